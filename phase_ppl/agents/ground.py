"""The static part of a scene as flat arrays for compiled code: rooms, doors, landmarks, grid."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.physics.jit import bare_kernel
from phase_ppl.world.rooms import N_ROOMS, ROOMS_OF_RAY, UNREACHABLE
from phase_ppl.world.scene import Scene

DISTANCE_UNIT: Final[float] = 20.0 * math.sqrt(2.0)
"""Length by which distances are divided in rewards and proposals: the arena's diagonal."""

ROOM_POINT_INSET: Final = 1.25
"""The point that stands for a room in the planner is this far from both outer walls, units."""

N_PLACES: Final = 2 * N_ROOMS
"""Places of CLOSE: the four rooms, then the four doors (by ray: up, left, down, right)."""


class Ground(NamedTuple):
    """What the agents know about the layout.

    Attributes:
        origin: (2,) x of the left and y of the top border.
        size: number of 1 x 1 cells along a side.
        walls: (n, 4) inner walls as x1, y1, x2, y2.
        centre: (2,) centre of the arena.
        is_open: no inner walls.
        routes: (4, 4, 4) from ``Rooms.route_table``.
        doors: (4, 2) door middles; door_width: (4,).
        landmarks: (4, 2) centres; half_width: of their squares.
        room_points: (4, 2) the point that stands for each room.
        neighbour: (4, 4) door (ray) that joins two rooms directly, -1 for none or closed.
    """

    origin: NDArray[np.float64]
    size: int
    walls: NDArray[np.float64]
    centre: NDArray[np.float64]
    is_open: bool
    routes: NDArray[np.int64]
    doors: NDArray[np.float64]
    door_width: NDArray[np.float64]
    landmarks: NDArray[np.float64]
    half_width: float
    room_points: NDArray[np.float64]
    neighbour: NDArray[np.int64]


def make_ground(scene: Scene) -> Ground:
    """Return the flat arrays of ``scene``."""
    x0, x1, y0, y1 = scene.arena
    rooms = scene.rooms
    inset = ROOM_POINT_INSET
    corners = np.array(
        [
            [x0 + inset, y1 - inset],
            [x1 - inset, y1 - inset],
            [x1 - inset, y0 + inset],
            [x0 + inset, y0 + inset],
        ]
    )
    neighbour = np.full((N_ROOMS, N_ROOMS), -1, np.int64)
    for ray, (a, b) in enumerate(ROOMS_OF_RAY):
        if rooms.door_width[ray] > 0:
            neighbour[a, b] = neighbour[b, a] = ray
    return Ground(
        origin=np.array([x0, y1]),
        size=math.ceil(x1 - x0 - 1e-9),
        walls=np.ascontiguousarray(scene.walls.reshape(-1, 4)),
        centre=scene.centre,
        is_open=rooms.is_open,
        routes=rooms.route_table,
        doors=np.ascontiguousarray(rooms.door_position),
        door_width=rooms.door_width,
        landmarks=np.array(scene.landmark_centres),
        half_width=float(scene.landmark_half_width),
        room_points=corners,
        neighbour=neighbour,
    )


@bare_kernel
def room_of(x: float, y: float, ground: Ground) -> int:
    """Return the room id of a point."""
    if x < ground.centre[0]:
        return 0 if y > ground.centre[1] else 3
    return 1 if y > ground.centre[1] else 2


@bare_kernel
def path_distance(x1: float, y1: float, x2: float, y2: float, ground: Ground) -> float:
    """Return the length of the way between two points through door middles, units."""
    start = room_of(x1, y1, ground)
    end = room_of(x2, y2, ground)
    if start == end or ground.is_open:
        return math.sqrt((x1 - x2) ** 2 + (y1 - y2) ** 2)
    n_doors = ground.routes[start, end, 0]
    if n_doors < 0:
        return UNREACHABLE
    length = 0.0
    x, y = x1, y1
    for i in range(n_doors):
        door = ground.routes[start, end, 1 + i]
        dx, dy = ground.doors[door, 0], ground.doors[door, 1]
        length += math.sqrt((x - dx) ** 2 + (y - dy) ** 2)
        x, y = dx, dy
    return length + math.sqrt((x - x2) ** 2 + (y - y2) ** 2)


@bare_kernel
def body_origin(
    bodies: NDArray[np.float64], entity: int, cog: NDArray[np.float64]
) -> tuple[float, float]:
    """Return x, y of the body origin of ``entity`` from its centre of mass and angle."""
    angle = bodies[entity, 2]
    return (
        bodies[entity, 0] + math.sin(angle) * cog[entity],
        bodies[entity, 1] - math.cos(angle) * cog[entity],
    )
