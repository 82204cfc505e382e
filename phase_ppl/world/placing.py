"""Random start places and sizes, some in given rooms or beside other bodies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.world.arrays import FloatArray, finite_array
from phase_ppl.world.errors import (
    InvalidSettingError,
    check_name,
    number_or_nan,
    shown,
    whole_number,
)
from phase_ppl.world.rooms import Rooms

SIZES: Final = (0.8, 1.01, 1.2, 1.6)
"""Sizes R of the original world's entities, units."""

MIN_RADIUS: Final = 0.01
"""Smallest size of an entity, units; smaller ones have next to no mass and inertia."""

NEARBY: Final = 2.0
"""Most free floor between bodies that start near each other, units."""

TRIES: Final = 300


def arrangements(
    world: Any,
    rng: np.random.Generator,
    walls: FloatArray,
    rooms: Mapping[str, Any],
    near: Mapping[str, str],
    size: Mapping[str, float] | float | None,
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield (entity, coord) starts and (entity,) sizes; bodies may still overlap.

    Arguments and errors are those of :meth:`phase_ppl.World.random_scene`.
    """
    n, n_agents = len(world.entities), len(world.agents)
    x0, x1, y0, y1 = world.arena
    plan = Rooms.from_walls(walls, world.arena, world.quadrants)  # refuses impossible ones
    most = min(x1 - x0, y1 - y0) / 4
    sizes = [one for one in SIZES if one <= most]
    closed_off = plan.closed_off(np.array([(one.x, one.y) for one in world.landmarks]))
    within = {world.entity(name): _room(world, room, plan) for name, room in rooms.items()}
    beside = _beside(world, near)
    free = [one for one in range(n) if one not in {*within, *dict(beside)}]
    fixed = dict(size) if isinstance(size, Mapping) else dict.fromkeys(world.entities, size)
    given = {world.entity(name): one for name, one in fixed.items() if one is not None}
    for one, value in given.items():
        if not MIN_RADIUS <= number_or_nan(value) <= most:
            raise InvalidSettingError(
                f"size of the {world.entities[one]} is {shown(value)}, expected one in "
                f"[{MIN_RADIUS:g}, {most:g}]"
            )
    for _ in range(TRIES):
        start = np.column_stack(
            [rng.uniform(x0, x1, n), rng.uniform(y0, y1, n), rng.uniform(-np.pi, np.pi, n)]
        )
        start[n_agents:, 2] = 0.0
        radius = rng.choice(sizes, n)
        for one, value in given.items():
            radius[one] = value
        share = (start[:, :2] - (x0, y0)) / (x1 - x0, y1 - y0)
        for one, room in within.items():
            left, right, low, high = plan.borders(room)
            start[one, :2] = (left, low) + share[one] * (right - left, high - low)
        for one, other in beside:
            if other < n:
                centre, reach = start[other, :2], radius[other]
            else:
                _, x, y, reach, *_ = world.landmarks[other - n]
                centre = np.array([x, y])
            way = 2 * np.pi * share[one, 0]
            apart = radius[one] + reach + NEARBY * share[one, 1]
            start[one, :2] = centre + apart * np.array([np.cos(way), np.sin(way)])
            if within.get(one, plan.room_of(centre)) != plan.room_of(start[one, :2]):
                break
        else:
            if not np.isin(plan.room_of(start[free, :2]), closed_off).any():
                yield start, radius


def _room(world: Any, given: object, rooms: Rooms) -> int:
    """Return the number of a room, given by number, by a landmark or by a point in it."""
    if isinstance(given, str):
        check_name("landmark", given, world.landmark_names)
        _, x, y, *_ = world.landmarks[world.landmark_names.index(given)]
    elif isinstance(given, (Sequence, np.ndarray)):
        x, y = finite_array("room", given, (2,), InvalidSettingError).tolist()
        x0, x1, y0, y1 = world.arena
        if not (x0 <= x <= x1 and y0 <= y <= y1):
            raise InvalidSettingError(f"room of ({x:g}, {y:g}), which lies outside the arena")
    else:
        return whole_number("room", given, 0, len(rooms) - 1)
    return int(rooms.room_of(np.array([x, y])))


def _beside(world: Any, near: Mapping[str, str]) -> list[tuple[int, int]]:
    """Return pairs (entity, neighbour), ordered so that every neighbour is placed first.

    Indices number the entities, then the landmarks.
    """
    places = (*world.entities, *world.landmark_names)
    for name, other in near.items():
        world.entity(name)
        check_name("agent, item or landmark", other, places)
    left, found = dict(near), []
    while left:
        ready = [name for name, other in left.items() if other not in left]
        if not ready:
            names = " and ".join(left)
            raise InvalidSettingError(f"near={shown(near)}: {names} are near themselves")
        found += [(world.entity(name), places.index(left.pop(name))) for name in ready]
    return found
