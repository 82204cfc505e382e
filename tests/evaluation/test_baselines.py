"""The baselines: the last frame, on scenes worked out by hand, and the one that does not look."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.models.baselines import goal_shares, last_frame
from phase_ppl.evaluation.registry import ready
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Observation
from phase_ppl.world.goals import GOALS, is_self_referring
from phase_ppl.world.scene import LANDMARK_CENTRES
from tests.evaluation.toys import START, right, several, still
from tests.world.examples import DEV, needs_dev

BLUE, GREEN, RED, YELLOW = LANDMARK_CENTRES


def answer(**ends: object) -> tuple[str, str, str]:
    """Return what it says where entities (by number, as ``_2=(x, y)``) end somewhere else."""
    end = START.copy()
    for name, place in ends.items():
        end[int(name[1:]), :2] = place
    scene = still().scene
    found = last_frame()(scene, Observation(np.stack([START, START, end])), 0)
    return found.answers["goal_red"], found.answers["goal_green"], found.answers["relation"]


def test_an_item_that_moved_to_a_landmark_is_what_both_want() -> None:
    goals = answer(_2=RED)
    assert goals == ("Get blue item to red lm", "Get blue item to red lm", "friendly")


def test_an_agent_nearer_to_a_landmark_than_any_moved_item_wants_to_be_there() -> None:
    goals = answer(_0=YELLOW + 0.1, _2=RED + 0.5)
    assert goals == ("Get red agent to yellow lm", "Get blue item to red lm", "neutral")


def test_an_item_that_lay_at_a_landmark_all_along_is_nobodys_goal() -> None:
    scene = still().scene
    start = START.copy()
    start[3, :2] = GREEN
    resting = ppl.Scene(start, scene.radius)
    found = last_frame()(resting, Observation(np.stack([start, start])), 0)
    assert found.answers["goal_red"].startswith("Get red agent to")


def test_an_item_that_was_only_nudged_did_not_move() -> None:
    start, scene = START.copy(), still().scene
    start[3, :2] = GREEN
    for nudge, moved in ((0.79, False), (0.81, True)):
        end = start.copy()
        end[3, 0] += nudge  # the radius is 0.8
        found = last_frame()(ppl.Scene(start, scene.radius), Observation(np.stack([start, end])), 0)
        assert (found.answers["goal_red"] == "Get pink item to green lm") is moved


def test_ties_go_to_the_own_body_and_to_the_first_landmark() -> None:
    middle = (BLUE + GREEN) / 2
    goals = answer(_0=middle, _1=middle, _3=middle)
    assert goals[:2] == ("Get red agent to blue lm", "Get green agent to blue lm")
    assert not last_frame()(still().scene, still().observation, 0).probabilities


@needs_dev
def test_it_finds_61_percent_of_the_goals_of_the_real_videos() -> None:
    found = ppl.evaluate(DEV, "last_frame", progress=False).metrics
    assert found["goal_accuracy"]["value"] == pytest.approx(0.61)
    assert found["reference_models"]["simple_authors"]["goal_accuracy"]["value"] == 0.88


# --- majority -----------------------------------------------------------------------------------


def test_the_majority_is_the_same_of_every_event() -> None:
    found = ppl.evaluate(several(3), "majority", progress=False)
    for given in found.predictions.values():
        assert given.answers["relation"] == "friendly"
        assert given.answers["goal_red"] == given.answers["goal_green"] == GOALS[0]
        assert given.probabilities["relation"] == pytest.approx([0.4, 0.216, 0.384])
        assert given.ties("goal_red") == 8


@pytest.mark.parametrize("agent", [0, 1])
def test_goals_are_as_frequent_as_their_types_in_the_original_events(agent: int) -> None:
    shares = dict(zip(GOALS, goal_shares(agent), strict=True))
    assert sum(shares.values()) == pytest.approx(1)
    to_landmark = [goal for goal in GOALS if goal.startswith("Get blue item to")]
    assert [shares[goal] for goal in to_landmark] == pytest.approx([0.584 / 8] * 4)
    other = "green agent" if agent == 0 else "red agent"
    assert shares[f"get to {other}"] == pytest.approx(0.063)
    assert not np.any([shares[g] for i, g in enumerate(GOALS) if is_self_referring(i, agent)])


# --- models by name -------------------------------------------------------------------------------


def make(answer: str = "friendly") -> Any:
    """Say one thing."""
    return lambda scene, observation, seed: {"relation": answer}


@pytest.mark.usefixtures("own_models")
def test_a_registered_model_is_made_with_its_options_and_asked_by_name() -> None:
    ppl.register_model("one_thing")(make)
    found = ppl.evaluate(still(), "one_thing", workers=1, answer="adversarial")
    assert found.predictions["still"].answers == {"relation": "adversarial"}
    assert found.settings["model"] == "one_thing"
    assert found.settings["options"] == {"answer": "adversarial"}


def test_an_option_that_a_model_does_not_have_is_refused() -> None:
    with pytest.raises(InvalidSettingError, match=r"'last_frame'.*planner"):
        ready("last_frame", {"planner": "fast"})


@pytest.mark.usefixtures("own_models")
def test_what_a_model_needs_is_said_with_the_extra_that_brings_it() -> None:
    needs = ("numpy", "no_such_module", "no_such_package.module")
    ppl.register_model("heavy", needs=needs, extra="neural")(make)
    with pytest.raises(
        InvalidSettingError, match=r"needs no_such_module, no_such_package.*phase_ppl\[neural\]"
    ):
        ready("heavy", {})


def two(scene: Any, observation: Any) -> Any:
    """Lack the seed."""


@pytest.mark.parametrize(
    ("model", "options", "message"),
    [
        (3, {}, "neither a name"),
        (two, {}, "cannot be called as"),
        (right, {"chains": 3}, "chains: options are for models given by name"),
    ],
)
def test_what_is_no_model_is_refused(model: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSettingError, match=message):
        ready(model, options)
