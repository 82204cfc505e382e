"""Scenes, observations and events refuse what cannot be, and say which value it is."""

from __future__ import annotations

import dataclasses
import math
import pickle
import re

import numpy as np
import pytest

from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.event import Event, Observation, State, Truth
from phase_ppl.world.scene import LANDMARK_CENTRES, Scene
from tests.world.examples import (
    RADIUS,
    START,
    check_refused,
    make_event,
    make_scene,
    make_trajectory,
)


def with_value(array: object, where: tuple[int, ...], value: object) -> np.ndarray:
    changed = np.array(array, dtype=object)
    changed[where] = value
    return changed


BAD_SCENES = {
    "start_nan": ({"start": np.where(np.eye(4, 3), math.nan, START)}, "scene.start[0, 0] is nan"),
    "start_infinite": ({"start": np.array(START) * [1, math.inf, 1]}, "scene.start[0, 1] is inf"),
    "start_three_entities": ({"start": START[:3]}, "scene.start has shape (3, 3), expected (4, 3)"),
    "start_without_angle": ({"start": [row[:2] for row in START]},
     "scene.start has shape (4, 2), expected (4, 3)"),
    "start_ragged": ({"start": [*START[:3], [1.0]]}, "scene.start is ragged"),
    "start_text": ({"start": with_value(START, (1, 1), "x")}, "scene.start holds 'x'"),
    "start_text_in_list": ({"start": [*START[:3], [20.0, "x", 0.0]]}, "scene.start holds 'x'"),
    "start_numeral": ({"start": with_value(START, (1, 1), "8.0")}, "scene.start holds '8.0'"),
    "start_none": ({"start": with_value(START, (1, 1), None)}, "scene.start holds None"),
    "start_missing": ({"start": None}, "scene.start holds None"),
    "start_huge_integer": ({"start": with_value(START, (0, 0), 10**400)}, "scene.start holds 1000"),
    "start_outside": ({"start": [*START[:2], [12.0, 1.0, 0.0], START[3]]},
     "the blue item is at (12, 1) in frame 0, outside the arena x 6..26, y 2..22"),
    "radius_zero": ({"radius": [0, 1, 1, 1]}, "scene.radius [0.0, 1.0, 1.0, 1.0]"),
    "radius_large": ({"radius": [1, 1, 1, 6]}, "sizes must lie in [0.01, 5]"),
    "radius_count": ({"radius": RADIUS[:3]}, "scene.radius has shape (3,)"),
    "wall_slanted": ({"walls": [[[16, 12], [20, 16]]]}, "does not run from the arena's centre"),
    "wall_shape": ({"walls": [[16, 12], [16, 22]]}, "scene.walls has shape (2, 2)"),
    "wall_nan": ({"walls": [[[16, 12], [16, math.nan]]]}, "scene.walls[0, 1, 1] is nan"),
    "arena_oblong": ({"arena": (0, 20, 0, 10)}, "is not a square"),
    "arena_empty": ({"arena": (26, 6, 22, 2)}, "is not a square"),
    "arena_short": ({"arena": (6, 26)}, "scene.arena has shape (2,)"),
    "landmarks_permuted": ({"landmark_centres": LANDMARK_CENTRES[::-1]},
     "expected blue lm, green lm, red lm, yellow lm top left, top right"),
    "landmarks_three": ({"landmark_centres": LANDMARK_CENTRES[:3]}, "has shape (3, 2)"),
    "half_width_negative": ({"landmark_half_width": -1.0}, "scene.landmark_half_width is -1"),
    "half_width_nan": ({"landmark_half_width": math.nan}, "scene.landmark_half_width"),
    "half_width_text": ({"landmark_half_width": "wide"}, "holds 'wide'"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_SCENES)
def test_an_impossible_scene_is_refused_with_the_value(case: str) -> None:
    changes, message = BAD_SCENES[case]
    check_refused(lambda: make_scene(**changes), message, InvalidEventError)


def test_an_unknown_turning_gets_the_allowed_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown turning 'left'; .*'both', 'ccw', 'cw'"):
        make_scene(turning="left")


def test_a_scene_is_the_original_world_unless_told_otherwise() -> None:
    scene = Scene(start=START, radius=RADIUS)  # type: ignore[arg-type]
    assert scene.arena == (6.0, 26.0, 2.0, 22.0)
    assert scene.centre.tolist() == [16.0, 12.0]
    assert scene.walls.shape == (0, 2, 2)
    assert scene.rooms.is_open
    assert scene.turning == "both"
    assert scene.landmark_centres.tolist() == [[8.5, 19.5], [23.5, 19.5], [23.5, 4.5], [8.5, 4.5]]


def test_the_border_runs_around_the_arena() -> None:
    border = make_scene().border
    lengths = np.linalg.norm(border[:, 1] - border[:, 0], axis=1)
    assert lengths.tolist() == [20.0] * 4
    assert np.array_equal(border[:, 1], np.roll(border[:, 0], -1, axis=0))


def test_a_scene_cannot_be_changed_by_accident() -> None:
    start = np.array(START)
    scene = make_scene(start=start)
    start[0, 0] = 25.0
    assert scene.start[0, 0] == START[0][0]
    with pytest.raises(ValueError, match="read-only"):
        scene.start[0, 0] = 25.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.turning = "cw"  # type: ignore[misc]


def test_an_event_can_be_sent_to_another_process() -> None:
    event = make_event()
    route = event.scene.rooms.route(0, 2)
    copy = pickle.loads(pickle.dumps(event))
    assert copy.scene.rooms.route(0, 2) == route
    assert np.array_equal(copy.observation.trajectory, event.observation.trajectory)
    assert np.array_equal(copy.scene.walls, event.scene.walls)
    assert (copy.id, copy.truth, copy.judgments) == (event.id, event.truth, event.judgments)


def test_at_the_start_everything_rests_and_nothing_is_held() -> None:
    scene = make_scene()
    state = State.at_start(scene)
    assert np.array_equal(state.pose, scene.start)
    assert not state.velocity.any()
    assert not state.spin.any()
    assert state.held.tolist() == [-1, -1]


@pytest.mark.parametrize(
    ("trajectory", "message"),
    [
        (make_trajectory(1), "trajectory has 1 frame(s), expected at least 2"),
        ([], "trajectory has 0 frame(s)"),
        (make_trajectory()[0], "trajectory has shape (4, 3)"),
        (
            np.where(np.arange(4)[:, None, None] == 2, math.nan, make_trajectory()),
            "[2, 0, 0] is nan",
        ),
    ],
)
def test_an_observation_needs_two_finite_frames(trajectory: object, message: str) -> None:
    with pytest.raises(InvalidEventError, match=re.escape(message)):
        Observation(trajectory)  # type: ignore[arg-type]


def test_an_event_needs_a_trajectory_of_all_of_its_world() -> None:
    with pytest.raises(InvalidEventError, match="has 3 entities, expected the 4 of PHASE"):
        Event(make_scene(), Observation(make_trajectory()[:, :3]))


def test_an_observation_knows_positions_and_angles() -> None:
    observation = Observation(make_trajectory(5))
    assert observation.n_frames == 5
    assert observation.positions.shape == (5, 4, 2)
    assert observation.angles[1, 0] == pytest.approx(0.3)


def test_a_trajectory_that_leaves_the_arena_is_refused_with_entity_and_frame() -> None:
    trajectory = make_trajectory()
    trajectory[3, 1, 0] = 26.5
    message = r"trajectory: the green agent is at \(26.5, .*\) in frame 3, outside the arena"
    with pytest.raises(InvalidEventError, match=message):
        Event(make_scene(), Observation(trajectory))


def test_a_body_pressed_into_the_border_is_still_inside() -> None:
    trajectory = make_trajectory()
    trajectory[3, 1, 0] = 26.2
    assert Event(make_scene(), Observation(trajectory)).observation.n_frames == 4


def test_truth_derives_scenario_and_relation_from_the_goals() -> None:
    truth = Truth("get blue item to red lm", "Get blue item to green lm")
    assert truth.goal_red == "Get blue item to red lm"
    assert (truth.scenario, truth.relation) == ("competing", "adversarial")


@pytest.mark.parametrize(
    ("field", "value", "error"),
    [
        ("goal_green", "Get blue item to red", UnknownNameError),
        ("relation", "friend", UnknownNameError),
        ("scenario", "racing", UnknownNameError),
        ("strength_red", -1.0, InvalidSettingError),
        ("strength_green", math.nan, InvalidSettingError),
    ],
)
def test_truth_refuses_unknown_words_and_impossible_forces(
    field: str, value: object, error: type[Exception]
) -> None:
    fields = {"goal_red": "get to green agent", "goal_green": "get away from red agent"}
    with pytest.raises(error, match=re.escape(repr(value))):
        Truth(**{**fields, field: value})  # type: ignore[arg-type]
