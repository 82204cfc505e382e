"""Symbolic operators with physical preconditions, and A* over them.

Operators of both agents: go to a room, touch, attach, carry (one or both holders) to a room,
place on the landmark, let go, settle on a landmark, stand in a door. Preconditions come from
the physics: door width against size, force of the holders against floor friction, who holds.
Costs are path lengths between rooms. Source: paper, Appendix "Hierarchical Planner" (the paper
names A* and the predicates; the operators are ours).
"""

from __future__ import annotations

import dataclasses
import heapq
import itertools
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.agents.symbols import SymbolicState
from phase_ppl.physics.constants import FLOOR_FRICTION
from phase_ppl.world.names import AGENTS, ITEMS, NOTHING, Literal, Predicate
from phase_ppl.world.rooms import N_ROOMS, ROOMS_OF_RAY
from phase_ppl.world.scene import Scene

TOUCH_COST: Final = 3.0
GRIP_COST: Final = 0.5
PLACE_COST: Final = 3.0
MAX_EXPANSIONS: Final = 4000

AGENT_WIDTH: Final = 3.0
"""Width of an agent driving straight, in units of its size R: the base of the trapezoid."""

ITEM_WIDTH: Final = 2.0


@dataclasses.dataclass(frozen=True)
class Abilities:
    """What the bodies of a scene can do; everything about physics that planning depends on.

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


class Node(NamedTuple):
    """A state of the search: rooms and holds change; ``near`` and ``placed`` are reached facts."""

    rooms: tuple[int, int, int, int]
    held: tuple[int, int]
    near: tuple[int, int]
    """Entity each agent is at, within grab range; -1 for none."""
    placed: tuple[bool, bool, bool, bool]
    """Whether each entity has been brought to the landmark of its room."""
    clear: tuple[int, int]
    """Door filled by the (blue, pink) item, or -1."""


class Step(NamedTuple):
    """One operator in a plan: who acts, the subgoal literal, and the state it leads to."""

    agents: tuple[int, ...]
    literal: Literal
    cost: float
    result: Node


def _set(values: tuple, index: int, value: object) -> tuple:  # type: ignore[type-arg]
    return (*values[:index], value, *values[index + 1 :])


def start_node(
    state: SymbolicState, done: tuple[bool, bool, bool, bool], targets: frozenset[int]
) -> Node:
    """Return the search node of a symbolic state; only targets count as near."""
    near = tuple(
        next((2 + i for i in range(2) if state.in_reach[2 * a + i] and 2 + i in targets), NOTHING)
        for a in range(2)
    )
    return Node(state.rooms, state.held, near, done, state.door_filled_by)  # type: ignore[arg-type]


def _door_free(node: Node, abilities: Abilities, ray: int, carried: int) -> bool:
    return not any(
        node.clear[i] == ray and abilities.fills[i][ray] and 2 + i != carried for i in range(2)
    )


def moves(
    node: Node, agent: int, willing: tuple[int, ...], targets: frozenset[int], abilities: Abilities
) -> Iterator[Step]:
    """Yield the operators of one agent that can be used in a state.

    Args:
        node: the state.
        agent: who acts, 0 red or 1 green.
        willing: agents that take part in the plan.
        targets: entities that matter; others are not touched, carried or placed.
        abilities: what the bodies can do.
    """
    other = 1 - agent
    item = node.held[agent]
    room = node.rooms[agent]
    if item == NOTHING:
        for ray, following in abilities.neighbours[room]:
            if abilities.passes[agent][ray] and _door_free(node, abilities, ray, NOTHING):
                yield Step(
                    (agent,),
                    Literal(Predicate.CLOSE, agent, following),
                    abilities.room_distance[room][following],
                    node._replace(
                        rooms=_set(node.rooms, agent, following),
                        near=_set(node.near, agent, NOTHING),
                        placed=_set(node.placed, agent, False),
                    ),
                )
        for target in targets:
            if target != agent and node.rooms[target] == room and node.near[agent] != target:
                yield Step(
                    (agent,),
                    Literal(Predicate.TOUCH, agent, target),
                    TOUCH_COST,
                    node._replace(near=_set(node.near, agent, target)),
                )
        target = node.near[agent]
        if target >= 2 and target in targets:
            yield Step(
                (agent,),
                Literal(Predicate.ATTACH, agent, target),
                GRIP_COST,
                node._replace(held=_set(node.held, agent, target)),
            )
        if agent in targets and not node.placed[agent]:
            yield Step(
                (agent,),
                Literal(Predicate.ON, agent, room),
                PLACE_COST,
                node._replace(placed=_set(node.placed, agent, True)),
            )
        return
    yield Step(
        (agent,),
        Literal(Predicate.ATTACH, agent, item, positive=False),
        GRIP_COST,
        node._replace(held=_set(node.held, agent, NOTHING), near=_set(node.near, agent, item)),
    )
    shared = node.held[other] == item
    helpers = shared and other in willing
    if shared:
        able = abilities.carries_together if helpers else abilities.carries_against_hold[agent]
    else:
        able = abilities.carries_alone[agent]
    if not able or item not in targets:
        return
    movers = (agent, item, other) if shared else (agent, item)
    actors = (agent, other) if helpers else (agent,)
    for ray, following in abilities.neighbours[node.rooms[item]]:
        # a holder beyond the door need not pass it; one before it must also be with the item
        crossing = [e for e in movers if node.rooms[e] != following]
        passing = all(
            abilities.passes[e][ray]
            and abilities.route((e,), node.rooms[e], node.rooms[item]) is not None
            for e in crossing
        )
        if passing and _door_free(node, abilities, ray, item):
            rooms = node.rooms
            placed = node.placed
            for entity in movers:
                rooms = _set(rooms, entity, following)
                placed = _set(placed, entity, False)
            yield Step(
                actors,
                Literal(Predicate.CLOSE, item, following),
                abilities.room_distance[node.rooms[item]][following],
                node._replace(rooms=rooms, placed=placed, clear=_set(node.clear, item - 2, -1)),
            )
    together = all(
        abilities.route((e,), node.rooms[e], node.rooms[item]) is not None for e in movers
    )
    if together and not node.placed[item]:
        yield Step(
            actors,
            Literal(Predicate.ON, item, node.rooms[item]),
            PLACE_COST,
            node._replace(
                placed=_set(node.placed, item, True), clear=_set(node.clear, item - 2, -1)
            ),
        )


def plan(
    start: Node,
    willing: tuple[int, ...],
    targets: frozenset[int],
    is_goal: Callable[[Node], bool],
    heuristic: Callable[[Node], float],
    abilities: Abilities,
) -> list[Step] | None:
    """Return the cheapest sequence of operators to a goal node by A*, or None.

    Args:
        start: where the search begins.
        willing: agents whose operators may be used.
        targets: entities that matter to the goal; others are not touched or carried.
        is_goal: goal test.
        heuristic: admissible lower bound of the cost left.
    """
    order = itertools.count()
    frontier: list[tuple[float, int, float, Node]] = [(heuristic(start), next(order), 0.0, start)]
    best = {start: 0.0}
    came: dict[Node, tuple[Node, Step]] = {}
    for _ in range(MAX_EXPANSIONS):
        if not frontier:
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
