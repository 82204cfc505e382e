"""Measures of a referee: by hand where that can be done, else by what they must tell apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phase_ppl.evaluation import doubt as module
from phase_ppl.evaluation.doubt import calibration, ceiling
from phase_ppl.evaluation.metrics import evaluate_predictions
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.table import Answers
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import RELATIONS
from tests.evaluation.judged import COLLABORATIVE, INDEPENDENT, make_event

VOTES = [[9, 1, 0], [6, 3, 1], [8, 2, 0], [1, 8, 1], [0, 9, 1], [3, 6, 1]]


def events() -> list[Event]:
    goals = [COLLABORATIVE] * 3 + [INDEPENDENT] * 3
    return [make_event(f"e{i}", g, v) for i, (g, v) in enumerate(zip(goals, VOTES, strict=True))]


def predictions(shares: Any) -> dict[str, Prediction]:
    return {f"e{i}": Prediction(f"e{i}", {"relation": p}) for i, p in enumerate(shares)}


def doubt(shares: Any, judged: list[Event] | None = None) -> dict[str, Any]:
    return evaluate_predictions(judged or events(), predictions(shares))["doubt"] or {}


SHARES = np.array(VOTES) / 10


def test_r_is_that_of_the_metrics_and_given_truth_only_what_is_left() -> None:
    p = (SHARES + np.roll(SHARES, 1, axis=0)) / 2
    found, known = doubt(p), evaluate_predictions(events(), predictions(p))
    for name in ("relation_r", "relation_r_given_truth"):
        assert found[name]["value"] == pytest.approx(known["human"][name]["value"])
        assert found[name]["ci_low"] < found[name]["value"] < found[name]["ci_high"] <= 1
    assert doubt(np.eye(3)[[0, 0, 0, 1, 1, 1]])["relation_r_given_truth"] is None


def test_intervals_of_r_are_as_wide_as_it_varies_between_sets_of_videos() -> None:
    rng = np.random.default_rng(0)
    values, widths = [], []
    for _ in range(40):
        p = rng.dirichlet(np.ones(3), 40)
        votes = [rng.multinomial(12, 0.6 * one + 0.4 * rng.dirichlet(np.ones(3))) for one in p]
        judged = [make_event(f"e{i}", COLLABORATIVE, v.tolist()) for i, v in enumerate(votes)]
        answers = Answers.of(judged, predictions(p))
        found = module.doubt(answers, resamples=200)["relation_r"]  # type: ignore[index]
        values.append(found["value"])
        widths.append(found["ci_high"] - found["ci_low"])
    assert 0.75 < np.mean(widths) / (2 * 1.96 * np.std(values)) < 1.35


def test_brier_and_calibration_by_hand() -> None:
    event = make_event("e0", COLLABORATIVE, [2, 1, 1])
    found = doubt([[0.5, 0.5, 0.0]], [event])
    friendly, neutral, adversarial = 0.5, 0.5, 1.5
    assert found["brier"]["value"] == pytest.approx((2 * friendly + neutral + adversarial) / 4)
    assert found["ece"] == pytest.approx(2 / 3 * abs(0.5 - 0.375) + 1 / 3 * 0.25)
    bins = calibration(np.array([[0.5, 0.5, 0.0]]), np.array([[0.5, 0.25, 0.25]]))
    assert [b["n"] for b in bins] == [1, 2]


def test_raters_of_one_law_reach_the_ceiling_of_their_number() -> None:
    rng = np.random.default_rng(0)
    p = rng.dirichlet([1.0, 1.0, 1.0], size=400)
    counts = rng.multinomial(16, p)
    truth = p.argmax(axis=1)
    found = ceiling(counts, truth, rng, 50)
    again = rng.multinomial(16, p) / 16
    r = np.corrcoef(again.ravel(), (counts / 16).ravel())[0, 1]
    assert found["spearman_brown"] == pytest.approx(r, abs=0.02)
    assert found["split_half_r"] < found["spearman_brown"]
    assert found["one_out_r"] < found["split_half_r"]
    assert found["split_half_r_given_truth"] < found["split_half_r"]
    # one with the rest, rater by rater
    found = ceiling(np.array(VOTES), np.array([0, 0, 0, 1, 1, 1]), rng, 2)
    answers = [np.repeat(np.eye(3), votes, axis=0) for votes in VOTES]
    rest = np.concatenate([(one.sum(axis=0) - one) / (len(one) - 1) for one in answers])
    given = np.concatenate(answers)
    assert found["one_out_r"] == pytest.approx(np.corrcoef(rest.ravel(), given.ravel())[0, 1])
    logs = np.log(0.99 * (rest * given).sum(axis=1) + 0.01 / 3)
    assert found["one_out_log_score"] == pytest.approx(logs.mean())


def test_people_with_names_are_resampled_as_wholes() -> None:
    rows = [
        {"participant": f"p{i}", "relation": "friendly" if i < 6 else "neutral"} for i in range(12)
    ]
    named = [make_event(f"e{i}", COLLABORATIVE, judgments={"responses": rows}) for i in range(6)]
    split = [make_event(f"e{i}", COLLABORATIVE, [6, 6, 0]) for i in range(6)]
    p = [[0.2 + 0.1 * i, 0.8 - 0.1 * i, 0.0] for i in range(6)]
    found = [doubt(p, given)["relation_r"] for given in (named, split)]
    width = [one["ci_high"] - one["ci_low"] for one in found]
    assert width[0] > width[1]
    # resampled people agree less than people do, which does not move the interval
    rng = np.random.default_rng(0)
    shares = rng.dirichlet(np.full(3, 2.0), 30)
    judged = []
    for i, share in enumerate(shares):
        said = rng.choice(RELATIONS, 6, p=share).tolist()
        rows = [{"participant": f"p{who}", "relation": one} for who, one in enumerate(said)]
        judged.append(make_event(f"e{i}", COLLABORATIVE, judgments={"responses": rows}))
    of_few = doubt(shares, judged)["relation_r"]
    middle = (of_few["ci_low"] + of_few["ci_high"]) / 2
    assert middle == pytest.approx(of_few["value"], abs=0.07)
