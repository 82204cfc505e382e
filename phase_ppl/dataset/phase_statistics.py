"""The original PHASE events in figures, totals only, to hold other sets of events beside.

In the form of :func:`phase_ppl.dataset.statistics.statistics`, as far as it goes. Measured on the
names of all 500 recordings (``ALL``), on those of the 400 for training and validation (``OTHERS``)
or on the 100 test recordings (``TEST``); the splits and the number of events of each relation are
the paper's. Nothing is known of single goals, items' sizes, layouts and families.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

ALL: Final = 500
OTHERS: Final = 400
TEST: Final = 100


def _table(units: int, counts: Mapping[str, int]) -> dict[str, Any]:
    total = sum(counts.values())
    shares = {label: count / total for label, count in counts.items()}
    return {"units": units, "counts": dict(counts), "shares": shares}


def _value(value: float | None, between: tuple[float, float] | None = None) -> dict[str, Any]:
    return {"units": TEST, "value": value, "between": None if between is None else list(between)}


PHASE: Final[Mapping[str, Any]] = {
    "name": "PHASE",
    "events": ALL,
    "tables": {
        "relation": _table(ALL, {"friendly": 200, "neutral": 108, "adversarial": 192}),
        "scenario": _table(
            ALL, {"collaborative": 200, "independent": 108, "competing": 54, "opposing": 138}
        ),
        # of 1000 agents
        "goal_type": _table(
            ALL, {"LMO+": 584, "LMO-": 7, "LMA+": 215, "LMA-": 68, "TE+": 63, "TE-": 63}
        ),
        # of 800 agents
        "strength": _table(OTHERS, {"150": 125, "300": 200, "450": 204, "600": 271}),
        "agent_size": _table(OTHERS, {"0.8": 484, "1.01": 120, "1.2": 136, "1.6": 60}),
        "reflection": _table(
            TEST,
            {"none": 25, "up-down": 12, "left-right": 18, "about y=x": 21, "about y=-x": 24},
        ),
        "split": _table(ALL, {"train": 320, "validation": 80, "test": 100}),
    },
    "values": {
        "frames_min": _value(33),
        "frames_median": _value(75),
        "frames_max": _value(101),
        "untrimmed": _value(0.38),
        "speed_mean_150": _value(4.5),
        "speed_mean_300": _value(6.6),
        "speed_mean_450": _value(8.4),
        "speed_mean_600": _value(9.1),
        "speed_p99_150": _value(21),
        "speed_p99_300": _value(30),
        "speed_p99_450": _value(39),
        "speed_p99_600": _value(47),
        "speed_max_150": _value(28),
        "speed_max_300": _value(42),
        "speed_max_450": _value(55),
        "speed_max_600": _value(63),
        # the least and the greatest of the four strengths
        "at_rest": _value(None, (0.19, 0.31)),
        "at_rest_150": _value(None, (0.19, 0.31)),
        "at_rest_300": _value(None, (0.19, 0.31)),
        "at_rest_450": _value(None, (0.19, 0.31)),
        "at_rest_600": _value(None, (0.19, 0.31)),
        "step_median": _value(0.38),
        "step_max": _value(5.1),
        "items_move": _value(0.24),
        "holding": _value(0.25),
    },
}
"""The original events in figures. A value's ``between`` is all that is known of it."""
