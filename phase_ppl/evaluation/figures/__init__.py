"""Figures of an evaluation, for an article: who is right, who agrees with people.

Every function takes a folder of results (or its path), draws on no global state and returns a
matplotlib figure, written to ``path`` (.png, .pdf, .svg) as well where one is given. Where the
results lack what a figure is about, it raises :class:`NothingToDrawError`.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from phase_ppl.analysis.style import written
from phase_ppl.evaluation.figures import accuracies as _accuracies
from phase_ppl.evaluation.figures import agreement as _agreement
from phase_ppl.evaluation.figures import matrices as _matrices
from phase_ppl.evaluation.figures import strips as _strips
from phase_ppl.evaluation.figures.results import NothingToDrawError, Results
from phase_ppl.evaluation.folder import ResultsFolder
from phase_ppl.world.errors import OutputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Source = ResultsFolder | str | os.PathLike[str]
Target = str | os.PathLike[str] | None

DRAWN: Final[dict[str, Callable[[Results], Figure]]] = {
    "accuracy": _accuracies.accuracy,
    "confusion": _matrices.confusion,
    "correlation": _agreement.correlation,
    "scatter_goals": functools.partial(_agreement.scatter, kind="goal"),
    "scatter_relations": functools.partial(_agreement.scatter, kind="relation"),
    "film_strips": _strips.film_strips,
}
"""Name of a figure, and of its file -> what draws it."""

TITLES: Final = {
    "accuracy": "Accuracy by scenario",
    "confusion": "Which scenario is taken for which",
    "correlation": "Correlation with people",
    "scatter_goals": "Goals: models against people",
    "scatter_relations": "Relations: models against people",
    "film_strips": "An event of every scenario",
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
    target = folder.path / "figures"
    try:
        target.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror or error}") from None
    files = []
    results = Results(folder)
    for name, draw in DRAWN.items():
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


def _drawn(name: str, source: Source, path: Target) -> Figure:
    folder = source if isinstance(source, ResultsFolder) else ResultsFolder.open(source)
    return written(DRAWN[name](Results(folder)), path)
