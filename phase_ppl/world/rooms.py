"""Rooms, doors and path distances of a scene.

The arena is a square cut into four rooms (quadrants) by walls on four rays from its centre.
Rooms carry the ids of their landmarks: 0 top left, 1 top right, 2 bottom right, 3 bottom left.
A ray's gap, between the end of its wall and the arena's border, is the door between two rooms.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import Final

import numpy as np

from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError

UP, LEFT, DOWN, RIGHT = range(4)
RAY_DIRECTIONS: Final = np.array([[0, 1], [-1, 0], [0, -1], [1, 0]], float)
ROOMS_OF_RAY: Final = ((0, 1), (0, 3), (2, 3), (1, 2))
"""The two rooms that the door on each ray (up, left, down, right) joins."""

N_ROOMS: Final = 4
UNREACHABLE: Final = 282.8
"""Path distance between places that no route joins, units."""

_TOLERANCE = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class Rooms:
    """The room graph of a scene.

    Attributes:
        centre: (2,) where the rays start, units.
        half_width: half the side of the arena, units.
        wall_length: (4,) length of the wall on each ray, 0 for none, units.
    """

    centre: FloatArray
    half_width: float
    wall_length: FloatArray

    @classmethod
    def from_walls(cls, walls: FloatArray, centre: FloatArray, half_width: float) -> Rooms:
        """Read the rays' walls off inner wall segments of shape (n, 2, 2).

        Raises:
            InvalidEventError: a wall that does not start at the centre and follow a ray.
        """
        lengths = np.zeros(4)
        for wall in np.asarray(walls, float).reshape(-1, 2, 2):
            ends = wall - centre
            order = np.argsort(np.abs(ends).sum(axis=1))
            near, far = ends[order[0]], ends[order[1]]
            along = RAY_DIRECTIONS @ far
            ray = int(np.argmax(along))
            off_ray = np.abs(far - along[ray] * RAY_DIRECTIONS[ray]).sum()
            if np.abs(near).sum() > _TOLERANCE or off_ray > _TOLERANCE:
                raise InvalidEventError(
                    f"wall {wall.tolist()} does not run from the arena's centre "
                    f"{centre.tolist()} straight up, left, down or right"
                )
            if along[ray] < _TOLERANCE:
                raise InvalidEventError(f"wall {wall.tolist()} has no length")
            if along[ray] > half_width + _TOLERANCE:
                raise InvalidEventError(f"wall {wall.tolist()} leaves the arena")
            lengths[ray] = max(lengths[ray], along[ray])
        return cls(np.asarray(centre, float), float(half_width), lengths)

    @functools.cached_property
    def door_width(self) -> FloatArray:
        """(4,) free width of the door on each ray; 0 where the wall closes it."""
        width = self.half_width - self.wall_length
        return np.where(width < _TOLERANCE, 0.0, width)

    @functools.cached_property
    def door_position(self) -> FloatArray:
        """(4, 2) middle of the gap on each ray."""
        middle = (self.wall_length + self.half_width) / 2
        return self.centre + middle[:, None] * RAY_DIRECTIONS

    @property
    def is_open(self) -> bool:
        """Whether there are no inner walls at all, so that every path is straight."""
        return not self.wall_length.any()

    def room_of(self, position: FloatArray) -> IntArray:
        """Return the room id of each position of shape (..., 2)."""
        position = np.asarray(position, float)
        left = position[..., 0] < self.centre[0]
        top = position[..., 1] > self.centre[1]
        return np.where(top, np.where(left, 0, 1), np.where(left, 3, 2))

    def route(self, start: int, end: int, width: float = 0.0) -> tuple[int, ...] | None:
        """Return the doors on the way from room to room, or None where there is no way.

        The way through the fewest doors; among those, the shortest from first to last door.
        The way back is the same way.

        Args:
            start, end: room ids.
            width: doors must be wider than this to count, units.
        """
        key = (start, end, width)
        if key not in self._routes:
            self._routes[key] = self._find_route(start, end, width)
        return self._routes[key]

    @functools.cached_property
    def _routes(self) -> dict[tuple[int, int, float], tuple[int, ...] | None]:
        return {}

    def _find_route(self, start: int, end: int, width: float) -> tuple[int, ...] | None:
        for count in range(N_ROOMS):
            ways = [
                doors
                for doors in itertools.permutations(range(4), count)
                if self._joins(start, end, doors, width)
            ]
            if ways:
                return min(ways, key=self._way_order)
        return None

    def _way_order(self, doors: tuple[int, ...]) -> tuple[float, tuple[int, ...]]:
        """Sort key of a way; equally long ways are told apart alike in both directions."""
        points = self.door_position[list(doors)]
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        return length, min(doors, doors[::-1])

    def _joins(self, start: int, end: int, doors: tuple[int, ...], width: float) -> bool:
        room = start
        for door in doors:
            sides = ROOMS_OF_RAY[door]
            if room not in sides or not self.door_width[door] > width:
                return False
            room = sides[1] if room == sides[0] else sides[0]
        return room == end

    def narrowest(self, start: int, end: int) -> float:
        """Return the width of the narrowest door on the way; inf in one room, 0 without a way."""
        doors = self.route(start, end)
        if doors is None:
            return 0.0
        return float(min((self.door_width[d] for d in doors), default=np.inf))

    def path_distance(self, start: FloatArray, end: FloatArray, width: float = 0.0) -> float:
        """Return the length of the way between two points through door middles, units.

        Straight within a room and in an arena without inner walls;
        :data:`UNREACHABLE` where no route of wide enough doors exists.
        """
        start, end = np.asarray(start, float), np.asarray(end, float)
        if self.is_open:
            return float(np.linalg.norm(end - start))
        doors = self.route(int(self.room_of(start)), int(self.room_of(end)), width)
        if doors is None:
            return UNREACHABLE
        points = np.vstack([start, self.door_position[list(doors)].reshape(-1, 2), end])
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    @functools.cached_property
    def route_table(self) -> IntArray:
        """(4, 4, 4): per pair of rooms the number of doors (-1: no way), then the doors' rays."""
        table = np.full((N_ROOMS, N_ROOMS, 4), -1, np.int64)
        for start, end in itertools.product(range(N_ROOMS), repeat=2):
            doors = self.route(start, end)
            if doors is not None:
                table[start, end, 0] = len(doors)
                table[start, end, 1 : 1 + len(doors)] = doors
        return table
