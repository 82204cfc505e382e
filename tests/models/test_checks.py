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


ANY_SITE: dict[str, tuple[Statement, str]] = {
    "missing": (lambda name: None, "does not sample"),
    "deterministic": (lambda name: numpyro.deterministic(name, jnp.array(1)), "does not sample"),
    "a parameter": (lambda name: numpyro.param(name, jnp.array(1.0)), "does not sample"),
    "hidden": (within(handlers.block), "does not sample"),
    "in a plate of one": (within(lambda: numpyro.plate("agents", 1)), "plate 'agents'"),
    "masked": (within(lambda: handlers.mask(mask=False)), "mask"),
    "scaled": (within(lambda: handlers.scale(scale=0.5)), "scale"),
    "conditioned": (
        lambda name: handlers.condition(usual, {name: jnp.array(1)})(name),
        "conditions on",
    ),
    "a vector": (sampled(dist.Uniform(1.0, 2.0).expand([3])), r"shape \(3,\)"),
    "any real number": (sampled(dist.Normal(300.0, 1.0)), "support"),
    "fixed": (sampled(dist.Delta(3.0)), "support"),
    "unbounded counts": (sampled(dist.Poisson(2.0)), "support"),
    "negative": (sampled(dist.Uniform(-5.0, -2.0)), "support"),
    "negative values": (sampled(sites.OneOf([-150, 300])), "support|as -150"),
    "infinite values": (
        lambda name: numpyro.sample(name, sites.OneOf([150.0, np.inf])),
        "cannot be run: ValueError: OneOf",
    ),
    "improper": (
        sampled(dist.ImproperUniform(dist.constraints.real, (), ())),
        "cannot be run: NotImplementedError",
    ),
    "nothing at all": (lambda name: 1 / 0, "cannot be run: ZeroDivisionError"),
}
SITES = ("goal_green", "alpha", "strength_red")
OF_EACH = ("missing", "any real number", "negative values")
"""Kinds of which another thing is said at each site."""
CASES = sorted({*itertools.product(SITES, OF_EACH), *zip(itertools.cycle(SITES), ANY_SITE)})


@pytest.mark.parametrize(("site", "kind"), CASES, ids=[f"{s}-{k}" for s, k in CASES])
def test_nasty_statement_of_any_hypothesis_site_is_refused_by_name(site: str, kind: str) -> None:
    statement, message = ANY_SITE[kind]
    with pytest.raises(InvalidSettingError, match=message) as caught:
        checked_sites(prior_with(site, statement))
    if not message.startswith("cannot be run"):
        assert repr(site) in str(caught.value)
    if message in ("does not sample", "support"):
        statement_of = "alpha" if site == "alpha" else site.split("_")[0] + "s"
        assert f"sites.{statement_of}" in str(caught.value)


def from_a_low_end(name: str) -> None:
    low = numpyro.sample("low", dist.Normal(0.0, 100.0))
    numpyro.sample(name, dist.Uniform(low, low + 10.0))


def branching() -> None:
    if numpyro.sample("mood", dist.Bernoulli(0.5)) == 1:
        numpyro.sample("more", dist.Normal())


RNG, COUNT = np.random.default_rng(0), itertools.count()
WHOLE: dict[str, tuple[Callable[[], Any], str]] = {
    "python branches": (also(branching), "cannot be compiled.*jnp.where"),
    "randomness of its own": (
        also(lambda: numpyro.sample("also", dist.Normal(RNG.normal(), 1.0))),
        "changes from run to run.*numpyro.sample",
    ),
    "other sites each time": (
        also(lambda: numpyro.sample(f"own_{next(COUNT)}", dist.Normal())),
        "'own_1' in some runs",
    ),
    "strength that may be negative": (
        prior_with("strength_red", from_a_low_end),
        "strength_red",
    ),
    "nan density": (also(lambda: numpyro.sample("also", Nan())), "'also'.*nan"),
    "no density": (also(lambda: numpyro.sample("also", NoDensity())), "'also'.*no density"),
    "nan parameter": (
        also(lambda: numpyro.sample("also", dist.Normal(jnp.nan, 1.0))),
        "cannot be run: ValueError: Normal",
    ),
    "slash in a name": (also(lambda: numpyro.sample("my/own", dist.Normal())), "'my/own'.*'/'"),
    "codes that are no integers": (
        prior_with("alpha", sampled(sites.OneOf([0.0, 1.0]))),
        "'alpha' of type float32",
    ),
    "no name": (also(lambda: numpyro.sample("", dist.Normal())), "expected a name"),
    "reserved": (also(lambda: numpyro.sample("weight", dist.Normal())), "'weight', a reserved"),
    "twice": (also(lambda: sites.alpha()), "cannot be run.*alpha"),
    "factor": (also(lambda: numpyro.factor("also", 0.5)), "conditions on 'also'"),
    "argument": (lambda event: priors.uniform(), "cannot be run: TypeError"),
}


@pytest.mark.parametrize(("prior", "message"), WHOLE.values(), ids=WHOLE)
def test_nasty_program_is_refused(prior: Callable[[], Any], message: str) -> None:
    with pytest.raises(InvalidSettingError, match=message):
        checked_sites(prior)


@pytest.mark.parametrize("site", CODES)
def test_codes_are_accepted_just_if_all_of_them_mean_something(site: str) -> None:
    last = CODES[site] - 1
    assert checked_sites(prior_with(site, sampled(dist.DiscreteUniform(0, last))))[site] == ()
    for low, high in ((-1, last), (0, last + 1)):
        with pytest.raises(InvalidSettingError, match=f"'{site}' with support"):
            checked_sites(prior_with(site, sampled(dist.DiscreteUniform(low, high))))


# --- what may be unusual and works -------------------------------------------------------------


def alpha_after_beta(name: str) -> None:
    social = numpyro.sample("social", dist.Beta(2.0, 5.0))
    numpyro.sample(name, dist.Categorical(probs=jnp.stack([1 - social, *[social / 4] * 4])))


def plated_traits(name: str) -> None:
    with numpyro.plate("traits", 3):
        trait = numpyro.sample("trait", dist.Normal())
    numpyro.sample(name, dist.Categorical(logits=jnp.append(trait, jnp.zeros(2))))


UNUSUAL: dict[str, tuple[Callable[[], Any], dict[str, tuple[int, ...]]]] = {
    "hierarchy": (prior_with("alpha", alpha_after_beta), {"social": ()}),
    "plate around own sites": (prior_with("alpha", plated_traits), {"trait": (3,)}),
    "few goals": (prior_with("goal_red", sampled(dist.DiscreteUniform(2, 4))), {}),
    "heavy tail": (prior_with("strength_red", sampled(dist.LogNormal(6.0, 0.5))), {}),
    "levels": (prior_with("strength_green", sampled(sites.OneOf([200.0, 700.0]))), {}),
    "whole newtons": (prior_with("strength_green", sampled(dist.DiscreteUniform(150, 600))), {}),
    "derived values": (also(lambda: numpyro.deterministic("also", jnp.array(1.0))), {}),
}


@pytest.mark.parametrize(("prior", "own"), UNUSUAL.values(), ids=UNUSUAL)
def test_unusual_prior_is_accepted(
    prior: Callable[[], Any], own: dict[str, tuple[int, ...]]
) -> None:
    assert checked_sites(prior) == dict.fromkeys(sites.HYPOTHESIS_SITES, ()) | own


def test_prior_that_cannot_be_hashed_is_checked_too() -> None:
    class Unhashable:
        __hash__ = None  # type: ignore[assignment]

        def __call__(self) -> None:
            priors.uniform()

    assert set(checked_sites(Unhashable())) == set(sites.HYPOTHESIS_SITES)
