"""Worlds as PettingZoo environments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.data import environment
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.event import Truth
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene
from tests.world.examples import check_refused, make_scene

pytest.importorskip("pettingzoo", reason="PettingZoo, the extra env, is not installed")

GOALS = {"red agent": "blue item to blue lm", "green agent": "get away from red agent"}


def phase(**changes: Any) -> Any:
    return ppl.env("PHASE", **{"scene": make_scene(walls=[]), "goals": GOALS, **changes})


def everybody(game: Any, action: int) -> dict[str, int]:
    return dict.fromkeys(game.agents, action)


def test_it_is_what_pettingzoo_expects() -> None:
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    parallel_api_test(ppl.env("trio", steps=12), num_cycles=30)
    parallel_seed_test(lambda: ppl.env("solo", steps=8), num_cycles=8)


def test_bodies_move_as_in_the_simulator() -> None:
    game, world = phase(), PymunkWorld(make_scene(walls=[]), (450.0, 450.0))
    game.reset()
    frames = [world.step((Action.UP_LEFT, Action.TURN_LEFT)) for _ in range(4)]
    for _ in frames:
        game.step({"red agent": Action.UP_LEFT, "green agent": Action.TURN_LEFT})
    assert np.array_equal(game.event().observation.trajectory[1:], frames)


def test_what_is_behind_an_agent_is_not_observed() -> None:
    start = [[16, 12, 0], [16, 18, 0], [16, 4, 0], [12, 16, 0]]  # red looks up
    game = phase(scene=Scene(start=start, radius=[0.8] * 4))  # type: ignore[arg-type]
    observations, _ = game.reset()
    seen = observations["red agent"]
    assert seen["observed"].tolist() == [1, 1, 0, 1]
    assert not seen["bodies"][2].any()
    assert seen["bodies"][1, :2] == pytest.approx([16, 18], abs=0.01)
    everything, _ = phase(scene=game.scene, full_view=True).reset()
    assert everything["red agent"]["observed"].all()


def test_rewards_are_whether_goals_are_true_and_episodes_end_after_their_steps() -> None:
    start = [[16, 12, 0], [16, 18, 0], [8.5, 19.5, 0], [12, 16, 0]]  # blue is on the blue lm
    game = phase(
        scene=Scene(start=start, radius=[0.8] * 4),  # type: ignore[arg-type]
        goals={"red agent": GOALS["red agent"]},
        relation={("green agent", "red agent"): "hinder"},
        steps=2,
    )
    _, infos = game.reset()
    assert infos["green agent"] == {"goal": "Get blue item away from blue lm", "reached": False}
    _, rewards, ended, cut, _ = game.step(everybody(game, Action.STOP))
    assert rewards == {"red agent": 1.0, "green agent": 0.0}
    assert not any(cut.values())
    *_, cut, _ = game.step(everybody(game, Action.STOP))
    assert all(cut.values())
    assert not any(ended.values())
    assert game.agents == []


def test_what_was_played_is_an_event_with_its_goals(tmp_path: Path) -> None:
    game = phase()
    game.reset()
    with pytest.raises(InvalidEventError, match="no step has been made"):
        game.event()
    game.step(everybody(game, Action.UP))
    ppl.save_events([game.event("played")], tmp_path / "played.json")
    event = ppl.load_event(tmp_path / "played.json")
    assert isinstance(event.truth, Truth)
    assert event.truth.goal_red == "Get blue item to blue lm"
    solo = ppl.env("solo")
    solo.reset(seed=1)
    solo.step(everybody(solo, Action.UP))
    assert isinstance(solo.event().truth, Hypothesis)
    assert np.array_equal(
        game.render(), ppl.render.draw_frame(game.scene, game.event().observation.trajectory[-1])
    )


def test_scenes_and_goals_are_drawn_from_the_seed_or_given_for_an_episode() -> None:
    game = ppl.env("solo")
    observations, _ = game.reset(seed=5)
    assert game.observation_space("red agent").contains(observations["red agent"])
    start, roles = game.scene.start, game.roles
    game.reset()
    assert not np.array_equal(game.scene.start, start)
    game.reset(seed=5)
    assert np.array_equal(game.scene.start, start)
    assert game.roles == roles
    game.reset(options={"goals": {"red agent": "ball to barn"}})
    assert game.roles.goals == {"red agent": "Get ball to barn"}


def test_what_cannot_be_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    game = phase()
    check_refused(lambda: game.step({}), "reset() begins one", InvalidSettingError)
    game.reset()
    for step, said in (
        ({"red agent": 0}, "the green agent has no action"),
        ({"red agent": 0, "green agent": 14}, "action of the green agent=14, expected at most"),
        ({"red agnt": 0}, "did you mean 'red agent'"),
    ):
        check_refused(lambda step=step: game.step(step), said)  # type: ignore[misc]
    check_refused(lambda: phase(goals={**GOALS, "red agent": "fly"}), "unknown goal")
    check_refused(lambda: ppl.env("solo", make_scene()), "the scene is of the world PHASE")
    help_only = {("purple agent", "red agent"): "help"}
    check_refused(lambda: ppl.env("trio", relation=help_only), "relation= goes with goals=")
    monkeypatch.setattr(environment, "_ParallelEnv", object)
    check_refused(lambda: ppl.env("solo"), "pip install 'phase_ppl[env]'", InvalidSettingError)
