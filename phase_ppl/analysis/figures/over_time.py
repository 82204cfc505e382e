"""Figures of a posterior over time, and of which frames speak for one thing over another."""

from __future__ import annotations

import itertools
import os
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
import xarray as xr
from PIL import Image, ImageDraw, ImageFont

from phase_ppl.analysis.figures.style import (
    COLOURS,
    GREY,
    INK,
    MANY_COLOURS,
    NORMAL,
    OTHER,
    SIMULATED_TIME,
    SMALL,
    direct_labels,
    dressed,
    figure_of,
    in_shares,
    new_figure,
    written,
)
from phase_ppl.analysis.hypotheses import Hypotheses
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.render.frames import BACKGROUND, PANEL, Painter, between_frames, panel, side_by_side
from phase_ppl.render.video import FRAMES_PER_SECOND, FRAMES_PER_STEP, Film, encode_mp4
from phase_ppl.world.files import atomic_output
from phase_ppl.world.hypothesis import RELATIONS
from phase_ppl.world.picture import Colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINES: Final = 5  # lines of a panel; what else there is, is one more
_SEEN: Final = 0.1  # probability that a goal must reach at some time to have a line
_RELATION_COLOURS: Final = dict(zip(RELATIONS, ("#009e73", GREY, "#d55e00"), strict=True))
_LINE_HEIGHT: Final = 0.095
"""Of a label, as a share of a panel's height."""

_NOTES: Final = {
    "hindsight": "Hindsight, not belief at the time: hypotheses proposed from the whole video, "
    "weighted by how well they explain it up to each frame.",
    "filtering": "What can be believed at each frame from the frames so far.",
}

_STILLS: Final = 5
_APART: Final = 4
"""Frames between two stills, at least."""


@figure_of(Posterior, StepwisePosterior)
def over_time(
    post: Posterior | StepwisePosterior, path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw how the probabilities of goals and relation grow out of the video.

    7.5 x 6.6 inches; higher where there are more agents.

    In hindsight, or as they could be believed at the time: see ``over_time`` of the posterior.
    Both agents' goals share their colours. Bands are 1.96 errors wide on either side, where errors
    are known.

    Raises:
        InvalidEventError, InvalidSettingError: there is no such posterior over time.
    """
    found = post.over_time()
    n_panels = len(post.goals_of) + len(post.relations_of)
    figure = new_figure(7.5, 2.2 * max(n_panels, 2), "constrained")
    figure.suptitle(post.event_id, x=0.012, ha="left", fontsize=10, color=INK)
    note = next(words for kind, words in _NOTES.items() if kind in found.attrs)
    figure.supxlabel(textwrap.fill(note, 120), x=0.012, ha="left", fontsize=SMALL + 0.3, color=GREY)
    shown = {name: _leading(found[name]) for name in post.goals_of.values()}
    goals = list(dict.fromkeys(goal for goals in shown.values() for goal in goals))
    # of more goals than colours some share theirs: labels stand beside the lines
    colours = dict(zip(goals, itertools.cycle(MANY_COLOURS), strict=False)) | _RELATION_COLOURS
    shown |= {key: list(_RELATION_COLOURS) for key in post.relations_of.values()}
    heights = [5] * len(post.goals_of) + [4] * len(post.relations_of)
    rows = figure.subplots(len(heights), 1, squeeze=False, sharex=True, height_ratios=heights)
    panels = list(rows[:, 0])
    for axes, (name, title) in zip(panels, titles(post).items(), strict=True):
        dressed(axes, title, x=SIMULATED_TIME if axes is panels[-1] else "")
        _panel(axes, found[name], found.get(f"{name}_error"), shown[name], colours)
    return written(figure, path)


def titles(post: Hypotheses | type[Hypotheses]) -> dict[str, str]:
    """Return quantity -> title of what shows it."""
    found = {name: f"Goal of the {agent}" for agent, name in post.goals_of.items()}
    for label, name in post.relations_of.items():
        found[name] = "Relation" if label == name else f"Relation of {label}"
    return found


def _leading(marginal: xr.DataArray) -> list[str]:
    """Return the labels that are ever probable, the highest at any time first, at most five."""
    peak = marginal.max("time").values
    order = np.argsort(-peak, kind="stable")[:_LINES]
    labels = marginal[f"{marginal.name}_is"].values
    return [str(labels[i]) for i in order if peak[i] >= _SEEN]


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
        axes.plot(time, values, color=colours[label], lw=1.8, solid_capstyle="round", zorder=3)
        if errors is not None:
            within = 1.96 * errors.sel({dim: label}).values
            low, high = np.clip([values - within, values + within], 0, 1)
            axes.fill_between(time, low, high, color=colours[label], alpha=0.18, lw=0, zorder=2)
        ends.append((float(values[-1]), label, colours[label]))
    rest = np.clip(1 - marginal.sel({dim: labels}).sum(dim).values, 0, 1)
    if rest.max() >= _SEEN / 2:
        axes.fill_between(time, rest, color=OTHER, alpha=0.6, lw=0, zorder=1)
        ends.append((float(rest[-1]), "all other goals", GREY))
    axes.set_xlim(time[0], time[-1])
    in_shares(axes)
    direct_labels(axes, ends, gap=_LINE_HEIGHT)


@figure_of(StepwisePosterior)
def why(
    post: StepwisePosterior,
    event: str,
    over: str | None = None,
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the log odds of ``event`` over ``over`` by frame, and the frames that decided.

    The band is 1.96 errors wide on either side. 8 x 5.6 inches. Arguments and errors are those of
    :meth:`phase_ppl.analysis.stepwise_posterior.StepwisePosterior.why`.
    """
    found = post.why(event, over)
    time, change = found["time"].values, found["change"].values
    figure = new_figure(8, 5.6, "constrained")
    title = f"{post.event_id}\n{found.attrs['event']}  over  {found.attrs['over']}"
    figure.suptitle(title, x=0.012, ha="left", fontsize=NORMAL + 1, color=INK)
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=(2, 1))[:, 0]
    odds, steps = upper.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    values, within = found["log_odds"].values, 1.96 * found["error"].values
    odds.fill_between(time, values - within, values + within, color="#dddddd", lw=0)
    odds.plot(time, values, color=INK, lw=1.8)
    dressed(odds, "", y="log odds [nats]")
    width = float(time[1] - time[0]) if len(time) > 1 else 1.0
    colours = [COLOURS[2] if step > 0 else COLOURS[1] for step in change]
    steps.bar(time, change, width=width, color=colours)
    steps.set_xlim(time[0] - width, time[-1] + width)
    dressed(steps, "", x=SIMULATED_TIME, y="change by\neach frame")
    for axes in (odds, steps):
        axes.axhline(0, color="#999999", lw=0.8)
    painter, poses = Painter(post.scene), post.observed()
    stills = lower.subplots(1, _STILLS)
    for still in stills:
        still.set_axis_off()
    for still, frame in zip(stills, _deciding(change), strict=False):
        still.imshow(np.asarray(panel(painter.draw(poses[frame]))))
        words = f"{time[frame]:.1f} s: {change[frame]:+.2f}"
        still.set_title(words, fontsize=NORMAL, color=colours[frame], pad=2)
        for axes in (odds, steps):
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


# --- as a film ------------------------------------------------------------------------------------

_FILLS: Final = {"goal_red": (214, 47, 47), "goal_green": (28, 138, 60), "relation": (76, 91, 118)}
"""Quantity -> colour of its bars in PHASE."""

_GOALS: Final = 12  # of all agents, for which there is room
_MARGIN: Final = 18
_TITLE_SIZE: Final = 15
_TEXT_SIZE: Final = 13
_ROW: Final = 19
_GAP: Final = 12
_NAME_WIDTH: Final = 220
_INK: Final = (34, 34, 34)
_SOFT: Final = (225, 225, 225)


def watch_film(post: StepwisePosterior, path: str | os.PathLike[str]) -> Film:
    """Write the video with the posterior at each frame beside it, as MP4.

    The goals shown are those that are the most probable at any time; thin lines reach one standard
    error to either side. The film is returned, for a notebook to play.

    Args:
        post: what was read.
        path: the file, ending in .mp4; it appears only once it is complete.

    Raises:
        OutputError: another ending, or the file cannot be written.
    """
    found = post.over_time()
    n = _GOALS // max(2, len(post.goals_of))
    shown = {name: _ever_leading(found[name], n) for name in post.goals_of.values()}
    shown |= {key: list(RELATIONS) for key in post.relations_of.values()}
    of_agents = zip(post.goals_of.values(), post.scene.world.entity_colours, strict=False)
    colours = dict(of_agents) | _FILLS
    titled, painter = titles(post), Painter(post.scene)
    poses = between_frames(post.observed(), FRAMES_PER_STEP)

    def draw(index: int) -> Image.Image:
        # a drawn frame shows what is on the way to the next; that one is not known yet
        at = found.isel(time=index // FRAMES_PER_STEP)
        groups = {
            name: [
                (
                    label,
                    float(at[name].sel({f"{name}_is": label})),
                    float(at[f"{name}_error"].sel({f"{name}_is": label})),
                )
                for label in labels
            ]
            for name, labels in shown.items()
        }
        return side_by_side([panel(painter.draw(poses[index])), _bars(groups, titled, colours)])

    with atomic_output(path, (".mp4",)) as part:
        encode_mp4(map(draw, range(len(poses))), part, FRAMES_PER_SECOND)
    return Film(path)


def _bars(
    groups: Mapping[str, list[tuple[str, float, float]]],
    titles: Mapping[str, str],
    colours: Mapping[str, Colour],
) -> Image.Image:
    """Return probabilities (quantity -> label, share, error) as bars, at least a frame high."""
    rows = sum(len(entries) + 1 for entries in groups.values())
    height = 2 * _MARGIN + 2 * _GAP + rows * _ROW + len(groups) * (_GAP + 2)
    height += height % 2  # films have an even number of lines
    picture = Image.new("RGB", (PANEL, max(PANEL, height)), BACKGROUND)
    draw = ImageDraw.Draw(picture)
    title_font, font = ImageFont.load_default(_TITLE_SIZE), ImageFont.load_default(_TEXT_SIZE)
    left, right = _MARGIN + _NAME_WIDTH, PANEL - _MARGIN - 40
    y = _MARGIN + 2 * _GAP
    for name, entries in groups.items():
        colour = colours.get(name, _FILLS["relation"])
        draw.text((_MARGIN, y), titles[name], fill=_INK, font=title_font, anchor="lm")
        y += _ROW + 2
        for label, share, error in entries:
            draw.text((_MARGIN, y), label, fill=_INK, font=font, anchor="lm")
            draw.rectangle((left, y - 6, right, y + 6), fill=_SOFT)
            if share > 0:
                end = left + max(1, round(share * (right - left)))
                draw.rectangle((left, y - 6, end, y + 6), fill=colour)
            if error > 0:
                reach = np.clip([share - error, share + error], 0, 1)
                ends = [left + round(float(part) * (right - left)) for part in reach]
                draw.line((ends[0], y, ends[1], y), fill=_INK, width=2)
            draw.text((right + 6, y), f"{share:.2f}", fill=_INK, font=font, anchor="lm")
            y += _ROW
        y += _GAP
    return picture


def _ever_leading(marginal: xr.DataArray, n: int) -> Sequence[str]:
    """Return the labels that are the most probable at any time, the first in the end first."""
    labels = marginal[f"{marginal.name}_is"].values
    peak, last = marginal.max("time").values, marginal.values[-1]
    order = np.argsort(-peak, kind="stable")[:n]
    return [str(labels[i]) for i in sorted(order, key=lambda i: -last[i])]
