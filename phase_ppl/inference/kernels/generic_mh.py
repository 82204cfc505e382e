"""Metropolis-Hastings that proposes from the prior, by small steps, or by a mixture of moves."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from numpy.typing import NDArray

from phase_ppl.inference.guide import NEVER, Guide
from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.metropolis import (
    MHState,
    Move,
    ProposalKernel,
    Proposed,
    SiteMove,
    chosen,
    log_ratio_known,
)
from phase_ppl.inference.registry import register_kernel
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.models.bridge import Request
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError, number_or_nan, positive_number, shown
from phase_ppl.world.goals import neighbouring_goals
from phase_ppl.world.space import HypothesisSpace


@register_kernel("prior_mh", validity="exact", any_length=True)
class PriorMH(ProposalKernel):
    """Metropolis-Hastings with proposals from the prior.

    An independence sampler: prior and proposal cancel, so the acceptance ratio is the ratio of
    likelihoods.
    """

    proposes_from_prior = True

    def proposed(self, key: jax.Array, state: MHState) -> tuple[dict[str, jax.Array], jax.Array]:
        sites = self.program.draw_prior(key)
        return sites, state.log_prior - self.program.log_prior(sites)


@register_kernel("single_site_mh", validity="exact", any_length=True)
class SingleSiteMH(ProposalKernel):
    """Metropolis-Hastings that proposes one site at a time from the prior.

    A random site is drawn from its prior given the sites above it; all others stay. A user's own
    sites move like any other, in any hierarchy.
    """

    def proposed(self, key: jax.Array, state: MHState) -> tuple[dict[str, jax.Array], jax.Array]:
        return self.one_site_moved(key, state.z)


LEAP: Final = 0.2
"""Share of goal proposals that come from the prior. They reach goals that have no neighbour with
prior mass."""

SCALE: Final = 60.0  # standard deviation of a step of a strength, newtons


@register_kernel("random_walk_mh", validity="exact", any_length=True)
class RandomWalkMH(ProposalKernel):
    """Metropolis-Hastings with small steps: to a similar goal, another relation, a strength.

    A random site moves, all others stay.

    * A goal moves to a neighbour (:func:`phase_ppl.world.goals.neighbouring_goals`) with prior
      mass. With probability :data:`LEAP`, or without neighbours, it is drawn from its prior given
      the sites above it.
    * Who helps or hinders whom moves to any other way.
    * A strength makes a normal step, reflected at the ends of its support. A discrete one is drawn
      from its prior given the sites above it.
    * A user's own site is drawn from its prior given the sites above it.

    Args:
        program, early_reject: as of every Metropolis-Hastings kernel.
        scale: standard deviation of a strength's step, newtons.

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

    def proposed(self, key: jax.Array, state: MHState) -> tuple[dict[str, jax.Array], jax.Array]:
        space = self.program.space
        moves: dict[str, SiteMove] = {}
        if len(space.ways) > 1:
            moves[space.company_site] = functools.partial(_another_way, len(space.ways))
        for holder, name in enumerate(space.goal_sites):
            moves[name] = functools.partial(_nearby_goal, _neighbours(space)[holder])
        for name in space.strength_sites:
            moves[name] = functools.partial(_reflected_step, self._scale)
        return self.one_site_moved(key, state.z, moves)


def _nearby_goal(
    near: NDArray[np.bool_], key: jax.Array, site: Mapping[str, Any]
) -> tuple[jax.Array, jax.Array]:
    goals = jnp.arange(len(near))
    log_prior = jnp.where(site["fn"].support(goals), site["fn"].log_prob(goals), -jnp.inf)
    prior = jnp.exp(log_prior)
    neighbours = jnp.asarray(near) & (log_prior > NEVER)

    def log_q(goal: jax.Array) -> jax.Array:
        """Return (goal,) log probabilities of the goals proposed from a goal."""
        row = neighbours[goal]
        leap = jnp.where(row.any(), LEAP, 1.0)
        return jnp.log((1 - leap) * row / jnp.maximum(row.sum(), 1) + leap * prior)

    old = site["value"]
    there = log_q(old)
    new = random.categorical(key, there)
    return new, log_q(new)[old] - there[new]


@functools.lru_cache(16)
def _neighbours(space: HypothesisSpace) -> NDArray[np.bool_]:
    """Return (holder, goal, goal): True where two possible goals are neighbours."""
    goals = np.arange(space.n_goals)
    near = [np.isin(goals, neighbouring_goals(goal, space.world)) for goal in goals.tolist()]
    return np.array(near)[None] & ~space.impossible[:, None, :]


def _another_way(n_ways: int, key: jax.Array, site: Mapping[str, Any]) -> tuple[jax.Array, float]:
    further = random.randint(key, (), 1, n_ways)
    return (site["value"] + further) % n_ways, 0.0


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


LOCAL_SHARE: Final = 0.5


@register_kernel("mixture", validity="exact", needs=("guide", "settings"), any_length=True)
class MixtureMH(LocalMH):
    """Metropolis-Hastings that mixes SIMPLE's local moves with moves of single sites.

    It makes a local move (:class:`LocalMH`, exact rule), or draws one site from its prior. Local
    moves go where the observation points; single sites explore there. The kind of move is drawn
    independently of the state. So each kind has its own acceptance ratio, and the mixture is exact
    if both kinds are.

    Args:
        program, guide, settings, early_reject: as of :class:`LocalMH`.
        local_share: probability of a local move.

    Raises:
        InvalidSettingError: ``local_share`` is no number in [0, 1].
    """

    def __init__(
        self,
        program: EventProgram | None = None,
        guide: Guide | None = None,
        settings: SimpleSettings | None = None,
        *,
        local_share: float = LOCAL_SHARE,
        early_reject: bool = True,
    ) -> None:
        super().__init__(program, guide, settings, early_reject=early_reject)
        if not 0 <= number_or_nan(local_share) <= 1:
            raise InvalidSettingError(
                f"local_share={shown(local_share)}, expected a number in [0, 1]"
            )
        self._local_share = float(local_share)

    def propose(self, state: MHState) -> tuple[Proposed, Request]:
        """Propose one of the two moves."""
        key, key_kind, *keys, key_seed, key_accept = random.split(state.rng_key, 7)
        key_window, key_local, key_site = keys
        local = random.bernoulli(key_kind, self._local_share)
        # both are proposed, which costs nothing, but only one is simulated
        window, sites = self.propose_locally(key_window, key_local, state)
        one_moved, log_hastings = self.one_site_moved(key_site, state.z)
        sites = chosen(local, sites, one_moved)
        move = self.local_move(window, sites, state)
        of_single = log_ratio_known(move.log_prior, log_hastings, state)
        move = move._replace(
            log_known=jnp.where(local, move.log_known, of_single),
            log_bound=jnp.where(local, move.log_bound, 0.0),
            window=jnp.where(local, window, -1),
            log_proposal=jnp.where(local, move.log_proposal, jnp.nan),
        )
        return self.asked(move, state, key, key_seed, key_accept)

    def log_after(self, move: Move, state: MHState, step_error: jax.Array) -> jax.Array | float:
        """Return the term of a local move; reversing a single site needs no simulation."""
        return jnp.where(move.window < 0, 0.0, super().log_after(move, state, step_error))
