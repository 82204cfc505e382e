"""Which recordings are kept, in place of the original authors' sorting by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from phase_ppl.world.goals import goal_literal
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import AGENTS, ENTITIES

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


def _together(hypothesis: Hypothesis, found: Measures) -> str | None:
    if not _both_touch(hypothesis, found):
        return "not both touch the item"
    return _achieved(hypothesis, found)


def _met(hypothesis: Hypothesis, found: Measures) -> str | None:
    return None if found["closest"] < NEAR else "the agents never come near each other"


def _rivals(hypothesis: Hypothesis, found: Measures) -> str | None:
    return None if _both_touch(hypothesis, found) else "not both touch the item"


def _both_touch(hypothesis: Hypothesis, found: Measures) -> bool:
    """Whether each agent touches the item that its goal is about, if it is about one."""
    wanted = [
        goal_literal(goal, agent).subject for agent, goal in enumerate(hypothesis.effective_goals)
    ]
    return all(
        item < len(AGENTS) or ENTITIES[item] in items
        for item, items in zip(wanted, found["touched"], strict=True)
    )


_SHOWS: Final[Mapping[str, Callable[[Hypothesis, Measures], str | None]]] = {
    "collaborative": _together,
    "independent": _achieved,
    "opposing": _met,
    "competing": _rivals,
}
