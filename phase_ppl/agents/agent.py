"""One agent: what it believes, which subgoal it takes up, and what it does next.

Source: paper, Algorithm 1, the inner loop. Policy and dynamics are separate: an agent can be
asked for its decision in any true state; it never moves the world.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents import pomcp, symbols
from phase_ppl.agents.beliefs import Beliefs, Perception
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.subgoals import subgoal_planner
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import Action
from phase_ppl.physics.compiled import Scratch
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.names import AGENTS, NOTHING, STOP, Literal, Predicate


def best_subgoal(
    agreeing: Mapping[Literal, Sequence[int]],
    costs: FloatArray,
    done: float,
    agent: int,
    config: PlannerConfig,
) -> Literal:
    """Return the subgoal of highest value V (paper, Algorithm 1).

    V(h) = share of the particles with subgoal h - lambda x their mean cost.

    Args:
        agreeing: subgoal -> particles for which it was planned.
        costs: (K,) cost C of each particle, units.
        done: share of the particles in which the agent's goal is reached.
        agent: who plans.
        config: settings of the planner.
    """
    if len(agreeing) == 1:
        return next(iter(agreeing))
    n = config.particles
    value = {
        subgoal: len(members) / n - config.cost_weight * costs[members].mean()
        for subgoal, members in agreeing.items()
    }
    candidates = sorted(value)
    # particles in which nothing is left to do are cheap; they must not end a search
    if not (done > 0.5 and len(agreeing.get(STOP, ())) > n / 2):
        candidates = [c for c in candidates if c != STOP]
    if config.touch_override:
        # the authors' code prefers touching, items first, then the other agent
        order = {2: 0, 3: 1, 1 - agent: 2}
        touching = [c for c in candidates if c.predicate is Predicate.TOUCH and c.positive]
        candidates = sorted(touching, key=lambda c: order[c.target])[:1] or candidates
    return max(candidates, key=value.__getitem__)


def reflex(
    subgoal: Literal, particle: int, agent: int, beliefs: Beliefs, model: WorldModel
) -> Action | None:
    """Return the action that needs no search: stop, let go, or grab what is in reach.

    Args:
        subgoal: what the agent is about.
        particle: one of the particles that agree with it.
        agent: 0 red, 1 green.
        beliefs, model: its own.
    """
    if subgoal == STOP:
        return Action.STOP
    if subgoal.predicate is not Predicate.ATTACH:
        return None
    if not subgoal.positive:
        return Action.DETACH
    if beliefs.held[particle, agent] != NOTHING:
        return None
    item, _ = compiled.find_grab(
        beliefs.bodies[particle], beliefs.held[particle], agent, model.params
    )
    return Action.ATTACH if item == subgoal.target else None


class RootStatistics(NamedTuple):
    """What a search found at the root of its tree.

    Attributes:
        actions: (A,) actions considered.
        visits: (A,) of the actions; values: (A,) mean returns, NaN if unvisited.
        best: the action to take.
    """

    actions: IntArray
    visits: IntArray
    values: FloatArray
    best: Action


def search_actions(
    tree: pomcp.Tree,
    subgoal: Literal,
    agreeing: IntArray,
    actions: IntArray,
    agent: int,
    beliefs: Beliefs,
    model: WorldModel,
    search: pomcp.Search,
    scratch: Scratch,
    rng: NDArray[np.uint64],
) -> RootStatistics:
    """Search for the best action over the particles that agree with a subgoal.

    Args:
        tree: empty.
        subgoal, agreeing, actions: as of :func:`phase_ppl.agents.pomcp.run`.
        agent: 0 red, 1 green.
        beliefs, model: its own.
        search, scratch, rng: settings, work space and random numbers.
    """
    column = pomcp.run(
        tree,
        beliefs.bodies,
        beliefs.held,
        beliefs.weld,
        agreeing,
        agent,
        pomcp.subgoal_code(subgoal),
        actions,
        search,
        model.params,
        model.layout,
        scratch,
        rng,
    )
    children = tree.child[0, : len(actions)]
    visited = children >= 0
    visits = np.where(visited, tree.visits[children], 0).astype(np.int64)
    with np.errstate(invalid="ignore", divide="ignore"):
        values = np.where(visited, tree.total[children] / np.maximum(visits, 1), np.nan)
    return RootStatistics(actions, visits, values, Action(int(actions[column])))


class Decision(NamedTuple):
    """What an agent does, and why.

    Attributes:
        action: the action to execute.
        subgoal: the literal it serves.
        support: share of the belief particles that agree with the subgoal.
        actions: (A,) actions the search considered; empty without a search.
        visits: (A,) root visits; values: (A,) mean returns at the root, NaN if unvisited.
        held: item that the agent holds when it decides, or ``NOTHING``.
    """

    action: Action
    subgoal: Literal
    support: float
    actions: IntArray
    visits: IntArray
    values: FloatArray
    held: int


_NO_ACTIONS = np.empty(0, np.int64)
_NO_VALUES = np.empty(0)


class Agent:
    """Beliefs and planners of one agent.

    Args:
        agent: 0 red, 1 green.
        goals: effective goals of (red, green), indices into ``GOALS``; both agents know both.
        model: layout and imagined physics.
        config: settings of the planner.
        generator: source of all randomness of this agent.
    """

    def __init__(
        self,
        agent: int,
        goals: tuple[int, int],
        model: WorldModel,
        config: PlannerConfig,
        generator: np.random.Generator,
    ) -> None:
        self.agent = agent
        self.config = config
        self.model = model
        self.goal = goal_literal(goals[agent], agent)
        other_goal = goal_literal(goals[1 - agent], 1 - agent)
        self._goal_code = pomcp.subgoal_code(self.goal)
        self._other_code = pomcp.subgoal_code(other_goal)
        self._planner = subgoal_planner(agent, self.goal, other_goal, model.abilities)
        self._perception = Perception(agent, model, config, generator)
        self._rng = self._perception.rng
        self._scratch = self._perception.scratch
        self.search = pomcp.Search.of(config)
        self.tree = pomcp.make_tree(config.simulations)
        self._facts = np.zeros((config.particles, symbols.N_FACTS), np.int8)
        self._costs = np.zeros(config.particles)

    @property
    def beliefs(self) -> Beliefs:
        """The belief particles."""
        return self._perception.beliefs

    def decide(self, bodies: FloatArray, held: IntArray, weld: FloatArray) -> Decision:
        """Observe the true state, update the beliefs, and choose subgoal and action.

        Args:
            bodies, held, weld: the true state as ``physics.compiled.from_state`` gives it.
        """
        self.perceive(bodies, held, weld)
        subgoal, agreeing = self.choose_subgoal()
        decision = self.choose_action(subgoal, agreeing)
        self.done(decision.action)
        return decision

    def done(self, action: Action) -> None:
        """Tell the agent what it has just executed, which its next prediction starts from."""
        self._perception.done(action)

    def perceive(self, bodies: FloatArray, held: IntArray, weld: FloatArray) -> None:
        """Observe the true state and bring the belief particles up to date."""
        self._perception.observe(bodies, held, weld)

    def choose_subgoal(self) -> tuple[Literal, IntArray]:
        """Return the subgoal of highest value V and the indices of the particles that agree."""
        beliefs = self.beliefs
        symbols.describe(
            beliefs.bodies,
            beliefs.held,
            self.agent,
            self._goal_code,
            self._other_code,
            self.model.params,
            self.model.layout,
            self._facts,
            self._costs,
        )
        observed = tuple(beliefs.observed.tolist())
        same_facts: dict[bytes, list[int]] = defaultdict(list)
        for k, row in enumerate(self._facts):
            same_facts[row.tobytes()].append(k)
        agreeing: dict[Literal, list[int]] = defaultdict(list)
        for members in same_facts.values():
            state = symbols.unpack(self._facts[members[0]])
            agreeing[self._planner.subgoal(state, observed)] += members
        done = float(self._facts[:, symbols.OWN_DONE].mean())
        best = best_subgoal(agreeing, self._costs, done, self.agent, self.config)
        return best, np.array(sorted(agreeing[best]), np.int64)

    def choose_action(self, subgoal: Literal, agreeing: IntArray) -> Decision:
        """Return the decision for a subgoal, by search over the agreeing particles."""
        support = len(agreeing) / self.config.particles
        held = int(self.beliefs.held[agreeing[0], self.agent])
        at_once = reflex(subgoal, int(agreeing[0]), self.agent, self.beliefs, self.model)
        if at_once is not None:
            return Decision(at_once, subgoal, support, _NO_ACTIONS, _NO_ACTIONS, _NO_VALUES, held)
        actions = pomcp.actions_for(subgoal, self.agent, held, self._planner.stance.contested)
        found = self._search_actions(subgoal, agreeing, actions)
        return Decision(found.best, subgoal, support, actions, found.visits, found.values, held)

    def _search_actions(
        self, subgoal: Literal, agreeing: IntArray, actions: IntArray
    ) -> RootStatistics:
        pomcp.clear(self.tree)
        return search_actions(
            *(self.tree, subgoal, agreeing, actions, self.agent, self.beliefs, self.model),
            *(self.search, self._scratch, self._rng),
        )


def both_agents(
    goals: tuple[int, int], model: WorldModel, config: PlannerConfig, rng: np.random.Generator
) -> list[Agent]:
    """Return red and green, each with random numbers of its own; arguments as of the agent."""
    return [Agent(agent, goals, model, config, rng.spawn(1)[0]) for agent in range(len(AGENTS))]
