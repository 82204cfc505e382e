"""Figures of kernels over simulations, of how chains went, and of sets of events."""

from __future__ import annotations

import os
import textwrap
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from phase_ppl.analysis.comparison import DISTANCES, Comparison
from phase_ppl.analysis.figures.style import (
    COLOURS,
    GREY,
    INK,
    MANY_COLOURS,
    OTHER,
    SIMULATED_TIME,
    banded,
    direct_labels,
    figure_of,
    in_shares,
    in_style,
    new_figure,
    titled,
    written,
)
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.tree import array
from phase_ppl.world.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure, SubFigure

STYLES: Final = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)))
"""Lines of the kernels, for those beyond the colours."""

_HEADINGS: Final = {
    "tv_goals": ("Distance from the reference", "total variation of a goal's marginal"),
    "p_goals": ("Belief in the true goals", "probability of an agent's true goal"),
}
"""Measure -> title and label of its axis."""

_POINTS: Final = 200


@figure_of(Comparison)
def comparison(c: Comparison, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw distance from the reference, and belief in the true goals, against simulations.

    The figure has a line per kernel; a panel is 4.6 inches wide. ``c.curve`` has further measures.

    With a budget of frames the axis is frames. Lines are means over repeats, bands their standard
    errors. A kernel that keeps its last population only is a point with a bar. A dashed line is the
    reference's own probability of the truth. Distances in the grey area at the bottom are smaller
    than the distance between the reference's halves. A panel without values is left out.
    """
    drawn = [name for name in _HEADINGS if c.curve[name].notna().any()]
    repeats = c.runs.groupby("kernel").size()
    words = f"{repeats.min()}" if repeats.min() == repeats.max() else "several"
    note = f"{c.settings['event']}: mean and standard error of {words} runs each"
    figure = new_figure(4.6 * len(drawn), 3.6, note=note)
    for axes, name in zip(figure.subplots(1, len(drawn), squeeze=False)[0], drawn, strict=True):
        _compared(axes, c, name)
    return written(figure, path)


def _compared(axes: Axes, c: Comparison, name: str) -> None:
    unit = "frames" if str(c.settings["budget"]).endswith("frames") else "simulations"
    ends: list[tuple[float, str, str]] = []
    furthest = 0.0
    for place, kernel in enumerate(c.kernels):
        colour, style = COLOURS[place % len(COLOURS)], STYLES[place // len(COLOURS) % len(STYLES)]
        x, mean, error = _mean_curve(c.curve[c.curve["kernel"] == kernel], name, unit)
        if len(x) == 1:
            axes.errorbar(x, mean, error, fmt="o", ms=4, color=colour, capsize=2, lw=1.2)
        else:
            banded(axes, x, mean, error, colour, ls=style)
        ends.append((float(mean[-1]), kernel, colour))
        furthest = max(furthest, float(x[-1]))
    own_error = c.reference_error(name) if name in DISTANCES else None
    if own_error is not None:
        axes.axhspan(0, own_error, color="#eeeeee", lw=0, zorder=0)
        note = "within the distance between the reference's halves"
        axes.text(0.015, 0.02, note, transform=axes.transAxes, color=GREY)
    reference = c.settings["reference"].get("truth", {}).get(name)
    if reference is not None:
        axes.axhline(reference, color=GREY, lw=0.9, ls=(0, (4, 3)), zorder=1)
        ends.append((reference, "reference", GREY))
    titled(axes, *_HEADINGS[name])
    axes.set_xlabel("simulated frames" if unit == "frames" else unit)
    axes.set_xlim(0, furthest * 1.02)
    axes.set_ylim(0, min(1.02, max(axes.get_ylim()[1], 0.05)))
    axes.grid(axis="y")
    direct_labels(axes, ends)


def _mean_curve(
    rows: pd.DataFrame, name: str, unit: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return simulations or frames, mean and standard error, from where all repeats have begun.

    At each number of simulations every run counts with its latest value.
    """
    repeats = [run for _, run in rows.groupby("repeat")]
    runs = [(run[unit].to_numpy(float), run[name].to_numpy(float)) for run in repeats]
    begin, end = max(x[0] for x, _ in runs), max(x[-1] for x, _ in runs)
    at = np.unique(np.linspace(begin, end, _POINTS)) if end > begin else np.array([end])
    values = np.array([y[np.searchsorted(x, at, side="right") - 1] for x, y in runs])
    spread = values.std(axis=0, ddof=1) / np.sqrt(len(runs)) if len(runs) > 1 else 0.0 * at
    return at, values.mean(axis=0), spread


# --- how chains went ------------------------------------------------------------------------------

_BEST: Final = "#d55e00"
_PALE: Final = "#7d93ad"
_MOST_BINS: Final = 20
_MOST_LINES: Final = 60  # rows of a map, at most, that lines keep apart


@figure_of(Posterior)
def diagnostics(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw on one page, 10 inches wide and about 7 high, whether a posterior can be trusted.

    The page shows the verdict, goals per particle and draw (:func:`goal_map`), error per frame
    (:func:`errors`) and acceptance by iteration. ArviZ draws traces and ranks:
    ``az.plot_trace(post.chains)``.
    """
    found = post.diagnostics()
    verdict = textwrap.wrap(found["verdict"], 130)
    title = "\n".join([f"{post.event_id}\n", *verdict])
    figure = new_figure(10, 6.2 + 0.155 * len(verdict), title)
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=(2.9, 2.8))[:, 0]
    _goal_panels(upper, post)
    step_errors, acceptance = lower.subplots(1, 2, width_ratios=(2.4, 1))
    _step_errors(step_errors, post, found)
    _acceptance(acceptance, found["acceptance_by_iteration"])
    return written(figure, path)


@figure_of(Posterior)
def goal_map(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw which goal each particle held at each draw, 10 x 3.2 inches.

    The goals held most have colours of their own, shared by all agents; the rest are grey.
    """
    figure = new_figure(10, 3.2)
    _goal_panels(figure, post)
    return written(figure, path)


@figure_of(Posterior)
def errors(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw how far each particle's last draw is from the observation in every frame, in units.

    The best draw of all is orange. The background is darker where more proposals came from a window
    with that frame. The figure is 7.5 x 3 inches.
    """
    figure = new_figure(7.5, 3)
    _step_errors(figure.subplots(), post, post.diagnostics())
    return written(figure, path)


def _goal_panels(figure: Figure | SubFigure, post: Posterior) -> None:
    """Draw the agents' maps, and what the colours mean to the right of them."""
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Patch

    codes = [array(post.tree, "posterior", name) for name in post.goals_of.values()]
    goals = post.scene.world.goals
    held = np.bincount(np.stack(codes).ravel(), minlength=len(goals))
    order = np.argsort(-held, kind="stable")[: np.count_nonzero(held)]
    room = len(MANY_COLOURS)
    coloured = order if len(order) <= room else order[: room - 1]
    entries = {goals[code]: c for code, c in zip(coloured, MANY_COLOURS, strict=False)}
    table = np.array([to_rgb(entries.get(goal, OTHER)) for goal in goals])
    n_chains, n_draws = codes[0].shape
    panels = figure.subplots(1, len(codes), squeeze=False)[0]
    for axes, agent, of_agent in zip(panels, post.goals_of, codes, strict=True):
        extent = (0.5, n_draws + 0.5, n_chains + 0.5, 0.5)
        axes.imshow(table[of_agent], aspect="auto", interpolation="nearest", extent=extent)
        if n_draws <= _MOST_LINES / 2:
            lines = np.arange(1, n_draws) + 0.5
            axes.vlines(lines, 0.5, n_chains + 0.5, color="white", lw=0.5)
        _whole_ticks(axes.xaxis, n_draws)
        _chain_rows(axes, n_chains)
        axes.set(title=f"Goal of the {agent}", xlabel="draw")
    panels[0].set_ylabel("particle")
    if len(order) > len(coloured):
        entries[f"{len(order) - len(coloured)} other goals"] = OTHER
    figure.legend(
        [Patch(facecolor=colour) for colour in entries.values()], entries,
        loc="outside right upper", handlelength=1.1, handleheight=1.1, labelspacing=0.35,
    )  # fmt: skip


def _step_errors(axes: Axes, post: Posterior, found: dict[str, Any]) -> None:
    """Draw the error per frame of the last draws and of the best, and where windows were."""
    from matplotlib.colors import LinearSegmentedColormap

    error = array(post.tree, "sample_stats", "step_error")
    time = array(post.tree, "observed_data", "time")
    total = array(post.tree, "sample_stats", "total_error")
    best = np.unravel_index(np.argmin(total), total.shape)
    axes.plot(time, error[:, -1].T, color=_PALE, lw=0.8, alpha=0.7)
    axes.plot(time, error[best], color=_BEST, lw=1.7)
    top = 1.06 * max(float(error[:, -1].max()), float(error[best].max()), 1e-3)
    note = "grey: each particle's last draw; orange: the best draw"
    windows, coverage = found["windows"], np.zeros(len(time))
    for start, count in zip(windows["starts"], windows["counts"], strict=True):
        coverage[start : start + (windows["frames"] or 1)] += count
    coverage /= max(windows["proposals"], 1)
    if coverage.any():
        note += "; shaded: where the windows of proposals were"
        step = time[1] - time[0]
        shade = LinearSegmentedColormap.from_list("windows", ["#ffffff", "#f2d9a8"])
        axes.imshow(
            coverage[None], cmap=shade, vmin=0, vmax=coverage.max(), aspect="auto", zorder=0,
            interpolation="nearest", extent=(time[0] - step / 2, time[-1] + step / 2, 0, top),
        )  # fmt: skip
    axes.set_ylim(0, top)
    axes.set_xlim(time[0], time[-1])
    titled(axes, "Error per frame [units]", note)
    axes.set_xlabel(SIMULATED_TIME)


def _acceptance(axes: Axes, rates: list[float]) -> None:
    """Draw the share of particles that accepted, per iteration or, of many, per stretch."""
    stretches = np.array_split(np.array(rates), min(len(rates), _MOST_BINS))
    sizes, means = [len(part) for part in stretches], [part.mean() for part in stretches]
    starts = np.cumsum([0, *sizes[:-1]]) + 0.5
    axes.bar(starts, means, np.array(sizes) * 0.86, align="edge", color=_PALE, zorder=2)
    axes.axhline(float(np.mean(rates)), color=INK, lw=0.9, ls=(0, (4, 3)), zorder=3)
    axes.set_xlim(0.4, len(rates) + 0.6)
    axes.set_xlabel("iteration")
    _whole_ticks(axes.xaxis, len(rates))
    in_shares(axes)
    titled(axes, "Proposals accepted", f"share of particles; dashed: mean, {np.mean(rates):.0%}")


def _whole_ticks(axis: Axis, n: int) -> None:
    """Mark whole numbers from 1 to ``n``, at most seven."""
    step = next(s for p in range(9) for s in (10**p, 2 * 10**p, 5 * 10**p) if n / s <= 7)
    axis.set_ticks(sorted({1, *range(step, n + 1, step)}))


def _chain_rows(axes: Axes, n: int) -> None:
    """Mark the rows of ``n`` chains, with lines between them where there is room."""
    if n <= _MOST_LINES:
        axes.hlines(np.arange(1, n) + 0.5, *axes.get_xlim(), color="white", lw=0.7)
    _whole_ticks(axes.yaxis, n)
    axes.spines[:].set_visible(False)


# --- a set of events ------------------------------------------------------------------------------

_PANELS: Final = {
    "Relation, scenario": ("relation", "scenario"),
    "Goals of agents, by type": ("goal_type",),
    "Strength [N], sizes": ("strength", "agent_size", "item_size"),
    "Time, and events": ("agent_rests", "agent_holds", "item_moves", "moves_to_the_end"),
    "How they were made": ("family", "reflection", "split"),
}
_WORDS: Final = {
    ("goal_type", "LMO+"): "item to landmark", ("goal_type", "LMO-"): "item from landmark",
    ("goal_type", "LMA+"): "agent to landmark", ("goal_type", "LMA-"): "agent from landmark",
    ("goal_type", "TE+"): "to other agent", ("goal_type", "TE-"): "from other agent",
    ("agent_rests", "mean"): "agent rests", ("agent_holds", "mean"): "agent holds item",
    ("item_moves", "mean"): "item moves", ("moves_to_the_end", "mean"): "moves to the end",
}  # fmt: skip
_PREFIXES: Final = {"agent_size": "agent ", "item_size": "item "}
_LONGEST: Final = 22  # characters of a label at most


@in_style
def data_card(statistics: pd.DataFrame, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the main shares of :func:`phase_ppl.statistics`, with their errors, as pairs of bars.

    The second bar, in grey, is the share in PHASE's original events, where it is known. The figure
    is 12 inches wide.
    """
    of = statistics.index.get_level_values("quantity")
    panels = {title: [n for n in names if n in of] for title, names in _PANELS.items()}
    panels = {title: names for title, names in panels.items() if names}
    events = statistics.attrs.get("events")
    title = "" if events is None else f"{events} event{'s' * (events != 1)}"
    figure = new_figure(12.0, 3.6, title, "bars: standard errors over events; in grey: PHASE")
    drawn = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (heading, names) in zip(drawn, panels.items(), strict=True):
        rows = pd.concat([statistics.loc[[name]] for name in names])
        start = rows.index.get_level_values("quantity")
        # quantities stand apart
        places = np.arange(len(rows)) + 0.7 * np.cumsum(np.r_[False, start[1:] != start[:-1]])
        axes.barh(places - 0.2, rows["value"], 0.4, xerr=rows["error"], color=COLOURS[0],
                  error_kw={"elinewidth": 0.8})  # fmt: skip
        axes.barh(places + 0.2, rows["phase"], 0.4, color="#b4b4b4")
        words = [_WORDS.get(one, _PREFIXES.get(one[0], "") + one[1]) for one in rows.index]
        axes.set_yticks(places, [name[:_LONGEST] for name in words])
        axes.set(title=heading, ylim=(places[-1] + 0.6, -0.6))
        axes.set_xlim(left=0)
        axes.locator_params(axis="x", nbins=4)
        axes.tick_params(axis="y", length=0)
    return written(figure, path)
