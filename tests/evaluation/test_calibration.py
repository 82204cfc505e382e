"""Simulation-based calibration, on a model whose posterior is a sum over eighteen hypotheses."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.calibration import DOUBTFUL, _p_score
from phase_ppl.evaluation.doubt import log_probabilities
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, OutputError, SimulationError
from phase_ppl.world.hypothesis import RELATIONS
from tests.evaluation.toys import START
from tests.inference.toy import all_of_few_goals, few_goals

SCENE = ppl.Scene(start=START, radius=np.full(4, 0.8))
SPREAD = 1.0
N_FRAMES = 3
N = 200  # videos
QUIET: dict[str, Any] = {"frames": N_FRAMES, "scenes": SCENE, "workers": 1, "progress": False}


def means(goals: tuple[int, ...]) -> FloatArray:
    """Return (agent, xy) where the agents appear, by goals."""
    return SCENE.start[:2, :2] + np.stack([[np.cos(goal), np.sin(goal)] for goal in goals])


def appear(scene: ppl.Scene, hypothesis: Any, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Agents appear anywhere near a place of their goal's own in every frame."""
    yield scene.start
    while True:
        frame = scene.start.copy()
        frame[:2, :2] = means(hypothesis.effective_goals) + rng.normal(0, SPREAD, (2, 2))
        yield frame


def by_sum(spread: float, scene: ppl.Scene, observation: Any, seed: int) -> dict[str, FloatArray]:
    """Return the exact posterior, were the spread this one."""
    seen = observation.trajectory[1:, :2, :2]
    found = [
        (np.log(mass) - 0.5 * ((seen - means(h.effective_goals)) ** 2).sum() / spread**2, h)
        for mass, h in all_of_few_goals()
    ]
    best = max(log for log, _ in found)
    answers = {"goal_red": np.zeros(36), "goal_green": np.zeros(36), "relation": np.zeros(3)}
    for log, h in found:
        truth = ppl.Truth.of(h)
        for question, labels in (
            ("goal_red", ppl.GOALS), ("goal_green", ppl.GOALS), ("relation", RELATIONS),
        ):  # fmt: skip
            answers[question][labels.index(getattr(truth, question))] += np.exp(log - best)
    return {question: mass / mass.sum() for question, mass in answers.items()}


def reader(spread: float) -> Any:
    return functools.partial(by_sum, spread)


MODEL = ppl.Model(prior=few_goals, simulator=appear)


def calibrate(n: int, spread: float = SPREAD, **more: Any) -> ppl.Calibration:
    return ppl.calibrate(MODEL, n, reader=reader(spread), **{**QUIET, **more})


@pytest.fixture(scope="module")
def exact() -> ppl.Calibration:
    return calibrate(N)


def test_an_exact_posterior_is_calibrated(exact: ppl.Calibration) -> None:
    summary = exact.summary
    assert list(summary.index) == ["goal_red", "goal_green", "relation"]
    assert summary["verdict"].tolist() == [f"no deviation shown ({N} videos)"] * 3
    assert (summary["p_even"] > 0.01).all()
    assert (summary["p_score"] > 0.01).all()
    bins = exact.reliability("goal_red")
    assert bins["n"].sum() == N
    assert bins["probability"].between(bins["low"], bins["high"]).mean() >= 0.8
    told = exact.table
    assert told["rank"].between(0, told["n"]).all()
    assert told["place"].between(0, 1).all()


@pytest.mark.parametrize(
    ("spread", "verdict", "sign"),
    [(0.5, "too sure", -1), (2.5, "not sure enough", 1)],
    ids=["too narrow", "too wide"],
)
def test_a_wrong_noise_is_found(spread: float, verdict: str, sign: int) -> None:
    summary = calibrate(N, spread).summary
    said = summary.loc["goal_red", "verdict"]
    assert said.startswith(verdict)
    assert f" nats {'above' if sign > 0 else 'below'} expectation" in said
    right_minus_sure = summary["right"] - summary["confidence"]
    assert sign * right_minus_sure["goal_red"] > 0.03
    assert summary.loc["goal_red", "p_even"] < 0.05


@pytest.mark.parametrize(
    ("p", "wrong", "plausible"),
    [(0.99, 0, True), (0.99, 8, False), (1.0, 1, True), (0.8, 0, False)],
)
def test_scores_of_nearly_sure_answers_are_tested(p: float, wrong: int, plausible: bool) -> None:
    """100 of 100 answers of probability 0.99 are right in every third study of calibration."""
    said = np.tile([p, 1 - p, 0.0], (100, 1))
    logs, right = log_probabilities(said), np.arange(100) >= wrong
    gain = np.where(right, logs[:, 0], logs[:, 1]) - (said * logs).sum(axis=1)
    assert (_p_score(said, float(gain.sum())) > DOUBTFUL) is plausible


def test_it_is_kept_and_continued(tmp_path: Path) -> None:
    first = calibrate(4, out=tmp_path)
    with pytest.raises(OutputError, match="resume"):
        calibrate(4, out=tmp_path)
    more = calibrate(6, out=tmp_path, resume=True)
    assert more.table[: len(first.table)].equals(first.table)
    assert more.table.equals(calibrate(6).table), "as if never interrupted"
    assert len((tmp_path / "calibration.csv").read_text().splitlines()) == 1 + 6 * 3
    assert more.plot(tmp_path / "ranks.png").axes
    assert "6 videos drawn from prior and simulator" in str(more)


class Knows:
    """The closed loop's form of the same simulator, without whole simulations."""

    def next_frames(
        self, scene: ppl.Scene, hypothesis: Any, seen: FloatArray, rng: Any, n: int
    ) -> FloatArray:
        frames = np.repeat(scene.start[None], n, axis=0)
        frames[:, :2, :2] = means(hypothesis.effective_goals) + rng.normal(0, SPREAD, (n, 2, 2))
        return frames

    def log_prob_next(
        self, scene: ppl.Scene, hypothesis: Any, seen: FloatArray, frame: FloatArray
    ) -> float:
        off = (frame[:2, :2] - means(hypothesis.effective_goals)) / SPREAD
        return float(-0.5 * (off**2).sum())


def test_the_closed_loop_is_asked_about_strengths_too() -> None:
    model = ppl.Model(
        prior=few_goals, simulator=Knows(), likelihood=ppl.ClosedLoopLikelihood(weight=0.5)
    )
    found = ppl.calibrate(model, 3, **QUIET)
    table = found.table.set_index(["event", "quantity"])
    exact = ppl.calibrate(model, 3, reader=reader(SPREAD / np.sqrt(0.5)), **QUIET).table
    exact = exact.set_index(["event", "quantity"])
    np.testing.assert_allclose(table.loc[exact.index, "truth"], exact["truth"], atol=1e-6)
    strengths = table.xs("strength_red", level="quantity")
    assert strengths["place"].between(0, 1).all()
    assert strengths["truth"].isna().all()
    assert found.reliability("strength_red")["probability"].tolist() == [0.5, 0.8, 0.9, 0.95]
    assert any("a frame counts 0.5" in note for note in found.notes)
    assert str(found).split()[:3] == ["calibration", "closed", "loop:"]


class OnlyKnows:
    log_prob_next = Knows.log_prob_next


def test_what_cannot_be_drawn_is_said() -> None:
    beyond = ppl.Model(simulator=appear, likelihood=ppl.RadialLikelihood(0.05))
    density = ppl.Model(simulator=OnlyKnows(), likelihood=ppl.ClosedLoopLikelihood())
    for model, options, said in (
        (MODEL, {"scenes": []}, r"scenes=\[\]"),
        (MODEL, {"n": 0}, "n=0"),
        (beyond, {}, "none of 200 draws can be an event"),
        (density, {}, "draws no videos"),
    ):
        with pytest.raises((InvalidSettingError, SimulationError), match=said):
            ppl.calibrate(model, **{"n": 1, "reader": reader(SPREAD), **QUIET, **options})
