"""Situations, and the draws by which families make them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple, NoReturn, TypeVar

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, check_name, shown
from phase_ppl.world.geometry import is_agent, overlaps
from phase_ppl.world.goals import goal_literal, possible_goals
from phase_ppl.world.hypothesis import STRENGTH_LEVELS, STRENGTH_RANGE, Hypothesis, scenario
from phase_ppl.world.names import PredicateKind
from phase_ppl.world.rooms import N_ROOMS, RAY_DIRECTIONS, ROOMS_OF_RAY, Rooms
from phase_ppl.world.scene import ARENA, PHASE, Scene, World

LAYOUTS: Final[Mapping[int, tuple[float, float, float, float]]] = {
    0: (0, 0, 0, 0), 2: (10, 5, 0, 0), 4: (10, 7.5, 0, 0), 6: (10, 0, 5, 0), 7: (10, 5, 5, 0),
    8: (10, 7.5, 5, 0), 9: (5, 10, 5, 0), 10: (7.5, 10, 5, 0), 12: (10, 0, 7.5, 0),
    13: (10, 5, 7.5, 0), 14: (10, 7.5, 7.5, 0), 15: (7.5, 10, 7.5, 0), 16: (10, 5, 5, 5),
    17: (10, 7.5, 5, 5), 18: (10, 5, 7.5, 5), 19: (10, 7.5, 7.5, 5), 20: (7.5, 10, 7.5, 5),
    21: (10, 7.5, 7.5, 7.5),
}  # fmt: skip
"""Layout -> lengths of the walls up, left, down and right of the centre, units. Numbers as in
the original files, which never used the missing ones."""

SIZES: Final = (0.8, 1.2, 1.6, 1.01)  # sizes R by the original ids, units

SPOTS: Final[tuple[tuple[tuple[float, float], ...], ...]] = (
    ((8, 20), (8, 14), (14, 16), (14, 20)),
    ((24, 20), (24, 14), (18, 16), (18, 20)),
    ((24, 10), (24, 4), (18, 8), (18, 4)),
    ((8, 10), (8, 4), (14, 8), (14, 4)),
)
"""Room -> places where entities start, units."""

NARROW: Final = 2.5
"""Width of the narrowest doors, units; only the smallest agents can drive through them."""


def walls_of(layout: int) -> FloatArray:
    """Return the (n, 2, 2) inner walls of a layout, units."""
    return walls_of_lengths(LAYOUTS[layout])


def walls_of_lengths(lengths: Sequence[float]) -> FloatArray:
    """Return the (n, 2, 2) inner walls of lengths up, left, down and right of the centre, units."""
    x0, x1, y0, y1 = ARENA
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    walls = [
        np.stack([centre, centre + length * ray])
        for length, ray in zip(lengths, RAY_DIRECTIONS, strict=True)
        if length
    ]
    return np.array(walls, np.float64).reshape(-1, 2, 2)


PHASE500: Final[Mapping[str, int]] = {
    "collab": 55, "help_lift": 35, "help_blocked": 104, "help_move": 6, "compete": 54,
    "hinder:LMA": 68, "hinder:LMO": 7, "chasing": 63,
    "independent:LMO+LMO": 15, "independent:LMO+LMA": 51, "independent:LMA+LMA": 42,
}  # fmt: skip
"""Cell, FAMILY or FAMILY:VARIANT -> number of events of the paper's 500.

200 friendly, 192 adversarial, 108 neutral; goals: item to a landmark 584, agent to a landmark 215,
agent away from one 68, to and away from the other agent 63 each, item away from a landmark 7. The
shares of the collaborative families are about those of the original test videos."""


@dataclasses.dataclass(frozen=True, eq=False)
class Tables:
    """What the makers of a world fixed for its events, beyond the world itself."""

    layouts: Mapping[int, FloatArray]  # number -> inner walls (n, 2, 2), units
    spots: Sequence[Sequence[tuple[float, float]]] = ()  # start places by room; none: everywhere
    strengths: Sequence[float] = ()  # newtons; none: all of ``STRENGTH_RANGE``
    cells: Mapping[str, int] = dataclasses.field(default_factory=dict)  # the default set
    has_looks: bool = False  # whether events can be reflected, and colours exchanged
    is_cut: bool = False  # whether events end soon after the last motion


_TABLES: Final = {
    PHASE: Tables(
        {number: walls_of(number) for number in LAYOUTS},
        SPOTS,
        STRENGTH_LEVELS,
        PHASE500,
        has_looks=True,
        is_cut=True,
    )
}


@functools.lru_cache(16)
def tables_of(world: World) -> Tables:
    """Return the tables of a world; except in PHASE it has one layout, its own."""
    return _TABLES.get(world) or Tables({0: np.array(world.walls, float).reshape(-1, 2, 2)})


_ARRANGEMENTS: Final = 50  # tries at places and angles without overlap before a draw is refused
Option = TypeVar("Option")


class Situation(NamedTuple):
    """A scene and a hypothesis, to be simulated."""

    scene: Scene
    roles: Hypothesis


class CannotDraw(Exception):  # control flow within this package, never seen by users
    """The family's situation is not possible here: draw again."""


class Draw:
    """One draw of a situation in a world: the choices that families are made of.

    Attributes:
        world: the world; all names are its names.
        rng: source of all randomness.
        layout: number of the floor plan; 0 in worlds with only one.
        rooms: the floor plan's rooms. In PHASE a room and its landmark have the same number, 0..3.
    """

    def __init__(self, world: World, rng: np.random.Generator, layout: int = 0) -> None:
        self.world, self.rng, self.layout = world, rng, layout
        self.tables = tables_of(world)
        self.walls = self.tables.layouts[layout]
        self.rooms = Rooms.from_walls(self.walls, world.arena, world.quadrants)

    def refuse(self, reason: str = "") -> NoReturn:
        """End this draw and make another. If all are refused, the error has the last reason."""
        raise CannotDraw(reason)

    def one_of(self, options: Iterable[Option]) -> Option:
        """Return one of the options, all equally likely; without any, the draw is refused."""
        allowed = list(options)
        return allowed[int(self.rng.integers(len(allowed)))] if allowed else self.refuse()

    def agents(self) -> list[str]:
        """Return the names of all agents in random order."""
        return [self.world.agents[i] for i in self.rng.permutation(len(self.world.agents))]

    def item(self, *, but: Sequence[str] = ()) -> str:
        """Return the name of an item other than ``but``."""
        return self.one_of(name for name in self.world.items if name not in but)

    def landmark(self, *, but: Sequence[str | int] = ()) -> str:
        """Return the name of a landmark other than ``but``: names, or numbers of their rooms."""
        return self.one_of(
            name for name in self.world.landmark_names if not {name, self._room_of(name)} & {*but}
        )

    def room(self, *, but: Sequence[str | int] = ()) -> int:
        """Return the number of a room other than ``but``: numbers, or names of their landmarks."""
        others = [self._room_of(one) for one in but]
        return self.one_of(room for room in range(len(self.rooms)) if room not in others)

    def _room_of(self, room: str | int) -> int:
        """Return the number of a room, given by number or by a landmark in it."""
        if not isinstance(room, str):
            return room
        check_name("landmark", room, self.world.landmark_names)
        one = self.world.landmarks[self.world.landmark_names.index(room)]
        return int(self.rooms.room_of(np.array([one.x, one.y])))

    @property
    def chain(self) -> tuple[int, ...]:
        """Return PHASE's rooms in a row, from one side of the closed wall to the other.

        An arena without a closed wall is cut at the upper one.
        """
        closed = next((ray for ray in range(N_ROOMS) if not self.rooms.door_width[ray]), 0)
        first, last = ROOMS_OF_RAY[closed]
        return tuple((first + i * (first - last)) % N_ROOMS for i in range(N_ROOMS))

    def sides_of(self, door: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the rooms on either side of a door that is the only way between them."""
        chain = self.chain
        cut = sorted(chain.index(room) for room in ROOMS_OF_RAY[door])
        if cut[1] - cut[0] != 1 or self.rooms.door_width.all():
            self.refuse()
        return chain[: cut[1]], chain[cut[1] :]

    def narrow_door(self) -> int:
        """Return a door that only the smallest agents can drive through."""
        width = self.rooms.door_width
        return self.one_of(ray for ray in range(len(width)) if 0 < width[ray] <= NARROW)

    def is_free(self, start: int | str, end: int | str) -> bool:
        """Whether bodies of any size can pass between two different rooms."""
        one, other = self._room_of(start), self._room_of(end)
        return one != other and self.rooms.narrowest(one, other) > NARROW

    def size(self, *ways: tuple[int | str, int | str], but: Sequence[float] = ()) -> float:
        """Return a size other than ``but``; the smallest unless all ways between rooms are free."""
        free = all(self.is_free(*way) for way in ways)
        allowed = SIZES if free else SIZES[:1]
        return self.one_of(size for size in allowed if size not in but)

    def strength(self, low: float = STRENGTH_RANGE[0], high: float = STRENGTH_RANGE[1]) -> float:
        """Return a force between two limits, newtons; in PHASE one of the four strengths."""
        levels = self.tables.strengths
        if not levels:
            return float(self.rng.uniform(low, high))
        return self.one_of(level for level in levels if low <= level <= high)

    def errand(self, agent: str, *, of_item: bool = False) -> str:
        """Return a goal to get the agent itself, or an item, to a landmark or a room.

        With ``of_item``, only goals about items.
        """
        return self.one_of(self._errands(agent, of_item))

    def _errands(self, agent: str, of_item: bool = False) -> Iterator[str]:
        """Yield the agent's own goals that are not about other agents."""
        world, holder = self.world, self.world.agent(agent)
        for goal in possible_goals(holder, world):
            predicate, subject, _, positive = goal_literal(goal, holder, world)
            is_own = subject >= len(world.agents) or (subject == holder and not of_item)
            if is_own and positive and predicate is not PredicateKind.TOUCH:
                yield world.goals[goal]

    def situation(
        self,
        goals: Mapping[str, str | int] | Sequence[str | int | None] | str | int | None = None,
        relation: Mapping[tuple[str, str], str] | None = None,
        strength: Mapping[str, float] | Sequence[float | None] | float | None = None,
        *,
        rooms: Any = None,
        near: Mapping[str, str] | None = None,
        size: Mapping[str, float] | Sequence[float | None] | float | None = None,
    ) -> Situation:
        """Return a situation; all that is not given is drawn.

        An agent that has no goal, and neither helps nor hinders, runs an errand unrelated to the
        other agents' goals. Goals, strengths, rooms and sizes are given by name, or as a list in
        the world's order (None: not given), or as one value for all.

        Args:
            goals: own goals of agents, strings or indices into ``world.goals``.
            relation: (name of an agent, name of the agent that it helps or hinders) -> "help" or
                "hinder".
            strength: maximum forces of agents, newtons.
            rooms, near, size: start places and sizes of agents and items, as in
                :meth:`phase_ppl.World.random_scene`. In PHASE a point (x, y) is the start itself.
        """
        world, own = self.world, _by_name(goals, self.world.agents)
        forces = _by_name(strength, world.agents)
        busy = {*own, *(who for who, _ in relation or {})}
        others: list[str] = []
        # unused numbers are drawn in other worlds too, so that seeds keep their meaning
        if not self.tables.strengths or not {*world.agents} <= busy & {*forces}:
            others = [name for name in self.agents() if name not in busy]
            forces = {name: self.strength() for name in world.agents} | forces
        anything = {name: possible_goals(world.agent(name), world)[0] for name in others}
        roles = Hypothesis.of(world, own | anything, relation, forces)
        wanted = {world.agent(a): g for a, g in roles.goals.items() if a not in others}
        for name in others:
            agent = world.agent(name)
            own[name] = wanted[agent] = self.one_of(
                errand
                for errand in self._errands(name)
                if all(
                    scenario(errand, goal, world, (agent, other)) == "independent"
                    for other, goal in wanted.items()
                )
            )
        places, sizes = _by_name(rooms, world.entities), _by_name(size, world.entities)
        if self.tables.spots and not near:
            scene = self._on_spots(places, sizes)
        else:
            scene = world.random_scene(self.rng, self.walls, rooms=places, near=near, size=sizes)
        return Situation(scene, Hypothesis.of(world, own, relation, forces))

    def _on_spots(self, rooms: Mapping[str, Any], sizes: Mapping[str, float]) -> Scene:
        """Return a scene with random places and angles, without overlap."""
        spots, names = self.tables.spots, self.world.entities
        for name in (*rooms, *sizes):
            self.world.entity(name)
        given = [rooms[name] if name in rooms else self.room() for name in names]
        places = [
            (one,) if isinstance(one, (tuple, list)) else spots[self._room_of(one)] for one in given
        ]
        radius = np.array([sizes[name] if name in sizes else self.size() for name in names], float)
        n_agents = len(self.world.agents)
        for _ in range(_ARRANGEMENTS):
            start = np.zeros((len(names), 3))
            for entity, spots_of in enumerate(places):
                spot = spots_of[int(self.rng.integers(len(spots_of)))]
                moves = is_agent(entity, n_agents)
                angle = self.rng.uniform(-2 * np.pi, 2 * np.pi) if moves else 0.0
                start[entity] = *spot, round(angle, 2)
            if not overlaps(start, radius, self.walls, n_agents):
                return Scene(start, radius, self.walls, world=self.world)
        self.refuse()


def _by_name(given: Any, names: Sequence[str]) -> dict[str, Any]:
    """Return values by name, given by name, for all in order (None: not given), or one for all."""
    if isinstance(given, Mapping):
        return dict(given)
    each = given if isinstance(given, (list, tuple)) else [given] * len(names)
    if len(each) != len(names):
        raise InvalidSettingError(f"{shown(given)}: expected one for each of {', '.join(names)}")
    return {name: one for name, one in zip(names, each, strict=True) if one is not None}
