"""Scenario and relation of every pair of effective goals (paper, Table 1)."""

from __future__ import annotations

import itertools
from collections import Counter

import pytest

from phase_ppl.dataset.load import load_events
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import (
    RELATION_TABLE,
    RELATIONS,
    SCENARIO_TABLE,
    SCENARIOS,
    relation,
    scenario,
)
from tests.world.examples import DEV, needs_dev

PAIRS = list(itertools.product(GOALS, GOALS))
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
    """The definition, on the strings alone."""
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
    for (i, red), (j, green) in itertools.product(enumerate(GOALS), repeat=2):
        expected = expected_scenario(red, green)
        assert scenario(red, green) == SCENARIOS[SCENARIO_TABLE[i, j]] == expected, (red, green)
        found = relation(red, green)
        assert found == RELATIONS[RELATION_TABLE[i, j]] == RELATION_OF[expected], (red, green)


def test_how_many_pairs_make_each_scenario() -> None:
    counts = Counter(itertools.starmap(scenario, PAIRS))
    assert counts["collaborative"] == 36 + 1  # equal goals, and both to each other
    assert counts["opposing"] == 32 + 2  # every goal about a landmark negated, and two chases
    assert counts["competing"] == 2 * 4 * 3  # per item, ordered pairs of different landmarks
    assert sum(counts.values()) == 36 * 36


@pytest.mark.parametrize(
    ("red", "green", "expected"),
    [
        ("Get red agent to blue lm", "Get green agent to blue lm", "independent"),
        ("Get blue item to red lm", "Get pink item to red lm", "independent"),
        ("get away from green agent", "get away from red agent", "independent"),
        ("Get red agent to blue lm", "Get red agent away from blue lm", "opposing"),
        ("Get pink item away from red lm", "Get pink item to blue lm", "independent"),
        ("Get pink item to red lm", "Get pink item to blue lm", "competing"),
        ("Get green agent to red lm", "Get green agent to blue lm", "independent"),
    ],
)
def test_cases_worked_by_hand(red: str, green: str, expected: str) -> None:
    assert scenario(red, green) == expected


@needs_dev
def test_true_scenarios_and_relations_of_the_published_videos_follow_from_the_goals() -> None:
    events = load_events(DEV)
    counts: Counter[str] = Counter()
    for event in events:
        truth = event.truth
        assert truth is not None
        assert truth.scenario == scenario(truth.goal_red, truth.goal_green), event.id
        assert truth.relation == relation(truth.goal_red, truth.goal_green), event.id
        counts[truth.scenario] += 1
    assert counts == {"collaborative": 19, "independent": 14, "competing": 5, "opposing": 12}
