from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from phase_ppl.data.load import load_events
from phase_ppl.inference.strength import (
    VALIDATION_SD,
    analytic_strengths,
    network_strengths,
)
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.event import Observation
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.scene import Scene

PHASE_TEST = Path("../shared/phase-test/dev.json")

# red faces right with 20 units of free way, green faces up
START = np.array([[7.0, 12.0, -np.pi / 2], [20.0, 4.0, 0.0], [8.0, 20.0, 0.0], [24.0, 20.0, 0.0]])
SCENE = Scene(START, np.array([1.2, 0.8, 0.8, 0.8]))


def driven(
    strengths: tuple[float, float], actions: list[tuple[Action, Action]], scene: Scene = SCENE
) -> np.ndarray:
    world = PymunkWorld(scene, strengths)
    return np.array([START, *(world.step((int(a), int(b))) for a, b in actions)])


def estimate(
    trajectory: np.ndarray, first: int = 0, last: int | None = None, scene: Scene = SCENE
) -> np.ndarray:
    windows = np.array([[first, len(trajectory) - 1 if last is None else last]])
    return analytic_strengths(scene, Observation(trajectory), windows).mean[0]


@pytest.mark.parametrize("resets", [False, True])
@pytest.mark.parametrize("level", STRENGTH_LEVELS)
def test_free_forward_driving_gives_the_strength_away(level: float, resets: bool) -> None:
    scene, strengths = dataclasses.replace(SCENE, resets_velocity=resets), (level, 750.0 - level)
    trajectory = driven(strengths, [(Action.UP, Action.UP)] * 5, scene)
    np.testing.assert_array_equal(estimate(trajectory, scene=scene), strengths)
    assert np.isnan(estimate(trajectory[:1].repeat(4, axis=0), scene=scene)).all()
    if resets:  # the network knows no such agents
        found = network_strengths(scene, Observation(trajectory), np.array([[0, 5]]))
        np.testing.assert_array_equal(found.mean[0], strengths)


def test_window_sees_only_its_own_frames() -> None:
    rest = [(Action.STOP, Action.STOP)] * 6
    trajectory = driven((300.0, 300.0), [*rest, *[(Action.UP, Action.STOP)] * 4])
    assert np.isnan(estimate(trajectory, 0, 6)[0])
    assert estimate(trajectory, 6, 10)[0] == 300


def test_no_strength_is_seen_where_none_shows() -> None:
    push, coast, both = ((Action.UP, Action.STOP), (Action.NO_FORCE, Action.STOP), (Action.UP,) * 2)
    coasting = driven((450.0, 450.0), [push, push, *[coast] * 6])
    between_the_levels = driven((375.0, 375.0), [both] * 5)
    two_frames = driven((300.0, 300.0), [both])
    for trajectory, first in ((coasting, 3), (between_the_levels, 0), (two_frames, 0)):
        assert np.isnan(estimate(trajectory, first)).all()


def test_estimates_on_the_authors_videos_have_the_stated_error() -> None:
    if not PHASE_TEST.is_file():
        pytest.skip(f"{PHASE_TEST} is not here")
    errors = []
    for event in load_events(PHASE_TEST):
        assert event.truth is not None
        found = estimate(event.observation.trajectory, scene=event.scene)
        errors += list(found - [event.truth.strength_red, event.truth.strength_green])
    known = np.array(errors)[~np.isnan(errors)]
    assert len(known) >= 55
    assert (known == 0).mean() > 0.95
    assert np.sqrt((known**2).mean()) == pytest.approx(VALIDATION_SD, abs=5)
