"""One agent: what it believes, which subgoal it takes up, and what it does next.

Source: paper, Algorithm 1, the inner loop. Policy and dynamics are separate: an agent can be
asked for its decision in any true state; it never moves the world.
"""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents import pomcp, symbols
from phase_ppl.agents.beliefs import Beliefs, Perception
from phase_ppl.agents.choice import Root, best_subgoal, make_search, reflex, search_actions
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.mind import Mind
from phase_ppl.agents.subgoals import subgoal_planner
from phase_ppl.physics.actions import Action
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.names import Literal


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
    actions: NDArray[np.int64]
    visits: NDArray[np.int64]
    values: NDArray[np.float64]
    held: int


_NO_ACTIONS = np.empty(0, np.int64)
_NO_VALUES = np.empty(0)


class Agent:
    """Beliefs and planners of one agent.

    Args:
        agent: 0 red, 1 green.
        goals: effective goals of (red, green), indices into ``GOALS``; both agents know both.
        mind: layout and imagined physics.
        config: settings of the planner.
        generator: source of all randomness of this agent.
    """

    def __init__(
        self,
        agent: int,
        goals: tuple[int, int],
        mind: Mind,
        config: PlannerConfig,
        generator: np.random.Generator,
    ) -> None:
        self.agent = agent
        self.config = config
        self.mind = mind
        self.goal = goal_literal(goals[agent], agent)
        other_goal = goal_literal(goals[1 - agent], 1 - agent)
        self._goal_code = pomcp.subgoal_code(self.goal)
        self._other_code = pomcp.subgoal_code(other_goal)
        self._planner = subgoal_planner(agent, self.goal, other_goal, mind.abilities)
        self._perception = Perception(agent, mind, config, generator)
        self._rng = self._perception.rng
        self._scratch = self._perception.scratch
        self.search = make_search(config)
        self.tree = pomcp.make_tree(config.simulations)
        self._facts = np.zeros((config.particles, symbols.N_FACTS), np.int8)
        self._costs = np.zeros(config.particles)

    @property
    def beliefs(self) -> Beliefs:
        """The belief particles."""
        return self._perception.beliefs

    def decide(
        self, bodies: NDArray[np.float64], held: NDArray[np.int64], weld: NDArray[np.float64]
    ) -> Decision:
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

    def perceive(
        self, bodies: NDArray[np.float64], held: NDArray[np.int64], weld: NDArray[np.float64]
    ) -> None:
        """Observe the true state and bring the belief particles up to date."""
        self._perception.observe(bodies, held, weld)

    def choose_subgoal(self) -> tuple[Literal, NDArray[np.int64]]:
        """Return the subgoal of highest value V and the indices of the particles that agree.

        V(h) = share of the particles with subgoal h - lambda x their mean cost (Algorithm 1).
        """
        beliefs = self.beliefs
        symbols.describe(
            beliefs.bodies,
            beliefs.held,
            self.agent,
            self._goal_code,
            self._other_code,
            self.mind.params,
            self.mind.ground,
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

    def choose_action(self, subgoal: Literal, agreeing: NDArray[np.int64]) -> Decision:
        """Return the decision for a subgoal, by search over the agreeing particles."""
        support = len(agreeing) / self.config.particles
        held = int(self.beliefs.held[agreeing[0], self.agent])
        at_once = reflex(subgoal, int(agreeing[0]), self.agent, self.beliefs, self.mind)
        if at_once is not None:
            return Decision(at_once, subgoal, support, _NO_ACTIONS, _NO_ACTIONS, _NO_VALUES, held)
        actions = pomcp.actions_for(subgoal, self.agent, held, self._planner.stance.contested)
        found = self._search_actions(subgoal, agreeing, actions)
        action = Action(int(actions[found.column]))
        return Decision(action, subgoal, support, actions, found.visits, found.values, held)

    def _search_actions(
        self, subgoal: Literal, agreeing: NDArray[np.int64], actions: NDArray[np.int64]
    ) -> Root:
        """Search for the best action."""
        pomcp.clear(self.tree)
        return search_actions(
            self.tree,
            subgoal,
            agreeing,
            actions,
            self.agent,
            self.beliefs,
            self.mind,
            self.search,
            self._scratch,
            self._rng,
        )
