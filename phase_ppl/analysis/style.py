"""What the figures have in common."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

from phase_ppl.world.files import atomic_output

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS: Final = (".png", ".pdf", ".svg")
"""File name endings a figure can be written with."""

INK: Final = "#222222"

SMALL: Final = 7.5
NORMAL: Final = 8.5
"""Font sizes, points."""


def new_figure(width: float, height: float) -> Figure:
    """Return an empty white figure, inches, that belongs to no global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def written(figure: Figure, path: str | os.PathLike[str] | None) -> Figure:
    """Return the figure, written to ``path`` as well if there is one.

    Raises:
        OutputError: it cannot be written there, or the ending is none of :data:`FORMATS`.
    """
    if path is not None:
        with atomic_output(path, FORMATS) as part:
            figure.savefig(part, dpi=200)
    return figure


def bare(axes: Axes, *more: str) -> None:
    """Leave the left and lower axis only, or fewer, in thin lines."""
    for side in ("top", "right", *more):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_linewidth(0.7)
        axes.spines[side].set_color(INK)
    axes.tick_params(labelsize=SMALL + 0.5, width=0.7, length=3, colors=INK)
