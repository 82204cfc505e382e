"""Which recordings are kept, in place of the original authors' sorting by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from phase_ppl.world.goals import goal_literal
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import ENTITIES

NEAR: Final = 1.5
"""Agents this near, in units of the sum of their sizes, are said to have met."""

MAX_STUCK: Final = 36
"""Frames (3 s simulated) for which an agent may push without any effect."""

Measures = Mapping[str, Any]


def reason_against(scenario: str, hypothesis: Hypothesis, found: Measures) -> str | None:
    """Return why a recording does not show its scenario; None where it does.

    Args:
        scenario: what it was drawn to show.
        hypothesis: under which it was simulated.
        found: its :func:`~phase_ppl.dataset.generation.measures.measures`.
    """
    positive = [
        goal_literal(goal, agent).positive for agent, goal in enumerate(hypothesis.effective_goals)
    ]
    if any(start and wanted for start, wanted in zip(found["at_start"], positive, strict=True)):
        return "a goal is true at the start"
    if max(found["stuck"]) > MAX_STUCK:
        return "an agent is stuck"
    return _SHOWS[scenario](hypothesis, found)


def _achieved(hypothesis: Hypothesis, found: Measures) -> str | None:
    return None if all(found["at_end"]) else "a goal is not reached"


def _met(hypothesis: Hypothesis, found: Measures) -> str | None:
    return None if found["closest"] < NEAR else "the agents never come near each other"


def _rivals(hypothesis: Hypothesis, found: Measures) -> str | None:
    wanted = [
        ENTITIES[goal_literal(goal, agent).subject]
        for agent, goal in enumerate(hypothesis.effective_goals)
    ]
    both = all(item in items for item, items in zip(wanted, found["touched"], strict=True))
    return None if both else "not both touch the item"


_SHOWS: Final[Mapping[str, Callable[[Hypothesis, Measures], str | None]]] = {
    "collaborative": _achieved,
    "independent": _achieved,
    "opposing": _met,
    "competing": _rivals,
}
