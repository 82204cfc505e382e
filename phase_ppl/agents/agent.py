"""One agent: what it believes, which subgoal it takes up, and what it does next.

Source: paper, Algorithm 1, the inner loop. Policy and dynamics are separate: an agent can be
asked for its decision in any true state; it never moves the world.
"""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents import beliefs as belief
from phase_ppl.agents import pomcp, rewards, symbols, vision
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.ground import Ground, make_ground
from phase_ppl.agents.operators import Abilities
from phase_ppl.agents.rng import make_rng
from phase_ppl.agents.subgoals import subgoal_planner
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import Action
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.literals import STOP, Literal, Predicate
from phase_ppl.world.names import NOTHING
from phase_ppl.world.scene import Scene
from phase_ppl.world.state import State


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


class Mind(NamedTuple):
    """What both agents of a simulation share: the layout and the physics they imagine."""

    scene: Scene
    ground: Ground
    params: compiled.Params
    abilities: Abilities

    @classmethod
    def of(cls, scene: Scene, strengths: tuple[float, float], config: PlannerConfig) -> Mind:
        return cls(
            scene,
            make_ground(scene),
            compiled.make_params(
                scene, strengths, inner_steps=config.inner_steps, swivel=config.swivel
            ),
            Abilities.of(scene, strengths),
        )


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
        self._contested = other_goal == self.goal.negated()
        self._goal_code = rewards.subgoal_code(self.goal)
        self._other_code = rewards.subgoal_code(other_goal)
        self._planner = subgoal_planner(agent, self.goal, other_goal, mind.abilities)
        self._rng = make_rng(generator)
        bodies, _, _ = compiled.from_state(State.at_start(mind.scene), mind.scene.radius)
        self.beliefs = belief.initial_beliefs(
            bodies, agent, config.particles, mind.ground, generator
        )
        self.search = pomcp.Search(
            config.simulations,
            config.rollout_length,
            config.discount,
            config.c_init,
            config.c_base,
            config.early_stop,
            config.paired,
        )
        self.tree = pomcp.make_tree(config.simulations)
        self._scratch = compiled.make_scratch()
        self._facts = np.zeros((config.particles, symbols.N_FACTS), np.int8)
        self._costs = np.zeros(config.particles)
        self._last: tuple[Literal, NDArray[np.int64], int] | None = None
        self._last_action: Action | None = None

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
        self._last_action = action

    def perceive(
        self, bodies: NDArray[np.float64], held: NDArray[np.int64], weld: NDArray[np.float64]
    ) -> None:
        """Observe the true state and bring the belief particles up to date."""
        mind, beliefs = self.mind, self.beliefs
        vision.observe(
            bodies,
            held,
            self.agent,
            self.config.full_observation,
            mind.params,
            mind.ground,
            beliefs.visible,
            beliefs.cells,
            beliefs.observed,
        )
        if self.config.true_state:
            beliefs.bodies[:], beliefs.held[:], beliefs.weld[:] = bodies, held, weld
            return
        own_action = Action.NO_FORCE if self._last_action is None else self._last_action
        belief.update(
            beliefs,
            bodies,
            held,
            weld,
            self.agent,
            int(own_action),
            self._last_action is not None,
            mind.params,
            mind.ground,
            self._scratch,
            self._rng,
        )

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
        n = self.config.particles
        value = {
            subgoal: len(members) / n - self.config.cost_weight * self._costs[members].mean()
            for subgoal, members in agreeing.items()
        }
        candidates = sorted(value)
        # particles in which nothing is left to do are cheap; they must not end a search
        done = self._facts[:, symbols.OWN_DONE].mean() > 0.5
        if len(candidates) > 1 and not (done and len(agreeing.get(STOP, ())) > n / 2):
            candidates = [c for c in candidates if c != STOP]
        if self.config.touch_override:
            candidates = _touching(candidates, self.agent) or candidates
        best = max(candidates, key=value.__getitem__)
        return best, np.array(sorted(agreeing[best]), np.int64)

    def choose_action(self, subgoal: Literal, agreeing: NDArray[np.int64]) -> Decision:
        """Return the decision for a subgoal, by search over the agreeing particles."""
        support = len(agreeing) / self.config.particles
        held = int(self.beliefs.held[agreeing[0], self.agent])
        reflex = self._reflex(subgoal, agreeing)
        if reflex is not None:
            self._last = None
            return Decision(reflex, subgoal, support, _NO_ACTIONS, _NO_ACTIONS, _NO_VALUES, held)
        actions = rewards.actions_for(subgoal, self.agent, held, self._contested)
        column, visits, values = self._search_actions(subgoal, agreeing, actions)
        return Decision(
            Action(int(actions[column])), subgoal, support, actions, visits, values, held
        )

    def _search_actions(
        self, subgoal: Literal, agreeing: NDArray[np.int64], actions: NDArray[np.int64]
    ) -> tuple[int, NDArray[np.int64], NDArray[np.float64]]:
        """Return the best action's column, and visits and values of all at the root."""
        beliefs, tree = self.beliefs, self.tree
        if (
            self.config.tree_reuse
            and self._last is not None
            and self._last[0] == subgoal
            and np.array_equal(self._last[1], actions)
        ):
            pomcp.keep_subtree(tree, self._last[2])
        else:
            pomcp.clear(tree)
        column = pomcp.run(
            tree,
            beliefs.bodies,
            beliefs.held,
            beliefs.weld,
            agreeing,
            self.agent,
            rewards.subgoal_code(subgoal),
            actions,
            self.search,
            self.mind.params,
            self.mind.ground,
            self._scratch,
            self._rng,
        )
        self._last = (subgoal, actions, column)
        children = tree.child[0, : len(actions)]
        visited = children >= 0
        visits = np.where(visited, tree.visits[children], 0).astype(np.int64)
        with np.errstate(invalid="ignore", divide="ignore"):
            values = np.where(visited, tree.total[children] / np.maximum(visits, 1), np.nan)
        return column, visits, values

    def _reflex(self, subgoal: Literal, agreeing: NDArray[np.int64]) -> Action | None:
        """Return the action that needs no search: stop, let go, or grab what is in reach."""
        if subgoal == STOP:
            return Action.STOP
        if subgoal.predicate is not Predicate.ATTACH:
            return None
        if not subgoal.positive:
            return Action.DETACH
        k = int(agreeing[0])
        beliefs = self.beliefs
        if beliefs.held[k, self.agent] != NOTHING:
            return None
        item, _ = compiled.find_grab(
            beliefs.bodies[k], beliefs.held[k], self.agent, self.mind.params
        )
        return Action.ATTACH if item == subgoal.target else None


def _touching(candidates: list[Literal], agent: int) -> list[Literal]:
    """Return the TOUCH subgoal that the authors' code prefers: items first, then the agent."""
    order = {2: 0, 3: 1, 1 - agent: 2}
    touching = [c for c in candidates if c.predicate is Predicate.TOUCH and c.positive]
    return sorted(touching, key=lambda c: order[c.target])[:1]
