"""Inference under priors other than the paper's, against enumeration and end to end."""

from __future__ import annotations

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from jax import random

import phase_ppl as ppl
from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.tables import window_count
from phase_ppl.models.density import compiled_quickly, log_density
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.simulator.contract import SimulationResult
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from tests.inference.toy import (
    N_FRAMES,
    SETTINGS,
    TableRunner,
    guide_of_logits,
    run,
    table_errors,
    table_guide,
    table_program,
    total_variation,
    walkers,
    walking_event,
)

STEPS = 1000
KEYS = random.split(random.key(0), 15)
ERRORS = table_errors()


class StrengthRunner(TableRunner):
    """As ``TableRunner``, but the errors grow with the strengths, red's faster than green's."""

    def run(self, hypotheses: Any, seeds: Any, error_ceilings: Any) -> list[SimulationResult]:
        results = super().run(hypotheses, seeds, [np.inf] * len(seeds))
        for result, h in zip(results, hypotheses, strict=True):
            result.errors[:] *= strength_factor(*h.strengths)
        return results


def strength_factor(red: Any, green: Any) -> Any:
    return 0.2 + red / 400 + green / 800


VALUES, PROBS = (200.0, 300.0, 450.0, 700.0), (0.1, 0.4, 0.3, 0.2)


def few_goals_and_levels() -> None:
    """Unequal levels, one of them beyond those of the original worlds."""
    numpyro.sample("strength_red", ppl.sites.OneOf(VALUES, PROBS))
    numpyro.sample("strength_green", ppl.sites.OneOf(VALUES, PROBS))
    numpyro.sample("goal_red", dist.Categorical(probs=jnp.zeros(N_GOALS).at[5].set(1.0)))
    numpyro.sample("goal_green", dist.Categorical(probs=jnp.zeros(N_GOALS).at[3].set(1.0)))
    numpyro.sample("alpha", dist.Categorical(probs=jnp.array([1.0, 0, 0, 0, 0])))


@pytest.mark.slow
def test_discrete_strengths_reach_the_enumerated_posterior() -> None:
    program, _bridge = table_program(StrengthRunner(ERRORS), few_goals_and_levels)
    kernel = LocalMH(program, table_guide(few_goals_and_levels), SETTINGS)
    z = run(kernel, STEPS, KEYS).z
    found = np.zeros((len(VALUES), len(VALUES)))
    index = [np.searchsorted(VALUES, np.asarray(z[name]).ravel())
             for name in ("strength_red", "strength_green")]  # fmt: skip
    np.add.at(found, tuple(index), 1 / index[0].size)
    exact = np.zeros_like(found)
    for (i, red), (j, green) in itertools.product(enumerate(VALUES), repeat=2):
        errors = ERRORS[5, 3] * strength_factor(red, green)
        likelihood = np.exp(-RadialLikelihood().beta * errors.sum(axis=-1)).mean()
        exact[i, j] = PROBS[i] * PROBS[j] * likelihood
    exact /= exact.sum()
    prior = np.outer(PROBS, PROBS)
    assert total_variation(exact, prior) > 0.2
    assert total_variation(found, exact) < 0.05


def test_guide_proposes_just_the_values_that_the_prior_allows() -> None:
    prior, n_windows = ppl.priors.strength_levels, window_count(N_FRAMES, SETTINGS.window)
    guide = guide_of_logits(prior, np.zeros((n_windows + 1, 2, N_GOALS)))

    def density(window: jax.Array, forces: jax.Array) -> jax.Array:
        goals = {name: jnp.array(0) for name in ("goal_red", "goal_green", "alpha")}
        z = goals | {"strength_red": forces[0], "strength_green": forces[1]}
        return log_density(guide, z, window)

    of_all = compiled_quickly(jax.vmap(jax.vmap(density, (None, 0)), (0, None)))
    pairs = jnp.array(list(itertools.product((*STRENGTH_LEVELS, 310.0), repeat=2)))
    densities = np.exp(of_all(jnp.arange(2), pairs)).reshape(2, 5, 5)
    assert (densities[:, :4, :4] > 0).all()
    assert (densities[:, 4] == 0).all()
    assert (densities[:, :, 4] == 0).all()
    # the estimates of window 1 are 300 N and 450 N
    assert np.unravel_index(densities[1].argmax(), (5, 5)) == (1, 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "relation_first",
        "strength_levels",
        "correlated_strengths",
        "sparse_social",
        "symmetric_alphas",
    ],
)
def test_infer_runs_with_each_ready_made_prior(name: str) -> None:
    model = ppl.Model(prior=name, simulator=walkers)
    kernel = "local_mh" if name in ("relation_first", "strength_levels") else "prior_mh"
    options: dict[str, Any] = {"chains": 3, "iterations": 1, "workers": 1, "progress": False}
    post = ppl.infer(walking_event(), model, kernel=kernel, **options)
    assert post.settings["model"]["prior"].endswith(name)
    assert np.isfinite(post.tree["simulations"]["log_prior_effective"]).all()
    if name == "strength_levels":
        assert np.isin(post.tree["posterior"]["strength_red"], STRENGTH_LEVELS).all()
