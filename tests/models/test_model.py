from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.models import priors, sites
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.models.stepwise import StepwiseLikelihood
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene


def still(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[Any]:
    while True:
        yield scene.start


def also(statement: Callable[[], Any]) -> Callable[[], None]:
    """The default prior and one more statement."""

    def changed() -> None:
        statement()
        priors.uniform()

    return changed


def test_prior_that_cannot_work_is_refused_by_name() -> None:
    # tests/models/test_checks.py has all that can be wrong
    with pytest.raises(InvalidSettingError, match="conditions on 'also'"):
        Model(prior=also(lambda: numpyro.factor("also", 0.5)), simulator=still)


def test_likelihood_must_be_of_one_of_two_kinds() -> None:
    with pytest.raises(InvalidSettingError, match="lacks log_prob or max_total_error"):
        Model(likelihood=object())  # type: ignore[arg-type]
    assert Model().error_likelihood == RadialLikelihood()
    table = Model(likelihood=StepwiseLikelihood()).error_likelihood
    assert table.log_prob(2.5) == -2.5
    assert table.max_total_error(-4.0, 10) == 4.0


def test_prior_must_be_a_program() -> None:
    with pytest.raises(InvalidSettingError, match="no NumPyro program"):
        Model(prior=34)  # type: ignore[arg-type]


def test_prior_may_have_sites_of_its_own() -> None:
    own = dist.Normal(jnp.zeros(3)).to_event(1)
    model = Model(prior=also(lambda: numpyro.sample("also", own)))
    assert model.sites["also"] == (3,)
    assert set(sites.HYPOTHESIS_SITES) < set(model.sites)


def test_joint_simulator_with_the_fast_planner_is_the_default() -> None:
    simulator = Model().build_simulator()
    assert isinstance(simulator, JointSimulator)
    assert simulator.planner == PlannerConfig.fast()
    assert Model(planner="paper").build_simulator().planner == PlannerConfig()


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="papr"):
        Model(planner="papr")
    with pytest.raises(UnknownNameError, match="noise"):
        Model(noise="none")  # type: ignore[arg-type]


def test_planner_belongs_to_the_joint_simulator() -> None:
    with pytest.raises(InvalidSettingError, match="joint simulator"):
        Model(simulator=still, planner="paper")


def test_fingerprint_tells_models_apart() -> None:
    def one() -> None:
        sites.goals(), sites.alpha(), sites.strengths()

    def other() -> None:
        sites.strengths(), sites.goals(), sites.alpha()

    prints = [Model(prior=prior, simulator=still).fingerprint() for prior in (one, other)]
    assert prints[0]["prior_source"] != prints[1]["prior_source"]
    assert prints[0]["simulator"].endswith("still")
    assert Model().fingerprint() != Model(planner="paper").fingerprint()
