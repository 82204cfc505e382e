"""Rooms, doors and path distances of a floor plan.

Walls run along x or y. The lines on which they stand cut the arena into rectangular rooms. A door
is a gap that walls leave between two rooms; without a wall it is as wide as the whole border. In
the world PHASE all walls run from the arena's centre. The lines are those through the centre, so
that the rooms are always the four quadrants.

Rooms are numbered row by row from the top, to and fro. Four rooms are 0 top left, 1 top right,
2 bottom right, 3 bottom left. Doors are numbered counter-clockwise about the arena's centre, from
the top.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError

UP, LEFT, DOWN, RIGHT = range(4)
RAY_DIRECTIONS: Final = np.array([[0, 1], [-1, 0], [0, -1], [1, 0]], float)
ROOMS_OF_RAY: Final = ((0, 1), (0, 3), (2, 3), (1, 2))
"""In PHASE, the two rooms that the door on each ray (up, left, down, right) joins."""

N_ROOMS: Final = 4  # of PHASE
MOST_ROOMS: Final = 36
UNREACHABLE: Final = 282.8
"""Path distance between places that no route joins, units."""

_TOLERANCE = 1e-6


class Door(NamedTuple):
    """A gap between two rooms; a border without a gap has a closed door."""

    rooms: tuple[int, int]  # ids of the two
    x: float  # its middle, units; if closed, the border's end that is far from the arena's centre
    y: float
    width: float  # units; 0 for closed
    walled: float  # length of the walls on the border, units


@dataclasses.dataclass(frozen=True, eq=False)
class Rooms:
    """The room graph of a floor plan."""

    columns: FloatArray  # x and y, ascending, of the lines that cut the arena, its borders included
    rows: FloatArray
    doors: tuple[Door, ...]  # between neighbouring rooms
    is_open: bool  # there are no inner walls at all, so that every path is straight

    @classmethod
    def from_walls(
        cls, walls: FloatArray, arena: Sequence[float], quadrants: bool = False
    ) -> Rooms:
        """Find rooms and doors; recent floor plans are cached and give the same object.

        Args:
            walls: (n, 2, 2) end points of the inner walls, units.
            arena: x_min, x_max, y_min, y_max, units.
            quadrants: the rooms are the arena's quadrants, and all walls run from its centre.
        """
        x0, x1, y0, y1 = map(float, arena)
        return _found(np.asarray(walls, float).tobytes(), (x0, x1, y0, y1), quadrants)

    def __len__(self) -> int:
        return int(self.ids.size)

    @functools.cached_property
    def ids(self) -> IntArray:
        """(row from the bottom, column) number of the room."""
        return _numbers(len(self.rows) - 1, len(self.columns) - 1)

    @functools.cached_property
    def door_width(self) -> FloatArray:
        """(door,) free width of each door; 0 where walls close it."""
        return np.array([door.width for door in self.doors], float)

    @functools.cached_property
    def door_position(self) -> FloatArray:
        """(door, 2) middle of each gap."""
        return np.array([(door.x, door.y) for door in self.doors], float).reshape(-1, 2)

    @functools.cached_property
    def wall_length(self) -> FloatArray:
        """(door,) length of the walls on the border that the door is in, units."""
        return np.array([door.walled for door in self.doors], float)

    def points(self, inset: float) -> FloatArray:
        """Return (room, 2) points that represent the rooms.

        At the arena's border they lie ``inset`` from it, elsewhere in the middle of the room.
        """

        def along(lines: FloatArray) -> list[float]:
            middle = ((lines[:-1] + lines[1:]) / 2).tolist()
            if len(middle) > 1:
                middle[0], middle[-1] = float(lines[0]) + inset, float(lines[-1]) - inset
            return middle

        found = np.empty((len(self), 2))
        for (row, column), room in np.ndenumerate(self.ids):
            found[room] = along(self.columns)[column], along(self.rows)[row]
        return found

    def borders(self, room: int) -> tuple[float, float, float, float]:
        """Return x_min, x_max, y_min, y_max of a room, units."""
        ((row, column),) = np.argwhere(self.ids == room)
        x0, x1 = self.columns[column : column + 2].tolist()
        y0, y1 = self.rows[row : row + 2].tolist()
        return x0, x1, y0, y1

    def exits(self, room: int) -> list[tuple[int, int]]:
        """Return (door, room behind it) of the open doors of a room."""
        return [
            (number, sum(door.rooms) - room)
            for number, door in enumerate(self.doors)
            if room in door.rooms and door.width > 0
        ]

    def room_of(self, position: FloatArray) -> IntArray:
        """Return the room id of each position of shape (..., 2)."""
        position = np.asarray(position, float)
        column = np.searchsorted(self.columns[1:-1], position[..., 0], side="right")
        row = np.searchsorted(self.rows[1:-1], position[..., 1], side="left")
        return np.asarray(self.ids[row, column])

    def route(self, start: int, end: int) -> tuple[int, ...] | None:
        """Return the doors on the way from room to room, or None if no way exists.

        The way has the fewest doors; among equals, it is shortest from first to last door. The
        way back is the same.
        """
        if (start, end) not in self._routes:
            self._routes[start, end] = self._find_route(start, end)
        return self._routes[start, end]

    @functools.cached_property
    def _routes(self) -> dict[tuple[int, int], tuple[int, ...] | None]:
        return {}

    def _find_route(self, start: int, end: int) -> tuple[int, ...] | None:
        away, frontier = {end: 0}, [end]  # doors from each room to the end
        for room in frontier:
            for _, following in self.exits(room):
                if following not in away:
                    away[following] = away[room] + 1
                    frontier.append(following)

        def ways(room: int) -> Iterator[tuple[int, ...]]:
            if room == end:
                yield ()
            for door, following in self.exits(room):
                if away[following] == away[room] - 1:
                    yield from ((door, *rest) for rest in ways(following))

        def order(doors: tuple[int, ...]) -> tuple[float, tuple[int, ...]]:
            legs = np.diff(self.door_position[list(doors)], axis=0)
            # break ties between equally long ways alike in both directions
            return float(np.linalg.norm(legs, axis=1).sum()), min(doors, doors[::-1])

        return min(ways(start), key=order) if start in away else None

    def closed_off(self, places: Sequence[FloatArray] | FloatArray) -> list[int]:
        """Return the rooms without a way to any of ``places``, (n, 2) points."""
        ends = set(self.room_of(np.asarray(places, float)).tolist())
        return [
            room for room in range(len(self)) if all(self.route(room, end) is None for end in ends)
        ]

    def narrowest(self, start: int, end: int) -> float:
        """Return the width of the narrowest door on the way; inf in one room, 0 without a way."""
        doors = self.route(start, end)
        return 0.0 if doors is None else min((self.doors[d].width for d in doors), default=math.inf)

    def path_distance(self, start: ArrayLike, end: ArrayLike) -> Any:
        """Return (...) lengths of the ways between (..., 2) points through door middles, units.

        Ways are straight within a room, and in an arena without inner walls. Without a way the
        length is :data:`UNREACHABLE`.
        """
        start, end = np.asarray(start, float), np.asarray(end, float)
        if self.is_open:
            # NumPy rounds one pair differently from many
            axis = None if start.ndim == end.ndim == 1 else -1
            return np.linalg.norm(end - start, axis=axis)
        return self._ways(start, self.room_of(end), end)

    def distance_into(self, room: int, start: ArrayLike) -> Any:
        """Return (...) lengths of the ways from (..., 2) points to the last door before a room."""
        return self._ways(np.asarray(start, float), np.asarray(room), None)

    def _ways(self, start: FloatArray, ends: IntArray, end: FloatArray | None) -> Any:
        starts, ends = np.broadcast_arrays(self.room_of(start), ends)
        start = np.broadcast_to(start, (*starts.shape, 2))
        end = None if end is None else np.broadcast_to(end, (*starts.shape, 2))
        found = np.full(starts.shape, UNREACHABLE)
        for one, other in {*zip(starts.ravel().tolist(), ends.ravel().tolist(), strict=True)}:
            doors = self.route(one, other)
            if doors is not None:
                there = (starts == one) & (ends == other)
                length, at = np.zeros(int(there.sum())), start[there]
                stops = self.door_position[list(doors)]
                for stop in (*stops, *([] if end is None else [end[there]])):
                    length, at = length + np.linalg.norm(stop - at, axis=-1), stop
                found[there] = length
        return found[()]  # a number, of one pair

    @functools.cached_property
    def route_table(self) -> IntArray:
        """(room, room, room): for each pair the number of doors (-1: no way), then the doors."""
        n = len(self)
        table = np.full((n, n, n), -1, np.int64)
        for start, end in itertools.product(range(n), repeat=2):
            doors = self.route(start, end)
            if doors is not None:
                table[start, end, 0] = len(doors)
                table[start, end, 1 : 1 + len(doors)] = doors
        return table


@functools.lru_cache(maxsize=64)
def _found(content: bytes, arena: tuple[float, float, float, float], quadrants: bool) -> Rooms:
    """Return the rooms between walls; the walls' end points are the bytes of their array.

    The result is cached: scenes of one world ask for the same rooms, a random one many times.
    """
    x0, x1, y0, y1 = arena
    walls = np.frombuffer(content).reshape(-1, 2, 2)
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    for wall in walls:
        _check_wall(wall, arena, centre if quadrants else None)
    upright = np.abs(walls[:, 0, 0] - walls[:, 1, 0]) < _TOLERANCE
    columns = _lines(x0, x1, centre[:1] if quadrants else walls[upright, 0, 0])
    rows = _lines(y0, y1, centre[1:] if quadrants else walls[~upright, 0, 1])
    n_rooms = (len(columns) - 1) * (len(rows) - 1)
    if n_rooms > MOST_ROOMS:
        raise InvalidEventError(
            f"the walls cut the arena into {n_rooms} rooms, at most {MOST_ROOMS}"
        )
    ids = _numbers(len(rows) - 1, len(columns) - 1)
    found: list[tuple[float, float, Door]] = []
    for flip, across, along, standing in (
        (False, columns, rows, walls[upright]),
        (True, rows, columns, walls[~upright][..., ::-1]),
    ):
        for line, part in itertools.product(range(1, len(across) - 1), range(len(along) - 1)):
            # a border: the line at across[line], from along[part] to along[part + 1]
            on_line = np.abs(standing[:, 0, 0] - across[line]) < _TOLERANCE
            border = float(along[part]), float(along[part + 1])
            cells = [(part, line - 1), (part, line)]
            one, other = sorted(int(ids[cell[::-1] if flip else cell]) for cell in cells)
            walled, gaps = _gaps(np.sort(standing[on_line, :, 1], axis=1), *border)
            at_middle = np.array([across[line], sum(border) / 2])
            angle = _turn((at_middle[::-1] if flip else at_middle) - centre)
            far = max(border, key=lambda end: abs(end - float(centre[0 if flip else 1])))
            for low, high in gaps or [(far, far)]:
                place = float(across[line]), (low + high) / 2
                x, y = place[::-1] if flip else place
                door = Door((one, other), x, y, high - low, walled)
                found.append((angle, math.dist((x, y), centre.tolist()), door))
    doors = tuple(door for _, _, door in sorted(found))
    return Rooms(columns, rows, doors, not len(walls))


def _check_wall(
    wall: FloatArray, arena: tuple[float, float, float, float], centre: FloatArray | None
) -> None:
    """Raise InvalidEventError for an impossible wall; it must start at ``centre``, if given."""
    (ax, ay), (bx, by) = wall.tolist()
    dx, dy = abs(bx - ax), abs(by - ay)
    if centre is not None:
        off = np.abs(wall - centre)
        starts_there = off.sum(axis=1).min() <= _TOLERANCE
        if not starts_there or min(dx, dy) > _TOLERANCE:
            raise InvalidEventError(
                f"wall {wall.tolist()} does not run from the arena's centre "
                f"{centre.tolist()} straight up, left, down or right"
            )
    elif min(dx, dy) > _TOLERANCE:
        raise InvalidEventError(
            f"wall {wall.tolist()} is slanted: rooms are found from walls along x or y"
        )
    if max(dx, dy) < _TOLERANCE:
        raise InvalidEventError(f"wall {wall.tolist()} has no length")
    x0, x1, y0, y1 = arena
    if (np.maximum([x0, y0] - wall, wall - [x1, y1]) > _TOLERANCE).any():
        raise InvalidEventError(f"wall {wall.tolist()} leaves {in_words(arena)}")


def in_words(arena: Sequence[float]) -> str:
    """Return an arena as error messages name it."""
    return "the arena x {:g}..{:g}, y {:g}..{:g}".format(*arena)


def _lines(low: float, high: float, between: FloatArray) -> FloatArray:
    """Return the two borders and the lines between them, ascending and distinct."""
    found = [low]
    for line in sorted(between.tolist()):
        if found[-1] + _TOLERANCE < line < high - _TOLERANCE:
            found.append(line)
    return np.array([*found, high])


def _numbers(rows: int, columns: int) -> IntArray:
    """Return (row from the bottom, column) numbers, to and fro from the top left."""
    ids = np.arange(rows * columns).reshape(rows, columns)
    ids[1::2] = ids[1::2, ::-1].copy()
    return ids[::-1].copy()


def _gaps(walls: FloatArray, low: float, high: float) -> tuple[float, list[tuple[float, float]]]:
    """Return the length of low..high that the (n, 2) walls cover, and the gaps between them."""
    gaps, covered, reached = [], 0.0, low
    for start, end in sorted(walls.clip(low, high).tolist()):
        if start - reached > _TOLERANCE:
            gaps.append((reached, start))
        covered += max(0.0, end - max(start, reached))
        reached = max(reached, end)
    if high - reached > _TOLERANCE:
        gaps.append((reached, high))
    return covered, gaps


def _turn(offset: FloatArray) -> float:
    """Return the angle of an offset, counter-clockwise from straight up, in [0, 2 pi)."""
    return float(np.arctan2(-offset[0], offset[1]) % (2 * np.pi))
