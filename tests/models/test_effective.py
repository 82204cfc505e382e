"""The prior of effective hypotheses sums out what changes nothing."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

from phase_ppl.models import priors, sites
from phase_ppl.models.effective import (
    log_prior_of_effective,
    prior_table,
    stated_hypotheses,
)
from phase_ppl.world.goals import N_GOALS, goal_index

PER_NEWTON = 2 * np.log(450.0)
BLUE_TO_RED = goal_index("Get blue item to red lm")
BLUE_AWAY = goal_index("Get blue item away from red lm")
PINK_TO_RED = goal_index("Get pink item to red lm")


def log_prior(pairs: list[tuple[int, int]], prior: object = priors.uniform) -> np.ndarray:
    strengths = {name: np.full(len(pairs), 300.0) for name in ("strength_red", "strength_green")}
    return log_prior_of_effective(prior, np.array(pairs), strengths)  # type: ignore[arg-type]


def test_every_stated_hypothesis_leads_to_one_effective_pair() -> None:
    assert sum(len(rows) for rows in stated_hypotheses().values()) == N_GOALS**2 * 5


def test_helping_and_hindering_pairs_gather_what_the_social_agent_might_have_wanted() -> None:
    shared, opposed, unrelated = np.exp(
        log_prior(
            [(BLUE_TO_RED, BLUE_TO_RED), (BLUE_TO_RED, BLUE_AWAY), (BLUE_TO_RED, PINK_TO_RED)]
        )
        + PER_NEWTON
    )
    # both for themselves; or one of two helpers, or one of two hinderers, of a goal in 34
    assert shared == pytest.approx(1 / 3 / 34**2 + 2 / 6 / 34, rel=1e-4)
    assert opposed == pytest.approx(1 / 3 / 34**2 + 2 / 6 / 34, rel=1e-4)
    assert unrelated == pytest.approx(1 / 3 / 34**2, rel=1e-4)


def test_a_site_of_ones_own_is_averaged_out() -> None:
    def friendly_or_not() -> None:
        friendly = numpyro.sample("friendly", dist.Bernoulli(0.5))
        helping = jnp.array([0.0, 0.5, 0.5, 0.0, 0.0])
        alone = jnp.array([1.0, 0.0, 0.0, 0.0, 0.0])
        numpyro.sample("alpha", dist.Categorical(probs=jnp.where(friendly, helping, alone)))
        sites.goals()
        sites.strengths()

    shared, unrelated = np.exp(
        log_prior([(BLUE_TO_RED, BLUE_TO_RED), (BLUE_TO_RED, PINK_TO_RED)], friendly_or_not)
        + PER_NEWTON
    )
    assert unrelated == pytest.approx(0.5 / 34**2, rel=0.3)
    assert shared == pytest.approx(0.5 / 34 + 0.5 / 34**2, rel=0.3)


@pytest.mark.parametrize(
    "law", [dist.Uniform(200.0, 400.0), dist.TruncatedNormal(378.0, 8.0, low=150.0, high=600.0)]
)
def test_levels_of_strength_have_the_mass_of_their_cells(law: dist.Distribution) -> None:
    def prior() -> None:
        sites.goals()
        sites.alpha()
        numpyro.sample("strength_red", law)
        numpyro.sample("strength_green", dist.Uniform(150.0, 600.0))

    table = np.exp(prior_table(prior, (150.0, 300.0, 450.0, 600.0))).sum(axis=(0, 1, 2))
    exact = np.diff(law.cdf(np.clip([150.0, 225.0, 375.0, 525.0, 600.0], *law_ends(law))))
    np.testing.assert_allclose(table.sum(axis=1), exact, atol=1e-5)
    np.testing.assert_allclose(table.sum(axis=0), [1 / 6, 1 / 3, 1 / 3, 1 / 6])


def law_ends(law: dist.Distribution) -> tuple[float, float]:
    return float(law.support.lower_bound), float(law.support.upper_bound)
