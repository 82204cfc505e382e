"""The ready-made priors: proper densities, draws that follow them, the effective prior."""

from __future__ import annotations

import functools
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import random

from phase_ppl.models import priors, sites
from phase_ppl.models.density import compiled_quickly, draw, log_density
from phase_ppl.models.effective import log_prior_of_effective
from phase_ppl.models.model import Model
from phase_ppl.models.sites import OneOf
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.goals import N_GOALS, effective_goals
from phase_ppl.world.hypothesis import (
    ALPHAS,
    RELATION_TABLE,
    RELATIONS,
    STRENGTH_LEVELS,
    STRENGTH_RANGE,
)

CODES = np.array(list(itertools.product(range(N_GOALS), range(N_GOALS), range(len(ALPHAS)))))
EFFECTIVE = np.array([effective_goals(r, g, ALPHAS[a]) for r, g, a in CODES])
RELATION = RELATION_TABLE[EFFECTIVE[:, 0], EFFECTIVE[:, 1]].astype(int)
LEVELS = np.array(list(itertools.product(STRENGTH_LEVELS, repeat=2)))


@functools.cache
def compiled_density(name: str) -> Any:
    return compiled_quickly(jax.vmap(lambda z: log_density(priors.named(name), z)))


def density(name: str, codes: Any, strengths: Any) -> np.ndarray:
    """Return the density at (n, 3) codes and (n, 2) strengths; either may be a single row."""
    codes, strengths = np.atleast_2d(codes), np.atleast_2d(strengths)
    n = max(len(codes), len(strengths))
    # as many rows in all calls, so that a prior is compiled once
    codes, strengths = (
        np.resize(np.broadcast_to(given, (n, width)), (len(CODES), width))
        for given, width in ((codes, 3), (strengths, 2))
    )
    z = {site: jnp.asarray(codes[:, i]) for i, site in enumerate((*sites.GOAL_SITES, "alpha"))}
    z |= {site: jnp.asarray(strengths[:, i], jnp.float32)
          for i, site in enumerate(sites.STRENGTH_SITES)}  # fmt: skip
    return np.exp(np.asarray(compiled_density(name)(z), float))[:n]


@functools.cache
def draws(name: str) -> dict[str, np.ndarray]:
    return drawn(priors.named(name), 20_000)


def drawn(prior: Any, n: int) -> dict[str, np.ndarray]:
    many = compiled_quickly(jax.vmap(lambda key: draw(prior, key)))
    return {site: np.asarray(v) for site, v in many(random.split(random.key(0), n)).items()}


REFERENCE = CODES[np.flatnonzero((CODES == (0, 5, 0)).all(axis=1))[0]]
STRENGTHS = (300.0, 450.0)


def strength_mass(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 2) that cover the strengths, and the mass at them given REFERENCE."""
    if name == "strength_levels":
        return LEVELS, density(name, REFERENCE, LEVELS)
    low, high = STRENGTH_RANGE
    n = 80
    middle = low + (np.arange(n) + 0.5) * (high - low) / n
    grid = np.array(list(itertools.product(middle, repeat=2)))
    return grid, density(name, REFERENCE, grid) * ((high - low) / n) ** 2


@pytest.mark.parametrize("name", priors.available())
def test_a_ready_made_prior_is_proper_and_its_draws_follow_it(name: str) -> None:
    """And it passes the checks of a user's own."""
    prior = priors.named(name)
    assert Model(prior=lambda: prior()).sites == Model(prior=prior).sites
    mass, reference = density(name, CODES, STRENGTHS), density(name, REFERENCE, STRENGTHS)
    # goals and alpha are independent of the strengths in all of them, so the sum factorises
    at = np.random.default_rng(0).choice(len(CODES), 50)
    ratio = reference / density(name, REFERENCE, (600.0, 600.0))
    elsewhere = density(name, CODES[at], (600.0, 600.0))
    np.testing.assert_allclose(mass[at], elsewhere * ratio, rtol=1e-3)
    points, weights = strength_mass(name)
    assert mass.sum() / reference[0] * weights.sum() == pytest.approx(1, abs=0.01)

    z = draws(name)
    codes = [z[site] for site in (*sites.GOAL_SITES, "alpha")]
    n, index = len(z["alpha"]), np.ravel_multi_index(codes, (N_GOALS, N_GOALS, len(ALPHAS)))
    mass /= mass.sum()
    for group, kinds in ((CODES[:, 2], 5), (RELATION, 3), (CODES[:, 0], 36), (CODES[:, 1], 36)):
        expected = np.bincount(group, mass, kinds)
        found = np.bincount(group[index], minlength=kinds) / n
        np.testing.assert_allclose(found, expected, atol=5 * np.sqrt(0.25 / n))
    assert (mass[index] > 0).all()
    for holder, site in enumerate(sites.GOAL_SITES):
        assert not sites.SELF_REFERRING[holder][z[site]].any()
    bins = [[0, 250, 350, 500, 1000]] * 2
    expected = np.histogram2d(*points.T, bins=bins, weights=weights / weights.sum())[0]
    found = np.histogram2d(z["strength_red"], z["strength_green"], bins=bins)[0] / n
    np.testing.assert_allclose(found, expected, atol=5 * np.sqrt(0.25 / n))


@pytest.mark.parametrize("name", ["uniform", "relation_first"])
def test_prior_of_effective_goals_is_the_sum_over_what_leads_to_them(name: str) -> None:
    expected = np.zeros((N_GOALS, N_GOALS))
    np.add.at(expected, tuple(EFFECTIVE.T), density(name, CODES, STRENGTHS))
    pairs = np.array(list(itertools.product(range(N_GOALS), repeat=2)))
    strengths = {site: np.full(len(pairs), s)
                 for site, s in zip(sites.STRENGTH_SITES, STRENGTHS, strict=True)}  # fmt: skip
    found = np.exp(log_prior_of_effective(priors.named(name), pairs, strengths))
    np.testing.assert_allclose(found, expected.ravel(), rtol=1e-3, atol=1e-12)


def test_relation_first_is_the_papers_prior_given_relations_of_a_third_each() -> None:
    both = [density(name, CODES, STRENGTHS) for name in ("relation_first", "uniform")]
    total = np.bincount(RELATION, both[0], len(RELATIONS)) / both[0].sum()
    assert total.tolist() == pytest.approx([1 / 3] * 3, rel=1e-4)
    for relation in range(len(RELATIONS)):
        one, other = (mass[relation == RELATION] for mass in both)
        np.testing.assert_allclose(one / one.sum(), other / other.sum(), rtol=1e-3, atol=1e-12)


def test_a_prior_of_ones_own_is_registered_and_checked_as_any(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(priors.PRIORS, "entries", dict(priors.PRIORS.entries))

    @priors.register_prior("without_strengths")
    def lacking() -> None:
        sites.goals()
        sites.alpha()

    assert Model(prior="sparse_social").prior is priors.sparse_social
    assert "without_strengths" in priors.available()
    with pytest.raises(InvalidSettingError, match="does not sample 'strength_red'"):
        Model(prior="without_strengths")
    with pytest.raises(InvalidSettingError, match="a prior named 'uniform' exists"):
        priors.register_prior("uniform")(lacking)


# --- one of finitely many numbers -----------------------------------------------------------------


VALUES, PROBS = [150.0, 300.0, 620.5], [0.2, 0.5, 0.3]


def test_draws_are_the_values_in_their_proportions_and_nothing_else_has_mass() -> None:
    one = OneOf(VALUES, PROBS)
    drawn = np.asarray(one.sample(random.key(0), (20_000,)))
    assert [(drawn == value).mean() for value in VALUES] == pytest.approx(PROBS, abs=0.02)
    assert np.isin(drawn, VALUES).all()
    found = np.exp(one.log_prob(jnp.array([*VALUES, 151.0, -1.0])))
    np.testing.assert_allclose(found, [*PROBS, 0, 0], rtol=1e-5)
    support = OneOf(VALUES, [0.5, 0.5, 0.0]).support
    np.testing.assert_array_equal(support(jnp.array([150.0, 620.5, 7.0])), [True, False, False])
    assert support.is_discrete


def test_values_may_depend_on_other_sites_inside_compiled_code() -> None:
    def density(mood: jax.Array, value: jax.Array) -> jax.Array:
        return OneOf(jnp.where(mood, jnp.array([1.0, 2.0]), jnp.array([3.0, 4.0]))).log_prob(value)

    found = jax.jit(jax.vmap(density))(jnp.array([True, False]), jnp.array([2.0, 2.0]))
    np.testing.assert_allclose(np.exp(found), [0.5, 0.0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"values": []}, "shape"),
        ({"values": 3.0}, "shape"),
        ({"values": [1.0, 2.0], "probs": [1.0]}, "probabilities of shape"),
        ({"values": VALUES, "probs": PROBS, "logits": PROBS}, "not both"),
    ],
)
def test_what_is_no_list_of_values_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        OneOf(**arguments)
