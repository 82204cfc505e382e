"""What the panels of the data card share: pairs of bars, titles, colours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from phase_ppl.analysis.data_table import Row, number
from phase_ppl.analysis.style import INK, NORMAL, SMALL, bare

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HERE: Final = "#0072b2"
BESIDE: Final = "#b4b4b4"
WORDS: Final = "#666666"
"""Colours: of the set, of the other, of what explains."""

LONGEST_LABEL: Final = 22
"""Characters of a label at most."""


def of(found: Sequence[Row], start: str) -> list[Row]:
    """Return the rows whose keys begin so."""
    return [row for row in found if row.key.startswith(start)]


def named(found: Sequence[Row], key: str) -> Row:
    """Return the row with this key."""
    return next(row for row in found if row.key == key)


def with_star(row: Row) -> str:
    """Return the value as text, with a star where it stands out."""
    return number(row.value, row) + ("*" if row.stands_out else "")


def short(text: str, length: int) -> str:
    """Return a text cut to a length."""
    return text if len(text) <= length else text[: length - 1] + "…"


def title(axes: Axes, text: str) -> None:
    """Write the title of a panel."""
    axes.set_title(text, fontsize=NORMAL + 1, loc="left", color=INK)


def unknown(axes: Axes) -> None:
    """Say in a panel that there is nothing to tell."""
    axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center", fontsize=NORMAL,
              color=WORDS)  # fmt: skip
    axes.set_axis_off()


def paired_bars(axes: Axes, groups: Sequence[Sequence[Row]]) -> None:
    """Draw shares of two sets as pairs of bars, groups apart, the set's value at the end."""
    shown = [row for group in groups for row in group]
    if not shown:
        unknown(axes)
        return
    gaps = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    places = np.arange(len(shown)) + 0.7 * gaps
    high = max(max(row.value, *np.atleast_1d(row.other or 0.0)) for row in shown)
    for place, row in zip(places, shown, strict=True):
        alone = row.other is None
        axes.barh(place if alone else place - 0.2, row.value, 0.7 if alone else 0.4, color=HERE)
        if row.other is not None:
            low, top = row.other if isinstance(row.other, tuple) else (0.0, row.other)
            axes.barh(place + 0.2, top - low, 0.4, left=low, color=BESIDE)
        end = max(row.value, *np.atleast_1d(row.other or 0.0))
        axes.text(end + 0.02 * high, place, with_star(row), va="center", fontsize=SMALL, color=INK,
                  weight="bold" if row.stands_out else "normal")  # fmt: skip
    axes.set_yticks(places, [short(row.label, LONGEST_LABEL) for row in shown])
    axes.set_ylim(places[-1] + 0.6, -0.6)
    axes.set_xlim(0, 1.2 * max(high, 0.01))
    axes.locator_params(axis="x", nbins=4)
    bare(axes)
    axes.tick_params(axis="y", length=0)
