"""Watching frame by frame: nothing later changes what was believed, and all ways agree."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.closed_loop.goal_filter import GoalFilter
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.event import Event, Observation
from tests.inference.toy import few_goals

QUICK = ppl.PlannerConfig(simulations=14, particles=6)
MODEL = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=2), planner=QUICK)


def short(frames: int = 9) -> Event:
    event = ppl.load_event("collaborate")
    return dataclasses.replace(
        event, observation=Observation(event.observation.trajectory[:frames])
    )


def infer(event: Event | None = None, **options: Any) -> ppl.ClosedLoopPosterior:
    given = {"model": MODEL, "workers": 1, "progress": False, **options}
    return ppl.infer(short() if event is None else event, **given)


@pytest.fixture(scope="module")
def whole() -> ppl.ClosedLoopPosterior:
    return infer()


TABLES = ("density", "policies", "policy_of", "shift", "strengths", "actions", "held")


def assert_same(one: ppl.ClosedLoopPosterior, other: ppl.ClosedLoopPosterior, frames: int) -> None:
    for name in TABLES:
        found = (post.dataset[name].values[:frames] for post in (one, other))
        np.testing.assert_array_equal(*found, name)


def test_the_last_posterior_of_watching_is_the_batch_result(whole: ppl.ClosedLoopPosterior) -> None:
    event = short()
    with ppl.watch(event.scene, MODEL, threads=2, event_id=event.id) as watch:
        posts = [watch.update(frame) for frame in event.observation.trajectory]
    assert_same(posts[-1], whole, 9)
    assert posts[-1].event_id == event.id
    assert len(posts[0].over_time()["time"]) == 1


def test_later_frames_never_change_earlier_posteriors(whole: ppl.ClosedLoopPosterior) -> None:
    event = short()
    other = event.observation.trajectory.copy()
    other[6:, 0, :2] -= 1.5
    post = infer(dataclasses.replace(event, observation=Observation(other)))
    assert_same(post, whole, 6)
    later = (one.dataset["density"].values[6:] for one in (post, whole))
    assert not np.array_equal(*later)
    early, again = whole.at(5), post.at(5)
    np.testing.assert_array_equal(early.marginal("relation"), again.marginal("relation"))


def test_only_scene_observation_and_seed_matter(whole: ppl.ClosedLoopPosterior) -> None:
    event = dataclasses.replace(short(), truth=None, judgments=None)
    assert_same(infer(event, workers=2), whole, 9)
    other = infer(event, seed=1).dataset["policies"]
    assert not np.array_equal(other, whole.dataset["policies"])


def test_a_bad_frame_is_refused_and_loses_nothing() -> None:
    event = short(4)
    frames = event.observation.trajectory
    with ppl.watch(event.scene, MODEL, threads=1) as watch:
        with pytest.raises(InvalidSettingError, match="nothing was watched"):
            watch.posterior()
        watch.take(frames[0])
        watch.take(frames[1])
        for bad, message in (
            (np.full((4, 3), np.inf), "frame 2"),
            (frames[2][:3], "frame 2"),
            (frames[2] + 100, "frame 2: the red agent is at"),
        ):
            with pytest.raises(InvalidEventError, match=message):
                watch.update(bad)
        post = watch.update(frames[2])
    assert len(post.observed()) == 3


def test_an_interrupted_reading_keeps_what_was_read(monkeypatch: pytest.MonkeyPatch) -> None:
    event = short(6)
    read, calls = GoalFilter.read, []

    def interrupted(self: GoalFilter, frame: np.ndarray) -> Any:
        calls.append(frame)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return read(self, frame)

    monkeypatch.setattr(GoalFilter, "read", interrupted)
    with pytest.raises(ppl.ClosedLoopInterrupted, match="after 3 frames") as stopped:
        ppl.infer(event, MODEL, workers=1, progress=False)
    assert len(stopped.value.posterior.observed()) == 3
    calls.clear()
    with ppl.watch(event.scene, MODEL, threads=1) as watch:
        for frame in event.observation.trajectory[:3]:
            watch.take(frame)
        with pytest.raises(KeyboardInterrupt):
            watch.take(event.observation.trajectory[3])
        with pytest.raises(InvalidSettingError, match="frame 3 was interrupted"):
            watch.take(event.observation.trajectory[3])
        assert len(watch.posterior().observed()) == 3


def test_other_likelihoods_cannot_be_read() -> None:
    with pytest.raises(InvalidSettingError, match="compares whole simulations with the video"):
        ppl.watch(short(3).scene, ppl.Model(likelihood=ppl.RadialLikelihood()))


def test_a_kernel_that_samples_finds_the_same() -> None:
    # a video that tells little: other goals or another prior of strengths would be 0.15 or 0.1 off
    tracking = ppl.Tracking(strength_weight=0.02)
    likelihood = ppl.ClosedLoopLikelihood(weight=0.05, planner_seeds=1, tracking=tracking)
    model = dataclasses.replace(MODEL, prior=few_goals, likelihood=likelihood)
    exact = infer(model=model)
    sampling: dict[str, Any] = {"kernel": "prior_mh", "chains": 100, "iterations": 128}
    post = ppl.infer(short(), model, **sampling, progress=False)
    assert "tempered: a frame counts 0.05" in str(post)
    assert "tempered: a frame counts 0.05 for goals and 0.02 for strengths" in str(exact)
    for name in ("relation", "goal_red", "goal_green"):
        apart = np.abs(post.marginal(name).values - exact.marginal(name).values).sum() / 2
        assert apart < 0.08, name
    for name in ("strength_red", "strength_green"):
        for cell in itertools.pairwise((150.0, 225.0, 375.0, 525.0, 600.0)):
            expected = exact.probability(**{name: cell})
            assert abs(post.probability(**{name: cell}) - expected) < 0.06, (name, cell)


def test_sets_of_searches_give_errors_and_one_gives_none(whole: ppl.ClosedLoopPosterior) -> None:
    assert ppl.ClosedLoopLikelihood().planner_seeds == 4
    assert whole.planner_seeds == 2
    assert whole.probability(relation="friendly").error > 0
    instant = dataclasses.replace(MODEL, likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1))
    post = infer(model=instant)
    assert np.isnan(post.probability(relation="friendly").error)
    assert post.cost["searches"] < whole.cost["searches"]


def test_impossible_videos_are_called_out(whole: ppl.ClosedLoopPosterior) -> None:
    assert whole.diagnostics()["unexplained_frames"] == []
    torn, lying = (short().observation.trajectory.copy() for _ in range(2))
    torn[4:6, 0, 0] -= 9.0  # red is elsewhere for two frames
    lying[3:, 0, :2] = lying[3:, 1, :2]
    found = []
    for frames in (torn, lying):
        post = infer(dataclasses.replace(short(), observation=Observation(frames)))
        found.append(post.diagnostics())
        assert found[-1]["answer"] in " ".join(str(post).split())
    assert {4, 6} <= set(found[0]["unexplained_frames"])
    assert found[0]["verdict"].startswith("No action explains")
    assert found[1]["overlapping_frames"] == list(range(3, 9))
    assert "Bodies lie on each other" in found[1]["verdict"]


@pytest.mark.usefixtures("unpainted")
def test_the_terminal_watches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    event = tmp_path / "event.json"
    ppl.save_event(short(6), event)
    out = tmp_path / "out"
    options = ["infer", str(event), "--model", "closed_loop", "--watch", "--out", str(out)]
    assert main([*options, "--workers", "1"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("  0.0 s  red: ")
    assert "  1.0 s  red: " in printed
    assert "closed loop, 6 frames" in printed
    written = {file.name for file in out.iterdir()}
    assert {"posterior.nc", "why.png", "over_time.png", "watch.mp4", "summary.json"} <= written
    assert main(["query", str(out), "P(relation=friendly)"]) == 0
    assert main(["diagnose", str(out), "--json"]) == 0
    assert "planner_seeds" in capsys.readouterr().out
    assert main(["diagnose", str(out), "--out", str(tmp_path / "figures")]) != 0
    assert "no chains to draw" in capsys.readouterr().err


def test_what_is_of_no_use_step_by_step_is_refused() -> None:
    for message, given in {
        "chains=3 is for sampling": {"chains": 3},
        "iterations=3 is for sampling": {"iterations": 3},
        "budget=.* is for sampling": {"budget": ppl.simulations(50)},
        "rule='paper' is for sampling": {"rule": "paper"},
        "began=5 is for sampling": {"began": 5},
        "on_failure='banana'": {"kernel": "prior_mh", "on_failure": "banana"},
    }.items():
        with pytest.raises(InvalidSettingError, match=message):
            ppl.infer(short(3), MODEL, progress=False, **given)  # type: ignore[arg-type]
