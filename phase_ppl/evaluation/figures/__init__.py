"""Figures of an evaluation or of a comparison of models, for an article.

They show who is right and who agrees with people. Every function takes a folder of results or of a
comparison (or its path), or a comparison itself, draws on no global state and returns a matplotlib
figure, written to ``path`` (.png, .pdf, .svg) as well where one is given. Where the results lack
what a figure is about, it raises :class:`NothingToDrawError`.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from phase_ppl.analysis.figures.style import written
from phase_ppl.evaluation.figures import accuracies as _accuracies
from phase_ppl.evaluation.figures import agreement as _agreement
from phase_ppl.evaluation.figures import costs as _costs
from phase_ppl.evaluation.figures import matrices as _matrices
from phase_ppl.evaluation.figures import pairs as _pairs
from phase_ppl.evaluation.figures import sheet as _strips
from phase_ppl.evaluation.figures.sheet import FolderResults, NothingToDrawError, Results
from phase_ppl.evaluation.folder import COMPARISON, ResultsFolder
from phase_ppl.world.files import writable_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from phase_ppl.evaluation.comparison.comparison import ModelComparison
    from phase_ppl.evaluation.comparison.results import ComparedResults

Source: TypeAlias = "ResultsFolder | ModelComparison | str | os.PathLike[str]"
Target = str | os.PathLike[str] | None

FIGURES: Final = "figures"
"""The folder of the figures in that of the results."""

DRAWN: Final[dict[str, Callable[[Results], Figure]]] = {
    "accuracy": _accuracies.accuracy,
    "confusion": _matrices.confusion,
    "correlation": _agreement.correlation,
    "scatter_goals": functools.partial(_agreement.scatter, kind="goal"),
    "scatter_relations": functools.partial(_agreement.scatter, kind="relation"),
    "film_strips": _strips.film_strips,
}
"""Name of a figure, and of its file -> what draws it."""

COMPARED: Final[dict[str, Callable[[ComparedResults], Figure]]] = {
    **DRAWN,
    "costs": _costs.costs,
    "differences": _pairs.differences,
    "equivalence": _pairs.equivalence,
}
"""The same of a comparison of models."""

TITLES: Final = {
    "accuracy": "Accuracy by scenario",
    "confusion": "Which scenario is taken for which",
    "correlation": "Correlation with people",
    "scatter_goals": "Goals: models against people",
    "scatter_relations": "Relations: models against people",
    "film_strips": "An event of every scenario",
    "costs": "Accuracy against CPU seconds",
    "differences": "Differences between models",
    "equivalence": "Models beside people",
}
"""Name of a figure -> what it shows, in words."""


def draw_figures(folder: ResultsFolder, *, progress: bool = True) -> list[Path]:
    """Write all figures that the results allow into ``figures/``, as PNG; return the files.

    Args:
        folder: with metrics.json, or they are computed from the finished events.
        progress: say on the standard error output which are left out, and why.

    Raises:
        InvalidEventError, UnknownNameError: a file in the folder is damaged.
        OutputError: a file cannot be written.
    """
    return _draw_all(DRAWN, FolderResults(folder), folder.path / FIGURES, progress)


def draw_comparison(
    comparison: ModelComparison, folder: str | os.PathLike[str], *, progress: bool = True
) -> list[Path]:
    """Write all figures of a comparison of models into ``figures/`` of a folder; return the files.

    Args:
        comparison: of the models.
        folder: to which ``figures/`` belongs.
        progress: say on the standard error output which are left out, and why.

    Raises:
        OutputError: a file cannot be written.
    """
    from phase_ppl.evaluation.comparison.results import ComparedResults

    return _draw_all(COMPARED, ComparedResults(comparison), Path(folder) / FIGURES, progress)


def _draw_all(
    drawn: Mapping[str, Callable[[Any], Figure]], results: Results, target: Path, progress: bool
) -> list[Path]:
    writable_folder(target)
    files = []
    for name, draw in drawn.items():
        file = target / f"{name}.png"
        try:
            written(draw(results), file)
        except NothingToDrawError as reason:
            file.unlink(missing_ok=True)  # of an earlier state of the results
            if progress:
                print(f"no figure {name}: {reason}", file=sys.stderr)
        else:
            files.append(file)
    return files


def accuracy(source: Source, path: Target = None) -> Figure:
    """Draw the accuracy of goals and relations, over all events and by true scenario."""
    return _drawn("accuracy", source, path)


def confusion(source: Source, path: Target = None) -> Figure:
    """Draw true scenarios against those of the goals answered."""
    return _drawn("confusion", source, path)


def correlation(source: Source, path: Target = None) -> Figure:
    """Draw how well models, and people among themselves, correlate with people's answers."""
    return _drawn("correlation", source, path)


def scatter_goals(source: Source, path: Target = None) -> Figure:
    """Draw models' probabilities of goals against people's."""
    return _drawn("scatter_goals", source, path)


def scatter_relations(source: Source, path: Target = None) -> Figure:
    """Draw models' probabilities of relations against people's."""
    return _drawn("scatter_relations", source, path)


def film_strips(source: Source, path: Target = None) -> Figure:
    """Draw an event of every true scenario as a film strip."""
    return _drawn("film_strips", source, path)


def costs(source: ModelComparison | str | os.PathLike[str], path: Target = None) -> Figure:
    """Draw the accuracy of the models of a comparison against CPU seconds per event."""
    return _drawn("costs", source, path)


def differences(source: ModelComparison | str | os.PathLike[str], path: Target = None) -> Figure:
    """Draw the differences in right answers between every two models of a comparison."""
    return _drawn("differences", source, path)


def equivalence(source: ModelComparison | str | os.PathLike[str], path: Target = None) -> Figure:
    """Draw how much more often models are right than people, beside the margin of equivalence."""
    return _drawn("equivalence", source, path)


def _drawn(name: str, source: Source, path: Target) -> Figure:
    if isinstance(source, str | os.PathLike) and not (Path(source) / COMPARISON).is_file():
        source = ResultsFolder.open(source)
    if isinstance(source, ResultsFolder):
        if name not in DRAWN:
            raise NothingToDrawError(f"{name} is a figure of a comparison of models")
        return written(DRAWN[name](FolderResults(source)), path)
    from phase_ppl.evaluation.comparison.comparison import ModelComparison
    from phase_ppl.evaluation.comparison.results import ComparedResults

    comparison = source if isinstance(source, ModelComparison) else ModelComparison.load(source)
    return written(COMPARED[name](ComparedResults(comparison)), path)
