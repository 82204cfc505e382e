"""Sequential Monte Carlo: a population that is cooled from the proposal to the posterior.

The particles of a run are one population. They start as draws from the proposal for the whole
observation, with weights P / Q. They pass through the laws P(h) p(w) L(e)^t of hypothesis h and
simulator seed w, from t = 0 to the posterior at t = 1 (Del Moral, Doucet, Jasra 2006).

Each iteration

1. raises t as far as the stored errors allow; reweighting needs no simulation;
2. resamples, systematically;
3. moves every particle once by Metropolis-Hastings at that t, with one simulation each.

The kernel of the moves may stop simulations early. From t = 1 on, iterations are moves only. If a
run ends before, its draws carry the remaining weight L^(1 - t). The draws are the last population
only.
"""

from __future__ import annotations

import copy
from typing import Any, Final, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax, random
from jax.scipy.special import logsumexp

from phase_ppl.inference.guide import Guide
from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.metropolis import EventKernel, PriorMH, for_each
from phase_ppl.inference.registry import register_kernel
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.models.bridge import Request
from phase_ppl.models.likelihood import TrajectoryLikelihood
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import unknown_name

_BISECTIONS = 40

TARGET: Final = 0.5
"""Share of the population that stays effective when the temperature rises. A lower one takes fewer
iterations to the posterior and leaves fewer distinct particles."""


class Tempered:
    """The likelihood raised to a temperature in [0, 1]; no longer a density."""

    def __init__(self, likelihood: TrajectoryLikelihood, temperature: jax.Array) -> None:
        self._likelihood, self._temperature = likelihood, temperature

    def log_prob(self, errors: Any) -> Any:
        """Return the temperature times the log density of each frame; -inf without one."""
        log_prob = self._likelihood.log_prob(errors)
        # 0 times -inf is NaN; failed simulations stay impossible at any temperature
        return jnp.where(jnp.isfinite(log_prob), self._temperature * log_prob, -jnp.inf)

    def max_total_error(self, log_floor: Any, n_frames: int) -> Any:
        """Return the summed error with which L^temperature reaches the floor."""
        warm = jnp.maximum(self._temperature, jnp.finfo(jnp.float32).tiny)
        highest = self._likelihood.max_total_error(log_floor / warm, n_frames)
        return jnp.where(self._temperature > 0, highest, jnp.inf)


def tempered(program: EventProgram, temperature: jax.Array) -> EventProgram:
    """Return the program of the same event with its likelihood raised to a temperature."""
    warm = copy.copy(program)
    warm.likelihood = Tempered(program.likelihood, temperature)
    return warm


def next_temperature(
    log_weights: jax.Array, log_likelihood: jax.Array, temperature: jax.Array
) -> jax.Array:
    """Return the highest temperature that the population can be reweighted to.

    It is found by bisection on the conditional effective sample size (Zhou, Johansen, Aston 2016).
    :data:`TARGET` is the share of particles that stay effective under the increments of weight,
    given the weights so far. Both arrays are (n,), log likelihoods up to a constant.
    """
    share = log_weights - logsumexp(log_weights)

    def stays(candidate: jax.Array) -> jax.Array:
        increment = powered(log_likelihood, candidate - temperature)
        log_kept = 2 * logsumexp(share + increment) - logsumexp(share + 2 * increment)
        return jnp.where(jnp.isfinite(log_kept), jnp.exp(log_kept), 0.0) >= TARGET

    def halve(_: int, bounds: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bounds
        middle = (low + high) / 2
        enough = stays(middle)
        return jnp.where(enough, middle, low), jnp.where(enough, high, middle)

    low, _ = lax.fori_loop(0, _BISECTIONS, halve, (temperature, jnp.ones_like(temperature)))
    return jnp.where(stays(jnp.ones_like(temperature)), 1.0, low)


def powered(log_likelihood: jax.Array, power: jax.Array) -> jax.Array:
    """Return log L^power; an impossible L stays -inf at any power."""
    return jnp.where(jnp.isfinite(log_likelihood), power * log_likelihood, -jnp.inf)


def systematic(key: jax.Array, log_weights: jax.Array) -> jax.Array:
    """Return (n,) the particle at each place after systematic resampling.

    With equal weights every particle keeps its place.
    """
    n = len(log_weights)
    shares = jnp.cumsum(jnp.exp(log_weights - logsumexp(log_weights)))
    pointers = (jnp.arange(n) + random.uniform(key)) / n
    places = jnp.searchsorted(shares / shares[-1], pointers)
    equal = log_weights.max() == log_weights.min()
    return jnp.where(equal, jnp.arange(n), jnp.clip(places, 0, n - 1))


Move = Literal["local_mh", "prior_mh"]

MOVES: Final = get_args(Move)


class SMCState(NamedTuple):
    """State of the population; all arrays are (chain, ...)."""

    i: jax.Array
    particle: Any  # state of the kernel that moves the particles
    temperature: jax.Array  # t, the same for all
    # of the particles as draws from the posterior: what is left at t, up to a constant
    log_weight: jax.Array
    log_evidence: jax.Array  # estimate of the log probability of the observation, the same for all
    # the part that is due to the temperatures so far, less the log likelihood without any error
    log_evidence_so_far: jax.Array
    rng_key: jax.Array  # of the places; the population's randomness comes from the first

    @property
    def z(self) -> Any:
        return self.particle.z

    @property
    def sim_seed(self) -> Any:
        return self.particle.sim_seed

    @property
    def accepted(self) -> Any:
        return self.particle.accepted

    @property
    def n_accepted(self) -> Any:
        return self.particle.n_accepted


@register_kernel(
    "smc",
    validity="consistent",
    needs=("guide", "settings"),
    keeps="last",
    weighted=True,
    any_length=True,
)
class SMC(EventKernel):
    """Sequential Monte Carlo: a population cooled from the proposal to the posterior.

    Args:
        move: name of the kernel that moves the particles at each temperature.

    Raises:
        UnknownNameError: there is no such kernel for moves.
    """

    validity = "consistent"
    keeps = "last"
    weighted = True
    is_population = True

    def __init__(
        self,
        program: EventProgram,
        guide: Guide | None = None,
        settings: SimpleSettings | None = None,
        *,
        move: Move = "local_mh",
    ) -> None:
        super().__init__(program, guide, settings)
        if move not in MOVES:
            raise unknown_name("move", move, MOVES)
        self._move = move

    def _mover(self, program: EventProgram) -> LocalMH | PriorMH:
        if self._move == "local_mh":
            return LocalMH(program, self.guide, self.settings)
        return PriorMH(program)

    def initial(self, keys: jax.Array, given: dict[str, jax.Array] | None) -> tuple[Any, Request]:
        """Draw the population (chain,) from the proposal for the whole observation."""

        def one(key: jax.Array, sites: dict[str, jax.Array] | None) -> tuple[Any, Request]:
            key, key_sites, key_start = random.split(key, 3)
            drawn = self.guide.draw(key_sites, self.n_windows) if sites is None else sites
            return self._mover(self.program).start(key, key_start, drawn)

        return for_each(one, keys, given)

    def started(self, known: Any, step_error: jax.Array) -> SMCState:
        """Weigh the population."""

        def one(known: Any, step_error: jax.Array) -> SMCState:
            particle = self._mover(self.program).started(known, step_error)
            log_proposal = self.guide.log_prob(particle.z, jnp.asarray(self.n_windows))
            log_likelihood = self.program.relative_log_likelihood(particle.step_error)
            log_weight = particle.log_prior - log_proposal + log_likelihood
            zero = jnp.zeros(())
            return SMCState(
                i=particle.i,
                particle=particle,
                temperature=zero,
                log_weight=jnp.where(jnp.isfinite(log_likelihood), log_weight, -jnp.inf),
                log_evidence=zero,
                log_evidence_so_far=zero,
                rng_key=particle.rng_key,
            )

        state: SMCState = for_each(one, known, step_error)
        # before cooling the evidence is importance sampling's
        return state._replace(
            log_evidence=jnp.full_like(state.log_evidence, self._log_mean(state.log_weight))
        )

    def propose(self, state: SMCState) -> tuple[Any, Request]:
        """Cool and resample the population, and propose a move of each particle."""
        keys = for_each(lambda key: random.split(key, 3), state.rng_key)
        log_likelihood = self._log_likelihood(state.particle)
        old = state.temperature[0]
        before = state.log_weight - powered(log_likelihood, 1 - old)
        before = jnp.where(jnp.isfinite(state.log_weight), before, -jnp.inf)
        temperature = next_temperature(before, log_likelihood, old)
        weights = before + powered(log_likelihood, temperature - old)
        so_far = state.log_evidence_so_far + logsumexp(weights) - np.log(len(weights))

        places = systematic(keys[0, 0], weights)
        particle = jax.tree.map(lambda leaf: leaf[places], state.particle)
        particle = particle._replace(rng_key=keys[:, 1])
        mover = self._mover(tempered(self.program, temperature))
        proposed, request = for_each(mover.propose, particle)
        # the probability that a simulation is not stopped follows from L^t, not from L: so it
        # cannot be weighed like those of other kernels
        unknown = jnp.full_like(weights, np.nan)
        request = request._replace(log_proposal=unknown, log_bound=jnp.full_like(weights, np.inf))
        return (state.i + 1, proposed, temperature, so_far, keys[:, 2]), request

    def accept(self, known: Any, step_error: jax.Array) -> SMCState:
        """Move the population."""
        i, proposed, temperature, so_far, keys = known
        mover = self._mover(tempered(self.program, temperature))
        particle = for_each(mover.accept, proposed, step_error)
        log_weight = powered(self._log_likelihood(particle), 1 - temperature)
        return SMCState(
            i=i,
            particle=particle,
            temperature=jnp.full_like(so_far, temperature),
            log_weight=log_weight,
            log_evidence=so_far + self._log_mean(log_weight),
            log_evidence_so_far=so_far,
            rng_key=keys,
        )

    def _log_mean(self, log_weight: jax.Array) -> jax.Array:
        """Return the log of the mean weight, with the part of the likelihood that weights omit."""
        without_error = self.program.log_likelihood(jnp.zeros(self.program.n_frames)).sum()
        return logsumexp(log_weight) - np.log(len(log_weight)) + without_error

    def _log_likelihood(self, particle: Any) -> jax.Array:
        found: jax.Array = for_each(self.program.relative_log_likelihood, particle.step_error)
        return found
