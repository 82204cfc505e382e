"""SIMPLE as a model of social perception: the same as ``infer``, over many events."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.evaluate import event_seed
from phase_ppl.evaluation.prediction import QUESTIONS
from phase_ppl.evaluation.registry import ready
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.identity import event_digest
from tests.inference.toy import walkers, walking_event

EVENT = walking_event()
TINY: dict[str, Any] = {"kernel": "prior_mh", "chains": 4, "iterations": 1}


def evaluate(**more: Any) -> ppl.Evaluation:
    given = {"simulator": walkers, "workers": 1, "progress": False, **TINY}
    return ppl.evaluate(EVENT, "simple", **{**given, **more})


def test_its_answers_are_the_marginals_of_the_posterior_it_keeps(tmp_path: Path) -> None:
    found = evaluate(out=tmp_path)
    seed = event_seed(0, event_digest(EVENT))
    post = ppl.infer(
        EVENT, ppl.Model(simulator=walkers), seed=seed, workers=1, progress=False, **TINY
    )
    prediction = found.predictions["walk"]
    assert found.folder is not None
    kept = ppl.Posterior.load(found.folder.folder_of("walk") / "posterior.nc")
    for question in QUESTIONS:
        for posterior in (post, kept):
            marginal = posterior.marginal(question).values
            assert prediction.probabilities[question] == pytest.approx(marginal, abs=1e-12)
    assert prediction.cost["simulations"] == post.cost["simulations"] == 8
    assert found.cost["simulations"] == 8
    assert "8 simulations" in str(found)
    assert found.settings["model_settings"]["model"]["simulator"] == "tests.inference.toy.walkers"


def test_weights_are_those_asked_for_also_in_the_file(tmp_path: Path) -> None:
    found = evaluate(weights="count", out=tmp_path)
    assert found.folder is not None
    kept = ppl.Posterior.load(found.folder.folder_of("walk") / "posterior.nc")
    assert kept.weights == "count"
    given = found.predictions["walk"].probabilities["goal_red"]
    assert given == pytest.approx(kept.marginal("goal_red").values, abs=1e-12)


def test_the_posterior_it_keeps_is_of_the_event_though_the_model_never_knew_its_name(
    tmp_path: Path,
) -> None:
    found = evaluate(out=tmp_path)
    assert found.folder is not None
    path = found.folder.folder_of("walk") / "posterior.nc"
    assert ppl.Posterior.load(path).event_id == "walk"


def test_a_model_of_ones_own_is_explained_by_simple() -> None:
    own = ppl.Model(prior="relation_first", simulator=walkers)
    made = ready(own, {"chains": 4})
    assert made.name == "simple"
    assert made.predict.model is own  # type: ignore[attr-defined]
    assert "relation_first" in made.record["model_settings"]["model"]["prior"]


def test_settings_of_simple_go_by_name() -> None:
    made: Any = ready("simple", {"proposal": "paper", "beta": 0.1, "rule": "paper"}).predict
    assert made.options == {
        "rule": "paper",
        "settings": ppl.SimpleSettings(proposal="paper", beta=0.1),
    }


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"planner": "slow"}, UnknownNameError, "'slow'"),
        ({"kernel": "local_hm"}, UnknownNameError, "'local_mh'"),
        ({"weights": "counts"}, UnknownNameError, "'count'"),
        ({"prior": "unifrom"}, UnknownNameError, "'uniform'"),
        ({"proposal": "papr"}, UnknownNameError, "'paper'"),
        ({"checkpoint": "run.ckpt"}, InvalidSettingError, "checkpoint is no option"),
        ({"beta": 0.1, "settings": ppl.SimpleSettings()}, InvalidSettingError, "either settings"),
        ({"program": ppl.Model(), "prior": "relation_first"}, InvalidSettingError, "either a prog"),
    ],
)
def test_options_that_cannot_be_used_are_refused_before_anything_is_asked(
    options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        ready("simple", options)


@pytest.mark.slow
def test_it_explains_bundled_events_with_workers_as_without(tmp_path: Path) -> None:
    events = [ppl.load_event(name) for name in ppl.bundled_events()[:2]]
    short = {"chains": 2, "iterations": 1, "progress": False}
    one = ppl.evaluate(events, workers=1, **short)
    two = ppl.evaluate(events, workers=2, out=tmp_path, **short)
    assert not one.failures
    for name, given in one.predictions.items():
        for question, values in given.probabilities.items():
            assert values.tobytes() == two.predictions[name].probabilities[question].tobytes()
    assert len(list(tmp_path.glob("events/*/posterior.nc"))) == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rull": "paper"}, "kernel 'local_mh': 'rull'; did you mean 'rule'"),
        ({"kernel": "prior_mh", "rule": "paper"}, "kernel 'prior_mh': 'rule'"),
        ({"planer": "fast"}, "did you mean 'planner'"),
    ],
)
def test_options_that_nothing_takes_are_refused_at_once(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UnknownNameError, match=message):
        ready("simple", options)
