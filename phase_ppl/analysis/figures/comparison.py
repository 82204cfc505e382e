"""The figure of a comparison: how good each kernel is after ever more simulations or frames."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from phase_ppl.analysis.comparison import DISTANCES, Comparison
from phase_ppl.analysis.figures.style import (
    COLOURS,
    INK,
    NORMAL,
    SMALL,
    bare,
    direct_labels,
    new_figure,
    written,
)
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import unknown_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


STYLES: Final = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)))
"""Lines of the kernels, for those beyond the colours."""

HEADINGS: Final = {
    "tv_goals": ("Distance from the reference", "total variation of a goal's marginal"),
    "tv_relation": ("Distance of the relation", "total variation of the relation's marginal"),
    "p_goals": ("Belief in the true goals", "probability of an agent's true goal"),
    "p_pair": ("Belief in the true pair", "probability of the true pair of goals"),
    "p_relation": ("Belief in the true relation", "probability of the true relation"),
    "map_goals": ("Accuracy", "share of agents whose leading goal is right"),
    "map_relation": ("Accuracy", "share of runs whose leading relation is right"),
}
"""Measure -> title and label of its axis."""

_POINTS: Final = 200


def comparison(
    c: Comparison,
    path: str | os.PathLike[str] | None = None,
    *,
    measures: tuple[str, ...] = ("tv_goals", "p_goals"),
) -> Figure:
    """Draw measures of accuracy against simulations, a line per kernel.

    Against frames, where the budget was of frames. Lines are means over repeats, bands their
    standard errors. A kernel that keeps its last population only is a point with a bar. A dashed
    line is what the reference says of the truth; of distances from the reference, those in
    the grey area at the bottom are smaller than its own error.

    Args:
        c: what to draw.
        path: where to write the figure as well, as .png, .pdf or .svg.
        measures: a panel for each, of :data:`HEADINGS`; those without values are left out.

    Returns:
        A matplotlib figure, 4.6 inches wide for each panel.

    Raises:
        UnknownNameError: there is no such measure.
        OutputError: the figure cannot be written there, or the ending is another.
    """
    for name in measures:
        if name not in HEADINGS:
            raise unknown_name("measure", name, HEADINGS)
    drawn = [name for name in measures if c.curve[name].notna().any()]
    figure = new_figure(4.6 * len(drawn), 3.6)
    grid = figure.add_gridspec(
        1, len(drawn), left=0.62 / (4.6 * len(drawn)), right=1 - 1.15 / (4.6 * len(drawn)),
        top=0.86, bottom=0.185, wspace=1.75 / 2.9,
    )  # fmt: skip
    for panel, name in enumerate(drawn):
        axes = figure.add_subplot(grid[panel])
        _panel(axes, c, name)
        title, label = HEADINGS[name]
        axes.set_title(title, fontsize=NORMAL + 1, loc="left", color=INK, pad=14)
        axes.text(0, 1.02, label, transform=axes.transAxes, fontsize=SMALL + 0.5, color="#666666")
    repeats = c.runs.groupby("kernel").size()
    words = f"{repeats.min()}" if repeats.min() == repeats.max() else "several"
    note = f"{c.settings['event']}: mean and standard error of {words} runs each"
    figure.text(0.62 / (4.6 * len(drawn)), 0.025, note, fontsize=SMALL, color="#666666")
    return written(figure, path)


def _panel(axes: Axes, c: Comparison, name: str) -> None:
    unit = "frames" if str(c.settings["budget"]).endswith("frames") else "simulations"
    ends: list[tuple[float, float, str, str]] = []
    for place, kernel in enumerate(c.kernels):
        colour, style = COLOURS[place % len(COLOURS)], STYLES[place // len(COLOURS) % len(STYLES)]
        rows = c.curve[c.curve["kernel"] == kernel]
        x, mean, error = _mean_curve(rows, name, unit)
        if len(x) == 1:
            axes.errorbar(x, mean, error, fmt="o", ms=4, color=colour, capsize=2, lw=1.2)
        else:
            axes.fill_between(x, mean - error, mean + error, color=colour, alpha=0.16, lw=0)
            axes.plot(x, mean, color=colour, ls=style, lw=1.8, solid_capstyle="round")
        ends.append((float(x[-1]), float(mean[-1]), kernel, colour))
    own_error = c.reference_error(name) if name in DISTANCES else None
    if own_error is not None:
        axes.axhspan(0, own_error, color="#eeeeee", lw=0, zorder=0)
        note = "within the reference's own error"
        axes.text(0.015, 0.02, note, transform=axes.transAxes, fontsize=SMALL, color="#777777")
    reference = c.settings["reference"].get("truth", {}).get(name)
    if reference is not None:
        axes.axhline(reference, color="#777777", lw=0.9, ls=(0, (4, 3)), zorder=1)
        ends.append((0.0, reference, "reference", "#777777"))
    bare(axes)
    axes.set_xlabel("simulated frames" if unit == "frames" else unit, fontsize=NORMAL, color=INK)
    axes.set_xlim(0, max(end[0] for end in ends) * 1.02)
    top = axes.get_ylim()[1]
    axes.set_ylim(0, min(1.02, max(top, 0.05)))
    axes.grid(axis="y", color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    direct_labels(axes, ends)


def _mean_curve(
    rows: pd.DataFrame, name: str, unit: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return simulations or frames, mean and standard error, where all repeats have begun.

    Every run counts at each number of simulations with what it had by then.
    """
    runs = [(run[unit].to_numpy(float), run[name].to_numpy(float))
            for _, run in rows.groupby("repeat")]  # fmt: skip
    begin, end = max(x[0] for x, _ in runs), max(x[-1] for x, _ in runs)
    at = np.unique(np.linspace(begin, end, _POINTS)) if end > begin else np.array([end])
    values = np.array([y[np.searchsorted(x, at, side="right") - 1] for x, y in runs])
    spread = values.std(axis=0, ddof=1) / np.sqrt(len(runs)) if len(runs) > 1 else 0.0 * at
    return at, values.mean(axis=0), spread
