"""Pictures of an event: one frame, or a film strip."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont, ImageOps

from phase_ppl.render.frames import (
    BACKGROUND,
    Colour,
    Drawable,
    Painter,
    panel,
    scene_and_trajectory,
    side_by_side,
    write_centred,
)
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.event import FRAMES_PER_SECOND, Event, Truth
from phase_ppl.world.files import atomic_output
from phase_ppl.world.hypothesis import SCENARIOS
from phase_ppl.world.progress import Bar
from phase_ppl.world.scene import Scene

_STRIP_PANEL: Final = 300
_STRIP_CAPTION: Final = 36
_STRIP_TEXT_SIZE: Final = 22


def image(
    what: Drawable,
    frame: int,
    path: str | os.PathLike[str],
    scene: Scene | None = None,
    *,
    fields_of_view: bool = False,
) -> None:
    """Write one frame, -1 the last one, as a PNG, in PHASE of 640 x 480.

    ``what``, ``scene`` and ``fields_of_view`` are those of :func:`phase_ppl.render.video`.
    """
    scene, trajectory = scene_and_trajectory(what, scene)
    n_frames = len(trajectory)
    if not -n_frames <= frame < n_frames:
        raise InvalidSettingError(f"frame={frame}, expected one of 0..{n_frames - 1}")
    picture = Painter(scene, fields_of_view).draw(trajectory[frame])
    with atomic_output(path, (".png",)) as part:
        picture.save(part, "PNG")


def strip(
    what: Drawable,
    path: str | os.PathLike[str],
    n: int = 6,
    scene: Scene | None = None,
    *,
    fields_of_view: bool = False,
) -> None:
    """Write a film strip as PNG: ``n`` frames from first to last, evenly spaced.

    Lines show the ways since the picture before; the time below is simulated seconds. ``what``,
    ``scene`` and ``fields_of_view`` are those of :func:`phase_ppl.render.video`.
    """
    picture = draw_strip(what, n, scene, fields_of_view)
    with atomic_output(path, (".png",)) as part:
        picture.save(part, "PNG")


def draw_strip(
    what: Drawable, n: int = 6, scene: Scene | None = None, fields_of_view: bool = False
) -> Image.Image:
    """Return the picture that :func:`strip` writes: panels 300 pixels high, 36 rows below."""
    scene, trajectory = scene_and_trajectory(what, scene)
    if not 1 <= n <= len(trajectory):
        raise InvalidSettingError(f"n={n}, expected one of 1..{len(trajectory)}")
    painter = Painter(scene, fields_of_view)
    chosen = np.linspace(0, len(trajectory) - 1, n).round().astype(int)
    panels: list[Image.Image] = []
    for before, frame in zip([0, *chosen[:-1]], chosen, strict=True):
        drawn = painter.draw(trajectory[frame], trail=trajectory[before : frame + 1])
        middle = panel(drawn)
        size = (round(_STRIP_PANEL * middle.width / middle.height), _STRIP_PANEL)
        panels.append(middle.resize(size, Image.Resampling.LANCZOS))
    picture = side_by_side(panels, below=_STRIP_CAPTION)
    for index, frame in enumerate(chosen):
        x, y = (index + 0.5) * size[0], _STRIP_PANEL + _STRIP_CAPTION / 3
        write_centred(picture, f"{frame / FRAMES_PER_SECOND:.1f} s", x, y, _STRIP_TEXT_SIZE)
    return picture


# --- A whole set of events as one picture ---------------------------------------------------------

SCENARIO_COLOURS: Final[dict[str, Colour]] = {
    "collaborative": (0, 158, 115),
    "independent": (86, 160, 211),
    "competing": (230, 159, 0),
    "opposing": (213, 94, 0),
}
"""To be told apart without seeing red and green apart."""

UNKNOWN_COLOUR: Final[Colour] = (170, 170, 170)  # of events without truth
THUMBNAIL: Final = 192
PER_PAGE: Final = 500

_GAP: Final = 10
_MARGIN: Final = 18
_LINE: Final = 5
_CAPTION: Final = 25
_TEXT_SIZE: Final = 13
_LEGEND_TEXT_SIZE: Final = (17, 2)
"""Pixels of the legend's text at least, and per column: a large page is looked at from afar."""

_TEXT_COLOUR: Final[Colour] = (60, 60, 60)
_FINE: Final = 3
_PALE: Final = 0.55
_TRIM: Final = 36
"""Pixels of a panel's margin around the arena that a thumbnail leaves out, of 40."""


def contact_sheet(
    events: Sequence[Event],
    path: str | os.PathLike[str],
    columns: int | None = None,
    captions: bool = True,
    *,
    per_page: int = PER_PAGE,
    progress: bool | None = None,
) -> list[Path]:
    """Write one picture of many events: of each its last frame, the ways there and its start.

    The start is faint. Captions are ids below a line in the colour of the scenario, which a
    legend above explains. A set larger than a page is spread over several, NAME-1.png, NAME-2.png
    and so on.

    Args:
        events: in the order in which they are shown, row by row.
        path: the file, ending in ".png".
        columns: events per row; by default as many as make a page about square.
        captions: whether to write captions and the legend.
        per_page: events of a page at most; a page of 500 takes some 60 MB while it is drawn.
        progress: whether to show a progress bar; None: where stderr is a terminal.

    Returns:
        The files.
    """
    if not events:
        raise InvalidEventError("there are no events to draw")
    whole_number("per_page", per_page)
    if columns is None:
        columns = math.ceil(math.sqrt(min(len(events), per_page)))
    columns = min(whole_number("columns", columns), len(events))
    target = Path(path)
    pages = [events[start : start + per_page] for start in range(0, len(events), per_page)]
    paths = [
        target if len(pages) == 1 else target.with_name(f"{target.stem}-{n}{target.suffix}")
        for n in range(1, len(pages) + 1)
    ]
    with Bar(len(events), 0, progress, "event", "contact sheet") as bar:
        for page, file in zip(pages, paths, strict=True):
            with atomic_output(file, (".png",)) as part:
                _page(page, columns, captions, bar.update).save(part, "PNG")
    return paths


def _page(
    events: Sequence[Event], columns: int, captions: bool, done: Callable[[], object]
) -> Image.Image:
    """Return a page; ``done`` is called after each event."""
    caption = _CAPTION if captions else 0
    text_size = max(_LEGEND_TEXT_SIZE[0], _LEGEND_TEXT_SIZE[1] * columns)
    legend = 2 * text_size if captions else 0
    across, down = THUMBNAIL + _GAP, THUMBNAIL + caption + _GAP
    size = (
        2 * _MARGIN - _GAP + columns * across,
        2 * _MARGIN - _GAP + legend + math.ceil(len(events) / columns) * down,
    )
    picture = Image.new("RGB", size, BACKGROUND)
    if captions:
        _write_legend(picture, events, text_size)
    for index, event in enumerate(events):
        row, column = divmod(index, columns)
        x, y = _MARGIN + column * across, _MARGIN + legend + row * down
        picture.paste(thumbnail(event), (x, y))
        if captions:
            _write_caption(picture, event, x, y + THUMBNAIL)
        done()
    return picture


def thumbnail(event: Event, side: int = THUMBNAIL) -> Image.Image:
    """Return a small square picture of what happened in an event."""
    track = event.observation.trajectory
    painter = Painter(event.scene, fine=_FINE, pale=_PALE)
    drawn = panel(painter.draw(track[-1], trail=track, faint=track[0]))
    arena = ImageOps.crop(drawn, _TRIM)
    return ImageOps.pad(arena, (side, side), Image.Resampling.LANCZOS, BACKGROUND)


def _scenario(event: Event) -> str:
    """Return the scenario of an event of PHASE whose truth is known; "" of others."""
    return event.truth.scenario if isinstance(event.truth, Truth) else ""


def _write_caption(picture: Image.Image, event: Event, x: int, y: int) -> None:
    """Write below a thumbnail whose lower left corner is (x, y)."""
    font, draw = ImageFont.load_default(_TEXT_SIZE), ImageDraw.Draw(picture)
    colour = SCENARIO_COLOURS.get(_scenario(event), UNKNOWN_COLOUR)
    draw.rectangle((x, y, x + THUMBNAIL - 1, y + _LINE - 1), fill=colour)
    text = " ".join(event.id.split())
    while font.getlength(text) > THUMBNAIL:
        text = f"{text[:-4]}..."
    middle = y + (_LINE + _CAPTION) // 2
    draw.text((x, middle), text, fill=_TEXT_COLOUR, font=font, anchor="lm")


def _write_legend(picture: Image.Image, events: Sequence[Event], text_size: int) -> None:
    """Write how many events there are, and of each scenario how many, as far as there is room."""
    found = Counter(map(_scenario, events))
    entries: list[tuple[Colour | None, str]] = [
        (None, f"{len(events)} event{'' if len(events) == 1 else 's'}"),
        *((SCENARIO_COLOURS[name], f"{name} {found[name]}") for name in SCENARIOS if found[name]),
    ]
    if found[""]:
        entries.append((UNKNOWN_COLOUR, f"of no known scenario {found['']}"))
    font, draw = ImageFont.load_default(text_size), ImageDraw.Draw(picture)
    chip = round(0.7 * text_size)
    x, middle = _MARGIN, _MARGIN + text_size // 2
    for colour, text in entries:
        start = x if colour is None else x + chip + text_size // 2
        if start + font.getlength(text) > picture.width:
            return
        if colour is not None:
            top = middle - chip // 2
            draw.rectangle((x, top, x + chip - 1, top + chip - 1), fill=colour)
        draw.text((start, middle), text, fill=_TEXT_COLOUR, font=font, anchor="lm")
        x = start + round(font.getlength(text)) + 2 * text_size
