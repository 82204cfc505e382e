"""Scenario and relation of a pair of effective goals (paper, Table 1)."""

from __future__ import annotations

from typing import Final

import numpy as np

from phase_ppl.world.goals import N_GOALS, goal_index, goal_literal, opposed_goal
from phase_ppl.world.literals import Predicate
from phase_ppl.world.names import AGENTS, GREEN, RED

SCENARIOS: Final = ("collaborative", "independent", "competing", "opposing")
RELATIONS: Final = ("friendly", "neutral", "adversarial")
RELATION_OF_SCENARIO: Final = {
    "collaborative": "friendly",
    "independent": "neutral",
    "competing": "adversarial",
    "opposing": "adversarial",
}


def scenario(goal_red: str | int, goal_green: str | int) -> str:
    """Return the scenario of two effective goals, defined on all 36 x 36 pairs.

    Equal goals, or both to get to each other: collaborative. One negates the other: opposing.
    The same item to two landmarks: competing. Everything else: independent.
    """
    red, green = goal_index(goal_red), goal_index(goal_green)
    literal_red, literal_green = goal_literal(red, RED), goal_literal(green, GREEN)
    both_approach = all(
        literal.predicate is Predicate.TOUCH and literal.positive and literal.target == other
        for literal, other in ((literal_red, GREEN), (literal_green, RED))
    )
    if red == green or both_approach:
        return "collaborative"
    # both ways, since a goal that names its own holder is nobody's to negate
    if red == opposed_goal(green, GREEN) and green == opposed_goal(red, RED):
        return "opposing"
    same_item = literal_red.subject == literal_green.subject >= len(AGENTS)
    if same_item and literal_red.positive and literal_green.positive:
        return "competing"
    return "independent"


def relation(goal_red: str | int, goal_green: str | int) -> str:
    """Return "friendly", "neutral" or "adversarial" for two effective goals."""
    return RELATION_OF_SCENARIO[scenario(goal_red, goal_green)]


SCENARIO_TABLE: Final = np.array(
    [[SCENARIOS.index(scenario(r, g)) for g in range(N_GOALS)] for r in range(N_GOALS)], np.int8
)
"""(goal_red, goal_green) -> index into :data:`SCENARIOS`."""

RELATION_TABLE: Final = np.array(
    [[RELATIONS.index(RELATION_OF_SCENARIO[SCENARIOS[s]]) for s in row] for row in SCENARIO_TABLE],
    np.int8,
)
"""(goal_red, goal_green) -> index into :data:`RELATIONS`."""
