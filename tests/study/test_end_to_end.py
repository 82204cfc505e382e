"""From two people at play to people beside models, by way of both likelihoods."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")
from starlette.testclient import TestClient

import phase_ppl as ppl
from phase_ppl.study import play, simulate
from phase_ppl.study.study import Study
from tests.study.players import HOST, Player, drives, make_study, near_goals, together

QUICK = ppl.PlannerConfig(particles=10, simulations=20)


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of three sessions that two people played."""
    folder = tmp_path_factory.mktemp("played")
    ahead = [near_goals("ahead"), near_goals("weaker", radius=[1.2, 0.8, 0.8, 0.8])]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(play, "COUNTDOWN", 0)
        study = make_study(folder / "study", ahead, trials=3, hold=6)
        with TestClient(study.app(), base_url=HOST) as client:
            players = [Player(client), Player(client)]
            together(*(lambda one=one: one.play(drives("forward")) for one in players))
    study.export(folder / "out")
    return folder / "out" / "sessions.json"


def test_played_sessions_are_explained_by_both_likelihoods(sessions: Path) -> None:
    event = ppl.load_events(sessions)[0]
    assert event.scene.resets_velocity
    closed = ppl.Model(likelihood=ppl.StepwiseLikelihood(planner_seeds=1), planner=QUICK)
    post = ppl.infer(event, closed)
    assert post.marginal("goal_red")["Get red agent to blue lm"] > 1 / 36
    strong = post.marginal("strength_red")
    assert post.settings["resets_velocity"]
    drawn = ppl.infer(event, planner=QUICK, chains=2, iterations=2, workers=1, progress=False)
    assert drawn.settings["resets_velocity"]
    assert strong is not None


def test_the_rule_of_a_session_explains_it_better_than_another(sessions: Path) -> None:
    event = ppl.load_events(sessions)[0]
    likelihood = ppl.StepwiseLikelihood(planner_seeds=1)
    evidence = []
    for rule in (True, False):
        scene = dataclasses.replace(event.scene, resets_velocity=rule)
        model = ppl.Model(likelihood=likelihood, planner=QUICK)
        evidence.append(ppl.infer(ppl.Event(scene, event.observation), model).log_evidence)
    assert evidence[0] > evidence[1] + 5


def test_from_play_to_people_beside_models(sessions: Path, tmp_path: Path) -> None:
    events = ppl.load_events(sessions)
    judging = Study.new(tmp_path / "judging", events, "judgment", raters=6, workers=1)
    believed = ppl.evaluate(events, "last_frame")
    out = tmp_path / "answers"
    simulate.simulate(judging, out, people=8, predictions=believed.predictions, lapse=0.2)
    judged = ppl.load_judgments(out / "judgments.csv", events)
    assert len(judged.table) >= 6 * len(events) - 8
    models = [
        ppl.evaluate(events, name, judgments=out / "judgments.csv", out=tmp_path / name)
        for name in ("last_frame", "majority")
    ]
    comparison = ppl.compare_models(models)
    assert comparison.people["n_events"] == len(events)
    assert comparison.people["goal_accuracy"]["value"] > 1 / 36
    for name in ("accuracy", "correlation"):
        figure = tmp_path / f"{name}.png"
        getattr(ppl.figures, name)(comparison, path=figure)
        assert figure.stat().st_size > 1000
