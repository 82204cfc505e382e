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


@pytest.mark.parametrize(
    ("options", "said"),
    [
        # tests/models/test_checks.py has all that can be wrong with a prior
        ({"prior": also(lambda: numpyro.factor("also", 0.5))}, "conditions on 'also'"),
        ({"prior": 34}, "no NumPyro program"),
        ({"prior": "sparse_socal"}, "'sparse_social'"),
        ({"likelihood": object()}, "lacks log_prob or max_total_error"),
        ({"planner": "papr"}, "papr"),
        ({"noise": "none"}, "noise"),
        ({"simulator": still, "planner": "paper"}, "joint simulator"),
    ],
)
def test_what_makes_no_model_is_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises((InvalidSettingError, UnknownNameError), match=said):
        Model(**options)


def test_kernels_weigh_errors_by_one_of_two_kinds_of_likelihood() -> None:
    assert Model().error_likelihood == RadialLikelihood()
    table = Model(likelihood=StepwiseLikelihood()).error_likelihood
    assert table.log_prob(2.5) == -2.5
    assert table.max_total_error(-4.0, 10) == 4.0


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


def test_fingerprint_tells_models_apart() -> None:
    def one() -> None:
        sites.goals(), sites.alpha(), sites.strengths()

    def other() -> None:
        sites.strengths(), sites.goals(), sites.alpha()

    prints = [Model(prior=prior, simulator=still).fingerprint() for prior in (one, other)]
    assert prints[0]["prior_source"] != prints[1]["prior_source"]
    assert prints[0]["simulator"].endswith("still")
    assert Model().fingerprint() != Model(planner="paper").fingerprint()
    assert Model(prior="relation_first").fingerprint()["prior"].endswith("relation_first")
