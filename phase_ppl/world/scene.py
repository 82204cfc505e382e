"""Worlds and scenes: the part of an event that everybody knows.

A world is a cast and a place. It has agents, items, landmarks, an arena with inner walls, and the
goals that follow from these. A scene belongs to a world and adds the start and size of each entity;
it can have walls of its own. All names come from the world.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from phase_ppl.world.arrays import FloatArray, finite_array
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    check_fields,
    check_name,
    instance_of,
    number_or_nan,
    shown,
    unknown_name,
    whole_number,
)
from phase_ppl.world.geometry import deepest_overlap
from phase_ppl.world.names import AGENTS, ITEMS, LANDMARKS, PredicateKind, goals_of, plain_goal
from phase_ppl.world.picture import LANDMARK_COLOURS, Colour, colours_of, drawn
from phase_ppl.world.placing import MIN_RADIUS, TRIES, arrangements
from phase_ppl.world.predicates import Predicate
from phase_ppl.world.rooms import Rooms, in_words

Turning = Literal["both", "ccw", "cw"]
TURNINGS: Final = ("both", "ccw", "cw")
ARENA: Final = (6.0, 26.0, 2.0, 22.0)  # x_min, x_max, y_min, y_max of the original world, units
LANDMARK_CENTRES: Final = np.array([[8.5, 19.5], [23.5, 19.5], [23.5, 4.5], [8.5, 4.5]])
LANDMARK_HALF_WIDTH: Final = 2.5
OUTSIDE_TOLERANCE: Final = 0.25
"""How far beyond the border a body's origin may lie before it counts as outside, units."""

MOST_AGENTS: Final = 4
MOST_ITEMS: Final = 6
MOST_LANDMARKS: Final = 8
MOST_PREDICATES: Final = 8
SIDES: Final = (4.0, 60.0)
"""Shortest and longest side of an arena, units."""

_READ_AS: Final = (" to ", " away from ")
"""Words between the two names of a goal, and so forbidden in names."""


class Landmark(NamedTuple):
    """A square on the floor."""

    name: str  # its name
    x: float  # its centre, units
    y: float
    half_width: float  # half its side, units
    colour: Colour  # red, green and blue, 0..255


@dataclasses.dataclass(frozen=True, repr=False)
class World:
    """A cast and a floor plan: agents, items, landmarks, walls, and the goals that follow.

    Example:
        ``ppl.World(["red agent", "green agent"], ["ball"], {"home": (4, 4), "field": (30, 12)},
        arena=(0, 36, 0, 24), walls=[((12, 0), (12, 16))])``

    Args:
        agents: names of 1 to 4 agents.
        items: names of up to 6 items.
        landmarks: name -> centre (x, y), or (x, y, half the side of the square), units, for 1 to 8
            landmarks. The attribute is a tuple with ``name``, ``x``, ``y``, ``half_width`` and
            ``colour`` of each.
        arena: x_min, x_max, y_min, y_max, units; each side is 4 to 60 units long.
        walls: end points ((x, y), (x, y)) of each inner wall, units. A wall runs along x or y.
        colours: name of an entity or landmark -> (red, green, blue), each from 0 to 255. By default
            the colour in the name, or else a colour that is not yet used.
        half_width: half the side of landmarks that are given without it, units.
        name: name of the world.
        touchable: names of the entities that goals such as "get to red agent" can name; None: all
            agents and items.
        quadrants: True: rooms are the arena's quadrants, and walls run from its centre, as in
            PHASE. False: rooms are found from the walls.
        predicates: up to 8 user-defined goals, each a :class:`phase_ppl.Predicate`.

    Raises:
        InvalidSettingError: a value is impossible; the message names it.
        UnknownNameError: ``colours``, ``touchable`` or a predicate has an unknown name.
        InvalidEventError: a wall is impossible.
    """

    agents: Sequence[str]
    items: Sequence[str]
    landmarks: Any
    arena: Sequence[float] = ARENA
    walls: Any = ()
    colours: Any = None
    half_width: float = LANDMARK_HALF_WIDTH
    name: str = "a world of one's own"
    touchable: Sequence[str] | None = None
    quadrants: bool = False
    predicates: Sequence[Predicate] = ()

    def __post_init__(self) -> None:
        set_field = functools.partial(object.__setattr__, self)
        set_field("agents", _names("agents", self.agents, 1, MOST_AGENTS))
        set_field("items", _names("items", self.items, 0, MOST_ITEMS))
        instance_of("name", self.name, str, "a text")
        instance_of("quadrants", self.quadrants, bool, "True or False")
        arena = tuple(finite_array("arena", self.arena, (4,), InvalidSettingError).tolist())
        set_field("arena", arena)
        sides = arena[1] - arena[0], arena[3] - arena[2]
        if not all(SIDES[0] <= side <= SIDES[1] for side in sides):
            raise InvalidSettingError(
                f"arena={arena}, expected x_min, x_max, y_min, y_max with sides of "
                f"{SIDES[0]:g} to {SIDES[1]:g} units"
            )
        places, colours = self.landmarks, self.colours or {}
        if isinstance(places, (list, tuple)) and all(isinstance(p, Landmark) for p in places):
            # those of another world, whose colours are pairs
            with contextlib.suppress(TypeError, ValueError):  # ``colours_of`` refuses others
                colours = {one.name: one.colour for one in places} | dict(colours)
            places = {one.name: one[1:4] for one in places}
        instance_of(
            "landmarks", places, Mapping, "a mapping of names to (x, y) or (x, y, half the side)"
        )
        places = {name: self._place(name, place) for name, place in places.items()}
        names = _names("landmarks", list(places), 1, MOST_LANDMARKS)
        everybody = [name.lower() for name in (*self.agents, *self.items, *names)]
        for name in _twice(everybody):
            raise InvalidSettingError(f"two of agents, items and landmarks are called {name!r}")
        for key in _twice([*self.keys, *map("_".join, itertools.permutations(self.keys, 2))]):
            raise InvalidSettingError(
                f"agents={list(self.agents)}: {key!r} could mean two of them in questions; "
                "expected names without that"
            )
        colours = colours_of(colours, self.agents, self.items, names)
        set_field("colours", tuple((name, colours[name]) for name in self.entities))
        found = ((name, *places[name], colours[name]) for name in names)
        set_field("landmarks", tuple(map(Landmark._make, found)))
        touchable = self.entities if self.touchable is None else tuple(self.touchable)
        for name in touchable:
            self.entity(name)
        for name in _twice(touchable):
            raise InvalidSettingError(f"touchable has {name!r} twice, expected it once")
        set_field("touchable", touchable)
        walls = finite_array("walls", self.walls, (None, 2, 2))
        set_field("walls", tuple(tuple(map(tuple, wall)) for wall in walls.tolist()))
        Rooms.from_walls(walls, arena, self.quadrants)
        set_field("predicates", self._users_predicates())

    def _users_predicates(self) -> tuple[Predicate, ...]:
        """Return the predicates, checked."""
        expected = "a list of ppl.Predicate"
        instance_of("predicates", self.predicates, (list, tuple), expected)
        for one in self.predicates:
            instance_of("predicates", one, Predicate, expected)
        _names("predicates", [one.name for one in self.predicates], 0, MOST_PREDICATES)
        taken = {
            plain_goal(goal)
            for goal in goals_of(self.agents, self.items, self.landmark_names, self.touchable or ())
        }
        for one in self.predicates:
            if one.name.lower().startswith("not "):
                raise InvalidSettingError(
                    f"predicate {one.name!r} begins with 'not', which its negation does"
                )
            if plain_goal(one.name) in taken:
                raise InvalidSettingError(f"two goals are called {one.name!r}")
            taken.add(plain_goal(one.name))
            one.check(self)
        return tuple(self.predicates)

    def _place(self, name: str, place: object) -> tuple[float, float, float]:
        """Return x, y and half-width of a landmark."""
        n = len(place) if isinstance(place, (Sequence, np.ndarray)) else 0
        if n not in (2, 3):
            raise InvalidSettingError(
                f"landmark {name!r} is {shown(place)}, expected (x, y) or (x, y, half the side)"
            )
        given = finite_array(f"landmark {name!r}", place, (n,), InvalidSettingError).tolist()
        x, y, said = (*given, self.half_width)[:3]
        x0, x1, y0, y1 = self.arena
        if not (x0 <= x <= x1 and y0 <= y <= y1):
            where = f"({x:g}, {y:g}), outside {in_words(self.arena)}"
            raise InvalidSettingError(f"landmark {name!r} is at {where}")
        half_width, most = number_or_nan(said), min(x1 - x0, y1 - y0) / 4
        if not 0 < half_width <= most:
            raise InvalidSettingError(
                f"landmark {name!r} has the half-width {shown(said)}, expected one in (0, {most:g}]"
            )
        return x, y, half_width

    @property
    def entities(self) -> tuple[str, ...]:
        """Names of all agents, then of all items: the order of the axis "entity" of arrays."""
        return (*self.agents, *self.items)

    @property
    def landmark_names(self) -> tuple[str, ...]:
        """Names of the landmarks: the order of the axis "landmark" of arrays."""
        return tuple(one.name for one in self.landmarks)

    @functools.cached_property
    def keys(self) -> tuple[str, ...]:
        """Short name of each agent, as in names of quantities: "red" in ``goal_red``.

        A short name is the agent's name as an identifier, in lower case. The word "agent" at its
        end is left out if all short names still differ.
        """
        plain = [re.sub(r"\W+", "_", name.lower()) for name in self.agents]
        short = [name.removesuffix("_agent") for name in plain]
        return tuple(short if len(set(short)) == len(short) else plain)

    @property
    def entity_colours(self) -> tuple[Colour, ...]:
        """Colour of each entity: (red, green, blue), each from 0 to 255."""
        return tuple(colour for _, colour in self.colours)

    def entity(self, name: str) -> int:
        """Return the index of an agent or item (UnknownNameError: none has that name)."""
        check_name("agent or item", name, self.entities)
        return self.entities.index(name)

    def agent(self, name: str) -> int:
        """Return the index of an agent (UnknownNameError: none has that name)."""
        check_name("agent", name, self.agents)
        return self.agents.index(name)

    @functools.cached_property
    def goals(self) -> tuple[str, ...]:
        """All goals, as strings.

        First come those about landmarks: each entity to and away from each landmark, such as "Get
        ball to home". Then "get to ..." and "get away from ..." each touchable entity, where the
        agent that has the goal moves itself. Then goals about a named agent and a touchable entity,
        such as "Get red agent to ball": with an item in worlds of two agents or more, with another
        agent in worlds of three or more. Last come the user-defined predicates, each followed by
        its negation.
        """
        users = ((one.name, f"not {one.name}") for one in self.predicates)
        return (
            *goals_of(self.agents, self.items, self.landmark_names, self.touchable or ()),
            *itertools.chain(*users),
        )

    @functools.cached_property
    def _places(self) -> dict[str, int]:
        return {plain_goal(goal): index for index, goal in enumerate(self.goals)}

    def goal_index(self, goal: str | int) -> int:
        """Return the index in ``goals`` of a goal, given as a string or an index.

        Strings can be in natural words: "ball to home", "get the ball away from home", "touch green
        agent", "avoid green agent". Case and spacing do not matter.

        Raises:
            UnknownNameError: there is no such goal; the message names close matches.
        """
        if isinstance(goal, str):
            index = self._places.get(plain_goal(goal))
            if index is None:
                raise unknown_name("goal", goal, self.goals)
            return index
        try:
            index = int(goal)
        except (TypeError, ValueError, OverflowError):
            index = -1
        if isinstance(goal, bool) or not 0 <= index < len(self.goals) or index != goal:
            raise unknown_name("goal", goal, [f"0..{len(self.goals) - 1}"])
        return index

    def words(self, literal: Any) -> str:
        """Return a ``phase_ppl.goals.Literal`` in names, such as "not ON(ball, home)"."""
        predicate, subject, target, positive = literal
        if predicate is PredicateKind.STOP:
            return "STOP"
        if predicate is PredicateKind.USERS:
            return f"{'' if positive else 'not '}{self.predicates[target].name}"
        if predicate is PredicateKind.ON:
            name = self.landmark_names[target]
        elif predicate is PredicateKind.CLOSE:
            rooms = len(Rooms.from_walls(self.walls, self.arena, self.quadrants))
            name = f"room {target}" if target < rooms else f"door {target - rooms}"
        else:
            name = self.entities[target]
        return f"{'' if positive else 'not '}{predicate.name}({self.entities[subject]}, {name})"

    def scene(
        self,
        start: Mapping[str, Sequence[float]],
        size: Mapping[str, float] | float = 1.0,
        walls: Any = None,
        turning: Turning = "both",
    ) -> Scene:
        """Return a scene of this world.

        Args:
            start: name of every entity -> (x, y) or (x, y, angle), units and rad. Angles are 0 (up)
                by default.
            size: size R of entities, units: name -> size, or one size for all. Entities that are
                not named have size 1. R is an item's radius; an agent's shape scales with it.
            walls: (n, 2, 2) end points (x, y) of the inner walls, units; None: the world's walls.
            turning: which way agents can turn by themselves: "both", "ccw" (counter-clockwise) or
                "cw".

        Raises:
            UnknownNameError: a name is neither an agent nor an item, or ``turning`` is unknown.
            InvalidEventError: an entity has no start or an impossible one, or a size or wall is
                impossible.
        """
        instance_of("start", start, Mapping, "a mapping of names to (x, y) or (x, y, angle)")
        sizes = dict(size) if isinstance(size, Mapping) else dict.fromkeys(self.entities, size)
        for name in (*start, *sizes):
            self.entity(name)
        rows = []
        for name in self.entities:
            if name not in start:
                raise InvalidEventError(f"start has no place for the {name}")
            place = start[name]
            n = len(place) if isinstance(place, (Sequence, np.ndarray)) else 0
            row = finite_array(f"start of the {name}", place, (3 if n == 3 else 2,))
            rows.append([*row.tolist(), 0.0][:3])
        radius = [sizes.get(name, 1.0) for name in self.entities]
        return Scene(rows, radius, walls, turning, world=self)

    def random_scene(
        self,
        seed: int | np.random.Generator,
        walls: Any = None,
        *,
        rooms: Mapping[str, Any] | None = None,
        near: Mapping[str, str] | None = None,
        size: Mapping[str, float] | float | None = None,
    ) -> Scene:
        """Return a scene with random start places, and sizes like the original world's.

        No body overlaps another or a wall, and agents can reach all items. Parts that walls close
        off from every landmark, as beside an L-shaped flat, stay empty unless ``rooms`` names them.

        Args:
            seed: a whole number >= 0, or a generator. The same number gives the same scene.
            walls: (n, 2, 2) end points (x, y) of the inner walls, units; None: the world's walls.
            rooms: name of an agent or item -> the room in which it starts: the name of a landmark
                in the room, a point (x, y) in the room, or the room's number.
            near: name of an agent or item -> name of an agent, item or landmark near which it
                starts: in the same room, with up to 2 units between their edges.
            size: size R, units: name of an agent or item -> size, or one size for all. Sizes that
                are not given are random.

        Raises:
            UnknownNameError: there is no such agent, item or landmark.
            InvalidSettingError: no places were found for all bodies, a room does not exist, or an
                entity is to be near itself.
        """
        if not isinstance(seed, np.random.Generator):
            seed = np.random.default_rng(whole_number("seed", seed, 0))
        walls = finite_array("walls", self.walls if walls is None else walls, (None, 2, 2))
        why = InvalidSettingError(f"no place was found for everybody in {TRIES} tries")
        for start, radius in arrangements(self, seed, walls, rooms or {}, near or {}, size):
            try:
                scene = Scene(start, radius, walls, world=self)
            except InvalidEventError:  # an item in a closed room, or somebody outside
                continue
            except InvalidSettingError as error:  # a goal that bodies of such sizes cannot have
                why = error
                continue
            if not deepest_overlap(scene)[1]:
                return scene
        raise why

    def to_dict(self) -> dict[str, Any]:
        """Return the world as plain data, which :meth:`from_dict` reads: the class's arguments."""
        x0, x1, y0, y1 = self.arena
        colours = [*self.colours, *((one.name, one.colour) for one in self.landmarks)]
        return {
            "name": self.name,
            "agents": list(self.agents),
            "items": list(self.items),
            "landmarks": {one.name: [one.x, one.y, one.half_width] for one in self.landmarks},
            "arena": [x0, x1, y0, y1],
            "walls": [[list(end) for end in wall] for wall in self.walls],
            "colours": {name: list(colour) for name, colour in colours},
            "touchable": list(self.touchable or ()),
            "quadrants": self.quadrants,
            **(
                {"predicates": [one.to_dict() for one in self.predicates]}
                if self.predicates
                else {}
            ),
        }

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> World:
        """Return the world that :meth:`to_dict` wrote as ``record``.

        Raises:
            UnknownNameError: a world does not have such a field.
            InvalidSettingError: agents, items or landmarks are missing, or a value is impossible.
            InvalidEventError: a wall is impossible.
        """
        check_fields(record, cls, "a world", ("agents", "items", "landmarks"))
        users = record.get("predicates", [])
        instance_of("predicates", users, list, "a list")
        return cls(**{**record, "predicates": [Predicate.from_dict(one) for one in users]})

    def __repr__(self) -> str:
        return (
            f"<world {self.name}: {len(self.agents)} agents, {len(self.items)} items, "
            f"{len(self.landmarks)} landmarks, {len(self.goals)} goals>"
        )


def _twice(names: Sequence[str]) -> list[str]:
    return [name for name in names if names.count(name) > 1]


def _names(what: str, names: object, least: int, most: int) -> tuple[str, ...]:
    """Return names, checked (InvalidSettingError: too few, too many, or a forbidden one)."""
    if not isinstance(names, (list, tuple)):
        raise InvalidSettingError(f"{what}={shown(names)}, expected a list of names")
    if not least <= len(names) <= most:
        raise InvalidSettingError(f"{len(names)} {what}, expected {least} to {most}")
    for name in names:
        plain = isinstance(name, str) and name == " ".join(name.split()) != ""
        if not plain or any(word in f" {name.lower()} " for word in _READ_AS):
            raise InvalidSettingError(
                f"{what} has the name {shown(name)}, expected words without 'to' and 'away from'"
            )
    return tuple(names)


PHASE: Final = World(
    AGENTS,
    ITEMS,
    dict(zip(LANDMARKS, LANDMARK_CENTRES.tolist(), strict=True)),
    colours=dict(zip(LANDMARKS, LANDMARK_COLOURS, strict=True)),
    name="PHASE",
    touchable=AGENTS,
    quadrants=True,
)
"""The world of the paper; its walls differ from scene to scene."""


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """Everything about an event that is known before any entity moves.

    Entities are in the order of ``world.entities``: agents first, then items.

    Attributes:
        start: (entity, 3) x, y [units], angle [rad] of each entity at rest, holding nothing. Angle
            0 looks up, and angles grow counter-clockwise.
        radius: (entity,) size R of each entity, units: an item's radius, an agent's scale.
        walls: (n, 2, 2) end points (x, y) of the inner walls, units; by default the world's. The
            arena's border is a wall too.
        turning: which way agents can turn by themselves: "both" (the default), "ccw"
            (counter-clockwise) or "cw".
        arena: x_min, x_max, y_min, y_max, units; by default the world's.
        landmark_centres: (landmark, 2) centres of the landmarks' squares, units; by default the
            world's.
        landmark_half_width: half the side of the landmarks' squares, one number for all or
            (landmark,), units; by default the world's.
        resets_velocity: whether agents stand still after each planner step (a frame), while items
            move on. True for scenes that people steer (paper, Appendix A.2). Default: False.
        world: the scene's world; by default PHASE.

    Raises:
        InvalidEventError: a value is not finite, has the wrong shape or is out of range; a body is
            outside the arena; or walls close an item off from every agent.
        UnknownNameError: ``turning`` is unknown.
        InvalidSettingError: ``world`` is no world, or a predicate of it is impossible in the scene.
    """

    start: FloatArray
    radius: FloatArray
    walls: FloatArray = None  # type: ignore[assignment]  # here and below: the world's
    turning: Turning = "both"
    arena: tuple[float, float, float, float] = None  # type: ignore[assignment]
    landmark_centres: FloatArray = None  # type: ignore[assignment]
    landmark_half_width: Any = None
    resets_velocity: bool = False
    world: World = PHASE

    if TYPE_CHECKING:  # accepted types of the fields

        def __init__(
            self,
            start: ArrayLike,
            radius: ArrayLike,
            walls: ArrayLike | None = None,
            turning: Turning = "both",
            arena: Sequence[float] | None = None,
            landmark_centres: ArrayLike | None = None,
            landmark_half_width: ArrayLike | None = None,
            resets_velocity: bool = False,
            world: World = PHASE,
        ) -> None: ...

    def __post_init__(self) -> None:
        instance_of("world", self.world, World, "a phase_ppl.World")
        n, places = len(self.world.entities), self.world.landmarks
        set_field = functools.partial(object.__setattr__, self)
        given: dict[str, tuple[Any, tuple[int | None, ...]]] = {
            "start": (None, (n, 3)),
            "radius": (None, (n,)),
            "walls": (self.world.walls, (None, 2, 2)),
            "landmark_centres": ([(one.x, one.y) for one in places], (len(places), 2)),
            "arena": (self.world.arena, (4,)),
        }
        for name, (of_world, shape) in given.items():
            value = getattr(self, name)
            value = of_world if value is None else value
            set_field(name, finite_array(f"scene.{name}", value, shape))
        x0, x1, y0, y1 = arena = tuple(np.asarray(self.arena).tolist())
        set_field("arena", arena)
        check_name("turning", self.turning, TURNINGS)
        if not isinstance(self.resets_velocity, bool):
            raise InvalidEventError(
                f"scene.resets_velocity is {shown(self.resets_velocity)}, expected true or false"
            )
        width, height = x1 - x0, y1 - y0
        as_in_paper = self.world == PHASE
        if min(width, height) <= 0 or (as_in_paper and abs(width - height) > 1e-6):
            kind = "a square" if as_in_paper else "a rectangle"
            raise InvalidEventError(f"scene.arena {self.arena} is not {kind} x0, x1, y0, y1")
        most = min(width, height) / 4
        if (self.radius < MIN_RADIUS).any() or (self.radius > most).any():
            raise InvalidEventError(
                f"scene.radius {self.radius.tolist()}: sizes must lie in [{MIN_RADIUS:g}, {most:g}]"
            )
        check_inside(self.start[None], self, "scene.start")
        self._check_landmarks() if as_in_paper else self._check_rooms()
        half_width = self.landmark_half_width
        if half_width is None:
            half_width = one_or_all([one.half_width for one in places])
        each = np.ndim(half_width) == 1 and not as_in_paper
        half_width = finite_array(
            "scene.landmark_half_width", half_width, (len(places),) if each else ()
        )
        for one in half_width.flat:
            if not 0 < one <= most:
                raise InvalidEventError(
                    f"scene.landmark_half_width is {one:g}, expected one in (0, {most:g}]"
                )
        set_field("landmark_half_width", half_width if each else float(half_width))

    def _check_landmarks(self) -> None:
        """Raise InvalidEventError unless landmarks are in the quadrants, as in the paper."""
        if list(self.rooms.room_of(self.landmark_centres)) != list(range(len(LANDMARKS))):
            raise InvalidEventError(
                f"scene.landmark_centres {self.landmark_centres.tolist()}: expected "
                f"{', '.join(LANDMARKS)} top left, top right, bottom right, bottom left"
            )

    def _check_rooms(self) -> None:
        """Raise InvalidEventError for impossible walls now, not during a run."""
        rooms, world = self.rooms, self.world
        starts = rooms.room_of(self.start[:, :2]).tolist()
        n_agents = len(world.agents)
        for name, room in zip(world.items, starts[n_agents:], strict=True):
            if all(rooms.route(start, room) is None for start in starts[:n_agents]):
                raise InvalidEventError(f"the {name} is in a room that walls close to every agent")
        for predicate in world.predicates:
            predicate.check_scene(self)

    def _repr_html_(self) -> str:
        return drawn(self)

    @property
    def centre(self) -> FloatArray:
        """(2,) x, y of the arena's centre, units."""
        x0, x1, y0, y1 = self.arena
        return np.array([(x0 + x1) / 2, (y0 + y1) / 2])

    @functools.cached_property
    def rooms(self) -> Rooms:
        """The rooms and doors that the walls make; ``len(scene.rooms)`` is the number of rooms."""
        return Rooms.from_walls(self.walls, self.arena, self.world.quadrants)

    @functools.cached_property
    def half_widths(self) -> FloatArray:
        """(landmark,) half the side of each landmark's square, units."""
        return np.broadcast_to(
            np.asarray(self.landmark_half_width, float), len(self.landmark_centres)
        )

    @functools.cached_property
    def border(self) -> FloatArray:
        """(4, 2, 2) end points (x, y) of the arena's outer walls, units."""
        x0, x1, y0, y1 = self.arena
        corners = np.array([[x0, y1], [x1, y1], [x1, y0], [x0, y0]])
        return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def check_inside(trajectory: FloatArray, scene: Scene, name: str) -> None:
    """Raise InvalidEventError if a body of a (time, entity, coord) trajectory is outside."""
    x0, x1, y0, y1 = scene.arena
    n = len(scene.world.entities)
    if trajectory.shape[1] != n:
        raise InvalidEventError(
            f"{name} has {trajectory.shape[1]} entities, expected the {n} of {scene.world.name}"
        )
    x, y = trajectory[..., 0], trajectory[..., 1]
    slack = OUTSIDE_TOLERANCE
    outside = (x < x0 - slack) | (x > x1 + slack) | (y < y0 - slack) | (y > y1 + slack)
    if outside.any():
        frame, entity = (int(i) for i in np.argwhere(outside)[0])
        raise InvalidEventError(
            f"{name}: the {scene.world.entities[entity]} is at ({x[frame, entity]:g}, "
            f"{y[frame, entity]:g}) in frame {frame}, outside {in_words(scene.arena)}"
        )


def world_in_files(world: World) -> dict[str, Any] | None:
    """Return what files have of a world: its plain form; None for PHASE, which they leave out."""
    return None if world == PHASE else world.to_dict()


def check_is_phase(world: World, what: str) -> None:
    """Raise InvalidSettingError unless the world is PHASE, the only one that ``what`` knows."""
    if world != PHASE:
        raise InvalidSettingError(f"{what} knows the world PHASE only, not {world.name!r}")


def one_or_all(values: Sequence[float]) -> float | list[float]:
    """Return one value if all are equal, else the list."""
    return values[0] if len(set(values)) == 1 else list(values)
