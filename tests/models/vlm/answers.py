"""Answers of a vision-language model."""

from __future__ import annotations

import json
from typing import Any

from phase_ppl.world.goals import GOALS

SHARES = (0.4, 0.2, 0.1, 0.1, 0.05, 0.05, 0.04, 0.03, 0.02, 0.01)


def goals(first: int = 0) -> dict[str, float]:
    """Return ten goals, from the ``first`` on, with probabilities that sum to 1."""
    return dict(zip(GOALS[first : first + 10], SHARES, strict=True))


def answer(**changes: Any) -> dict[str, Any]:
    """Return a good answer with some keys replaced; those that are None are left out."""
    given = {
        "goal_red": goals(),
        "goal_green": goals(5),
        "relation": {"friendly": 0.7, "neutral": 0.2, "adversarial": 0.1},
        **changes,
    }
    return {key: value for key, value in given.items() if value is not None}


def text(**changes: Any) -> str:
    """Return :func:`answer` as it is sent."""
    return json.dumps(answer(**changes))
