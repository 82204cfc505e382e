"""Metropolis-Hastings with proposals from the prior: the simplest generic sampler."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from phase_ppl.inference.kernels.base import HypothesisMH, MHState, Proposal
from phase_ppl.inference.program import Sites
from phase_ppl.inference.registry import register_kernel


@register_kernel(
    "prior_mh",
    validity="exact",
    sims_per_step=1,
    chain_methods=("vectorized", "sequential", "parallel"),
)
class PriorMH(HypothesisMH):
    """Independent proposals from the prior; the acceptance ratio is that of the likelihoods."""

    def initial(self, key: jax.Array) -> Sites:
        """Draw from the prior."""
        return self.program.sample_prior(key)

    def propose(self, key: jax.Array, state: MHState) -> Proposal:
        """Draw from the prior."""
        z = self.program.sample_prior(key)
        log_prior = self.program.log_prior(z)
        return Proposal(
            z,
            log_prior,
            jnp.full((), -1, jnp.int32),
            log_prior,
            lambda errors: state.log_prior,
            state.log_prior,
        )
