"""Frames put beside each other, with words."""

from __future__ import annotations

from typing import Final

from PIL import Image, ImageDraw, ImageFont

from phase_ppl.render.frames import BACKGROUND, HEIGHT, WIDTH

PANEL: Final = HEIGHT
"""Side of a square panel, pixels: the arena and its margin."""

_TEXT_COLOUR: Final = (70, 70, 70)


def panel(frame: Image.Image) -> Image.Image:
    """Return the square middle of a frame, in which the arena lies."""
    left = (WIDTH - PANEL) // 2
    return frame.crop((left, 0, left + PANEL, PANEL))


def side_by_side(panels: list[Image.Image], below: int = 0) -> Image.Image:
    """Return a picture of ``panels`` from left to right over ``below`` blank rows."""
    width, height = panels[0].size
    picture = Image.new("RGB", (width * len(panels), height + below), BACKGROUND)
    for index, part in enumerate(panels):
        picture.paste(part, (index * width, 0))
    return picture


def write_centred(picture: Image.Image, text: str, x: float, y: float, size: float) -> None:
    """Write ``text`` around the pixel (x, y), ``size`` pixels high."""
    font = ImageFont.load_default(size)
    ImageDraw.Draw(picture).text((x, y), text, fill=_TEXT_COLOUR, font=font, anchor="mm")
