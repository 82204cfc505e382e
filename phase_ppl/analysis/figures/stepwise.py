"""The figure of a posterior over time, in hindsight."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

import numpy as np
import xarray as xr

from phase_ppl.analysis.figures.style import (
    INK,
    MANY_COLOURS,
    NORMAL,
    OTHER,
    SMALL,
    bare,
    direct_labels,
    new_figure,
    written,
)
from phase_ppl.world.hypothesis import RELATIONS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phase_ppl.analysis.posterior import Posterior
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from typing import TYPE_CHECKING

from phase_ppl.render.frames import Painter, panel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior


PANELS: Final = {
    "goal_red": "Goal of the red agent",
    "goal_green": "Goal of the green agent",
    "relation": "Relation",
}
"""Quantity -> title of its panel."""

_LINES: Final = 5
"""Lines of a panel; what else there is, is one more."""

_SEEN: Final = 0.1
"""Probability that a goal must reach at some time to have a line."""

_RELATION_COLOURS: Final = dict(zip(RELATIONS, ("#009e73", "#666666", "#d55e00"), strict=True))
_LINE_HEIGHT: Final = 0.095
"""Of a label, as a share of a panel's height."""

_NOTES: Final = {
    "hindsight": "Hindsight, not belief at the time: hypotheses proposed from the whole video, "
    "weighted by how well they explain it up to each frame.",
    "filtering": "What can be believed at each frame from the frames so far.",
}


def over_time(
    post: Posterior | StepwisePosterior, path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw how the probabilities of goals and relation grow out of the video.

    In hindsight, or as they could be believed at the time: see ``over_time`` of the posterior.
    Both agents' goals share their colours.

    Args:
        post: what to draw.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure of 7.5 x 6.6 inches.

    Raises:
        InvalidEventError, InvalidSettingError: there is no such posterior over time.
        OutputError: the figure cannot be written there, or the ending is another.
    """
    found = post.over_time()
    figure = new_figure(7.5, 6.6)
    grid = figure.add_gridspec(
        3, 1, left=0.075, right=0.66, top=0.895, bottom=0.07, hspace=0.34, height_ratios=(5, 5, 4)
    )
    figure.text(0.012, 0.985, post.event_id, va="top", fontsize=10, color=INK)
    note = next(words for kind, words in _NOTES.items() if kind in found.attrs)
    figure.text(0.012, 0.955, note, va="top", fontsize=SMALL + 0.3, color="#666666")
    shown = {name: _leading(found[name]) for name in ("goal_red", "goal_green")}
    goals = list(dict.fromkeys(goal for goals in shown.values() for goal in goals))
    colours = dict(zip(goals, MANY_COLOURS, strict=False))
    colours |= _RELATION_COLOURS
    shown["relation"] = list(_RELATION_COLOURS)
    for place, (name, title) in enumerate(PANELS.items()):
        axes = figure.add_subplot(grid[place])
        _panel(axes, found[name], shown[name], colours)
        axes.set_title(title, fontsize=NORMAL + 1, loc="left", color=INK)
        if place == len(PANELS) - 1:
            axes.set_xlabel("time [s]", fontsize=NORMAL, color=INK)
        else:
            axes.tick_params(labelbottom=False)
    return written(figure, path)


def _leading(marginal: xr.DataArray) -> list[str]:
    """Return the labels that are ever probable, the highest at any time first, at most five."""
    peak = marginal.max("time").values
    order = np.argsort(-peak, kind="stable")[:_LINES]
    labels = marginal[f"{marginal.name}_is"].values
    return [str(labels[i]) for i in order if peak[i] >= _SEEN]


def _panel(axes: Axes, marginal: xr.DataArray, labels: list[str], colours: dict[str, str]) -> None:
    dim = f"{marginal.name}_is"
    time = marginal["time"].values
    ends = []
    for label in labels:
        values = marginal.sel({dim: label}).values
        axes.plot(time, values, color=colours[label], lw=1.8, solid_capstyle="round", zorder=3)
        ends.append((float(time[-1]), float(values[-1]), label, colours[label]))
    rest = np.clip(1 - marginal.sel({dim: labels}).sum(dim).values, 0, 1)
    if rest.max() >= _SEEN / 2:
        axes.fill_between(time, rest, color=OTHER, alpha=0.6, lw=0, zorder=1)
        ends.append((float(time[-1]), float(rest[-1]), "all other goals", "#777777"))
    axes.set_xlim(time[0], time[-1])
    axes.set_ylim(0, 1.02)
    axes.set_yticks([0, 0.5, 1], ["0", "0.5", "1"])
    axes.grid(axis="y", color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    bare(axes)
    direct_labels(axes, ends, gap=_LINE_HEIGHT)


# --- the figure of which frames speak for one thing over another ----------------------------------

_STILLS: Final = 5
_FOR, _AGAINST = "#009e73", "#d55e00"
_APART: Final = 4
"""Frames between two stills, at least."""


def why(
    post: StepwisePosterior,
    event: str,
    over: str | None = None,
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the log odds of ``event`` over ``over`` by frame, and the frames that decided.

    See :meth:`phase_ppl.analysis.stepwise_posterior.StepwisePosterior.why`.

    Args:
        post: what was read.
        event, over: as there.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure of 8 x 5.6 inches.

    Raises:
        QueryError, InvalidSettingError, OutputError: as there; or it cannot be written.
    """
    found = post.why(event, over)
    time, change = found["time"].values, found["change"].values
    figure = new_figure(8, 5.6)
    grid = figure.add_gridspec(
        2, 1, left=0.085, right=0.985, top=0.86, bottom=0.39, hspace=0.16, height_ratios=(3, 2)
    )
    title = f"{found.attrs['event']}  over  {found.attrs['over']}"
    figure.text(0.012, 0.985, post.event_id, va="top", fontsize=10, color=INK)
    figure.text(0.012, 0.945, title, va="top", fontsize=NORMAL + 0.5, color=INK)
    axes = figure.add_subplot(grid[0])
    axes.axhline(0, color="#999999", lw=0.8)
    axes.plot(time, found["log_odds"].values, color=INK, lw=1.8)
    axes.set_ylabel("log odds [nats]", fontsize=NORMAL)
    axes.tick_params(labelbottom=False, labelsize=SMALL)
    bare(axes)
    below = figure.add_subplot(grid[1], sharex=axes)
    width = float(time[1] - time[0]) if len(time) > 1 else 1.0
    colours = [_FOR if step > 0 else _AGAINST for step in change]
    below.bar(time, change, width=width, color=colours)
    below.axhline(0, color="#999999", lw=0.8)
    below.set_ylabel("change by\neach frame", fontsize=NORMAL)
    below.set_xlabel("time [s]", fontsize=NORMAL, labelpad=1)
    below.tick_params(labelsize=SMALL)
    below.set_xlim(time[0] - width, time[-1] + width)
    bare(below)
    painter, poses = Painter(post.scene), post.observed()
    for place, frame in enumerate(_deciding(change)):
        still = figure.add_axes((0.012 + place * 0.197, 0.005, 0.187, 0.285))
        still.imshow(np.asarray(panel(painter.draw(poses[frame]))))
        still.set_axis_off()
        still.set_title(
            f"{time[frame]:.1f} s: {change[frame]:+.2f}",
            fontsize=NORMAL,
            color=_FOR if change[frame] > 0 else _AGAINST,
            pad=2,
        )
        below.axvline(time[frame], color="#bbbbbb", lw=0.7, ls=":", zorder=0)
        axes.axvline(time[frame], color="#bbbbbb", lw=0.7, ls=":", zorder=0)
    return written(figure, path)


def _deciding(change: np.ndarray) -> list[int]:
    """Return the frames of the greatest changes, not too near each other, in their order."""
    chosen: list[int] = []
    for frame in np.argsort(-np.abs(change), kind="stable"):
        if all(abs(int(frame) - other) >= _APART for other in chosen):
            chosen.append(int(frame))
        if len(chosen) == _STILLS:
            break
    return sorted(chosen)
