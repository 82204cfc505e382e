"""The bottom-up proposal Q(h | window) as a NumPyro program (paper, Appendix 4B).

The guide is the prior program with some of its distributions replaced by what the window shows:
those of the goals, and of the strengths where there is an estimate. Alpha and any further sites
of the user's keep the prior's, given the sites before them. With a small weight the whole
hypothesis comes from the prior itself, so that Q > 0 wherever the prior is and Hastings'
correction is always defined.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

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

from phase_ppl.inference.proposals import BottomUpTables
from phase_ppl.models.density import Program, draw, log_density
from phase_ppl.models.sites import GOAL_SITES, IMPOSSIBLE, STRENGTH_SITES
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import STRENGTH_RANGE

Replace = Callable[[dist.Distribution], dist.Distribution]

_NEVER = -80.0
"""Log probability below which a goal is taken to have no prior mass; NumPyro's categorical
distribution gives a probability of 0 a log of -87."""


def bottom_up_guide(
    prior: Program,
    sites: Mapping[str, tuple[int, ...]],
    tables: BottomUpTables,
    *,
    prior_share: float,
) -> Mixture:
    """Return the program ``guide(window)``: (1 - share) Q_local + share prior, one joint mixture.

    Args:
        prior: the user's prior.
        sites: its latent sites and their shapes.
        tables: of the event; the index after the last window stands for the whole observation.
        prior_share: weight of the prior, in (0, 1).
    """
    local = _local_program(prior, tables)
    return Mixture((local, lambda window: prior()), (1 - prior_share, prior_share), sites)


def _local_program(prior: Program, tables: BottomUpTables) -> Program:
    logits = jnp.asarray(tables.goal_logits, jnp.float32)
    strength = jnp.asarray(tables.strength, jnp.float32)
    known = ~jnp.isnan(strength)
    estimate = jnp.where(known, strength, float(np.mean(STRENGTH_RANGE)))
    sd = jnp.where(known, jnp.asarray(tables.strength_sd, jnp.float32), 1.0)

    def local(window: jax.Array) -> None:
        replace: dict[str, Replace] = {}
        for agent, name in enumerate(GOAL_SITES):
            replace[name] = functools.partial(_goal_distribution, logits[window, agent])
        for agent, name in enumerate(STRENGTH_SITES):
            normal = dist.TruncatedNormal(
                estimate[window, agent],
                sd[window, agent],
                low=STRENGTH_RANGE[0],
                high=STRENGTH_RANGE[1],
            )
            replace[name] = functools.partial(Either, known[window, agent], normal)
        with Replaced(replace):
            prior()

    return local


def _goal_distribution(logits: jax.Array, prior: dist.Distribution) -> dist.Distribution:
    """Return the window's distribution of a goal, on goals that have prior mass."""
    possible = prior.log_prob(jnp.arange(N_GOALS)) > _NEVER
    return dist.Categorical(logits=jnp.where(possible, logits, IMPOSSIBLE))


class Replaced(Messenger):
    """Effect handler that replaces the distributions of sites as they are sampled.

    Args:
        replace: site -> function of its distribution that returns another one.
    """

    def __init__(self, replace: Mapping[str, Replace]) -> None:
        super().__init__(None)
        self._replace = replace

    def process_message(self, msg: Any) -> None:
        """Replace the distribution if the message is about one of the sites."""
        if msg["type"] == "sample" and not msg["is_observed"] and msg["name"] in self._replace:
            msg["fn"] = self._replace[msg["name"]](msg["fn"])


class Either(dist.Distribution):
    """The first of two scalar distributions if ``condition`` holds, else the second.

    Args:
        condition: a boolean, perhaps known only inside compiled code.
        first, second: distributions of the same kind of value.
    """

    support = constraints.real

    def __init__(
        self, condition: jax.Array, first: dist.Distribution, second: dist.Distribution
    ) -> None:
        self._condition, self._parts = condition, (first, second)
        super().__init__((), ())

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Draw from whichever applies."""
        first, second = (part.sample(key, sample_shape) for part in self._parts)
        return jnp.where(self._condition, first, second)

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Return the log density of whichever applies, -inf outside its support."""
        first, second = (
            jnp.where(part.support(value), part.log_prob(value), -jnp.inf) for part in self._parts
        )
        return jnp.where(self._condition, first, second)


class Mixture:
    """NumPyro program that is a mixture of programs over the same latent sites.

    Its density is the exact one of the mixture: all components can have made a given value.

    Args:
        programs: the components; called with the mixture's arguments.
        weights: their probabilities.
        sites: latent sites with their shapes.
    """

    def __init__(
        self,
        programs: Sequence[Program],
        weights: Sequence[float],
        sites: Mapping[str, tuple[int, ...]],
    ) -> None:
        self._programs = programs
        self._log_weights = np.log(np.array(weights, np.float32))
        self._sites = sites

    def __call__(self, *args: Any) -> None:
        key = numpyro.prng_key()  # None where all values are given
        # the components' statements are hidden: only the mixture's own count
        with handlers.block():
            drawn = {} if key is None else self._draw(key, *args)
        with handlers.substitute(data=drawn):
            values = {
                name: numpyro.sample(name, dist.ImproperUniform(constraints.real, (), shape))
                for name, shape in self._sites.items()
            }
        with handlers.block():
            parts = [log_density(program, values, *args) for program in self._programs]
        numpyro.factor("mixture", logsumexp(self._log_weights + jnp.stack(parts)))

    def _draw(self, key: jax.Array, *args: Any) -> dict[str, jax.Array]:
        key_which, *keys = random.split(key, 1 + len(self._programs))
        which = random.categorical(key_which, jnp.asarray(self._log_weights))
        draws = [draw(p, k, *args) for p, k in zip(self._programs, keys, strict=True)]
        return {
            name: jnp.stack([d[name].astype(draws[-1][name].dtype) for d in draws])[which]
            for name in self._sites
        }
