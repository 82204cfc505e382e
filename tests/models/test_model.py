from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.models import sites
from phase_ppl.models.model import Model
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene


def still(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[Any]:
    while True:
        yield scene.start


def equal(n: int) -> Any:
    return dist.Categorical(logits=jnp.zeros(n))


def prior_with(**statements: Callable[[str], Any]) -> Callable[[], None]:
    """The default prior with some sites' statements replaced; None leaves a site out."""

    def changed() -> None:
        for name in sites.GOAL_SITES:
            statements.get(
                name, lambda n: numpyro.sample(n, dist.Categorical(logits=jnp.zeros(36)))
            )(name)
        statements.get("alpha", lambda n: sites.alpha())("alpha")
        for name in sites.STRENGTH_SITES:
            statements.get(name, lambda n: numpyro.sample(n, dist.Uniform(150, 600)))(name)
        if "also" in statements:
            statements["also"]("also")

    return changed


def sampled(distribution: Any) -> Callable[[str], Any]:
    return lambda name: numpyro.sample(name, distribution)


REFUSED = {
    "missing goal": ({"goal_red": lambda n: None}, "does not sample 'goal_red'.*sites.goals"),
    "missing alpha": ({"alpha": lambda n: None}, "does not sample 'alpha'.*sites.alpha"),
    "missing strength": ({"strength_red": lambda n: None}, "'strength_red'.*sites.strengths"),
    "37 goals": (
        {"goal_red": sampled(equal(37))},
        "'goal_red'.*support",
    ),
    "real goal": ({"goal_green": sampled(dist.Uniform(0, 35))}, "'goal_green'.*support"),
    "six alphas": ({"alpha": sampled(dist.DiscreteUniform(0, 5))}, "'alpha'.*support"),
    "negative goal": ({"goal_red": sampled(dist.DiscreteUniform(-1, 35))}, "'goal_red'.*support"),
    "negative strength": (
        {"strength_green": sampled(dist.Normal(300, 50))},
        "'strength_green'.*positive",
    ),
    "two strengths": (
        {"strength_red": sampled(dist.Uniform(150, 600).expand([2]))},
        r"'strength_red' of shape \(2,\)",
    ),
    "observed": (
        {
            "alpha": lambda n: numpyro.sample(
                n, dist.Categorical(logits=jnp.zeros(5)), obs=jnp.array(0)
            )
        },
        "conditions on 'alpha'",
    ),
    "factor": ({"also": lambda n: numpyro.factor(n, 0.5)}, "conditions on 'also'"),
    "reserved name": ({"also": lambda n: numpyro.sample("relation", dist.Normal())}, "reserved"),
    "crash": ({"alpha": lambda n: 1 / 0}, "cannot be run: ZeroDivisionError"),
    "no density": (
        {"also": sampled(dist.distribution.Distribution())},
        "cannot be run|no density",
    ),
}


@pytest.mark.parametrize(("statements", "message"), REFUSED.values(), ids=REFUSED)
def test_prior_that_cannot_work_is_refused_by_name(statements: Any, message: str) -> None:
    with pytest.raises(InvalidSettingError, match=message):
        Model(prior=prior_with(**statements), simulator=still)


def test_prior_must_be_a_program() -> None:
    with pytest.raises(InvalidSettingError, match="no NumPyro program"):
        Model(prior=34)  # type: ignore[arg-type]


def test_prior_may_have_sites_of_its_own() -> None:
    model = Model(prior=prior_with(also=sampled(dist.Normal(jnp.zeros(3)).to_event(1))))
    assert model.sites["also"] == (3,)
    assert set(sites.HYPOTHESIS_SITES) < set(model.sites)


def test_prior_of_strengths_may_reach_beyond_the_original_worlds() -> None:
    Model(prior=prior_with(strength_red=sampled(dist.LogNormal(6.0, 0.5))))


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
