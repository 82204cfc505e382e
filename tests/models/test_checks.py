"""Priors that cannot work are refused before the first simulation, by site and expectation."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from numpyro import handlers

from phase_ppl.models import priors, sites
from phase_ppl.models.model import checked_sites
from phase_ppl.world.errors import InvalidSettingError

Statement = Callable[[str], Any]

CODES = {"goal_red": 36, "goal_green": 36, "alpha": 5}


def sampled(distribution: Any) -> Statement:
    return lambda name: numpyro.sample(name, distribution)


def usual(name: str) -> Any:
    if name in CODES:
        return numpyro.sample(name, dist.Categorical(logits=jnp.zeros(CODES[name])))
    return numpyro.sample(name, dist.Uniform(150.0, 600.0))


def prior_with(site: str, statement: Statement) -> Callable[[], None]:
    """The usual statements, with that of one site replaced; or with one more."""

    def changed() -> None:
        for name in sites.HYPOTHESIS_SITES:
            (statement if name == site else usual)(name)
        if site not in sites.HYPOTHESIS_SITES:
            statement(site)

    return changed


def within(context: Callable[[], Any]) -> Statement:
    def statement(name: str) -> None:
        with context():
            usual(name)

    return statement


def also(statement: Callable[[], Any]) -> Callable[[], None]:
    return prior_with("also", lambda name: statement())


class NoDensity(dist.Distribution):
    support = dist.constraints.positive

    def sample(self, key: Any, sample_shape: tuple[int, ...] = ()) -> Any:
        return jnp.ones(sample_shape)


class Nan(NoDensity):
    def log_prob(self, value: Any) -> Any:
        return jnp.full(jnp.shape(value), jnp.nan)


RNG, COUNT = np.random.default_rng(0), itertools.count()


def from_a_low_end(name: str) -> None:
    low = numpyro.sample("low", dist.Normal(0.0, 100.0))
    numpyro.sample(name, dist.Uniform(low, low + 10.0))


def branching() -> None:
    if numpyro.sample("mood", dist.Bernoulli(0.5)) == 1:
        numpyro.sample("more", dist.Normal())


def conditioned(name: str) -> Any:
    return handlers.condition(usual, {name: jnp.array(1)})(name)


IMPROPER = dist.ImproperUniform(dist.constraints.real, (), ())
AT: dict[str, tuple[str, Statement, str]] = {
    "missing": ("goal_green", lambda name: None, "sites.goals"),
    "masked": ("alpha", within(lambda: handlers.mask(mask=False)), "a mask"),
    "conditioned": ("goal_green", conditioned, "only samples"),
    "unbounded counts": ("strength_red", sampled(dist.Poisson(2.0)), "support"),
    "too high codes": ("goal_red", sampled(dist.DiscreteUniform(0, 36)), "support"),
    "codes that are no integers": ("alpha", sampled(sites.OneOf([0.0, 1.0])), "type float32"),
    "negative": ("strength_red", sampled(dist.Uniform(-5.0, -2.0)), "support"),
    "negative codes": ("goal_green", sampled(sites.OneOf([-150, 300])), "as -150"),
    "perhaps negative": ("strength_red", from_a_low_end, ""),
}
"""What is wrong with the statement of a site of a hypothesis, which is named."""

NOT_RUN: dict[str, tuple[Statement, str]] = {
    "improper": (sampled(IMPROPER), "NotImplementedError"),
    "an error": (lambda name: 1 / 0, "ZeroDivisionError"),
}

BESIDE: dict[str, tuple[Callable[[], Any], str]] = {
    "python branches": (branching, "cannot be compiled.*jnp.where"),
    "randomness of its own": (
        lambda: numpyro.sample("also", dist.Normal(RNG.normal(), 1.0)),
        "changes from run to run.*numpyro.sample",
    ),
    "other sites each time": (
        lambda: numpyro.sample(f"own_{next(COUNT)}", dist.Normal()),
        "'own_1' in some runs",
    ),
    "nan density": (lambda: numpyro.sample("also", Nan()), "'also'.*nan"),
    "no density": (lambda: numpyro.sample("also", NoDensity()), "'also'.*no density"),
    "slash in a name": (lambda: numpyro.sample("my/own", dist.Normal()), "'my/own'.*'/'"),
    "factor": (lambda: numpyro.factor("also", 0.5), "conditions on 'also'"),
}
"""What is wrong with what a program does beside its hypotheses."""

REFUSED = {
    **{kind: (prior_with(at, one), f"'{at}'.*{said}") for kind, (at, one, said) in AT.items()},
    **{
        kind: (prior_with("alpha", one), f"cannot be run: {said}")
        for kind, (one, said) in NOT_RUN.items()
    },
    **{kind: (also(one), said) for kind, (one, said) in BESIDE.items()},
    "argument": (lambda event: priors.uniform(), "cannot be run: TypeError"),
}


@pytest.mark.parametrize(("prior", "message"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_work_is_refused_with_site_and_expectation(prior: Any, message: str) -> None:
    with pytest.raises(InvalidSettingError, match=message):
        checked_sites(prior)


def alpha_after_beta(name: str) -> None:
    social = numpyro.sample("social", dist.Beta(2.0, 5.0))
    numpyro.sample(name, dist.Categorical(probs=jnp.stack([1 - social, *[social / 4] * 4])))


def plated_traits(name: str) -> None:
    with numpyro.plate("traits", 3):
        trait = numpyro.sample("trait", dist.Normal())
    numpyro.sample(name, dist.Categorical(logits=jnp.append(trait, jnp.zeros(2))))


def also_derived() -> None:
    prior_with("strength_green", sampled(sites.OneOf([200.0, 700.0])))()
    numpyro.deterministic("also", jnp.array(1.0))


class Unhashable:
    __hash__ = None  # type: ignore[assignment]

    def __call__(self) -> None:
        priors.uniform()


UNUSUAL: dict[str, tuple[Callable[[], Any], dict[str, tuple[int, ...]]]] = {
    "hierarchy": (prior_with("alpha", alpha_after_beta), {"social": ()}),
    "plate around own sites": (prior_with("alpha", plated_traits), {"trait": (3,)}),
    "levels and derived values": (also_derived, {}),
    "no hash": (Unhashable(), {}),
}


@pytest.mark.parametrize(("prior", "own"), UNUSUAL.values(), ids=UNUSUAL)
def test_unusual_priors_work(prior: Callable[[], Any], own: dict[str, tuple[int, ...]]) -> None:
    assert checked_sites(prior) == dict.fromkeys(sites.HYPOTHESIS_SITES, ()) | own
