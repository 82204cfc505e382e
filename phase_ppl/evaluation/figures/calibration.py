"""The figure of a calibration: ranks of the truth, and reliability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd
from scipy.stats import binom

from phase_ppl.analysis.figures.style import COLOURS, in_style, new_figure, written
from phase_ppl.evaluation.figures.frame import PathLike
from phase_ppl.world.arrays import IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BAND: Final = (0.005, 0.995)  # between these quantiles lie 99 % of the bars


@in_style
def ranks_and_reliability(
    title: str,
    ranks: Mapping[str, IntArray],
    reliability: Mapping[str, pd.DataFrame],
    notes: Sequence[str] = (),
    path: PathLike | None = None,
) -> Figure:
    """Draw a row per quantity: where the truth ranked, and how often answers were right.

    Args:
        title: of the figure.
        ranks: quantity -> (bar,) videos by the place of the truth, in even bars from 0 to 1.
        reliability: quantity -> what :meth:`phase_ppl.Calibration.reliability` returns.
        notes: written below.
        path: where the figure is also written.
    """
    note = (
        "Left: how many videos have the truth at this place among draws of the posterior, and the "
        "band that holds 99 % of the bars of a calibrated model. Right: shares of right top "
        "answers, or of central intervals that hold the true strength, with 95 % intervals; the "
        "line is a calibrated model. "
    )
    height = 1.0 + 1.55 * len(ranks) + 0.12 * sum(map(len, notes)) / 100
    figure = new_figure(6.4, height, title, note + " ".join(notes))
    grid = figure.subplots(len(ranks), 2, squeeze=False, width_ratios=(1.7, 1))
    for (left, right), (quantity, counts) in zip(grid, ranks.items(), strict=True):
        _draw_ranks(left, counts)
        words = quantity.replace("_", " of ")
        left.set_title(words if quantity.startswith("strength") else f"probability of {words}")
        _draw_reliability(right, reliability[quantity])
    grid[-1, 0].set_xlabel("place of the truth")
    grid[-1, 1].set_xlabel("probability said")
    return written(figure, path)


def _draw_ranks(axes: Axes, counts: IntArray) -> None:
    from matplotlib.ticker import MaxNLocator

    n, bars = counts.sum(), len(counts)
    axes.axhspan(*binom.ppf(_BAND, n, 1 / bars), color="0.9", lw=0)
    axes.axhline(n / bars, color="0.6", lw=0.8)
    axes.bar((np.arange(bars) + 0.5) / bars, counts, 0.9 / bars, color=COLOURS[0])
    axes.set(xlim=(0, 1), ylabel="videos")
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))


def _draw_reliability(axes: Axes, found: pd.DataFrame) -> None:
    axes.plot([0, 1], [0, 1], color="0.6", lw=0.8)
    axes.vlines(found["probability"], found["low"], found["high"], COLOURS[0], lw=1.2)
    axes.plot(found["probability"], found["share"], "o", ms=4, color=COLOURS[0], clip_on=False)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])
    axes.set_ylabel("share")
