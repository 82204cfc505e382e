from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.world.errors import InvalidSettingError

BETAS = (0.05, 0.7)
N_COORDINATES = 8  # of the four entities of PHASE


@pytest.mark.parametrize("n_entities", [4, 1, 10])
@pytest.mark.parametrize("beta", BETAS)
def test_radial_density_integrates_to_one(beta: float, n_entities: int) -> None:
    radius, d = np.linspace(1e-6, 90 / beta, 200_001), 2 * n_entities
    sphere = 2 * math.pi ** (d / 2) / math.gamma(d / 2)
    density = np.exp(RadialLikelihood(beta, n_entities).log_prob(radius))
    found = np.trapezoid(density * sphere * radius ** (d - 1), radius)
    assert found == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("beta", BETAS)
def test_mean_distance_of_samples_is_d_over_beta(beta: float) -> None:
    predicted = np.broadcast_to(np.arange(3 * 8.0).reshape(3, 4, 2), (2000, 3, 4, 2))
    samples = RadialLikelihood(beta).replicate(predicted, np.random.default_rng(0))
    distance = np.sqrt(((samples - predicted) ** 2).sum(axis=(-2, -1)))
    assert distance.shape == (2000, 3)
    # the standard deviation of a Gamma(8) distance is its mean / sqrt(8)
    assert distance.mean() == pytest.approx(N_COORDINATES / beta, rel=4 / math.sqrt(8 * 6000))


def test_largest_error_reaches_exactly_the_floor() -> None:
    likelihood = RadialLikelihood()
    total = likelihood.max_total_error(-400.0, 10)
    assert likelihood.log_prob(np.full(10, total / 10)).sum() == pytest.approx(-400)


def test_density_is_the_same_in_numpy_and_jax_and_zero_of_an_infinite_error() -> None:
    errors = np.array([0.0, 3.0, 40.0, np.inf])
    found = RadialLikelihood().log_prob(errors)
    np.testing.assert_allclose(found, RadialLikelihood().log_prob(jnp.asarray(errors)), 1e-6)
    assert found[-1] == -np.inf


@pytest.mark.parametrize("beta", [0, -1.0, math.nan, math.inf, 10**400, "0.05", True])
def test_beta_must_be_a_positive_number(beta: Any) -> None:
    with pytest.raises(InvalidSettingError, match="beta"):
        RadialLikelihood(beta)
