"""Statistics of a set of events: contents and motion, compared with the original events."""

from __future__ import annotations

import functools
import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
import pandas as pd

from phase_ppl.data.generated import GeneratedEvents
from phase_ppl.data.generation.situation import SIZES
from phase_ppl.data.motion import SLOW, moves_to_the_end, seems_to_hold, speeds
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import FRAMES_PER_SECOND, Event, Truth
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.scene import PHASE, World

GOAL_TYPES: Final = ("LMO+", "LMO-", "LMA+", "LMA-", "TE+", "TE-")
"""Item to (+) or away from (-) a landmark, agent likewise, to or away from the other agent."""

LEVELS: Final = tuple(f"{level:g}" for level in STRENGTH_LEVELS)
"""Names of the strengths of the original world, newtons."""

_MADE: Final = ("family", "layout", "reflection", "split")  # an event's entries in a manifest
OTHER: Final = "other"  # a strength, size or type of goal that is not original
_RESAMPLINGS: Final = 200

Row: TypeAlias = tuple[str, str, int | None, float, float, float]

COUNTS: Final[Mapping[str, Mapping[str, int]]] = {
    "relation": {"friendly": 200, "neutral": 108, "adversarial": 192},
    "scenario": {"collaborative": 200, "independent": 108, "competing": 54, "opposing": 138},
    "goal_type": dict(zip(GOAL_TYPES, (584, 7, 215, 68, 63, 63), strict=True)),
    "strength": dict(zip(LEVELS, (125, 200, 204, 271), strict=True)),
    "agent_size": {"0.8": 484, "1.01": 120, "1.2": 136, "1.6": 60},
    "reflection": {"none": 25, "up-down": 12, "left-right": 18, "about y=x": 21, "about y=-x": 24},
    "split": {"train": 320, "validation": 80, "test": 100},
}
"""PHASE's 500 events; strengths and sizes without the test videos, reflections of these only."""

FIGURES: Final[Mapping[str, Mapping[str, float]]] = {
    "frames": {"min": 33, "median": 75, "max": 101},
    "moves_to_the_end": {"mean": 0.38},
    "speed": dict.fromkeys(("mean", "p99", "max"), math.nan),
    "speed_150": {"mean": 4.5, "p99": 21, "max": 28},
    "speed_300": {"mean": 6.6, "p99": 30, "max": 42},
    "speed_450": {"mean": 8.4, "p99": 39, "max": 55},
    "speed_600": {"mean": 9.1, "p99": 47, "max": 63},
    "step": {"median": 0.38, "max": 5.1},
    "agent_rests": {"mean": math.nan},  # from 0.19 to 0.31 by strength
    "agent_holds": {"mean": 0.25},
    "item_moves": {"mean": 0.24},
}
"""PHASE's 100 test videos; NaN: unknown."""

_HOW: Final[Mapping[str, Callable[[FloatArray], Any]]] = {
    "min": np.min, "median": np.median, "mean": np.mean, "max": np.max,
    "p99": functools.partial(np.percentile, q=99),
}  # fmt: skip


def shares(quantity: str) -> dict[str, float]:
    """Return the shares of the labels of one of :data:`COUNTS`."""
    total = sum(COUNTS[quantity].values())
    return {label: count / total for label, count in COUNTS[quantity].items()}


def statistics(events: Sequence[Event]) -> pd.DataFrame:
    """Return a table of the contents and the motion of a set of events, beside PHASE's events.

    These quantities are counted: ``relation`` and ``scenario`` (of the two agents in PHASE, of
    every pair of agents in other worlds), ``goal_type``, ``goal``, ``strength`` [N], ``agent_size``
    and ``item_size`` [units]. Types of goals are LMO (an item and a landmark), LMA (an agent and a
    landmark) and TE (the agent and the other one), with + for "to" and - for "away from". A
    generated set also has ``family``, ``layout``, ``reflection`` and ``split``.

    These quantities are figures: ``frames``, the length of an event; ``speed`` of agents
    [units per simulated s], also by strength (``speed_150`` and so on); ``step``, the way of an
    agent in a frame [units]. Shares of time are ``agent_rests`` (slower than 0.5 units/s),
    ``agent_holds`` (an item, inferred from places) and ``item_moves``. ``moves_to_the_end`` is
    the share of events in which some body still moves within the last five frames. Quantities
    without data are left out.

    Args:
        events: events of one world. Events without truth count where no truth is needed.

    Returns:
        A row for each ``quantity`` and ``label``, the two levels of its index. A label is a counted
        value, such as "friendly", or what was computed of a figure, such as "mean". Columns are
        ``count``, missing for figures; ``value``, for a label its share, otherwise the figure
        itself; ``error``, the standard error of ``value``, NaN for extremes and single events (an
        event and its reflected copies count as one); and ``phase``, the value of PHASE's events,
        NaN if unknown.
        ``attrs`` has the number of ``events``, of ``units`` (events without copies), of events
        ``without_truth`` and of agents ``without_strength``.

    Example:
        ``ppl.statistics(one).join(ppl.statistics(other)["value"].rename("other"))``

    Raises:
        InvalidEventError: there are no events, they are of several worlds, or one has a body that
            was not seen in some frame.
    """
    if not events:
        raise InvalidEventError("there are no events to describe")
    of_set = isinstance(events, GeneratedEvents)
    told: Sequence[Any] = list(events.entries) if of_set else [{}] * len(events)  # type: ignore[attr-defined]
    events = list(events)  # read once: a stored set reads each event anew
    world = events[0].scene.world
    if any(event.scene.world != world for event in events):
        raise InvalidEventError("the events are of several worlds, which are described one by one")
    units = [str(entry.get("group", event.id)) for event, entry in zip(events, told, strict=True)]
    labels = [_labels(event, entry) for event, entry in zip(events, told, strict=True)]
    moves = [_moves(event) for event in events]
    rows = [row for name in labels[0] for row in _counted(name, labels, units, world)]
    rows += [row for name in FIGURES for row in _figures(name, moves, units)]
    table = pd.DataFrame(rows, columns=["quantity", "label", "count", "value", "error", "phase"])
    table = table.astype({"count": "Int64"}).set_index(["quantity", "label"])
    table.attrs = {
        "events": len(events),
        "units": len(set(units)),
        "without_truth": sum(event.truth is None for event in events),
        "without_strength": sum(force is None for event in events for force in _strengths(event)),
    }
    return table


# --- what is counted ------------------------------------------------------------------------------


def _labels(event: Event, entry: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return quantity -> the event's labels."""
    truth, world = event.truth, event.scene.world
    goals = [] if truth is None else [*truth.goals.values()]
    relations, scenarios = [], []
    if isinstance(truth, Truth):
        relations, scenarios = [truth.relation], [truth.scenario]
    elif truth is not None:
        pairs = list(itertools.combinations(world.agents, 2))
        relations = [truth.relation_between(*pair) for pair in pairs]
        scenarios = [truth.scenario_between(*pair) for pair in pairs]
    size = [
        next((f"{one:g}" for one in SIZES if abs(radius - one) < 1e-3), OTHER)
        for radius in event.scene.radius
    ]
    forces = [force for force in _strengths(event) if force is not None]
    return {
        "relation": relations,
        "scenario": scenarios,
        "goal_type": [goal_type(goal, world) for goal in goals],
        "goal": goals,
        "strength": [f"{force:g}" if force in STRENGTH_LEVELS else OTHER for force in forces],
        "agent_size": size[: len(world.agents)],
        "item_size": size[len(world.agents) :],
        **{name: [str(entry[name])] if entry.get(name) is not None else [] for name in _MADE},
    }


def _counted(
    name: str, labels: Sequence[Mapping[str, Any]], units: Sequence[str], world: World
) -> Iterator[Row]:
    """Yield the rows of a quantity: labels of the original events first, then others."""
    counts = Counter(label for one in labels for label in one[name])
    first = {"goal": world.goals, "item_size": COUNTS["agent_size"]}.get(name, COUNTS.get(name, ()))
    others = sorted({*counts} - {*first}, key=lambda one: (one == OTHER, one.zfill(9)))
    n = len({unit for unit, one in zip(units, labels, strict=True) if one[name]})
    phase = shares(name) if name in COUNTS else {}
    for label in (*first, *others) if counts else ():
        share = counts[label] / counts.total()
        likely = (n * share + 2) / (n + 4)  # Agresti and Coull: a share of 0 has an error too
        error = math.sqrt(likely * (1 - likely) / (n + 4))
        other = phase.get(label, 0.0 if phase else math.nan)
        yield name, label, counts[label], share, error, other


def goal_type(goal: str | int, world: World = PHASE) -> str:
    """Return which of :data:`GOAL_TYPES` a goal is; "other" for a user-defined predicate."""
    literal = goal_literal(goal, 0, world)
    if literal.predicate.name == "USERS":
        return OTHER
    kind = "LMA" if literal.subject < len(world.agents) else "LMO"
    kind = "TE" if literal.predicate.name == "TOUCH" else kind
    return kind + ("+" if literal.positive else "-")


def _strengths(event: Event) -> tuple[float | None, ...]:
    """Return (agent,) strengths, newtons; None if unknown."""
    if event.truth is None:
        return (None,) * len(event.scene.world.agents)
    return tuple(event.truth.strengths)


# --- how bodies move ------------------------------------------------------------------------------


def _moves(event: Event) -> dict[str, FloatArray]:
    """Return the numbers of an event from which :data:`FIGURES` are computed."""
    track, n = event.observation.whole("a summary").trajectory, len(event.scene.world.agents)
    speed = speeds(track)
    agents = speed[:, :n].ravel()
    numbers: dict[str, Any] = {
        "frames": [len(track)],
        "moves_to_the_end": [moves_to_the_end(track)],
        "speed": agents,
        "step": agents / FRAMES_PER_SECOND,
        "agent_rests": agents < SLOW,
        "agent_holds": seems_to_hold(track, event.scene.radius, n).ravel(),
        "item_moves": speed[:, n:].ravel() >= SLOW,
    }
    for level, name in zip(STRENGTH_LEVELS, LEVELS, strict=True):
        of_level = [agent for agent, force in enumerate(_strengths(event)) if force == level]
        numbers[f"speed_{name}"] = speed[:, of_level].ravel()
    return {name: np.asarray(given, np.float64) for name, given in numbers.items()}


def _figures(
    name: str, moves: Sequence[Mapping[str, FloatArray]], units: Sequence[str]
) -> Iterator[Row]:
    """Yield the rows of a quantity; events of a unit are resampled together."""
    grouped: dict[str, list[FloatArray]] = {}
    for unit, numbers in zip(units, moves, strict=True):
        if len(numbers[name]):
            grouped.setdefault(unit, []).append(numbers[name])
    parts = [np.concatenate(arrays) for arrays in grouped.values()]
    for label, phase in FIGURES[name].items() if parts else ():
        how = _HOW[label]
        error = math.nan if label in ("min", "max") else standard_error(parts, how)
        yield name, label, None, float(how(np.concatenate(parts))), error, phase


def standard_error(parts: Sequence[FloatArray], function: Callable[[FloatArray], Any]) -> float:
    """Return the bootstrap's standard error of a function of all parts together; one part: NaN."""
    n = len(parts)
    if n < 2:
        return math.nan
    rng = np.random.default_rng(0)
    again = [
        float(function(np.concatenate([parts[i] for i in rng.integers(n, size=n)])))
        for _ in range(_RESAMPLINGS)
    ]
    return float(np.std(again, ddof=1))
