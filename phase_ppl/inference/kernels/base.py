"""What Metropolis-Hastings kernels over hypotheses share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import random
from numpyro.infer.mcmc import MCMCKernel
from numpyro.util import is_prng_key

from phase_ppl.inference.program import Program, Sites

CEILING_SLACK = 0.1
"""Simulations are stopped this much beyond the error at which acceptance becomes impossible, so
that the decision itself never hangs on rounding; units."""


class MHState(NamedTuple):
    """State of one chain.

    Attributes:
        i: iteration; 0 after ``init``.
        z: sites of the current hypothesis.
        sim_seed: seed of its simulation; the simulation is never run again.
        log_prior, log_likelihood: of the current hypothesis and simulation.
        step_error: (time,) errors of the current simulation, units.
        window: first frame of the last proposal's interval, -1 if there was none.
        accepted: whether the last proposal was accepted.
        acceptance_rate: mean of ``accepted`` since warm-up.
        rng_key: for the next iteration.
    """

    i: jax.Array
    z: Sites
    sim_seed: jax.Array
    log_prior: jax.Array
    log_likelihood: jax.Array
    step_error: jax.Array
    window: jax.Array
    accepted: jax.Array
    acceptance_rate: jax.Array
    rng_key: jax.Array


class Proposal(NamedTuple):
    """A proposed hypothesis and what is known about it before it is simulated.

    Attributes:
        z: sites.
        log_prior: of z.
        window: first frame of its interval, or -1.
        log_q_forward: log density of proposing z.
        reverse: gives the log density of the way back, from the errors of z's simulation.
        reverse_bound: upper bound of that.
    """

    z: Sites
    log_prior: jax.Array
    window: jax.Array
    log_q_forward: jax.Array
    reverse: Callable[[jax.Array], jax.Array]
    reverse_bound: jax.Array


class HypothesisMH(MCMCKernel):  # type: ignore[misc]
    """Metropolis-Hastings over hypotheses with a simulation per proposal.

    The uniform number of the acceptance test is drawn before simulating, so that a simulation
    stops as soon as its proposal cannot be accepted any more; the chain is the same as without.

    Args:
        program: the programs of one inference.
        early_reject: stop hopeless simulations.
    """

    sample_field = "z"

    def __init__(self, program: Program, *, early_reject: bool = True) -> None:
        self.program = program
        self.early_reject = early_reject
        self._num_warmup = 0

    @property
    def model(self) -> Program:
        return self.program

    @property
    def default_fields(self) -> tuple[str, ...]:
        return (self.sample_field,)

    def get_diagnostics_str(self, state: MHState) -> str:
        """Return the acceptance rate for NumPyro's progress bar."""
        return f"acc. rate={float(jnp.mean(state.acceptance_rate)):.2f}"

    def init(
        self,
        rng_key: jax.Array,
        num_warmup: int,
        init_params: Sites | None,
        model_args: tuple[Any, ...],
        model_kwargs: dict[str, Any],
    ) -> MHState:
        """Return the state of one chain, or of a batch of chains for a batch of keys."""
        self._num_warmup = num_warmup
        if is_prng_key(rng_key):
            return self._init_one(rng_key, init_params)
        axes = (0, None if init_params is None else 0)
        return jax.vmap(self._init_one, in_axes=axes)(rng_key, init_params)

    def sample(
        self, state: MHState, model_args: tuple[Any, ...], model_kwargs: dict[str, Any]
    ) -> MHState:
        """Return the next state of one chain or of a batch of chains."""
        if is_prng_key(state.rng_key):
            return self._sample_one(state)
        return jax.vmap(self._sample_one)(state)

    @abstractmethod
    def initial(self, key: jax.Array) -> Sites:
        """Draw the first hypothesis of a chain."""

    @abstractmethod
    def propose(self, key: jax.Array, state: MHState) -> Proposal:
        """Draw a proposal."""

    def log_target(self, log_prior: jax.Array, log_likelihood: jax.Array) -> jax.Array:
        """Return the log of what the acceptance ratio compares."""
        return log_prior + log_likelihood

    def _init_one(self, key: jax.Array, init_params: Sites | None) -> MHState:
        key, key_z, key_seed = random.split(key, 3)
        z = self.initial(key_z) if init_params is None else init_params
        z = {name: _strong(value) for name, value in z.items()}
        seed = random.bits(key_seed, (), jnp.uint32)
        log_likelihood, errors = self.program.log_likelihood(z, seed)
        return MHState(
            i=jnp.zeros((), jnp.int32),
            z=z,
            sim_seed=seed,
            log_prior=_strong(self.program.log_prior(z)),
            log_likelihood=_strong(log_likelihood),
            step_error=errors,
            window=jnp.full((), -1, jnp.int32),
            accepted=jnp.zeros((), bool),
            acceptance_rate=jnp.zeros((), jnp.float32),
            rng_key=key,
        )

    def _sample_one(self, state: MHState) -> MHState:
        key, key_proposal, key_seed, key_u = random.split(state.rng_key, 4)
        log_u = jnp.log(random.uniform(key_u))
        new = self.propose(key_proposal, state)
        seed = random.bits(key_seed, (), jnp.uint32)
        current = self.log_target(state.log_prior, state.log_likelihood)
        # log u < target' - target + reverse - forward, solved for the likelihood in target'
        known = self.log_target(new.log_prior, jnp.zeros(())) - current - new.log_q_forward
        floor = log_u - known - new.reverse_bound
        floor = jnp.where(jnp.isfinite(new.log_prior), floor, jnp.inf)
        ceiling = self.program.likelihood.max_total_error(floor, self.program.n_frames)
        ceiling = jnp.where(jnp.isnan(ceiling), jnp.inf, ceiling + CEILING_SLACK)
        if not self.early_reject:
            ceiling = jnp.where(jnp.isfinite(new.log_prior), jnp.inf, -jnp.inf)
        log_likelihood, errors = self.program.log_likelihood(new.z, seed, ceiling)
        complete = jnp.isfinite(log_likelihood)
        log_ratio = known + log_likelihood + new.reverse(jnp.where(complete, errors, 0.0))
        log_ratio = jnp.where(jnp.isfinite(state.log_likelihood), log_ratio, jnp.inf)
        accepted = complete & jnp.isfinite(new.log_prior) & (log_u < log_ratio)

        def chosen(proposed: Any, kept: Any) -> Any:
            return jax.tree.map(lambda a, b: jnp.where(accepted, a, b), proposed, kept)

        i = state.i + 1
        n = jnp.where(i <= self._num_warmup, i, i - self._num_warmup)
        return MHState(
            i=i,
            z=chosen({name: _strong(value) for name, value in new.z.items()}, state.z),
            sim_seed=chosen(seed, state.sim_seed),
            log_prior=chosen(_strong(new.log_prior), state.log_prior),
            log_likelihood=chosen(_strong(log_likelihood), state.log_likelihood),
            step_error=chosen(errors, state.step_error),
            window=new.window.astype(jnp.int32),
            accepted=accepted,
            acceptance_rate=state.acceptance_rate
            + (accepted.astype(jnp.float32) - state.acceptance_rate) / n,
            rng_key=key,
        )


def _strong(value: Any) -> jax.Array:
    """Return ``value`` without a weak type, which would make a loop compile twice."""
    array = jnp.asarray(value)
    return jax.lax.convert_element_type(array, array.dtype)
