"""Every hypothesis, one after the other: for simulators fast enough."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
from jax import random
from numpyro.util import is_prng_key

from phase_ppl.inference.registry import register_kernel
from phase_ppl.inference.sampling.grid import Grid, hypothesis_grid
from phase_ppl.inference.sampling.particle import ParticleKernel, chosen
from phase_ppl.inference.settings import whole_number
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError

STRENGTHS: Final = (150.0, 300.0, 450.0, 600.0)
"""Grid of either agent's strength, newtons."""

MAX_SIMULATIONS: Final = 50_000


class EnumerationState(NamedTuple):
    """State of one particle, which works through its share of the hypotheses.

    Attributes:
        i: iterations so far.
        z: site -> value, the hypothesis simulated last; an earlier one, at weight 0, where
            that failed or all are done.
        sim_seed: seed of its simulation.
        log_weight: its log prior + log likelihood, less that without any error.
        accepted: whether the iteration's simulation was completed.
        n_accepted: how many were.
        rng_key: of the particle.
    """

    i: jax.Array
    z: dict[str, jax.Array]
    sim_seed: jax.Array
    log_weight: jax.Array
    accepted: jax.Array
    n_accepted: jax.Array
    rng_key: jax.Array


class Enumeration(ParticleKernel[EnumerationState]):
    """Simulates all pairs of effective goals and strengths; each draw weighs P(h) L.

    As good as its grid of strengths and, where the simulator is noisy, as its number of seeds:
    hence "consistent" and not "exact". The particles share the work; the seeds vary slowest.

    Args:
        program: the model of an event.
        strengths: grid of either agent's strength, newtons, weighted by the prior's density.
        noise_seeds: simulations of each hypothesis, with seeds of their own.
        max_simulations: more than these are refused.

    Raises:
        InvalidSettingError: the prior cannot be enumerated, or takes too many simulations; more
            than one seed where the model's noise is fixed.
    """

    validity = "consistent"
    keeps = "start"
    weighted = True

    def __init__(
        self,
        program: EventProgram | None = None,
        *,
        strengths: Sequence[float] = STRENGTHS,
        noise_seeds: int = 1,
        max_simulations: int = MAX_SIMULATIONS,
    ) -> None:
        super().__init__(program)
        self._strengths = strengths
        self._noise_seeds = whole_number("noise_seeds", noise_seeds)
        self._max_simulations = whole_number("max_simulations", max_simulations)
        if program is not None:
            self._check(program)

    def _check(self, program: EventProgram) -> None:
        if program.model.noise == "fixed" and self._noise_seeds > 1:
            raise InvalidSettingError(
                f"noise_seeds={self._noise_seeds}, but with noise='fixed' every hypothesis has "
                "one seed"
            )
        if self.n_simulations > self._max_simulations:
            raise InvalidSettingError(
                f"the prior leaves {self._grid.size} hypotheses with the strengths "
                f"{list(self._strengths)}; with noise_seeds={self._noise_seeds} that takes "
                f"{self.n_simulations} simulations, more than "
                f"max_simulations={self._max_simulations}"
            )

    @property
    def _grid(self) -> Grid:
        return hypothesis_grid(self.model.model, self._strengths)

    @property
    def n_simulations(self) -> int:
        """How many simulations all hypotheses take."""
        return self._grid.size * self._noise_seeds

    def n_iterations(self, chains: int) -> int:
        """Return how many iterations so many particles need after their initial ones."""
        return -(-self.n_simulations // chains) - 1

    def propose_initial(self, key: jax.Array) -> dict[str, jax.Array]:
        """Return the first hypothesis."""
        return self._sites(jnp.zeros((), jnp.int32))

    def _initial_sites(self, key: jax.Array) -> dict[str, jax.Array]:
        return self.propose_initial(key)

    def start_one(
        self, key: jax.Array, key_start: jax.Array, sites: dict[str, jax.Array]
    ) -> EnumerationState:
        """Return a particle before its first hypothesis."""
        none = jnp.zeros((), jnp.int32)
        return EnumerationState(
            i=none - 1,
            z=sites,
            sim_seed=none,
            log_weight=jnp.full((), -jnp.inf),
            accepted=jnp.array(False),
            n_accepted=none,
            rng_key=key,
        )

    def init(self, *args: object, **kwargs: object) -> EnumerationState:
        """Return the particles at their first hypotheses, simulated."""
        return self._sample_fn(super().init(*args, **kwargs))  # type: ignore[arg-type]

    def step_one(self, state: EnumerationState) -> EnumerationState:
        """Simulate the next hypothesis of a single particle, which does all of them."""
        return self._simulated(state, state.i + 1)

    def _sample_fn(self, state: EnumerationState) -> EnumerationState:
        if is_prng_key(state.rng_key):
            return self.step_one(state)
        chains = len(state.i)
        return jax.vmap(self._simulated)(state, (state.i + 1) * chains + jnp.arange(chains))

    def _sites(self, row: jax.Array) -> dict[str, jax.Array]:
        return {name: jnp.asarray(values)[row] for name, values in self._grid.sites.items()}

    def _simulated(self, state: EnumerationState, number: jax.Array) -> EnumerationState:
        """Simulate the hypothesis with this number, if there is one."""
        program = self.model
        key, key_seed = random.split(state.rng_key)
        row = number % self._grid.size
        sites = self._sites(row)
        exists = number < self.n_simulations
        log_prior = jnp.where(exists, program.log_prior(sites), -jnp.inf)
        seed = program.simulator_seed(key_seed, sites)
        error = program.simulate(sites, log_prior, seed)
        done = jnp.isfinite(error).all()
        log_weight = jnp.asarray(self._grid.log_prior)[row] + program.relative_log_likelihood(error)
        sites, seed = chosen(done, (sites, seed), (state.z, state.sim_seed))
        return EnumerationState(
            state.i + 1,
            sites,
            seed,
            jnp.where(done, log_weight, -jnp.inf),
            done,
            state.n_accepted + done,
            key,
        )


@register_kernel(
    "enumerate",
    validity="consistent",
    chain_methods=("vectorized",),
    keeps="start",
    weighted=True,
)
def enumerate_hypotheses(
    program: EventProgram,
    *,
    strengths: Sequence[float] = STRENGTHS,
    noise_seeds: int = 1,
    max_simulations: int = MAX_SIMULATIONS,
) -> Enumeration:
    """Enumeration of all pairs of effective goals on a grid of strengths."""
    return Enumeration(
        program,
        strengths=strengths,
        noise_seeds=noise_seeds,
        max_simulations=max_simulations,
    )
