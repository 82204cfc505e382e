"""Families of events by name: the original eight of PHASE, those of any world, and user-defined.

A user-defined family is a function that draws a situation::

    @register_family("two_on_one", scenario="collaborative", world=trio)
    def two_on_one(draw: Draw) -> Situation:
        ...

Families with variants take the variant's name as second argument.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.data.generation.situation import (
    LAYOUTS,
    NARROW,
    SIZES,
    SPOTS,
    CannotDraw,
    Draw,
    Situation,
    tables_of,
)
from phase_ppl.world.errors import (
    InvalidSettingError,
    check_name,
    shown,
    unknown_name,
    whole_number,
)
from phase_ppl.world.geometry import deepest_overlap
from phase_ppl.world.goals import goal_literal, is_true
from phase_ppl.world.hypothesis import SCENARIOS, Hypothesis, scenario
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS
from phase_ppl.world.registry import Registry
from phase_ppl.world.rooms import ROOMS_OF_RAY
from phase_ppl.world.scene import PHASE, Scene, World
from phase_ppl.world.worlds import named

_TRIES: Final = 200  # refused draws after which a family is called impossible
_OVERLAP: Final = 0.25  # units by which bodies may overlap; the simulator moves them apart


class Drawn(NamedTuple):
    """A situation, and the layout that it was drawn in."""

    scene: Scene
    roles: Hypothesis
    layout: int  # number of the layout


@dataclasses.dataclass(frozen=True)
class Family:
    """A family of events, with or without a chosen variant."""

    name: str  # as users call it
    # ``function(draw)`` or, with variants, ``function(draw, variant)``; None: draw anew
    function: Callable[..., Any]
    summary: str  # first line of the function's documentation
    # the scenario of at least one pair of agents; "independent" is of all pairs, or of a lone agent
    scenario: str
    variants: tuple[str, ...]  # names of its variants; empty: none
    layouts: tuple[int, ...]  # numbers of the layouts that it can be drawn in
    world: World | None  # its only world; None: any with enough of the following
    needs: Mapping[str, int]  # least number of "agents", "items" and "landmarks"
    variant: str | None = None

    def lacks(self, world: World) -> str:
        """Return why a world cannot have it; "": it can."""
        if self.world is not None and self.world != world:
            whose = self.world.name
            return f"the family {self.name!r} is of the world {whose!r}, not of {world.name!r}"
        there = {what: len(getattr(world, what)) for what in self.needs}
        few = [what for what, least in self.needs.items() if there[what] < least]
        wanted, has = (
            " and ".join(f"{n[what]} {what if n[what] != 1 else what[:-1]}" for what in few)
            for n in (self.needs, there)
        )
        return f"the family {self.name!r} needs {wanted}; {world.name!r} has {has}" if few else ""

    def draw(self, world: World, rng: np.random.Generator) -> Drawn:
        """Return a situation of a world in which no agent has reached its goal."""
        there = tables_of(world).layouts
        layouts = [number for number in self.layouts if number in there] or [*there]
        reason = ""
        for _ in range(_TRIES):
            try:
                layout = layouts[int(rng.integers(len(layouts)))]
                return self.drawn_with(Draw(world, rng, layout))
            except CannotDraw as refused:
                reason = str(refused)
        raise InvalidSettingError(
            f"family {self.name!r} found no situation in {_TRIES} draws in {world.name!r}"
            + (f", the last since {reason}" if reason else "")
        )

    def drawn_with(self, draw: Draw) -> Drawn:
        """Return the situation of one draw."""
        found = self.function(draw) if self.variant is None else self.function(draw, self.variant)
        if found is None:
            draw.refuse("it returned None")
        told = f"family {self.name!r} drew {shown(found)}, expected a scene and a hypothesis"
        match found:
            case (Scene() as scene, Hypothesis() as roles):
                pass
            case _:
                raise InvalidSettingError(f"{told}, or None")
        if not scene.world == roles.world == draw.world:
            raise InvalidSettingError(f"{told} of the world {draw.world.name!r}")
        n, showing = len(roles.world.agents), len(pairs_showing(self.scenario, roles))
        if showing < (n * (n - 1) // 2 if self.scenario == "independent" else 1):
            raise InvalidSettingError(
                f"family {self.name!r} drew {roles}, which is not {self.scenario}"
            )
        for agent, goal in enumerate(roles.effective_goals):
            literal = goal_literal(goal, agent, draw.world)
            if literal.positive and is_true(literal, scene.start, scene):
                draw.refuse(f"{draw.world.goals[goal]!r} is true at the start")
        what, depth = deepest_overlap(scene)
        if depth > _OVERLAP and not draw.tables.spots:  # some spots are that near the border
            draw.refuse(f"{what} overlap")
        return Drawn(scene, roles, draw.layout)


def pairs_showing(what: str, wanted: Hypothesis) -> list[tuple[int, int]]:
    """Return the pairs of agents whose effective goals make the scenario ``what``."""
    goals = wanted.effective_goals
    return [
        (one, other)
        for one, other in itertools.combinations(range(len(goals)), 2)
        if scenario(goals[one], goals[other], wanted.world, (one, other)) == what
    ]


FAMILIES: Final = Registry[Family]("family", entry_points="phase_ppl.families")
"""Families by name; those of a single world by "NAME of WORLD"."""


def register_family(
    name: str,
    *,
    scenario: str,
    layouts: Sequence[int] = tuple(LAYOUTS),
    variants: Sequence[str] = (),
    world: World | str | None = PHASE,
    agents: int = 1,
    items: int = 0,
    landmarks: int = 1,
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that registers a family of events, a kind of situation, as ``name``.

    The decorated function takes a :class:`phase_ppl.data.generation.situation.Draw` and returns a
    scene and a hypothesis, as ``draw.situation`` does. It may return None: then it is called again
    with a new draw.

    Args:
        name: name of the family, without a colon.
        scenario: scenario of at least one pair of agents in each situation; "independent": of all
            pairs.
        layouts: numbers of PHASE's wall layouts in which the family can be drawn.
        variants: names of the family's variants. If there are some, the function's second argument
            is one of these names.
        world: the family's world, or the name of a ready-made one. None: any world that has the
            least numbers below, and no family of its own of that name.
        agents, items, landmarks: least number of each in a world, if ``world`` is None.

    Raises:
        UnknownNameError: the scenario, a layout or the world is unknown.
        InvalidSettingError: the name is taken by another function or holds a colon, or there are no
            layouts.
    """
    check_name("scenario", scenario, SCENARIOS)
    for layout in layouts:
        if layout not in LAYOUTS:
            raise unknown_name("layout", layout, map(str, LAYOUTS))
    if not layouts or ":" in name:
        raise InvalidSettingError(f"family {name!r}: expected layouts, and a name without ':'")
    given = {"agents": agents, "items": items, "landmarks": landmarks}
    needs = {what: whole_number(what, n, 0) for what, n in given.items()}
    key = name
    if world is not None:
        world, needs = named(world), {}
        key = f"{name} of {world.name}"
    kinds = tuple(variants), tuple(layouts)
    return FAMILIES.register(
        key,
        lambda function, summary: Family(name, function, summary, scenario, *kinds, world, needs),
    )


def _families_of(world: World) -> dict[str, Family]:
    """Return the families of a world by name: its own, and those of any world."""
    able = [family for _, family in FAMILIES.items() if not family.lacks(world)]
    return {one.name: one for one in sorted(able, key=lambda family: family.world is not None)}


def available_families(world: World | str = PHASE) -> list[str]:
    """Return the names of all families, kinds of situations, of a world; sorted.

    ``world`` is a world, or the name of a ready-made one (UnknownNameError: there is none).
    """
    return sorted(_families_of(named(world)))


def family_of(cell: str, world: World = PHASE) -> Family:
    """Return the family, with its variant, for "FAMILY" or "FAMILY:VARIANT" in a world."""
    name, colon, variant = cell.partition(":")
    known = _families_of(world)
    if name not in known:
        for _, family in FAMILIES.items():
            if family.name == name:
                raise InvalidSettingError(family.lacks(world))
        raise unknown_name(f"family of {world.name!r}", name, sorted(known))
    family = known[name]
    if not family.variants and not colon:
        return family
    if variant not in family.variants:
        allowed = [f"{name}:{known}" for known in family.variants] or [name]
        raise unknown_name("variant", cell, allowed)
    return dataclasses.replace(family, variant=variant)


def cells_of(cell: str, world: World) -> list[str]:
    """Return "FAMILY:VARIANT" for all variants, if given a family that has some; else the cell."""
    family = _families_of(world).get(cell)
    variants = () if family is None else family.variants
    return [f"{cell}:{variant}" for variant in variants] or [cell]


def draw_situation(cell: str, world: World | str, seed: int) -> Situation:
    """Return ``(scene, roles)`` that a family draws in a world: a scene and a hypothesis.

    ``phase_ppl.simulate(scene, roles)`` makes an event of them. :func:`phase_ppl.generate` draws
    its situations in this way.

    Args:
        cell: FAMILY or FAMILY:VARIANT, such as "chasing" or "independent:LMO+LMA". LMO is the goal
            to have an item at a landmark, LMA the goal to be at one oneself. The first is the red
            agent's here, the second the green agent's.
        world: the world, or the name of a ready-made one.
        seed: a whole number >= 0. The same seed gives the same situation.

    Raises:
        UnknownNameError: there is no such world, family or variant.
        InvalidSettingError: the world cannot have the family; the family's function returned no
            scene and hypothesis of this world, or goals that do not make the family's scenario; or
            each of 200 draws was refused, such as for overlapping bodies or a goal that is true at
            the start.
    """
    world = named(world)
    rng = np.random.default_rng(whole_number("seed", seed, 0))
    scene, roles, *_ = family_of(cell, world).draw(world, rng)
    return Situation(scene, roles)


# --- the paper's, in PHASE ------------------------------------------------------------------------
# Rooms and sizes are in the order red agent, green agent, blue item, pink item; strengths are of
# the agents. Rooms have the numbers of their landmarks.

_RED, _GREEN, _BLUE, _ = ENTITIES


@register_family("chasing", scenario="opposing")
def chasing(draw: Draw) -> Situation:
    """One agent chases the other."""
    chaser = draw.room()
    chased = draw.room(but=[chaser])
    way = chaser, chased
    return draw.situation(
        {_RED: f"get to {_GREEN}"},
        {(_GREEN, _RED): "hinder"},
        rooms=(chaser, chased, draw.room(), draw.room()),
        size=(draw.size(way), draw.size(way), draw.size(), draw.size()),
        strength=(draw.strength(300), draw.strength(300)),
    )


@register_family("collab", scenario="collaborative")
def collab(draw: Draw) -> Situation:
    """Both want the same item at a landmark and fetch it from the same or from two sides."""
    item = draw.room()
    landmark = draw.landmark(but=[item])
    first = draw.room(but=[item])
    place = draw.chain.index(item)
    sides = draw.chain[:place], draw.chain[place + 1 :]
    across = sides[0] if first in sides[1] else sides[1]
    second = draw.one_of([first, draw.one_of(across)] if across else [first])
    force, way = draw.strength(), (item, landmark)
    return draw.situation(
        f"{_BLUE} to {landmark}",
        rooms=(first, second, item, draw.room()),
        size=(
            draw.size((first, item), way),
            draw.size((second, item), way),
            draw.size(way),
            draw.size(),
        ),
        strength=force,
    )


@register_family("compete", scenario="competing")
def compete(draw: Draw) -> Situation:
    """Both want the same item, at landmarks of their own."""
    item = draw.room()
    red = draw.landmark(but=[item])
    green = draw.landmark(but=[item, red])
    ways = (item, red), (item, green)
    rooms = draw.room(), draw.room()
    return draw.situation(
        (f"{_BLUE} to {red}", f"{_BLUE} to {green}"),
        rooms=(*rooms, item, draw.room()),
        size=(
            *(draw.size((room, item), way) for room, way in zip(rooms, ways, strict=True)),
            draw.size(*ways),
            draw.size(),
        ),
        strength=(draw.strength(300), draw.strength(300)),
    )


NARROW_LAYOUTS = tuple(n for n, lengths in LAYOUTS.items() if 10 - NARROW in lengths)


@register_family("help_blocked", scenario="collaborative", layouts=NARROW_LAYOUTS)
def help_blocked(draw: Draw) -> Situation:
    """A large agent cannot get to its item through a narrow door; a small one helps it."""
    sides = draw.sides_of(draw.narrow_door())
    near = draw.one_of((0, 1))
    helpee = draw.one_of(sides[near])
    landmark = LANDMARKS[draw.one_of(sides[near])]
    item = draw.one_of(sides[1 - near])
    return draw.situation(
        {_GREEN: f"{_BLUE} to {landmark}"},
        {(_RED, _GREEN): "help"},
        rooms=(draw.room(), helpee, item, draw.room()),
        size=(SIZES[0], draw.size(but=SIZES[:1]), SIZES[0], draw.size()),
        strength=(draw.strength(300), draw.strength(300)),
    )


@register_family("help_lift", scenario="collaborative")
def help_lift(draw: Draw) -> Situation:
    """A weak agent is with the item, a stronger one comes; both want the item at a landmark."""
    item = draw.room()
    landmark = draw.landmark(but=[item])
    helper = draw.room(but=[item])
    way = item, landmark
    return draw.situation(
        f"{_BLUE} to {landmark}",
        rooms=(helper, item, item, draw.room()),
        size=(draw.size((helper, item), way), SIZES[0], draw.size(way), draw.size()),
        strength=(draw.strength(300), draw.strength(high=150)),
    )


@register_family("help_move", scenario="collaborative", layouts=NARROW_LAYOUTS)
def help_move(draw: Draw) -> Situation:
    """A large item stands before the door to an agent's landmark; a strong agent helps it."""
    door = draw.narrow_door()
    sides = draw.sides_of(door)
    near = draw.one_of((0, 1))
    beyond = sides[1 - near]
    before_door = draw.one_of(room for room in ROOMS_OF_RAY[door] if room in beyond)
    away = [np.linalg.norm(draw.rooms.door_position[door] - spot) for spot in SPOTS[before_door]]
    nearest = SPOTS[before_door][int(np.argmin(away))]
    return draw.situation(
        {_GREEN: f"{_GREEN} to {LANDMARKS[draw.one_of(beyond)]}"},
        {(_RED, _GREEN): "help"},
        rooms=(draw.one_of(beyond), draw.one_of(sides[near]), nearest, draw.room()),
        size=(draw.size(), SIZES[0], SIZES[2], draw.size()),
        strength=(draw.strength(600), draw.strength(high=300)),
    )


@register_family("hinder", scenario="opposing", variants=("LMA", "LMO"))
def hinder(draw: Draw, variant: str) -> Situation:
    """One wants itself (LMA) or an item (LMO) at a landmark, the other wants it not to be there.

    The original family also has agents that are to touch an item; the 36 goals have none.
    """
    hinderer, hindered, item = draw.room(), draw.room(), draw.room()
    of_item = variant == "LMO"
    mover = item if of_item else hindered
    landmark = draw.landmark(but=[mover])
    way = mover, landmark
    return draw.situation(
        {_GREEN: f"{_BLUE if of_item else _GREEN} to {landmark}"},
        {(_RED, _GREEN): "hinder"},
        rooms=(hinderer, hindered, item, draw.room()),
        size=(
            draw.size((hinderer, mover), way),
            draw.size(way, *[(hindered, mover)] * of_item),
            draw.size(*[way] * of_item),
            draw.size(),
        ),
        strength=(draw.strength(300), draw.strength(300)),
    )


@register_family("independent", scenario="independent", variants=("LMO+LMO", "LMO+LMA", "LMA+LMA"))
def independent(draw: Draw, variant: str) -> Situation:
    """Each agent takes an item of its own (LMO), or itself (LMA), to a landmark."""
    rooms = [draw.room() for _ in ENTITIES]
    goals, sizes, item_sizes = [], [], [draw.size(), draw.size()]
    for agent, kind in enumerate(variant.split("+")):
        moved = agent + len(AGENTS) * (kind == "LMO")
        landmark = draw.landmark(but=[rooms[moved]])
        way = rooms[moved], landmark
        goals.append(f"{ENTITIES[moved]} to {landmark}")
        if kind == "LMO":
            sizes.append(draw.size((rooms[agent], rooms[moved]), way))
            item_sizes[agent] = draw.size(way)
        else:
            sizes.append(draw.size(way))
    return draw.situation(
        goals,
        rooms=rooms,
        size=(*sizes, *item_sizes),
        strength=(draw.strength(), draw.strength()),
    )


# --- in any world ---------------------------------------------------------------------------------


@register_family("independent", scenario="independent", world=None)
def independent_of_any(draw: Draw) -> Situation:
    """Each agent runs an errand that has nothing to do with those of the others."""
    return draw.situation()


@register_family("help", scenario="collaborative", world=None, agents=2, items=1)
def help_of_any(draw: Draw) -> Situation:
    """One agent helps another to get an item somewhere; further agents run errands."""
    helper, helped, *_ = draw.agents()
    goal = draw.errand(helped, of_item=True)
    return draw.situation({helped: goal}, {(helper, helped): "help"})


@register_family("collab", scenario="collaborative", world=None, agents=2, items=1)
def collab_of_any(draw: Draw) -> Situation:
    """Two agents want the same item at the same landmark; further agents run errands."""
    goal = f"{draw.item()} to {draw.landmark()}"
    return draw.situation(dict.fromkeys(draw.agents()[:2], goal))


@register_family("compete", scenario="competing", world=None, agents=2, items=1, landmarks=2)
def compete_of_any(draw: Draw) -> Situation:
    """Two agents want the same item at landmarks of their own; further agents run errands."""
    item, here = draw.item(), draw.landmark()
    places = here, draw.landmark(but=[here])
    goals = [f"{item} to {place}" for place in places]
    return draw.situation(dict(zip(draw.agents(), goals, strict=False)))


@register_family("hinder", scenario="opposing", world=None, agents=2)
def hinder_of_any(draw: Draw) -> Situation:
    """One agent hinders another in an errand; further agents run errands."""
    hinderer, hindered, *_ = draw.agents()
    return draw.situation({hindered: draw.errand(hindered)}, {(hinderer, hindered): "hinder"})


@register_family("chasing", scenario="opposing", world=None, agents=2)
def chasing_of_any(draw: Draw) -> Situation:
    """One agent chases another; further agents run errands."""
    chaser, chased, *_ = draw.agents()
    return draw.situation({chaser: f"get to {chased}"}, {(chased, chaser): "hinder"})
