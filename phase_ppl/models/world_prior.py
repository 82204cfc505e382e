"""A prior in any world, and what it says of what is simulated: effective goals and strengths.

A prior of another world than PHASE is a :class:`WorldPrior`. In PHASE sites may depend on each
other, and sums are over tables of all stated hypotheses (:mod:`phase_ppl.models.effective`).
Elsewhere they are independent of each other, so that a mass is a sum over ways to help or hinder of
products, and tables of all goals are not needed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from phase_ppl.models import effective, roles
from phase_ppl.models.density import Program, remembered
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import HypothesisSpace, space_of

_PRIORS_KEPT: Final = 8


@dataclasses.dataclass(frozen=True)
class WorldPrior:
    """A NumPyro program of a world (:mod:`phase_ppl.models.roles`), bound to one."""

    given: Callable[..., Any]  # by the user: a program of a world, or a ready-made prior of PHASE
    program: Callable[[World], Any]  # that it stands for
    world: World

    def __call__(self) -> None:
        self.program(self.world)


def as_given(prior: Callable[..., Any]) -> Callable[..., Any]:
    """Return a prior as the user gave it, without its world."""
    return prior.given if isinstance(prior, WorldPrior) else prior


def space_of_prior(prior: object) -> HypothesisSpace:
    """Return the hypotheses that a prior is over: those of PHASE, unless it is bound to a world."""
    return space_of(prior.world if isinstance(prior, WorldPrior) else PHASE)


@remembered(_PRIORS_KEPT)
def masses(prior: WorldPrior) -> roles.Masses:
    """Return the masses of own goals and ways of a prior that is bound to a world."""
    with jax.ensure_compile_time_eval():  # kernels are made inside compiled code
        return roles.masses(prior.given, prior.world)


def log_prior_of_effective(
    prior: Program, goals: NDArray[np.int64], strengths: Mapping[str, NDArray[np.float64]]
) -> FloatArray:
    """Return (row,) the log prior of effective goals (row, agent) with strengths [N], each (row,).

    Stated goals and ways to help or hinder are summed over.
    """
    if not isinstance(prior, WorldPrior):
        return effective.log_prior_of_effective(prior, goals, strengths)
    found = masses(prior)
    space = space_of_prior(prior)
    by_way = space.log_prior_of_effective(found.goals, found.company, goals)
    log_prior = np.logaddexp.reduce(by_way, axis=0)
    for name in space.strength_sites:
        law, newtons = found.trace[name]["fn"], jnp.asarray(strengths[name], jnp.float32)
        density = np.asarray(law.log_prob(newtons), np.float64)
        log_prior += np.where(np.asarray(law.support(newtons)), density, -np.inf)
    return np.asarray(log_prior)


def kept_prior(prior: Program) -> dict[str, tuple[tuple[str, ...], FloatArray]]:
    """Return what a file keeps of a prior over goals: name -> dimensions and values.

    In PHASE ``prior_of_pairs``; elsewhere ``log_prior_goals`` and ``log_prior_company``.
    """
    if not isinstance(prior, WorldPrior):
        return {"prior_of_pairs": (("pair_red", "pair_green"), effective.prior_of_pairs(prior))}
    found = masses(prior)
    return {
        "log_prior_goals": (("agent", "goal"), found.goals),
        "log_prior_company": (("way",), found.company),
    }


def drawn_stated(
    prior: Program, goals: NDArray[np.int64], strengths: NDArray[np.floating[Any]]
) -> NDArray[np.int64]:
    """Return (row, agent + 1) stated goals and way for effective goals (row, agent).

    Drawn by the prior given these and strengths (row, agent), newtons.
    """
    if not isinstance(prior, WorldPrior):
        return effective.drawn_stated(prior, goals, strengths)
    found, space, rng = masses(prior), space_of_prior(prior), np.random.default_rng(0)
    by_way = space.log_prior_of_effective(found.goals, found.company, goals)
    # the largest of Gumbel-perturbed log weights is a draw in proportion to the weights
    way = (by_way + rng.gumbel(size=by_way.shape)).argmax(axis=0)
    stated = np.array(goals, np.int64)
    for agent in range(space.n_agents):
        # the own goal of one that helps or hinders is not used
        unused = rng.choice(space.n_goals, len(goals), p=softmax(found.goals[agent]))
        idle = space.owner[way, agent] != agent
        stated[idle, agent] = unused[idle]
    return np.column_stack([stated, way])
