"""A situation: what a family draws, and what it draws it with."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple, NoReturn, TypeVar

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.geometry import is_agent, overlaps
from phase_ppl.world.goals import goal_literal, literal_goal, possible_goals
from phase_ppl.world.hypothesis import (
    STRENGTH_LEVELS,
    STRENGTH_RANGE,
    Hypothesis,
    Roles,
    scenario,
)
from phase_ppl.world.names import AGENTS, ENTITIES, Literal, Predicate
from phase_ppl.world.rooms import N_ROOMS, RAY_DIRECTIONS, ROOMS_OF_RAY, Rooms
from phase_ppl.world.scene import ARENA, Scene, Turning, World

LAYOUTS: Final[Mapping[int, tuple[float, float, float, float]]] = {
    0: (0, 0, 0, 0), 2: (10, 5, 0, 0), 4: (10, 7.5, 0, 0), 6: (10, 0, 5, 0), 7: (10, 5, 5, 0),
    8: (10, 7.5, 5, 0), 9: (5, 10, 5, 0), 10: (7.5, 10, 5, 0), 12: (10, 0, 7.5, 0),
    13: (10, 5, 7.5, 0), 14: (10, 7.5, 7.5, 0), 15: (7.5, 10, 7.5, 0), 16: (10, 5, 5, 5),
    17: (10, 7.5, 5, 5), 18: (10, 5, 7.5, 5), 19: (10, 7.5, 7.5, 5), 20: (7.5, 10, 7.5, 5),
    21: (10, 7.5, 7.5, 7.5),
}  # fmt: skip
"""Layout -> lengths of the walls up, left, down and right of the centre, units. Numbers as in
the original files; those that are missing were never used."""

LAYOUTS_OF_A_KIND: Final = ((4, 8, 17), (12, 13, 18), (14, 19), (15, 20))
"""Layouts in which the same doors are narrow: a situation of one can be planned in another."""

SIZES: Final = (0.8, 1.2, 1.6, 1.01)  # sizes R by the original ids, units

SPOTS: Final[tuple[tuple[tuple[float, float], ...], ...]] = (
    ((8, 20), (8, 14), (14, 16), (14, 20)),
    ((24, 20), (24, 14), (18, 16), (18, 20)),
    ((24, 10), (24, 4), (18, 8), (18, 4)),
    ((8, 10), (8, 4), (14, 8), (14, 4)),
)
"""Room -> places where entities start, units."""

NARROW: Final = 2.5
"""Width of the narrowest doors, units: only agents of the smallest size drive through them."""


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


_ARRANGEMENTS: Final = 50  # tries at places and angles without an overlap before a draw is given up
NUMBER: Final = "number"
SIZE: Final = "size"
STRENGTH: Final = "strength"


class Choice(NamedTuple):
    """One of the choices that a situation is made of."""

    kind: str  # ``NUMBER`` (of a room, landmark or the like), ``SIZE`` or ``STRENGTH``
    value: int  # the number, or the original id of the size or strength


@dataclasses.dataclass(frozen=True, eq=False)
class Situation:
    """What is to be simulated."""

    scene: Scene  # layout, sizes and start
    hypothesis: Hypothesis  # stated goals, alpha, strengths
    layout: int  # number of the layout
    # that its family made, in order; places and angles are not among them
    choices: tuple[Choice, ...] = ()


class CannotDraw(Exception):  # control flow within this package, never seen by users
    """The layout does not allow what the family wants: draw again."""


class Draw:
    """One draw of a situation in a layout, with the choices that families are made of.

    Rooms and landmarks share their numbers 0..3. Agents are red 0 and green 1, items blue 2 and
    pink 3; the colours are shuffled later.
    """

    def __init__(self, rng: np.random.Generator, layout: int, turning: Turning = "both") -> None:
        self.rng = rng
        self.layout = layout
        self.turning: Turning = turning
        self.walls = walls_of(layout)
        self.rooms = Rooms.from_walls(self.walls, ARENA, quadrants=True)
        self._choices: list[Choice] = []

    def one_of(self, options: Iterable[int]) -> int:
        """Return one of some numbers, all equally likely (CannotDraw: there is none)."""
        return self._choice(NUMBER, options)

    def _choice(self, kind: str, options: Iterable[int]) -> int:
        allowed = list(options)
        if not allowed:
            raise CannotDraw
        value = self._value(kind, allowed)
        self._choices.append(Choice(kind, value))
        return value

    def _value(self, kind: str, options: Sequence[int]) -> int:
        """Return one of the options."""
        return options[int(self.rng.integers(len(options)))]

    def room(self, *, but: Sequence[int] = ()) -> int:
        """Return a room (or landmark) other than ``but``."""
        return self.one_of(room for room in range(N_ROOMS) if room not in but)

    @property
    def chain(self) -> tuple[int, ...]:
        """The rooms in a row, from one side of the closed wall to the other.

        An arena without a closed wall is cut at the upper one.
        """
        closed = next((ray for ray in range(N_ROOMS) if not self.rooms.door_width[ray]), 0)
        order = [ROOMS_OF_RAY[closed][0]]
        while len(order) < N_ROOMS:
            order += [
                room
                for ray, pair in enumerate(ROOMS_OF_RAY)
                if ray != closed and order[-1] in pair
                for room in pair
                if room not in order
            ]
        return tuple(order)

    def sides_of(self, door: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the rooms on either side of a door, which is the only way between them."""
        chain = self.chain
        cut = sorted(chain.index(room) for room in ROOMS_OF_RAY[door])
        if cut[1] - cut[0] != 1 or self.rooms.door_width.all():
            raise CannotDraw
        return chain[: cut[1]], chain[cut[1] :]

    def narrow_door(self) -> int:
        """Return a door through which only the smallest agents drive."""
        width = self.rooms.door_width
        return self.one_of(ray for ray in range(N_ROOMS) if 0 < width[ray] <= NARROW)

    def is_free(self, start: int, end: int) -> bool:
        """Whether bodies of any size can pass between two rooms; not so of a room and itself."""
        return start != end and self.rooms.narrowest(start, end) > NARROW

    def size(self, *ways: tuple[int, int]) -> float:
        """Return any size where all ways between rooms are free, else the smallest."""
        free = all(self.is_free(*way) for way in ways)
        return SIZES[self._choice(SIZE, range(len(SIZES)) if free else (0,))]

    def any_size(self, *, but: Sequence[float] = ()) -> float:
        """Return a size other than ``but``."""
        return SIZES[self._choice(SIZE, (i for i, size in enumerate(SIZES) if size not in but))]

    def strength(self, *levels: int) -> float:
        """Return the force of one of some levels 0..3, newtons; of any if none is given."""
        return STRENGTH_LEVELS[self._choice(STRENGTH, levels or range(len(STRENGTH_LEVELS)))]

    def situation(
        self,
        goals: tuple[int, int],
        alpha: tuple[int, int],
        rooms: Sequence[int],
        sizes: Sequence[float],
        strengths: tuple[float, float],
        *,
        at: Mapping[int, tuple[float, float]] | None = None,
    ) -> Situation:
        """Return the situation with places and angles drawn, nothing overlapping.

        Goals are stated ones; ``rooms`` say where each of the four entities starts, ``sizes`` are
        their R [units], ``strengths`` in newtons; ``at`` fixes the places [units] of some entities.
        """
        radius = np.array(sizes, np.float64)
        for start in self._arrangements(rooms, at or {}):
            if not overlaps(start, radius, self.walls):
                return Situation(
                    Scene(start, radius, self.walls, self.turning),
                    Hypothesis(*goals, alpha, *strengths),
                    self.layout,
                    tuple(self._choices),
                )
        raise CannotDraw

    def _arrangements(
        self, rooms: Sequence[int], at: Mapping[int, tuple[float, float]]
    ) -> Iterator[FloatArray]:
        """Yield (entity, coord) starts in the rooms, for as long as it is worth trying."""
        for _ in range(_ARRANGEMENTS):
            start = np.zeros((len(ENTITIES), 3))
            for entity, room in enumerate(rooms):
                places = SPOTS[room]
                spot = at.get(entity) or places[int(self.rng.integers(len(places)))]
                angle = self.rng.uniform(-2 * np.pi, 2 * np.pi) if is_agent(entity) else 0.0
                start[entity] = *spot, round(angle, 2)
            yield start


def item_to(item: int, landmark: int) -> int:
    """Return the goal to get an item (2 or 3) to a landmark."""
    return literal_goal(Literal(Predicate.ON, item, landmark))


def agent_to(agent: int, landmark: int) -> int:
    """Return the goal to get an agent to a landmark."""
    return literal_goal(Literal(Predicate.ON, agent, landmark))


def approach(agent: int) -> int:
    """Return the goal of an agent to get to the other one."""
    return literal_goal(Literal(Predicate.TOUCH, agent, len(AGENTS) - 1 - agent))


# --- in worlds of any cast ------------------------------------------------------------------------

Option = TypeVar("Option")


class CastSituation(NamedTuple):
    """What is to be simulated in another world than PHASE."""

    scene: Scene
    roles: Roles


class CastDraw:
    """One draw of a situation in a world of any cast, in the names of that world.

    Attributes:
        world: the world.
        rng: of everything that is drawn.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self.world, self.rng = world, rng

    def refuse(self, reason: str = "") -> NoReturn:
        """End this draw: another is made. If all are refused, the last reason is told."""
        raise CannotDraw(reason)

    def one_of(self, options: Iterable[Option]) -> Option:
        """Return one of some, all equally likely; the draw is refused where there is none."""
        allowed = list(options)
        return allowed[int(self.rng.integers(len(allowed)))] if allowed else self.refuse()

    def agents(self) -> list[str]:
        """Return the names of all agents in random order."""
        return [self.world.agents[i] for i in self.rng.permutation(len(self.world.agents))]

    def item(self, *, but: Sequence[str] = ()) -> str:
        """Return the name of an item other than ``but``."""
        return self.one_of(name for name in self.world.items if name not in but)

    def landmark(self, *, but: Sequence[str] = ()) -> str:
        """Return the name of a landmark other than ``but``."""
        return self.one_of(name for name in self.world.landmark_names if name not in but)

    def room(self, *, but: Sequence[str | int] = ()) -> int:
        """Return the number of a room other than some, by number or by a landmark that is there."""
        rooms = Rooms.from_walls(np.array(self.world.walls), self.world.arena, self.world.quadrants)
        centre = {one.name: np.array([one.x, one.y]) for one in self.world.landmarks}
        others = [int(rooms.room_of(centre[one])) if one in centre else one for one in but]
        return self.one_of(room for room in range(len(rooms)) if room not in others)

    def strength(self, low: float = STRENGTH_RANGE[0], high: float = STRENGTH_RANGE[1]) -> float:
        """Return a force between two, newtons."""
        return float(self.rng.uniform(low, high))

    def errand(self, agent: str, *, of_item: bool = False) -> str:
        """Return a goal to get the agent itself, or an item, somewhere: a landmark or a room.

        With ``of_item`` only to get an item somewhere.
        """
        return self.one_of(
            goal
            for goal in self._errands(agent)
            if not of_item or goal_literal(goal, 0, self.world).subject >= len(self.world.agents)
        )

    def _errands(self, agent: str) -> list[str]:
        """Return the goals that agents have for themselves, and not about each other."""
        holder, n_agents = self.world.agent(agent), len(self.world.agents)
        goals = possible_goals(holder, self.world)
        literals = (goal_literal(goal, holder, self.world) for goal in goals)
        return [
            self.world.goals[goal]
            for goal, literal in zip(goals, literals, strict=True)
            if literal.positive
            and literal.predicate is not Predicate.TOUCH
            and (literal.subject == holder or literal.subject >= n_agents)
        ]

    def situation(
        self,
        goals: Mapping[str, str | int] | None = None,
        relation: Mapping[tuple[str, str], str] | None = None,
        strength: Mapping[str, float] | float | None = None,
        *,
        rooms: Mapping[str, Any] | None = None,
        near: Mapping[str, str] | None = None,
        size: Mapping[str, float] | float | None = None,
    ) -> CastSituation:
        """Return a situation with all drawn that is not given.

        Agents without a goal that neither help nor hinder run an errand that has nothing to do with
        what the others want.

        Args:
            goals: name of an agent -> its own goal.
            relation: (who, whom) -> "help" or "hinder".
            strength: newtons by name, or of all; of those not named any.
            rooms, near, size: where they start and how large they are, as of
                :meth:`phase_ppl.World.random_scene`.
        """
        world, own = self.world, dict(goals or {})
        others = [name for name in self.agents() if name not in own]
        others = [name for name in others if not any(name == who for who, _ in relation or {})]
        forces = {name: self.strength() for name in world.agents}
        if isinstance(strength, Mapping):
            forces |= strength
        elif strength is not None:
            forces = dict.fromkeys(world.agents, strength)
        anything = {name: possible_goals(world.agent(name), world)[0] for name in others}
        roles = Roles.of(world, own | anything, relation, forces)
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
        scene = world.random_scene(self.rng, rooms=rooms, near=near, size=size)
        return CastSituation(scene, Roles.of(world, own, relation, forces))
