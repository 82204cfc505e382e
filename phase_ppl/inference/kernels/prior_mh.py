"""Metropolis-Hastings with proposals from the prior."""

from __future__ import annotations

import jax

from phase_ppl.inference.registry import register_kernel
from phase_ppl.inference.sampling.metropolis import MHState, ProposalKernel
from phase_ppl.models.program import EventProgram


class PriorMH(ProposalKernel):
    """Independence sampler: each proposal is a fresh draw from the prior.

    Prior and proposal cancel, so that the acceptance ratio is that of the likelihoods.
    """

    proposes_from_prior = True

    def propose(self, key: jax.Array, state: MHState) -> tuple[dict[str, jax.Array], jax.Array]:
        """Return a hypothesis from the prior."""
        sites = self.model.draw_prior(key)
        return sites, state.log_prior - self.model.log_prior(sites)


@register_kernel("prior_mh", validity="exact")
def prior_mh(program: EventProgram, *, early_reject: bool = True) -> PriorMH:
    """Metropolis-Hastings with proposals from the prior."""
    return PriorMH(program, early_reject=early_reject)
