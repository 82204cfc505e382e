"""Velocities, holds and strengths are found from positions alone."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import phase_ppl as ppl
from phase_ppl.closed_loop.hidden_state import (
    UNSEEN,
    HiddenState,
    NoiseEstimate,
    Tracking,
    filter_gains,
)
from phase_ppl.physics import inverse
from phase_ppl.physics.actions import ACTION_NAMES, Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.scene import Scene
from tests.agents.scenes import scene

FOLDER = Path(__file__).parents[3] / "shared" / "phase-test"
STRENGTHS = (450.0, 300.0)
CARRY = [
    *[(Action.UP, Action.TURN_LEFT)] * 3,
    (Action.ATTACH, Action.UP),
    *[(Action.UP_LEFT, Action.UP)] * 4,
    *[(Action.TURN_LEFT, Action.STOP)] * 3,
    (Action.DETACH, Action.UP),
    *[(Action.DOWN, Action.NO_FORCE)] * 3,
]


def played(where: Scene, actions: Any, strengths: tuple[float, float] = STRENGTHS) -> list[Any]:
    world = PymunkWorld(where, strengths)
    return [(world.step(pair), world.state) for pair in actions]


def followed(where: Scene, frames: Any, **settings: Any) -> HiddenState:
    hidden = HiddenState(where, Tracking(**settings))
    for frame in frames:
        hidden.advance(frame)
    return hidden


def frames_of(*given: Any) -> list[NDArray[np.float64]]:
    return [frame for frame, _ in played(*given)]


def near_item(**changes: Any) -> Scene:
    return scene(red=(12.0, 8.0, 0.0), blue=(12.0, 11.2), green=(22.0, 16.0, 0.5), **changes)


def test_frames_of_any_array_are_read_by_the_kernels_that_are_there() -> None:
    where = near_item()
    frame = where.start + 0.01
    densities, kinds = [], set()
    for given in (frame, np.asfortranarray(frame), np.repeat(frame, 2, axis=0)[::2]):
        for writable in (True, False):
            given.setflags(write=writable)
            densities.append(HiddenState(where, Tracking(states=1)).advance(given))
            kinds.add((len(inverse.try_all.overloads), len(inverse.follow.overloads)))
            assert given.flags.writeable == writable
    assert len(kinds) == 1
    assert all(np.array_equal(density, densities[0]) for density in densities)


def test_actions_holds_and_strengths_are_recovered() -> None:
    where = near_item()
    hidden = HiddenState(where, Tracking(strength_weight=1.0))
    for (frame, state), actions in zip(played(where, CARRY), CARRY, strict=True):
        density = hidden.advance(frame)
        if actions[0] is not Action.ATTACH:  # which shows as soon as something moves
            assert hidden.best().held.tolist() == state.held.tolist()
        for agent, action in enumerate(actions):
            own = density.max(axis=1 - agent)
            assert own[action] > own.max() - 1.0, (agent, Action(own.argmax()))
    strengths = hidden.strengths().reshape(4, 4)
    assert strengths[2, 1] > 0.99
    assert strengths.sum() == pytest.approx(1)
    assert {one.strengths for one in hidden.spread(4)} == {STRENGTHS}  # for planners


def test_agents_that_turn_one_way_only_may_have_meant_the_other() -> None:
    where = near_item(turning="ccw")
    frame, _ = played(where, [(Action.TURN_LEFT, Action.STOP)])[0]
    density = HiddenState(where, Tracking()).advance(frame)
    np.testing.assert_array_equal(density[Action.TURN_LEFT], density[Action.TURN_RIGHT])
    assert density[Action.TURN_RIGHT, Action.STOP] > density[Action.UP, Action.STOP] + 5


def test_what_agents_do_that_are_reset_is_understood_by_that_rule_alone() -> None:
    where = near_item(resets_velocity=True)
    frames = frames_of(where, CARRY)
    explained = {}
    for rule in (True, False):
        assumed = dataclasses.replace(where, resets_velocity=rule)
        hidden = HiddenState(assumed, Tracking(strength_weight=1.0))
        densities = [hidden.advance(frame) for frame in frames]
        explained[rule] = sum(float(np.logaddexp.reduce(d, axis=None)) for d in densities)
        if rule:
            found = hidden.strengths().reshape(4, 4)
            for density, actions in zip(densities, CARRY, strict=True):
                own = density.max(axis=1)
                assert own[actions[0]] > own.max() - 1.0
    assert found[2, 1] > 0.9
    assert explained[True] > explained[False] + 20


def test_a_body_that_jumps_is_followed() -> None:
    where = near_item()
    hidden = HiddenState(where, Tracking())
    for frame in frames_of(where, [(Action.STOP, Action.STOP)] * 8):
        frame[3, :2] += 2.0
        assert np.isfinite(hidden.advance(frame)).all()
    assert hidden.best().bodies[3, :2] == pytest.approx(frame[3, :2], abs=0.05)
    frame[:, :2] += 2.0
    hidden.advance(frame)  # which no action explains: many are as good as the best
    assert len(hidden.beam) > len(hidden.combinations)


@pytest.mark.skipif(not FOLDER.exists(), reason="the real videos are not here")
def test_recorded_agents_are_understood() -> None:
    events = {event.id: event for event in ppl.load_events(FOLDER / "dev.json")}
    records = json.loads((FOLDER / "dev_replays.json").read_text())["videos"]
    agreed: list[bool] = []
    for record in [r for r in records if r["reflection"] == "none"][:4]:
        event = events[record["id"]]
        hidden = HiddenState(event.scene, Tracking())
        names = record["actions"][:35]
        for frame, pair in zip(event.observation.trajectory[1:], names, strict=False):
            density = hidden.advance(frame)
            for agent, name in enumerate(pair):
                own = density.max(axis=1 - agent)
                agreed.append(own[ACTION_NAMES.index(name)] > own.max() - 0.7)
        levels = np.array(Tracking().strengths)
        red, green = np.unravel_index(hidden.strengths().argmax(), (4, 4))
        assert [levels[red], levels[green]] == record["strength_newton"]
    assert np.mean(agreed) > 0.85


def noisy(sigma: float) -> NDArray[np.float64]:
    still = np.zeros((60, 4, 3))
    still[31:, 2, 0] = 0.3 * np.arange(31, 60)  # one item is moved
    still[..., :2] += np.random.default_rng(0).normal(0, sigma, still[..., :2].shape)
    return still


def test_noise_is_estimated_from_items_that_mostly_lie_still() -> None:
    def estimated(frames: NDArray[np.float64], known: float | None = None) -> float:
        estimate = NoiseEstimate(known, frames[0], 2)
        for frame in frames[1:]:
            estimate.update(frame)
        return estimate.now

    for sigma in (0.05, 0.3):
        assert estimated(noisy(sigma)) == pytest.approx(sigma, rel=0.25)
    assert estimated(noisy(0.3)[:2], known=0.2) == 0.2
    assert estimated(noisy(0.0)[:1]) == UNSEEN
    assert estimated(noisy(0.0)[:3]) == 0


def test_a_frame_is_scored_with_the_noise_of_the_frames_before() -> None:
    where = near_item()
    *before, still = frames_of(where, [(Action.STOP, Action.STOP)] * 5)
    jump = still.copy()
    jump[2:, :2] += 1.0  # which alone would say that positions are noisy
    peaks = {followed(where, [*before, last]).log_peak for last in (still, jump)}
    assert len(peaks) == 1


def test_noise_and_the_models_own_error_add_in_squares() -> None:
    where = near_item()
    frame = where.start + 0.05
    both, alone = (
        HiddenState(where, Tracking(scale=scale, noise=noise, states=1)).advance(frame)
        for scale, noise in ((0.06, 0.08), (0.1, 0.0))
    )
    np.testing.assert_allclose(both, alone)


def test_no_strength_is_lost_and_each_has_states_of_its_own() -> None:
    where = near_item()
    hidden = HiddenState(where, Tracking(states=4, strength_weight=1.0))
    frames = frames_of(where, CARRY, (150.0, 600.0))
    for frame in frames:
        hidden.advance(frame)
        assert sorted(set(hidden.beam.combination.tolist())) == list(range(16))
        assert len(hidden.beam) <= 16 + 4
        for pair in range(16):
            within = hidden.beam.within[hidden.beam.combination == pair]
            assert np.exp(within).sum() == pytest.approx(1)
    assert hidden.strengths().reshape(4, 4)[0, 3] > 0.99
    doubtful = followed(where, frames, states=4, strength_weight=0.01)
    assert 0.1 < doubtful.strengths().reshape(4, 4)[0, 3] < 0.6


def test_planners_spread_over_what_is_believed_of_the_strengths() -> None:
    hidden = HiddenState(near_item(), Tracking(strength_weight=1.0))
    assert [one.strengths for one in hidden.spread(1)] == [(450.0, 450.0)]
    for n in (2, 3, 4, 8):
        found = hidden.spread(n)
        for agent in range(2):
            assert len({one.strengths[agent] for one in found}) == min(n, 4)


def test_noisier_positions_are_followed_less() -> None:
    exact, rough, blurred = (filter_gains(0.06, noise) for noise in (0.0, 0.1, 0.3))
    assert (exact[:2] >= rough[:2]).all()
    assert (rough[:2] > blurred[:2]).all()
    # as a Kalman filter of a position that drifts, once it has settled
    variance = 0.0
    for _ in range(200):
        gain = (variance + 0.06**2) / (variance + 0.06**2 + 0.3**2)
        variance = gain * 0.3**2
    assert blurred[:2] == pytest.approx([gain, gain**2 / (2 - gain)])
