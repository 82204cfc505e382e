"""The inversion of the forward model: P(goals | trajectory), and with it that of the relation.

P(g_red, g_green | tau) ~ P(tau | g_red) P(tau | g_green) P(g_red, g_green) (paper, Appendix
"Predicate Inverse Planning"), over all pairs of effective goals. The paper says "a prior over
goals, often uniform". Under SIMPLE's prior each agent's effective goal is uniform over the 34
that it can have, but the two go together more often than by chance: 2 of 3 times one agent helps
or hinders the other. That is the default here, so that the two models differ in physics and
nothing else; the other choice, :data:`INDEPENDENT`, has all pairs alike.
"""

from __future__ import annotations

import functools
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import unknown_name
from phase_ppl.world.goals import N_GOALS, is_self_referring
from phase_ppl.world.names import AGENTS
from phase_ppl.world.relations import RELATION_TABLE, RELATIONS

INDEPENDENT: Final = "independent"
"""Name of the prior under which all pairs of effective goals are alike."""

_STRENGTH: Final = 450.0


class Inverse(NamedTuple):
    """Probabilities of goals and relation.

    Attributes:
        joint: (goal of red, goal of green).
        goal_red, goal_green: (36,) marginals.
        relation: (3,) of ``RELATIONS``, which follows from the two goals.
    """

    joint: FloatArray
    goal_red: FloatArray
    goal_green: FloatArray
    relation: FloatArray


def posterior(log_likelihood: FloatArray, log_prior: FloatArray) -> Inverse:
    """Return what a symbolic trajectory says.

    Args:
        log_likelihood: (agent, goal) log P(trajectory | goal) of each agent.
        log_prior: (goal of red, goal of green).
    """
    log_joint = log_likelihood[0][:, None] + log_likelihood[1] + log_prior
    joint = np.exp(log_joint - log_joint.max())
    joint /= joint.sum()
    relation = np.array([joint[index == RELATION_TABLE].sum() for index in range(len(RELATIONS))])
    return Inverse(joint, joint.sum(axis=1), joint.sum(axis=0), relation)


def log_prior_of_pairs(name: str) -> FloatArray:
    """Return the log prior of pairs of effective goals (goal of red, goal of green), sum 1.

    Args:
        name: :data:`INDEPENDENT`, or a ready-made prior of SIMPLE
            (:mod:`phase_ppl.models.priors`), in all of which goals and strengths are independent.

    Raises:
        UnknownNameError: there is none of that name; the message names close matches.
    """
    if name != INDEPENDENT:
        from phase_ppl.models import priors

        if not isinstance(name, str) or name not in priors.available():
            raise unknown_name("prior", name, [INDEPENDENT, *priors.available()])
    return _log_prior_of_pairs(name)


@functools.cache
def _log_prior_of_pairs(name: str) -> FloatArray:
    possible = [
        np.array([not is_self_referring(goal, agent) for goal in range(N_GOALS)])
        for agent in range(len(AGENTS))
    ]
    allowed = possible[0][:, None] & possible[1]
    if name == INDEPENDENT:
        prior = allowed / allowed.sum()
    else:
        prior = np.where(allowed, _of_simple(name), 0.0)
        prior /= prior.sum()
    with np.errstate(divide="ignore"):
        log_prior: FloatArray = np.log(prior)
    log_prior.flags.writeable = False
    return log_prior


def _of_simple(name: str) -> FloatArray:
    from phase_ppl.models import priors
    from phase_ppl.models.effective import log_prior_of_effective

    pairs = np.argwhere(np.ones((N_GOALS, N_GOALS)))
    strengths = {
        site: np.full(len(pairs), _STRENGTH) for site in ("strength_red", "strength_green")
    }
    log_prior = log_prior_of_effective(priors.named(name), pairs, strengths)
    prior: FloatArray = np.exp(log_prior - log_prior.max()).reshape(N_GOALS, N_GOALS)
    return prior
