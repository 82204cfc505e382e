"""Sessions that two people played are read by both likelihoods, by their own rule of motion."""

from __future__ import annotations

import asyncio
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")

import phase_ppl as ppl
from phase_study import play
from phase_study.room import Room
from tests.study.players import both_play, drives, make_study, near_goals
from tests.study.studies import serving

QUICK = ppl.PlannerConfig(particles=6, simulations=8)


class Patient(Room):
    """Begins once all people hold keys down, so that sessions are the same on any machine."""

    async def run(self, *given: Any) -> str:
        while not all(seat.who is None or seat.controls.pressed() for seat in self.seats):
            await asyncio.sleep(0.01)
        return await super().run(*given)


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("played")
    start = [[14.5, 19.5, np.pi / 2], [17.5, 19.5, -np.pi / 2], [12, 7, 0], [20, 7, 0]]
    sizes = {"alike": [0.8] * 4, "larger": [1.2, 0.8, 0.8, 0.8]}
    ahead = [near_goals(name, start=start, radius=radius) for name, radius in sizes.items()]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(play, "COUNTDOWN", 0)
        patch.setattr(play, "Room", Patient)
        study = make_study(folder / "study", ahead, trials=2, hold=6, limit=60, steps_per_second=24)
        with serving(study) as client:
            both_play(client, drives("forward"))
    study.export(folder / "out")
    return folder / "out" / "sessions.json"


def test_what_people_did_speaks_for_their_goals_and_their_rule(sessions: Path) -> None:
    planner = dataclasses.replace(QUICK, particles=10, simulations=40)
    model = ppl.Model(likelihood=ppl.StepwiseLikelihood(planner_seeds=1), planner=planner)
    evidence = {True: 0.0, False: 0.0}
    for event in ppl.load_events(sessions):
        assert event.scene.resets_velocity
        for rule in evidence:
            scene = dataclasses.replace(event.scene, resets_velocity=rule)
            post = ppl.infer(ppl.Event(scene, event.observation), model)
            assert post.settings["resets_velocity"] is post.scene.resets_velocity is rule
            evidence[rule] += post.log_evidence
            for goal in ("goal_red", "goal_green") if rule else ():
                # it is some 0.08 to 0.3
                assert float(post.probability(**{goal: getattr(event.truth, goal)})) > 1 / 36
    assert evidence[True] > evidence[False] + 3


@pytest.mark.parametrize("kernel", ["prior_mh", pytest.param("local_mh", marks=pytest.mark.slow)])
def test_a_session_is_simulated_by_its_own_rule(sessions: Path, kernel: str) -> None:
    event = ppl.load_events(sessions)[0]
    post = ppl.infer(
        event, kernel=kernel, planner=QUICK, chains=2, iterations=2, workers=1, progress=False
    )
    assert post.settings["resets_velocity"]
    assert post.scene.resets_velocity
    # whoever drives from rest in each step goes no further than the strongest can
    way = abs(post.replay()[:, :2, :2] - event.scene.start[:2, :2]).max()
    assert way < 0.9 * event.observation.n_frames
