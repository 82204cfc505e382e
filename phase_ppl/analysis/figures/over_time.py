"""Figures of a posterior over time, and of which frames speak for one thing over another."""

from __future__ import annotations

import functools
import itertools
import os
from typing import TYPE_CHECKING, Final

import numpy as np
import xarray as xr
from PIL import Image

from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.figures.posterior import RELATION_COLOUR, bars, line_colour, titles
from phase_ppl.analysis.figures.style import (
    COLOURS,
    GREY,
    INK,
    MANY_COLOURS,
    NORMAL,
    OTHER,
    SIMULATED_TIME,
    banded,
    direct_labels,
    figure_of,
    in_shares,
    new_figure,
    written,
)
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.render.frames import PANEL, Painter, between_frames, panel, side_by_side
from phase_ppl.render.video import FRAMES_PER_STEP, Film, film
from phase_ppl.world.hypothesis import RELATIONS

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINES: Final = 5  # lines of a panel; what else there is, is one more
_SEEN: Final = 0.1  # probability that a goal must reach at some time to have a line
_RELATION_COLOURS: Final = dict(zip(RELATIONS, ("#009e73", GREY, "#d55e00"), strict=True))
_LINE_HEIGHT: Final = 0.095  # of a label, as a share of a panel's height

_NOTES: Final = {
    "hindsight": "Hindsight, not belief at the time: hypotheses proposed from the whole video, "
    "weighted by how well they explain it up to each frame.",
    "filtering": "What can be believed at each frame from the frames so far.",
}

_STILLS: Final = 5
_APART: Final = 4  # frames between two stills, at least


@figure_of(Posterior, ClosedLoopPosterior)
def over_time(
    post: Posterior | ClosedLoopPosterior, path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw how the probabilities of goals and relation change along the video.

    For a sampled posterior they are in hindsight, for the closed loop's as they could be believed
    at the time (``post.over_time()``). All agents' goals share their colours. Bands are 1.96 errors
    wide on either side, if errors are known. The figure is 7.5 x 6.6 inches, and higher with more
    than two agents.

    Raises:
        InvalidEventError, InvalidSettingError: the posterior cannot be given over time.
    """
    found = post.over_time()
    n_panels = len(post.goals_of) + len(post.relations_of)
    note = next(words for kind, words in _NOTES.items() if kind in found.attrs)
    figure = new_figure(7.5, 2.2 * max(n_panels, 2), post.event_id, note)
    shown = {name: _leading(found[name], _LINES, _SEEN) for name in post.goals_of.values()}
    goals = list(dict.fromkeys(goal for goals in shown.values() for goal in goals))
    # of more goals than colours some share theirs: labels stand beside the lines
    colours = dict(zip(goals, itertools.cycle(MANY_COLOURS), strict=False)) | _RELATION_COLOURS
    shown |= {key: list(_RELATION_COLOURS) for key in post.relations_of.values()}
    heights = [5] * len(post.goals_of) + [4] * len(post.relations_of)
    rows = figure.subplots(len(heights), 1, squeeze=False, sharex=True, height_ratios=heights)
    for axes, (name, title) in zip(rows[:, 0], titles(post).items(), strict=True):
        axes.set_title(title)
        _panel(axes, found[name], found.get(f"{name}_error"), shown[name], colours)
    rows[-1, 0].set_xlabel(SIMULATED_TIME)
    return written(figure, path)


def _leading(marginal: xr.DataArray, n: int, least: float = 0.0) -> list[str]:
    """Return the ``n`` labels that are the most probable at any time, the highest first."""
    peak = marginal.max("time").values
    order = np.argsort(-peak, kind="stable")[:n]
    labels = marginal[f"{marginal.name}_is"].values
    return [str(labels[i]) for i in order if peak[i] >= least]


def _panel(
    axes: Axes,
    marginal: xr.DataArray,
    errors: xr.DataArray | None,
    labels: list[str],
    colours: dict[str, str],
) -> None:
    dim = f"{marginal.name}_is"
    time = marginal["time"].values
    ends = []
    for label in labels:
        values = marginal.sel({dim: label}).values
        within = None if errors is None else 1.96 * errors.sel({dim: label}).values
        banded(axes, time, values, within, colours[label], shares=True, zorder=3)
        ends.append((float(values[-1]), label, colours[label]))
    rest = np.clip(1 - marginal.sel({dim: labels}).sum(dim).values, 0, 1)
    if rest.max() >= _SEEN / 2:
        axes.fill_between(time, rest, color=OTHER, alpha=0.6, lw=0, zorder=1)
        ends.append((float(rest[-1]), "all other goals", GREY))
    axes.set_xlim(time[0], time[-1] if len(time) > 1 else None)
    in_shares(axes)
    direct_labels(axes, ends, gap=_LINE_HEIGHT)


@figure_of(Posterior, ClosedLoopPosterior)
def why(
    post: Posterior | ClosedLoopPosterior,
    event: str,
    over: str | None = None,
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the log odds of ``event`` over ``over`` by frame, and the frames that decided.

    The band is 1.96 errors wide on either side; the figure is 8 x 5.6 inches. ``event`` and
    ``over`` are conditions as for :meth:`phase_ppl.Posterior.why`, which has the same errors.
    """
    found = post.why(event, over)
    time, change = found["time"].values, found["change"].values
    title = f"{post.event_id}\n{found.attrs['event']}  over  {found.attrs['over']}"
    figure = new_figure(8, 5.6, title)
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=(2, 1))[:, 0]
    odds, steps = upper.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    values, within = found["log_odds"].values, 1.96 * found["error"].values
    odds.fill_between(time, values - within, values + within, color="#dddddd", lw=0)
    odds.plot(time, values, color=INK, lw=1.8)
    odds.set_ylabel("log odds [nats" + (", tempered]" if found.attrs["tempering"] else "]"))
    width = float(time[1] - time[0]) if len(time) > 1 else 1.0
    colours = [COLOURS[2] if step > 0 else COLOURS[1] for step in change]
    steps.bar(time, change, width=width, color=colours)
    steps.set_xlim(time[0] - width, time[-1] + width)
    steps.set(xlabel=SIMULATED_TIME, ylabel="change by\neach frame")
    for axes in (odds, steps):
        axes.axhline(0, color="#999999", lw=0.8)
    painter, poses = Painter(post.scene), post.observed()
    stills = lower.subplots(1, _STILLS)
    for still in stills:
        still.set_axis_off()
    for still, frame in zip(stills, _deciding(change), strict=False):
        still.imshow(np.asarray(panel(painter.draw(poses[frame]))))
        words = f"{time[frame]:.1f} s: {change[frame]:+.2f}"
        still.set_title(words, loc="center", fontsize=NORMAL, color=colours[frame], pad=2)
        for axes in (odds, steps):
            axes.axvline(time[frame], color="#bbbbbb", lw=0.7, ls=":", zorder=0)
    return written(figure, path)


def _deciding(change: np.ndarray) -> list[int]:
    """Return the frames of the greatest changes, not too near each other, in their order."""
    chosen: list[int] = []
    for frame in np.argsort(-np.abs(change), kind="stable").tolist():
        if len(chosen) < _STILLS and all(abs(frame - other) >= _APART for other in chosen):
            chosen.append(frame)
    return sorted(chosen)


# --- as a film ------------------------------------------------------------------------------------

_GOALS: Final = 12  # of all agents, for which there is room
_PER_INCH: Final = 100
_ROW: Final = 19
"""Pixels of an inch of a figure, and of a bar, in the film."""


@figure_of(ClosedLoopPosterior)
def watch_film(post: ClosedLoopPosterior, path: str | os.PathLike[str]) -> Film:
    """Write the video with the closed loop's posterior at each frame beside it, as MP4.

    The film shows the relations and each agent's goals with the highest probabilities at any time,
    up to six with two agents. Thin lines reach one standard error to either side.

    Args:
        post: a posterior of the closed loop, as ``ppl.infer(event)`` returns it.
        path: the file, ending in .mp4; it appears only once it is complete.

    Returns:
        The film, for a notebook to play.

    Raises:
        OutputError: ``path`` has another ending, or cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    found, named = post.over_time(), titles(post)
    n, shown = _GOALS // max(2, len(post.goals_of)), dict[str, list[str]]()
    for name in post.goals_of.values():
        last = found[name][-1].to_series()
        shown[name] = sorted(_leading(found[name], n), key=lambda goal: -last[goal])
    shown |= {key: list(RELATIONS) for key in post.relations_of.values()}
    world = post.scene.world
    colours = {name: line_colour(world, i) for i, name in enumerate(post.goals_of.values())}
    rows = [len(labels) + 1.6 for labels in shown.values()]
    height = max(PANEL, 2 * round(_ROW / 2 * sum(rows)))  # films have an even number of lines
    figure = new_figure(PANEL / _PER_INCH, height / _PER_INCH)
    figure.set_dpi(_PER_INCH)
    figure.set_layout_engine("constrained", w_pad=0.15, h_pad=0.12)
    canvas = FigureCanvasAgg(figure)
    panels = figure.subplots(len(rows), 1, squeeze=False, height_ratios=rows)[:, 0]
    painter, poses = Painter(post.scene), between_frames(post.observed(), FRAMES_PER_STEP)

    def drawn(frame: int) -> list[Artist]:
        made: list[Artist] = []
        at = found.isel(time=frame)
        for axes, (name, labels) in zip(panels, shown.items(), strict=True):
            share, error = (at[key].sel({f"{name}_is": labels}) for key in (name, f"{name}_error"))
            made += bars(axes, labels, share, error, colours.get(name, RELATION_COLOUR))
            axes.set(title=named[name], xticks=[])
            axes.spines["bottom"].set_visible(False)
        return made

    # all but the bars is the same in all frames, and takes most of the time
    first = drawn(0)
    canvas.draw()
    figure.set_layout_engine("none")
    for artist in first:
        artist.remove()
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)

    @functools.lru_cache(1)
    def believed(frame: int) -> Image.Image:
        canvas.restore_region(background)
        for artist in drawn(frame):
            figure.draw_artist(artist)
            artist.remove()
        for axes in panels:  # on which the bars stand
            figure.draw_artist(axes.spines["left"])
        return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")

    def draw(index: int) -> Image.Image:
        # a drawn frame shows what is on the way to the next; that one is not known yet
        beside = believed(index // FRAMES_PER_STEP)
        return side_by_side([panel(painter.draw(poses[index])), beside])

    return film(draw, len(poses), path)
