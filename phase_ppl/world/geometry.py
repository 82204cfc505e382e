"""Shapes of the entities and the geometry of the predicates.

An item is a disc of radius R. An agent is a trapezoid whose short side, local +y, is its
front: at angle a it looks along (-sin a, cos a). Positions are the origin of the body frame;
an agent's centre of mass lies at local (0, -R / 6).
"""

from __future__ import annotations

import itertools
import math
from typing import Any, Final

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.names import AGENTS

UNIT_TRAPEZOID: Final = np.array([[-1.5, -1.0], [-0.5, 1.0], [0.5, 1.0], [1.5, -1.0]])
"""Corners of an agent of size 1 in its body frame, clockwise from the back left."""

CENTRE_OF_MASS_Y: Final = -1.0 / 6.0  # local y of an agent's centre of mass, in units of its size R
TOUCH_ENLARGEMENT: Final = 1.2  # factor by which the other's shape grows in the touch test

GRAB_REACH: Final = 0.5
"""An item can be grabbed within its radius + this distance of a grab point, units."""

GRAB_POINTS: Final = np.array([[0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [-1.0, 0.0]])
"""Grab points of an agent of size 1 in its body frame."""


def rotation(angle: float) -> FloatArray:
    """Return the (2, 2) matrix that turns body-frame vectors by ``angle`` radians."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])


def heading(angle: float) -> FloatArray:
    """Return the unit vector in which an agent at ``angle`` looks."""
    return np.array([-math.sin(angle), math.cos(angle)])


def is_agent(entity: int, n_agents: int = len(AGENTS)) -> bool:
    """Whether an entity is an agent; agents have the first indices."""
    return entity < n_agents


def centre_of_mass(
    position: FloatArray, angle: float, radius: float, entity: int, n_agents: int = len(AGENTS)
) -> FloatArray:
    """Return the centre of mass of an entity whose body origin is at ``position``."""
    if not is_agent(entity, n_agents):
        return np.asarray(position, float)
    return np.asarray(position, float) + CENTRE_OF_MASS_Y * radius * heading(angle)


def agent_outline(pose: FloatArray, radius: float, enlarge: float = 1.0) -> FloatArray:
    """Return the (4, 2) corners of an agent at ``pose`` = (x, y, angle).

    Enlargement is about the centre of mass.
    """
    centre = np.array([0.0, CENTRE_OF_MASS_Y * radius])
    local = centre + enlarge * (radius * UNIT_TRAPEZOID - centre)
    return np.asarray(pose[:2], float) + local @ rotation(float(pose[2])).T


def _shape(
    entity: int, poses: FloatArray, radii: FloatArray, n_agents: int, enlarge: float = 1.0
) -> tuple[FloatArray, float]:
    """Return corners and rounding: an agent's outline and 0, or an item's centre and radius."""
    if is_agent(entity, n_agents):
        return agent_outline(poses[entity], radii[entity], enlarge), 0.0
    return poses[None, entity, :2], float(radii[entity]) * enlarge


def shapes_meet(
    first: int,
    second: int,
    poses: FloatArray,
    radii: FloatArray,
    enlarge_first: float = 1.0,
    enlarge_second: float = 1.0,
    n_agents: int = len(AGENTS),
) -> bool:
    """Whether the shapes of two entities overlap, enlarged about their centres.

    ``poses`` are (entity, 3) x, y, angle of all entities and ``radii`` (entity,) their sizes R.
    """
    one, rounding = _shape(first, poses, radii, n_agents, enlarge_first)
    other, more = _shape(second, poses, radii, n_agents, enlarge_second)
    return _depth(one, other, rounding + more) >= 0


def touches(
    entity: int, other: int, poses: FloatArray, radii: FloatArray, n_agents: int = len(AGENTS)
) -> bool:
    """TOUCH(entity, other): the shape of ``entity`` meets that of ``other`` enlarged 1.2 times."""
    return shapes_meet(entity, other, poses, radii, 1.0, TOUCH_ENLARGEMENT, n_agents)


def is_on(position: FloatArray, landmark_centre: FloatArray, half_width: float) -> bool:
    """ON(entity, landmark): the entity's centre is inside the landmark's square."""
    return bool(np.all(np.abs(np.asarray(position) - landmark_centre) <= half_width))


def penetration(first: FloatArray, second: FloatArray, rounding: float = 0.0) -> float:
    """Return how far two convex shapes must be moved to part, units; 0 if they are apart.

    Args:
        first, second: (n, 2) corners in order; two make a segment, one is a disc's centre.
        rounding: sum of the two radii by which the shapes are rounded.
    """
    return max(0.0, _depth(first, second, rounding))


def _depth(first: FloatArray, second: FloatArray, rounding: float) -> float:
    """As :func:`penetration`, but below 0 for shapes that are apart; 0 for those that touch."""
    gaps = first.min(axis=0) - second.max(axis=0), second.min(axis=0) - first.max(axis=0)
    gap = float(np.max(gaps))
    if gap > rounding:  # most are far apart
        return rounding - gap
    axes = [(first[:, None] - second).reshape(-1, 2)]
    for shape in (first, second):
        edges = np.roll(shape, -1, axis=0) - shape
        axes += [edges[:, ::-1] * (-1, 1), edges[: len(shape) == 2]]
    along = np.concatenate(axes)
    along = along[along.any(axis=1)].T
    if not along.size:  # the same point twice
        return rounding
    a, b = (shape @ along / np.hypot(*along) for shape in (first, second))
    inside = np.minimum(a.max(axis=0) - b.min(axis=0), b.max(axis=0) - a.min(axis=0))
    return float(inside.min()) + rounding


def deepest_overlap(scene: Any) -> tuple[str, float]:
    """Return the deepest overlap at a scene's start, in words and in units; "" and 0 if none."""
    n_agents, radii, arena = len(scene.world.agents), scene.radius, scene.arena
    parts = (_shape(e, scene.start, radii, n_agents) for e in range(len(radii)))
    shapes, rounding = zip(*parts, strict=True)
    things = [*shapes, *scene.walls]
    low = np.array([corners.min(axis=0) for corners in things])
    high = np.array([corners.max(axis=0) for corners in things])
    found = {"": 0.0}
    for e, shape in enumerate(shapes):
        name = f"the {scene.world.entities[e]}"
        beyond = [arena[0] - low[e, 0], high[e, 0] - arena[1]]
        beyond += [arena[2] - low[e, 1], high[e, 1] - arena[3]]
        found[f"{name} and the arena's border"] = float(np.max(beyond)) + rounding[e]
        apart = np.maximum(low - high[e], low[e] - high).max(axis=1)  # from all at once
        for place, wall in enumerate(scene.walls, len(shapes)):
            if apart[place] <= rounding[e]:
                words, inside = f"{name} and an inner wall", penetration(shape, wall, rounding[e])
                found[words] = max(inside, found.get(words, 0.0))
        for other in range(e):
            if apart[other] <= (both := rounding[e] + rounding[other]):
                words = f"the {scene.world.entities[other]} and {name}"
                found[words] = penetration(shape, shapes[other], both)
    return max(found.items(), key=lambda item: item[1])


def overlaps(
    start: FloatArray, radius: FloatArray, walls: FloatArray, n_agents: int = len(AGENTS)
) -> bool:
    """Whether any two shapes overlap or touch, or one overlaps a wall.

    The shapes start at (entity, coord) x, y [units], angle [rad]; sizes are (entity,) [units].
    Walls (n, 2, 2) run along the axes. The first entities are agents.
    """
    shapes = [_shape(entity, start, radius, n_agents) for entity in range(len(start))]
    return any(
        _depth(one, other, rounding + more) >= 0
        for (one, rounding), (other, more) in itertools.combinations(shapes, 2)
    ) or any(penetration(shape, wall, rounding) > 0 for shape, rounding in shapes for wall in walls)


def unwrapped(angles: FloatArray) -> FloatArray:
    """Return angles (time, ...) that turn the shorter way, NaN where they are NaN."""
    unseen = np.isnan(angles)
    time = np.arange(len(angles)).reshape(-1, *[1] * (angles.ndim - 1))
    last = np.maximum.accumulate(np.where(unseen, 0, time), axis=0)
    known = np.nan_to_num(np.take_along_axis(angles, last, axis=0))
    return np.where(unseen, np.nan, np.unwrap(known, axis=0))
