"""Which way agents turn is read off the observed angles."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from phase_ppl.dataset import load_events
from phase_ppl.dataset.motion import count_turns, full_turn, observed_turning
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from tests.world.examples import DEV, START, make_scene, needs_dev

SIZES = (0.8, 1.01, 1.2, 1.6)
RADII = np.array([0.8, 1.6, 1.0, 1.0])


def turned(red: Sequence[int], green: Sequence[int] = ()) -> NDArray[np.float64]:
    """Return the frames of agents that turn (+1), turn back (-1) or rest (0) in each step.

    Each substep updates the spin and then the angle; a step begins without spin; a frame is the
    mean of a step.
    """
    trajectory = np.tile(np.array(START), (max(len(red), len(green)) + 1, 1, 1))
    shares = np.cumsum(np.arange(1, 6)) / 15  # of the turn, after each substep
    for agent, ways in enumerate((red, green)):
        angle = trajectory[0, agent, 2]
        for step, way in enumerate(ways, start=1):
            turn = way * full_turn(RADII[agent])
            trajectory[step, agent, 2] = angle + turn * shares.mean()
            angle += turn
        trajectory[len(ways) + 1 :, agent, 2] = angle
    return trajectory


@pytest.mark.parametrize(("radius", "angle"), [(0.8, 1.06), (1.01, 0.66), (1.2, 0.47), (1.6, 0.26)])
def test_a_full_turn_is_what_the_torque_gives_in_one_step(radius: float, angle: float) -> None:
    assert full_turn(radius) == pytest.approx(angle, abs=0.005)


def test_every_step_of_a_turn_is_counted_once() -> None:
    assert count_turns(turned([1, 0]), RADII) == (1, 0)  # spread over two frames
    assert count_turns(turned([1, 1, 1, 0]), RADII) == (2, 0)  # its first and last are partial
    assert count_turns(turned([0, -1, 0, 0, -1, 0], [1, 1, 0]), RADII) == (1, 2)
    assert count_turns(turned([0, 0, 0]), RADII) == (0, 0)


def test_agents_that_turn_one_way_only_are_recognised() -> None:
    assert observed_turning(turned([1, 1, 0, 1, 0]), RADII) == "both"
    assert observed_turning(turned([1, 1, 1, 1, 0]), RADII) == "ccw"
    assert observed_turning(turned([-1, 0, -1, 0], [0, -1, -1]), RADII) == "cw"


def test_agents_that_turn_both_ways_are_recognised() -> None:
    assert observed_turning(turned([1] * 6, [-1] * 6), RADII) == "both"


def test_too_few_turns_leave_both_ways_open() -> None:
    assert observed_turning(turned([1, 1, 1, 0]), RADII) == "both"
    assert observed_turning(turned([0]), RADII) == "both"


def test_one_contrary_turn_does_not_outweigh_many() -> None:
    assert observed_turning(turned([1] * 9, [0, -1, 0]), RADII) == "ccw"


def test_being_pushed_round_is_no_turn() -> None:
    trajectory = turned([0] * 12)
    trajectory[:, 0, 2] -= 0.6 * full_turn(RADII[0]) * np.arange(13)
    assert count_turns(trajectory, RADII) == (0, 0)


ways = st.lists(st.sampled_from([-1, 0, 1]), min_size=1, max_size=30)


@settings(deadline=None)
@given(ways, ways)
def test_in_a_mirror_agents_turn_the_other_way(red: list[int], green: list[int]) -> None:
    trajectory = turned(red, green)
    mirrored = trajectory * [1, 1, -1]
    assert count_turns(mirrored, RADII) == count_turns(trajectory, RADII)[::-1]


@pytest.mark.parametrize("radius", SIZES)
def test_turns_of_the_physics_are_recognised(radius: float) -> None:
    scene = make_scene(radius=[radius, radius, 0.8, 0.8], walls=[])
    world = PymunkWorld(scene, (450.0, 450.0))
    frames = [scene.start]
    frames += [world.step((Action.TURN_LEFT, Action.NO_FORCE)) for _ in range(5)]
    assert observed_turning(np.array(frames), scene.radius) == "ccw"
    frames += [world.step((Action.NO_FORCE, Action.TURN_RIGHT)) for _ in range(5)]
    assert observed_turning(np.array(frames), scene.radius) == "both"


@needs_dev
def test_the_published_originals_turn_left_and_their_reflected_copies_right() -> None:
    mirrors = [record["mirror_of_original"] for record in json.loads(DEV.read_text())["videos"]]
    found = Counter(
        (mirror == "none", event.scene.turning)
        for mirror, event in zip(mirrors, load_events(DEV), strict=True)
    )
    assert found == {(True, "ccw"): 10, (True, "both"): 1, (False, "cw"): 37, (False, "both"): 2}
