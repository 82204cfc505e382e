"""The hypothesis sites and their default statements, for use inside a prior of one's own.

============== ======================== =====================================================
site           support                  meaning
============== ======================== =====================================================
goal_red       0..35                    stated goal of the red agent, index into ``GOALS``
goal_green     0..35                    stated goal of the green agent
alpha          0..4                     index into ``ALPHAS``: who helps or hinders whom
strength_red   150..600                 maximum force of the red agent, newtons
strength_green 150..600                 maximum force of the green agent, newtons
============== ======================== =====================================================
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist

from phase_ppl.world.goals import N_GOALS, is_self_referring
from phase_ppl.world.hypothesis import ALPHAS, STRENGTH_RANGE
from phase_ppl.world.names import GREEN, RED

GOAL_SITES: Final = ("goal_red", "goal_green")
STRENGTH_SITES: Final = ("strength_red", "strength_green")
SITES: Final = (*GOAL_SITES, "alpha", *STRENGTH_SITES)

ALPHA_PROBABILITIES: Final = (1 / 3, 1 / 6, 1 / 6, 1 / 6, 1 / 6)
"""The paper's: u uniform on {-1, 0, 1}; if u is not 0, either agent gets it (Appendix 4B)."""

_POSSIBLE: Final = np.array(
    [[not is_self_referring(goal, agent) for goal in range(N_GOALS)] for agent in (RED, GREEN)]
)

GOAL_LOGITS: Final = np.where(_POSSIBLE, 0.0, -np.inf).astype(np.float32)
"""(agent, goal): uniform, but for the goal that names its own holder."""


def goals() -> tuple[jax.Array, jax.Array]:
    """Sample ``goal_red`` and ``goal_green``, uniform over the 35 goals each agent can have."""
    red, green = (
        numpyro.sample(
            name,
            # NumPyro's check allows no -inf
            dist.Categorical(logits=jnp.asarray(GOAL_LOGITS[agent]), validate_args=False),
        )
        for agent, name in enumerate(GOAL_SITES)
    )
    return red, green


def alpha() -> jax.Array:
    """Sample ``alpha`` with the paper's probabilities."""
    assert len(ALPHA_PROBABILITIES) == len(ALPHAS)
    return numpyro.sample("alpha", dist.Categorical(probs=jnp.array(ALPHA_PROBABILITIES)))


def strengths() -> tuple[jax.Array, jax.Array]:
    """Sample ``strength_red`` and ``strength_green``, uniform over 150..600 N."""
    red, green = (
        numpyro.sample(name, dist.Uniform(*(float(v) for v in STRENGTH_RANGE)))
        for name in STRENGTH_SITES
    )
    return red, green
