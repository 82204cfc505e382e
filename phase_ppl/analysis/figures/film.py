"""What could be believed at each moment, shown beside the video."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import xarray as xr
from PIL import Image, ImageDraw, ImageFont

from phase_ppl.render.frames import BACKGROUND, PANEL, Painter, between_frames, panel, side_by_side
from phase_ppl.render.video import FRAMES_PER_SECOND, FRAMES_PER_STEP, encode_mp4
from phase_ppl.world.files import atomic_output
from phase_ppl.world.hypothesis import RELATIONS

if TYPE_CHECKING:
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior


_MARGIN: Final = 18
_TITLE_SIZE: Final = 15
_TEXT_SIZE: Final = 13
_ROW: Final = 19
_GAP: Final = 12
_NAME_WIDTH: Final = 220
_INK: Final = (34, 34, 34)
_SOFT: Final = (225, 225, 225)


class Group(NamedTuple):
    """Bars under a title.

    Attributes:
        title: above them.
        entries: label and share in [0, 1] of each bar, from the top down.
        colour: of the bars, RGB.
    """

    title: str
    entries: Sequence[tuple[str, float]]
    colour: tuple[int, int, int]


def bars_panel(groups: Sequence[Group], heading: str = "") -> Image.Image:
    """Return groups of bars on a square panel, as high as a frame's.

    Args:
        groups: from the top down; what does not fit is cut off.
        heading: a line above all.
    """
    picture = Image.new("RGB", (PANEL, PANEL), BACKGROUND)
    draw = ImageDraw.Draw(picture)
    title_font, font = ImageFont.load_default(_TITLE_SIZE), ImageFont.load_default(_TEXT_SIZE)
    draw.text((_MARGIN, _MARGIN), heading, fill=_INK, font=title_font, anchor="lm")
    left, right = _MARGIN + _NAME_WIDTH, PANEL - _MARGIN - 40
    y = _MARGIN + 2 * _GAP
    for group in groups:
        draw.text((_MARGIN, y), group.title, fill=_INK, font=title_font, anchor="lm")
        y += _ROW + 2
        for label, share in group.entries:
            draw.text((_MARGIN, y), label, fill=_INK, font=font, anchor="lm")
            draw.rectangle((left, y - 6, right, y + 6), fill=_SOFT)
            if share > 0:
                end = left + max(1, round(share * (right - left)))
                draw.rectangle((left, y - 6, end, y + 6), fill=group.colour)
            draw.text((right + 6, y), f"{share:.2f}", fill=_INK, font=font, anchor="lm")
            y += _ROW
        y += _GAP
    return picture


# --- what could be believed at each moment, shown beside the video --------------------------------

_GOALS: Final = 6
_TITLES: Final = {"goal_red": "Goal of the red agent", "goal_green": "Goal of the green agent"}
_COLOURS: Final = {"goal_red": (214, 47, 47), "goal_green": (28, 138, 60)}
_RELATION_COLOUR: Final = (76, 91, 118)


def watch_film(post: StepwisePosterior, path: str | os.PathLike[str]) -> None:
    """Write the video with the posterior at each frame beside it, as MP4.

    The goals shown are those that are the most probable at any time.

    Args:
        post: what was read.
        path: the file, ending in .mp4; it appears only once it is complete.

    Raises:
        OutputError: another ending, or the file cannot be written.
    """
    found = post.over_time()
    shown = {name: leading(found[name], _GOALS) for name in _TITLES}
    painter = Painter(post.scene)
    poses = between_frames(post.observed(), FRAMES_PER_STEP)

    def draw(index: int) -> Image.Image:
        # a drawn frame shows what is on the way to the next; that one is not known yet
        frame = index // FRAMES_PER_STEP
        groups = [
            Group(_TITLES[name], entries(found[name], shown[name], frame), _COLOURS[name])
            for name in _TITLES
        ]
        relation = entries(found["relation"], RELATIONS, frame)
        groups.append(Group("Relation", relation, _RELATION_COLOUR))
        return side_by_side([panel(painter.draw(poses[index])), bars_panel(groups)])

    with atomic_output(path, (".mp4",)) as part:
        encode_mp4(map(draw, range(len(poses))), part, FRAMES_PER_SECOND)


def leading(marginal: xr.DataArray, n: int) -> list[str]:
    """Return the ``n`` labels that are the most probable at any time, the first in the end first.

    Args:
        marginal: (time, label) from ``over_time``.
        n: how many.
    """
    labels = marginal[f"{marginal.name}_is"].values
    peak, last = marginal.max("time").values, marginal.values[-1]
    order = np.argsort(-peak, kind="stable")[:n]
    return [str(labels[i]) for i in sorted(order, key=lambda i: -last[i])]


def entries(
    marginal: xr.DataArray, labels: list[str] | tuple[str, ...], frame: int
) -> list[tuple[str, float]]:
    """Return labels with their probabilities at a frame."""
    at = marginal.isel(time=frame)
    return [(label, float(at.sel({f"{marginal.name}_is": label}))) for label in labels]
