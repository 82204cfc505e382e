"""How often each kind of thing occurs in a set of events."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from phase_ppl.dataset.generation.situation import SIZES
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS, goal_literal
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS, STRENGTH_LEVELS
from phase_ppl.world.names import AGENTS, Predicate

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


# --- how often each kind of thing occurs in a set of events ---------------------------------------

GOAL_TYPES: Final = ("LMO+", "LMO-", "LMA+", "LMA-", "TE+", "TE-")
"""Item to (+) or away from (-) a landmark, agent likewise, to or away from the other agent."""

LEVELS: Final = tuple(f"{level:g}" for level in STRENGTH_LEVELS)
"""Names of the strengths of the original world, newtons."""

OTHER: Final = "other"
"""What is none of the original strengths or sizes."""

_ORIGINAL_ORDER: Final = [
    label for key in ("reflection", "split") for label in PHASE["tables"][key]["counts"]
]


def goal_type(goal: str | int) -> str:
    """Return which of :data:`GOAL_TYPES` a goal is."""
    literal = goal_literal(goal, 0)
    if literal.predicate is Predicate.TOUCH:
        kind = "TE"
    else:
        kind = "LMA" if literal.subject < len(AGENTS) else "LMO"
    return kind + ("+" if literal.positive else "-")


def tables(
    events: Sequence[Event], entries: Mapping[str, Mapping[str, Any]], units: Sequence[str]
) -> dict[str, Any]:
    """Return the ``tables`` of :func:`phase_ppl.dataset.statistics.statistics`.

    Args:
        events: the set.
        entries: id -> entry of a manifest, where there are any.
        units: per event the event that it is a copy of, or itself.
    """
    truths = [(e.truth, unit) for e, unit in zip(events, units, strict=True) if e.truth is not None]
    goals = [(goal, unit) for t, unit in truths for goal in (t.goal_red, t.goal_green)]
    forces = [
        (f"{force:g}" if force in STRENGTH_LEVELS else OTHER, unit)
        for event, unit in zip(events, units, strict=True)
        for force in strengths(event)
        if force is not None
    ]
    sizes = [
        [(_size(float(radius)), unit) for radius in event.scene.radius]
        for event, unit in zip(events, units, strict=True)
    ]
    n = len(AGENTS)
    known_sizes = [f"{size:g}" for size in sorted(SIZES)]
    found = {
        "relation": table(((t.relation, unit) for t, unit in truths), RELATIONS),
        "scenario": table(((t.scenario, unit) for t, unit in truths), SCENARIOS),
        "goal_type": table(((goal_type(goal), unit) for goal, unit in goals), GOAL_TYPES),
        "goal": table(goals, GOALS),
        "strength": table(forces, LEVELS),
        "agent_size": table((size for event in sizes for size in event[:n]), known_sizes),
        "item_size": table((size for event in sizes for size in event[n:]), known_sizes),
    }
    for key in ("family", "layout", "split", "reflection"):
        told = [
            (str(entries[event.id][key]), unit)
            for event, unit in zip(events, units, strict=True)
            if entries.get(event.id, {}).get(key) is not None
        ]
        labels = sorted({label for label, _ in told}, key=_place)
        found[key] = table(told, labels)
    return {key: counted for key, counted in found.items() if counted["units"]}


def table(labelled: Iterable[tuple[str, str]], known: Sequence[str]) -> dict[str, Any]:
    """Return counts and shares of labels, those that are known first and even where there are none.

    Args:
        labelled: (label, unit that it belongs to).
        known: labels in the order in which they are listed.
    """
    pairs = list(labelled)
    counts = Counter(dict.fromkeys(known, 0))
    counts.update(label for label, _ in pairs)
    total = max(len(pairs), 1)
    return {
        "units": len({unit for _, unit in pairs}),
        "counts": dict(counts),
        "shares": {label: count / total for label, count in counts.items()},
    }


def strengths(event: Event) -> tuple[float | None, float | None]:
    """Return the strengths of red and green, newtons, as far as they are known."""
    truth = event.truth
    return (None, None) if truth is None else (truth.strength_red, truth.strength_green)


def _size(radius: float) -> str:
    return next((f"{size:g}" for size in SIZES if abs(radius - size) < 1e-3), OTHER)


def _place(label: str) -> tuple[int, int, str]:
    """Return the sorting key of a label: those of the original events, numbers, others."""
    if label in _ORIGINAL_ORDER:
        return 0, _ORIGINAL_ORDER.index(label), ""
    return (1, int(label), "") if label.isdecimal() else (2, 0, label)
