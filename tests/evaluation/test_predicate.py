"""Predicate inverse planning as a model of social perception."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.prediction import QUESTIONS
from phase_ppl.evaluation.registry import ready
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.goals import N_GOALS, is_self_referring
from phase_ppl.world.hypothesis import RELATIONS
from tests.evaluation.toys import still
from tests.world.examples import DEV, needs_dev


def test_it_finds_goals_and_relation_of_a_bundled_event() -> None:
    event = ppl.load_event("collaborate")
    assert event.truth is not None
    given = ppl.evaluate(event, "predicate", workers=1).predictions[event.id]
    assert given.answers == {
        "goal_red": event.truth.goal_red,
        "goal_green": event.truth.goal_green,
        "relation": event.truth.relation,
    }
    assert set(given.probabilities) == set(given.answers)
    possible = np.array([not is_self_referring(goal, 0) for goal in range(N_GOALS)])
    assert np.array_equal(given.probabilities["goal_red"] > 0, possible)


def test_its_options_are_thresholds_and_rationality_and_are_kept() -> None:
    made = ready("predicate", {"on_item": 2.0, "rationality": 0.4, "prior": "independent"})
    kept = made.record["model_settings"]
    assert (kept["on_item"], kept["rationality"], kept["prior"]) == (2.0, 0.4, "independent")


@pytest.mark.parametrize("n_frames", [2, 3])
def test_a_video_in_which_next_to_nothing_happens_has_an_answer(n_frames: int) -> None:
    event = still(n_frames=n_frames)
    given = ppl.evaluate(event, "predicate", workers=1, prior="independent").predictions[event.id]
    for question, labels in QUESTIONS.items():
        assert given.probabilities[question].shape == (len(labels),)
    assert given.probabilities["relation"].argmax() == RELATIONS.index("neutral")


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"planner": "fast"}, InvalidSettingError, r"planner is no option.*rationality"),
        ({"on_item": -1}, InvalidSettingError, "on_item=-1"),
        ({"prior": "unifrom"}, UnknownNameError, "'uniform'"),
        ({"prior": ["uniform"]}, UnknownNameError, "'uniform'"),
    ],
)
def test_wrong_options_are_refused(
    options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        ready("predicate", options)


@needs_dev
def test_it_finds_most_goals_of_some_real_videos() -> None:
    found = ppl.evaluate(DEV, "predicate", limit=12, workers=1, progress=False).metrics
    assert found["goal_accuracy"]["value"] > 0.6
    assert found["relation_accuracy"]["value"] > 0.5
