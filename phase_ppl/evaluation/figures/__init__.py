"""Figures of an evaluation or of a comparison of models, for an article.

They show who is right and who agrees with people. Every function takes an evaluation or a
comparison, or the folder of one, draws on no global state and returns a matplotlib
figure, written to ``path`` (.png, .pdf, .svg) as well where one is given. Where the results lack
what a figure is about, it raises :class:`NothingToDrawError`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from phase_ppl.evaluation.comparison import ModelComparison
from phase_ppl.evaluation.figures.grids import (
    confusion,
    costs,
    differences,
    film_strips,
    scatter_goals,
    scatter_relations,
)
from phase_ppl.evaluation.figures.layout import NothingToDrawError, Results, Source, opened
from phase_ppl.evaluation.figures.rows import (
    accuracy,
    correlation,
    equivalence,
    likeness,
    people,
    tags,
)
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

FOLDER: Final = "figures"  # of the figures, in that of the results


class Drawing(NamedTuple):
    """A kind of figure."""

    title: str  # what it shows, in a few words
    alt: str  # what stands in its place for those who do not see it
    draw: Callable[..., Figure]  # draws results, and writes the figure to a path
    compares: bool = False  # whether it is one of comparisons of models only


DRAWINGS: Final = {
    "accuracy": Drawing(
        "Accuracy by scenario, or by agent and pair",
        "Bars: share of right goals and relations of everybody, over all events and by true "
        "scenario, in other worlds than PHASE by agent and pair, with 95 % intervals; the numbers "
        "are in the tables above.",
        accuracy,
    ),
    "confusion": Drawing(
        "Which scenario is taken for which",
        "Matrices of counts: true scenario against the scenario of the goals answered.",
        confusion,
    ),
    "correlation": Drawing(
        "Correlation with people",
        "Bars: correlation of each model with people; the numbers are in the table.",
        correlation,
    ),
    "scatter_goals": Drawing(
        "Goals: models against people",
        "Points: probability of a goal for a model against that for people.",
        scatter_goals,
    ),
    "scatter_relations": Drawing(
        "Relations: models against people",
        "Points: probability of a relation for a model against that for people.",
        scatter_relations,
    ),
    "people": Drawing(
        "Doubt: models against people",
        "Points: probabilities of relations against people's shares, as they are and given the "
        "truth; bars: both correlations, beside what people reach among themselves.",
        people,
    ),
    "film_strips": Drawing(
        "An event of every scenario, or the first few",
        "Film strips: an event of every scenario, from first to last frame.",
        film_strips,
    ),
    "costs": Drawing(
        "Accuracy against CPU seconds",
        "Points: share of right answers against CPU seconds per event, with intervals.",
        costs,
        compares=True,
    ),
    "differences": Drawing(
        "Differences between models",
        "Matrices: difference in right answers between every two models.",
        differences,
        compares=True,
    ),
    "equivalence": Drawing(
        "Models beside people",
        "Points with intervals: right answers of models minus those of people, beside the margin "
        "of equivalence; the numbers are in the table.",
        equivalence,
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
    results = opened(source)
    target = writable_folder(folder / FOLDER)
    files = []
    for name, drawing in drawings_of(results).items():
        file = target / f"{name}.png"
        try:
            drawing.draw(results, file)
        except NothingToDrawError as reason:
            file.unlink(missing_ok=True)  # of an earlier state of the results
            if progress:
                print(f"no figure {name}: {reason}", file=sys.stderr)
        else:
            files.append(file)
    return files


def drawings_of(results: Results) -> dict[str, Drawing]:
    """Return the figures that there are of such results."""
    compares = isinstance(results, ModelComparison)
    return {name: one for name, one in DRAWINGS.items() if compares or not one.compares}


def __dir__() -> list[str]:
    return __all__
