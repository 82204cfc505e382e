"""Figures of how the chains went."""

from __future__ import annotations

import os
import textwrap
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.diagnostics import scalars
from phase_ppl.analysis.figures.style import (
    COLOURS,
    GREY,
    INK,
    MANY_COLOURS,
    OTHER,
    SIMULATED_TIME,
    figure_of,
    in_shares,
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


NAMES: Final = {"log_joint": "log joint", "total_error": "total error [units]"}
"""Scalar -> title of its panel, beside strengths."""

_BEST: Final = "#d55e00"
_PALE: Final = "#7d93ad"
_MOST_BINS: Final = 20
_MOST_LINES: Final = 60  # rows of a map, at most, that lines keep apart


@figure_of(Posterior)
def diagnostics(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw on one page, 10 inches wide and about 11 high, whether a posterior can be trusted.

    The verdict; goals per particle and draw (:func:`goal_map`); trace and ranks of log joint,
    total error and strengths (:func:`chains`); error per frame (:func:`errors`); acceptance.
    """
    found = post.diagnostics()
    verdict = textwrap.wrap(found["verdict"], 130)
    title = "\n".join([f"{post.event_id}\n", *verdict])
    figure = new_figure(10, 10.5 + 0.155 * len(verdict), title)
    upper, middle, lower = figure.subfigures(3, 1, squeeze=False, height_ratios=(2.9, 4, 2.8))[:, 0]
    _goal_panels(upper, post)
    _traces(middle, post, [*NAMES, *post.strengths_of.values()], 2)
    step_errors, acceptance = lower.subplots(1, 2, width_ratios=(2.4, 1))
    _step_errors(step_errors, post, found)
    _acceptance(acceptance, found["acceptance_by_iteration"])
    return written(figure, path)


@figure_of(Posterior)
def goal_map(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw which goal each particle held at each draw, in shared colours, 10 x 3.2 inches.

    The goals held most have colours of their own; the rest are grey.
    """
    figure = new_figure(10, 3.2)
    _goal_panels(figure, post)
    return written(figure, path)


@figure_of(Posterior)
def chains(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw traces of the real quantities, and where each particle's draws rank among all.

    Real sites of the user's own are drawn as well; 8 inches wide, 1.75 high for each quantity.
    Orange is the particle with the best draw. In the panels of ranks, a row is a particle: where
    chains have mixed all cells are pale; blue cells have fewer draws than expected, orange more.
    """
    names = list(scalars(post.tree))
    figure = new_figure(8, 1.75 * len(names) + 0.4)
    _traces(figure, post, names, 1)
    return written(figure, path)


@figure_of(Posterior)
def errors(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw how far each particle's last draw is from the observation in every frame.

    Orange is the best draw of all. The background is the darker, the more proposals came from a
    window with that frame; 7.5 x 3 inches.
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


def _traces(figure: Figure | SubFigure, post: Posterior, names: list[str], columns: int) -> None:
    """Draw traces and ranks of quantities, so many beside each other, and what colours mean."""
    values, log_joint = scalars(post.tree), array(post.tree, "sample_stats", "log_joint")
    best, few = int(np.nanargmax(log_joint.max(axis=1))), len(log_joint) <= len(COLOURS)
    ratios, rows = (2.1 if columns > 1 else 2.2, 1) * columns, -(-len(names) // columns)
    panels = figure.subplots(rows, 2 * columns, width_ratios=ratios, squeeze=False).reshape(-1, 2)
    for axes in panels[len(names) :].ravel():
        axes.set_axis_off()
    for (trace, ranks), name in zip(panels, names, strict=False):
        numbers = values[name]
        n = numbers.shape[1]
        for chain in [*(c for c in range(len(numbers)) if c != best), best]:
            leads = chain == best and not few
            style: dict[str, Any] = {
                "color": COLOURS[chain] if few else _BEST if leads else _PALE,
                "lw": 0.6 if n > _MOST_LINES else 1.5 if leads else 0.8,
                "alpha": 0.85 if few or leads else 0.6,
            }
            trace.plot(np.arange(1, n + 1), numbers[chain], "o" if n == 1 else "-", ms=3, **style)
        trace.set_xlim(*((0.5, 1.5) if n == 1 else (1, n)))
        _whole_ticks(trace.xaxis, n)
        trace.locator_params(axis="y", nbins=4)
        agent = name.removeprefix("strength_")
        title = NAMES.get(name, name) if agent == name else f"strength of {agent} [N]"
        trace.set(title=title, xlabel="draw")
        _ranks(ranks, numbers)
    lines = "a colour for each particle" if few else "orange line: the particle with the best draw"
    note = f"{lines}; ranks: orange where a particle has more draws than expected, blue where fewer"
    figure.supxlabel(note, x=0.012, ha="left", color=GREY)


def _ranks(axes: Axes, values: FloatArray) -> None:
    """Draw per chain where its draws rank among all: counts over what is expected."""
    from matplotlib.colors import LinearSegmentedColormap

    n_chains, n_draws = values.shape
    bins = int(np.clip(n_draws // 2, 2, _MOST_BINS))
    order = values.ravel().argsort(kind="stable").argsort().reshape(values.shape)
    place = order * bins // values.size
    counts = np.stack([np.bincount(row, minlength=bins) for row in place])
    colours = LinearSegmentedColormap.from_list("ranks", ["#4f8fc0", "#f4f4f2", "#e08a3c"])
    # beyond twice what is expected all is equally too much
    axes.imshow(
        counts * bins / n_draws, cmap=colours, vmin=0, vmax=2, aspect="auto",
        interpolation="nearest", extent=(0, 1, n_chains + 0.5, 0.5),
    )  # fmt: skip
    axes.set_xticks([0, 1], ["lowest", "highest"])
    for label, side in zip(axes.get_xticklabels(), ("left", "right"), strict=True):
        label.set(ha=side)
    axes.set_title("ranks, per particle")
    _chain_rows(axes, n_chains)
    axes.tick_params(length=0)


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
