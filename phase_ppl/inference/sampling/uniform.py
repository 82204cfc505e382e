"""A model as a function of uniform numbers, for samplers that know real vectors only.

Every latent site of the prior is its inverse distribution function at a uniform number, site
after site, and the simulator's seed is a function of one more. Such a model has no discrete site,
and its prior is the same for every site; samplers move on the whole real line, u = 1 / (1 +
exp(-x)).
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpyro.distributions as dist
from jax import random
from numpyro import handlers
from numpyro.primitives import Messenger

from phase_ppl.models.density import latent_sites
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError

SEED_BITS: Final = 24
"""So many bits of a uniform number in single precision make a seed."""

IMPOSSIBLE: Final = 1e8
"""Potential of what has no mass. Finite: NumPyro's SA never gives up a point with an infinite
one."""

_STEPS: Final = 2**16
"""Distinct values of a uniform number."""


class At(NamedTuple):
    """What a point stands for.

    Attributes:
        sites: site -> value.
        seed: of the simulator.
        error: (time,) of the simulation, units.
        potential: - log density of the point, up to a constant.
    """

    sites: dict[str, jax.Array]
    seed: jax.Array
    error: jax.Array
    potential: jax.Array


class Uniformised:
    """The model of an event over real vectors.

    Args:
        program: the model of an event.

    Raises:
        InvalidSettingError: a site of the prior has no inverse distribution function.
    """

    def __init__(self, program: EventProgram) -> None:
        self.program = program
        sizes = [math.prod(shape) for shape in program.model.sites.values()]
        own_seed = program.model.noise == "fresh"
        self.n_sites = sum(sizes)
        self.dimensions = self.n_sites + own_seed
        jax.eval_shape(self.sites, jax.ShapeDtypeStruct((self.dimensions,), jnp.float32))

    def draw(self, key: jax.Array) -> jax.Array:
        """Return a point (dimension,) by chance, as likely as the prior makes it."""
        return random.logistic(key, (self.dimensions,))

    def sites(self, point: jax.Array) -> dict[str, jax.Array]:
        """Return the hypothesis, with any further sites, that a point stands for."""
        with handlers.trace() as trace, FromUniform(self._uniform(point)):
            self.program.model.prior()
        return {name: site["value"] for name, site in latent_sites(trace).items()}

    def __call__(self, point: jax.Array) -> At:
        """Return what a point stands for, simulated."""
        program, sites = self.program, self.sites(point)
        # the site after the last is the seed's; with fixed noise there is none, and no need
        seed = seed_of(program, self._uniform(point)[-1], sites)
        log_prior = program.log_prior(sites)
        error = program.simulate(sites, log_prior, seed)
        # the density of u is the same everywhere, that of x is du/dx = u (1 - u)
        volume = jax.nn.log_sigmoid(point) + jax.nn.log_sigmoid(-point)
        potential = -program.relative_log_likelihood(error) - volume.sum()
        potential = jnp.where(jnp.isfinite(potential), potential, IMPOSSIBLE)
        return At(sites, seed, error, potential)

    def potential(self, point: jax.Array) -> jax.Array:
        """Return - log density of a point (dimension,), up to a constant."""
        return self(point).potential

    def _uniform(self, point: jax.Array) -> jax.Array:
        # in steps: compiled code rounds the same sum differently in different places, and what
        # was simulated must be known again when the sampler has moved there; once in some
        # thousand iterations a step is missed, and simulated again
        steps = jnp.minimum(jnp.floor(jax.nn.sigmoid(point) * _STEPS), _STEPS - 1)
        return (steps + 0.5) / _STEPS


def seed_of(program: EventProgram, uniform: jax.Array, sites: dict[str, jax.Array]) -> jax.Array:
    """Return the simulator's seed for a number in [0, 1); with fixed noise it does not count."""
    number = jnp.floor(uniform * 2**SEED_BITS).astype(jnp.uint32)
    return program.simulator_seed(random.fold_in(random.key(0), number), sites)


class FromUniform(Messenger):
    """Effect handler that gives latent sites their values from uniform numbers, in turn.

    Args:
        uniform: (n,) numbers in (0, 1).
    """

    def __init__(self, uniform: jax.Array) -> None:
        super().__init__(None)
        self._uniform = uniform
        self._used = 0

    def process_message(self, msg: Any) -> None:
        """Give the site its value, if it has none."""
        if msg["type"] != "sample" or msg["is_observed"] or msg["value"] is not None:
            return
        shape = msg["fn"].shape()
        begin, self._used = self._used, self._used + math.prod(shape)
        msg["value"] = quantile(
            msg["name"], msg["fn"], self._uniform[begin : self._used].reshape(shape)
        )


def quantile(name: str, distribution: Any, uniform: jax.Array) -> jax.Array:
    """Return where a distribution function reaches ``uniform``, element by element.

    Args:
        name: of the site, for the error.
        distribution: of independent elements.
        uniform: of the distribution's shape.

    Raises:
        InvalidSettingError: its elements are not independent, or there is no such function.
    """
    kind = type(distribution).__name__
    while isinstance(distribution, dist.Independent | dist.ExpandedDistribution):
        distribution = distribution.base_dist  # broadcasting gives the shape back
        kind = type(distribution).__name__
    refused = InvalidSettingError(
        f"site {name!r} ({kind}) has no inverse distribution function, which this kernel needs"
    )
    if distribution.event_shape:
        raise refused
    try:
        if distribution.has_enumerate_support:
            return _discrete_quantile(distribution, uniform)
        value: jax.Array = distribution.icdf(uniform)
    except (NotImplementedError, ImportError):
        raise refused from None
    return value


def _discrete_quantile(distribution: Any, uniform: jax.Array) -> jax.Array:
    support = distribution.enumerate_support(expand=True)
    reached = jnp.cumsum(jnp.exp(distribution.log_prob(support)), axis=0)
    reached = reached / reached[-1]
    index = (uniform[None] > reached[:-1]).sum(axis=0)
    values = jnp.broadcast_to(support, (len(support), *uniform.shape))
    value: jax.Array = jnp.take_along_axis(values, index[None], axis=0)[0]
    return value
