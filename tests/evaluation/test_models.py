"""Models by name: the baselines, on scenes worked out by hand, and predicate inverse planning."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.models.baselines import goal_shares, last_frame
from phase_ppl.evaluation.prediction import QUESTIONS
from phase_ppl.evaluation.registry import ready
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Observation
from phase_ppl.world.goals import GOALS, N_GOALS, is_self_referring
from phase_ppl.world.scene import LANDMARK_CENTRES
from tests.evaluation.toys import START, several, still
from tests.world.examples import DEV, needs_dev

BLUE, GREEN, RED, YELLOW = LANDMARK_CENTRES


def answer(start: Any = START, **ends: object) -> tuple[str, str, str]:
    """Return what it says where entities (by number, as ``_2=(x, y)``) end somewhere else."""
    end = start.copy()
    for name, place in ends.items():
        end[int(name[1:]), :2] = place
    scene = ppl.Scene(start, still().scene.radius)
    found = last_frame()(scene, Observation(np.stack([start, start, end])), 0)
    return found.answers["goal_red"], found.answers["goal_green"], found.answers["relation"]


def test_an_item_that_moved_to_a_landmark_is_what_both_want() -> None:
    goal = "Get blue item to red lm"
    assert answer(_2=RED) == (goal, goal, "friendly")


def test_an_agent_nearer_to_a_landmark_than_any_moved_item_wants_to_be_there() -> None:
    goals = answer(_0=YELLOW + 0.1, _2=RED + 0.5)
    assert goals == ("Get red agent to yellow lm", "Get blue item to red lm", "neutral")


def test_an_item_that_was_only_nudged_or_lay_at_a_landmark_all_along_is_nobodys_goal() -> None:
    start = START.copy()
    start[3, :2] = GREEN
    for nudge, moved in ((0.0, False), (0.79, False), (0.81, True)):  # the radius is 0.8
        red, *_ = answer(start, _3=GREEN + np.array([nudge, 0]))
        assert red.startswith("Get pink item to green lm" if moved else "Get red agent to")


@needs_dev
def test_it_finds_61_percent_of_the_goals_of_the_real_videos() -> None:
    found = ppl.evaluate(DEV, "last_frame", progress=False).metrics
    assert found["goal_accuracy"]["value"] == pytest.approx(0.61)
    assert found["reference_models"]["simple_authors"]["goal_accuracy"]["value"] == 0.88


def test_the_majority_is_the_same_of_every_event() -> None:
    found = ppl.evaluate(several(3), "majority", progress=False)
    for given in found.predictions.values():
        assert given.answers["relation"] == "friendly"
        assert given.answers["goal_red"] == given.answers["goal_green"] == GOALS[0]
        assert given.probabilities["relation"] == pytest.approx([0.4, 0.216, 0.384])
        shares = given.probabilities["goal_red"]
        assert np.isclose(shares, shares.max()).sum() == 8


def test_goals_are_as_frequent_as_their_types_in_the_original_events() -> None:
    for agent, other in enumerate(("green agent", "red agent")):
        shares = dict(zip(GOALS, goal_shares(agent), strict=True))
        assert sum(shares.values()) == pytest.approx(1)
        to_landmark = [goal for goal in GOALS if goal.startswith("Get blue item to")]
        assert [shares[goal] for goal in to_landmark] == pytest.approx([0.584 / 8] * 4)
        assert shares[f"get to {other}"] == pytest.approx(0.063)
        assert not np.any([shares[g] for i, g in enumerate(GOALS) if is_self_referring(i, agent)])


def test_predicates_tell_goals_and_relation_of_a_bundled_event() -> None:
    event = ppl.load_event("collaborate")
    given = ppl.evaluate(event, "predicate", workers=1).predictions[event.id]
    assert given.answers == {name: getattr(event.truth, name) for name in QUESTIONS}
    assert set(given.probabilities) == set(given.answers)
    possible = np.array([not is_self_referring(goal, 0) for goal in range(N_GOALS)])
    assert np.array_equal(given.probabilities["goal_red"] > 0, possible)


def make(answer: str = "friendly") -> Any:
    """Say one thing."""
    return lambda scene, observation, seed: {"relation": answer}


@pytest.mark.usefixtures("own_models")
def test_what_a_model_needs_is_said_with_the_extra_that_brings_it() -> None:
    needs = ("numpy", "no_such_module", "no_such_package.module")
    ppl.register_model("heavy", needs=needs, extra="neural")(make)
    with pytest.raises(
        InvalidSettingError, match=r"needs no_such_module, no_such_package.*phase_ppl\[neural\]"
    ):
        ready("heavy", {})


def test_what_is_no_model_and_no_option_is_refused() -> None:
    cases: tuple[tuple[Any, dict[str, Any], str], ...] = (
        (3, {}, "neither a name"),
        ("last_frame", {"planner": "fast"}, r"'last_frame'.*planner"),
        ("predicate", {"planner": "fast"}, "planner is no.*rationality"),
        ("predicate", {"on_item": -1}, "on_item=-1"),
    )
    for model, options, message in cases:
        with pytest.raises(InvalidSettingError, match=message):
            ready(model, options)
