"""A model: what is refused, its likelihood, and as a program bound to an event."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.infer.util import log_density as numpyro_log_density

from phase_ppl.models import sites
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.models.program import MAX_SEED
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from tests.inference.toy import (
    TableRunner,
    never_called,
    table_errors,
    table_program,
)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        # tests/models/test_checks.py has all that can be wrong with a prior
        ({"prior": 34}, "no NumPyro program"),
        ({"prior": "sparse_socal"}, "'sparse_social'"),
        ({"likelihood": object()}, "lacks log_prob or max_total_error"),
        ({"planner": "papr"}, "papr"),
        ({"simulator": never_called, "planner": "paper"}, "joint simulator"),
    ],
)
def test_what_makes_no_model_is_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises((InvalidSettingError, UnknownNameError), match=said):
        Model(**options)


def test_fingerprint_tells_models_apart() -> None:
    def one() -> None:
        sites.goals(), sites.alpha(), sites.strengths()

    def other() -> None:
        sites.strengths(), sites.goals(), sites.alpha()

    prints = [Model(prior=prior, simulator=never_called).fingerprint() for prior in (one, other)]
    assert prints[0]["prior_source"] != prints[1]["prior_source"]
    assert prints[0]["simulator"].endswith("never_called")
    assert Model().fingerprint() != Model(planner="paper").fingerprint()
    assert Model(prior="relation_first").fingerprint()["prior"].endswith("relation_first")


@pytest.mark.parametrize(("beta", "n_entities"), [(0.05, 4), (0.7, 1), (0.7, 10)])
def test_radial_density_integrates_to_one(beta: float, n_entities: int) -> None:
    radius, d = np.linspace(1e-6, 90 / beta, 200_001), 2 * n_entities
    sphere = 2 * math.pi ** (d / 2) / math.gamma(d / 2)
    density = np.exp(RadialLikelihood(beta, n_entities).log_prob(radius))
    found = np.trapezoid(density * sphere * radius ** (d - 1), radius)
    assert found == pytest.approx(1, abs=1e-4)


def test_distances_of_samples_have_the_law_of_the_radial_density() -> None:
    predicted = np.broadcast_to(np.arange(3 * 8.0).reshape(3, 4, 2), (2000, 3, 4, 2))
    samples = RadialLikelihood(0.7).replicate(predicted, np.random.default_rng(0))
    distance = np.sqrt(((samples - predicted) ** 2).sum(axis=(-2, -1)))
    # d = 8 coordinates; the standard deviation of a Gamma(8) distance is its mean / sqrt(8)
    assert distance.mean() == pytest.approx(8 / 0.7, rel=4 / math.sqrt(8 * distance.size))
    assert distance.std() == pytest.approx(math.sqrt(8) / 0.7, rel=0.05)


def test_density_in_numpy_and_jax_and_the_error_at_which_it_reaches_a_floor() -> None:
    likelihood, errors = RadialLikelihood(), np.array([0.0, 3.0, 40.0, np.inf])
    found = likelihood.log_prob(errors)
    np.testing.assert_allclose(found, likelihood.log_prob(jnp.asarray(errors)), 1e-6)
    assert found[-1] == -np.inf
    total = likelihood.max_total_error(-400.0, 10)
    assert likelihood.log_prob(np.full(10, total / 10)).sum() == pytest.approx(-400)


Z = {"goal_red": 0, "goal_green": 3, "alpha": 0, "strength_red": 300.0, "strength_green": 200.0}
SITES = {name: jnp.asarray(value) for name, value in Z.items()}


def test_program_is_prior_times_likelihood() -> None:
    errors = table_errors()
    program, _bridge = table_program(TableRunner(errors))
    found, trace = numpyro_log_density(program, (), {}, {**SITES, "sim_seed": jnp.array(4)})
    np.testing.assert_allclose(trace["step_error"]["value"], errors[0, 3, 1], rtol=1e-5)
    expected = program.log_prior(SITES) + program.log_likelihood(errors[0, 3, 1]).sum()
    expected -= np.log(MAX_SEED)  # all seeds alike
    assert float(found) == pytest.approx(float(expected), rel=1e-5)
