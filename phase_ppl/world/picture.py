"""Displays for terminals and notebooks: lines of a table, and a scene as a small drawing (SVG)."""

from __future__ import annotations

import html
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    check_name,
    instance_of,
    shown,
    whole_number,
)
from phase_ppl.world.geometry import agent_outline, is_agent

Colour = tuple[int, int, int]

LANDMARK_COLOURS: Final = ((45, 45, 180), (50, 150, 50), (180, 45, 45), (180, 180, 45))
ENTITY_COLOURS: Final = ((255, 0, 0), (0, 255, 0), (117, 216, 230), (255, 153, 153))
TRAIL_COLOURS: Final = ((170, 0, 0), (0, 140, 0), (60, 150, 170), (215, 100, 110))

COLOURS: Final[dict[str, Colour]] = {
    "blue": (60, 90, 230),
    "green": (0, 170, 0),
    "red": (230, 40, 40),
    "yellow": (225, 190, 0),
    "purple": (150, 60, 220),
    "orange": (245, 130, 20),
    "brown": (140, 90, 50),
    "grey": (130, 130, 130),
}
"""Default colours by name."""

AGENT_COLOURS: Final = {
    "red": ENTITY_COLOURS[0],
    "green": ENTITY_COLOURS[1],
    "purple": COLOURS["purple"],
    "orange": COLOURS["orange"],
} | {name: colour for name, colour in COLOURS.items() if name not in ("red", "green")}
ITEM_COLOURS: Final = {
    "blue": ENTITY_COLOURS[2],
    "pink": ENTITY_COLOURS[3],
    "yellow": (250, 225, 90),
    "brown": (190, 140, 95),
    "grey": (180, 180, 180),
    "green": (150, 220, 120),
}
SCENARIO_COLOURS: Final[dict[str, Colour]] = {
    "collaborative": (0, 158, 115),
    "independent": (77, 111, 179),
    "competing": (201, 138, 0),
    "opposing": (184, 51, 106),
}
"""Colours that people with red-green blindness can tell apart."""

_TRAILS: Final = dict(zip(ENTITY_COLOURS, TRAIL_COLOURS, strict=True))
_DARKER: Final = 0.7
_PALER: Final = 0.45

_PIXELS: Final = 260


def floor_colour(colour: Colour) -> Colour:
    """Return the dull variant of a colour for landmarks, so that entities stand out."""
    red, green, blue = (round(part + _PALER * (165 - part)) for part in colour)
    return red, green, blue


def colours_of(
    given: Any, agents: Sequence[str], items: Sequence[str], landmarks: Sequence[str]
) -> dict[str, Colour]:
    """Return name -> colour of all entities and landmarks; by default the colour in the name.

    Raises:
        InvalidSettingError: a value is no colour.
        UnknownNameError: a name is neither an entity nor a landmark.
    """
    instance_of("colours", given, Mapping, "a mapping of names to (red, green, blue)")
    found: dict[str, Colour] = {}
    for name, colour in given.items():
        check_name("name with a colour", name, (*agents, *items, *landmarks))
        if not isinstance(colour, list | tuple) or len(colour) != 3:
            raise InvalidSettingError(
                f"the colour of {name!r} is {shown(colour)}, expected (red, green, blue)"
            )
        red, green, blue = (whole_number(f"the colour of {name!r}", v, 0, 255) for v in colour)
        found[name] = red, green, blue
    floors = {name: floor_colour(colour) for name, colour in COLOURS.items()}
    for names, palette in ((agents, AGENT_COLOURS), (items, ITEM_COLOURS), (landmarks, floors)):
        # names that begin with a colour, such as "red agent", come first and take it
        said = {name: palette.get(name.split()[0].lower()) for name in names}
        for name in sorted(names, key=lambda name: said[name] is None):
            free = (colour for colour in palette.values() if colour not in found.values())
            found.setdefault(name, said[name] or next(free, next(iter(palette.values()))))
    return found


def trail_colour(colour: Colour) -> Colour:
    """Return the colour of an entity's path: darker than the entity."""
    red, green, blue = (round(_DARKER * part) for part in colour)
    return _TRAILS.get(colour, (red, green, blue))


class Printed:
    """A notebook display of printed text that keeps its lines."""

    def _repr_html_(self) -> str:
        return preformatted(str(self))


def preformatted(text: str) -> str:
    """Return text as HTML that keeps its lines."""
    return f'<pre style="line-height:1.25">{html.escape(text)}</pre>'


def drawn(scene: Any, trajectory: FloatArray | None = None, caption: str = "") -> str:
    """Return a scene as SVG with a caption: bodies at the start, (time, entity, coord) paths."""
    x0, x1, y0, y1 = scene.arena
    world, parts = scene.world, []
    for (x, y), half, one in zip(
        scene.landmark_centres, scene.half_widths, world.landmarks, strict=True
    ):
        box = f'x="{x - half:g}" y="{y - half:g}" width="{2 * half:g}" height="{2 * half:g}"'
        parts.append(f'<rect {box} fill="rgb{one.colour}" opacity="0.5"/>')
    if trajectory is not None:
        for entity, colour in enumerate(world.entity_colours):
            line = _points(trajectory[~np.isnan(trajectory[:, entity, 0]), entity, :2])
            stroke = f'stroke="rgb{trail_colour(colour)}"'
            parts.append(f'<polyline points="{line}" fill="none" {stroke}/>')
    for entity, (pose, radius) in enumerate(zip(scene.start, scene.radius, strict=True)):
        if is_agent(entity, len(world.agents)):
            shape = f'<polygon points="{_points(agent_outline(pose, radius))}"'
        else:
            shape = f'<circle cx="{pose[0]:.2f}" cy="{pose[1]:.2f}" r="{radius:g}"'
        parts.append(f'{shape} fill="rgb{world.entity_colours[entity]}" stroke="#222"/>')
    for wall in (*scene.border, *scene.walls):
        parts.append(f'<polyline points="{_points(wall)}" stroke="black" stroke-width="0.25"/>')
    width, height = x1 - x0 + 1, y1 - y0 + 1
    view = f"{x0 - 0.5:g} {-y1 - 0.5:g} {width:g} {height:g}"
    scale = _PIXELS / max(width, height)
    return (
        f'<svg width="{scale * width:g}" height="{scale * height:g}" viewBox="{view}" '
        f'stroke-width="0.12" role="img"><g transform="scale(1,-1)">{"".join(parts)}</g></svg>'
        f"<div>{html.escape(caption)}</div>"
    )


def _points(points: FloatArray) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in np.asarray(points))


# --- lines of a table in a terminal ---------------------------------------------------------------

WIDTH: Final = 88  # columns of a table
LABEL: Final = 13  # columns of the label before a line

_NAME, _NUMBER, _BAR = 36, 18, 21


def plain(value: Any) -> Any:
    """Return ``value`` in JSON's types; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return float(value) if np.isfinite(value) else None
    return value


def bars(label: str, entries: Sequence[tuple[str, float | None]]) -> Iterator[str]:
    """Yield a line for each name and probability; the first begins with the label.

    A probability of None was not tried.
    """
    for name, probability in entries:
        bar = "#" * round((probability or 0) * _BAR)
        number = "not tried" if probability is None else str(probability)
        yield f"{f'{label} ':<{LABEL}}{name:<{_NAME}}{number:<{_NUMBER}}{bar}".rstrip()
        label = ""


def wrapped(label: str, text: str) -> list[str]:
    """Return ``text`` as lines of a table; the first begins with the label."""
    indent = " " * LABEL
    return textwrap.wrap(text, WIDTH, initial_indent=f"{label:<{LABEL}}", subsequent_indent=indent)
