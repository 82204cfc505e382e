"""From belief particles to symbolic states: the facts that the subgoal planner reasons over.

Source: paper, Appendix "Predicates, Symbolic States, Goals, and Subgoals".
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.world_model import DISTANCE_UNIT, Layout, body_origin, path_distance, room_of
from phase_ppl.physics.compiled import Params
from phase_ppl.physics.jit import bare_kernel
from phase_ppl.physics.welds import in_reach
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.names import Predicate

NEAR_AGENT_ON: Final = 0.02 * DISTANCE_UNIT
"""An agent is done with ON(itself, landmark) this close to the centre, units."""

NEAR_ITEM_ON: Final = 0.05 * DISTANCE_UNIT
"""Likewise for ON(item, landmark)."""

NEAR_TOUCH: Final = 0.1 * DISTANCE_UNIT
"""Likewise for TOUCH."""

NO_DOOR: Final = -1
_ON, _TOUCH = int(Predicate.ON), int(Predicate.TOUCH)
_FACTS: Final = struct.Struct("6b4?2b")
N_FACTS: Final = _FACTS.size


class SymbolicState(NamedTuple):
    """Which facts hold in one particle.

    Attributes:
        rooms: room of each entity (0 for all in an arena without inner walls).
        held: item held by each agent, or -1.
        in_reach: whether (red, blue), (red, pink), (green, blue), (green, pink) can be grabbed.
        own_done, other_done: whether the positive form of the agent's own and of the other's
            goal is reached.
        door_filled_by: the door (ray) that the (blue, pink) item closes, or -1.
    """

    rooms: tuple[int, int, int, int]
    held: tuple[int, int]
    in_reach: tuple[bool, bool, bool, bool]
    own_done: bool
    other_done: bool
    door_filled_by: tuple[int, int]


def unpack(facts: bytes, own_done: bool, other_done: bool) -> SymbolicState:
    """Return the symbolic state of one row written by :func:`describe`."""
    f = _FACTS.unpack(facts)
    return SymbolicState(f[:4], f[4:6], f[6:10], own_done, other_done, f[10:])  # type: ignore[arg-type]


@bare_kernel
def _done(bodies: FloatArray, goal: IntArray, params: Params, layout: Layout) -> bool:
    x, y = body_origin(bodies, goal[1], params.cog)
    if goal[0] == _ON:
        near = NEAR_ITEM_ON if goal[1] >= 2 else NEAR_AGENT_ON
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
    params: Params,
    layout: Layout,
) -> float:
    if goal[3] < 0:
        return 0.0
    x, y = body_origin(bodies, agent, params.cog)
    sx, sy = body_origin(bodies, goal[1], params.cog)
    if goal[1] != agent and held[agent] != goal[1]:
        return path_distance(x, y, sx, sy, layout)
    if goal[0] == _ON:
        lx, ly = layout.landmarks[goal[2], 0], layout.landmarks[goal[2], 1]
        return path_distance(sx, sy, lx, ly, layout)
    tx, ty = body_origin(bodies, goal[2], params.cog)
    return path_distance(sx, sy, tx, ty, layout)


@bare_kernel
def describe(
    bodies: FloatArray,
    held: IntArray,
    agent: int,
    goals: IntArray,
    params: Params,
    layout: Layout,
    facts: NDArray[np.int8],
    done: BoolArray,
    costs: FloatArray,
) -> None:
    """Write the facts of every particle, and how far goals are reached in it.

    Args:
        bodies, held: (K, ...) particles.
        agent: who plans.
        goals: (G, 4) codes of goal literals, the agent's own or the other's.
        facts: (K, N_FACTS) output, the fields of :class:`SymbolicState` in order, but for what
            depends on goals.
        done: (G, K) output, whether the positive form of each goal is reached.
        costs: (G, K) output, the cost C of Algorithm 1 to each goal: path length of the leg the
            agent is on, to the item it is after or from there to the goal, units; 0 for negative
            goals.
    """
    for k in range(bodies.shape[0]):
        particle = bodies[k]
        for entity in range(4):
            x, y = body_origin(particle, entity, params.cog)
            facts[k, entity] = 0 if layout.is_open else room_of(x, y, layout)
        for a in range(2):
            facts[k, 4 + a] = held[k, a]
            for i in range(2):
                facts[k, 6 + 2 * a + i] = in_reach(particle, a, 2 + i, params)
        for i in range(2):
            facts[k, 10 + i] = NO_DOOR
            for door in range(4):
                if layout.is_open or layout.door_width[door] <= 0.0:
                    continue
                dx = particle[2 + i, 0] - layout.doors[door, 0]
                dy = particle[2 + i, 1] - layout.doors[door, 1]
                # a narrower item can be pushed through
                radius = params.radius[2 + i]
                if 2.0 * radius <= layout.door_width[door]:
                    continue
                if dx * dx + dy * dy < (radius + params.radius[1 - agent]) ** 2:
                    facts[k, 10 + i] = door
        for g in range(goals.shape[0]):
            done[g, k] = _done(particle, goals[g], params, layout)
            costs[g, k] = _cost_to_go(particle, held[k], agent, goals[g], params, layout)
