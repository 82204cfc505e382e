"""The world in symbols for the subgoal planner: states, operators, and A* over them.

A belief particle becomes a symbolic state. Operators of agents: go to a room, touch, attach, carry
(one or more holders) to a room, place on the landmark, let go, settle on a landmark, stand in a
door. Preconditions come from the physics: door width against size, force of the holders against
floor friction, and holds. Costs are path lengths between rooms.

Source: paper, Appendices "Predicates, Symbolic States, Goals, and Subgoals" and "Hierarchical
Planner". The paper names A* and the predicates; the operators are ours.
"""

from __future__ import annotations

import functools
import heapq
import itertools
import struct
import typing
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.world_model import (
    DISTANCE_UNIT,
    Abilities,
    Layout,
    body_origin,
    path_distance,
    room_of,
)
from phase_ppl.physics.compiled import Params
from phase_ppl.physics.jit import bare_kernel
from phase_ppl.physics.welds import in_reach
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.names import NOTHING, Literal, PredicateKind

NEAR_AGENT_ON: Final = 0.02 * DISTANCE_UNIT
"""An agent is done with ON(itself, landmark) this close to the centre, units."""

NEAR_ITEM_ON: Final = 0.05 * DISTANCE_UNIT  # likewise for ON(item, landmark)
NEAR_TOUCH: Final = 0.1 * DISTANCE_UNIT  # likewise for TOUCH
NO_DOOR: Final = -1
_ON, _TOUCH = int(PredicateKind.ON), int(PredicateKind.TOUCH)


class SymbolicState(NamedTuple):
    """The facts that hold in one particle."""

    rooms: tuple[int, ...]  # room of each entity (0 for all in an arena without inner walls)
    held: tuple[int, ...]  # item held by each agent, or ``NOTHING``
    in_reach: tuple[bool, ...]  # agent by agent, whether it can grab each item
    # whether the positive forms of the agent's own goal and of the other's are reached
    own_done: bool
    other_done: bool
    door_filled_by: tuple[int, ...]  # the door that each item closes, or ``NO_DOOR``


class Facts(NamedTuple):
    """The layout of a row of facts from :func:`describe`, by numbers of entities and agents."""

    n_entities: int
    n_agents: int

    @property
    def size(self) -> int:
        """Length of a row."""
        n_items = self.n_entities - self.n_agents
        return self.n_entities + self.n_agents + self.n_agents * n_items + n_items

    def unpack(self, row: bytes, own_done: bool, other_done: bool) -> SymbolicState:
        """Return the symbolic state of one row."""
        held, reach = self.n_entities, self.n_entities + self.n_agents
        doors = len(row) - (self.n_entities - self.n_agents)
        f = struct.unpack(f"{len(row)}b", row)
        able = tuple(map(bool, f[reach:doors]))
        return SymbolicState(f[:held], f[held:reach], able, own_done, other_done, f[doors:])


@bare_kernel
def _done(bodies: FloatArray, goal: IntArray, params: Params, layout: Layout) -> bool:
    x, y = body_origin(bodies, goal[1], params.cog)
    if goal[0] == _ON:
        near = NEAR_ITEM_ON if goal[1] >= params.force.shape[0] else NEAR_AGENT_ON
        lx, ly = layout.landmarks[goal[2], 0], layout.landmarks[goal[2], 1]
        return path_distance(x, y, lx, ly, layout) < near
    tx, ty = body_origin(bodies, goal[2], params.cog)
    return path_distance(x, y, tx, ty, layout) < NEAR_TOUCH


@bare_kernel
def _cost_to_go(
    bodies: FloatArray,
    held: IntArray,
    agent: int,
    goal: IntArray,
    whole: bool,
    params: Params,
    layout: Layout,
) -> float:
    if goal[3] < 0:
        return 0.0
    moved, target = goal[1], goal[2]
    if goal[0] == _TOUCH and moved != agent and target >= params.force.shape[0]:
        moved, target = target, moved  # an item is brought to another agent
    x, y = body_origin(bodies, agent, params.cog)
    sx, sy = body_origin(bodies, moved, params.cog)
    before = 0.0
    if moved != agent and held[agent] != moved:
        before = path_distance(x, y, sx, sy, layout)
        if not whole:
            return before
    if goal[0] == _ON:
        lx, ly = layout.landmarks[goal[2], 0], layout.landmarks[goal[2], 1]
        return before + path_distance(sx, sy, lx, ly, layout)
    tx, ty = body_origin(bodies, target, params.cog)
    return before + path_distance(sx, sy, tx, ty, layout)


@bare_kernel
def describe(
    bodies: FloatArray,
    held: IntArray,
    agent: int,
    goals: IntArray,
    whole: BoolArray,
    params: Params,
    layout: Layout,
    facts: NDArray[np.int8],
    done: BoolArray,
    costs: FloatArray,
) -> None:
    """Write the facts of every particle, and how near goals are in it.

    Args:
        bodies, held: (K, ...) particles.
        agent: who plans.
        goals: (G, 4) codes of goal literals, the agent's own or the other's.
        whole: (G,) whether its cost is of the whole plan, not of a leg.
        facts: (K, Facts.size) output, the fields of :class:`SymbolicState` in order, without those
            that depend on goals.
        done: (G, K) output, whether the positive form of each goal is reached.
        costs: (G, K) output, the cost C of Algorithm 1 to each goal, units; 0 for negative goals.
            It is the path length of the present leg, to the item or from there to the goal, or of
            both.
    """
    n_bodies, n_agents = bodies.shape[1], held.shape[1]
    n_items = n_bodies - n_agents
    reach, filled = n_bodies + n_agents, n_bodies + n_agents + n_agents * n_items
    others = params.radius[agent] if n_agents == 1 else 0.0  # size of the largest other agent
    for a in range(n_agents):
        if a != agent:
            others = max(others, params.radius[a])
    for k in range(bodies.shape[0]):
        particle = bodies[k]
        for entity in range(n_bodies):
            x, y = body_origin(particle, entity, params.cog)
            facts[k, entity] = 0 if layout.is_open else room_of(x, y, layout)
        for a in range(n_agents):
            facts[k, n_bodies + a] = held[k, a]
            for i in range(n_items):
                facts[k, reach + n_items * a + i] = in_reach(particle, a, n_agents + i, params)
        for i in range(n_items):
            facts[k, filled + i] = NO_DOOR
            for door in range(layout.door_width.shape[0]):
                if layout.is_open or layout.door_width[door] <= 0.0:
                    continue
                dx = particle[n_agents + i, 0] - layout.doors[door, 0]
                dy = particle[n_agents + i, 1] - layout.doors[door, 1]
                # a narrower item can be pushed through
                radius = params.radius[n_agents + i]
                if 2.0 * radius <= layout.door_width[door]:
                    continue
                if dx * dx + dy * dy < (radius + others) ** 2:
                    facts[k, filled + i] = door
        for g in range(goals.shape[0]):
            done[g, k] = _done(particle, goals[g], params, layout)
            costs[g, k] = _cost_to_go(particle, held[k], agent, goals[g], whole[g], params, layout)


# --- operators ---------------------------------------------------------------------------------

TOUCH_COST: Final = 3.0
GRIP_COST: Final = 0.5
PLACE_COST: Final = 3.0
MAX_EXPANSIONS: Final = 4000


class Node(NamedTuple):
    """A state of the search: rooms and holds change; ``near`` and ``placed`` are facts reached."""

    rooms: tuple[int, ...]
    held: tuple[int, ...]
    near: tuple[int, ...]
    """Entity each agent is at, within grab range, or ``NOTHING``."""
    placed: tuple[bool, ...]
    """Whether each entity has been brought to the landmark of its room."""
    door_filled_by: tuple[int, ...]
    """Door that each item closes, or ``NO_DOOR``."""


class Target(NamedTuple):
    """What a plan shall attain: a field of an entity has one of some values."""

    field: typing.Literal["rooms", "held", "door_filled_by"]
    entity: int  # index in ``field`` of a node: among entities, agents or items
    values: frozenset[int]
    placed: bool = False  # and the entity has been brought to the landmark of its room

    def reached(self, node: Node) -> bool:
        """Whether a state attains it."""
        value = getattr(node, self.field)[self.entity]
        return value in self.values and (not self.placed or node.placed[self.entity])


class Step(NamedTuple):
    """One operator in a plan: who acts, the subgoal literal, and the state it leads to."""

    agents: tuple[int, ...]
    literal: Literal
    cost: float
    result: Node


def _set(values: tuple, index: int, value: object) -> tuple:  # type: ignore[type-arg]
    return (*values[:index], value, *values[index + 1 :])


def start_node(state: SymbolicState, done: tuple[bool, ...], targets: frozenset[int]) -> Node:
    """Return the search node of a symbolic state; only targets count as near."""
    n_agents, n_items = len(state.held), len(state.door_filled_by)
    near = [NOTHING] * n_agents
    for agent, item in np.argwhere(np.reshape(state.in_reach, (n_agents, n_items))).tolist():
        if near[agent] == NOTHING and n_agents + item in targets:
            near[agent] = n_agents + item
    return Node(state.rooms, state.held, tuple(near), done, state.door_filled_by)


def _door_free(node: Node, abilities: Abilities, door: int, carried: int) -> bool:
    return not any(
        filled == door and abilities.fills[item][door] and len(node.held) + item != carried
        for item, filled in enumerate(node.door_filled_by)
    )


def moves(
    node: Node, agent: int, willing: tuple[int, ...], targets: frozenset[int], abilities: Abilities
) -> Iterator[Step]:
    """Yield the operators of one agent that can be used in a state.

    Args:
        node: the state.
        agent: who acts.
        willing: agents that take part in the plan.
        targets: entities that matter; others are not touched, carried or placed.
        abilities: what the bodies can do.
    """
    rooms, held, near, placed, filled = node
    n_agents, item, room = len(held), held[agent], rooms[agent]
    actors: tuple[int, ...] = (agent,)

    def step(predicate: PredicateKind, subject: int, target: int, cost: float, node: Node) -> Step:
        return Step(actors, Literal(predicate, subject, target), cost, node)

    if item == NOTHING:
        for door, following in abilities.neighbours[room]:
            if abilities.passes[agent][door] and _door_free(node, abilities, door, NOTHING):
                there = _set(rooms, agent, following), held, _set(near, agent, NOTHING)
                after = Node(*there, _set(placed, agent, False), filled)
                length = abilities.room_distance[room][following]
                yield step(PredicateKind.CLOSE, agent, following, length, after)
        for target in targets:
            if target != agent and rooms[target] == room and near[agent] != target:
                after = Node(rooms, held, _set(near, agent, target), placed, filled)
                yield step(PredicateKind.TOUCH, agent, target, TOUCH_COST, after)
        target = near[agent]
        if target >= n_agents and target in targets:
            after = Node(rooms, _set(held, agent, target), near, placed, filled)
            yield step(PredicateKind.ATTACH, agent, target, GRIP_COST, after)
        landmark = abilities.landmark_in[room]
        if agent in targets and not placed[agent] and landmark != NOTHING:
            after = Node(rooms, held, near, _set(placed, agent, True), filled)
            yield step(PredicateKind.ON, agent, landmark, PLACE_COST, after)
        return
    after = Node(rooms, _set(held, agent, NOTHING), _set(near, agent, item), placed, filled)
    yield Step(actors, Literal(PredicateKind.ATTACH, agent, item, positive=False), GRIP_COST, after)
    others = [a for a, thing in enumerate(held) if a != agent and thing == item]
    actors = (agent, *(other for other in others if other in willing))
    if not abilities.carries(*actors, holders=1 + len(others)) or item not in targets:
        return
    movers = (agent, item, *others)
    emptied = _set(filled, item - n_agents, NO_DOOR)
    apart = [e for e in movers if abilities.route((e,), rooms[e], rooms[item]) is None]
    for door, following in abilities.neighbours[rooms[item]]:
        # a holder beyond the door need not pass it; one before it must be with the item
        passing = all(
            abilities.passes[e][door] and e not in apart for e in movers if rooms[e] != following
        )
        if passing and _door_free(node, abilities, door, item):
            moved, lifted = rooms, placed
            for entity in movers:
                moved, lifted = _set(moved, entity, following), _set(lifted, entity, False)
            length = abilities.room_distance[rooms[item]][following]
            after = Node(moved, held, near, lifted, emptied)
            yield step(PredicateKind.CLOSE, item, following, length, after)
    landmark = abilities.landmark_in[rooms[item]]
    if not apart and not placed[item] and landmark != NOTHING:
        after = Node(rooms, held, near, _set(placed, item, True), emptied)
        yield step(PredicateKind.ON, item, landmark, PLACE_COST, after)


def plan(
    start: Node,
    willing: tuple[int, ...],
    targets: frozenset[int],
    is_goal: Callable[[Node], bool],
    heuristic: Callable[[Node], float],
    abilities: Abilities,
    hopeless: set[Node] | None = None,
) -> list[Step] | None:
    """Return the cheapest sequence of operators to a goal node by A*, or None.

    Args:
        start: where the search begins.
        willing: agents whose operators may be used.
        targets: entities that matter to the goal; others are not touched or carried.
        is_goal: goal test.
        heuristic: admissible lower bound of the cost left.
        hopeless: states known not to lead to the goal. If a search runs out of states, all states
            that it saw are added.
    """
    if hopeless is not None and start in hopeless:
        return None
    order = itertools.count()
    frontier: list[tuple[float, int, float, Node]] = [(heuristic(start), next(order), 0.0, start)]
    best = {start: 0.0}
    came: dict[Node, tuple[Node, Step]] = {}
    for _ in range(MAX_EXPANSIONS):
        if not frontier:
            if hopeless is not None:
                hopeless.update(best)
            return None
        _, _, cost, node = heapq.heappop(frontier)
        if cost > best[node]:
            continue
        if is_goal(node):
            steps: list[Step] = []
            while node in came:
                node, step = came[node]
                steps.append(step)
            return steps[::-1]
        for agent in willing:
            for step in moves(node, agent, willing, targets, abilities):
                total = cost + step.cost
                if total < best.get(step.result, np.inf):
                    best[step.result] = total
                    came[step.result] = (node, step)
                    estimate = total + heuristic(step.result)
                    heapq.heappush(frontier, (estimate, next(order), total, step.result))
    return None


Finder = Callable[
    [Node, tuple[int, ...], frozenset[int], Target, tuple[int, int] | None], list[Step] | None
]
"""Arguments as for :func:`plan`, then an entity and the room that it must reach, or none. The room
gives a lower bound of the cost left."""


def plans_of(abilities: Abilities) -> Finder:
    """Return the finder of cheapest plans for bodies; it remembers each plan."""
    distance = abilities.room_distance
    hopeless: defaultdict[tuple[object, ...], set[Node]] = defaultdict(set)

    @functools.cache
    def find(
        start: Node,
        willing: tuple[int, ...],
        targets: frozenset[int],
        goal: Target,
        heading: tuple[int, int] | None,
    ) -> list[Step] | None:
        def heuristic(node: Node) -> float:
            return 0.0 if heading is None else distance[node.rooms[heading[0]]][heading[1]]

        known = hopeless[willing, targets, goal]
        return plan(start, willing, targets, goal.reached, heuristic, abilities, known)

    return find
