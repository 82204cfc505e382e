"""Shared knowledge of all agents of a simulation: layout, abilities of bodies, and physics.

The layout is the static part of a scene as flat arrays for compiled code: rooms, doors, landmarks
and a grid of 1 x 1 cells.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.physics import compiled
from phase_ppl.physics.constants import FLOOR_FRICTION
from phase_ppl.physics.jit import bare_kernel
from phase_ppl.physics.records import record
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.names import NOTHING
from phase_ppl.world.rooms import UNREACHABLE
from phase_ppl.world.scene import Scene

DISTANCE_UNIT: Final[float] = 20.0 * math.sqrt(2.0)
"""Length by which distances are divided in rewards and proposals: the diagonal of PHASE's arena."""

ROOM_POINT_INSET: Final = 1.25
"""Distance from the arena's border of the point that represents a room in the planner, units."""

AGENT_WIDTH: Final = 3.0
"""Width of an agent driving straight, in units of its size R: the base of the trapezoid."""

ITEM_WIDTH: Final = 2.0


@record
class Layout(NamedTuple):
    """What the agents know about the layout."""

    origin: FloatArray  # (2,) x of the left and y of the top border
    rows: int  # number of 1 x 1 cells along a side
    columns: int
    walls: FloatArray  # (n, 4) inner walls as x1, y1, x2, y2
    lines_x: FloatArray  # (n,) lines that cut the arena into rooms, ascending
    lines_y: FloatArray
    rooms: IntArray  # (row from the bottom, column) number of the room between those lines
    is_open: bool  # no inner walls
    routes: IntArray  # (room, room, room) from ``Rooms.route_table``
    doors: FloatArray  # (door, 2) door middles
    door_width: FloatArray  # (door,)
    landmarks: FloatArray  # (landmark, 2) centres
    room_points: FloatArray  # (room, 2) the point that represents each room
    neighbour: IntArray  # (room, room) the widest door that joins two rooms directly, -1 for none

    @classmethod
    def of(cls, scene: Scene) -> Layout:
        """Return the flat arrays of ``scene``."""
        x0, x1, y0, y1 = scene.arena
        rooms = scene.rooms
        neighbour = np.full((len(rooms), len(rooms)), -1, np.int64)
        for door in np.argsort(rooms.door_width, kind="stable"):
            if rooms.door_width[door] > 0:
                a, b = rooms.doors[door].rooms
                neighbour[a, b] = neighbour[b, a] = door
        return cls(
            origin=np.array([x0, y1]),
            rows=math.ceil(y1 - y0 - 1e-9),
            columns=math.ceil(x1 - x0 - 1e-9),
            walls=np.ascontiguousarray(scene.walls.reshape(-1, 4)),
            lines_x=rooms.columns[1:-1].copy(),
            lines_y=rooms.rows[1:-1].copy(),
            rooms=rooms.ids,
            is_open=rooms.is_open,
            routes=rooms.route_table,
            doors=np.ascontiguousarray(rooms.door_position),
            door_width=rooms.door_width,
            landmarks=np.array(scene.landmark_centres),
            room_points=rooms.points(ROOM_POINT_INSET),
            neighbour=neighbour,
        )


@bare_kernel
def room_of(x: float, y: float, layout: Layout) -> int:
    """Return the room id of a point."""
    column, row = 0, 0
    for line in range(layout.lines_x.shape[0]):
        if x >= layout.lines_x[line]:
            column += 1
    for line in range(layout.lines_y.shape[0]):
        if y > layout.lines_y[line]:
            row += 1
    return layout.rooms[row, column]


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
    """What the bodies of a scene can do; plans depend on no other physics."""

    passes: tuple[tuple[bool, ...], ...]  # (entity, door): whether the entity fits through the door
    # (item, door): whether the item, standing at the door, closes it. It does if it is wider than
    # the gap, so that nobody can push it through
    fills: tuple[tuple[bool, ...], ...]
    # (door,) whether there is a wall beside the door, so that an agent can fill it
    walled: tuple[bool, ...]
    # (pulling agents, number of holders): whether the pull beats the floor friction of an item and
    # all its holders; the other holders do not help
    strong: frozenset[tuple[tuple[int, ...], int]]
    # (room, room) length of the way, inf for none; through doors as in ``passes``
    room_distance: tuple[tuple[float, ...], ...]
    # for each room, the (door, room) pairs that open doors join
    neighbours: tuple[tuple[tuple[int, int], ...], ...]
    landmark_rooms: tuple[int, ...]  # (landmark,) the room of each
    landmark_in: tuple[int, ...]  # (room,) a landmark in each, or ``NOTHING``
    is_open: bool  # no inner walls
    # cache of routes, by (entities, start, end)
    _routes: dict[tuple[tuple[int, ...], int, int], tuple[int, ...] | None] = dataclasses.field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @classmethod
    def of(cls, scene: Scene, strengths: Sequence[float]) -> Abilities:
        """Return the abilities of a scene's bodies with the given strengths, newtons."""
        rooms, world = scene.rooms, scene.world
        n_agents = len(world.agents)
        factor = [AGENT_WIDTH] * n_agents + [ITEM_WIDTH] * len(world.items)
        width = [f * r for f, r in zip(factor, scene.radius, strict=True)]
        landmark_rooms = tuple(rooms.room_of(scene.landmark_centres).tolist())
        landmark_in = tuple(
            landmark_rooms.index(room) if room in landmark_rooms else NOTHING
            for room in range(len(rooms))
        )
        middle = rooms.points(ROOM_POINT_INSET)
        for room, landmark in enumerate(landmark_in):
            if landmark != NOTHING:
                middle[room] = scene.landmark_centres[landmark]
        return cls(
            passes=tuple(tuple(bool(w < gap) for gap in rooms.door_width) for w in width),
            fills=tuple(
                tuple(bool(0 < gap < 2 * radius) for gap in rooms.door_width)
                for radius in scene.radius[n_agents:]
            ),
            walled=tuple((rooms.wall_length > 0).tolist()),
            strong=frozenset(
                (pulling, holders)
                for holders in range(1, n_agents + 1)
                for number in range(1, holders + 1)
                for pulling in itertools.combinations(range(n_agents), number)
                if sum(strengths[agent] for agent in pulling) > (holders + 1) * FLOOR_FRICTION
            ),
            room_distance=tuple(
                tuple(
                    np.inf if rooms.route(a, b) is None else float(rooms.path_distance(start, end))
                    for b, end in enumerate(middle)
                )
                for a, start in enumerate(middle)
            ),
            neighbours=tuple(tuple(rooms.exits(room)) for room in range(len(rooms))),
            landmark_rooms=landmark_rooms,
            landmark_in=landmark_in,
            is_open=rooms.is_open,
        )

    def carries(self, *pulling: int, holders: int) -> bool:
        """Whether ``pulling`` agents can pull an item with ``holders`` holders."""
        return (tuple(sorted(pulling)), holders) in self.strong

    def route(self, entities: tuple[int, ...], start: int, end: int) -> tuple[int, ...] | None:
        """Return the rooms from start to end through doors that all ``entities`` pass."""
        asked = entities, start, end
        if asked not in self._routes:
            self._routes[asked] = self._found_route(*asked)
        return self._routes[asked]

    def _found_route(
        self, entities: tuple[int, ...], start: int, end: int
    ) -> tuple[int, ...] | None:
        frontier, came = [start], {start: start}
        for room in frontier:
            for door, following in self.neighbours[room]:
                if following not in came and all(self.passes[e][door] for e in entities):
                    came[following] = room
                    frontier.append(following)
        if end not in came:
            return None
        way = [end]
        while way[-1] != start:
            way.append(came[way[-1]])
        return tuple(reversed(way))


class WorldModel(NamedTuple):
    """What all agents of a simulation share."""

    scene: Scene  # where they are
    layout: Layout  # the scene's flat arrays
    params: compiled.Params  # the physics that they imagine
    abilities: Abilities  # what their bodies can do

    @classmethod
    def of(cls, scene: Scene, strengths: Sequence[float], config: PlannerConfig) -> WorldModel:
        """Return what agents of these strengths, newtons, know of a scene."""
        params = compiled.make_params(
            scene, strengths, inner_steps=config.inner_steps, swivel=config.swivel
        )
        return cls(scene, Layout.of(scene), params, Abilities.of(scene, strengths))
