"""A likelihood raised to a power, and the arithmetic of tempering a population."""

from __future__ import annotations

import copy
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax, random
from jax.scipy.special import logsumexp

from phase_ppl.models.likelihood import Likelihood
from phase_ppl.models.program import EventProgram

_BISECTIONS = 40


class Tempered:
    """The likelihood L^temperature; not a density any more.

    Args:
        likelihood: L.
        temperature: in [0, 1]; may be known only inside compiled code.
    """

    def __init__(self, likelihood: Likelihood, temperature: jax.Array) -> None:
        self._likelihood, self._temperature = likelihood, temperature

    def log_prob(self, errors: Any) -> Any:
        """Return the temperature times the log density of each frame; -inf without one."""
        log_prob = self._likelihood.log_prob(errors)
        # 0 times -inf is no number; what failed stays impossible at any temperature
        return jnp.where(jnp.isfinite(log_prob), self._temperature * log_prob, -jnp.inf)

    def max_total_error(self, log_floor: Any, n_frames: int) -> Any:
        """Return the summed error with which L^temperature reaches the floor."""
        warm = jnp.maximum(self._temperature, jnp.finfo(jnp.float32).tiny)
        highest = self._likelihood.max_total_error(log_floor / warm, n_frames)
        return jnp.where(self._temperature > 0, highest, jnp.inf)


def tempered(program: EventProgram, temperature: jax.Array) -> EventProgram:
    """Return the program with its likelihood raised to ``temperature``."""
    model = copy.copy(program.model)
    # not dataclasses.replace: a model checks its prior anew, which compiled code cannot
    object.__setattr__(model, "likelihood", Tempered(program.model.likelihood, temperature))
    return EventProgram(model, program.bridge, program.n_frames, program.salt)


def effective_share(log_weights: jax.Array) -> jax.Array:
    """Return 1 / (n * sum of squared normalised weights), in (0, 1]; 0 without any weight."""
    log_share = 2 * logsumexp(log_weights) - logsumexp(2 * log_weights)
    return jnp.where(jnp.isfinite(log_share), jnp.exp(log_share), 0.0) / len(log_weights)


def next_temperature(
    log_weights: jax.Array, log_likelihood: jax.Array, temperature: jax.Array, target: float
) -> jax.Array:
    """Return the highest temperature that the population can be reweighted to.

    By bisection on the conditional effective sample size (Zhou, Johansen, Aston 2016): the share
    of particles that the increments of weight leave effective, given the weights so far.

    Args:
        log_weights: (n,) at the current temperature.
        log_likelihood: (n,) up to a constant.
        temperature: the current one, in [0, 1].
        target: share of particles that shall stay effective, in (0, 1).
    """
    share = log_weights - logsumexp(log_weights)

    def stays(candidate: jax.Array) -> jax.Array:
        increment = powered(log_likelihood, candidate - temperature)
        log_kept = 2 * logsumexp(share + increment) - logsumexp(share + 2 * increment)
        return jnp.where(jnp.isfinite(log_kept), jnp.exp(log_kept), 0.0) >= target

    def halve(_: int, bounds: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bounds
        middle = (low + high) / 2
        enough = stays(middle)
        return jnp.where(enough, middle, low), jnp.where(enough, high, middle)

    low, _ = lax.fori_loop(0, _BISECTIONS, halve, (temperature, jnp.ones_like(temperature)))
    return jnp.where(stays(jnp.ones_like(temperature)), 1.0, low)


def powered(log_likelihood: jax.Array, power: jax.Array) -> jax.Array:
    """Return log L^power; -inf for what is impossible, whatever the power."""
    return jnp.where(jnp.isfinite(log_likelihood), power * log_likelihood, -jnp.inf)


def systematic(key: jax.Array, log_weights: jax.Array) -> jax.Array:
    """Return (n,) which particle each place of a systematic resampling gets.

    With equal weights every particle keeps its place.
    """
    n = len(log_weights)
    shares = jnp.cumsum(jnp.exp(log_weights - logsumexp(log_weights)))
    pointers = (jnp.arange(n) + random.uniform(key)) / n
    places = jnp.searchsorted(shares / shares[-1], pointers)
    equal = log_weights.max() == log_weights.min()
    return jnp.where(equal, jnp.arange(n), jnp.clip(places, 0, n - 1))
