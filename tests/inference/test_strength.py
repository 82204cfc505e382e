"""Estimators of strengths: the network with its training, and the analytic rule."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from strength_training import Simulated, blurred, main, quality, simulate_events

from phase_ppl.data.load import bundled_events, load_event, load_events
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.inference.strength import (
    N_FEATURES,
    VALIDATION_SD,
    StrengthEstimates,
    StrengthNetwork,
    analytic_strengths,
    network_strengths,
    shipped_network,
    window_features,
)
from phase_ppl.inference.tables import bottom_up_tables
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.errors import UnknownNameError
from phase_ppl.world.event import Observation
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.scene import Scene

PHASE_TEST = Path("../shared/phase-test/dev.json")
EVENT = load_event("collaborate")
TRAJECTORY = EVENT.observation.trajectory
RADIUS = EVENT.scene.radius
ALL = np.array([[0, len(TRAJECTORY) - 1]])
PRIOR_LOG_DENSITY = -np.log(450.0)


def no_weights() -> dict[str, np.ndarray]:
    weights = {name: np.zeros_like(array) for name, array in shipped_network().weights.items()}
    return weights | {"scale": np.ones(N_FEATURES)}


def test_features_are_finite_for_the_shortest_observations() -> None:
    for n_frames in (2, 3, 4, 7):
        windows = np.array([[0, n_frames - 1], [0, 1], [n_frames - 2, n_frames - 1]])
        features = window_features(TRAJECTORY[:n_frames], RADIUS, windows)
        assert features.shape == (3, 2, N_FEATURES)
        assert np.isfinite(features).all()


def test_features_do_not_depend_on_place_or_direction() -> None:
    windows = np.array([[0, 12], [5, 40]])
    turned = TRAJECTORY[..., [1, 0, 2]] * [-1, 1, 1] + [3.0, -7.0, np.pi / 2]
    reflected = TRAJECTORY * [-1, 1, -1]
    reference = window_features(TRAJECTORY, RADIUS, windows)
    for moved in (turned, reflected):
        np.testing.assert_allclose(
            window_features(moved, RADIUS, windows), reference, rtol=1e-3, atol=1e-3
        )


def test_shipped_network_beats_the_prior_on_new_events() -> None:
    events, window = simulate_events(6, 36, seed=20_000), np.array([[0, 35]])
    for jitter, gain in ((0.0, 0.8), (0.1, 0.4)):
        rng = np.random.default_rng(0)
        found = [
            shipped_network().outputs(window_features(blurred(t, jitter, rng), radius, window))
            for t, radius in zip(events.trajectory, events.radius, strict=True)
        ]
        mean, sd = (np.concatenate(part) for part in zip(*found, strict=True))
        judged = quality(StrengthEstimates(mean, sd), events.strength)
        assert judged.log_density > PRIOR_LOG_DENSITY + gain


def test_the_network_knows_little_of_agents_at_rest_and_jitter_makes_it_less_sure() -> None:
    resting = Observation(np.repeat(TRAJECTORY[:1], 30, axis=0))
    windows = np.array([[0, 29], [0, 10]])
    assert (network_strengths(EVENT.scene, resting, windows).sd > 100).all()
    clear, blur = (
        network_strengths(EVENT.scene, Observation(seen), ALL).sd
        for seen in (TRAJECTORY, blurred(TRAJECTORY, 0.3, np.random.default_rng(0)))
    )
    assert (blur > 2 * clear).all()


def test_an_unknown_estimator_is_named() -> None:
    with pytest.raises(UnknownNameError, match="'networks'; did you mean 'network'"):
        SimpleSettings(strength="networks")  # type: ignore[arg-type]


def test_inference_needs_no_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    shipped_network.cache_clear()
    for name in bundled_events():
        event = load_event(name)
        tables = bottom_up_tables(event.scene, event.observation, SimpleSettings())
        assert np.isfinite(tables.strength_sd).any()


# red faces right with 20 units of free way, green faces up
START = np.array([[7.0, 12.0, -np.pi / 2], [20.0, 4.0, 0.0], [8.0, 20.0, 0.0], [24.0, 20.0, 0.0]])
PLACE = Scene(START, np.array([1.2, 0.8, 0.8, 0.8]))


def driven(
    strengths: tuple[float, float], actions: list[tuple[Action, Action]], scene: Scene = PLACE
) -> np.ndarray:
    world = PymunkWorld(scene, strengths)
    return np.array([START, *(world.step((int(a), int(b))) for a, b in actions)])


def estimate(
    trajectory: np.ndarray, first: int = 0, last: int | None = None, scene: Scene = PLACE
) -> np.ndarray:
    windows = np.array([[first, len(trajectory) - 1 if last is None else last]])
    return analytic_strengths(scene, Observation(trajectory), windows).mean[0]


@pytest.mark.parametrize("resets", [False, True])
@pytest.mark.parametrize("level", STRENGTH_LEVELS)
def test_free_forward_driving_gives_the_strength_away(level: float, resets: bool) -> None:
    scene, strengths = dataclasses.replace(PLACE, resets_velocity=resets), (level, 750.0 - level)
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
        found = estimate(event.observation.trajectory, scene=event.scene)
        errors += list(found - [event.truth.strength_red, event.truth.strength_green])
    known = np.array(errors)[~np.isnan(errors)]
    assert len(known) >= 55
    assert (known == 0).mean() > 0.95
    assert np.sqrt((known**2).mean()) == pytest.approx(VALIDATION_SD, abs=5)


def driving(n: int = 20, frames: int = 16) -> Simulated:
    rng = np.random.default_rng(0)
    strength = rng.uniform(150, 600, (n, 2))
    trajectory = np.zeros((n, frames, 4, 3), np.float32)
    trajectory[..., 0] = [8, 12, 18, 22]
    trajectory[:, :, :2, 1] = np.arange(frames)[:, None] * strength[:, None] / 1000
    return Simulated(trajectory, np.full((n, 4), 0.8), strength)


HAS_TORCH = importlib.util.find_spec("torch") is not None
with_torch = pytest.mark.skipif(not HAS_TORCH, reason="PyTorch, the extra neural, is not installed")


@with_torch
def test_command_writes_weights_that_load_and_a_report(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "events.npz",
        allow_pickle=False,
        settings=json.dumps({"events": 20, "frames": 16, "seed": 0}),
        **driving()._asdict(),
    )
    options = ["--events-file", str(tmp_path / "events.npz"), "--epochs", "1", "--rounds", "1"]
    main([str(tmp_path / "out"), "--events", "20", "--frames", "16", *options])
    StrengthNetwork(np.load(tmp_path / "out" / "strength_weights.npz", allow_pickle=False))
    report = json.loads((tmp_path / "out" / "strength_weights.json").read_text())
    assert report["settings"]["events"] == 20
