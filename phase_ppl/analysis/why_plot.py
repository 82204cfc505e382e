"""The figure of which frames speak for one thing over another."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

import numpy as np

from phase_ppl.analysis.style import INK, NORMAL, SMALL, bare, new_figure, written
from phase_ppl.render.frames import Painter
from phase_ppl.render.panels import panel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

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
