"""Hypotheses: what is allowed, their plain form, and their relation (paper, Table 1)."""

from __future__ import annotations

import itertools
import math
import pickle
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phase_ppl.data.load import load_events
from phase_ppl.world.errors import InvalidSettingError, PhasePPLError
from phase_ppl.world.goals import GOALS, is_self_referring
from phase_ppl.world.hypothesis import (
    ALPHAS,
    RELATION_TABLE,
    RELATIONS,
    SCENARIO_TABLE,
    SCENARIOS,
    STRENGTH_RANGE,
    Hypothesis,
    relation,
    scenario,
)
from phase_ppl.world.names import GREEN, RED
from phase_ppl.world.worlds import TRIO
from tests.world.examples import DEV, needs_dev


def goals_of(holder: int) -> st.SearchStrategy[int]:
    return st.sampled_from([g for g in range(len(GOALS)) if not is_self_referring(g, holder)])


hypotheses = st.builds(
    Hypothesis,
    goal_red=goals_of(RED),
    goal_green=goals_of(GREEN),
    alpha=st.sampled_from(ALPHAS),
    strength_red=st.floats(*STRENGTH_RANGE),
    strength_green=st.floats(*STRENGTH_RANGE),
)


@given(hypotheses)
def test_effective_goals_can_be_stated_and_stay_as_they_are(hypothesis: Hypothesis) -> None:
    assert Hypothesis.from_dict(hypothesis.to_dict()) == hypothesis
    assert pickle.loads(pickle.dumps(hypothesis)) == hypothesis
    effective = hypothesis.effective()
    assert effective.alpha == (0, 0)
    assert effective.effective_goals == hypothesis.effective_goals
    assert effective.effective() == effective
    assert effective.relation == hypothesis.relation
    assert effective.strengths == hypothesis.strengths
    if sum(hypothesis.alpha) < 0:
        assert (hypothesis.scenario, hypothesis.relation) == ("opposing", "adversarial")
    elif sum(hypothesis.alpha) > 0:  # friendly, unless it helps to part
        red, green = (GOALS[goal] for goal in hypothesis.effective_goals)
        part = (red, green) == ("get away from green agent", "get away from red agent")
        assert hypothesis.relation == ("neutral" if part else "friendly")


def test_what_is_no_hypothesis_is_refused() -> None:
    for goals, agent in (
        (("get to red agent", "Get blue item to red lm"), "red agent"),
        ((0, "get away from green agent"), "green agent"),
    ):
        with pytest.raises(InvalidSettingError, match=f"names its own holder, the {agent}"):
            Hypothesis(*goals)  # type: ignore[arg-type]
    for alpha in ((1, 1), (2, 0), (0,), (0, 0, 0), 1, None, "00"):
        with pytest.raises(InvalidSettingError, match="alpha="):
            Hypothesis(0, 0, alpha)  # type: ignore[arg-type]
    for strength in (0, -150.0, math.nan, math.inf, "450", None, 10**400):
        with pytest.raises(InvalidSettingError, match=r"strength_green=.* newtons"):
            Hypothesis(0, 0, strength_green=strength)  # type: ignore[arg-type]
    alfa = {"goal_red": 0, "goal_green": 0, "alfa": (0, 0)}
    with pytest.raises(PhasePPLError, match="'alfa'; did you mean 'alpha'"):
        Hypothesis.from_dict(alfa)
    for record in ({"goal_red": 0}, {"goal_red": "x"}, {}):
        with pytest.raises(PhasePPLError):
            Hypothesis.from_dict(record)
    for record in ({"goals": {}, "relations": []}, {"goal_red": 0}):
        with pytest.raises(PhasePPLError, match="field of a hypothesis"):
            Hypothesis.from_dict(record, TRIO)


def test_what_is_read_equals_what_was_written_unused_goals_too() -> None:
    goals = dict.fromkeys(TRIO.agents, "blue ball to home")
    one = Hypothesis.of(TRIO, goals, {("green agent", "red agent"): "hinder"}, 300.0)
    assert Hypothesis.from_dict(one.to_dict(), TRIO) == one


RELATION_OF = {
    "collaborative": "friendly",
    "independent": "neutral",
    "competing": "adversarial",
    "opposing": "adversarial",
}
CHASES = {
    ("get to green agent", "get away from red agent"),
    ("get away from green agent", "get to red agent"),
}


def item_and_landmark(goal: str) -> list[str] | None:
    """The item that is to get to a landmark, and the landmark, if that is what ``goal`` says."""
    if " item to " not in goal:
        return None
    return goal.removeprefix("Get ").split(" to ")


def expected_scenario(red: str, green: str) -> str:
    if red == green or (red, green) == ("get to green agent", "get to red agent"):
        return "collaborative"
    about_landmarks = red.startswith("Get") and green.startswith("Get")
    if about_landmarks and red.replace(" away from ", " to ") == green.replace(
        " away from ", " to "
    ):
        return "opposing"
    if (red, green) in CHASES:
        return "opposing"
    first, second = item_and_landmark(red), item_and_landmark(green)
    if first and second and first[0] == second[0]:
        return "competing"
    return "independent"


def test_scenario_and_relation_of_all_pairs() -> None:
    assert SCENARIO_TABLE.shape == RELATION_TABLE.shape == (len(GOALS), len(GOALS))
    counts: Counter[str] = Counter()
    for (i, red), (j, green) in itertools.product(enumerate(GOALS), repeat=2):
        expected = expected_scenario(red, green)
        assert scenario(red, green) == SCENARIOS[SCENARIO_TABLE[i, j]] == expected, (red, green)
        found = relation(red, green)
        assert found == RELATIONS[RELATION_TABLE[i, j]] == RELATION_OF[expected], (red, green)
        counts[expected] += 1
    assert counts["collaborative"] == 36 + 1  # equal goals, and both to each other
    assert counts["opposing"] == 32 + 2  # every goal about a landmark negated, and two chases
    assert counts["competing"] == 2 * 4 * 3  # per item, ordered pairs of different landmarks


@needs_dev
def test_true_scenarios_and_relations_of_the_published_videos_follow_from_the_goals() -> None:
    events = load_events(DEV)
    counts: Counter[str] = Counter()
    for event in events:
        truth = event.truth
        assert truth.scenario == scenario(truth.goal_red, truth.goal_green), event.id
        assert truth.relation == relation(truth.goal_red, truth.goal_green), event.id
        counts[truth.scenario] += 1
    assert counts == {"collaborative": 19, "independent": 14, "competing": 5, "opposing": 12}
