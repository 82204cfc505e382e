"""Which answers of a vision-language model are read, repaired and refused."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.evaluation.prediction import QUESTIONS, Prediction
from phase_ppl.models.vlm import parse
from phase_ppl.world.errors import AnswerError
from phase_ppl.world.goals import GOALS
from tests.models.vlm.answers import SHARES, answer, goals, text


def relation(friendly: float, neutral: float, adversarial: float, name: str = "friendly") -> Any:
    return {name: friendly, "neutral": neutral, "adversarial": adversarial}


def test_a_good_answer_is_read_as_it_is() -> None:
    found = parse(text())
    assert found.repairs == ()
    assert found.probabilities["goal_red"][:11] == pytest.approx([*SHARES, 0])
    assert found.probabilities["goal_green"][5:15] == pytest.approx(SHARES)
    assert found.probabilities["relation"] == pytest.approx([0.7, 0.2, 0.1])
    assert Prediction("", found.probabilities).answers["goal_green"] == GOALS[5]
    sure = dict.fromkeys(GOALS[:10], 0) | {GOALS[3]: 1}  # whole numbers are probabilities too
    assert parse(text(goal_red=sure)).probabilities["goal_red"][3] == 1


REPAIRED = {
    f"```json\n{text()}\n```": "code fence removed",
    f"```json\r\n{text()}\r\n```\r\n": "code fence removed",
    f"```\n{text()}```\n": "code fence removed",
    f"Here you are:\n```json\n{text()}\n```\nAny more?": "code fence and text around it",
    text(Goal_Red=goals(), goal_red=None): "'Goal_Red' read as 'goal_red'",
    text(relation=relation(1, 0, 0, "Friendly")): "'Friendly' read as 'friendly'",
    text().replace(GOALS[0], "get blue  item to blue lm"): "read as 'Get blue item to bl",
    text(reasoning="they meet"): "'reasoning' left out",
}


def test_what_has_one_meaning_is_repaired_and_noted() -> None:
    for given_answer, expected in REPAIRED.items():
        (repair,) = parse(given_answer).repairs
        assert expected in repair
    one, two = goals(), goals(5)
    one["GET BLUE ITEM TO BLUE LM"] = one.pop(GOALS[0])
    two[GOALS[5]] += 0.02
    many = f"```json\n{text(goal_red=one, goal_green=two, why='so')}\n```"
    assert len(parse(many).repairs) == 4


def shares_of(total: float) -> dict[str, float]:
    return {goal: share * total for goal, share in goals().items()}


@pytest.mark.parametrize(
    ("total", "named", "other", "repair"),
    [
        (0.96, 0.96, 0.04 / 26, "0.96; the rest spread over 26 goals"),
        (1.05, 1, 0, "1.05; scaled to 1"),
    ],
)
def test_a_little_that_is_missing_or_too_much_is_shared_out(
    total: float, named: float, other: float, repair: str
) -> None:
    found = parse(text(goal_red=shares_of(total)))
    values = found.probabilities["goal_red"]
    assert values[:10] == pytest.approx(named * np.array(SHARES))
    assert values[10:] == pytest.approx(other)
    assert f"goal_red sums to {repair}" in found.repairs[0]
    # relations are scaled, since none is unnamed
    found = parse(text(relation=relation(0.33, 0.33, 0.33)))
    assert found.probabilities["relation"] == pytest.approx([1 / 3] * 3)


def renamed(name: str) -> dict[str, float]:
    return {name if goal == GOALS[0] else goal: share for goal, share in goals().items()}


REFUSED: dict[str, tuple[str, str]] = {
    "a refusal": ("I'm sorry, I cannot help with that.", r"not JSON.*it begins \"I'm sorry"),
    "spaces for ever": ("```" + " " * 1_000_000 + "x", "not JSON"),  # in no time
    "cut": (text()[:200], "not JSON: line 1"),
    "nested deeply": ("[" * 100_000, "is no JSON object"),
    "NaN": (text().replace("0.4", "NaN", 1), "not JSON"),
    "a goal twice": (text().replace(GOALS[1], GOALS[0], 1), "two fields"),
    "no relation": (text(relation=None), "lacks relation; it has 'goal_red', 'goal_green'"),
    "nine goals": (
        text(goal_red=dict(list(goals().items())[1:])),
        "goal_red has 9 entries, expected exactly 10",
    ),
    "an unknown goal": (
        text(goal_red=renamed("Get blue ball to blue lm")),
        f"unknown goal 'Get blue ball to blue lm'; did you mean '{GOALS[0]}'",
    ),
    "percent": (text(goal_red=goals() | {GOALS[0]: 40}), "has 40, expected a number from 0 to 1"),
    "sums far below 1": (text(goal_red=shares_of(0.9)), "goal_red sums to 0.9, expected 1"),
    "relations beyond 1": (text(relation=relation(1, 0.5, 0)), "relation sums to 1.5"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_without_guessing_is_refused(name: str) -> None:
    given, reason = REFUSED[name]
    with pytest.raises(AnswerError) as caught:
        parse(given)
    assert re.search(reason, str(caught.value), re.DOTALL), caught.value
    assert len(str(caught.value)) < 400


@settings(max_examples=40)
@given(st.data())
def test_whatever_comes_is_probabilities_or_refused(data: Any) -> None:
    values = st.none() | st.booleans() | st.floats() | st.just("0.4") | st.integers()
    names = st.sampled_from([*GOALS[:12], "friendly", "Neutral", "x"])
    part = values | st.dictionaries(names, values, max_size=12) | st.just(goals())
    given_answer = answer()
    for key in data.draw(st.sets(st.sampled_from([*QUESTIONS, "more"]))):
        given_answer[key] = data.draw(part)
    try:
        found = parse(json.dumps(given_answer))
    except AnswerError:
        return
    for question, labels in QUESTIONS.items():
        shares = found.probabilities[question]
        assert shares.shape == (len(labels),)
        assert (shares >= 0).all()
        assert shares.sum() == pytest.approx(1)
