"""SIMPLE as a model of social perception, the same as ``infer`` over many events; its lesions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.evaluate import event_seed
from phase_ppl.evaluation.prediction import QUESTIONS
from phase_ppl.evaluation.registry import ready
from phase_ppl.inference.run import Run
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.identity import event_digest
from tests.inference.toy import walkers, walking_event

EVENT = walking_event()
TINY: dict[str, Any] = {"kernel": "prior_mh", "chains": 4, "iterations": 1}


def test_its_answers_are_the_marginals_of_the_posterior_it_keeps(tmp_path: Path) -> None:
    given = {"simulator": walkers, "workers": 1, "progress": False, **TINY}
    found = ppl.evaluate(EVENT, "simple", weights="count", out=tmp_path, **given)
    seed = event_seed(0, event_digest(EVENT))
    own = ppl.Model(simulator=walkers)
    of_run = {"seed": seed, "workers": 1, "progress": False, "weights": "count", **TINY}
    post = ppl.infer(EVENT, own, **of_run)
    prediction = found.predictions["walk"]
    kept = found.posterior("walk")
    assert isinstance(kept, ppl.Posterior)
    assert kept.event_id == "walk", "which the model never knew"
    assert kept.weights == "count"
    for question in QUESTIONS:
        for posterior in (kept, post):
            marginal = posterior.marginal(question).values
            assert prediction.probabilities[question] == pytest.approx(marginal, abs=1e-12)
    spent = post.cost["simulations"]
    assert spent == 8, "rivals are simulated where all simulations are weighed, not the draws"
    assert prediction.cost["simulations"] == found.cost["simulations"] == spent
    assert f"{spent} simulations" in str(found)
    assert found.settings["model_settings"]["model"]["simulator"] == "tests.inference.toy.walkers"


def test_a_model_of_ones_own_is_explained_as_by_infer() -> None:
    own = ppl.Model(prior="relation_first", simulator=walkers)
    made = ready(own, {"kernel": "local_mh", "chains": 4})
    assert made.name == "simple"
    assert made.predict.model is own  # type: ignore[attr-defined]
    assert "relation_first" in made.record["model_settings"]["model"]["prior"]
    read = ready(ppl.Model(prior="relation_first"), {})
    assert read.name == "closed_loop"
    assert read.predict.model.likelihood == ppl.ClosedLoopLikelihood()  # type: ignore[attr-defined]


def test_settings_of_simple_go_by_name() -> None:
    made: Any = ready("simple", {"proposal": "paper", "eta": 0.2, "rule": "paper"}).predict
    assert made.options == {
        "kernel": "local_mh",
        "rule": "paper",
        "settings": ppl.SimpleSettings(proposal="paper", eta=0.2),
    }


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"planner": "slow"}, UnknownNameError, "'slow'"),
        ({"weights": "counts"}, UnknownNameError, "'count'"),
        ({"checkpoint": "run.ckpt"}, InvalidSettingError, "checkpoint is no option"),
        ({"eta": 0.2, "settings": ppl.SimpleSettings()}, InvalidSettingError, "either settings"),
        ({"rull": "paper"}, UnknownNameError, "kernel 'local_mh': 'rull'; did you mean 'rule'"),
        ({"program": ppl.Model(), "prior": "relation_first"}, InvalidSettingError, "either a prog"),
    ],
)
def test_options_that_cannot_be_used_are_refused_before_anything_is_asked(
    options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        ready("simple", options)


# --- lesions: each is SIMPLE with one thing changed ---------------------------------------------

LESIONS = (
    *("no_physics", "noisy_physics", "full_observation", "true_state", "no_cost_weight"),
    "no_social_goals",
)


def test_lesions_take_the_options_of_simple_but_for_what_they_change() -> None:
    for name in LESIONS:
        given = {"kernel": "gibbs", "weights": "count", "planner": "paper"}
        made: Any = ready(name, given).predict
        assert made.options == {"kernel": "gibbs", "weights": "count"}
        with pytest.raises(UnknownNameError, match="'local_mh'"):
            ready(name, {"kernel": "local_hm"})
    changed = {"no_physics": "simulator", "noisy_physics": "simulator", "no_social_goals": "prior"}
    for name, option in changed.items():
        with pytest.raises(InvalidSettingError, match=f"{option} is no option here"):
            ready(name, {option: None})


CHANGES = {
    "no_physics": {"simulator", "simulator_source", "simulator_settings", "planner"},
    "noisy_physics": {"simulator", "simulator_source", "simulator_settings", "planner"},
    "full_observation": {"planner.full_observation"},
    "true_state": {"planner.true_state"},
    "no_cost_weight": {"planner.cost_weight"},
    "no_social_goals": {"prior", "prior_source"},
}
"""Lesion -> what of a model it changes; who brings a simulator has its planner in there."""


@pytest.mark.parametrize("name", LESIONS)
def test_a_lesion_differs_from_simple_in_the_one_thing_that_its_name_says(name: str) -> None:
    intact: Any = ready("simple", {}).predict
    lesioned: Any = ready(name, {}).predict
    assert lesioned.options == intact.options
    parts = [_flat(made.model.fingerprint()) for made in (intact, lesioned)]
    keys = parts[0].keys() | parts[1].keys()
    changed = {key for key in keys if parts[0].get(key) != parts[1].get(key)}
    assert {_whole(key, CHANGES[name]) for key in changed} == CHANGES[name]
    # proposals too: they are settled by kernel and world alone
    runs = [
        Run(EVENT, made.model, made.options["kernel"], {}, ppl.SimpleSettings(), 2, 0)
        for made in (intact, lesioned)
    ]
    assert runs[0].settings == runs[1].settings
    assert runs[0].settings.proposal == "learned"
    if "simulator" in CHANGES[name]:  # by which it plans, where that is no field of the model
        planner = lesioned.model.simulator.settings()["planner"]
        assert planner == intact.model.planner_config().to_dict()


def _flat(record: Any) -> dict[str, Any]:
    planner = record.pop("planner") or {}
    return {**record, **{f"planner.{name}": value for name, value in planner.items()}}


def _whole(key: str, names: set[str]) -> str:
    return key if key in names else key.partition(".")[0]
