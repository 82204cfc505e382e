"""Accuracy, rankings, confusion and ties of predictions, with error bars."""

from __future__ import annotations

import itertools
import json
from typing import Any

import numpy as np
import pytest
from scipy import stats

from phase_ppl.evaluation.bootstrap import (
    Measure,
    clopper_pearson,
    difference,
    measure,
    proportion,
    resampled,
    weighted_mean,
)
from phase_ppl.evaluation.comparison import _tested
from phase_ppl.evaluation.metrics import evaluate_predictions, human_accuracy
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.world.errors import PhasePPLError
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import SCENARIOS
from tests.evaluation.judged import (
    BLUE_TO_GREEN,
    BLUE_TO_RED,
    COLLABORATIVE,
    COMPETING,
    INDEPENDENT,
    OPPOSING,
    PINK_TO_BLUE,
    answers,
    by_id,
    differences,
    make_event,
    shares,
    values,
)

EVENTS = [
    make_event("a", COLLABORATIVE),
    make_event("b", COLLABORATIVE),
    make_event("c", COMPETING),
    make_event("d", INDEPENDENT),
]
ANSWERS = by_id(
    answers("a", *COLLABORATIVE, relation="friendly"),
    answers("b", BLUE_TO_RED, PINK_TO_BLUE, relation="friendly"),
    answers("c", *COLLABORATIVE, relation="friendly"),
    answers("d", PINK_TO_BLUE, BLUE_TO_RED, relation="neutral"),
)


def alike(n: int) -> list[Event]:
    """Return collaborative events, called 0, 1, ..."""
    return [make_event(str(i), COLLABORATIVE) for i in range(n)]


def relations(n: int, right: int) -> dict[str, Prediction]:
    """Return answers about the relation of :func:`alike` events, the first of them right."""
    said = ["friendly"] * right + ["neutral"] * (n - right)
    return by_id(*(answers(str(i), relation=one) for i, one in enumerate(said)))


def test_accuracies_are_shares_by_true_scenario() -> None:
    metrics = evaluate_predictions(EVENTS, ANSWERS)
    assert metrics["n_events"] == 4
    assert values(metrics, "goal_accuracy", "relation_accuracy") == [(2 + 1 + 1 + 0) / 8, 3 / 4]
    by_scenario = metrics["by_scenario"]
    assert list(by_scenario) == list(SCENARIOS)
    assert by_scenario["collaborative"]["n"] == 2
    goals = [f"{name}.goal_accuracy" for name in SCENARIOS]
    assert values(by_scenario, *goals) == [3 / 4, 0, 1 / 2, None]
    assert values(by_scenario, "collaborative.relation_accuracy") == [1]
    assert {figure for name, figure in by_scenario["opposing"].items() if name != "n"} == {None}
    # a single event has no interval, nor has a scenario that a single event has
    assert by_scenario["competing"]["goal_accuracy"]["ci_low"] is None
    assert by_scenario["collaborative"]["goal_accuracy"]["ci_low"] is not None
    alone = evaluate_predictions(EVENTS[:1], ANSWERS)["goal_accuracy"]
    assert alone == {"value": 1, "ci_low": None, "ci_high": None}


@pytest.mark.parametrize("n", [5, 50])
def test_intervals_of_accuracies_cover(n: int) -> None:
    """Of relations (None), of goals of which the second is the first's this often, of shares."""
    rng = np.random.default_rng(0)

    def share_covered(scores: np.ndarray, p: float) -> float:
        found = [proportion(one) for one in scores]
        return float(np.mean([one["ci_low"] <= p <= one["ci_high"] for one in found]))  # type: ignore[index,operator]

    # 600 draws of a coverage of 0.945, the least of many more draws, are below this once in 200
    for p, alike in itertools.product((0.6, 0.97), (None, 0.0, 0.5)):
        scores = (rng.random((600, n, 1 if alike is None else 2)) < p).astype(float)
        if alike is not None:
            scores[..., 1] = np.where(rng.random((600, n)) < alike, scores[..., 0], scores[..., 1])
        assert share_covered(scores, p) >= 0.92, (p, alike)
    assert share_covered(rng.beta(5.4, 0.6, size=(600, n, 1)), 0.9) >= 0.92


def test_goals_that_go_together_say_no_more_than_one() -> None:
    """Both goals right or both wrong: the interval is as wide as of one answer per event."""
    made = relations(40, right=30)
    for i in range(40):
        goals = COLLABORATIVE if i < 30 else OPPOSING
        made[str(i)] = answers(str(i), *goals, relation=made[str(i)].answers["relation"])
    metrics = evaluate_predictions(alike(40), made)
    exact = stats.binomtest(30, 40).proportion_ci(method="exact")
    found = metrics["relation_accuracy"]
    assert metrics["goal_accuracy"] == found
    assert list(found.values()) == pytest.approx([0.75, exact.low, exact.high])
    right = np.repeat([1.0, 0.0], 20)
    apart = proportion(np.stack([right, np.tile([1.0, 0.0], 20)], axis=1))
    exact = stats.binomtest(40, 80).proportion_ci(method="exact")
    assert apart is not None
    assert (apart["ci_low"], apart["ci_high"]) == pytest.approx((exact.low, exact.high))
    # as often as both answers are there, one says no more: (sum n)^2 / sum n^2 = 25 / 9
    some = proportion([[1.0, np.nan], [1.0, 1.0], [0.0, 0.0]])
    assert some is not None
    assert (some["ci_low"], some["ci_high"]) == pytest.approx(clopper_pearson(15 / 9, 25 / 9))


def test_top3_needs_a_probability() -> None:
    events = [make_event("a", INDEPENDENT), make_event("b", INDEPENDENT)]
    third = {BLUE_TO_GREEN: 0.5, PINK_TO_BLUE: 0.3, BLUE_TO_RED: 0.2}
    fourth = {BLUE_TO_GREEN: 0.4, PINK_TO_BLUE: 0.3, GOALS[7]: 0.2, BLUE_TO_RED: 0.1}
    made = by_id(
        shares("a", goal_red=third, goal_green=third),
        shares("b", goal_red=fourth, goal_green={BLUE_TO_GREEN: 1.0}),
    )
    found = values(evaluate_predictions(events, made), "goal_top3_accuracy", "goal_accuracy")
    assert found == [2 / 4, 0]
    # the first goals in label order would be second and third, of probability 0
    sure = by_id(shares("a", goal_red={PINK_TO_BLUE: 1.0}))
    first = make_event("a", (GOALS[0], PINK_TO_BLUE))
    assert evaluate_predictions([first], sure)["goal_top3_accuracy"]["value"] == 0


def test_ties_go_to_the_first_in_label_order() -> None:
    events = [make_event("a", COLLABORATIVE), make_event("b", COMPETING)]
    tied = by_id(*(shares(name, relation=[0.4, 0.2, 0.4]) for name in "ab"))
    metrics = evaluate_predictions(events, tied)
    assert metrics["relation_accuracy"]["value"] == 1 / 2


def test_log_score_of_the_truth_has_a_lapse_of_one_in_a_hundred() -> None:
    events = [make_event("a", COLLABORATIVE), make_event("b", COMPETING)]
    made = by_id(
        shares("a", relation=[0.5, 0.3, 0.2], goal_red={BLUE_TO_RED: 1}),
        shares("b", relation=[1, 0, 0], goal_red={BLUE_TO_RED: 0.25, BLUE_TO_GREEN: 0.75}),
    )
    metrics = evaluate_predictions(events, made)
    relation = (np.log(0.99 * 0.5 + 0.01 / 3) + np.log(0.01 / 3)) / 2
    goal = (np.log(0.99 + 0.01 / 36) + np.log(0.99 * 0.25 + 0.01 / 36)) / 2
    found = values(metrics, "relation_log_score_truth", "goal_log_score_truth")
    assert found == pytest.approx([relation, goal], abs=1e-12)
    competing = metrics["by_scenario"]["competing"]["relation_log_score_truth"]
    assert competing == {"value": pytest.approx(np.log(0.01 / 3)), "ci_low": None, "ci_high": None}
    sure = metrics["calibration"]["relation"]
    of_sure = {least: one["n"] for least, one in sure.items()}
    assert of_sure == {"0": 2, "0.5": 2, "0.8": 1, "0.95": 1}
    assert sure["0.8"]["accuracy"]["value"] == 0
    # an answer that is given beside probabilities has its own, whatever is more probable
    given = Prediction("a", {"relation": [0.1, 0.9, 0.0]}, {"relation": "friendly"})
    sure = evaluate_predictions(events[:1], {"a": given})["calibration"]["relation"]
    assert list(sure) == ["0"]
    assert (sure["0"]["probability"], sure["0"]["accuracy"]["value"]) == (0.1, 1)


def test_only_what_is_answered_counts() -> None:
    made = {name: ANSWERS[name] for name in ("b", "c")}
    metrics = evaluate_predictions(EVENTS, made)
    assert (metrics["n_events"], metrics["n"]["events"]) == (2, 4)
    assert metrics["goal_accuracy"]["value"] == 2 / 4
    assert metrics["by_scenario"]["independent"]["n"] == 0
    assert metrics == {**evaluate_predictions(EVENTS[1:3], ANSWERS), "n": metrics["n"]}
    # a goal that is not given is not wrong
    made = by_id(answers("a", BLUE_TO_RED), answers("b", PINK_TO_BLUE, BLUE_TO_RED))
    metrics = evaluate_predictions(EVENTS, made)
    assert metrics["goal_accuracy"]["value"] == 2 / 3
    assert metrics["relation_accuracy"] is None


def test_without_truth_judgments_or_predictions_figures_are_none() -> None:
    def figures(part: object) -> list[object]:
        if isinstance(part, dict) and "value" not in part:
            return [one for entry in part.values() for one in figures(entry)]
        return [part]

    unknown = [make_event("a", None), make_event("b", None)]
    for events, made in ((unknown, ANSWERS), (EVENTS, {}), ([], {})):
        metrics = evaluate_predictions(events, made)
        of_counts = ("n", "n_events", "by_scenario")
        assert set(figures({k: v for k, v in metrics.items() if k not in of_counts})) == {None}
        for part in metrics["by_scenario"].values():
            assert part.pop("n") == 0
            assert set(part.values()) == {None}
        json.dumps(metrics, allow_nan=False)
    metrics = evaluate_predictions([EVENTS[0], unknown[1]], ANSWERS)
    assert (metrics["n_events"], metrics["n"]["truth"]) == (2, 1)
    assert metrics["goal_accuracy"]["value"] == 1


def test_what_cannot_be_is_refused() -> None:
    cases: tuple[tuple[Any, str], ...] = (
        ({"seed": -1}, "seed"),
        ({"predictions": {"a": ANSWERS["b"]}}, "'a' is of the event 'b'"),
        ({"events": [EVENTS[0]] * 2}, "two events with the id 'a'"),
    )
    for given, message in cases:
        with pytest.raises(PhasePPLError, match=message):
            evaluate_predictions(**{"events": EVENTS, "predictions": ANSWERS, **given})


# --- differences -------------------------------------------------------------------------------


def test_difference_is_paired() -> None:
    """Each model's accuracy varies with the events drawn; their difference here does not."""
    one, other = (
        by_id(*(answers(str(i), red, (PINK_TO_BLUE, BLUE_TO_RED)[i % 2]) for i in range(20)))
        for red in (BLUE_TO_RED, PINK_TO_BLUE)
    )
    found = differences(alike(20), one, other, resamples=999)["goal_accuracy"]
    assert found["value"] == pytest.approx(0.5)
    # two further events could speak for either side
    assert (found["ci_low"], found["ci_high"]) == pytest.approx((7 / 22, 13 / 22))
    assert found["p"] < 0.01
    equal = differences(EVENTS, ANSWERS, ANSWERS)["goal_accuracy"]
    assert (equal["value"], equal["p"]) == (0, 1)
    assert equal["ci_low"] == -equal["ci_high"] < 0


def test_p_is_small_only_where_the_difference_is_clear() -> None:
    clear, unclear = (
        differences(alike(30), relations(30, right), relations(30, 0))["relation_accuracy"]
        for right in (12, 2)
    )
    assert clear["p"] < 0.01 < 0.2 < unclear["p"]
    assert unclear["ci_low"] < 0 < clear["ci_low"]
    # a few events that agree are no more than their signs
    for n, least in ((2, 1 / 2), (3, 1 / 4), (5, 1 / 16)):
        for right in (0, n):
            one, other = relations(n, right), relations(n, n - right)
            assert differences(alike(n), one, other)["relation_accuracy"]["p"] == least


def test_difference_is_over_what_both_answer() -> None:
    one = by_id(answers("a", BLUE_TO_RED, PINK_TO_BLUE), answers("b", BLUE_TO_RED))
    other = by_id(
        answers("a", BLUE_TO_RED, relation="friendly"),
        answers("b", PINK_TO_BLUE, BLUE_TO_RED),
        answers("c", *COMPETING),
    )
    found = differences(EVENTS, one, other)
    # red's goal in a (both right) and in b (one right, other wrong)
    assert (found["goal_accuracy"]["value"], found["goal_accuracy"]["n_events"]) == (1 / 2, 2)
    assert "relation_accuracy" not in found
    assert differences(EVENTS, one, {}) == {}


# --- intervals and tests against the binomial law, summed over all that can come out --------------

N = 50  # events
WEIGHTS = resampled(N, resamples=2000)


def wrong_more_often(k: int) -> np.ndarray:
    """Return resampled differences of a model that errs about k events from one that never does."""
    return weighted_mean(WEIGHTS, -(np.arange(N)[:, None] < k).astype(float))


def of_shares(k: int) -> Measure:
    values = wrong_more_often(k)
    found = difference(values, 0 * values, N, of_shares=True)
    assert found is not None
    return found


def test_intervals_of_differences_of_shares_hold_them() -> None:
    k = np.arange(N + 1)
    found = [of_shares(int(wrong)) for wrong in k]
    for share in (0.02, 0.06, 0.1, 0.3):
        held = np.array([one["ci_low"] <= -share <= one["ci_high"] for one in found])  # type: ignore[operator]
        assert stats.binom.pmf(k, N, share)[held].sum() > 0.945, share


@pytest.mark.parametrize(("n", "apart"), [(10, 0.6), (50, 0.1)])
def test_models_that_are_equally_good_differ_in_one_of_twenty_cases(n: int, apart: float) -> None:
    """They are apart on that share of events; p is below 0.05 where the interval leaves out 0."""
    weights, events = resampled(n, resamples=1000), np.arange(n)
    rejected = 0.0
    for one, other in itertools.product(range(n + 1), repeat=2):
        chance = stats.multinomial.pmf(
            [one, other, n - one - other], n, [apart / 2, apart / 2, 1 - apart]
        )
        if chance < 1e-4:
            continue
        values = weights @ ((events < one) * 1.0 - (events >= n - other)) / n
        found = difference(values, 0 * values, n, of_shares=True)
        assert found is not None
        low, high, p = found["ci_low"], found["ci_high"], found["p"]
        assert abs(p - 0.05) < 0.01 or (p < 0.05) == (low > 0 or high < 0)  # type: ignore[operator]
        rejected += chance * (p <= 0.05)  # type: ignore[operator]
    assert rejected <= 0.05


def test_means_of_few_events_lie_in_their_intervals_as_often_as_these_say() -> None:
    n = 10
    # means of resamples spread by sqrt((n - 1) / n) of what Student's interval goes by
    t, spread = stats.t.ppf(0.975, n - 1), np.sqrt((n - 1) / n)
    drawn = np.append(0.0, spread * stats.norm.ppf((np.arange(1e5) + 0.5) / 1e5))
    ends, moved = measure(drawn, n), difference(drawn + t, 0 * drawn, n)
    assert ends is not None
    assert moved is not None
    assert (ends["ci_low"], ends["ci_high"]) == pytest.approx((-t, t), rel=1e-3)
    assert moved["p"] == pytest.approx(0.05, rel=0.01)
    rng, runs = np.random.default_rng(1), 1000
    inside = apart = 0
    for seed in range(runs):
        one, other = rng.normal(size=(2, n))
        weights = resampled(n, seed, 400)
        of_one, of_other = weighted_mean(weights, one), weighted_mean(weights, other)
        found, differ = measure(of_one, n), difference(of_one, of_other, n)
        assert found is not None
        assert differ is not None
        inside += found["ci_low"] < 0 < found["ci_high"]  # type: ignore[operator]
        apart += differ["p"] <= 0.05  # type: ignore[operator]
    assert inside / runs == pytest.approx(0.95, abs=0.02)
    assert apart / runs < 0.065


def test_what_differs_by_the_margin_is_called_equivalent_in_one_of_twenty_cases() -> None:
    k = np.arange(N + 1)
    p = np.array([_tested(wrong_more_often(int(one)), N, 0.1)["p_equivalent"] for one in k])  # type: ignore[index]
    for share in (0.1, 0.15):
        assert stats.binom.pmf(k, N, share)[p <= 0.05].sum() <= 0.05
    # of no difference at all: the normal test with the correction for continuity
    assert p[0] == pytest.approx(stats.norm.sf((0.1 - 0.5 / N) / np.sqrt(0.1 * 0.9 / N)))


# --- what people got right ------------------------------------------------------------------------


def test_shares_and_majorities_of_votes() -> None:
    events = [
        make_event("a", COLLABORATIVE, [6, 4, 0]),
        make_event("b", COMPETING, [6, 0, 4]),
        make_event("c", INDEPENDENT, [5, 5, 0]),
        make_event("d", COLLABORATIVE),
        make_event("e", None, [9, 1, 0]),
    ]
    found = human_accuracy(events)
    assert found["n_events"] == 3
    of_competing = "by_scenario.competing.relation_accuracy"
    places = ("relation_accuracy", "majority.relation_accuracy", of_competing)
    assert values(found, *places) == pytest.approx([(0.6 + 0.4 + 0.5) / 3, 1 / 3, 0.4])
    assert values(found["majority"], of_competing) == [0]
    assert found["by_scenario"]["competing"]["n"] == 1
    assert found["goal_accuracy"] is found["by_participant"] is None
    # an agent whose goal nobody named does not count
    one = {"goal_counts": {"red agent": {BLUE_TO_RED: 1, PINK_TO_BLUE: 3}}}
    of_goals = human_accuracy([make_event("a", COLLABORATIVE, judgments=one)])
    assert values(of_goals, "goal_accuracy", "majority.goal_accuracy") == [0.25, 0]
