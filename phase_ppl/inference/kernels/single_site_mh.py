"""Metropolis-Hastings that proposes one site at a time from the prior."""

from __future__ import annotations

import jax

from phase_ppl.inference.registry import register_kernel
from phase_ppl.inference.sampling.metropolis import MHState, ProposalKernel
from phase_ppl.inference.sampling.site_moves import moved_site
from phase_ppl.models.program import EventProgram


class SingleSiteMH(ProposalKernel):
    """Draws a random site from its prior given the sites above it; all others stay.

    A site of a user's own moves like any other, in whatever hierarchy it stands.
    """

    def propose(self, key: jax.Array, state: MHState) -> tuple[dict[str, jax.Array], jax.Array]:
        """Return the hypothesis with one site drawn anew."""
        model = self.model.model
        return moved_site(model.prior, key, state.z, tuple(model.sites))


@register_kernel("single_site_mh", validity="exact")
def single_site_mh(program: EventProgram, *, early_reject: bool = True) -> SingleSiteMH:
    """Metropolis-Hastings that proposes one site at a time from the prior."""
    return SingleSiteMH(program, early_reject=early_reject)
