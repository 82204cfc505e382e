"""The panels that figures of how the chains went are made of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.style import COLOURS, INK, MANY_COLOURS, NORMAL, OTHER, SMALL, bare
from phase_ppl.analysis.tree import array
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.goals import GOALS, N_GOALS
from phase_ppl.world.names import AGENTS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
