"""The sites of a hypothesis, and default statements to use inside a prior of one's own.

A prior is a NumPyro program that samples all five sites; it may sample further ones::

    def helpers_common():
        numpyro.sample("alpha", dist.Categorical(probs=jnp.array([.2, .3, .3, .1, .1])))
        phase_ppl.sites.goals()
        phase_ppl.sites.strengths()

Strengths are real numbers, or one of a few (:class:`OneOf`).
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist

from phase_ppl.models.one_of import IMPOSSIBLE as IMPOSSIBLE
from phase_ppl.models.one_of import OneOf as OneOf
from phase_ppl.world.goals import N_GOALS, is_self_referring
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.names import AGENTS

GOAL_SITES: Final = ("goal_red", "goal_green")
"""Stated goals: indices into ``GOALS``."""

ALPHA_SITE: Final = "alpha"
"""Index into ``ALPHAS``."""

STRENGTH_SITES: Final = ("strength_red", "strength_green")
"""Maximum forces, newtons."""

HYPOTHESIS_SITES: Final = (*GOAL_SITES, ALPHA_SITE, *STRENGTH_SITES)

ALPHA_PROBABILITIES: Final = (1 / 3, 1 / 6, 1 / 6, 1 / 6, 1 / 6)
"""The paper's (Appendix 4B): u from {-1, 0, 1}; if not 0, one agent by chance has it."""

SELF_REFERRING: Final = np.array(
    [[is_self_referring(g, holder) for g in range(N_GOALS)] for holder in range(len(AGENTS))]
)
"""(holder, goal): goals that name their own holder and have no prior mass."""


def goals() -> tuple[jax.Array, jax.Array]:
    """Sample ``goal_red`` and ``goal_green``: the 34 that do not name their holder, alike."""
    logits = np.where(SELF_REFERRING, IMPOSSIBLE, 0.0)
    red, green = (
        numpyro.sample(name, dist.Categorical(logits=jnp.asarray(row)))
        for name, row in zip(GOAL_SITES, logits, strict=True)
    )
    return red, green


def alpha() -> jax.Array:
    """Sample ``alpha``: 1/3 for (0, 0), 1/6 for each of the others."""
    return numpyro.sample(ALPHA_SITE, dist.Categorical(probs=jnp.array(ALPHA_PROBABILITIES)))


def strengths() -> tuple[jax.Array, jax.Array]:
    """Sample ``strength_red`` and ``strength_green``: uniform on [150, 600] newtons."""
    red, green = (numpyro.sample(name, dist.Uniform(*STRENGTH_RANGE)) for name in STRENGTH_SITES)
    return red, green
