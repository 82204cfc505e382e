"""Metropolis-Hastings with proposals from the prior."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import random

from phase_ppl.inference.particle import ParticleKernel, chosen, log_uniform
from phase_ppl.inference.registry import register_kernel
from phase_ppl.models.program import EventProgram


class PriorMHState(NamedTuple):
    """State of one particle.

    Attributes:
        i: iterations so far.
        z: site -> value, the current hypothesis with any further sites.
        sim_seed: seed of its simulation.
        log_prior: its log prior density.
        step_error: (time,) errors of its simulation, units; never simulated again.
        log_joint: log prior + log likelihood, in single precision.
        accepted: whether the last proposal was accepted.
        n_accepted: how many were.
        rng_key: of the chain.
    """

    i: jax.Array
    z: dict[str, jax.Array]
    sim_seed: jax.Array
    log_prior: jax.Array
    step_error: jax.Array
    log_joint: jax.Array
    accepted: jax.Array
    n_accepted: jax.Array
    rng_key: jax.Array


class PriorMH(ParticleKernel[PriorMHState]):
    """Independence sampler: each proposal is a fresh draw from the prior.

    Prior and proposal cancel, so that the acceptance ratio is that of the likelihoods. The seed
    of the simulation belongs to the state (pseudo-marginal): the stationary law of the hypothesis
    is the posterior under the likelihood's mean over seeds.

    Args:
        program: the model of an event.
        early_reject: stop simulations that cannot be accepted any more.
    """

    validity = "exact"

    def __init__(self, program: EventProgram | None = None, *, early_reject: bool = True) -> None:
        super().__init__(program)
        self._early_reject = early_reject

    def propose_initial(self, key: jax.Array) -> dict[str, jax.Array]:
        """Return a hypothesis from the prior."""
        return self.model.draw_prior(key)

    def start_one(
        self, key: jax.Array, key_start: jax.Array, sites: dict[str, jax.Array]
    ) -> PriorMHState:
        """Simulate the initial hypothesis."""
        program = self.model
        seed = program.simulator_seed(key_start, sites)
        log_prior = program.log_prior(sites)
        step_error = program.simulate(sites, log_prior, seed)
        log_joint = log_prior + program.log_likelihood(step_error).sum()
        none = jnp.zeros((), jnp.int32)
        return PriorMHState(
            none, sites, seed, log_prior, step_error, log_joint, jnp.array(False), none, key
        )

    def step_one(self, state: PriorMHState) -> PriorMHState:
        """Propose from the prior, accept by the ratio of likelihoods."""
        program = self.model
        key, key_sites, key_seed, key_accept = random.split(state.rng_key, 4)
        proposed = program.draw_prior(key_sites)
        log_prior = program.log_prior(proposed)
        seed = program.simulator_seed(key_seed, proposed)
        current = program.log_likelihood(state.step_error)
        log_u = log_uniform(key_accept)
        ceiling = self.error_ceiling(log_u + current.sum()) if self._early_reject else np.inf
        step_error = program.simulate(proposed, log_prior, seed, ceiling)
        by_frame = program.log_likelihood(step_error)
        # frame by frame, so that the large constant of the likelihood cancels without rounding
        accepted = log_u < (by_frame - current).sum()
        new = (proposed, seed, log_prior, step_error, log_prior + by_frame.sum())
        z, seed, log_prior, step_error, log_joint = chosen(accepted, new, _kept(state))
        return PriorMHState(
            state.i + 1,
            z,
            seed,
            log_prior,
            step_error,
            log_joint,
            accepted,
            state.n_accepted + accepted,
            key,
        )


def _kept(state: PriorMHState) -> tuple[Any, ...]:
    return state.z, state.sim_seed, state.log_prior, state.step_error, state.log_joint


@register_kernel("prior_mh", validity="exact")
def prior_mh(program: EventProgram, *, early_reject: bool = True) -> PriorMH:
    """Metropolis-Hastings with proposals from the prior."""
    return PriorMH(program, early_reject=early_reject)
