"""What one agent would do now, under every pair of goals at once.

What an agent sees and believes does not depend on its goal, and a search depends on the subgoal,
the particles that agree with it and the actions only. So there is one filter of beliefs, and each
search is made once for all the goals that call for it.
"""

from __future__ import annotations

import functools
import hashlib
from collections import defaultdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents import pomcp, symbols
from phase_ppl.agents.agent import RootStatistics, best_subgoal, reflex, search_actions
from phase_ppl.agents.beliefs import Perception
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.subgoals import SubgoalPlanner, stance, subgoal_planner
from phase_ppl.agents.world_model import Abilities, WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import Action
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.goals import N_GOALS, goal_literal, is_self_referring
from phase_ppl.world.names import Literal

NO_INTENT = -1
"""Stands for a pair of goals that is none."""


class Intent(NamedTuple):
    """What an agent is about: all that its next action depends on.

    Attributes:
        subgoal: the literal that it serves.
        agreeing: indices of the particles that agree with it.
        contested: whether the other agent wants the opposite, which allows more actions.
    """

    subgoal: Literal
    agreeing: tuple[int, ...]
    contested: bool


class Policies:
    """One agent's beliefs, and its intents under every pair of effective goals.

    Args:
        agent: 0 red, 1 green.
        model: layout and imagined physics.
        config: settings of the planner.
        seed: of beliefs and searches. A search's own seed follows from it, the step and the
            intent, so that its result does not depend on what else is searched.

    Attributes:
        intents: those of the last observation.
        of_pair: (goal_red, goal_green) -> index into ``intents``, or ``NO_INTENT`` where this
            agent's goal names itself, or the pair was not asked for.
    """

    def __init__(self, agent: int, model: WorldModel, config: PlannerConfig, seed: int) -> None:
        self.agent = agent
        self.config = config
        self._seed = seed
        self._perception = Perception(agent, model, config, np.random.default_rng([seed, agent]))
        self._search = pomcp.Search.of(config)
        self._codes = [
            np.array([pomcp.subgoal_code(goal_literal(g, holder)) for g in range(N_GOALS)])
            for holder in (agent, 1 - agent)
        ]
        particles = config.particles
        self._facts = np.zeros((particles, symbols.N_FACTS), np.int8)
        self._done = np.zeros((2, N_GOALS, particles), np.bool_)
        self._costs = np.zeros((N_GOALS, particles))
        self._planners = _planners(agent, model.abilities)
        self._groups: dict[bytes, list[tuple[symbols.SymbolicState, list[int]]]] = {}
        self._step = 0
        self.intents: list[Intent] = []
        self.of_pair = np.full((N_GOALS, N_GOALS), NO_INTENT)

    @property
    def model(self) -> WorldModel:
        """Layout and imagined physics; may be exchanged between observations."""
        return self._perception.model

    @model.setter
    def model(self, model: WorldModel) -> None:
        self._perception.model = model
        self._planners = _planners(self.agent, model.abilities)

    def done(self, action: Action) -> None:
        """Say what the agent has just executed."""
        self._perception.done(action)

    def observe(
        self,
        bodies: FloatArray,
        held: IntArray,
        weld: FloatArray,
        wanted: NDArray[np.bool_] | None = None,
    ) -> None:
        """Look at the true state; bring beliefs and intents up to date.

        Args:
            bodies, held, weld: the true state as ``physics.compiled.from_state`` gives it.
            wanted: (goal_red, goal_green) the pairs whose intents are needed; None: all.
        """
        self._step += 1
        self._perception.observe(bodies, held, weld)
        self._describe()
        found: dict[Intent, int] = {}
        of_pair = self.of_pair if self.agent == 0 else self.of_pair.T
        of_pair[:] = NO_INTENT
        asked = wanted if wanted is None or self.agent == 0 else wanted.T
        for own in range(N_GOALS):
            if is_self_referring(own, self.agent):
                continue
            for others in self._alike(own, None if asked is None else asked[own]):
                intent = self._intent(own, others[0])
                of_pair[own, others] = found.setdefault(intent, len(found))
        self.intents = list(found)

    def _alike(self, own: int, asked: NDArray[np.bool_] | None) -> list[list[int]]:
        """Return the other's goals in classes that lead to the same intent with goal ``own``."""
        classes: list[list[int]] = []
        for others in _alike(self.agent, own):
            chosen = others if asked is None else [other for other in others if asked[other]]
            if not chosen:
                continue
            if not self._planners[own, chosen[0]].stance.helps_along:
                classes.append(chosen)
                continue
            # it matters whether the other is where it wants to be
            by_done: dict[bytes, list[int]] = defaultdict(list)
            for other in chosen:
                by_done[self._done[1, other].tobytes()].append(other)
            classes += by_done.values()
        return classes

    def _describe(self) -> None:
        beliefs, model = self._perception.beliefs, self.model
        own, other = self._codes
        symbols.describe(
            beliefs.bodies,
            beliefs.held,
            self.agent,
            own[0],
            other[0],
            model.params,
            model.layout,
            self._facts,
            np.empty(self.config.particles),
        )
        for which, codes in ((1, other), (0, own)):
            symbols.describe_goals(
                beliefs.bodies,
                beliefs.held,
                self.agent,
                codes,
                model.params,
                model.layout,
                self._done[which],
                self._costs,
            )
        # particles that agree in all but the goals
        self._facts[:, [symbols.OWN_DONE, symbols.OTHER_DONE]] = 0
        rows, self._kind = np.unique(self._facts, axis=0, return_inverse=True)
        self._kinds = [symbols.unpack(row) for row in rows]
        self._observed = tuple(beliefs.observed.tolist())
        self._done_share = self._done[0].mean(axis=1)
        self._groups = {}

    def _grouped(self, kinds: IntArray) -> list[tuple[symbols.SymbolicState, list[int]]]:
        """Return the symbolic states among the particles, and which particles are in each.

        Args:
            kinds: (K,) 4 x place in ``_kinds`` + 2 x own goal reached + other's goal reached.
        """
        key = kinds.tobytes()
        if key not in self._groups:  # most goals are reached in the same particles: in none
            members: dict[int, list[int]] = defaultdict(list)
            for particle, kind in enumerate(kinds.tolist()):
                members[kind].append(particle)
            self._groups[key] = [
                (
                    self._kinds[kind >> 2]._replace(
                        own_done=bool(kind & 2), other_done=bool(kind & 1)
                    ),
                    members[kind],
                )
                for kind in sorted(members)
            ]
        return self._groups[key]

    def _intent(self, own: int, other: int) -> Intent:
        """Return what the agent is about with its own goal and the other's."""
        planner = self._planners[own, other]
        kinds = 4 * self._kind + 2 * self._done[0, own]
        if planner.stance.helps_along:
            kinds += self._done[1, other]
        agreeing: dict[Literal, list[int]] = defaultdict(list)
        for state, members in self._grouped(kinds):
            agreeing[planner.subgoal(state, self._observed)] += members
        best = best_subgoal(
            agreeing, self._costs[own], float(self._done_share[own]), self.agent, self.config
        )
        return Intent(best, tuple(sorted(agreeing[best])), planner.stance.contested)

    def root_statistics(self, intent: Intent) -> RootStatistics:
        """Return what the planner makes of one intent; only this much depends on chance.

        Where no search is needed there is one action, visited once.
        """
        beliefs = self._perception.beliefs
        first = intent.agreeing[0]
        action = reflex(intent.subgoal, first, self.agent, beliefs, self.model)
        if action is not None:
            once = np.ones(1, np.int64)
            return RootStatistics(np.array([action]), once, np.full(1, np.nan), action)
        actions = pomcp.actions_for(
            intent.subgoal, self.agent, int(beliefs.held[first, self.agent]), intent.contested
        )
        return search_actions(
            pomcp.make_tree(self.config.simulations),
            intent.subgoal,
            np.array(intent.agreeing, np.int64),
            actions,
            self.agent,
            beliefs,
            self.model,
            self._search,
            compiled.make_scratch(),
            self._rng(intent),
        )

    def _rng(self, intent: Intent) -> NDArray[np.uint64]:
        text = repr((self._seed, self.agent, self._step, intent.subgoal, intent.agreeing))
        digest = hashlib.blake2b(text.encode(), digest_size=8).digest()
        return np.frombuffer(digest, np.uint64).copy()


@functools.cache
def _alike(agent: int, own: int) -> list[list[int]]:
    """Return the other's goals in classes towards which an agent with goal ``own`` stands alike.

    A subgoal depends on the other's goal only in whether it is the same, or the opposite; and,
    when helping the other to get somewhere, in whether that is reached.
    """
    literal = goal_literal(own, agent)
    classes: dict[object, list[int]] = defaultdict(list)
    for other in range(N_GOALS):
        if not is_self_referring(other, 1 - agent):
            classes[stance(agent, literal, goal_literal(other, 1 - agent))].append(other)
    return list(classes.values())


@functools.lru_cache(maxsize=64)
def _planners(agent: int, abilities: Abilities) -> dict[tuple[int, int], SubgoalPlanner]:
    """Return (own goal, other's goal) -> planner, the same one for goals that are alike."""
    return {
        (own, other): subgoal_planner(
            agent, goal_literal(own, agent), goal_literal(others[0], 1 - agent), abilities
        )
        for own in range(N_GOALS)
        if not is_self_referring(own, agent)
        for others in _alike(agent, own)
        for other in others
    }
