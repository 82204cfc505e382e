"""Families of events by name: the original eight, those of any cast, and other people's.

A family of one's own is a function that draws a situation::

    @register_family("two_on_one", scenario="collaborative")
    def two_on_one(draw: Draw) -> Situation:
        ...

    @register_family("two_on_one", scenario="collaborative", world=trio)
    def two_on_one(draw: CastDraw) -> CastSituation:
        ...

Families with variants take the variant's name as second argument.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np

from phase_ppl.dataset.generation.situation import (
    LAYOUTS,
    LAYOUTS_OF_A_KIND,
    NARROW,
    NUMBER,
    SIZES,
    SPOTS,
    CannotDraw,
    CastDraw,
    CastSituation,
    Draw,
    Situation,
    agent_to,
    approach,
    item_to,
)
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    check_name,
    shown,
    unknown_name,
    whole_number,
)
from phase_ppl.world.goals import goal_literal, is_true
from phase_ppl.world.hypothesis import (
    RELATION_OF_SCENARIO,
    SCENARIOS,
    STRENGTH_LEVELS,
    Hypothesis,
    Roles,
    scenario,
)
from phase_ppl.world.names import AGENTS, BLUE_ITEM, GREEN, PINK_ITEM, RED
from phase_ppl.world.registry import Registry
from phase_ppl.world.rooms import ROOMS_OF_RAY
from phase_ppl.world.scene import PHASE, Scene, Turning, World
from phase_ppl.world.worlds import named

Drawn = TypeVar("Drawn")
_TRIES: Final = 200  # draws that a layout may refuse before the family is said to be impossible


@dataclasses.dataclass(frozen=True)
class Family:
    """A family of events, of PHASE or of other worlds, perhaps with one of its variants chosen."""

    name: str  # as users call it
    # ``function(draw)`` or, with variants, ``function(draw, variant)``; None: draw anew
    function: Callable[..., Any]
    summary: str  # first line of the function's documentation
    # what its events show; in other worlds some two agents do, with "independent" all, or a single
    # one is alone
    scenario: str
    variants: tuple[str, ...]  # names of its variants; empty where there are none
    layouts: tuple[int, ...]  # numbers of PHASE's layouts that it can be drawn in
    world: World | None  # whose it is; None: any but PHASE with enough of the following
    needs: Mapping[str, int]  # least number of "agents", "items" and "landmarks"
    variant: str | None = None

    @property
    def relation(self) -> str:
        """What its events show."""
        return RELATION_OF_SCENARIO[self.scenario]

    def lacks(self, world: World) -> str:
        """Return why a world other than PHASE cannot have it; "" where it can."""
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

    def draw(self, rng: np.random.Generator, turning: Turning = "both") -> Situation:
        """Return a situation of PHASE in one of the layouts."""

        def once() -> Situation:
            layout = self.layouts[int(rng.integers(len(self.layouts)))]
            return self.drawn_with(Draw(rng, layout, turning))

        return self._tried(once, f"from layouts {list(self.layouts)}")

    def drawn_with(self, draw: Draw) -> Situation:
        """Return the situation of one draw."""
        drawn: Situation = self._called(draw)
        shown = scenario(*drawn.hypothesis.effective_goals)
        if shown != self.scenario:
            raise InvalidSettingError(
                f"family {self.name!r} drew {drawn.hypothesis}, which is {shown}, "
                f"not {self.scenario}"
            )
        return drawn

    def draw_in(self, world: World, seed: int) -> CastSituation:
        """Return a situation of another world, in which nobody is where it wants to get."""
        draw = CastDraw(world, np.random.default_rng(seed))
        return self._tried(lambda: self._drawn_in(draw), f"in {world.name!r}")

    def _drawn_in(self, draw: CastDraw) -> CastSituation:
        found = self._called(draw)
        if found is None:
            draw.refuse("it returned None")
        told = f"family {self.name!r} drew {shown(found)}, expected a scene and roles"
        match found:
            case (Scene() as scene, Roles() as roles):
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
        return CastSituation(scene, roles)

    def _called(self, draw: Draw | CastDraw) -> Any:
        return self.function(draw) if self.variant is None else self.function(draw, self.variant)

    def _tried(self, once: Callable[[], Drawn], where: str) -> Drawn:
        reason = ""
        for _ in range(_TRIES):
            try:
                return once()
            except CannotDraw as refused:
                reason = str(refused)
        raise InvalidSettingError(
            f"family {self.name!r} found no situation in {_TRIES} draws {where}"
            + (f", the last since {reason}" if reason else "")
        )


def pairs_showing(what: str, wanted: Hypothesis | Roles) -> list[tuple[int, int]]:
    """Return the pairs of agents whose effective goals make the scenario ``what``."""
    goals = wanted.effective_goals
    return [
        (one, other)
        for one, other in itertools.combinations(range(len(goals)), 2)
        if scenario(goals[one], goals[other], wanted.world, (one, other)) == what
    ]


FAMILIES: Final = Registry[Family]("family", entry_points="phase_ppl.families")
CAST_FAMILIES: Final = Registry[Family]("family", entry_points="phase_ppl.families")
"""Of other worlds than PHASE, whose names may be the same."""


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
    """Return a decorator that makes a family known under ``name``.

    Args:
        name: as users call it, without a colon.
        scenario: what its events show, in other worlds of some two agents; "independent" of all.
        layouts: numbers of PHASE's layouts that it can be drawn in.
        variants: names of its variants, one of which the function is then given too.
        world: whose it is, or the name of a ready-made one; None: any but PHASE that has enough of
            the following. In PHASE the function takes a ``Draw`` and returns a ``Situation``,
            elsewhere it takes a :class:`CastDraw` and returns a scene and roles, or None for
            another draw.
        agents, items, landmarks: least numbers, where ``world`` is None.

    Raises:
        UnknownNameError: an unknown scenario, layout or world.
        InvalidSettingError: the name is taken by another function, or holds a colon.
    """
    check_name("scenario", scenario, SCENARIOS)
    for layout in layouts:
        if layout not in LAYOUTS:
            raise unknown_name("layout", layout, map(str, LAYOUTS))
    if not layouts or ":" in name:
        raise InvalidSettingError(f"family {name!r}: expected layouts, and a name without ':'")
    world = None if world is None else named(world)
    given = {"agents": agents, "items": items, "landmarks": landmarks}
    least = {what: whole_number(what, n, 0) for what, n in given.items()}
    needs = least if world is None else {}
    registry = FAMILIES if world == PHASE else CAST_FAMILIES
    kinds = tuple(variants), tuple(layouts)
    return registry.register(
        name,
        lambda function, summary: Family(name, function, summary, scenario, *kinds, world, needs),
    )


def available_families(world: World | str = PHASE) -> list[str]:
    """Return the names of all families that a world, or the ready-made one of a name, has."""
    world = named(world)
    if world == PHASE:
        return FAMILIES.names()
    return [name for name, family in CAST_FAMILIES.items() if not family.lacks(world)]


def family_of(cell: str, world: World = PHASE) -> Family:
    """Return the family, with its variant, that "FAMILY" or "FAMILY:VARIANT" names in a world."""
    name, colon, variant = cell.partition(":")
    if world == PHASE:
        family = FAMILIES[name]
    elif name in CAST_FAMILIES.names():
        family = CAST_FAMILIES[name]
        if lacking := family.lacks(world):
            raise InvalidSettingError(lacking)
    elif name in FAMILIES.names():
        raise InvalidSettingError(
            f"the family {name!r} is for the world PHASE only, not {world.name!r}"
        )
    else:
        raise unknown_name(f"family of {world.name!r}", name, available_families(world))
    if not family.variants and not colon:
        return family
    if variant not in family.variants:
        allowed = [f"{name}:{known}" for known in family.variants] or [name]
        raise unknown_name("variant", cell, allowed)
    return dataclasses.replace(family, variant=variant)


def draw_situation(cell: str, world: World | str, seed: int) -> CastSituation:
    """Return the scene and roles that a family draws in another world than PHASE.

    As :func:`phase_ppl.generate` does; ``phase_ppl.simulate(scene, roles, ...)`` takes them.

    Args:
        cell: FAMILY or FAMILY:VARIANT.
        world: the world, or the name of a ready-made one.
        seed: the same seed gives the same situation.

    Raises:
        UnknownNameError: there is no such world, family or variant.
        InvalidSettingError: the world is PHASE, or cannot have the family; or what the family draws
            is not what it should be, or nothing.
    """
    world = named(world)
    if world == PHASE:
        raise InvalidSettingError("draw_situation knows other worlds only, not 'PHASE'")
    return family_of(cell, world).draw_in(world, whole_number("seed", seed, 0))


@register_family("chasing", scenario="opposing")
def chasing(draw: Draw) -> Situation:
    """One agent chases the other."""
    chaser = draw.room()
    chased = draw.room(but=[chaser])
    return draw.situation(
        (approach(RED), approach(GREEN)),
        (0, -1),
        (chaser, chased, draw.room(), draw.room()),
        (
            draw.size((chaser, chased)),
            draw.size((chaser, chased)),
            draw.any_size(),
            draw.any_size(),
        ),
        (draw.strength(1, 2, 3), draw.strength(1, 2, 3)),
    )


@register_family("collab", scenario="collaborative")
def collab(draw: Draw) -> Situation:
    """Both want the same item at a landmark and fetch it from the same or from two sides."""
    item = draw.room()
    landmark = draw.room(but=[item])
    first = draw.room(but=[item])
    chain = draw.chain
    place = chain.index(item)
    sides = chain[:place], chain[place + 1 :]
    across = sides[0] if first in sides[1] else sides[1]
    second = draw.one_of([first, draw.one_of(across)] if across else [first])
    force = draw.strength()
    return draw.situation(
        (item_to(BLUE_ITEM, landmark),) * 2,
        (0, 0),
        (first, second, item, draw.room()),
        (
            draw.size((first, item), (item, landmark)),
            draw.size((second, item), (item, landmark)),
            draw.size((item, landmark)),
            draw.any_size(),
        ),
        (force, force),
    )


@register_family("compete", scenario="competing")
def compete(draw: Draw) -> Situation:
    """Both want the same item, at landmarks of their own."""
    item = draw.room()
    red = draw.room(but=[item])
    green = draw.room(but=[item, red])
    rooms = draw.room(), draw.room()
    return draw.situation(
        (item_to(BLUE_ITEM, red), item_to(BLUE_ITEM, green)),
        (0, 0),
        (*rooms, item, draw.room()),
        (
            draw.size((rooms[0], item), (item, red)),
            draw.size((rooms[1], item), (item, green)),
            draw.size((item, red), (item, green)),
            draw.any_size(),
        ),
        (draw.strength(1, 2, 3), draw.strength(1, 2, 3)),
    )


NARROW_LAYOUTS = tuple(n for n, lengths in LAYOUTS.items() if 10 - NARROW in lengths)


@register_family("help_blocked", scenario="collaborative", layouts=NARROW_LAYOUTS)
def help_blocked(draw: Draw) -> Situation:
    """A large agent cannot get to its item through a narrow door; a small one helps it."""
    sides = draw.sides_of(draw.narrow_door())
    near = draw.one_of((0, 1))
    helpee = draw.one_of(sides[near])
    landmark = draw.one_of(sides[near])
    item = draw.one_of(sides[1 - near])
    return draw.situation(
        # what the helper would want for itself does not matter: it acts on the other's goal
        (item_to(BLUE_ITEM, landmark),) * 2,
        (1, 0),
        (draw.room(), helpee, item, draw.room()),
        (SIZES[0], draw.any_size(but=SIZES[:1]), SIZES[0], draw.any_size()),
        (draw.strength(1, 2, 3), draw.strength(1, 2, 3)),
    )


@register_family("help_lift", scenario="collaborative")
def help_lift(draw: Draw) -> Situation:
    """A weak agent is with the item, a stronger one comes; both want the item at a landmark."""
    item = draw.room()
    landmark = draw.room(but=[item])
    helper = draw.room(but=[item])
    return draw.situation(
        (item_to(BLUE_ITEM, landmark),) * 2,
        (0, 0),
        (helper, item, item, draw.room()),
        (
            draw.size((helper, item), (item, landmark)),
            SIZES[0],
            draw.size((item, landmark)),
            draw.any_size(),
        ),
        (draw.strength(1, 2, 3), draw.strength(0)),
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
    goal = agent_to(GREEN, draw.one_of(beyond))
    return draw.situation(
        (goal, goal),
        (1, 0),
        (draw.one_of(beyond), draw.one_of(sides[near]), before_door, draw.room()),
        (draw.any_size(), SIZES[0], SIZES[2], draw.any_size()),
        (draw.strength(3), draw.strength(0, 1)),
        at={BLUE_ITEM: SPOTS[before_door][int(np.argmin(away))]},
    )


@register_family("hinder", scenario="opposing", variants=("LMA", "LMO"))
def hinder(draw: Draw, variant: str) -> Situation:
    """One wants itself (LMA) or an item (LMO) at a landmark, the other wants it not to be there.

    The original family also has agents that are to touch an item; the 36 goals have none.
    """
    hinderer, hindered, item = draw.room(), draw.room(), draw.room()
    mover = hindered if variant == "LMA" else item
    landmark = draw.room(but=[mover])
    goal = agent_to(GREEN, landmark) if variant == "LMA" else item_to(BLUE_ITEM, landmark)
    ways = [(mover, landmark)] + [(hindered, mover)] * (variant == "LMO")
    return draw.situation(
        (goal, goal),
        (-1, 0),
        (hinderer, hindered, item, draw.room()),
        (
            draw.size((hinderer, mover), (mover, landmark)),
            draw.size(*ways),
            draw.size((item, landmark)) if variant == "LMO" else draw.any_size(),
            draw.any_size(),
        ),
        (draw.strength(1, 2, 3), draw.strength(1, 2, 3)),
    )


@register_family("independent", scenario="independent", variants=("LMO+LMO", "LMO+LMA", "LMA+LMA"))
def independent(draw: Draw, variant: str) -> Situation:
    """Each agent takes an item of its own (LMO), or itself (LMA), to a landmark."""
    agents = [draw.room() for _ in AGENTS]
    items = [draw.room(), draw.room()]
    goals, sizes, item_sizes = [], [], [draw.any_size(), draw.any_size()]
    for agent, kind in enumerate(variant.split("+")):
        moved = items[agent] if kind == "LMO" else agents[agent]
        landmark = draw.room(but=[moved])
        if kind == "LMO":
            goals.append(item_to((BLUE_ITEM, PINK_ITEM)[agent], landmark))
            sizes.append(draw.size((agents[agent], moved), (moved, landmark)))
            item_sizes[agent] = draw.size((moved, landmark))
        else:
            goals.append(agent_to(agent, landmark))
            sizes.append(draw.size((moved, landmark)))
    return draw.situation(
        (goals[0], goals[1]),
        (0, 0),
        (*agents, *items),
        (*sizes, *item_sizes),
        (draw.strength(), draw.strength()),
    )


# --- in worlds of any cast ------------------------------------------------------------------------


@register_family("independent", scenario="independent", world=None)
def independent_of_any(draw: CastDraw) -> CastSituation:
    """Each agent runs an errand that has nothing to do with those of the others."""
    return draw.situation()


@register_family("help", scenario="collaborative", world=None, agents=2, items=1)
def help_of_any(draw: CastDraw) -> CastSituation:
    """One agent helps another to get an item somewhere; further agents run errands."""
    helper, helped, *_ = draw.agents()
    goal = draw.errand(helped, of_item=True)
    return draw.situation({helped: goal}, {(helper, helped): "help"})


@register_family("collab", scenario="collaborative", world=None, agents=2, items=1)
def collab_of_any(draw: CastDraw) -> CastSituation:
    """Two agents want the same item at the same landmark; further agents run errands."""
    goal = f"{draw.item()} to {draw.landmark()}"
    return draw.situation(dict.fromkeys(draw.agents()[:2], goal))


@register_family("compete", scenario="competing", world=None, agents=2, items=1, landmarks=2)
def compete_of_any(draw: CastDraw) -> CastSituation:
    """Two agents want the same item at landmarks of their own; further agents run errands."""
    item, here = draw.item(), draw.landmark()
    places = here, draw.landmark(but=[here])
    goals = [f"{item} to {place}" for place in places]
    return draw.situation(dict(zip(draw.agents(), goals, strict=False)))


@register_family("hinder", scenario="opposing", world=None, agents=2)
def hinder_of_any(draw: CastDraw) -> CastSituation:
    """One agent hinders another in an errand; further agents run errands."""
    hinderer, hindered, *_ = draw.agents()
    return draw.situation({hindered: draw.errand(hindered)}, {(hinderer, hindered): "hinder"})


@register_family("chasing", scenario="opposing", world=None, agents=2)
def chasing_of_any(draw: CastDraw) -> CastSituation:
    """One agent chases another; further agents run errands."""
    chaser, chased, *_ = draw.agents()
    return draw.situation({chaser: f"get to {chased}"}, {(chased, chaser): "hinder"})


# --- the same situation elsewhere -----------------------------------------------------------------
# In a layout of the same kind, or with sizes and strengths moved: a family is asked to draw once
# more, and gets the choices of the earlier draw, in the other layout or with every size and
# strength one id further. Where it was not offered such a choice, its rules do not hold, and there
# is none.

_STEPS: Final = (1, -1)
"""How far ids of sizes and strengths are moved; ids are not turned over at the ends."""

MOST_CHANGES: Final = max(map(len, LAYOUTS_OF_A_KIND)) - 1 + len(_STEPS)
"""Changes that any situation has at most."""


class Change(NamedTuple):
    """What differs from the situation that was drawn first."""

    layout: int  # number of the layout
    ids: int = 0  # by how much all ids of sizes and strengths are moved: 0, 1 or -1

    @property
    def name(self) -> str:
        """A short name, such as "layout-17" or "ids-up"."""
        return {0: f"layout-{self.layout}", 1: "ids-up", -1: "ids-down"}[self.ids]

    def described(self, before: Situation) -> dict[str, Any]:
        """Return as plain data how it differs from the situation that was drawn first."""
        return {"ids_moved_by": self.ids} if self.ids else {"layout_before": before.layout}


def changed(family: Family, situation: Situation) -> list[tuple[Change, Situation]]:
    """Return all situations that are a situation in another layout, or with ids moved by one.

    Goals, alpha and all places and angles at the start are those of the first.
    """
    kinds = [kind for kind in LAYOUTS_OF_A_KIND if situation.layout in kind]
    changes = [
        *(Change(layout) for kind in kinds for layout in kind
          if layout != situation.layout and layout in family.layouts),
        *(Change(situation.layout, step) for step in _STEPS),
    ]  # fmt: skip
    found = ((change, _redrawn(family, situation, change)) for change in changes)
    return [(change, other) for change, other in found if other is not None]


def _redrawn(family: Family, situation: Situation, change: Change) -> Situation | None:
    sizes = _moved(situation.scene.radius.tolist(), SIZES, change.ids)
    strengths = _moved(situation.hypothesis.strengths, STRENGTH_LEVELS, change.ids)
    if sizes is None or strengths is None:
        return None
    try:
        found = family.drawn_with(_Redraw(situation, change))
    except CannotDraw:
        return None
    # what a family fixes is not moved, and what it draws elsewhere than from a Draw is drawn anew
    before, after = situation.hypothesis, found.hypothesis
    same = (
        (before.goal_red, before.goal_green, before.alpha)
        == (after.goal_red, after.goal_green, after.alpha)
        and np.array_equal(found.scene.start, situation.scene.start)
        and found.scene.radius.tolist() == sizes
        and list(after.strengths) == strengths
    )
    return found if same else None


def _moved(values: Sequence[float], levels: Sequence[float], by: int) -> list[float] | None:
    """Return values so many ids further; None where one is not a level, or there is none."""
    if not by:
        return list(values)
    ids = [levels.index(value) + by if value in levels else -1 for value in values]
    return [levels[i] for i in ids] if all(0 <= i < len(levels) for i in ids) else None


class _Redraw(Draw):
    """A draw that makes the choices of an earlier one, but for a change."""

    def __init__(self, earlier: Situation, change: Change) -> None:
        super().__init__(np.random.default_rng(0), change.layout, earlier.scene.turning)
        self._left = deque(earlier.choices)
        self._start = earlier.scene.start
        self._ids = change.ids

    def _value(self, kind: str, options: Sequence[int]) -> int:
        if not self._left or self._left[0].kind != kind:
            raise CannotDraw
        value = self._left.popleft().value + (0 if kind == NUMBER else self._ids)
        if value not in options:
            raise CannotDraw
        return value

    def _arrangements(
        self, rooms: Sequence[int], at: Mapping[int, tuple[float, float]]
    ) -> Iterator[FloatArray]:
        for entity, room in enumerate(rooms):
            places = (at[entity],) if entity in at else SPOTS[room]
            if tuple(self._start[entity, :2]) not in places:
                return
        yield self._start
