"""Ready-made priors over hypotheses.

``Model(prior="sparse_social")`` takes one by name; :func:`available` lists the names. Each is a
NumPyro program, which a prior of your own can call. The density of each prior is exactly that of
its draws.

Another package registers its prior under the entry point group ``phase_ppl.priors``::

    [project.entry-points."phase_ppl.priors"]
    my_prior = "my_package.my_prior:my_prior"

where ``my_prior`` is a program decorated with :func:`register_prior`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Final, TypeVar, cast

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist

from phase_ppl.models import sites
from phase_ppl.models.density import Program
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES, IMPOSSIBLE, SELF_REFERRING, OneOf
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import (
    ALPHAS,
    RELATION_TABLE,
    RELATIONS,
    STRENGTH_LEVELS,
    effective_table,
)
from phase_ppl.world.registry import Registry

AnyProgram = TypeVar("AnyProgram", bound=Program)
SPARSE_SOCIAL: Final = 0.1  # probability of a social goal; under ``uniform`` it is 2/3

PRIORS: Final = Registry[Program]("prior", entry_points="phase_ppl.priors")


def register_prior(name: str) -> Callable[[AnyProgram], AnyProgram]:
    """Return a decorator that makes a prior known under ``name``, as in ``Model(prior=name)``.

    It decorates a NumPyro program without arguments that samples goals, alpha and strengths
    (``phase_ppl.sites.HYPOTHESIS_SITES``), or any other program that :class:`phase_ppl.Model`
    takes as its ``prior``. The program itself is not changed.

    Raises:
        InvalidSettingError: the name is taken by another prior.
    """
    return PRIORS.register(name, lambda one, _: cast("Program", one))


def _ready_made(prior: AnyProgram) -> AnyProgram:
    return register_prior(prior.__name__)(prior)


def name_of(prior: Program) -> str | None:
    """Return the name of a prior of this module; None for another.

    That of another package may not be there, or be another by then.
    """
    if getattr(prior, "__module__", "") != __name__:
        return None
    return next((name for name, known in PRIORS.entries.items() if known is prior), None)


@_ready_made
def uniform() -> None:
    """The paper's prior: uniform goals and strengths, and at most one agent helps or hinders."""
    sites.goals()
    sites.alpha()
    sites.strengths()


@_ready_made
def sparse_social() -> None:
    """Social goals are rare: one agent helps or hinders with probability 0.1.

    The four ways to do so are equally likely. Goals and strengths are as in :func:`uniform`.
    """
    sites.goals()
    one = SPARSE_SOCIAL / (len(ALPHAS) - 1)
    probs = jnp.array([1 - SPARSE_SOCIAL, *[one] * (len(ALPHAS) - 1)])
    numpyro.sample(ALPHA_SITE, dist.Categorical(probs=probs))
    sites.strengths()


@_ready_made
def no_social_goals() -> None:
    """Nobody helps or hinders: alpha is (0, 0) for certain. An ablation.

    Two agents share a goal, or have opposite ones, by chance only. Goals and strengths are as in
    :func:`uniform`.
    """
    sites.goals()
    logits = jnp.full(len(ALPHAS), IMPOSSIBLE).at[ALPHAS.index((0, 0))].set(0.0)
    numpyro.sample(ALPHA_SITE, dist.Categorical(logits=logits))
    sites.strengths()


@_ready_made
def relation_first(
    friendly: float = 1 / 3, neutral: float = 1 / 3, adversarial: float = 1 / 3
) -> None:
    """The relation is drawn first, then goals and alpha that make it.

    P(goals, alpha) = P(relation) P(goals, alpha | relation). The last factor is that of
    :func:`uniform`. The relation follows from effective goals, so it is no site: the program draws
    the goals one after the other, then alpha, from this joint distribution.

    Args:
        friendly, neutral, adversarial: probability of each relation, by default 1/3.
    """
    probabilities = dict(zip(("friendly", "neutral", "adversarial"),
                             (friendly, neutral, adversarial), strict=True))  # fmt: skip
    log_red, log_green, log_alpha = _relation_tables(tuple(probabilities[r] for r in RELATIONS))
    red = numpyro.sample(GOAL_SITES[0], dist.Categorical(logits=jnp.asarray(log_red)))
    green = numpyro.sample(GOAL_SITES[1], dist.Categorical(logits=jnp.asarray(log_green)[red]))
    numpyro.sample(ALPHA_SITE, dist.Categorical(logits=jnp.asarray(log_alpha)[red, green]))
    sites.strengths()


@functools.cache
def _relation_tables(probabilities: tuple[float, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return log P(red), log P(green | red), log P(alpha | red, green), up to constants.

    Args:
        probabilities: of the relations, in the order of ``RELATIONS``.
    """
    given = np.array(probabilities, float)
    if not ((given >= 0).all() and abs(given.sum() - 1) < 1e-6):
        raise InvalidSettingError(
            f"probabilities of {', '.join(RELATIONS)} = {list(probabilities)}: expected numbers "
            ">= 0 of sum 1"
        )
    goals = effective_table()
    relation = RELATION_TABLE[goals[..., 0], goals[..., 1]].astype(int)
    base = np.einsum(
        "r,g,a->rga", *(~SELF_REFERRING).astype(float), np.array(sites.ALPHA_PROBABILITIES)
    )
    mass = np.bincount(relation.ravel(), base.ravel(), len(RELATIONS))
    joint = base * (given / mass)[relation]
    with np.errstate(divide="ignore"):
        tables = (np.log(joint.sum(axis=(1, 2))), np.log(joint.sum(axis=2)), np.log(joint))
    red, green, alpha = (np.maximum(table, IMPOSSIBLE) for table in tables)
    return red, green, alpha


@_ready_made
def strength_levels() -> None:
    """Strengths are 150, 300, 450 or 600 N, the original world's levels, all equally likely.

    Goals and alpha are as in :func:`uniform`.
    """
    sites.goals()
    sites.alpha()
    for name in sites.STRENGTH_SITES:
        numpyro.sample(name, OneOf(STRENGTH_LEVELS))


def available() -> list[str]:
    """Return the names of all priors, ready-made and registered, sorted."""
    return PRIORS.names()


def named(name: str) -> Program:
    """Return the prior of that name, ready-made or registered."""
    return PRIORS[name]
