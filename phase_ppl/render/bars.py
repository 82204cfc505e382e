"""A panel of labelled bars, to stand beside a frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from PIL import Image, ImageDraw, ImageFont

from phase_ppl.render.frames import BACKGROUND
from phase_ppl.render.panels import PANEL

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
