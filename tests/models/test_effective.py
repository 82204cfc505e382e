"""The prior of effective hypotheses sums out what changes nothing."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

from phase_ppl.models import priors, sites
from phase_ppl.models.effective import log_prior_of_effective, stated_hypotheses
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
