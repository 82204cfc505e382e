"""The bottom-up proposal Q(h | window) as a NumPyro program (paper, Appendix 4B).

The guide is the prior program with some distributions replaced by those of the window: goals,
strengths with an estimate, and alpha if the tables have it. Alpha is then drawn first, even if the
program samples it after a goal. A user's further sites keep the prior's distributions, given the
sites before them.

With a small weight the whole hypothesis comes from the prior. So Q > 0 wherever the prior is, and
Hastings' correction is always defined. The paper prints no such share; without it Q is Q_local.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import random
from jax.scipy.special import logsumexp
from numpyro import handlers
from numpyro.distributions import constraints
from numpyro.primitives import Messenger

from phase_ppl.inference.tables import BottomUpTables
from phase_ppl.models.compiled import Compiled
from phase_ppl.models.density import Program, Sites, draw, log_density, remembered, traced
from phase_ppl.models.effective import space_of_prior
from phase_ppl.models.sites import IMPOSSIBLE, OneOf
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.space import ALPHA_SITE

Replace = Callable[[dist.Distribution, Mapping[str, jax.Array]], dist.Distribution]

NEVER = -80.0
"""Log probability below which a goal is taken to have no prior mass; NumPyro's categorical
distribution gives a probability of 0 a log of -87."""

_NEVER_WAY: Final = 1e-30
_PRIORS_KEPT: Final = 16
_PRIOR_DRAWS: Final = 32
"""Draws that average a prior of ways over a user's own sites."""


def bottom_up_guide(
    prior: Program,
    sites: Mapping[str, tuple[int, ...]],
    tables: BottomUpTables,
    *,
    prior_share: float,
) -> Guide:
    """Return the program ``guide(window)``: (1 - share) Q_local + share prior, one joint mixture.

    ``sites`` are the prior's latent sites with their shapes, in the order of sampling. The index
    after the last window stands for the whole observation. ``prior_share`` is in [0, 1).
    """
    local, whole = _local_program(prior, sites, tables), len(tables.goal_logits) - 1
    if prior_share == 0:
        return Guide((local,), (1.0,), sites, whole=whole)
    weights = 1 - prior_share, prior_share
    return Guide((local, lambda window: prior()), weights, sites, whole=whole)


def _local_program(
    prior: Program, sites: Mapping[str, tuple[int, ...]], tables: BottomUpTables
) -> Program:
    order, space, prior_of_way = list(sites), space_of_prior(prior), None
    way_site = ALPHA_SITE
    if tables.way_logits is not None and any(
        order.index(goal) < order.index(way_site) for goal in space.goal_sites
    ):
        prior_of_way = _prior_of_way(prior)

    def local(window: jax.Array) -> None:
        def here(table: FloatArray | jax.Array) -> jax.Array:
            return jnp.asarray(table, jnp.float32)[window]

        logits = here(tables.goal_logits)
        strength, strength_sd = here(tables.strength), here(tables.strength_sd)
        of_way = None if tables.way_logits is None else here(tables.way_logits)
        replace: dict[str, Replace] = {}
        given: dict[str, jax.Array] = {}
        if prior_of_way is not None and of_way is not None:
            both = dist.Categorical(logits=prior_of_way + of_way)
            given[way_site] = numpyro.sample(way_site, both)
        elif of_way is not None:
            replace[way_site] = functools.partial(_way_distribution, of_way)
        for agent, name in enumerate(space.goal_sites):
            of_agent = logits[..., agent, :]
            replace[name] = functools.partial(_goal_distribution, way_site, of_agent)
        for agent, name in enumerate(space.strength_sites):
            estimate = estimated(strength[agent], strength_sd[agent])
            replace[name] = functools.partial(strength_distribution, *estimate)
        with (
            handlers.block(hide=list(given)),
            handlers.substitute(data=given),
            Replaced(replace, given),
        ):
            prior()

    return local


@remembered(_PRIORS_KEPT)
def _prior_of_way(prior: Program) -> FloatArray:
    """Return (way,) the log prior, averaged over the sites that it depends on."""
    space = space_of_prior(prior)

    def probabilities(key: jax.Array) -> jax.Array:
        trace = traced(prior, key)
        return jnp.exp(trace[ALPHA_SITE]["fn"].log_prob(jnp.arange(len(space.ways))))

    def averaged() -> jax.Array:
        keys = random.split(random.key(0), _PRIOR_DRAWS)
        mean = jax.vmap(probabilities)(keys).mean(axis=0)
        return jnp.log(jnp.maximum(mean, _NEVER_WAY))

    return np.asarray(Compiled(averaged)())


def _way_distribution(
    logits: jax.Array, prior: dist.Distribution, values: Mapping[str, jax.Array]
) -> dist.Distribution:
    """Return the window's distribution of the way, times the prior given the sites before it."""
    return dist.Categorical(logits=prior.log_prob(jnp.arange(len(logits))) + logits)


def _goal_distribution(
    way_site: str, logits: jax.Array, prior: dist.Distribution, values: Mapping[str, jax.Array]
) -> dist.Distribution:
    """Return the window's distribution of a goal, on goals that have prior mass.

    Logits are (goal,), or (way, goal) if the goal depends on the way: ``values[way_site]``.
    """
    if logits.ndim == 2:
        logits = logits[values[way_site]]
    codes = jnp.arange(logits.shape[-1])
    possible = (prior.log_prob(codes) > NEVER) & prior.support(codes)
    return dist.Categorical(logits=jnp.where(possible, logits, IMPOSSIBLE))


def estimated(mean: jax.Array, sd: jax.Array) -> tuple[jax.Array, dist.Distribution]:
    """Return whether a strength [N] has an estimate (NaN: none), and its distribution."""
    known, (low, high) = ~jnp.isnan(mean), STRENGTH_RANGE
    mean = jnp.where(known, mean, (low + high) / 2)
    return known, dist.TruncatedNormal(mean, jnp.where(known, sd, 1.0), low=low, high=high)


def strength_distribution(
    known: jax.Array,
    estimate: dist.Distribution,
    prior: dist.Distribution,
    values: Mapping[str, jax.Array],
) -> dist.Distribution:
    """Return the window's distribution of a strength if there is an estimate, else the prior.

    If the prior is discrete, its values are weighed by the estimate's density.
    """
    if prior.support.is_discrete:
        levels = prior.enumerate_support(expand=False)
        possible = (prior.log_prob(levels) > NEVER) & prior.support(levels)
        logits = jnp.where(possible, estimate.log_prob(levels), IMPOSSIBLE)
        estimate = OneOf(levels, logits=logits)
    return Either(known, estimate, prior)


class Replaced(Messenger):
    """Effect handler that replaces the distributions of sites as they are sampled.

    Each replacement is a function of the distribution and of the values of earlier sites. Some
    values are ``given`` beforehand.
    """

    def __init__(self, replace: Mapping[str, Replace], given: Mapping[str, jax.Array]) -> None:
        super().__init__(None)
        self._replace = replace
        self._values = dict(given)

    def process_message(self, msg: Any) -> None:
        if msg["type"] == "sample" and not msg["is_observed"] and msg["name"] in self._replace:
            msg["fn"] = self._replace[msg["name"]](msg["fn"], self._values)

    def postprocess_message(self, msg: Any) -> None:
        if msg["type"] == "sample":
            self._values[msg["name"]] = msg["value"]


class Either(dist.Distribution):
    """The first of two scalar distributions if ``condition`` holds, else the second.

    The condition may be known only inside compiled code. The log density is -inf outside the
    support of the one that applies.
    """

    support = constraints.real

    def __init__(
        self, condition: jax.Array, first: dist.Distribution, second: dist.Distribution
    ) -> None:
        self._condition, self._parts = condition, (first, second)
        super().__init__((), ())

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        first, second = (part.sample(key, sample_shape) for part in self._parts)
        return jnp.where(self._condition, first, second)

    def log_prob(self, value: jax.Array) -> jax.Array:
        first, second = (
            jnp.where(part.support(value), part.log_prob(value), -jnp.inf) for part in self._parts
        )
        return jnp.where(self._condition, first, second)


class Guide:
    """A proposal Q(h | window): a NumPyro program ``guide(window)`` with draws and densities.

    It is a weighted mixture of programs over the same latent sites, and its density is the exact
    density of the mixture, over all components.

    Attributes:
        programs: the components.
        whole: argument of the bottom-up proposal that stands for the whole observation.
    """

    def __init__(
        self,
        programs: Sequence[Program],
        weights: Sequence[float],
        sites: Mapping[str, tuple[int, ...]],
        whole: int = 0,
    ) -> None:
        self.programs, self.whole = programs, whole
        self._log_weights = np.log(np.array(weights, np.float32))
        self._sites = sites

    def __call__(self, *args: Any) -> None:
        key = numpyro.prng_key()  # None where all values are given
        # the components' statements are hidden: only the mixture's own count
        with handlers.block():
            drawn = {} if key is None else self._drawn(key, *args)
        with handlers.substitute(data=drawn):
            values = {
                name: numpyro.sample(name, dist.ImproperUniform(constraints.real, (), shape))
                for name, shape in self._sites.items()
            }
        with handlers.block():
            parts = [log_density(program, values, *args) for program in self.programs]
        numpyro.factor("mixture", logsumexp(self._log_weights + jnp.stack(parts)))

    def draw(self, key: jax.Array, *args: Any) -> dict[str, jax.Array]:
        """Return a hypothesis, with any further sites; the argument is the window's number."""
        # what ``models.density.draw`` does, without the density
        return self._drawn(random.split(key)[1], *map(jnp.asarray, args))

    def log_prob(self, sites: Sites, *args: Any) -> jax.Array:
        """Return the log density of a hypothesis, -inf outside the support."""
        return log_density(self, sites, *args)

    def _drawn(self, key: jax.Array, *args: Any) -> dict[str, jax.Array]:
        key_which, *keys = random.split(key, 1 + len(self.programs))
        which = random.categorical(key_which, jnp.asarray(self._log_weights))
        draws = [draw(p, k, *args) for p, k in zip(self.programs, keys, strict=True)]
        return {
            name: jnp.stack([d[name].astype(draws[-1][name].dtype) for d in draws])[which]
            for name in self._sites
        }
