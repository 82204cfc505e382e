"""Agreement of models with people's answers, and of people with each other."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.spatial.distance import jensenshannon
from scipy.stats import entropy, pearsonr

from phase_ppl.evaluation.bootstrap import correlation, resampled
from phase_ppl.evaluation.doubt import jensen_shannon, rows_of, same_truth, split_half
from phase_ppl.evaluation.metrics import evaluate_predictions
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import RELATIONS
from tests.evaluation.judged import (
    BLUE_TO_GREEN,
    BLUE_TO_RED,
    COLLABORATIVE,
    COMPETING,
    INDEPENDENT,
    OPPOSING,
    PINK_TO_BLUE,
    by_id,
    make_event,
    shares,
)

VOTES = [[8, 2, 0], [4, 4, 2], [1, 0, 9], [0, 5, 5], [10, 0, 0], [3, 1, 6]]
MODEL = [[0.9, 0.1, 0], [0.5, 0.2, 0.3], [0, 0, 1], [0.3, 0.3, 0.4], [0.6, 0.4, 0], [0.2, 0, 0.8]]
TRUTH = [COLLABORATIVE, COLLABORATIVE, COMPETING, INDEPENDENT, COLLABORATIVE, OPPOSING]
PEOPLE = np.array(VOTES) / 10


def events(truth: list[tuple[str, str]] = TRUTH) -> list[Event]:
    return [make_event(str(i), goals, VOTES[i]) for i, goals in enumerate(truth)]


def model(probabilities: list[list[float]] = MODEL) -> dict[str, Prediction]:
    return by_id(*(shares(str(i), relation=row) for i, row in enumerate(probabilities)))


def human(made: dict[str, Prediction] | None = None) -> dict[str, Any]:
    return evaluate_predictions(events(), made or model())["human"]  # type: ignore[no-any-return]


def deviations(values: Any, groups: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (event, answer) values less their mean over the events of the same group."""
    found = np.array(values, float)
    for group in np.unique(groups):
        found[groups == group] -= found[groups == group].mean(axis=0)
    return found


RELATION = np.array([0, 0, 2, 1, 0, 2])  # of TRUTH


def test_figures_about_relations_are_those_of_scipy() -> None:
    found = human()
    bits = [jensenshannon(m, h, base=2) ** 2 for m, h in zip(MODEL, PEOPLE, strict=True)]
    scores = [np.repeat(np.log(0.99 * np.array(m) + 0.01 / 3), v).mean()
              for m, v in zip(MODEL, VOTES, strict=True)]  # fmt: skip
    left = [deviations(values, RELATION).ravel() for values in (MODEL, PEOPLE)]
    expected = {
        "relation_r": pearsonr(np.ravel(MODEL), PEOPLE.ravel()).statistic,
        "relation_r_given_truth": pearsonr(*left).statistic,
        "js": np.mean(bits),
        "log_score": np.mean(scores),
        "log_score_people": -np.mean([entropy(h) for h in PEOPLE]),
    }
    for name, value in expected.items():
        assert found[name]["value"] == pytest.approx(value, abs=1e-12), name
        assert found[name]["ci_low"] < value < found[name]["ci_high"]
    assert found["goal_r"] is None
    apart = jensen_shannon(np.array([[1.0, 0, 0]]), np.array([[0, 0.5, 0.5]]))
    assert apart == pytest.approx(1)


@pytest.mark.parametrize(("by_truth", "drawn"), [(False, True), (True, False)])
def test_resampled_r_is_that_of_the_drawn_events(by_truth: bool, drawn: bool) -> None:
    """Also with the means of the groups in the resample, and with people of its own for each."""
    weights = resampled(6, seed=3, resamples=20)
    people = np.stack([PEOPLE] * 21)
    if drawn:
        people = np.random.default_rng(0).dirichlet(np.ones(3), (21, 6))
    groups = same_truth(RELATION, 3) if by_truth else None
    found = correlation(weights, MODEL, people if drawn else PEOPLE, groups)
    for row, shares_, value in zip(weights.astype(int), people, found, strict=True):
        rows = np.repeat(np.arange(6), row)
        x, y = np.array(MODEL)[rows], shares_[rows]
        if by_truth:
            x, y = (deviations(values, RELATION[rows]) for values in (x, y))
        assert value == pytest.approx(pearsonr(x.ravel(), y.ravel()).statistic, abs=1e-9)


def test_goal_r_is_over_both_agents_and_all_36_goals() -> None:
    counts = [
        {"red agent": {BLUE_TO_RED: 3, PINK_TO_BLUE: 1}, "green agent": {BLUE_TO_RED: 4}},
        {"red agent": {BLUE_TO_RED: 2}, "green agent": {BLUE_TO_GREEN: 1, PINK_TO_BLUE: 3}},
    ]
    said = [
        [{BLUE_TO_RED: 0.5, BLUE_TO_GREEN: 0.5}, {BLUE_TO_RED: 1.0}],
        [{PINK_TO_BLUE: 0.8, BLUE_TO_RED: 0.2}, {BLUE_TO_GREEN: 0.6, PINK_TO_BLUE: 0.4}],
    ]
    watched = [
        make_event(str(i), COLLABORATIVE, judgments={"goal_counts": one})
        for i, one in enumerate(counts)
    ]
    made = by_id(*(shares(str(i), goal_red=r, goal_green=g) for i, (r, g) in enumerate(said)))

    def flat(rows: list[list[dict[str, float]]]) -> NDArray[np.float64]:
        parts = [[row.get(goal, 0) for goal in GOALS] for pair in rows for row in pair]
        return np.array([np.array(part) / sum(part) for part in parts]).ravel()

    x, y = flat(said), flat([list(one.values()) for one in counts])  # type: ignore[arg-type]
    assert x.shape == (72 * 2,)
    found = evaluate_predictions(watched, made)["human"]
    assert found["goal_r"]["value"] == pytest.approx(pearsonr(x, y).statistic, abs=1e-12)
    assert found["relation_r"] is None
    mixed = 0.99 * x + 0.01 / 36
    assert found["goal_log_score"]["value"] == pytest.approx((y * np.log(mixed)).sum() / 4)
    pairs = zip(x.reshape(4, 36), y.reshape(4, 36), strict=True)
    distances = [jensenshannon(*pair, base=2) for pair in pairs]
    assert found["goal_js"]["value"] == pytest.approx(np.mean(np.square(distances)))


def test_people_themselves_agree_and_r_of_what_is_constant_is_none() -> None:
    themselves = human(model(PEOPLE.tolist()))
    bound = themselves["log_score_people"]["value"]
    assert bound - 0.05 < themselves["log_score"]["value"] < bound, "but for the lapse"
    assert themselves["js"]["value"] == pytest.approx(0, abs=1e-12)
    assert themselves["relation_r"]["value"] == pytest.approx(1)
    right = human(model(np.eye(3)[RELATION].tolist()))
    assert right["relation_r"]["value"] > 0.8
    assert right["relation_r_given_truth"] is None  # to be right is not rewarded
    flat = human(model([[1 / 3] * 3] * 6))
    assert flat["relation_r"] is None
    assert flat["log_score"]["value"] == pytest.approx(np.log(1 / 3))


def split(votes: list[list[int]], chosen: Any = None, splits: int = 4000) -> float:
    """Return r of halves of votes (video, relation), or of people (who, video) with choices."""
    people = None
    if chosen is not None:
        said = [(v, who, "relation", RELATIONS[answer], 1.0)
                for who, row in enumerate(chosen) for v, answer in enumerate(row)]  # fmt: skip
        given = pd.DataFrame(said, columns=["event", "who", "question", "label", "value"])
        people = rows_of(given, range(len(votes)), ["relation"])
    counts = np.array(votes, int).reshape(len(votes), 1, 3)
    return float(split_half(counts, np.ones((1, len(votes))), people, splits=splits)[0][0])


def test_split_half_is_the_mean_over_all_ways_to_split_the_votes() -> None:
    """Two videos with four votes each: all 6 x 6 splits, by hand."""
    ballots = [[0, 0, 0, 1], [0, 1, 2, 2]]
    found = []
    for chosen in itertools.product(itertools.combinations(range(4), 2), repeat=2):
        halves = np.zeros((2, 2, 3))
        for video, (ballot, first) in enumerate(zip(ballots, chosen, strict=True)):
            for rater, answer in enumerate(ballot):
                halves[0 if rater in first else 1, video, answer] += 0.5
        found.append(pearsonr(halves[0].ravel(), halves[1].ravel()).statistic)
    assert split([[3, 1, 0], [1, 1, 2]]) == pytest.approx(np.mean(found), abs=0.02)


def test_split_half_by_participants_keeps_the_answers_of_one_together() -> None:
    """Two always see friends, two always foes: halves by people, 4 of 6 splits agree exactly."""
    video, other, chosen = [2, 0, 2], [0, 4, 0], [[0, 1], [0, 1], [2, 1], [2, 1]]
    even = pearsonr([0.5, 0, 0.5, 0, 1, 0], [0.5, 0, 0.5, 0, 1, 0]).statistic
    odd = pearsonr([1, 0, 0, 0, 1, 0], [0, 0, 1, 0, 1, 0]).statistic
    expected = (4 * even + 2 * odd) / 6
    assert split([video, other], chosen) == pytest.approx(expected, abs=0.03)
    # votes of eight such videos, split on their own, even out; those of people do not
    eight = [[row[0]] * 8 for row in chosen]
    assert split([video] * 8, eight) == pytest.approx((4 * 1 + 2 * -0.5) / 6, abs=0.03)


def test_unanimous_people_agree_and_single_raters_have_no_halves() -> None:
    assert split([[6, 0, 0], [0, 6, 0]]) == pytest.approx(1)
    assert np.isnan(split([[1, 0, 0], [0, 0, 0]]))
    assert np.isnan(split([]))
