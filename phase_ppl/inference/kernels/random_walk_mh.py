"""Metropolis-Hastings with small steps: to a similar goal, another relation, another strength."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from numpy.typing import NDArray

from phase_ppl.inference.proposals.guide import NEVER
from phase_ppl.inference.registry import register_kernel
from phase_ppl.inference.sampling.metropolis import MHState, ProposalKernel
from phase_ppl.inference.sampling.site_moves import SiteMove, moved_site
from phase_ppl.models.program import EventProgram
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES, SELF_REFERRING, STRENGTH_SITES
from phase_ppl.world.checks import positive_number
from phase_ppl.world.goals import N_GOALS, neighbouring_goals
from phase_ppl.world.hypothesis import ALPHAS

LEAP: Final = 0.2
"""Share of goal proposals that come from the prior, so that goals which it leaves without
neighbours are reached too."""

SCALE: Final = 60.0
"""Standard deviation of a step of a strength, newtons."""


class RandomWalkMH(ProposalKernel):
    """Moves a random site by a small step; all others stay.

    * a goal: to one of those neighbours (:func:`phase_ppl.world.goals.neighbouring_goals`) that
      have prior mass; with probability :data:`LEAP`, or where there is none, to a goal from its
      prior given the sites above it;
    * alpha: to any other;
    * a strength: by a normal step, reflected at the ends of its support; one that the prior makes
      one of a few values, drawn from it given the sites above;
    * a site of a user's own: drawn from its prior given the sites above it.

    Args:
        program: the model of an event.
        scale: standard deviation of a strength's step, newtons.
        early_reject: stop a simulation once it cannot be accepted any more.

    Raises:
        InvalidSettingError: ``scale`` is no positive number.
    """

    def __init__(
        self,
        program: EventProgram | None = None,
        *,
        scale: float = SCALE,
        early_reject: bool = True,
    ) -> None:
        super().__init__(program, early_reject=early_reject)
        self._scale = positive_number("scale", scale)

    def propose(self, key: jax.Array, state: MHState) -> tuple[dict[str, jax.Array], jax.Array]:
        """Return the hypothesis with one site moved."""
        model = self.model.model
        moves: dict[str, SiteMove] = {ALPHA_SITE: _another_alpha}
        for holder, name in enumerate(GOAL_SITES):
            moves[name] = functools.partial(_nearby_goal, holder)
        for name in STRENGTH_SITES:
            moves[name] = functools.partial(_reflected_step, self._scale)
        return moved_site(model.prior, key, state.z, tuple(model.sites), moves)


def _nearby_goal(
    holder: int, key: jax.Array, site: Mapping[str, Any]
) -> tuple[jax.Array, jax.Array]:
    goals = jnp.arange(N_GOALS)
    log_prior = jnp.where(site["fn"].support(goals), site["fn"].log_prob(goals), -jnp.inf)
    prior = jnp.exp(log_prior)
    neighbours = jnp.asarray(_neighbours()[holder]) & (log_prior > NEVER)

    def log_q(goal: jax.Array) -> jax.Array:
        """Return (goal,) log probabilities of what is proposed from a goal."""
        near = neighbours[goal]
        leap = jnp.where(near.any(), LEAP, 1.0)
        return jnp.log((1 - leap) * near / jnp.maximum(near.sum(), 1) + leap * prior)

    old = site["value"]
    there = log_q(old)
    new = random.categorical(key, there)
    return new, log_q(new)[old] - there[new]


@functools.cache
def _neighbours() -> NDArray[np.bool_]:
    """Return (holder, goal, goal) which possible goals are each other's neighbours."""
    near = [np.isin(np.arange(N_GOALS), neighbouring_goals(goal)) for goal in range(N_GOALS)]
    return np.array(near)[None] & ~SELF_REFERRING[:, None, :]


def _another_alpha(key: jax.Array, site: Mapping[str, Any]) -> tuple[jax.Array, float]:
    further = random.randint(key, (), 1, len(ALPHAS))
    return (site["value"] + further) % len(ALPHAS), 0.0


def _reflected_step(
    scale: float, key: jax.Array, site: Mapping[str, Any]
) -> tuple[jax.Array, jax.Array | float]:
    law = site["fn"]
    if law.support.is_discrete:
        new = law.sample(key)
        return new, law.log_prob(site["value"]) - law.log_prob(new)
    # symmetric: the support depends on the sites above only, which stay
    support = law.support
    low, high = (getattr(support, f"{end}_bound", None) for end in ("lower", "upper"))
    new = site["value"] + scale * random.normal(key)
    if low is not None and high is not None:
        width = high - low
        beyond = jnp.abs((new - low) % (2 * width) - width)
        new = jnp.clip(high - beyond, low, high)
    elif low is not None:
        new = low + jnp.abs(new - low)
    elif high is not None:
        new = high - jnp.abs(high - new)
    return new, 0.0


@register_kernel("random_walk_mh", validity="exact")
def random_walk_mh(
    program: EventProgram, *, scale: float = SCALE, early_reject: bool = True
) -> RandomWalkMH:
    """Metropolis-Hastings with small steps: to a similar goal, another relation, a strength."""
    return RandomWalkMH(program, scale=scale, early_reject=early_reject)
