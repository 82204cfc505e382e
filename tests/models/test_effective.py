"""The prior of effective hypotheses sums out what changes nothing."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

from phase_ppl.models import priors, sites
from phase_ppl.models.effective import (
    drawn_stated,
    log_prior_of_effective,
    prior_table,
    stated_hypotheses,
)
from phase_ppl.world.goals import goal_index

LEVELS = (150.0, 300.0, 450.0, 600.0)
ENDS = np.array([150.0, 225.0, 375.0, 525.0, 600.0])
PER_NEWTON = 2 * np.log(450.0)
BLUE_TO_RED = goal_index("Get blue item to red lm")
PINK_TO_RED = goal_index("Get pink item to red lm")


def log_prior(pairs: list[tuple[int, int]], prior: object = priors.uniform) -> np.ndarray:
    strengths = {name: np.full(len(pairs), 300.0) for name in ("strength_red", "strength_green")}
    return log_prior_of_effective(prior, np.array(pairs), strengths)  # type: ignore[arg-type]


def test_stated_goals_are_drawn_by_the_prior_given_effective_ones() -> None:
    pair, n = (BLUE_TO_RED, BLUE_TO_RED), 3000
    goals, forces = np.tile(pair, (n, 1)), np.full((n, 2), 300.0)
    drawn, log_drawn = drawn_stated(priors.sparse_social, goals, forces)
    table = np.exp(prior_table(priors.sparse_social, (300.0,)))[..., 0, 0]
    options = stated_hypotheses()[pair]
    expected = table[tuple(options.T)] / table[tuple(options.T)].sum()
    place = (drawn[:, None] == options).all(axis=2).argmax(axis=1)
    np.testing.assert_allclose(log_drawn, np.log(expected[place]), atol=1e-4)
    by_alpha = np.bincount(options[:, 2], expected, minlength=5)
    np.testing.assert_allclose(np.bincount(drawn[:, 2], minlength=5) / n, by_alpha, atol=0.04)
    again, other = (drawn_stated(priors.sparse_social, goals, forces, seed)[0] for seed in (0, 1))
    np.testing.assert_array_equal(again, drawn)
    assert (other != drawn).any()


def test_a_site_of_ones_own_with_few_values_is_summed_out() -> None:
    share = 0.001

    def friendly_or_not() -> None:
        friendly = numpyro.sample("friendly", dist.Bernoulli(share))
        helping = jnp.array([0.0, 0.5, 0.5, 0.0, 0.0])
        alone = jnp.array([1.0, 0.0, 0.0, 0.0, 0.0])
        numpyro.sample("alpha", dist.Categorical(probs=jnp.where(friendly, helping, alone)))
        sites.goals()
        sites.strengths()

    shared, unrelated = np.exp(
        log_prior([(BLUE_TO_RED, BLUE_TO_RED), (BLUE_TO_RED, PINK_TO_RED)], friendly_or_not)
        + PER_NEWTON
    )
    assert unrelated == pytest.approx((1 - share) / 34**2, rel=1e-4)
    assert shared == pytest.approx(share / 34 + (1 - share) / 34**2, rel=1e-4)
    masses = np.exp(prior_table(friendly_or_not, LEVELS))
    expected = [1 - share, share / 2, share / 2, 0, 0]
    np.testing.assert_allclose(masses.sum(axis=(0, 1, 3, 4)), expected, rtol=1e-4)


def test_sites_of_ones_own_are_averaged_out_where_they_have_many_values() -> None:
    def moody() -> None:
        tries = numpyro.sample("tries", dist.DiscreteUniform(1, 5))
        hits = numpyro.sample("hits", dist.Binomial(tries, 0.5))  # has other values each time
        mood = numpyro.sample("mood", dist.Beta(2.0, 2.0))
        helping = 0.1 * hits * mood
        numpyro.sample(
            "alpha", dist.Categorical(probs=jnp.stack([1 - helping, *[helping / 4] * 4]))
        )
        sites.goals()
        sites.strengths()

    masses = np.exp(prior_table(moody, LEVELS)).sum(axis=(0, 1, 3, 4))
    np.testing.assert_allclose(masses, [0.925, *[0.075 / 4] * 4], rtol=0.02)
    (density,) = np.exp(log_prior([(BLUE_TO_RED, PINK_TO_RED)], moody) + PER_NEWTON)
    assert density == pytest.approx(0.925 / 34**2, rel=0.02)


def test_levels_of_strength_have_the_mass_of_their_cells() -> None:
    law = dist.TruncatedNormal(378.0, 8.0, low=150.0, high=600.0)

    def prior() -> None:
        sites.goals()
        sites.alpha()
        numpyro.sample("strength_red", law)
        numpyro.sample("strength_green", dist.Uniform(150.0, 600.0))

    table = np.exp(prior_table(prior, LEVELS)).sum(axis=(0, 1, 2))
    np.testing.assert_allclose(table.sum(axis=1), of_cells(law), atol=1e-5)
    np.testing.assert_allclose(table.sum(axis=0), [1 / 6, 1 / 3, 1 / 3, 1 / 6])


def of_cells(law: Any) -> np.ndarray:
    low, high = float(law.support.lower_bound), float(law.support.upper_bound)
    masses: np.ndarray = np.diff(law.cdf(np.clip(ENDS, low, high)))
    return masses


def masses_of_levels(prior: Any) -> np.ndarray:
    table: np.ndarray = np.exp(prior_table(prior, LEVELS))
    return table.sum(axis=(0, 1, 4))


def test_the_mass_of_levels_is_right_where_alpha_depends_on_strengths() -> None:
    law = dist.TruncatedNormal(378.0, 8.0, low=150.0, high=600.0)

    def prior() -> None:
        sites.goals()
        red = numpyro.sample("strength_red", law)
        helps = 0.1 + 0.1 * (red > 300)
        probs = jnp.stack([1 - 4 * helps, *[helps] * 4])
        numpyro.sample("alpha", dist.Categorical(probs=probs))
        numpyro.sample("strength_green", dist.Uniform(150.0, 600.0))

    found = masses_of_levels(prior)
    np.testing.assert_allclose(found.sum(axis=0), of_cells(law), atol=1e-4)
    np.testing.assert_allclose(found.sum(axis=1), [0.2] * 5, atol=1e-4)
