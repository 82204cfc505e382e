"""Predictions that the events carry, and the published figures that follow from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.metrics import human_accuracy, metrics_of
from phase_ppl.evaluation.prediction import Prediction, reference_predictions
from phase_ppl.world.errors import PhasePPLError
from tests.evaluation.judged import BLUE_TO_RED, PINK_TO_BLUE, make_event, values
from tests.world.examples import DEV, needs_dev

SIMPLE = {
    "goals": {"red agent": BLUE_TO_RED, "green agent": PINK_TO_BLUE},
    "relation": "adversarial",
    "relation_probs": {"friendly": 0.592055, "neutral": 0.0, "adversarial": 0.407944},
}


def test_what_a_file_gives_is_read_and_nothing_added() -> None:
    some = {"goal_probs": {"green agent": {BLUE_TO_RED: 0.75, PINK_TO_BLUE: 0.25}}, "goals": None}
    events = [
        make_event("a", predictions={"simple": SIMPLE, "gnn": {"relation": "neutral"}}),
        make_event("b", predictions={"gnn": {"relation": "friendly"}, "simple": None}),
        make_event("c", predictions={"green": some}),
    ]
    found = reference_predictions(events)
    ids = {model: list(made) for model, made in found.items()}
    assert ids == {"simple": ["a"], "gnn": ["a", "b"], "green": ["c"]}
    simple = found["simple"]["a"]
    # the answer given stays, even where another is more probable
    given = (BLUE_TO_RED, PINK_TO_BLUE, "adversarial")
    assert simple.answers == dict(zip(("goal_red", "goal_green", "relation"), given, strict=True))
    assert list(simple.probabilities) == ["relation"]
    assert simple.probabilities["relation"].sum() == pytest.approx(1, abs=1e-15)
    assert found["gnn"]["a"].answers == {"relation": "neutral"}
    assert found["gnn"]["a"].scenario is None
    assert found["green"]["c"].answers == {"goal_green": BLUE_TO_RED}


def test_predictions_of_the_package_are_read_back_with_their_errors(tmp_path: Path) -> None:
    given, errors = {"relation": [0.5, 0.25, 0.25]}, [0.1, float("nan"), 0.0]
    made = Prediction("a", given, {"goal_red": BLUE_TO_RED}, errors={"relation": errors})
    ppl.save_event(make_event("a", predictions={"mine": made.to_dict()}), tmp_path / "a.json")
    answers = {"answers": {"relation": "neutral"}}
    events = [ppl.load_event(tmp_path / "a.json"), make_event("b", predictions={"mine": answers})]
    found = reference_predictions(events)["mine"]
    np.testing.assert_equal(found["a"].to_dict(), made.to_dict())
    np.testing.assert_array_equal(found["a"].errors["relation"], errors)
    assert found["b"].answers == {"relation": "neutral"}
    assert str(made.estimate("relation", "friendly")) == "0.50 ± 0.10"
    unknown = Prediction("a", given)
    assert "errors" not in unknown.to_dict()
    for one, label in ((made, "neutral"), (unknown, "friendly")):
        assert np.isnan(one.estimate("relation", label).error)


def test_bad_predictions_are_refused_with_event_and_model_and_so_are_bad_errors() -> None:
    cases: tuple[tuple[Any, str], ...] = (
        (3, "it is 3, expected an object"),
        ({"relations": "friendly"}, "unknown field 'relations'; did you mean 'relation'"),
        ({"goals": {"red": BLUE_TO_RED}}, "unknown agent in goals 'red'; did you mean 'red agent'"),
        ({"goals": {"red agent": "win"}}, "unknown goal 'win'"),
        ({"relation_probs": {"friendly": 0.4}}, "relation has probabilities of sum 0.4"),
        ({"relation_probs": {"friendly": "1"}}, "'friendly' has '1', expected a number"),
        ({"event": "z", "answers": {}}, "names the event 'z', expected 'film 7'"),
        ({"probabilities": [0.1, 0.2, 0.7]}, "probabilities of a prediction is .*an object"),
    )
    for record, message in cases:
        event = make_event("film 7", predictions={"m": record})
        with pytest.raises(PhasePPLError, match=f"event film 7: predictions: m: .*{message}"):
            reference_predictions([event])
    for errors, message in (
        ({"goal_red": [0.1] * 36}, "goal_red has errors, but no probabilities"),
        ({"relation": [0.1, 0.1]}, "relation has errors .*, expected 3 numbers >= 0 or NaN"),
        ({"relation": [0.1, -0.1, 0.1]}, "expected 3 numbers >= 0"),
        ({"relations": [0.1, 0.1, 0.1]}, "unknown question 'relations'"),
    ):
        with pytest.raises(PhasePPLError, match=message):
            Prediction("a", {"relation": [0.5, 0.25, 0.25]}, errors=errors)


@needs_dev
def test_published_figures_of_the_authors_models() -> None:
    events = ppl.load_events(DEV)
    found = metrics_of(events, reference_predictions(events))
    simple = found["simple_authors"]
    assert simple["n_events"] == 50
    assert values(simple, "goal_accuracy", "relation_accuracy") == pytest.approx([0.88, 0.9])
    by_scenario = [(of["n"], *values(of, "goal_accuracy")) for of in simple["by_scenario"].values()]
    assert [n for n, _ in by_scenario] == [19, 14, 5, 12]
    goals = [value for _, value in by_scenario]
    assert goals == pytest.approx([0.974, 0.929, 0.6, 0.792], abs=5e-4)
    human = simple["human"]
    assert human["relation_r"]["value"] == pytest.approx(0.645, abs=5e-4)
    assert human["split_half_r"]["value"] == pytest.approx(0.90, abs=0.01)
    assert human["goal_r"] is simple["goal_top3_accuracy"] is None
    of_gnn = found["socialgnn_2023"]
    assert values(of_gnn, "relation_accuracy", "human.relation_r") == [pytest.approx(0.68), None]
    # what people agree on least bounds how well they are predicted
    assert human["log_score"]["value"] < human["log_score_people"]["value"]


@needs_dev
def test_people_see_the_relations_of_the_authors_videos() -> None:
    found = human_accuracy(ppl.load_events(DEV))
    assert found["n_events"] == 50
    assert found["goal_accuracy"] is None
    assert 0.7 < found["relation_accuracy"]["value"] < 0.9
    assert found["majority"]["relation_accuracy"]["value"] > found["relation_accuracy"]["value"]
    assert found["by_participant"] is None
