"""Metropolis-Hastings that mixes SIMPLE's local moves with moves of single sites.

Local moves find where the observation points; single sites move about there. The kind of a move
is drawn beforehand and independently of the state, so that each kind is accepted by its own
ratio and the mixture leaves invariant what both leave invariant.
"""

from __future__ import annotations

from typing import Final

import jax.numpy as jnp
from jax import random

from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.registry import register_kernel
from phase_ppl.inference.sampling.metropolis import MHState
from phase_ppl.inference.sampling.particle import chosen
from phase_ppl.inference.sampling.site_moves import moved_site
from phase_ppl.inference.settings import SimpleSettings, probability
from phase_ppl.models.density import Program
from phase_ppl.models.program import EventProgram

LOCAL_SHARE: Final = 0.5


class MixtureMH(LocalMH):
    """Makes a local move (:class:`LocalMH`, exact rule), or draws one site from its prior.

    Args:
        program: the model of an event.
        guide: see :class:`LocalMH`.
        settings: see :class:`LocalMH`.
        local_share: probability of a local move.
        early_reject: stop a simulation once it cannot be accepted any more.

    Raises:
        InvalidSettingError: ``local_share`` is no number in [0, 1].
    """

    def __init__(
        self,
        program: EventProgram | None = None,
        guide: Program | None = None,
        settings: SimpleSettings | None = None,
        *,
        local_share: float = LOCAL_SHARE,
        early_reject: bool = True,
    ) -> None:
        super().__init__(program, guide, settings, early_reject=early_reject)
        self._local_share = probability("local_share", local_share)

    def step_one(self, state: MHState) -> MHState:
        """Make one of the two moves."""
        key, key_kind, *keys, key_seed, key_accept = random.split(state.rng_key, 7)
        key_window, key_local, key_site = keys
        model = self.model.model
        local = random.bernoulli(key_kind, self._local_share)
        # both are proposed, which costs nothing, and one of them is simulated
        window, sites = self.propose_locally(key_window, key_local, state)
        one_moved, log_hastings = moved_site(model.prior, key_site, state.z, tuple(model.sites))
        sites = chosen(local, sites, one_moved)
        move = self.local_move(window, sites, state)
        after = move.log_after
        known = self.log_known(move.log_prior, log_hastings, state)
        move = move._replace(
            log_known=jnp.where(local, move.log_known, known),
            log_after=lambda step_error: jnp.where(local, after(step_error), 0.0),
            log_bound=jnp.where(local, move.log_bound, 0.0),
            window=jnp.where(local, window, -1),
            log_proposal=jnp.where(local, move.log_proposal, jnp.nan),
        )
        return self.settle(move, state, key, key_seed, key_accept)


@register_kernel("mixture", validity="exact", needs=("guide", "settings"))
def mixture(
    program: EventProgram,
    *,
    guide: Program,
    settings: SimpleSettings,
    local_share: float = LOCAL_SHARE,
    early_reject: bool = True,
) -> MixtureMH:
    """Metropolis-Hastings that mixes SIMPLE's local moves with moves of single sites."""
    return MixtureMH(program, guide, settings, local_share=local_share, early_reject=early_reject)
