"""The sites of a hypothesis, and functions that sample them inside a prior of your own.

A prior of PHASE is a NumPyro program that samples the five sites ``goal_red``, ``goal_green``,
``alpha``, ``strength_red`` and ``strength_green``. It may sample further sites::

    def helpers_common():
        numpyro.sample("alpha", dist.Categorical(probs=jnp.array([.2, .3, .3, .1, .1])))
        phase_ppl.sites.goals()
        phase_ppl.sites.strengths()

A strength is a real number, newtons, or one of a few numbers (:class:`OneOf`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import random
from jax.scipy.special import logsumexp
from numpyro.distributions import constraints

from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import ALPHA_SITE, space_of

__all__ = [
    "ALPHA_PROBABILITIES",
    "ALPHA_SITE",
    "GOAL_SITES",
    "HYPOTHESIS_SITES",
    "STRENGTH_SITES",
    "OneOf",
    "alpha",
    "goals",
    "strengths",
]


IMPOSSIBLE: Final = -1e30
"""Logit of what has no mass; finite, so that NumPyro's argument checks let it pass."""

_MASSLESS = -1e15  # values with logits below this are outside the support


_SPACE: Final = space_of(PHASE)
GOAL_SITES: Final = _SPACE.goal_sites  # stated goals: indices into ``GOALS``
STRENGTH_SITES: Final = _SPACE.strength_sites  # maximum forces, newtons
HYPOTHESIS_SITES: Final = _SPACE.sites

ALPHA_PROBABILITIES: Final = (1 / 3, 1 / 6, 1 / 6, 1 / 6, 1 / 6)
"""Probability of each of ``ALPHAS`` under the paper's prior (Appendix 4B).

A number u is drawn from {-1, 0, 1}. If it is not 0, one of the agents, drawn at random, has it."""

SELF_REFERRING: Final = _SPACE.impossible
"""(holder, goal): goals that name their own holder and have no prior mass."""


def goals(world: World = PHASE) -> tuple[jax.Array, ...]:
    """Sample the site ``goal_<agent>`` of each agent; return the goals, indices (agent,).

    The goals that an agent can have, 34 in PHASE, are equally likely.
    """
    space = space_of(world)
    logits = np.where(space.impossible, IMPOSSIBLE, 0.0)
    return tuple(
        numpyro.sample(name, dist.Categorical(logits=jnp.asarray(row)))
        for name, row in zip(space.goal_sites, logits, strict=True)
    )


def alpha() -> jax.Array:
    """Sample the site ``alpha``; return an index into ``ALPHAS``.

    (0, 0) has probability 1/3, each other alpha 1/6.
    """
    return numpyro.sample(ALPHA_SITE, dist.Categorical(probs=jnp.array(ALPHA_PROBABILITIES)))


def strengths(world: World = PHASE) -> tuple[jax.Array, ...]:
    """Sample the site ``strength_<agent>`` of each agent; return the strengths (agent,).

    They are independent and uniform on [150, 600] newtons.
    """
    names = space_of(world).strength_sites
    return tuple(numpyro.sample(name, dist.Uniform(*STRENGTH_RANGE)) for name in names)


class OneOf(dist.Distribution):
    """NumPyro distribution over finitely many numbers.

    If a prior samples a strength from it, bottom-up proposals of that strength are among these
    numbers too, so that Hastings' correction compares like with like::

        numpyro.sample("strength_red", ppl.sites.OneOf([150.0, 450.0], probs=[0.2, 0.8]))

    Args:
        values: (value,) the numbers; they may depend on other sites.
        probs: (value,) probability of each number, normalised here. Default: all equal.
        logits: (value,) unnormalised log probability of each number, in place of ``probs``.
        validate_args: whether NumPyro checks arguments; None: NumPyro's default.

    Raises:
        ValueError: there are no values, another number of probabilities than of values, or both
            ``probs`` and ``logits``.
    """

    arg_constraints = {  # noqa: RUF012  (NumPyro's way to declare them)
        "values": constraints.real_vector,
        "logits": constraints.real_vector,
    }
    pytree_data_fields = ("values", "logits")
    has_enumerate_support = True

    def __init__(
        self,
        values: jax.Array | Sequence[float],
        probs: jax.Array | Sequence[float] | None = None,
        *,
        logits: jax.Array | Sequence[float] | None = None,
        validate_args: bool | None = None,
    ) -> None:
        self.values = jnp.asarray(values)
        if self.values.ndim != 1 or len(self.values) == 0:
            raise ValueError(f"OneOf needs a list of values, not one of shape {self.values.shape}")
        if probs is not None and logits is not None:
            raise ValueError("OneOf takes probs or logits, not both")
        if probs is not None:
            logits = jnp.log(jnp.asarray(probs, jnp.float32))
            logits = jnp.where(jnp.isneginf(logits), IMPOSSIBLE, logits)
        elif logits is None:
            logits = jnp.zeros(len(self.values))
        self.logits = jnp.asarray(logits, jnp.float32)
        if self.logits.shape != self.values.shape:
            raise ValueError(
                f"OneOf has {len(self.values)} values but probabilities of shape "
                f"{self.logits.shape}"
            )
        super().__init__((), (), validate_args=validate_args)

    @constraints.dependent_property(is_discrete=True, event_dim=0)
    def support(self) -> constraints.Constraint:
        """The numbers that have probability above 0."""
        return _OneOf(self.values, self.logits > _MASSLESS)

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        return self.values[random.categorical(key, self.logits, shape=sample_shape)]

    def log_prob(self, value: Any) -> jax.Array:
        """Return the log probability of each of ``value``; -inf if it is none of the numbers."""
        same = jnp.asarray(value)[..., None] == self.values
        return logsumexp(jnp.where(same, jax.nn.log_softmax(self.logits), -jnp.inf), axis=-1)

    def enumerate_support(self, expand: bool = True) -> jax.Array:
        return self.values


class _OneOf(constraints.Constraint[Any]):
    """Holds for the numbers of a list that are possible."""

    is_discrete = True

    def __init__(self, values: jax.Array, possible: jax.Array) -> None:
        self.values, self.possible = values, possible

    def __call__(self, x: Any) -> jax.Array:
        return ((jnp.asarray(x)[..., None] == self.values) & self.possible).any(axis=-1)

    def __repr__(self) -> str:
        return f"one of {self.values}"

    def feasible_like(self, prototype: Any) -> jax.Array:
        return jnp.full_like(prototype, self.values[jnp.argmax(self.possible)])

    def tree_flatten(self) -> Any:
        return (self.values, self.possible), (("values", "possible"), {})


def __dir__() -> list[str]:
    return __all__
