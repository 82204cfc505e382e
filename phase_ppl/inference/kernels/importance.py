"""Importance sampling from what the windows of the observation show."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from jax.scipy.special import logsumexp

from phase_ppl.inference.kernels.particle import ParticleKernel, WeightedState
from phase_ppl.inference.registry import register_kernel
from phase_ppl.models.density import Sites, log_density


@register_kernel(
    "importance",
    validity="consistent",
    needs=("guide", "settings"),
    keeps="start",
    weighted=True,
    any_length=True,
)
class Importance(ParticleKernel[WeightedState]):
    """Importance sampling from the guide's mixture over windows.

    Draws are independent, each weighing P(h) L / Q(h). Q is the even mixture of the guide's
    proposals over all windows and the whole observation; with the guide's share of the prior it
    covers whatever the prior does. Nothing is stopped early.
    """

    validity = "consistent"

    initial_tries = 1

    def propose_initial(self, key: jax.Array) -> dict[str, jax.Array]:
        return self._draw(key)[0]

    def _draw(self, key: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
        key_window, key_sites = random.split(key)
        window = random.randint(key_window, (), 0, self.n_windows + 1)
        return self.draw_guide(key_sites, window), window

    def start_one(
        self, key: jax.Array, key_start: jax.Array, sites: dict[str, jax.Array]
    ) -> WeightedState:
        seed, log_weight = self._weighed(key_start, sites)
        possible = jnp.isfinite(log_weight)
        return WeightedState.before(key, sites, seed).after(key, sites, seed, log_weight, possible)

    def step_one(self, state: WeightedState) -> WeightedState:
        """Draw once more, whatever was drawn before."""
        key, key_sites, key_seed = random.split(state.rng_key, 3)
        sites, window = self._draw(key_sites)
        seed, log_weight = self._weighed(key_seed, sites)
        return state.after(key, sites, seed, log_weight, jnp.isfinite(log_weight), window)

    def _weighed(self, key: jax.Array, sites: Sites) -> tuple[jax.Array, jax.Array]:
        """Simulate a draw; return the seed and the log weight, -inf where it is impossible."""
        program = self.program
        seed = program.simulator_seed(key, sites)
        log_prior = program.log_prior(sites)
        windows = jnp.arange(self.most_windows + 1)  # and the whole observation
        by_window = jax.vmap(lambda window: log_density(self.guide, sites, window))(windows)
        by_window = jnp.where(windows <= self.n_windows, by_window, -jnp.inf)
        log_count = jnp.asarray(np.log(np.arange(1, len(windows) + 1)), jnp.float32)
        log_proposal = logsumexp(by_window) - log_count[self.n_windows]
        error = program.simulate(sites, log_prior, seed)
        log_weight = log_prior - log_proposal + program.relative_log_likelihood(error)
        return seed, jnp.where(jnp.isfinite(error).all(), log_weight, -jnp.inf)
