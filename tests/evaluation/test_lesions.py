"""Lesions of SIMPLE: each is SIMPLE with one thing changed."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.cli.evaluate import options_of
from phase_ppl.evaluation.registry import ready
from phase_ppl.models import priors
from phase_ppl.simulator.joint import DynamicsNoise, JointSimulator
from phase_ppl.simulator.no_physics import PathSimulator
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from tests.inference.toy import walkers, walking_event

LESIONS = (
    *("no_physics", "noisy_physics", "full_observation", "true_state"),
    *("no_cost_weight", "no_social_goals"),
)


def model(name: str, **options: Any) -> ppl.Model:
    made: Any = ready(name, options).predict
    found: ppl.Model = made.model
    return found


@pytest.mark.parametrize("planner", [None, "paper"])
@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("full_observation", {"full_observation": True}),
        ("true_state", {"true_state": True}),
        ("no_cost_weight", {"cost_weight": 0.0}),
    ],
)
def test_one_setting_of_the_planner_is_changed(
    name: str, change: dict[str, Any], planner: str | None
) -> None:
    usual, lesion = model("simple", planner=planner), model(name, planner=planner)
    assert isinstance(usual.planner, ppl.PlannerConfig)
    assert lesion == dataclasses.replace(
        usual, planner=dataclasses.replace(usual.planner, **change)
    )


def test_another_simulator_takes_the_place_of_the_joint_one() -> None:
    still = model("no_physics", planner="paper", speed=5.0).simulator
    assert isinstance(still, PathSimulator)
    assert (still.planner, still.speed) == (ppl.PlannerConfig(), 5.0)
    noisy = model("noisy_physics", speed_noise=0.1).simulator
    assert isinstance(noisy, JointSimulator)
    assert noisy.planner == ppl.PlannerConfig.fast()
    assert noisy.noise == DynamicsNoise(speed=0.1, direction=0.2)


def test_what_a_simulator_consists_of_is_kept_with_the_run() -> None:
    kept = ready("noisy_physics", {"direction_noise": 0.3}).record["model_settings"]["model"]
    assert kept["simulator_settings"]["noise"] == {"speed": 0.2, "direction": 0.3}
    assert "simulator_settings" not in ready("simple", {}).record["model_settings"]["model"]


def test_without_social_goals_alpha_is_zero_in_every_draw() -> None:
    assert model("no_social_goals").prior is priors.no_social_goals
    lesion = model("no_social_goals", simulator=walkers)
    post = ppl.infer(
        walking_event(), lesion, chains=4, iterations=1, workers=1, progress=False, checkpoint=None
    )
    assert post.cost["simulations"] == 8
    assert np.all(post.tree["posterior"]["alpha"].values == 0)


@pytest.mark.parametrize("name", LESIONS)
def test_options_of_simple_are_taken(name: str) -> None:
    made: Any = ready(name, {"kernel": "mixture", "weights": "count", "planner": "paper"}).predict
    assert made.options == {"kernel": "mixture"}
    assert made.weights == "count"
    with pytest.raises(UnknownNameError, match="'local_mh'"):
        ready(name, {"kernel": "local_hm"})
    with pytest.raises(UnknownNameError, match="'slow'"):
        ready(name, {"planner": "slow"})


@pytest.mark.parametrize(
    ("name", "option"),
    [("no_physics", "simulator"), ("noisy_physics", "simulator"), ("no_social_goals", "prior")],
)
def test_what_a_lesion_changes_cannot_be_given(name: str, option: str) -> None:
    with pytest.raises(InvalidSettingError, match=f"{option} is no option here"):
        ready(name, {option: None})


def test_of_several_models_each_gets_the_options_that_it_takes() -> None:
    names = ("simple", *LESIONS)
    given = [("speed", 5), ("speed_noise", 0.1), ("chains", 3), ("rule", "paper")]
    found = options_of(dict(zip(names, names, strict=True)), {"prior": "sparse_social"}, given)
    for name, options in found.items():
        assert options.get("prior") == (None if name == "no_social_goals" else "sparse_social")
        assert options.get("speed") == (5 if name == "no_physics" else None)
        assert options.get("speed_noise") == (0.1 if name == "noisy_physics" else None)
        assert (options["chains"], options["rule"]) == (3, "paper")
        ready(name, options)


@pytest.mark.slow
@pytest.mark.parametrize("name", LESIONS)
def test_they_answer(name: str) -> None:
    found = ppl.evaluate("collaborate", name, chains=2, iterations=1, workers=1, progress=False)
    assert not found.failures
    assert set(found.predictions["collaborate"].answers) == {"goal_red", "goal_green", "relation"}
