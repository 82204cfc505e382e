"""What is left to do for a goal, in symbols: the cost of the cheapest plan, without physics.

Plans are those of SIMPLE's subgoal planner (:mod:`phase_ppl.agents.operators`) by bodies that can
do everything: they pass every door, close none, and carry any item alone. Costs are its too:
lengths of ways from room to room, and constants for touching, gripping and placing.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Final

from phase_ppl.agents.operators import Abilities, Node, Step, moves, plan
from phase_ppl.models.predicate.symbols import SymbolicState
from phase_ppl.world.literals import Literal, Predicate
from phase_ppl.world.names import AGENTS, ENTITIES, ITEMS, NOTHING
from phase_ppl.world.rooms import N_ROOMS
from phase_ppl.world.scene import Scene

_ALL: Final = frozenset(range(len(ENTITIES)))
_CLEAR: Final = (NOTHING, NOTHING)
"""No item closes a door."""
_TIE: Final = 1e-6


def without_physics(scene: Scene) -> Abilities:
    """Return abilities that know the layout of a scene and no sizes, strengths or masses."""
    able = Abilities.of(scene, (math.inf, math.inf))
    doors = range(len(scene.rooms.door_width))
    return dataclasses.replace(
        able,
        passes=tuple(tuple(True for _ in doors) for _ in ENTITIES),
        fills=tuple(tuple(False for _ in doors) for _ in ITEMS),
    )


def operators(node: Node, agent: int, touched: Sequence[int], abilities: Abilities) -> list[Step]:
    """Return all that an agent can do in a state.

    Args:
        node: the state, in which an agent is at one entity only.
        agent: 0 red, 1 green.
        touched: all entities that it touches: none is touched anew, and any item among them can
            be gripped.
        abilities: of the bodies.
    """
    found = dict[Literal, Step]()
    for near in dict.fromkeys([node.near[agent], *touched]):
        at = tuple(near if a == agent else other for a, other in enumerate(node.near))
        for step in moves(node._replace(near=at), agent, (agent,), _ALL, abilities):  # type: ignore[arg-type]
            predicate, _, target, positive = step.literal
            if predicate is Predicate.TOUCH and target in touched:
                continue
            if predicate is Predicate.ATTACH and positive:
                step = step._replace(result=step.result._replace(near=node.near))
            found.setdefault(step.literal, step)
    return list(found.values())


class CostToGo:
    """Cost of the cheapest plan of one agent to what its goal means in symbols.

    =====================  =================================================================
    goal                   done when
    =====================  =================================================================
    ON(self | item, l)     it is on the landmark
    TOUCH(self, other)     it touches the other
    ON(other, l)           always: the other goes by itself
    not ON(self, l)        it is in the room farthest from the landmark
    not TOUCH(self, other) it is in the room farthest from the other's
    not ON(item, l)        it holds the item in the room farthest from the landmark
    not ON(other, l)       it touches the other: without physics there is no other way to
                           hinder anyone
    =====================  =================================================================

    Farthest of the rooms in reach; none is farther than one without a way.

    Args:
        abilities: of the bodies, :func:`without_physics`.
        agent: who plans, 0 red or 1 green.
        goal: literal of its effective goal.
    """

    def __init__(self, abilities: Abilities, agent: int, goal: Literal) -> None:
        self.abilities, self.agent, self.goal = abilities, agent, goal
        item = goal.subject if goal.subject >= len(AGENTS) else NOTHING
        chased = goal.predicate is Predicate.TOUCH and goal.positive
        hindered = goal.subject == 1 - agent and not goal.positive
        self.focus = item if item != NOTHING else (1 - agent if chased or hindered else NOTHING)
        """The entity that the agent has to be at for the goal, or ``NOTHING``."""
        self._known: dict[Node, float] = {}

    def __call__(self, node: Node) -> float:
        """Return the cost, units of way; inf where there is no plan."""
        relevant = self._relevant(node)
        if relevant not in self._known:
            self._known[relevant] = self._cost(relevant)
        return self._known[relevant]

    def node(self, state: SymbolicState) -> Node:
        """Return a symbolic state as the planner's: being at the focus counts first."""
        near = list[int]()
        for agent, touched in enumerate(state.near):
            at = [entity for entity, yes in enumerate(touched) if yes]
            first = self.focus if agent == self.agent and self.focus in at else NOTHING
            near.append(first if first != NOTHING else next(iter(at), NOTHING))
        return Node(state.rooms, state.held, tuple(near), state.placed, _CLEAR)  # type: ignore[arg-type]

    def _relevant(self, node: Node) -> Node:
        """Return the node without what makes no difference to the goal."""
        agent, literal = self.agent, self.goal
        entities = {agent, literal.subject}
        if literal.predicate is Predicate.TOUCH:
            entities.add(literal.target)
        near = [NOTHING, NOTHING]
        if self.focus != NOTHING and node.near[agent] == self.focus:
            near[agent] = self.focus
        held = [NOTHING, NOTHING]
        held[agent] = node.held[agent]
        return Node(
            tuple(room if e in entities else 0 for e, room in enumerate(node.rooms)),  # type: ignore[arg-type]
            tuple(held),  # type: ignore[arg-type]
            tuple(near),  # type: ignore[arg-type]
            tuple(yes and e == literal.subject for e, yes in enumerate(node.placed)),  # type: ignore[arg-type]
            _CLEAR,
        )

    def _cost(self, node: Node) -> float:
        agent, (predicate, subject, target, positive) = self.agent, self.goal
        if predicate is Predicate.ON and positive:
            if subject == 1 - agent:
                return 0.0
            return self._plan(
                node, {subject}, lambda n: n.placed[subject] and n.rooms[subject] == target
            )
        if predicate is Predicate.ON and subject >= len(AGENTS):
            away = self._farthest(target, node.rooms[subject])
            return self._plan(
                node, {subject}, lambda n: n.held[agent] == subject and n.rooms[subject] in away
            )
        if positive or subject == 1 - agent:
            return self._plan(node, {1 - agent}, lambda n: n.near[agent] == 1 - agent)
        fled = node.rooms[target] if predicate is Predicate.TOUCH else target
        away = self._farthest(fled, node.rooms[agent])
        return self._plan(node, set(), lambda n: n.rooms[agent] in away)

    def _plan(self, node: Node, targets: set[int], is_goal: Callable[[Node], bool]) -> float:
        steps = plan(
            node, (self.agent,), frozenset(targets), is_goal, lambda n: 0.0, self.abilities
        )
        return math.inf if steps is None else sum(step.cost for step in steps)

    def _farthest(self, room: int, start: int) -> frozenset[int]:
        """Return the rooms farthest from ``room``, of those that one gets to from ``start``.

        None is farther than one without a way to it.
        """
        distance = self.abilities.room_distance
        there = [r for r in range(N_ROOMS) if math.isfinite(distance[start][r])]
        most = max(distance[room][r] for r in there)
        return frozenset(r for r in there if distance[room][r] >= most - _TIE)


@functools.lru_cache(maxsize=1024)
def cost_to_go(abilities: Abilities, agent: int, goal: Literal) -> CostToGo:
    """Return the cost to go for these arguments; scenes of one layout share what it knows."""
    return CostToGo(abilities, agent, goal)
