"""The panels that figures of how the chains went are made of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.figures.style import COLOURS, INK, MANY_COLOURS, NORMAL, OTHER, SMALL, bare
from phase_ppl.analysis.tree import array
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.goals import GOALS, N_GOALS
from phase_ppl.world.names import AGENTS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phase_ppl.analysis.posterior import Posterior
import os
import textwrap
from typing import TYPE_CHECKING

from phase_ppl.analysis.diagnostics import scalars
from phase_ppl.analysis.figures.style import new_figure, written

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec

    from phase_ppl.analysis.posterior import Posterior


NAMES: Final = {
    "log_joint": "log joint",
    "total_error": "total error [units]",
    "strength_red": "strength of red [N]",
    "strength_green": "strength of green [N]",
}
"""Scalar -> title of its panel."""

_GOALS: Final = dict(zip(("goal_red", "goal_green"), AGENTS, strict=True))
_BEST: Final = "#d55e00"
_PALE: Final = "#7d93ad"
_MOST_BINS: Final = 20
_FEW: Final = len(COLOURS)
"""Chains that have a colour each."""


def goal_panels(figure: Figure, panels: list[Axes], post: Posterior, right: float) -> None:
    """Draw the two agents' maps, and what the colours mean from ``right`` on."""
    codes = {name: array(post.tree, "posterior", name) for name in _GOALS}
    held = np.bincount(np.stack(list(codes.values())).ravel(), minlength=N_GOALS)
    order = np.argsort(-held, kind="stable")[: np.count_nonzero(held)]
    room = len(MANY_COLOURS)
    coloured = order if len(order) <= room else order[: room - 1]
    for axes, (name, agent) in zip(panels, _GOALS.items(), strict=True):
        _goal_panel(axes, codes[name], coloured)
        axes.set_title(f"Goal of the {agent}", fontsize=NORMAL + 1, loc="left", color=INK)
    panels[0].set_ylabel("particle", fontsize=NORMAL, color=INK)
    entries = [(GOALS[code], colour) for code, colour in zip(coloured, MANY_COLOURS, strict=False)]
    if len(order) > len(coloured):
        entries.append((f"{len(order) - len(coloured)} other goals", OTHER))
    _legend(figure, panels[-1], entries, right)


def _goal_panel(axes: Axes, codes: NDArray[Any], coloured: NDArray[np.int64]) -> None:
    from matplotlib.colors import to_rgb

    table = np.tile(to_rgb(OTHER), (N_GOALS, 1))
    for code, colour in zip(coloured, MANY_COLOURS, strict=False):
        table[code] = to_rgb(colour)
    n_chains, n_draws = codes.shape
    extent = (0.5, n_draws + 0.5, n_chains + 0.5, 0.5)
    axes.imshow(table[codes], aspect="auto", interpolation="nearest", extent=extent)
    if n_chains <= 60:
        for line in range(1, n_chains):
            axes.axhline(line + 0.5, color="white", lw=0.8)
    if n_draws <= 30:
        for line in range(1, n_draws):
            axes.axvline(line + 0.5, color="white", lw=0.5)
    _whole_ticks(axes, n_draws)
    _chain_ticks(axes, n_chains)
    axes.set_xlabel("draw", fontsize=NORMAL, color=INK, labelpad=2)
    bare(axes, "left", "bottom")


def _legend(figure: Figure, beside: Axes, entries: list[tuple[str, str]], left: float) -> None:
    from matplotlib.patches import Patch

    figure.legend(
        [Patch(facecolor=colour) for _, colour in entries],
        [label for label, _ in entries],
        loc="upper left",
        bbox_to_anchor=(left, beside.get_position().y1 + 0.01),
        frameon=False,
        fontsize=SMALL + 0.5,
        labelcolor=INK,
        handlelength=1.1,
        handleheight=1.1,
        labelspacing=0.35,
        borderpad=0,
    )


def trace(axes: Axes, values: FloatArray, best: int, name: str) -> None:
    """Draw (chain, draw) numbers, a line per chain; many chains pale, but for the best."""
    draws = np.arange(1, values.shape[1] + 1)
    marker = "o" if len(draws) == 1 else ""
    few = len(values) <= _FEW
    order = [*(c for c in range(len(values)) if c != best), best]
    for chain in order:
        colour = COLOURS[chain] if few else _BEST if chain == best else _PALE
        width = 1.5 if chain == best and not few else 0.8
        axes.plot(
            draws, values[chain], color=colour, lw=width if len(draws) <= 60 else 0.6,
            marker=marker, ms=3, alpha=0.85 if few or chain == best else 0.6,
        )  # fmt: skip
    axes.set_xlim(*((0.5, 1.5) if len(draws) == 1 else (1, len(draws))))
    _whole_ticks(axes, len(draws))
    axes.set_title(NAMES.get(name, name), fontsize=NORMAL, loc="left", color=INK, pad=3)
    axes.set_xlabel("draw", fontsize=SMALL + 0.5, color=INK, labelpad=1)
    axes.locator_params(axis="y", nbins=4)
    bare(axes)


def ranks(axes: Axes, values: FloatArray) -> None:
    """Draw per chain where its draws rank among all: counts over what is expected."""
    from matplotlib.colors import LinearSegmentedColormap

    n_chains, n_draws = values.shape
    bins = int(np.clip(n_draws // 2, 2, _MOST_BINS))
    order = np.empty(values.size, int)
    order[np.argsort(values, axis=None, kind="stable")] = np.arange(values.size)
    place = order.reshape(values.shape) * bins // values.size
    counts = np.stack([np.bincount(row, minlength=bins) for row in place])
    colours = LinearSegmentedColormap.from_list("ranks", ["#4f8fc0", "#f4f4f2", "#e08a3c"])
    # beyond twice what is expected all is equally too much
    axes.imshow(
        counts * bins / n_draws, cmap=colours, vmin=0, vmax=2, aspect="auto",
        interpolation="nearest", extent=(0, 1, n_chains + 0.5, 0.5),
    )  # fmt: skip
    for line in range(1, n_chains if n_chains <= 60 else 0):
        axes.axhline(line + 0.5, color="white", lw=0.5)
    axes.set_xticks([0, 1], ["lowest", "highest"])
    lowest, highest = axes.get_xticklabels()
    lowest.set_horizontalalignment("left")
    highest.set_horizontalalignment("right")
    _chain_ticks(axes, n_chains)
    axes.set_title("ranks, per particle", fontsize=NORMAL, loc="left", color=INK, pad=3)
    bare(axes, "left", "bottom")
    axes.tick_params(length=0)


def step_errors(axes: Axes, post: Posterior, found: dict[str, Any]) -> None:
    """Draw the error per frame of the last draws and of the best, and where windows were."""
    from matplotlib.colors import LinearSegmentedColormap

    error = array(post.tree, "sample_stats", "step_error")
    time = array(post.tree, "observed_data", "time")
    total = array(post.tree, "sample_stats", "total_error")
    best = np.unravel_index(np.argmin(total), total.shape)
    axes.plot(time, error[:, -1].T, color=_PALE, lw=0.8, alpha=0.7)
    axes.plot(time, error[best], color=_BEST, lw=1.7)
    top = 1.06 * max(float(error[:, -1].max()), float(error[best].max()), 1e-3)
    axes.set_ylim(0, top)
    axes.set_xlim(time[0], time[-1])
    coverage = _coverage(found["windows"], len(time))
    if coverage.any():
        step = time[1] - time[0]
        shade = LinearSegmentedColormap.from_list("windows", ["#ffffff", "#f2d9a8"])
        axes.imshow(
            coverage[None], cmap=shade, vmin=0, vmax=coverage.max(), aspect="auto", zorder=0,
            interpolation="nearest", extent=(time[0] - step / 2, time[-1] + step / 2, 0, top),
        )  # fmt: skip
        axes.set_xlim(time[0], time[-1])
    note = "grey: each particle's last draw; orange: the best draw"
    note += "; shaded: where the windows of proposals were" if coverage.any() else ""
    axes.set_title("Error per frame [units]", fontsize=NORMAL + 1, loc="left", color=INK, pad=14)
    axes.text(0, 1.02, note, transform=axes.transAxes, fontsize=SMALL, color="#666666")
    axes.set_xlabel("time [s]", fontsize=NORMAL, color=INK)
    bare(axes)


def _coverage(windows: dict[str, Any], n_frames: int) -> FloatArray:
    """Return (time,) the share of proposals whose window has the frame."""
    coverage = np.zeros(n_frames)
    if not windows["proposals"]:
        return coverage
    for start, count in zip(windows["starts"], windows["counts"], strict=True):
        coverage[start : start + (windows["frames"] or 1)] += count
    return coverage / windows["proposals"]


def acceptance(axes: Axes, rates: list[float]) -> None:
    """Draw the share of particles that accepted, per iteration or, of many, per stretch."""
    stretches = np.array_split(np.array(rates), min(len(rates), _MOST_BINS))
    starts = np.cumsum([0, *(len(part) for part in stretches)])
    means = [float(part.mean()) for part in stretches]
    axes.bar(starts[:-1] + 0.5, means, np.diff(starts) * 0.86, align="edge", color=_PALE, zorder=2)
    axes.axhline(float(np.mean(rates)), color=INK, lw=0.9, ls=(0, (4, 3)), zorder=3)
    axes.set_xlim(0.4, len(rates) + 0.6)
    _whole_ticks(axes, len(rates))
    axes.set_ylim(0, 1)
    axes.set_yticks([0, 0.5, 1], ["0", "0.5", "1"])
    axes.set_xlabel("iteration", fontsize=NORMAL, color=INK)
    axes.set_title("Proposals accepted", fontsize=NORMAL + 1, loc="left", color=INK, pad=14)
    note = f"share of particles; dashed: mean, {np.mean(rates):.0%}"
    axes.text(0, 1.02, note, transform=axes.transAxes, fontsize=SMALL, color="#666666")
    bare(axes)


def chains_note(post: Posterior) -> str:
    """Return what the colours of traces and ranks mean."""
    note = "ranks: orange where a particle has more draws than expected, blue where fewer"
    if len(array(post.tree, "sample_stats", "log_joint")) <= _FEW:
        return f"a colour for each particle; {note}"
    return f"orange line: the particle with the best draw; {note}"


def best_chain(post: Posterior) -> int:
    """Return the chain with the best draw."""
    return int(np.nanargmax(array(post.tree, "sample_stats", "log_joint").max(axis=1)))


def _whole_ticks(axes: Axes, n: int) -> None:
    """Mark whole numbers from 1 to ``n``, at most seven."""
    step = next(s for p in range(9) for s in (10**p, 2 * 10**p, 5 * 10**p) if n / s <= 7)
    axes.set_xticks(sorted({1, *range(step, n + 1, step)}))


def _chain_ticks(axes: Axes, n: int) -> None:
    marked = range(1, n + 1) if n <= 5 else [1, *range(5, n + 1, 5 * -(-n // 25))]
    axes.set_yticks(list(marked))


# --- figures of how the chains went ---------------------------------------------------------------

_PAGE: Final = 10.25
"""Height of the page below the verdict, inches."""


def diagnostics(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw on one page whether a posterior can be trusted.

    The verdict; goals per particle and draw (:func:`goal_map`); trace and ranks of log joint,
    total error and strengths (:func:`chains`); error per frame (:func:`errors`); acceptance.

    Args:
        post: what to draw.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure, 10 inches wide, about 11 high: the verdict decides.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    found = post.diagnostics()
    verdict = textwrap.wrap(found["verdict"], 150)
    height = _PAGE + 0.5 + 0.155 * len(verdict)
    figure = new_figure(10, height)
    figure.text(0.012, 1 - 0.12 / height, post.event_id, va="top", fontsize=10, color=INK)
    figure.text(
        0.012, 1 - 0.34 / height, "\n".join(verdict), va="top", fontsize=NORMAL, color=INK,
        linespacing=1.3,
    )  # fmt: skip

    def grid(rows: int, columns: int, bottom: float, top: float, **options: Any) -> GridSpec:
        return figure.add_gridspec(
            rows, columns, left=0.06, bottom=bottom / height, top=top / height, **options
        )

    goals = grid(1, 2, 7.65, 10.05, right=0.715, wspace=0.16)
    goal_panels(figure, [figure.add_subplot(goals[i]) for i in range(2)], post, 0.735)
    figure.text(0.06, 7.1 / height, chains_note(post), fontsize=SMALL, color="#666666")
    middle = grid(
        2, 4, 3.55, 6.88, right=0.985, hspace=0.5, wspace=0.28, width_ratios=(2.1, 1, 2.1, 1)
    )
    values = scalars(post.tree)
    for place, name in enumerate(NAMES):
        row, column = divmod(place, 2)
        trace(figure.add_subplot(middle[row, 2 * column]), values[name], best_chain(post), name)
        ranks(figure.add_subplot(middle[row, 2 * column + 1]), values[name])
    low = grid(1, 2, 0.5, 2.75, right=0.985, wspace=0.16, width_ratios=(2.4, 1))
    step_errors(figure.add_subplot(low[0]), post, found)
    acceptance(figure.add_subplot(low[1]), found["acceptance_by_iteration"])
    return written(figure, path)


def goal_map(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw which goal each particle held at each draw, for both agents, in shared colours.

    The goals held most have colours of their own; the rest are grey.

    Args:
        post: what to draw.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure of 10 x 3.2 inches.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    figure = new_figure(10, 3.2)
    grid = figure.add_gridspec(1, 2, left=0.055, right=0.715, top=0.89, bottom=0.14, wspace=0.16)
    goal_panels(figure, [figure.add_subplot(grid[i]) for i in range(2)], post, 0.735)
    return written(figure, path)


def chains(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw traces of the real quantities, and where each particle's draws rank among all.

    Orange is the particle with the best draw. In the panels of ranks, a row is a particle: where
    chains have mixed all cells are pale; blue cells have fewer draws than expected, orange more.

    Args:
        post: what to draw; real sites of the user's own are drawn as well.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure, 8 inches wide, 1.75 high for each quantity.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    values = scalars(post.tree)
    height = 1.75 * len(values) + 0.4
    figure = new_figure(8, height)
    grid = figure.add_gridspec(
        len(values), 2, left=0.085, right=0.985, top=1 - 0.28 / height, bottom=0.65 / height,
        hspace=0.5, wspace=0.14, width_ratios=(2.2, 1),
    )  # fmt: skip
    note = chains_note(post)
    figure.text(0.085, 0.09 / height, note, fontsize=SMALL, color="#666666")
    for row, (name, numbers) in enumerate(values.items()):
        trace(figure.add_subplot(grid[row, 0]), numbers, best_chain(post), name)
        ranks(figure.add_subplot(grid[row, 1]), numbers)
    return written(figure, path)


def errors(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw how far each particle's last draw is from the observation in every frame.

    Orange is the best draw of all. The background is the darker, the more proposals came from a
    window with that frame.

    Args:
        post: what to draw.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure of 7.5 x 3 inches.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    figure = new_figure(7.5, 3)
    axes = figure.add_axes((0.075, 0.155, 0.91, 0.7))
    step_errors(axes, post, post.diagnostics())
    return written(figure, path)
