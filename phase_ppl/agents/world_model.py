"""What both agents of a simulation know alike: the layout, what bodies can do, and the physics.

The layout is the static part of a scene as flat arrays for compiled code: rooms, doors, landmarks
and a grid of 1 x 1 cells.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.physics import compiled
from phase_ppl.physics.constants import FLOOR_FRICTION
from phase_ppl.physics.jit import bare_kernel
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.names import AGENTS, ITEMS
from phase_ppl.world.rooms import N_ROOMS, ROOMS_OF_RAY, UNREACHABLE
from phase_ppl.world.scene import Scene

DISTANCE_UNIT: Final[float] = 20.0 * math.sqrt(2.0)
"""Length by which distances are divided in rewards and proposals: the arena's diagonal."""

ROOM_POINT_INSET: Final = 1.25
"""The point that stands for a room in the planner is this far from both outer walls, units."""

AGENT_WIDTH: Final = 3.0
"""Width of an agent driving straight, in units of its size R: the base of the trapezoid."""

ITEM_WIDTH: Final = 2.0


class Layout(NamedTuple):
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

    origin: FloatArray
    size: int
    walls: FloatArray
    centre: FloatArray
    is_open: bool
    routes: IntArray
    doors: FloatArray
    door_width: FloatArray
    landmarks: FloatArray
    half_width: float
    room_points: FloatArray
    neighbour: IntArray

    @classmethod
    def of(cls, scene: Scene) -> Layout:
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
        return cls(
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
def room_of(x: float, y: float, layout: Layout) -> int:
    """Return the room id of a point."""
    if x < layout.centre[0]:
        return 0 if y > layout.centre[1] else 3
    return 1 if y > layout.centre[1] else 2


@bare_kernel
def path_distance(x1: float, y1: float, x2: float, y2: float, layout: Layout) -> float:
    """Return the length of the way between two points through door middles, units."""
    start = room_of(x1, y1, layout)
    end = room_of(x2, y2, layout)
    if start == end or layout.is_open:
        return math.sqrt((x1 - x2) ** 2 + (y1 - y2) ** 2)
    n_doors = layout.routes[start, end, 0]
    if n_doors < 0:
        return UNREACHABLE
    length = 0.0
    x, y = x1, y1
    for i in range(n_doors):
        door = layout.routes[start, end, 1 + i]
        dx, dy = layout.doors[door, 0], layout.doors[door, 1]
        length += math.sqrt((x - dx) ** 2 + (y - dy) ** 2)
        x, y = dx, dy
    return length + math.sqrt((x - x2) ** 2 + (y - y2) ** 2)


@bare_kernel
def body_origin(bodies: FloatArray, entity: int, cog: FloatArray) -> tuple[float, float]:
    """Return x, y of the body origin of ``entity`` from its centre of mass and angle."""
    angle = bodies[entity, 2]
    return (
        bodies[entity, 0] + math.sin(angle) * cog[entity],
        bodies[entity, 1] - math.cos(angle) * cog[entity],
    )


@dataclasses.dataclass(frozen=True)
class Abilities:
    """What the bodies of a scene can do; all of the physics that plans depend on.

    Attributes:
        passes: (entity, ray): whether the entity fits through the door.
        fills: (item, ray): whether the item, standing at the door, closes it: it is wider than
            the gap, so that nobody can push it through.
        walled: (ray,) whether a wall stands on the ray, so that its door can be stood in.
        carries_alone: whether each agent's pull beats the floor friction of itself and an item.
        carries_against_hold: likewise with the other agent hanging on the item, not helping.
        carries_together: whether both beat the friction of all three bodies.
        room_distance: (room, room) length of the way, inf for none; doors only by ``passes``.
        neighbours: per room the (ray, room) pairs that open doors join.
        is_open: no inner walls.
    """

    passes: tuple[tuple[bool, ...], ...]
    fills: tuple[tuple[bool, ...], ...]
    walled: tuple[bool, ...]
    carries_alone: tuple[bool, bool]
    carries_against_hold: tuple[bool, bool]
    carries_together: bool
    room_distance: tuple[tuple[float, ...], ...]
    neighbours: tuple[tuple[tuple[int, int], ...], ...]
    is_open: bool

    @classmethod
    def of(cls, scene: Scene, strengths: tuple[float, float]) -> Abilities:
        """Return the abilities of a scene's bodies with the given strengths, newtons."""
        rooms = scene.rooms
        factor = [AGENT_WIDTH] * len(AGENTS) + [ITEM_WIDTH] * len(ITEMS)
        width = [f * r for f, r in zip(factor, scene.radius, strict=True)]
        middle = scene.landmark_centres
        return cls(
            passes=tuple(tuple(bool(w < gap) for gap in rooms.door_width) for w in width),
            fills=tuple(
                tuple(bool(0 < gap < 2 * scene.radius[len(AGENTS) + i]) for gap in rooms.door_width)
                for i in range(len(ITEMS))
            ),
            walled=tuple((rooms.wall_length > 0).tolist()),
            carries_alone=tuple(f > 2 * FLOOR_FRICTION for f in strengths),  # type: ignore[arg-type]
            carries_against_hold=tuple(  # type: ignore[arg-type]
                f > 3 * FLOOR_FRICTION for f in strengths
            ),
            carries_together=sum(strengths) > 3 * FLOOR_FRICTION,
            room_distance=tuple(
                tuple(
                    float(rooms.path_distance(middle[a], middle[b]))
                    if rooms.route(a, b) is not None
                    else np.inf
                    for b in range(N_ROOMS)
                )
                for a in range(N_ROOMS)
            ),
            neighbours=tuple(
                tuple(
                    (ray, sides[1] if sides[0] == room else sides[0])
                    for ray, sides in enumerate(ROOMS_OF_RAY)
                    if room in sides and rooms.door_width[ray] > 0
                )
                for room in range(N_ROOMS)
            ),
            is_open=rooms.is_open,
        )

    def route(self, entities: tuple[int, ...], start: int, end: int) -> tuple[int, ...] | None:
        """Return the rooms from start to end through doors that all ``entities`` pass."""
        if start == end:
            return (start,)
        frontier, came = [start], {start: start}
        for room in frontier:
            for ray, following in self.neighbours[room]:
                if following not in came and all(self.passes[e][ray] for e in entities):
                    came[following] = room
                    frontier.append(following)
        if end not in came:
            return None
        way = [end]
        while way[-1] != start:
            way.append(came[way[-1]])
        return tuple(reversed(way))


class WorldModel(NamedTuple):
    """What both agents of a simulation share.

    Attributes:
        scene: where they are.
        layout: the scene's flat arrays.
        params: the physics that they imagine.
        abilities: what their bodies can do.
    """

    scene: Scene
    layout: Layout
    params: compiled.Params
    abilities: Abilities

    @classmethod
    def of(cls, scene: Scene, strengths: tuple[float, float], config: PlannerConfig) -> WorldModel:
        """Return what agents of these strengths, newtons, know of a scene."""
        params = compiled.make_params(
            scene, strengths, inner_steps=config.inner_steps, swivel=config.swivel
        )
        return cls(scene, Layout.of(scene), params, Abilities.of(scene, strengths))
