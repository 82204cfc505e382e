from __future__ import annotations

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from phase_ppl.inference.proposals import goal_training
from phase_ppl.inference.proposals.goal_training import Examples, draw_goals, learned, loss_of_whole
from phase_ppl.inference.proposals.tables import FEATURES, KINDS, WEIGHTS_FILE
from phase_ppl.models.sites import SELF_REFERRING
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import scenario


def telling_examples(n: int) -> Examples:
    """Events in which one feature of the true goals, and of no others, is 1."""
    rng = np.random.default_rng(0)
    features = np.zeros((n, 2, 2, N_GOALS, len(FEATURES)), np.float32)
    goals = np.array([draw_goals(rng)[1] for _ in range(n)])
    for event, pair in enumerate(goals):
        for agent, goal in enumerate(pair):
            features[event, :, agent, goal, 3] = 1
    return Examples(features, goals)


def test_learning_finds_the_feature_that_tells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(goal_training, "ITERATIONS", 15)
    data = telling_examples(40)
    weights = learned(loss_of_whole, data)
    nothing = jnp.zeros((len(KINDS), len(FEATURES)))
    before, after = (
        float(loss_of_whole(jnp.asarray(w), data.features, data.goals)) for w in (nothing, weights)
    )
    assert after < before - 3
    assert weights[0, 3] > 2
    assert np.abs(weights[:, 5]).max() < 0.01


def test_drawn_goals_make_the_scenario_that_they_are_drawn_for() -> None:
    rng = np.random.default_rng(1)
    drawn = [draw_goals(rng) for _ in range(300)]
    assert {name for name, _ in drawn} == set(goal_training.SHARES)
    for name, (red, green) in drawn:
        assert not SELF_REFERRING[0, red]
        assert not SELF_REFERRING[1, green]
        # two independent draws can agree, or be of one item
        assert scenario(red, green) == name or name == "independent"


@pytest.mark.slow
def test_training_writes_weights_and_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goal_training, "ITERATIONS", 2)
    monkeypatch.setattr(goal_training, "FRAMES", 31)
    report = goal_training.main([str(tmp_path), "--draws", "12", "--workers", "1"])
    assert json.loads((tmp_path / "goal_weights.json").read_text()) == json.loads(
        json.dumps(report)
    )
    with np.load(tmp_path / WEIGHTS_FILE) as stored:
        assert {stored[name].shape for name in ("window", "whole")} == {(len(KINDS), len(FEATURES))}
