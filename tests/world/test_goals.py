"""The paper's goals, and what agents pursue when they help or hinder."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest

from phase_ppl.world.errors import UnknownNameError
from phase_ppl.world.goals import (
    GOALS,
    N_GOALS,
    effective_goals,
    goal_index,
    goal_literal,
    is_self_referring,
    literal_goal,
)
from phase_ppl.world.hypothesis import ALPHAS
from phase_ppl.world.names import AGENTS, GREEN, RED, STOP, Literal, PredicateKind
from phase_ppl.world.scene import PHASE
from tests.world.examples import DEV, needs_dev

PAPER = [
    *(
        f"Get {who} {way} {colour} lm"
        for who in ("blue item", "green agent", "pink item", "red agent")
        for way in ("to", "away from")
        for colour in ("blue", "green", "red", "yellow")
    ),
    *("get away from green agent", "get away from red agent"),
    *("get to green agent", "get to red agent"),
]
"""In the order of the published data (see below)."""


def test_the_goals_are_the_papers_36_strings_in_any_case_and_spacing() -> None:
    assert list(GOALS) == PAPER
    assert N_GOALS == 36
    assert goal_index("  get BLUE item  to red LM ") == PAPER.index("Get blue item to red lm")
    assert goal_index(np.int16(35)) == 35
    with pytest.raises(UnknownNameError, match="'Get blue item to red lm'"):
        goal_index("Get blue ball to red lm")
    for value in (-1, 36, 1.5, math.nan, None, True, [3], b"3"):
        with pytest.raises(UnknownNameError, match="unknown goal"):
            goal_index(value)  # type: ignore[arg-type]


@needs_dev
def test_the_goals_are_the_labels_of_the_published_data() -> None:
    assert json.loads(DEV.read_text())["goal_labels"] == PAPER


def test_literals_say_who_is_to_be_where() -> None:
    assert PHASE.words(goal_literal("Get pink item to red lm", RED)) == "ON(pink item, red lm)"
    away = goal_literal("Get green agent away from blue lm", RED)
    assert PHASE.words(away) == "not ON(green agent, blue lm)"
    assert PHASE.words(goal_literal("get to red agent", GREEN)) == "TOUCH(green agent, red agent)"
    assert PHASE.words(STOP) == "STOP"
    with pytest.raises(UnknownNameError, match="ATTACH"):
        literal_goal(Literal(PredicateKind.ATTACH, RED, 2))


def test_only_getting_to_or_from_oneself_is_self_referring() -> None:
    found = {(GOALS[g], h) for g in range(36) for h in (RED, GREEN) if is_self_referring(g, h)}
    ways = ("get to", "get away from")
    assert found == {(f"{way} {AGENTS[h]}", h) for way in ways for h in (RED, GREEN)}


def helped(goal: str, owner: int) -> str:
    """The goal of the agent that helps ``owner``: the same state of the world."""
    if not goal.startswith("get "):
        return goal
    way = goal.removesuffix(AGENTS[RED]).removesuffix(AGENTS[GREEN])
    return way + AGENTS[owner]


def hindered(goal: str, owner: int) -> str:
    """The goal of the agent that hinders ``owner``: "to" and "away from" change places."""
    same = helped(goal, owner)
    if " away from " in same:
        return same.replace(" away from ", " to ")
    return same.replace(" to ", " away from ")


def own_goals(holder: int) -> list[str]:
    return [goal for goal in PAPER if not is_self_referring(goal, holder)]


@pytest.mark.parametrize("alpha", ALPHAS)
def test_effective_goals_of_all_pairs(alpha: tuple[int, int]) -> None:
    for red, green in itertools.product(own_goals(RED), own_goals(GREEN)):
        expected = [red, green]
        if alpha[0]:
            expected[0] = (helped if alpha[0] > 0 else hindered)(green, GREEN)
        if alpha[1]:
            expected[1] = (helped if alpha[1] > 0 else hindered)(red, RED)
        assert [GOALS[g] for g in effective_goals(red, green, alpha)] == expected
