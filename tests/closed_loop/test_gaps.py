"""A body that is not seen goes on, and what is seen counts as if the rest were summed out."""

from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.closed_loop.hidden_state import HiddenState, Tracking
from phase_ppl.physics.actions import N_ACTIONS, Action
from tests.closed_loop.test_hidden_state import CARRY, near_item, played

RED, GREEN, BLUE = 0, 1, 2
STILL = np.zeros(N_ACTIONS)
STILL[Action.STOP] = 1.0


def one_hot(action: Action) -> np.ndarray:
    return np.eye(N_ACTIONS)[action]


def hidden_from(
    frames: list[np.ndarray], body: int | slice, first: int, n: int
) -> list[np.ndarray]:
    frames = [frame.copy() for frame in frames]
    for frame in frames[first : first + n]:
        frame[body] = np.nan
    return frames


def test_an_item_that_is_carried_unseen_is_where_its_carrier_took_it() -> None:
    where = near_item()
    steps = played(where, CARRY)
    frames = [frame for frame, _ in steps]
    hidden, apart = HiddenState(where, Tracking(strength_weight=1.0)), []
    for frame, (_, state) in zip(hidden_from(frames, BLUE, 5, 6), steps, strict=True):
        hidden.advance(frame)
        apart.append(np.hypot(*(hidden.best().bodies[BLUE, :2] - state.pose[BLUE, :2])))
    moved = np.hypot(*(frames[11] - frames[5])[BLUE, :2])
    assert max(apart[5:11]) < 0.3 < moved


def test_an_agent_goes_on_unseen_by_its_policy_and_is_found_again() -> None:
    where, doing = near_item(), [(Action.UP_LEFT, Action.UP)] * 10
    frames = [frame for frame, _ in played(where, doing)]
    told = [STILL, one_hot(Action.UP)]
    hidden = HiddenState(where, Tracking())
    for k, frame in enumerate(hidden_from(frames, GREEN, 3, 5)):
        density = hidden.advance(frame, policies=told)
        unexplained = hidden.log_peak - density.max()
        if k == 7:  # the last unseen frame
            spread = hidden._spread()
            off = hidden.best().bodies[GREEN, :2] - frames[k][GREEN, :2]
        assert unexplained < 5
    assert np.hypot(*off) < 1.0 < np.hypot(*(frames[7] - frames[2])[GREEN, :2])
    assert (spread[GREEN] > 0).all()
    assert not spread[RED].any()
    assert hidden.best().bodies[GREEN, :2] == pytest.approx(frames[-1][GREEN, :2], abs=1.5)
    assert not hidden._spread().any()


def test_whoever_may_do_anything_unseen_may_be_anywhere_the_longer_the_more() -> None:
    where = near_item()
    frames = [frame for frame, _ in played(where, [(Action.STOP, Action.UP)] * 8)]
    hidden, spread = HiddenState(where, Tracking()), []
    for frame in hidden_from(frames, GREEN, 0, 8):
        density = hidden.advance(frame)
        spread.append(hidden._spread()[GREEN, 0])
        assert np.ptp(density, axis=GREEN).max() < 1e-9  # the frames say nothing of it
        assert density[Action.STOP, 0] == density.max()
    assert spread[0] < spread[3] < spread[7]


def test_whole_turns_that_a_tracker_adds_while_an_angle_is_unseen_do_not_matter() -> None:
    where, doing = near_item(), [(Action.TURN_LEFT, Action.STOP)] * 8
    frames, found, angles = [frame for frame, _ in played(where, doing)], [], set()
    for turns in (0, 1, -2):
        given = [frame.copy() for frame in frames]
        for frame in given[2:4]:
            frame[RED, 2] = np.nan
        for frame in given[4:]:
            frame[RED, 2] += 2 * np.pi * turns
        hidden = HiddenState(where, Tracking())
        found.append([hidden.advance(frame) for frame in given])
        angles.add(round(hidden.best().bodies[RED, 2], 6))
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)
    np.testing.assert_allclose(found[2], found[0], atol=1e-6)
    assert len(angles) == 1
