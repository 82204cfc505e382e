"""What the figures have in common."""

from __future__ import annotations

import functools
import inspect
import io
import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final, Literal, ParamSpec

import numpy as np

from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.files import atomic_output

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS: Final = (".png", ".pdf", ".svg")  # file name endings a figure can be written with
INK: Final = "#222222"
GREY: Final = "#666666"
"""Colours of text: of what is shown, of what explains it."""

SIMULATED_TIME: Final = "simulated time [s], a third of that of the film"
"""Label of every axis of time."""

SMALL: Final = 7.5
NORMAL: Final = 8.5
"""Font sizes, points."""

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#9a4c8f", "#8a6d00", "#56a0d3", "#444444")
"""Colours of lines, to be told apart without seeing red and green apart."""

MANY_COLOURS: Final = (
    *("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9"),
    *("#7a5195", "#8a6d00", "#444444", "#b5bd00", "#a50f15", "#7fcdbb"),
)
"""Colours of areas that stand for categories."""

OTHER: Final = "#d0d0d0"
"""Colour of what has none of its own."""


P = ParamSpec("P")


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = None) -> Figure:
    """Return an empty white figure, inches, that belongs to no global state.

    A notebook that shows it draws it, whatever the backend.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = _figure_class()(figsize=(width, height), facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


@functools.cache
def _figure_class() -> type[Figure]:
    from matplotlib.figure import Figure

    class ShownFigure(Figure):  # matplotlib is loaded where something is drawn
        def _repr_png_(self) -> bytes:
            buffer = io.BytesIO()
            self.savefig(buffer, format="png")
            return buffer.getvalue()

    return ShownFigure


def figure_of(*kinds: type) -> Callable[[Callable[P, Figure]], Callable[P, Figure]]:
    """Have a function refuse, in one line, to draw anything but these kinds of objects."""
    expected = " or ".join(f"a phase_ppl.{kind.__name__}" for kind in kinds)

    def checking(draw: Callable[P, Figure]) -> Callable[P, Figure]:
        first = next(iter(inspect.signature(draw).parameters))

        @functools.wraps(draw)
        def checked(*args: P.args, **options: P.kwargs) -> Figure:
            given = args[0] if args else options.get(first)
            if not isinstance(given, kinds):
                raise InvalidSettingError(f"{draw.__name__} of {shown(given)}, expected {expected}")
            return draw(*args, **options)

        return checked

    return checking


def written(figure: Figure, path: str | os.PathLike[str] | None) -> Figure:
    """Return the figure, written to ``path`` as well if there is one."""
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


def dressed(axes: Axes, title: str, note: str = "", *, x: str = "", y: str = "") -> None:
    """Leave the left and lower axis only; write a title, a note below it, and labels of axes."""
    bare(axes)
    axes.set_title(title, fontsize=NORMAL + 1, loc="left", color=INK, pad=14 if note else 6)
    if note:
        axes.text(0, 1.02, note, transform=axes.transAxes, fontsize=SMALL, color=GREY)
    axes.set_xlabel(x, fontsize=NORMAL, color=INK, labelpad=2)
    axes.set_ylabel(y, fontsize=NORMAL, color=INK)


def in_shares(axes: Axes) -> None:
    """Let the vertical axis go from 0 to 1, with faint lines."""
    axes.set_ylim(0, 1.02)
    axes.set_yticks([0, 0.5, 1], ["0", "0.5", "1"])
    faint_lines(axes)


def faint_lines(axes: Axes) -> None:
    """Draw faint horizontal lines below all else."""
    axes.grid(axis="y", color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)


def direct_labels(
    axes: Axes, ends: Sequence[tuple[float, str, str]], *, gap: float = 0.065
) -> None:
    """Write each line's name beside its end, moved apart where they would touch.

    ``ends`` are y, name and colour on axes with final limits; ``gap`` is the least distance of two
    names, as a share of the axis.
    """
    low, high = axes.get_ylim()
    wanted = np.array([(y - low) / (high - low) for y, _, _ in ends])
    order = np.argsort(wanted)
    places = wanted[order].copy()
    for _ in range(200):
        gaps = np.diff(places)
        for i in np.flatnonzero(gaps < gap - 1e-9):
            push = (gap - gaps[i]) / 2
            places[i] -= push
            places[i + 1] += push
        places[0] += max(0.0, 0.02 - places[0])
    for place, i in zip(places, order, strict=True):
        _, name, colour = ends[i]
        line = {"arrowstyle": "-", "color": colour, "lw": 0.7, "relpos": (0, 0.5)}
        axes.annotate(
            name,
            (1.0, wanted[i]),
            xycoords="axes fraction",
            xytext=(1.035, place),
            textcoords="axes fraction",
            va="center",
            fontsize=NORMAL,
            color=colour,
            annotation_clip=False,
            arrowprops={**line, "shrinkA": 0, "shrinkB": 0},
        )
