"""Figures of an evaluation or of a comparison of models, for an article.

They show who is right and who agrees with people. Every function takes an evaluation or a
comparison, or the folder of one, draws on no global state and returns a matplotlib
figure, written to ``path`` (.png, .pdf, .svg) as well where one is given. Where the results lack
what a figure is about, it raises :class:`NothingToDrawError`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from phase_ppl.evaluation.comparison import ModelComparison
from phase_ppl.evaluation.figures.grids import (
    confusion,
    costs,
    differences,
    film_strips,
    people,
    scatter_goals,
    scatter_relations,
)
from phase_ppl.evaluation.figures.rows import (
    DRAWINGS,
    Drawing,
    NothingToDrawError,
    Results,
    Source,
    accuracy,
    correlation,
    equivalence,
    likeness,
    opened,
    tags,
)
from phase_ppl.world.files import writable_folder

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
