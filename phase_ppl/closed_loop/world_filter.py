"""One pass through a video of any world: what its agents would do, and what they did.

p(s_t+1 | s_<=t, h) = sum over joint actions of prod_i pi_i(a_i | h) p(s_t+1 | T(s_t, a)), as in
:mod:`phase_ppl.closed_loop.goal_filter`. The goals of all agents together are too many for a table,
but each agent's policy depends on its standpoint only (:mod:`phase_ppl.agents.standpoints`), and
most standpoints lead to the same intent: so a frame is kept as the few policies of each agent, the
number of the policy of each standpoint, and the density of the frame after every joint action.
What that says of hypotheses is worked out where it is asked
(:mod:`phase_ppl.analysis.roles_table`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from phase_ppl.agents.standpoints import standpoints
from phase_ppl.closed_loop.hidden_state import most_probable_actions
from phase_ppl.closed_loop.search_sets import Conduct, Looked, SearchSets
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.world.arrays import FloatArray, IntArray


class WorldReading(NamedTuple):
    """What one frame says."""

    # (joint action,) log density of the frame after it, the first agent's action most significant
    density: FloatArray
    # of each agent (policy, planner_seed, action) probabilities
    policies: list[FloatArray]
    policy_of: list[IntArray]  # of each agent (standpoint,) which of its policies
    # (agent, goal) log masses of each agent's goal, the others taken to act as is believed of them:
    # approximate, to draw hypotheses from where they are too many
    marginals: FloatArray
    strengths: FloatArray  # (combination,) probabilities given the frames so far
    actions: FloatArray  # (agent, action) probabilities of what each has just done
    held: IntArray  # (agent,) item that each most probably holds now, or ``NOTHING``
    unexplained: float  # as of ``goal_filter.Reading``
    log_peak: float
    searches: int  # searches that were made


class WorldFilter:
    """Takes in a video of any world frame by frame.

    Args:
        sets, conduct: as of :class:`~phase_ppl.closed_loop.goal_filter.GoalFilter`.
        weight: what a frame counts as evidence, and
        log_prior: (agent, goal) log prior masses; both are for ``marginals`` only.

    Attributes:
        combinations: (combination, agent) strengths that are followed, newtons.
    """

    def __init__(
        self,
        sets: SearchSets,
        conduct: Conduct,
        weight: float,
        log_prior: FloatArray,
    ) -> None:
        world = sets.scene.world
        self._sets, self._conduct, self._weight = sets, conduct, weight
        self._points = [standpoints(agent, world) for agent in range(len(world.agents))]
        self._marginals = log_prior.copy()
        self.combinations = sets.hidden.combinations
        # (agent) (goal,) the standpoint of each goal where the others want something else
        n_goals = len(world.goals)
        self._usual = [self._alone(agent, n_goals) for agent in range(len(world.agents))]

    def close(self) -> None:
        """End the threads."""
        self._sets.close()

    def read(self, frame: FloatArray) -> WorldReading:
        """Take in the next frame, (entity, 3) x, y [units], angle [rad]."""
        hidden = self._sets.hidden
        looked = self._sets.look()
        density = hidden.advance(frame, self._sets.map)
        relative = np.exp(density - density.max())
        policies, policy_of = self._policies(looked)
        self._learn(relative, policies, policy_of)
        self._sets.done(most_probable_actions(density))
        axes = range(density.ndim)
        actions = np.stack([relative.sum(tuple(a for a in axes if a != k)) for k in axes])
        return WorldReading(
            density.ravel(),
            policies,
            policy_of,
            self._marginals.copy(),
            hidden.strengths(),
            actions / actions.sum(axis=1, keepdims=True),
            hidden.best().held.copy(),
            hidden.log_peak - float(density.max()),
            hidden.log_peak,
            sum(len(root.actions) > 1 for each in looked for one in each for root in one.roots),
        )

    def _alone(self, agent: int, n_goals: int) -> IntArray:
        """Return (goal,) the first standpoint of an agent with each goal; -1: it cannot have it."""
        found = np.full(n_goals, -1)
        for one in reversed(self._points[agent].alike):
            found[one.own] = one.places[0]
        return found

    def _policies(
        self, looked: Sequence[Sequence[Looked]]
    ) -> tuple[list[FloatArray], list[IntArray]]:
        """Return each agent's different policies, and which of them each standpoint has."""
        policies, policy_of = [], []
        for sets in zip(*looked, strict=True):
            intents = np.stack([one.intent_of for one in sets], axis=1)
            kinds, number = np.unique(intents, axis=0, return_inverse=True)
            of_sets = []
            for place, one in enumerate(sets):
                found = [self._conduct.policy(root) for root in one.roots]
                found.append(np.full(N_ACTIONS, 1 / N_ACTIONS))  # of NO_INTENT, which is -1
                of_sets.append(np.array(found)[kinds[:, place]])
            policies.append(np.stack(of_sets, axis=1))
            policy_of.append(number.reshape(-1))
        return policies, policy_of

    def _learn(
        self, relative: FloatArray, policies: list[FloatArray], policy_of: list[IntArray]
    ) -> None:
        """Bring the marginals up to date."""
        of_goals, believed = [], []
        for table, numbers, usual, log_mass in zip(
            policies, policy_of, self._usual, self._marginals, strict=True
        ):
            mean = table.mean(axis=1)[numbers[usual]]
            mass = np.exp(log_mass - log_mass.max())
            of_goals.append(mean)
            believed.append(mass @ mean / mass.sum())
        for agent, mean in enumerate(of_goals):
            left = relative
            for other in range(len(believed) - 1, -1, -1):
                if other != agent:
                    left = np.tensordot(left, believed[other], axes=(other, 0))
            self._marginals[agent] += self._weight * np.log(mean @ left)
