"""From tracks to predicates."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.symbols import Facts, describe
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.models.predicate import FACTOR, Thresholds, symbolic_trajectory
from phase_ppl.physics import compiled
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Observation, State
from phase_ppl.world.geometry import GRAB_REACH
from phase_ppl.world.names import NOTHING
from phase_ppl.world.scene import LANDMARK_CENTRES
from tests.agents.scenes import FULL_WALL_UP, scene


def states(poses: Any, **changes: Any) -> Any:
    trajectory = np.asarray(poses, float)
    where = scene(red=tuple(trajectory[0, 0]), walls=changes.pop("walls", []))
    return symbolic_trajectory(where, Observation(trajectory), Thresholds(**changes))


def still(n: int = 8) -> np.ndarray:
    return np.repeat(scene().start[None], n, axis=0)


def test_close_is_being_in_a_landmarks_room_also_without_walls() -> None:
    assert states(still())[0].rooms == (0, 1, 2, 3)


def test_an_entity_is_on_a_landmark_within_the_threshold() -> None:
    poses = still()
    poses[:, 0, :2] = LANDMARK_CENTRES[0] + [1.0, 0.0]
    assert states(poses, on_agent=1.1)[0].on[0] == 0
    assert states(poses, on_agent=0.9)[0].on[0] == NOTHING


def test_bodies_on_two_sides_of_a_wall_do_not_touch() -> None:
    poses = still()
    poses[:, 0], poses[:, 1] = (15.0, 20.0, 0.0), (17.0, 20.0, 0.0)
    for walls in ([], [FULL_WALL_UP]):
        assert not states(poses, walls=walls)[0].near[0][1]
    poses[:, 1] = (13.0, 20.0, 0.0)
    first = states(poses)[0]
    assert first.near[0][1]
    assert first.near[1][0]


def test_an_item_that_stays_in_front_of_its_holder_is_attached() -> None:
    poses = still(10)
    poses[:, 0, 0] += 0.4 * np.arange(10)
    poses[:, 0, 2] = -math.pi / 2
    poses[:, 2, :2] = poses[:, 0, :2] + [1.6, 0.0]
    assert {state.held for state in states(poses)} == {(2, NOTHING)}
    poses[:, 2, 0] += 0.3
    assert {state.held for state in states(poses)} == {(NOTHING, NOTHING)}


def test_what_does_not_last_does_not_count() -> None:
    poses = still(9)
    poses[4:6, 0, :2] = LANDMARK_CENTRES[0]
    assert sum(state.on[0] == 0 for state in states(poses, on_agent=0.5, lasting=2)) == 2
    assert not any(state.on[0] == 0 for state in states(poses, on_agent=0.5, lasting=3))


def test_items_are_in_reach_and_rooms_are_as_for_the_planner() -> None:
    rng = np.random.default_rng(0)
    n = 40
    poses = np.repeat(scene(walls=[FULL_WALL_UP]).start[None], n, axis=0)
    poses[:, :, :2] = rng.uniform([7, 13], [11, 17], (n, 4, 2))  # all in one room
    poses[:, :2, 2] = rng.uniform(-3, 3, (n, 2))
    where = scene(walls=[FULL_WALL_UP])
    model = WorldModel.of(where, (450.0, 450.0), PlannerConfig())
    facts, costs = np.zeros((n, Facts(4, 2).size), np.int8), np.zeros((1, n))
    held = np.full((n, 2), NOTHING)
    bodies = np.array(
        [
            compiled.from_state(
                State(pose, np.zeros((4, 2)), np.zeros(4), held[0], np.zeros((2, 3))), where.radius
            )[0]
            for pose in poses
        ]
    )
    goal, done = np.array([[0, 0, 0, 1]]), np.zeros((1, n), np.bool_)
    describe(bodies, held, 0, goal, model.params, model.layout, facts, done, costs)
    found = symbolic_trajectory(
        where, Observation(poses), Thresholds(touch_item=GRAB_REACH, lasting=1)
    )
    near = [[*state.near[0][2:], *state.near[1][2:]] for state in found]
    assert np.array_equal(near, facts[:, 6:10])
    assert 10 < np.sum(near) < 150
    assert np.array_equal([state.rooms for state in found], facts[:, :4])


def test_the_defaults_are_wider_than_the_planners_only_where_they_say_so() -> None:
    assert Thresholds().touch_item == pytest.approx(FACTOR * GRAB_REACH)
    assert Thresholds().touch_agent == pytest.approx(0.1 * 20 * math.sqrt(2))


@pytest.mark.parametrize(
    ("name", "value"),
    [("on_agent", 0), ("on_item", -1.0), ("attach", math.nan), ("touch_item", "1"), ("lasting", 0),
     ("lasting", 1.5), ("touch_agent", True)],
)  # fmt: skip
def test_thresholds_are_positive(name: str, value: Any) -> None:
    with pytest.raises(InvalidSettingError, match=f"{name}="):
        Thresholds(**{name: value})
