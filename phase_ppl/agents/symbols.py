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

NEAR_ITEM_ON: Final = 0.05 * DISTANCE_UNIT  # likewise for ON(item, landmark)
NEAR_TOUCH: Final = 0.1 * DISTANCE_UNIT  # likewise for TOUCH
NO_DOOR: Final = -1
_ON, _TOUCH = int(Predicate.ON), int(Predicate.TOUCH)


class SymbolicState(NamedTuple):
    """Which facts hold in one particle."""

    rooms: tuple[int, ...]  # room of each entity (0 for all in an arena without inner walls)
    held: tuple[int, ...]  # item held by each agent, or -1
    in_reach: tuple[bool, ...]  # agent by agent, whether it can grab each item
    # whether the positive form of the agent's own and of the other's goal is reached
    own_done: bool
    other_done: bool
    door_filled_by: tuple[int, ...]  # the door that each item closes, or -1


class Facts(NamedTuple):
    """The rows of facts that :func:`describe` writes of so many entities, some of them agents."""

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
    bodies: FloatArray, held: IntArray, agent: int, goal: IntArray, params: Params, layout: Layout
) -> float:
    if goal[3] < 0:
        return 0.0
    moved, target = goal[1], goal[2]
    if goal[0] == _TOUCH and moved != agent and target >= params.force.shape[0]:
        moved, target = target, moved  # an item is brought to another agent
    x, y = body_origin(bodies, agent, params.cog)
    sx, sy = body_origin(bodies, moved, params.cog)
    if moved != agent and held[agent] != moved:
        return path_distance(x, y, sx, sy, layout)
    if goal[0] == _ON:
        lx, ly = layout.landmarks[goal[2], 0], layout.landmarks[goal[2], 1]
        return path_distance(sx, sy, lx, ly, layout)
    tx, ty = body_origin(bodies, target, params.cog)
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
        facts: (K, Facts.size) output, the fields of :class:`SymbolicState` in order, but for what
            depends on goals.
        done: (G, K) output, whether the positive form of each goal is reached.
        costs: (G, K) output, the cost C of Algorithm 1 to each goal: path length of the leg the
            agent is on, to the item it is after or from there to the goal, units; 0 for negative
            goals.
    """
    n_bodies, n_agents = bodies.shape[1], held.shape[1]
    n_items = n_bodies - n_agents
    reach, filled = n_bodies + n_agents, n_bodies + n_agents + n_agents * n_items
    others = params.radius[agent] if n_agents == 1 else 0.0  # size of the largest of them
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
            costs[g, k] = _cost_to_go(particle, held[k], agent, goals[g], params, layout)
