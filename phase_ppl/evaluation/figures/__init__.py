"""Figures of an evaluation or of a comparison of models, for an article.

They show who is right and who agrees with people. Every function takes an evaluation or a
comparison, or the folder of one, draws on no global state and returns a matplotlib
figure, written to ``path`` (.png, .pdf, .svg) as well where one is given. Where the results lack
what a figure is about, it raises :class:`NothingToDrawError`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeVar

from phase_ppl.analysis.figures.style import written
from phase_ppl.evaluation.comparison import ModelComparison
from phase_ppl.evaluation.experiments import (
    MAJORITY,
    MARGIN,
    Likeness,
    Tags,
    load_likeness,
    load_tags,
)
from phase_ppl.evaluation.figures import grids as _grids
from phase_ppl.evaluation.figures import rows as _rows
from phase_ppl.evaluation.figures.layout import NothingToDrawError, Results, Source
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.files import writable_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "DRAWINGS",
    "accuracy",
    "confusion",
    "correlation",
    "costs",
    "differences",
    "draw_figures",
    "equivalence",
    "film_strips",
    "likeness",
    "people",
    "scatter_goals",
    "scatter_relations",
    "tags",
]

_Data = TypeVar("_Data")

FOLDER: Final = "figures"
"""The folder of the figures in that of the results."""


class Drawing(NamedTuple):
    """A kind of figure."""

    title: str  # what it shows, in a few words
    alt: str  # what stands in its place for those who do not see it
    draw: Callable[[Results], Figure]  # draws it
    compares: bool = False  # whether it is one of comparisons of models only


DRAWINGS: Final = {
    "accuracy": Drawing(
        "Accuracy by scenario",
        "Bars: share of right goals and relations of everybody, over all events and by true "
        "scenario, with 95 % intervals; the numbers are in the tables above.",
        _rows.accuracy,
    ),
    "confusion": Drawing(
        "Which scenario is taken for which",
        "Matrices of counts: true scenario against the scenario of the goals answered.",
        _grids.confusion,
    ),
    "correlation": Drawing(
        "Correlation with people",
        "Bars: correlation of each model with people; the numbers are in the table.",
        _rows.correlation,
    ),
    "scatter_goals": Drawing(
        "Goals: models against people",
        "Points: probability of a goal for a model against that for people.",
        _grids.scatter_goals,
    ),
    "scatter_relations": Drawing(
        "Relations: models against people",
        "Points: probability of a relation for a model against that for people.",
        _grids.scatter_relations,
    ),
    "people": Drawing(
        "Doubt: models against people",
        "Points: probabilities of relations against people's shares, as they are and given the "
        "truth; bars: both correlations, beside what people reach among themselves.",
        _rows.people,
    ),
    "film_strips": Drawing(
        "An event of every scenario",
        "Film strips: an event of every scenario, from first to last frame.",
        _grids.film_strips,
    ),
    "costs": Drawing(
        "Accuracy against CPU seconds",
        "Points: share of right answers against CPU seconds per event, with intervals.",
        _grids.costs,
        compares=True,
    ),
    "differences": Drawing(
        "Differences between models",
        "Matrices: difference in right answers between every two models.",
        _grids.differences,
        compares=True,
    ),
    "equivalence": Drawing(
        "Models beside people",
        "Points with intervals: right answers of models minus those of people, beside the margin "
        "of equivalence; the numbers are in the table.",
        _rows.equivalence,
        compares=True,
    ),
}
"""Name of a figure, and of its file -> what it is."""


def draw_figures(source: Source, folder: Path, *, progress: bool = True) -> list[Path]:
    """Write all figures that the results allow into ``figures/``, as PNG; return the files.

    With ``progress`` standard error says which are left out, and why.

    Raises:
        InvalidEventError, UnknownNameError: a file in the folder is damaged.
        OutputError: a file cannot be written.
    """
    results = Results.of(source)
    target = writable_folder(folder / FOLDER)
    files = []
    for name, drawing in drawings_of(results).items():
        file = target / f"{name}.png"
        try:
            written(drawing.draw(results), file)
        except NothingToDrawError as reason:
            file.unlink(missing_ok=True)  # of an earlier state of the results
            if progress:
                print(f"no figure {name}: {reason}", file=sys.stderr)
        else:
            files.append(file)
    return files


def drawings_of(results: Results) -> dict[str, Drawing]:
    """Return the figures that there are of such results."""
    compares = isinstance(results.source, ModelComparison)
    return {name: one for name, one in DRAWINGS.items() if compares or not one.compares}


class _Public(Protocol):
    def __call__(self, source: Source, path: str | os.PathLike[str] | None = None) -> Figure: ...


def _public(name: str) -> _Public:
    drawing = DRAWINGS[name]

    def drawn(source: Source, path: str | os.PathLike[str] | None = None) -> Figure:
        results = Results.of(source)
        if name not in drawings_of(results):
            raise NothingToDrawError(f"{name} is a figure of a comparison of models")
        return written(drawing.draw(results), path)

    drawn.__name__, drawn.__doc__ = name, drawing.draw.__doc__
    return drawn


accuracy = _public("accuracy")
confusion = _public("confusion")
correlation = _public("correlation")
scatter_goals = _public("scatter_goals")
scatter_relations = _public("scatter_relations")
people = _public("people")
film_strips = _public("film_strips")
costs = _public("costs")
differences = _public("differences")
equivalence = _public("equivalence")


def _read(source: Any, kind: type[_Data], load: Callable[[Any], _Data]) -> _Data:
    if isinstance(source, str | os.PathLike):
        return load(source)
    if not isinstance(source, kind):
        raise InvalidSettingError(f"{shown(source)}, expected {kind.__name__} or their file")
    return source


def tags(
    source: Tags | str | os.PathLike[str],
    path: str | os.PathLike[str] | None = None,
    *,
    majority: float = MAJORITY,
) -> Figure:
    """Draw in how many videos people see what, as the paper does of its 23 labels.

    The labels, or their CSV file (:mod:`phase_ppl.evaluation.experiments`), may be anybody's; a
    video has a category from which on that share of its viewers, ``majority``, chose it.

    Raises:
        InvalidSettingError: ``source`` is neither labels nor a file, or ``majority`` no share.
        InvalidEventError: the file holds no labels; the message names file and line.
    """
    return written(_rows.tags(_read(source, Tags, load_tags), majority), path)


def likeness(
    source: Likeness | str | os.PathLike[str],
    path: str | os.PathLike[str] | None = None,
    *,
    margin: float = MARGIN,
) -> Figure:
    """Draw how likely people find it that people behave like this, in two groups of videos.

    The ratings, or their CSV file (:mod:`phase_ppl.evaluation.experiments`), may be anybody's;
    groups are equivalent if their mean ratings differ by less than ``margin``.

    Raises:
        InvalidSettingError: ``source`` is neither ratings nor a file, or ``margin`` not positive.
        InvalidEventError: the file holds no ratings; the message names file and line.
    """
    return written(_rows.likeness(_read(source, Likeness, load_likeness), margin), path)


def __dir__() -> list[str]:
    return __all__
