"""What agents can see, as areas to be drawn: the rule of :mod:`phase_ppl.agents.vision`.

A point is in view if it lies in the cone around the heading, and between it and the eye, the
agent's centre of mass, is no inner wall and no other entity, taken as a disc of its size R around
its centre of mass. A disc hides what lies beyond its centre: along a ray that meets it, sight ends
at the point nearest to the centre.

The simulator asks this of the middles of 1 x 1 cells; here it is drawn without that grid.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.geometry import centre_of_mass
from phase_ppl.world.names import ENTITIES
from phase_ppl.world.scene import Scene

_RAYS: Final = 361
"""Rays at equal angles; further ones go to both sides of every wall's end and disc's edge."""

_ASIDE: Final = 1e-7
"""How far beside an edge its two rays pass, rad."""


def field_of_view(scene: Scene, poses: FloatArray, agent: int) -> FloatArray:
    """Return (n, 2) corners of the area that ``agent`` has in view, beyond the arena too.

    Args:
        scene: walls and sizes.
        poses: (entity, coord) with coord = x, y [units], angle [rad].
        agent: 0 red, 1 green.
    """
    from phase_ppl.agents.vision import HALF_ANGLE  # with numba: only where it is needed

    radius = scene.radius
    centres = np.array(
        [
            centre_of_mass(p[:2], p[2], r, e)
            for e, (p, r) in enumerate(zip(poses, radius, strict=True))
        ]
    )
    eye = centres[agent]
    others = [entity for entity in range(len(ENTITIES)) if entity != agent]
    discs, sizes = centres[others] - eye, radius[others]
    walls = scene.walls - eye

    ahead = poses[agent, 2] + np.pi / 2
    edges = np.concatenate([_directions(walls.reshape(-1, 2)), _disc_edges(discs, sizes)])
    edges = np.concatenate([edges - _ASIDE, edges + _ASIDE]) - ahead
    edges = (edges + np.pi) % (2 * np.pi) - np.pi  # -180..180 degrees from the heading
    turns = np.concatenate([np.linspace(-HALF_ANGLE, HALF_ANGLE, _RAYS), edges])
    turns = np.sort(turns[np.abs(turns) <= HALF_ANGLE])
    rays = np.stack([np.cos(ahead + turns), np.sin(ahead + turns)], axis=1)

    x0, x1, _, _ = scene.arena
    beyond = 4 * (x1 - x0)
    reach = np.minimum(_to_walls(rays, walls), _to_discs(rays, discs, sizes)).clip(max=beyond)
    return np.concatenate([eye[None], eye + reach[:, None] * rays])


def _directions(points: FloatArray) -> FloatArray:
    return np.arctan2(points[:, 1], points[:, 0])


def _disc_edges(discs: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return the directions of rays that touch the discs; from inside one, square to its centre."""
    distance = np.maximum(np.hypot(discs[:, 0], discs[:, 1]), 1e-9)
    half = np.arcsin(np.minimum(sizes / distance, 1.0))
    return np.concatenate([_directions(discs) - half, _directions(discs) + half])


def _to_walls(rays: FloatArray, walls: FloatArray) -> FloatArray:
    """Return (rays,) the distance along each ray to the first wall, inf if there is none."""
    start, along = walls[:, 0], walls[:, 1] - walls[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        facing = _cross(rays[:, None], along)
        distance = _cross(start, along) / facing
        part = _cross(start, rays[:, None]) / facing
    met = (distance >= 0) & (part >= 0) & (part <= 1)
    return np.where(met, distance, np.inf).min(axis=1, initial=np.inf)


def _to_discs(rays: FloatArray, discs: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return (rays,) the distance along each ray to where the first disc ends sight."""
    along = rays @ discs.T
    aside = np.abs(_cross(rays[:, None], discs))
    return np.where((along > 0) & (aside < sizes), along, np.inf).min(axis=1, initial=np.inf)


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])
