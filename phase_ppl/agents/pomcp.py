"""The low-level planner: POMCP over an agent's own actions, with PUCT, on the compiled physics.

Source: paper, Appendix "Hierarchical Planner"; Silver and Veness (2010); the PUCT variant of
Silver et al. (2018). Each simulation draws a particle, walks down the tree of the agent's own
actions (the others coast), adds one node, and rolls out with random actions of all.

We pair simulations: the n-th one through each root action meets the same particle and random
numbers. That compares the actions like with like and needs far fewer simulations. Searches for
several subgoals from the same particles and random numbers imagine the same until the paths
through their trees part. Such playouts are imagined once, and valued by each search.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import DISTANCE_UNIT, Layout, body_origin, path_distance, room_of
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import N_ACTIONS, NO_ACTION, Action
from phase_ppl.physics.compiled import Params, Scratch
from phase_ppl.physics.jit import bare_kernel
from phase_ppl.physics.records import record
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.names import AGENTS, ENTITIES, NOTHING, Literal, PredicateKind
from phase_ppl.world.rooms import UNREACHABLE

SIDEWAYS_COST: Final = 0.02  # cost of each translation other than straight ahead

_ON, _TOUCH, _ATTACH = (
    int(p) for p in (PredicateKind.ON, PredicateKind.TOUCH, PredicateKind.ATTACH)
)
_FIRST_SIDEWAYS, _LAST_SIDEWAYS = int(Action.DOWN), int(Action.DOWN_RIGHT)
_NAVIGATION: Final = (Action.TURN_LEFT, Action.TURN_RIGHT, Action.UP, Action.STOP, Action.NO_FORCE)
_GRIP: Final = (Action.ATTACH, Action.DETACH)


def subgoal_code(literal: Literal) -> IntArray:
    """Return (predicate, subject, target, sign) for compiled code."""
    sign = 1 if literal.positive else -1
    return np.array([literal.predicate, literal.subject, literal.target, sign], np.int64)


def actions_for(
    literal: Literal, agent: int, held: int, contested: bool = False, n_agents: int = len(AGENTS)
) -> IntArray:
    """Return the actions that ``agent`` considers for a subgoal, indices into ``Action``.

    Args:
        literal: the subgoal.
        agent: who plans.
        held: item it holds or ``NOTHING``.
        contested: another agent wants to keep it from the landmark it wants to be on.
        n_agents: number of agents, which are the first entities.
    """
    predicate, subject = literal.predicate, literal.subject
    without: tuple[Action, ...]
    walks = predicate in (PredicateKind.TOUCH, PredicateKind.CLOSE)
    if subject == agent and (walks or (predicate is PredicateKind.ON and not contested)):
        return np.array(_NAVIGATION, np.int64)
    if predicate is PredicateKind.ATTACH:
        without = () if held != NOTHING else (Action.DETACH,)
    elif predicate is PredicateKind.ON and subject >= n_agents:
        without = (Action.DETACH,)
    elif predicate is PredicateKind.CLOSE and subject >= n_agents:
        without = _GRIP if held != NOTHING else (Action.DETACH,)
    else:
        without = _GRIP
    return np.array([action for action in Action if action not in without], np.int64)


@bare_kernel
def _distance(
    bodies: FloatArray, held: IntArray, subgoal: IntArray, params: Params, layout: Layout
) -> float:
    predicate, subject, target = subgoal[0], subgoal[1], subgoal[2]
    if predicate == _ATTACH:
        return 0.0 if held[subject] == target else DISTANCE_UNIT
    x, y = body_origin(bodies, subject, params.cog)
    if predicate == _ON:
        return path_distance(x, y, layout.landmarks[target, 0], layout.landmarks[target, 1], layout)
    if predicate == _TOUCH:
        other_x, other_y = body_origin(bodies, target, params.cog)
        return path_distance(x, y, other_x, other_y, layout)
    n_rooms = layout.room_points.shape[0]
    if target >= n_rooms:
        door = target - n_rooms
        return path_distance(x, y, layout.doors[door, 0], layout.doors[door, 1], layout)
    px, py = layout.room_points[target, 0], layout.room_points[target, 1]
    room = room_of(x, y, layout)
    if room == target:
        inside = math.sqrt((x - px) ** 2 + (y - py) ** 2)
        # as in the original, an item in its room is worth more than any way there
        return inside - UNREACHABLE if subject >= params.force.shape[0] else inside
    door = layout.neighbour[room, target]
    if door < 0:
        return DISTANCE_UNIT
    dx, dy = layout.doors[door, 0], layout.doors[door, 1]
    return math.sqrt((x - dx) ** 2 + (y - dy) ** 2) + math.sqrt((dx - px) ** 2 + (dy - py) ** 2)


@bare_kernel
def reward(
    bodies: FloatArray,
    held: IntArray,
    subgoal: IntArray,
    action: int,
    params: Params,
    layout: Layout,
) -> float:
    """Return the reward of being in a state after ``action``, for one subgoal."""
    value = -subgoal[3] * _distance(bodies, held, subgoal, params, layout) / DISTANCE_UNIT
    if _FIRST_SIDEWAYS <= action <= _LAST_SIDEWAYS:
        value -= SIDEWAYS_COST
    return value


# --- A counter-based random generator for compiled code: explicit state, no globals ---------------
# SplitMix64 (Steele, Lea and Flood, 2014). The state is a uint64 array of length 1.

_INCREMENT = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_TO_UNIT = 1.0 / 9007199254740992.0


def make_rng(generator: np.random.Generator) -> NDArray[np.uint64]:
    """Return a compiled-code generator state seeded from a NumPy generator."""
    return generator.integers(0, 2**64, size=1, dtype=np.uint64)


@bare_kernel
def _mixed(z: np.uint64) -> np.uint64:
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@bare_kernel
def uniform(rng: NDArray[np.uint64]) -> float:
    """Return the next float in [0, 1) and advance ``rng``."""
    rng[0] += _INCREMENT
    return np.float64(_mixed(rng[0]) >> _S11) * _TO_UNIT


@bare_kernel
def below(rng: NDArray[np.uint64], n: int) -> int:
    """Return the next integer in 0..n-1 and advance ``rng``."""
    return int(uniform(rng) * n)


# --- the search -----------------------------------------------------------------------------

NO_NODE: Final = -1
_UNVISITED_SCORE = 1e200
_STREAMS: Final = 2**52
_STREAM_STEP = np.uint64(0xD1342543DE82EF95)


@record
class SearchSettings(NamedTuple):
    """Settings of one search, for compiled code (see ``PlannerConfig``)."""

    simulations: int
    rollout_length: int
    discount: float
    c_init: float
    c_base: float
    early_stop: bool
    paired: bool

    @classmethod
    def of(cls, config: PlannerConfig) -> SearchSettings:
        """Return the search settings of a planner."""
        return cls(*(getattr(config, name) for name in cls._fields))


@record
class Tree(NamedTuple):
    """A search tree in flat arrays; node 0 is the root."""

    child: NDArray[np.int32]  # (nodes, actions) node reached by each action column, or NO_NODE
    visits: NDArray[np.int32]  # (nodes,)
    total: FloatArray  # (nodes,) sum of returns
    used: IntArray  # (1,) number of nodes in use
    path: IntArray  # (nodes,) scratch: nodes of one simulation
    columns: IntArray  # (nodes,) scratch: the actions that led to them
    rewards: FloatArray
    particle: FloatArray  # scratch state of one simulation
    particle_held: IntArray
    particle_weld: FloatArray
    actions: IntArray  # (agent,) scratch: the agents' actions in a step
    stream: NDArray[np.uint64]  # (1,) state of the random numbers of one simulation
    statistics: IntArray  # (3,) simulations run, physics steps, sum of depths


@record
class Playouts(NamedTuple):
    """Recorded simulations: everything in each step that a reward depends on.

    A later search finds a playout by its ``key``, a digest of all that it follows from: the
    random numbers left and the actions in the tree.
    """

    key: NDArray[np.uint64]  # (slots,) a hash table; no slots: nothing is kept
    start: IntArray  # (slots,) first step of the playout, or ``NO_NODE``
    used: IntArray  # (1,) steps that are kept
    bodies: FloatArray  # (step, body, 3) x, y, angle after each step
    held: IntArray  # (step, agent)
    action: IntArray  # (step,) the agent's own


_MOST_KEPT: Final = 200_000  # steps; above, playouts are imagined anew for each search


def make_playouts(
    search: SearchSettings,
    n_searches: int = 1,
    n_bodies: int = len(ENTITIES),
    n_agents: int = len(AGENTS),
) -> Playouts:
    """Return space for the playouts of some searches, which share them if they are paired."""
    longest = search.simulations + 2 + search.rollout_length
    slots = kept = 0
    if search.paired and n_searches > 1:
        playouts = n_searches * search.simulations
        slots = 2 ** (2 * playouts - 1).bit_length()
        kept = min(playouts * (search.rollout_length + 4), _MOST_KEPT)
    return Playouts(
        np.zeros(slots, np.uint64),
        np.full(slots, NO_NODE, np.int64),
        np.zeros(1, np.int64),
        np.empty((kept + longest, n_bodies, 3)),
        np.empty((kept + longest, n_agents), np.int64),
        np.empty(kept + longest, np.int64),
    )


def make_tree(
    n_simulations: int, n_bodies: int = len(ENTITIES), n_agents: int = len(AGENTS)
) -> Tree:
    """Return an empty tree with space for ``n_simulations``."""
    nodes = n_simulations + 2
    return Tree(
        np.full((nodes, N_ACTIONS), NO_NODE, np.int32),
        np.zeros(nodes, np.int32),
        np.zeros(nodes),
        np.ones(1, np.int64),
        np.zeros(nodes + 1, np.int64),
        np.zeros(nodes + 1, np.int64),
        np.zeros(nodes + 1),
        np.zeros((n_bodies, 9)),
        np.zeros(n_agents, np.int64),
        np.zeros((n_agents, 3)),
        np.zeros(n_agents, np.int64),
        np.zeros(1, np.uint64),
        np.zeros(3, np.int64),
    )


@bare_kernel
def _select(
    tree: Tree, node: int, n_actions: int, search: SearchSettings, rng: NDArray[np.uint64]
) -> int:
    """Return the column with the highest Q + U; unvisited ones first, ties at random.

    U = (ln((1 + N + c_base) / c_base) + c_init) p sqrt(N) / (1 + n), p = 1 / actions.
    """
    n_parent = tree.visits[node]
    factor = (
        (math.log((1.0 + n_parent + search.c_base) / search.c_base) + search.c_init)
        * math.sqrt(n_parent)
        / n_actions
    )
    best, best_score, ties = 0, -1e300, 0
    for column in range(n_actions):
        child = tree.child[node, column]
        if child < 0 or tree.visits[child] == 0:
            score = _UNVISITED_SCORE
        else:
            n = tree.visits[child]
            score = tree.total[child] / n + factor / (1.0 + n)
        if score > best_score:
            best, best_score, ties = column, score, 1
        elif score == best_score:
            ties += 1
            if below(rng, ties) == 0:
                best = column
    return best


@bare_kernel
def _leader_is_safe(tree: Tree, n_actions: int, left: int) -> bool:
    """Whether no other root action can catch up with the most visited one any more."""
    first, second = 0, 0
    for column in range(n_actions):
        child = tree.child[0, column]
        n = tree.visits[child] if child >= 0 else 0
        if n > first:
            first, second = n, first
        elif n > second:
            second = n
    return first - second > left


@bare_kernel
def _most_visited(tree: Tree, n_actions: int, rng: NDArray[np.uint64]) -> int:
    best, most, ties = 0, -1, 0
    for column in range(n_actions):
        child = tree.child[0, column]
        n = tree.visits[child] if child >= 0 else 0
        if n > most:
            best, most, ties = column, n, 1
        elif n == most:
            ties += 1
            if below(rng, ties) == 0:
                best = column
    return best


@bare_kernel
def _load_particle(
    tree: Tree, bodies: FloatArray, held: IntArray, weld: FloatArray, k: int
) -> None:
    for body in range(bodies.shape[1]):
        for column in range(bodies.shape[2]):
            tree.particle[body, column] = bodies[k, body, column]
    for agent in range(held.shape[1]):
        tree.particle_held[agent] = held[k, agent]
        for column in range(weld.shape[2]):
            tree.particle_weld[agent, column] = weld[k, agent, column]


@bare_kernel
def _descend(
    tree: Tree, first: int, n_actions: int, search: SearchSettings, stream: NDArray[np.uint64]
) -> int:
    """Walk down the tree to a new node; return its depth. It needs no state."""
    node, depth, column = 0, 0, first
    while True:
        tree.columns[depth] = column
        child = tree.child[node, column]
        new = child < 0
        if new:
            child = tree.used[0]
            tree.used[0] += 1
            tree.child[node, column] = child
        tree.path[depth] = child
        depth += 1
        if new:
            return depth
        node = child
        column = _select(tree, node, n_actions, search, stream)


@bare_kernel
def _slot(tree: Tree, playouts: Playouts, depth: int) -> int:
    """Return the slot of a playout in the table, or a free one for it."""
    key = tree.stream[0]
    for level in range(depth):
        key = _mixed((key ^ np.uint64(tree.columns[level] + 1)) + _INCREMENT)
    last = playouts.key.shape[0] - 1
    slot = np.int64(key & np.uint64(last))
    while playouts.start[slot] >= 0 and playouts.key[slot] != key:
        slot = (slot + 1) & last
    playouts.key[slot] = key
    return int(slot)


@bare_kernel
def _play(
    tree: Tree,
    playouts: Playouts,
    start: int,
    depth: int,
    agent: int,
    actions: IntArray,
    search: SearchSettings,
    params: Params,
    scratch: Scratch,
    rng: NDArray[np.uint64],
) -> None:
    """Imagine on from the loaded particle: the path in the tree, then random actions of all."""
    state, held, n_actions = tree.particle, tree.particle_held, actions.shape[0]
    for step in range(depth + search.rollout_length):
        if step < depth:
            own = actions[tree.columns[step]]
            for other in range(tree.actions.shape[0]):
                tree.actions[other] = own if other == agent else NO_ACTION
        else:
            own = actions[below(rng, n_actions)]
            for other in range(tree.actions.shape[0]):
                tree.actions[other] = own if other == agent else actions[below(rng, n_actions)]
        compiled.step(state, held, tree.particle_weld, tree.actions, params, scratch)
        for body in range(state.shape[0]):
            for column in range(3):
                playouts.bodies[start + step, body, column] = state[body, column]
        for other in range(held.shape[0]):
            playouts.held[start + step, other] = held[other]
        playouts.action[start + step] = own


@bare_kernel
def _value(
    tree: Tree,
    playouts: Playouts,
    start: int,
    depth: int,
    subgoal: IntArray,
    search: SearchSettings,
    params: Params,
    layout: Layout,
) -> float:
    """Return the discounted rewards of a rollout; write those in the tree into ``rewards``."""
    value, weight = 0.0, 1.0
    for step in range(depth + search.rollout_length):
        at = start + step
        found = reward(
            playouts.bodies[at], playouts.held[at], subgoal, playouts.action[at], params, layout
        )
        if step < depth:
            tree.rewards[step] = found
        else:
            value += weight * found
            weight *= search.discount
    return value


@bare_kernel
def run(
    tree: Tree,
    playouts: Playouts,
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    agreeing: IntArray,
    agent: int,
    subgoal: IntArray,
    actions: IntArray,
    search: SearchSettings,
    params: Params,
    layout: Layout,
    scratch: Scratch,
    rng: NDArray[np.uint64],
) -> int:
    """Search until the root has the set number of visits; return the best action's column.

    Args:
        tree: from ``make_tree``, empty.
        playouts: from ``make_playouts``, empty or from earlier searches that differed only in the
            subgoal and began with the same ``rng``.
        bodies, held, weld: (K, ...) the agent's belief particles.
        agreeing: indices of the particles that agree with the subgoal.
        subgoal: (4,) from ``subgoal_code``.
        actions: (A,) actions to consider; the tree's columns are in this order.
    """
    n_actions, sharing = actions.shape[0], playouts.key.shape[0] > 0
    longest = search.simulations + 2 + search.rollout_length
    base = below(rng, _STREAMS) if search.paired else 0
    stream = tree.stream if search.paired else rng
    for visit in range(search.simulations):
        first = _select(tree, 0, n_actions, search, rng)
        if search.paired:
            child = tree.child[0, first]
            turn = tree.visits[child] if child >= 0 else 0
            stream[0] = np.uint64(base) + np.uint64(turn) * _STREAM_STEP
        k = agreeing[below(stream, agreeing.shape[0])]
        depth = _descend(tree, first, n_actions, search, stream)
        slot = _slot(tree, playouts, depth) if sharing else 0
        start = playouts.start[slot] if sharing else NO_NODE
        if start < 0:
            start = playouts.used[0]
            _load_particle(tree, bodies, held, weld, k)
            _play(tree, playouts, start, depth, agent, actions, search, params, scratch, stream)
            length = depth + search.rollout_length
            tree.statistics[1] += length
            if sharing and start + length + longest <= playouts.action.shape[0]:
                playouts.start[slot] = start
                playouts.used[0] += length
        value = _value(tree, playouts, start, depth, subgoal, search, params, layout)
        for level in range(depth - 1, -1, -1):
            value = tree.rewards[level] + search.discount * value
            tree.visits[tree.path[level]] += 1
            tree.total[tree.path[level]] += value
        tree.visits[0] += 1
        tree.statistics[0] += 1
        tree.statistics[2] += depth
        left = search.simulations - 1 - visit
        if search.early_stop and left <= visit and _leader_is_safe(tree, n_actions, left):
            break
    return _most_visited(tree, n_actions, rng)
