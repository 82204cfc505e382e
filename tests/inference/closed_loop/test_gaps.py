"""Videos with gaps are read, and the posterior says what was not seen."""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.special import entr

import phase_ppl as ppl
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, SimulationError
from tests.inference.closed_loop.test_users_simulator import EVENT, SPREAD, Draws, Knows, model

QUICK = ppl.Model(
    likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1),
    planner=ppl.PlannerConfig(simulations=14, particles=6),
)
STINGY = dataclasses.replace(QUICK, planner=ppl.PlannerConfig(simulations=2, particles=2))
FRAMES = 12


def hidden(event: ppl.Event, frames: slice, bodies: Any) -> ppl.Event:
    seen = event.observation.trajectory.copy()
    seen[frames, bodies] = np.nan
    return dataclasses.replace(event, observation=ppl.Observation(seen))


def infer(event: ppl.Event, given: ppl.Model = QUICK) -> ppl.ClosedLoopPosterior:
    return ppl.infer(event, given, workers=1, progress=False)


@pytest.fixture(scope="module")
def event() -> ppl.Event:
    whole = ppl.load_event("collaborate")
    seen = ppl.Observation(whole.observation.trajectory[:FRAMES])
    return dataclasses.replace(whole, observation=seen)


def test_missing_frames_change_no_belief_and_are_named(event: ppl.Event) -> None:
    post = infer(hidden(event, slice(5, 8), slice(None)))
    for name in ("goal_red", "relation", "strength_red"):
        before, after = post.at(4), post.at(7)
        if name == "strength_red":
            assert after.mean(name) == pytest.approx(before.mean(name), abs=1e-3)
        else:
            np.testing.assert_allclose(after.marginal(name), before.marginal(name), atol=1e-6)
    assert post.at(7).log_evidence == pytest.approx(post.at(4).log_evidence, abs=1e-4)
    assert post.diagnostics()["unseen_frames"]["pink item"] == [5, 6, 7]
    assert "all bodies are seen     not in 3 of 12 frames" in str(post)
    assert "all bodies are seen" not in str(post.at(4))
    assert post.diagnostics()["unexplained_frames"] == []


def test_the_less_is_seen_of_an_agent_the_less_sure_is_its_goal(event: ppl.Event) -> None:
    marginals = [infer(event).marginal("goal_red").values]
    for gap in (slice(5, 8), slice(4, 10)):
        marginals.append(infer(hidden(event, gap, 0)).marginal("goal_red").values)
    entropies = [float(entr(one).sum()) for one in marginals]
    assert entropies == sorted(entropies)
    assert entropies[0] < entropies[2] - 0.1


def test_watch_takes_frames_with_gaps_and_says_what_is_no_gap(event: ppl.Event) -> None:
    frames = hidden(event, slice(3, 5), 1).observation.trajectory
    odd = frames[1].copy()
    odd[2, 0] = np.nan
    with ppl.watch(event.scene, QUICK) as watch:
        watch.take(frames[0])
        with pytest.raises(
            InvalidEventError, match=r"frame 1\[2\] is \[nan, .*all three of a body"
        ):
            watch.take(odd)
        for frame in frames[1:6]:
            post = watch.update(frame)
    assert post.diagnostics()["unseen_frames"] == {"green agent": [3, 4]}


def test_frames_with_time_stamps_are_put_on_the_grid_while_watching(event: ppl.Event) -> None:
    frames = event.observation.trajectory
    times = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.8])
    with ppl.watch(event.scene, QUICK) as watch:
        with pytest.raises(InvalidEventError, match="time stamp nan"):
            watch.take(frames[0], at=float("nan"))
        watch.take(frames[0])  # what failed decides nothing
    with ppl.watch(event.scene, QUICK) as watch:
        counts = []
        for frame, at in zip(frames, times, strict=False):
            watch.take(frame, at=7.0 + at)
            counts.append(len(watch.posterior().observed()))
        with pytest.raises(InvalidSettingError, match="at=None for frame 10, expected time stamps"):
            watch.take(frames[6])
        with pytest.raises(InvalidEventError, match=r"time stamp 7\.8 after 7\.8"):
            watch.take(frames[6], at=7.8)
        post = watch.posterior()
    assert counts == [1, 1, 2, 3, 4, 10]
    batch = ppl.Observation.at_times(frames[:6], times)
    np.testing.assert_allclose(post.observed(), batch.trajectory)
    assert set(post.diagnostics()["unseen_frames"]["red agent"]) == set(range(4, 10))


@pytest.mark.parametrize(("fps", "pace"), [(12, ""), (60, "slow"), (5, "fast")])
def test_the_verdict_names_tracks_that_show_another_rate(fps: float, pace: str) -> None:
    whole = ppl.load_event("compete")
    track = whole.observation.trajectory
    at = np.arange(0, len(track) - 1, 12 / fps)[:70]
    seen = CubicSpline(range(len(track)), track)(at)
    event = dataclasses.replace(whole, observation=ppl.Observation(seen))
    warns = pytest.warns(UserWarning, match="at_rate") if pace else contextlib.nullcontext()
    with warns:
        found = infer(event, STINGY).diagnostics()
    assert found["odd_pace"] == pace
    assert ("Agents change their speed" in found["verdict"]) == bool(pace)
    if pace:
        assert found["trust"] == "do not trust"


def test_worlds_of_any_number_of_agents_are_read_with_gaps() -> None:
    world = ppl.worlds.TRIO
    scene = world.random_scene(1)
    frames = np.repeat(scene.start[None], 5, axis=0)
    frames[:, 0, 1] += 0.05 * np.arange(5) ** 2
    event = hidden(ppl.Event(scene, ppl.Observation(frames)), slice(2, 4), 0)
    post = infer(event)
    goal = f"goal_{world.agents[0].split()[0]}"
    np.testing.assert_allclose(post.at(3).marginal(goal).sum(), 1.0)


class OfLastSeen(Draws):
    """Goes on from where each body was seen last; items rest, and so may be unseen."""

    def expected(self, scene: ppl.Scene, hypothesis: Any, seen: FloatArray) -> FloatArray:
        last = seen[-1].copy()
        for frame in seen[::-1]:
            last = np.where(np.isnan(last), frame, last)
        return super().expected(scene, hypothesis, np.append(seen, last[None], axis=0))


class KnowsItsRest(OfLastSeen):
    """The same, as a density of what is seen, put in place of one of whole frames."""

    def log_prob_next(
        self, scene: ppl.Scene, hypothesis: Any, seen: FloatArray, frame: FloatArray
    ) -> float:
        off = (frame - self.expected(scene, hypothesis, seen))[:, :2] / SPREAD
        off = off[~np.isnan(off)]
        return float(-0.5 * (off**2).sum() - off.size * np.log(SPREAD * np.sqrt(2 * np.pi)))


FEW = ppl.Tracking(strengths=(300.0, 450.0))
GAPS = hidden(hidden(EVENT, slice(1, 3), 0), slice(2, 4), 3)


def test_of_samples_the_axes_of_unseen_bodies_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    by_samples = infer(GAPS, model(OfLastSeen(), samples=480, tracking=FEW))
    # the only density that there is otherwise is of whole frames, and so refused
    monkeypatch.setattr("phase_ppl.inference.closed_loop.has_density", lambda simulator: False)
    exact = infer(GAPS, model(KnowsItsRest(), tracking=FEW))
    for name in ("goal_red", "goal_green"):
        assert np.abs(by_samples.marginal(name) - exact.marginal(name)).sum() / 2 < 0.08


def test_a_density_of_whole_frames_refuses_gaps() -> None:
    with pytest.raises(InvalidEventError, match="frame 1 does not show all bodies, and log_prob"):
        infer(GAPS, model(Knows()))


def test_a_simulator_that_cannot_go_on_from_gaps_is_told_of_them() -> None:
    with pytest.raises(SimulationError, match="not finite; seen is NaN where a body was not seen"):
        infer(GAPS, model(Draws(), samples=20))


@pytest.mark.parametrize("world", [ppl.worlds.PHASE, ppl.worlds.SOLO], ids=["phase", "solo"])
def test_the_model_for_real_time_reads_any_world_by_a_prior_of_ones_own(world: ppl.World) -> None:
    scene = world.random_scene(2)
    searches = []
    for given in (ppl.Model.realtime("uniform"), ppl.Model()):
        with ppl.watch(scene, given) as watch:
            for _ in range(3):
                post = watch.update(scene.start)
        assert post.marginal("goal_red").sum() == pytest.approx(1)
        searches.append(post.cost["searches"])
    assert searches[0] < searches[1]
    assert ppl.Model.realtime().planner_config().simulations == 30
