"""What the figures have in common."""

from __future__ import annotations

import functools
import inspect
import io
import os
import textwrap
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import isotonic_regression

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.files import atomic_output

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS: Final = (".png", ".pdf", ".svg")  # file name endings a figure can be written with
INK: Final = "#222222"
GREY: Final = "#666666"
_WARNING: Final = "#b00020"
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

STYLE: Final[Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.labelpad": 2,
    "axes.labelsize": NORMAL,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": NORMAL + 1,
    "figure.labelsize": SMALL,
    "axes.formatter.use_locale": False,
    "figure.titlesize": NORMAL + 1,
    "font.size": SMALL,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "legend.fontsize": SMALL + 0.5,
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
    "text.color": INK,
    "text.parse_math": False,
    "text.usetex": False,  # names are no TeX, and LaTeX need not be there
    **{f"{axis}tick.{name}": value for axis in "xy" for name, value in
       {"color": INK, "labelsize": SMALL + 0.5, "major.size": 3, "major.width": 0.7}.items()},
}  # fmt: skip
"""Of all figures, in matplotlib's names."""

_PER_INCH: Final = 17.5  # small characters of a line

P = ParamSpec("P")
R = TypeVar("R")


def new_figure(width: float, height: float, title: str = "", note: str = "") -> Figure:
    """Return an empty white figure of ``width`` x ``height`` inches that ``pyplot`` does not know.

    It lays out its parts itself. ``title`` stands above them on the left, ``note`` below. A
    notebook shows the figure, whatever matplotlib's backend.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = _figure_class()(figsize=(width, height), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, x=0.1 / width, ha="left")
    if note:
        lines = textwrap.fill(note, int(_PER_INCH * width))
        figure.supxlabel(lines, x=0.1 / width, ha="left", color=GREY)
    return figure


@functools.cache
def _figure_class() -> type[Figure]:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    class ShownFigure(Figure):  # matplotlib is loaded where something is drawn
        def draw(self, renderer: Any) -> None:
            with rc_context(STYLE):  # some parts are only made now
                super().draw(renderer)

        def _repr_png_(self) -> bytes:
            buffer = io.BytesIO()
            self.savefig(buffer, format="png")
            return buffer.getvalue()

    return ShownFigure


def in_style(draw: Callable[P, R]) -> Callable[P, R]:
    """Return a function that draws as ``draw`` does, in the package's style."""

    @functools.wraps(draw)
    def styled(*args: P.args, **options: P.kwargs) -> R:
        from matplotlib import rc_context

        with rc_context(STYLE):
            return draw(*args, **options)

    return styled


def figure_of(*kinds: type) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Have a function refuse, in one line, to draw anything but these kinds of objects."""
    expected = " or ".join(f"a phase_ppl.{kind.__name__}" for kind in kinds)

    def checking(draw: Callable[P, R]) -> Callable[P, R]:
        first = next(iter(inspect.signature(draw).parameters))

        @functools.wraps(draw)
        def checked(*args: P.args, **options: P.kwargs) -> R:
            given = args[0] if args else options.get(first)
            if not isinstance(given, kinds):
                raise InvalidSettingError(f"{draw.__name__} of {shown(given)}, expected {expected}")
            return in_style(draw)(*args, **options)

        return checked

    return checking


def warned(figure: Figure, text: str) -> None:
    """Write a warning above a figure's note."""
    width = figure.get_figwidth()
    lines = textwrap.fill(f"{text[:1].upper()}{text[1:]}.", int(_PER_INCH * width))
    note = f"{lines}\n{figure.get_supxlabel()}".rstrip()
    figure.supxlabel(note, x=0.1 / width, ha="left", color=_WARNING)


def written(figure: Figure, path: str | os.PathLike[str] | None) -> Figure:
    """Return the figure; with a ``path`` also write it there, as .png, .pdf or .svg."""
    if path is not None:
        with atomic_output(path, FORMATS) as part:
            figure.savefig(part, dpi=200)
    return figure


def titled(axes: Axes, title: str, note: str = "", **style: Any) -> None:
    """Write a title, and smaller what stands between it and the axes."""
    axes.set_title(title, pad=15 if note else 6, **style)
    axes.annotate(
        note, (0, 1), (0, 4), xycoords="axes fraction", textcoords="offset points", color=GREY,
        annotation_clip=False,
    )  # fmt: skip


def banded(
    axes: Axes,
    x: ArrayLike,
    y: FloatArray,
    within: FloatArray | None,
    colour: str,
    *,
    shares: bool = False,
    **style: Any,
) -> None:
    """Draw a line, and a band of so much to either side of it; of shares up to 0 and 1."""
    if within is not None:
        low, high = np.clip([y - within, y + within], *((0, 1) if shares else (None, None)))
        axes.fill_between(x, low, high, color=colour, alpha=0.16, lw=0)
    axes.plot(x, y, color=colour, lw=1.8, **style)


def in_shares(axes: Axes) -> None:
    """Let the vertical axis go from 0 to 1, with faint lines."""
    axes.set_ylim(0, 1.02)
    axes.set_yticks([0, 0.5, 1], ["0", "0.5", "1"])
    axes.grid(axis="y")


def direct_labels(
    axes: Axes, ends: Sequence[tuple[float, str, str]], *, gap: float = 0.065
) -> None:
    """Write each line's name beside its end, moved apart where they would touch.

    ``ends`` are y, name and colour on axes with final limits; ``gap`` is the least distance of two
    names, as a share of the axis.
    """
    if not ends:
        return
    low, high = axes.get_ylim()
    ends = sorted(ends)
    wanted = np.array([(y - low) / (high - low) for y, _, _ in ends])
    steps = gap * np.arange(len(ends))
    # of all places that are so far apart, the nearest
    places = np.maximum(isotonic_regression(wanted - steps).x, 0.02) + steps
    for (_, name, colour), at, place in zip(ends, wanted, places, strict=True):
        line = {"arrowstyle": "-", "color": colour, "lw": 0.7, "relpos": (0, 0.5)}
        axes.annotate(
            name, (1.0, at), (1.035, place), xycoords="axes fraction", textcoords="axes fraction",
            va="center", fontsize=NORMAL, color=colour, annotation_clip=False,
            arrowprops={**line, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
