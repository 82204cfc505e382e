"""Angles that were wrapped before they were averaged are put right."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.dataset import load_events
from phase_ppl.dataset.authors.videos import repaired
from phase_ppl.dataset.motion import full_turn
from phase_ppl.world.arrays import FloatArray
from tests.dataset.authors.pickles import wrapped
from tests.world.examples import DEV, needs_dev

SIZES = (0.8, 1.01, 1.2, 1.6)
TURN = 2 * np.pi


def spoiled(substeps: FloatArray) -> FloatArray:
    """Return what the authors' processing makes of angles: the first, then means over five."""
    angle = wrapped(substeps)
    return np.concatenate([angle[:1], angle[1:].reshape(-1, 5).mean(axis=1)])


def means(substeps: FloatArray) -> FloatArray:
    return np.concatenate([substeps[:1], substeps[1:].reshape(-1, 5).mean(axis=1)])


def turning(steps: list[int], radius: float, start: float) -> FloatArray:
    """Return angles per substep of an agent that turns by -1, 0 or 1 full turns in each step.

    Within a step the spin grows evenly, and is gone at its end.
    """
    part = np.arange(1, 6) / 15
    moves = np.concatenate([sign * full_turn(radius) * part for sign in steps])
    return np.concatenate([[start], start + np.cumsum(moves)])


def assert_equal_but_for_whole_turns(got: FloatArray, wanted: FloatArray) -> None:
    whole = np.round((got[0] - wanted[0]) / TURN) * TURN
    np.testing.assert_allclose(got, wanted + whole, atol=1e-9)


@pytest.mark.parametrize("radius", SIZES)
@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("part", np.arange(0, 1, 0.1).tolist())
def test_an_agent_that_turns_round_and_round(radius: float, way: int, part: float) -> None:
    angles = turning([0, 0, *[way] * 40, 0, 0], radius, -part * TURN)
    assert_equal_but_for_whole_turns(repaired(spoiled(angles), radius), means(angles))


@settings(max_examples=200, deadline=None)
@given(
    steps=st.lists(st.integers(1, 12), min_size=2, max_size=12),
    radius=st.sampled_from(SIZES),
    start=st.floats(-TURN, 0),
    way=st.sampled_from([1, -1]),
)
def test_an_agent_that_turns_one_way_now_and_then(
    steps: list[int], radius: float, start: float, way: int
) -> None:
    moves = [way * (block % 2) for block, length in enumerate(steps) for _ in range(length)]
    angles = turning([0, 0, *moves, 0, 0], radius, start)
    assert_equal_but_for_whole_turns(repaired(spoiled(angles), radius), means(angles))


def test_frames_that_pass_the_cut_are_wrong_before() -> None:
    angles = turning([1] * 10, 0.8, -1.0)
    off = spoiled(angles) - means(angles)
    assert ((off % TURN > 0.1) & (off % TURN < TURN - 0.1)).sum() == 2


@pytest.mark.parametrize("angle", [0.0, -1e-12, -TURN, -TURN / 5, -4 * TURN / 5])
def test_an_agent_at_rest_is_left_alone(angle: float) -> None:
    given_ = np.full(20, angle)
    np.testing.assert_array_equal(repaired(given_, 0.8), given_)


def test_angles_beyond_the_cut_were_never_wrapped() -> None:
    angles = np.array([-0.3, -0.1, 0.2, -5.0, -0.1])
    np.testing.assert_array_equal(repaired(angles, 0.8), angles)


@needs_dev
def test_repaired_angles_are_left_alone() -> None:
    for event in load_events(DEV):
        for agent in range(2):
            angles = event.observation.trajectory[:, agent, 2]
            radius = float(event.scene.radius[agent])
            np.testing.assert_array_equal(repaired(angles, radius), angles)


@needs_dev
def test_hardly_a_frame_of_the_real_tracks_is_repaired_wrongly() -> None:
    """Tracks of all kinds, turned at random, wrapped and averaged; substeps by interpolation."""
    rng = np.random.default_rng(0)
    frames, wrong = 0, 0
    for event in load_events(DEV):
        for agent in range(2):
            track = event.observation.trajectory[:, agent, 2] + rng.uniform(0, TURN)
            at = np.arange(5 * (len(track) - 1)) / 5 + 0.6  # the middle of five is at a frame
            angles = np.concatenate([track[:1], np.interp(at, np.arange(len(track)), track)])
            radius = float(event.scene.radius[agent])
            got, wanted = repaired(spoiled(angles), radius), means(angles)
            whole = np.round((got[0] - wanted[0]) / TURN) * TURN
            wrong += int((np.abs(got - wanted - whole) > 1e-6).sum())
            frames += len(track)
    assert frames > 5000
    assert wrong < 0.002 * frames
