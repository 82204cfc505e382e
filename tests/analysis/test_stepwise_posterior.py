"""A posterior that was read step by step is the sum over all hypotheses, at any frame."""

from __future__ import annotations

import functools
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import rc_context

import phase_ppl as ppl
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.render.frames import PANEL
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, QueryError
from phase_ppl.world.goals import GOALS, N_GOALS, effective_goals
from phase_ppl.world.hypothesis import ALPHAS, RELATIONS, relation
from tests.analysis.readings import BLUE_NOT_TO_RED, BLUE_TO_RED, LEVELS, reading
from tests.render.test_video import read

FOUND = reading()


@functools.cache
def by_hand(frame: int) -> dict[tuple[int, int, int, int, int], float]:
    """Return the mass of every hypothesis: stated goals, alpha, strengths."""
    likelihood = FOUND["log_likelihood"].values[: frame + 1].sum(axis=0)
    log_prior, strengths = FOUND["log_prior"].values, FOUND["strengths"].values[frame]
    masses = {}
    for red, green, alpha, fr, fg in itertools.product(
        range(N_GOALS), range(N_GOALS), range(len(ALPHAS)), range(2), range(2)
    ):
        pair = effective_goals(red, green, ALPHAS[alpha])
        mass = np.exp(log_prior[red, green, alpha, fr, fg] + 0.5 * likelihood[pair])
        masses[red, green, alpha, fr, fg] = float(mass * strengths[fr, fg])
    total = sum(masses.values())
    return {hypothesis: mass / total for hypothesis, mass in masses.items()}


@pytest.mark.parametrize("frame", [0, 2, 3])
def test_every_answer_is_a_sum_over_hypotheses(frame: int) -> None:
    post, masses = StepwisePosterior(FOUND, frame), by_hand(frame)
    goals: dict[str, float] = dict.fromkeys(GOALS, 0.0)
    friendly = strong = 0.0
    for (red, green, alpha, fr, _), mass in masses.items():
        pair = effective_goals(red, green, ALPHAS[alpha])
        goals[GOALS[pair[0]]] += mass
        friendly += mass * (relation(*pair) == "friendly")
        strong += mass * (LEVELS[fr] == 600.0)
    marginal = post.marginal("goal_red")
    np.testing.assert_allclose(marginal.values, list(goals.values()), atol=1e-9)
    assert post.probability(relation="friendly") == pytest.approx(friendly, abs=1e-9)
    assert post.probability(strength_red=(500, 600)) == pytest.approx(strong, abs=1e-9)
    assert post.query("P(relation=friendly)") == pytest.approx(friendly, abs=1e-9)


def without_each() -> list[StepwisePosterior]:
    """Return what is read without each set of searches."""
    found = FOUND["log_likelihood_without"].values.astype(float)
    return [StepwisePosterior(reading(1, columns={"log_likelihood": one})) for one in found]


def test_errors_are_the_jackknife_over_sets_of_searches() -> None:
    post = StepwisePosterior(FOUND)
    shares = [alone.probability(relation="friendly") for alone in without_each()]
    expected = np.sqrt((3 - 1) * np.var(shares))
    assert expected > 0.001
    found = post.probability(relation="friendly")
    assert found.error == pytest.approx(expected, rel=1e-4)
    assert post.at(0).probability(relation="friendly").error == 0  # nothing was searched yet
    assert post.query("P(relation=friendly)").error == found.error
    for of_strengths in ("hdi strength_red", "E[strength_red]", "P(strength_red > 300)",
                         "P(relation=friendly and strength_red > strength_green)"):  # fmt: skip
        assert np.isnan(post.query(of_strengths).error).all(), "one filter follows strengths"
    one = StepwisePosterior(reading(planner_seeds=1))
    assert np.isnan(one.probability(relation="friendly").error)
    assert "With one set of searches nothing tells" in str(one)
    assert "± ?" in str(one)


def expected_errors(post: StepwisePosterior) -> list[float]:
    return [post.probability(relation=label).error for label in RELATIONS]


def test_over_time_is_the_posterior_at_each_frame() -> None:
    post = StepwisePosterior(FOUND)
    found = post.over_time()
    for frame in range(4):
        for name in ("goal_red", "goal_green", "relation", "scenario"):
            expected = post.at(frame).marginal(name)
            np.testing.assert_allclose(found[name].values[frame], expected, atol=1e-9)
        errors = found["relation_error"].values[frame]
        np.testing.assert_allclose(errors, expected_errors(post.at(frame)), rtol=1e-6, atol=1e-9)
    assert (found["relation_error"].values[-1] > 0.001).any()
    assert "filtering" in found.attrs
    assert len(post.at(1).over_time()["time"]) == 2
    one = StepwisePosterior(reading(planner_seeds=1)).over_time()
    assert np.isnan(one["relation_error"].values).all()


def test_the_best_hypothesis_leads_and_the_evidence_grows() -> None:
    post = StepwisePosterior(FOUND)
    assert post.map().effective_goals == (BLUE_TO_RED, BLUE_TO_RED)
    assert post.map_record()["goal_red"] == GOALS[BLUE_TO_RED]
    evidence = [post.at(frame).log_evidence for frame in range(4)]
    assert evidence[0] == pytest.approx(0, abs=1e-9)
    assert evidence[3] > evidence[0]
    # frames count in full, although the posterior tempers them
    prior = by_hand(0)
    likelihood = FOUND["log_likelihood"].values.sum(axis=0)
    strengths = FOUND["strengths"].values[-1] * 4
    total = sum(
        mass * np.exp(likelihood[effective_goals(red, green, ALPHAS[alpha])]) * strengths[fr, fg]
        for (red, green, alpha, fr, fg), mass in prior.items()
    )
    assert evidence[3] == pytest.approx(np.log(total))
    tempered = StepwisePosterior(reading(weight=0.1))
    assert tempered.log_evidence == pytest.approx(evidence[3])
    assert "tempered: a frame counts 0.1 for goals" in str(tempered)
    assert "tempered" not in str(StepwisePosterior(reading(weight=1.0)))


def test_what_is_tempered_is_said_of_goals_and_strengths() -> None:
    found = reading(weight=1.0)
    found.attrs["settings"] = json.dumps({"likelihood": {"tracking": {"strength_weight": 0.05}}})
    post = StepwisePosterior(found)
    tempering = "tempered: a frame counts 0.05 for strengths"
    assert post.tempering == tempering
    assert tempering in str(post)
    assert "nats, every frame counted in full, for strengths 0.05" in str(post)
    assert post.why("relation=friendly").attrs["tempering"] == tempering
    assert post.over_time().attrs["tempering"] == tempering


def test_why_gives_the_log_odds_and_who_changed_them() -> None:
    post, names = StepwisePosterior(FOUND), ("to red lm", "away from red lm")
    found = post.why(*(f"goal_red=Get blue item {name}" for name in names))
    for frame in range(4):
        at = post.at(frame).marginal("goal_red").values
        odds = np.log(at[BLUE_TO_RED] / at[BLUE_NOT_TO_RED])
        assert found["log_odds"].values[frame] == pytest.approx(odds)
    np.testing.assert_allclose(np.diff(found["log_odds"]), found["change"].values[1:])
    assert found["change"].values[0] == 0
    alone = post.why("relation=friendly")
    share = post.probability(relation="friendly")
    assert alone["log_odds"].values[-1] == pytest.approx(np.log(share / (1 - share)))


def test_log_odds_have_the_jackknifes_error_over_the_sets_of_searches() -> None:
    found = StepwisePosterior(FOUND).why("relation=friendly")
    odds = np.array([post.why("relation=friendly")["log_odds"].values for post in without_each()])
    expected = np.sqrt((len(odds) - 1) / len(odds) * ((odds - odds.mean(axis=0)) ** 2).sum(axis=0))
    np.testing.assert_allclose(found["error"].values, expected, rtol=1e-6, atol=1e-9)
    assert (found["error"].values[1:] > 0).all()
    single = StepwisePosterior(reading(planner_seeds=1)).why("relation=friendly")
    assert np.isnan(single["error"].values).all()


@pytest.mark.parametrize(
    ("event", "error", "message"),
    [
        ("relation", QueryError, "expected =, !="),
        ("relation=cordial", QueryError, "cordial"),
        ("relation=friendly | alpha=(1, 0)", QueryError, "'or' or the end"),
        ("goal_red=get to red agent", InvalidSettingError, "impossible under the prior"),
        ("strength_red > 0", InvalidSettingError, "^not strength_red > 0 is impossible"),
    ],
)
def test_what_has_no_odds_is_refused(event: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        StepwisePosterior(FOUND).why(event)


def test_it_is_saved_and_read_again(tmp_path: Path) -> None:
    post = StepwisePosterior(FOUND)
    file = post.save(tmp_path / "found.nc")
    for again in (StepwisePosterior.load(file), ppl.load_posterior(file)):
        assert isinstance(again, StepwisePosterior)
        np.testing.assert_array_equal(
            again.joint("goal_red", "relation"), post.joint("goal_red", "relation")
        )
        assert str(again) == str(post)
    with pytest.raises(InvalidEventError, match="read step by step: load_posterior"):
        ppl.Posterior.load(file)
    with pytest.raises(InvalidSettingError, match="no draws"):
        ppl.load_posterior(file, "count")
    content = bytearray(file.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 64] = bytes(64)
    file.write_bytes(content)
    with pytest.raises(InvalidEventError):
        StepwisePosterior.load(file)


def test_the_verdict_leads_with_the_worst_sign() -> None:
    def diagnosed(**columns: Any) -> dict[str, Any]:
        return StepwisePosterior(reading(columns=columns)).diagnostics()

    fine = diagnosed()
    assert fine["unexplained_frames"] == fine["overlapping_frames"] == []
    assert fine["verdict"].startswith("Actions explain every frame")
    poses = FOUND["trajectory"].values.copy()
    poses[2, 0, :2] = poses[2, 1, :2]  # red lies on green
    lying = diagnosed(trajectory=poses)
    assert lying["overlapping_frames"] == [2]
    assert lying["verdict"].startswith("Bodies lie on each other or in a wall in frame 2,")
    torn = diagnosed(unexplained=np.array([0.0, 1.0, 40.0, 1.0]), trajectory=poses)
    assert torn["unexplained_frames"] == [2]
    assert torn["verdict"].startswith("No action explains frame 2:")
    assert "Bodies lie" in torn["verdict"]
    odd = diagnosed(log_peak=np.full(4, 60.0))
    assert odd["surprising_share"] == 1.0
    assert odd["verdict"].startswith("100% of the frames surprise")
    without = FOUND["log_likelihood_without"].values.copy()
    without[0, 1:, BLUE_NOT_TO_RED, BLUE_TO_RED] += 30.0
    split = diagnosed(log_likelihood_without=without)
    assert "sets of searches disagree" in split["verdict"]
    for found in (lying, torn, odd, split):
        assert "Actions explain every frame" not in found["verdict"]
    text = str(StepwisePosterior(FOUND))
    assert text.index("verdict") < text.index(fine["verdict"][-20:]) < text.index("relation  ")


def test_what_is_no_reading_is_refused() -> None:
    nan = FOUND["log_likelihood"].values * np.nan
    for found, said in (
        (FOUND.drop_vars("held"), "lacks held"),
        (reading(schema="other"), "schema is 'other'"),
        (reading(columns={"log_likelihood": nan}), "no log densities"),
    ):
        with pytest.raises(InvalidEventError, match=said):
            StepwisePosterior(found)


def test_figures_and_film(tmp_path: Path) -> None:
    post = StepwisePosterior(FOUND)
    figure = ppl.plot.why(post, "relation=friendly", "relation=adversarial", tmp_path / "why.png")
    assert len(figure.axes) >= 3
    ppl.plot.over_time(post, tmp_path / "over_time.png")
    ppl.plot.posterior(post, tmp_path / "posterior.png")
    with rc_context({"figure.dpi": 150}):  # a user's own, which films do not follow
        film = ppl.watch_film(post, tmp_path / "watch.mp4")
    _, frames = read(film.path)
    assert frames.shape[2] < 2.1 * PANEL
    assert all(file.stat().st_size > 1000 for file in tmp_path.iterdir())
    assert len(list(tmp_path.iterdir())) == 4


def test_medians_and_mutual_information() -> None:
    post, masses = StepwisePosterior(FOUND), by_hand(3)
    joint = np.zeros((N_GOALS, N_GOALS))
    for (red, green, alpha, _, _), mass in masses.items():
        joint[effective_goals(red, green, ALPHAS[alpha])] += mass
    apart = joint.sum(axis=1, keepdims=True) * joint.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.nansum(joint * np.log(joint / apart))
    found = post.query("I(goal_red; goal_green)")
    assert found == pytest.approx(expected, abs=1e-6)
    assert found == pytest.approx(post.mutual_information("goal_green", "goal_red"))
    assert found.error > 0
    assert post.query("I(goal_red; relation | goal_red=get to green agent)") == pytest.approx(0)
    strong = sum(mass for (*_, fr, _), mass in masses.items() if fr == 1)
    assert post.query("median strength_red") == LEVELS[int(strong > 0.5)]
    with pytest.raises(QueryError, match="';' and another"):
        post.query("I(goal_red)")
    with pytest.raises(QueryError, match="categories, not numbers"):
        post.query("median(goal_red)")


def test_comparisons_and_definitions_hold_at_every_frame_in_why_and_in_files(
    tmp_path: Path,
) -> None:
    post = StepwisePosterior(FOUND)
    post.define("red_leads", "strength_red > strength_green")
    post.define("same", lambda h: h.goal_red == h.goal_green)
    last, before = post.query("P(red_leads=True)"), post.at(0).query("P(red_leads=True)")
    assert last == pytest.approx(0.3, abs=1e-3)  # the filter's, as the prior of both is flat
    assert before == pytest.approx(0.25)
    assert np.isnan(last.error)  # one filter follows strengths
    odds = post.why("same=True", over="not goal_red = goal_green")["log_odds"].values
    assert odds[-1] == pytest.approx(post.why("same=True")["log_odds"].values[-1])
    share = post.query("P(goal_red = goal_green)")
    assert odds[-1] == pytest.approx(np.log(share / (1 - share)), abs=1e-6)
    again = StepwisePosterior.load(post.save(tmp_path / "x.nc"))
    assert list(again.definitions) == ["red_leads"]
    assert again.query("P(red_leads=True)") == last
    with pytest.raises(InvalidSettingError, match="no draws to be weighted"):
        post.query("P(relation)", weights="count")


def test_a_video_of_one_frame_says_what_was_believed_before_it() -> None:
    one = FOUND.isel(time=slice(0, 1))
    post = StepwisePosterior(one)
    assert post.surprise().tolist() == [0.0]
    assert "Nothing was seen but the start" in post.diagnostics()["verdict"]


@pytest.mark.parametrize("frame", [1.5, "2", True, -1, 4])
def test_frames_that_there_are_not_are_refused(frame: Any) -> None:
    with pytest.raises(InvalidSettingError, match="frame="):
        StepwisePosterior(FOUND).at(frame)
