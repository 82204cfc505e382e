"""From what each agent seems to work for to a joint proposal of goals and alpha.

A helper or hinderer works for the other's goal or against it. Given alpha, the stated goal that
both act on therefore has the scores of both agents, and the goal that nobody acts on has none.
Alpha itself is proposed by how well its best goals score, beside its prior: the tables are those
of the distribution over (goal_red, goal_green, alpha) in proportion to

    P(alpha) exp(score of red's effective goal + score of green's effective goal).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.models.sites import IMPOSSIBLE, SELF_REFERRING
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.goals import N_GOALS, effective_goals
from phase_ppl.world.hypothesis import ALPHAS
from phase_ppl.world.names import AGENTS


class JointLogits(NamedTuple):
    """Unnormalised log probabilities of stated goals and alpha.

    Attributes:
        goal: (..., alpha, agent, goal) of the stated goals, given alpha.
        alpha: (..., alpha) beside the prior's.
    """

    goal: FloatArray
    alpha: FloatArray


def joint_logits(scores: FloatArray) -> JointLogits:
    """Return the tables that scores (..., agent, goal) of effective goals make."""
    goal = np.where(SELF_REFERRING, IMPOSSIBLE, 0.0)
    goal = np.broadcast_to(goal, (*scores.shape[:-2], len(ALPHAS), *goal.shape)).copy()
    for index in range(len(ALPHAS)):
        for agent in range(len(AGENTS)):
            for actor, acted_on in enumerate(_FOLLOWED[index]):
                if _SOURCE[index][actor] == agent:
                    goal[..., index, agent, :] += scores[..., actor, :][..., acted_on]
    goal = np.where(SELF_REFERRING, IMPOSSIBLE, goal)
    evidence = np.logaddexp.reduce(goal, axis=-1).sum(axis=-1)
    return JointLogits(goal, evidence - evidence.max(axis=-1, keepdims=True))


def _source(alpha: tuple[int, int]) -> tuple[int, ...]:
    """Return, per agent, whose stated goal it acts on."""
    return tuple(agent if alpha[agent] == 0 else 1 - agent for agent in range(len(AGENTS)))


def _followed(alpha: tuple[int, int]) -> tuple[NDArray[np.int64], ...]:
    """Return, per agent, its effective goal for every stated goal of the one it acts on."""
    pairs = np.array([effective_goals(goal, goal, alpha) for goal in range(N_GOALS)])
    return tuple(pairs[:, agent] for agent in range(len(AGENTS)))


_SOURCE: Final = [_source(alpha) for alpha in ALPHAS]
_FOLLOWED: Final = [_followed(alpha) for alpha in ALPHAS]
