"""A figure that is laid out in inches from its upper left corner, as a page is."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

from phase_ppl.analysis.style import INK, NORMAL, SMALL, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH: Final = 7.2
"""Inches: both columns of a journal's page."""

GREY: Final = "#6b6b6b"

_NARROWEST: Final = 1.3
_WIDEST: Final = 2.3
_REGULAR: Final = 0.58
"""Mean character of a text that is not bold, as a share of its size."""

_CHARACTER: Final = 0.69
"""Widest mean character of a bold text, as a share of its size."""

_UNBROKEN: Final = 1.3
"""How much too long, as a share, a word may be and is written smaller instead of broken."""


class Sheet:
    """An empty figure of ``width`` x ``height`` inches."""

    def __init__(self, width: float, height: float) -> None:
        self.figure: Figure = new_figure(width, height)
        self.width, self.height = width, height

    def axes(self, left: float, top: float, width: float, height: float) -> Axes:
        """Return new axes at a place in inches."""
        return self.figure.add_axes(
            (
                left / self.width,
                1 - (top + height) / self.height,
                width / self.width,
                height / self.height,
            )
        )

    def write(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = NORMAL,
        colour: str = INK,
        ha: str = "left",
        va: str = "baseline",
        weight: str = "normal",
    ) -> None:
        """Write at a place in inches; nothing in ``text`` is read as mathematics."""
        self.figure.text(
            x / self.width,
            1 - y / self.height,
            text,
            fontsize=size,
            color=colour,
            ha=ha,
            va=va,
            fontweight=weight,
            parse_math=False,
        )


def fitting(text: str, width: float, most: float = NORMAL) -> float:
    """Return the font size, points, at which ``text`` fits into ``width`` inches."""
    return min(most, 72 * width / (_CHARACTER * max(len(text), 1)))


def label_column(labels: Iterable[str]) -> float:
    """Return how many inches names of rows take on the left of a sheet, with what surrounds them.

    Names that are longer still are written smaller, see :func:`fitting`.
    """
    longest = max(map(len, labels), default=0)
    return min(_WIDEST, max(_NARROWEST, _REGULAR * longest * NORMAL / 72 + 0.2))


def in_lines(text: str, width: float) -> list[str]:
    """Return a name in as many lines as it needs to be legible in ``width`` inches.

    A word is broken only where it would otherwise be written much smaller than the rest.
    """
    if fitting(text, width) >= SMALL:
        return [text]
    characters = max(1, int(72 * width / (_CHARACTER * SMALL)))
    longest = max(map(len, text.split()), default=0)
    if longest <= _UNBROKEN * characters:
        characters = max(characters, longest)
    return textwrap.wrap(text, characters) or [text]


def in_words(counts: Iterable[int]) -> str:
    """Return how many there are, such as of the events of several models: "n = 9 to 10"."""
    known = sorted(counts)
    least, most = known[0], known[-1]
    return f"n = {most}" if least == most else f"n = {least} to {most}"


def tint(colour: str, share: float) -> tuple[float, float, float]:
    """Return ``colour`` mixed with white; ``share`` is what is kept of it."""
    from matplotlib.colors import to_rgb

    red, green, blue = (1 - share * (1 - part) for part in to_rgb(colour))
    return red, green, blue
