"""What could be believed at each moment, shown beside the video."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
import xarray as xr
from PIL import Image, ImageDraw, ImageFont

from phase_ppl.render.frames import BACKGROUND, PANEL, Painter, between_frames, panel, side_by_side
from phase_ppl.render.video import FRAMES_PER_SECOND, FRAMES_PER_STEP, Film, encode_mp4
from phase_ppl.world.files import atomic_output
from phase_ppl.world.hypothesis import RELATIONS

if TYPE_CHECKING:
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

_GROUPS: Final = {
    "goal_red": ("Goal of the red agent", (214, 47, 47)),
    "goal_green": ("Goal of the green agent", (28, 138, 60)),
    "relation": ("Relation", (76, 91, 118)),
}
"""Quantity -> title and colour of its bars."""

_GOALS: Final = 6
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
    shown = {name: _leading(found[name]) for name in ("goal_red", "goal_green")}
    shown["relation"] = list(RELATIONS)
    painter = Painter(post.scene)
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
        return side_by_side([panel(painter.draw(poses[index])), _bars(groups)])

    with atomic_output(path, (".mp4",)) as part:
        encode_mp4(map(draw, range(len(poses))), part, FRAMES_PER_SECOND)
    return Film(path)


def _bars(groups: dict[str, list[tuple[str, float, float]]]) -> Image.Image:
    """Return probabilities (quantity -> label, share, error) as bars, as high as a frame."""
    picture = Image.new("RGB", (PANEL, PANEL), BACKGROUND)
    draw = ImageDraw.Draw(picture)
    title_font, font = ImageFont.load_default(_TITLE_SIZE), ImageFont.load_default(_TEXT_SIZE)
    left, right = _MARGIN + _NAME_WIDTH, PANEL - _MARGIN - 40
    y = _MARGIN + 2 * _GAP
    for name, entries in groups.items():
        title, colour = _GROUPS[name]
        draw.text((_MARGIN, y), title, fill=_INK, font=title_font, anchor="lm")
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


def _leading(marginal: xr.DataArray) -> Sequence[str]:
    """Return the labels that are the most probable at any time, the first in the end first."""
    labels = marginal[f"{marginal.name}_is"].values
    peak, last = marginal.max("time").values, marginal.values[-1]
    order = np.argsort(-peak, kind="stable")[:_GOALS]
    return [str(labels[i]) for i in sorted(order, key=lambda i: -last[i])]
