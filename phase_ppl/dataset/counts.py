"""How often each kind of thing occurs in a set of events."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from phase_ppl.dataset.generation.tables import SIZES
from phase_ppl.dataset.phase_statistics import PHASE
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS, goal_literal
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.literals import Predicate
from phase_ppl.world.names import AGENTS
from phase_ppl.world.relations import RELATIONS, SCENARIOS

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
