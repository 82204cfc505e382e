from __future__ import annotations

import dataclasses
import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from phase_ppl.dataset.generation.situation import LAYOUTS, SIZES
from phase_ppl.inference.proposals.strength import SHAPES, StrengthNetwork
from phase_ppl.inference.proposals.strength_features import N_FEATURES
from phase_ppl.inference.proposals.strength_training import (
    VALIDATION_JITTER,
    VALIDATION_LENGTHS,
    Simulated,
    TrainingSettings,
    cached_events,
    draw_hypothesis,
    draw_scene,
    main,
    needs_torch,
    simulate_events,
    train,
    training_examples,
    validation_examples,
)
from phase_ppl.world.errors import InvalidSettingError

SETTINGS = TrainingSettings(events=20, frames=16, rounds=1, epochs=3, batch=16)


def driving(n: int = 20, frames: int = 16) -> Simulated:
    """Both agents go straight up, the faster the stronger; the items rest."""
    rng = np.random.default_rng(0)
    strength = rng.uniform(150, 600, (n, 2))
    trajectory = np.zeros((n, frames, 4, 3), np.float32)
    trajectory[..., 0] = [8, 12, 18, 22]
    trajectory[:, :, :2, 1] = np.arange(frames)[:, None] * strength[:, None] / 1000
    return Simulated(trajectory, np.full((n, 4), 0.8), strength)


# --- data --------------------------------------------------------------------------------------


def test_drawn_scenes_and_hypotheses_have_the_variety_of_phase() -> None:
    rng = np.random.default_rng(0)
    scenes = [draw_scene(rng) for _ in range(400)]
    lengths = {tuple(scene.rooms.wall_length) for scene in scenes}
    assert lengths == {tuple(map(float, layout)) for layout in LAYOUTS.values()}
    assert set(np.concatenate([scene.radius for scene in scenes])) == set(SIZES)
    assert {scene.turning for scene in scenes} == {"both", "ccw", "cw"}
    drawn = [draw_hypothesis(rng) for _ in range(400)]
    assert {h.relation for h in drawn} == {"friendly", "neutral", "adversarial"}
    strengths = np.array([h.strengths for h in drawn])
    assert strengths.min() == 150
    assert strengths.max() == 600
    assert 0.4 < np.isin(strengths, (150, 300, 450, 600)).mean() < 0.6


def test_simulated_events_are_the_same_for_the_same_seed_and_kept(tmp_path: Path) -> None:
    kept = cached_events(tmp_path / "events.npz", 2, 6, seed=3)
    assert kept.trajectory.shape == (2, 6, 4, 3)
    again, read = simulate_events(1, 6, seed=3), cached_events(tmp_path / "events.npz", 2, 6, 3)
    for whole, first, copy in zip(kept, again, read, strict=True):
        np.testing.assert_array_equal(whole[:1], first)
        np.testing.assert_array_equal(whole, copy)
    with pytest.raises(InvalidSettingError, match=r"'seed': 3.*not of.*'seed': 4"):
        cached_events(tmp_path / "events.npz", 2, 6, 4)


def test_examples_cover_lengths_and_jitter() -> None:
    examples = training_examples(driving(), rounds=3, seed=0)
    assert examples.features.shape == (len(examples.strength), N_FEATURES)
    assert np.isfinite(examples.features).all()
    assert 0.15 < (examples.jitter == 0).mean() < 0.55
    assert examples.length.min() == 1
    assert examples.length.max() == 15
    validation = validation_examples(driving(2), seed=0)
    cells = set(zip(validation.jitter, validation.length, strict=True))
    assert cells == {(j, n) for j in VALIDATION_JITTER for n in VALIDATION_LENGTHS}


@pytest.mark.parametrize("change", [{"events": 2}, {"frames": 5}, {"epochs": 0}])
def test_settings_too_small_to_train_are_refused(change: dict[str, int]) -> None:
    with pytest.raises(InvalidSettingError, match=f"{next(iter(change))}="):
        dataclasses.replace(SETTINGS, **change)


# --- training ----------------------------------------------------------------------------------


def test_training_without_torch_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InvalidSettingError, match=r"phase_ppl\[neural\]"):
        needs_torch()
    with pytest.raises(SystemExit, match="2"):
        main([str(tmp_path)])
    assert "phase_ppl[neural]" in capsys.readouterr().err


HAS_TORCH = importlib.util.find_spec("torch") is not None
with_torch = pytest.mark.skipif(not HAS_TORCH, reason="PyTorch, the extra neural, is not installed")


@with_torch
def test_training_learns_and_repeats_itself() -> None:
    network, report = train(driving(), SETTINGS)
    curve = report["curves"]["training"]
    assert curve[-1] < curve[0]
    assert len(report["validation"]) == len(VALIDATION_JITTER) * len(VALIDATION_LENGTHS)
    again, _ = train(driving(), SETTINGS)
    other, _ = train(driving(), dataclasses.replace(SETTINGS, seed=1))
    features = np.random.default_rng(0).normal(size=(5, N_FEATURES))
    np.testing.assert_array_equal(network.outputs(features), again.outputs(features))
    assert np.abs(network.outputs(features)[0] - other.outputs(features)[0]).max() > 1e-3


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
    StrengthNetwork.load(tmp_path / "out" / "strength_weights.npz")
    report = json.loads((tmp_path / "out" / "strength_weights.json").read_text())
    assert report["settings"]["events"] == 20
    assert set(SHAPES)


def test_drawn_events_are_the_same_with_one_and_two_workers() -> None:
    # among them is one whose bodies overlap at the start
    one, two = (simulate_events(3, 6, 0, workers) for workers in (1, 2))
    for alone, shared in zip(one, two, strict=True):
        np.testing.assert_array_equal(alone, shared)
