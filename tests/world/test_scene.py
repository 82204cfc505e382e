"""Scenes, observations and events refuse what cannot be, and say which value it is."""

from __future__ import annotations

import dataclasses
import functools
import math
import re

import numpy as np
import pytest

from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.scene import LANDMARK_CENTRES
from tests.world.examples import START, check_refused, make_scene, make_trajectory

BAD_SCENES: list[tuple[str, dict[str, object]]] = [
    ("scene.start[0, 0] is nan", {"start": np.where(np.eye(4, 3), math.nan, START)}),
    ("scene.start has shape (3, 3), expected (4, 3)", {"start": START[:3]}),
    ("scene.start holds 'x'", {"start": [*START[:3], [20.0, "x", 0.0]]}),
    ("the blue item is at (12, 1) in frame 0, outside the arena x 6..26, y 2..22",
     {"start": [*START[:2], [12.0, 1.0, 0.0], START[3]]}),
    ("scene.radius [0.0, 1.0, 1.0, 1.0]", {"radius": [0, 1, 1, 1]}),
    ("does not run from the arena's centre", {"walls": [[[16, 12], [20, 16]]]}),
    ("is not a square", {"arena": (0, 20, 0, 10)}),
    ("expected blue lm, green lm, red lm, yellow lm top left, top right",
     {"landmark_centres": LANDMARK_CENTRES[::-1]}),
    ("scene.landmark_half_width", {"landmark_half_width": math.nan}),
]  # fmt: skip


def test_an_impossible_scene_is_refused_with_the_value() -> None:
    for message, changes in BAD_SCENES:
        check_refused(functools.partial(make_scene, **changes), message, InvalidEventError)
    message = "unknown turning 'left'; allowed: 'both', 'ccw', 'cw'"
    check_refused(lambda: make_scene(turning="left"), message, UnknownNameError)


def test_a_scene_cannot_be_changed_by_accident() -> None:
    start = np.array(START)
    scene = make_scene(start=start)
    start[0, 0] = 25.0
    assert scene.start[0, 0] == START[0][0]
    with pytest.raises(ValueError, match="read-only"):
        scene.start[0, 0] = 25.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.turning = "cw"  # type: ignore[misc]


def test_an_observation_needs_two_finite_frames_of_all_inside_the_arena() -> None:
    observation = Observation(make_trajectory(5))
    assert observation.n_frames == 5
    assert observation.positions.shape == (5, 4, 2)
    assert observation.angles[1, 0] == pytest.approx(0.3)
    hole = make_trajectory().copy()
    hole[2, 0, 0] = math.nan
    for trajectory, message in (
        (make_trajectory(1), "trajectory has 1 frame(s), expected at least 2"),
        ([], "trajectory has 0 frame(s)"),
        (make_trajectory()[0], "trajectory has shape (4, 3)"),
        (hole, "trajectory[2, 0] is [nan, "),
        (make_trajectory()[:, :3], "has 3 entities, expected the 4 of PHASE"),
    ):
        with pytest.raises(InvalidEventError, match=re.escape(message)):
            Event(make_scene(), Observation(trajectory))  # type: ignore[arg-type]
    pressed = make_trajectory()
    pressed[3, 1, 0] = 26.2  # into the border
    assert Event(make_scene(), Observation(pressed)).observation.n_frames == 4
    pressed[3, 1, 0] = 26.5
    message = r"trajectory: the green agent is at \(26.5, .*\) in frame 3, outside the arena"
    with pytest.raises(InvalidEventError, match=message):
        Event(make_scene(), Observation(pressed))


def test_truth_derives_scenario_and_relation_and_refuses_unknown_words_and_forces() -> None:
    truth = Truth("get blue item to red lm", "Get blue item to green lm")
    assert truth.goal_red == "Get blue item to red lm"
    assert (truth.scenario, truth.relation) == ("competing", "adversarial")
    fields = {"goal_red": "get to green agent", "goal_green": "get away from red agent"}
    wrong: tuple[tuple[str, object, type[Exception]], ...] = (
        ("goal_green", "Get blue item to red", UnknownNameError),
        ("relation", "friend", UnknownNameError),
        ("scenario", "racing", UnknownNameError),
        ("strength_red", -1.0, InvalidSettingError),
        ("strength_green", math.nan, InvalidSettingError),
    )
    for field, value, error in wrong:
        with pytest.raises(error, match=re.escape(repr(value))):
            Truth(**{**fields, field: value})  # type: ignore[arg-type]
