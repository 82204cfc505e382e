"""What notebooks show: text as it is printed, and a scene or an event as a small drawing (SVG)."""

from __future__ import annotations

import html
from typing import Any, Final

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.geometry import agent_outline, is_agent

Colour = tuple[int, int, int]

LANDMARK_COLOURS: Final[tuple[Colour, ...]] = (
    (45, 45, 180),
    (50, 150, 50),
    (180, 45, 45),
    (180, 180, 45),
)
ENTITY_COLOURS: Final[tuple[Colour, ...]] = (
    (255, 0, 0),
    (0, 255, 0),
    (117, 216, 230),
    (255, 153, 153),
)
TRAIL_COLOURS: Final[tuple[Colour, ...]] = (
    (170, 0, 0),
    (0, 140, 0),
    (60, 150, 170),
    (215, 100, 110),
)

_PIXELS: Final = 260


def preformatted(what: Any) -> str:
    """Return ``str(what)`` as HTML that keeps its lines."""
    return f'<pre style="line-height:1.25">{html.escape(str(what))}</pre>'


def drawn(scene: Any, trajectory: FloatArray | None = None, caption: str = "") -> str:
    """Return a scene as SVG with a caption, bodies at the start, and the way they go.

    Args:
        scene: the :class:`phase_ppl.Scene` to draw.
        trajectory: (time, entity, coord) of the way.
        caption: a line below it.
    """
    x0, x1, _, y1 = scene.arena
    half, parts = scene.landmark_half_width, []
    for (x, y), colour in zip(scene.landmark_centres, LANDMARK_COLOURS, strict=True):
        box = f'x="{x - half:g}" y="{y - half:g}" width="{2 * half:g}" height="{2 * half:g}"'
        parts.append(f'<rect {box} fill="rgb{colour}" opacity="0.5"/>')
    if trajectory is not None:
        for entity, colour in enumerate(TRAIL_COLOURS):
            line = _points(trajectory[:, entity, :2])
            parts.append(f'<polyline points="{line}" fill="none" stroke="rgb{colour}"/>')
    for entity, (pose, radius) in enumerate(zip(scene.start, scene.radius, strict=True)):
        if is_agent(entity):
            shape = f'<polygon points="{_points(agent_outline(pose, radius))}"'
        else:
            shape = f'<circle cx="{pose[0]:.2f}" cy="{pose[1]:.2f}" r="{radius:g}"'
        parts.append(f'{shape} fill="rgb{ENTITY_COLOURS[entity]}" stroke="#222"/>')
    for wall in (*scene.border, *scene.walls):
        parts.append(f'<polyline points="{_points(wall)}" stroke="black" stroke-width="0.25"/>')
    width = x1 - x0
    view = f"{x0 - 0.5:g} {-y1 - 0.5:g} {width + 1:g} {width + 1:g}"
    return (
        f'<svg width="{_PIXELS}" height="{_PIXELS}" viewBox="{view}" stroke-width="0.12" '
        f'role="img"><g transform="scale(1,-1)">{"".join(parts)}</g></svg>'
        f"<div>{html.escape(caption)}</div>"
    )


def _points(points: FloatArray) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in np.asarray(points))
