"""A model as a function of uniform numbers, for samplers that know no discrete sites.

Every latent site of the prior is its inverse distribution function at a uniform number, one site
after the other. The simulator's seed is a function of one more number. Such a model has no discrete
site, and its prior is uniform.
"""

from __future__ import annotations

import contextlib
import math
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpyro.distributions as dist
from numpyro import handlers

from phase_ppl.models.bridge import no_gradient
from phase_ppl.models.density import latent_sites, tracing
from phase_ppl.models.model import Model
from phase_ppl.world.errors import InvalidSettingError

IMPOSSIBLE_POTENTIAL: Final = 1e8
"""Potential of points without mass. It is finite: NumPyro's SA never leaves a point with infinite
potential."""

SEED_BITS: Final = 24  # bits of a uniform number in single precision that make a seed
_STEPS: Final = 2**16  # distinct values of a uniform number


def dimensions(model: Model) -> int:
    """Return how many numbers make a hypothesis and, unless noise is fixed, the seed."""
    return sum(map(math.prod, model.sites.values())) + (model.noise == "fresh")


@jax.custom_jvp
def in_steps(uniform: jax.Array) -> jax.Array:
    """Return uniform numbers rounded to the middle of one of many steps.

    Compiled code rounds the same sum differently in different places. Steps let a simulation be
    recognised when the sampler has moved there. Once in some thousand iterations this fails, and
    the point is simulated again.
    """
    steps = jnp.minimum(jnp.floor(uniform * _STEPS), _STEPS - 1)
    return (steps + 0.5) / _STEPS


in_steps.defjvp(no_gradient)  # a gradient of 0 everywhere would be worse than an error


@tracing()
def sites_at(model: Model, uniform: jax.Array) -> dict[str, jax.Array]:
    """Return the hypothesis, with any further sites, for uniform numbers (dimension,).

    Raises:
        InvalidSettingError: a site of the prior has no inverse distribution function.
    """
    numbers: dict[str, jax.Array] = {}
    begin = 0
    for name, shape in model.sites.items():
        numbers[name] = uniform[begin : begin + math.prod(shape)].reshape(shape)
        begin += math.prod(shape)

    def value(site: dict[str, Any]) -> jax.Array | None:
        name = site["name"]
        free = name in numbers and site["value"] is None
        return _quantile(name, site["fn"], numbers[name]) if free else None

    prior = handlers.substitute(model.prior, substitute_fn=value)
    found = latent_sites(handlers.trace(prior).get_trace())
    return {name: site["value"] for name, site in found.items()}


def _quantile(name: str, distribution: Any, uniform: jax.Array) -> jax.Array:
    """Return the inverse distribution function at ``uniform``, element by element."""
    while isinstance(distribution, dist.Independent | dist.ExpandedDistribution):
        distribution = distribution.base_dist  # broadcasting gives the shape back
    if not distribution.event_shape:
        with contextlib.suppress(NotImplementedError, ImportError):
            if distribution.has_enumerate_support:
                return _discrete_quantile(distribution, uniform)
            value: jax.Array = distribution.icdf(uniform)
            return value
    raise InvalidSettingError(
        f"site {name!r} ({type(distribution).__name__}) has no inverse distribution function, "
        "which this kernel needs"
    )


def _discrete_quantile(distribution: Any, uniform: jax.Array) -> jax.Array:
    support = distribution.enumerate_support(expand=True)
    reached = jnp.cumsum(jnp.exp(distribution.log_prob(support)), axis=0)
    reached = reached / reached[-1]
    index = (uniform[None] > reached[:-1]).sum(axis=0)
    values = jnp.broadcast_to(support, (len(support), *uniform.shape))
    return jnp.take_along_axis(values, index[None], axis=0)[0]
