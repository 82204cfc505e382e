"""Predictions that events carry, as an evaluation."""

from __future__ import annotations

import dataclasses

import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.evaluation import carried_evaluation
from phase_ppl.world.errors import UnknownNameError
from tests.evaluation.toys import GREEN_TO_RED, RED_TO_RED, right, several
from tests.world.examples import DEV, needs_dev

RIVAL = {"goals": {"red agent": RED_TO_RED, "green agent": GREEN_TO_RED}, "relation": "friendly"}
EVENTS = [
    dataclasses.replace(event, predictions={"rival": RIVAL} if event.id != "b" else None)
    for event in several(3)
]


def test_it_is_scored_as_any_other_evaluation() -> None:
    found = carried_evaluation(EVENTS, "rival")
    assert found.name == "rival"
    assert found.metrics["goal_accuracy"]["value"] == 1
    assert found.metrics["relation_accuracy"]["value"] == 0
    assert list(found.predictions) == ["a", "c"]
    assert found.failures == {"b": "the event carries no prediction of rival"}
    assert "rival: 2 of 3 events" in str(found)


def test_it_is_compared_with_a_model_that_was_run() -> None:
    ran = ppl.evaluate(EVENTS, right, workers=1, progress=False)
    carried = carried_evaluation(EVENTS, "rival")
    assert ran.against(carried)["relation_accuracy"]["value"] == 1
    assert carried.against(ran)["n_events"] == 2


def test_a_model_that_nothing_is_carried_of_gets_close_names() -> None:
    with pytest.raises(UnknownNameError, match="'rival'"):
        carried_evaluation(EVENTS, "rivals")


@needs_dev
def test_its_figures_are_those_beside_which_models_are_shown() -> None:
    events = ppl.load_events(DEV)
    found = carried_evaluation(events, "simple_authors").metrics
    beside = found["reference_models"]["simple_authors"]
    for name in ("goal_accuracy", "relation_accuracy", "by_scenario"):
        assert found[name] == beside[name]
