"""Panels of the data card: how long events are, and how fast agents go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.data_card_bars import BESIDE, HERE, WORDS, named, title, with_star
from phase_ppl.analysis.data_table import Row, other_text
from phase_ppl.analysis.style import INK, NORMAL, SMALL, bare
from phase_ppl.dataset.counts import LEVELS
from phase_ppl.dataset.statistics import SPEED_EDGES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Statistics = Mapping[str, Any]

_SPEED_MARKS: Final = {"mean": ("mean", "o"), "p99": ("99 %", "|"), "max": ("most", "o")}
_SPEED_TEXT: Final = SPEED_EDGES[-1] + 7.0
"""Where the columns of numbers begin, units/s."""


def durations(axes: Axes, here: Statistics, beside: Statistics, found: Sequence[Row]) -> None:
    """Draw how long events are, with the least, the median and the greatest length."""
    title(axes, "Duration")
    histogram = here["histograms"]["frames"]
    edges, counts = np.array(histogram["edges"], float), np.array(histogram["counts"], float)
    share = counts / counts.sum()
    width = edges[1] - edges[0]  # the last bin is open, and drawn as wide as the others
    axes.bar(edges[:-1], share, width, align="edge", color=HERE, ec="white", lw=0.8)
    top = float(share.max())
    for colour, ink, values, y in (
        (HERE, INK, here["values"], 1.42 * top),
        (BESIDE, WORDS, beside["values"], 1.17 * top),
    ):
        if "frames_median" not in values:
            continue
        figures = [values[f"frames_{what}"]["value"] for what in ("min", "median", "max")]
        places = np.minimum(figures, edges[-1])
        axes.plot(places[[0, 2]], [y, y], color=colour, lw=2, solid_capstyle="butt")
        axes.plot(places[1], y, "o", ms=5, color=colour)
        for value, x, side, shift in zip(
            figures, places, ("right", "center", "left"), ((-3, 0), (0, 7), (3, 0)), strict=True
        ):
            axes.annotate(f"{value:.0f}", (x, y), shift, textcoords="offset points", ha=side,
                          va="center", fontsize=SMALL, color=ink)  # fmt: skip
    untrimmed = named(found, "untrimmed")
    words = f"share that moves to the end: {with_star(untrimmed)}"
    if untrimmed.other is not None:
        words += f" (grey: {other_text(untrimmed)})"
    axes.set_xlim(0, edges[-2] + 1.6 * width)
    axes.set_ylim(0, top * 1.6)
    axes.set_xticks([0, 25, 50, 75, 100])
    axes.set_yticks([0, top], ["0", f"{top:.2f}"])
    axes.set_xlabel(f"frames (12 per simulated second)\n{words}", fontsize=SMALL, color=INK)
    bare(axes)


def speeds(axes: Axes, here: Statistics, beside: Statistics, found: Sequence[Row]) -> None:
    """Draw the agents' speeds for each strength: distribution, mean, 99 % and greatest."""
    title(axes, "Speed of agents, by strength")
    kinds = {"": "all", **{f"_{level}": f"{level} N" for level in LEVELS}}
    shown = [kind for kind in kinds if f"speed_mean{kind}" in here["values"]]
    for place, kind in enumerate(shown):
        histogram = here["histograms"][f"speed{kind}"]
        edges, counts = np.array(histogram["edges"], float), np.array(histogram["counts"], float)
        heights = 0.62 * np.sqrt(counts / counts.max())
        axes.stairs(place - heights, edges, baseline=place, fill=True, color=HERE, alpha=0.25)
        for values, colour, y in (
            (beside["values"], BESIDE, place + 0.18),
            (here["values"], HERE, place + 0.05),
        ):
            if f"speed_mean{kind}" in values:
                _speed_marks(axes, values, kind, y, colour)
        for column, what in enumerate(_SPEED_MARKS):
            row = named(found, f"speed_{what}{kind}")
            axes.text(_SPEED_TEXT + column * 12, place - 0.02, with_star(row), fontsize=SMALL,
                      va="bottom", ha="center", color=INK,
                      weight="bold" if row.stands_out else "normal")  # fmt: skip
    for column, (words, mark) in enumerate(_SPEED_MARKS.values()):
        x = _SPEED_TEXT + column * 12
        axes.plot(x, -0.88, mark, ms=4.5, mew=1.4, color=HERE, mfc="white" if column else HERE)
        axes.text(x, -0.76, words, fontsize=SMALL, color=WORDS, ha="center", va="top")
    axes.set_yticks(range(len(shown)), [kinds[kind] for kind in shown])
    axes.set_ylim(len(shown) - 0.6, -0.95)
    axes.set_xlim(0, _SPEED_TEXT + 30)
    axes.set_xticks(range(0, SPEED_EDGES[-1] + 1, 10))
    axes.set_xlabel("units/s; shaded: root of the frequency", fontsize=NORMAL, color=INK)
    bare(axes)
    axes.tick_params(axis="y", length=0)


def _speed_marks(axes: Axes, values: Mapping[str, Any], kind: str, y: float, colour: str) -> None:
    mean, high, most = (
        min(values[f"speed_{what}{kind}"]["value"], SPEED_EDGES[-1]) for what in _SPEED_MARKS
    )
    axes.plot([mean, most], [y, y], color=colour, lw=1)
    axes.plot(mean, y, "o", ms=4.5, color=colour)
    axes.plot(high, y, "|", ms=6, mew=2, color=colour)
    axes.plot(most, y, "o", ms=4, mfc="white", mec=colour)
