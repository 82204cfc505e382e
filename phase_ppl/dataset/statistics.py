"""The statistics of a set of events, as plain data: what is in it, and how its bodies move."""

from __future__ import annotations

import functools
import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.dataset.generated import GeneratedEvents
from phase_ppl.dataset.generation.situation import SIZES
from phase_ppl.dataset.motion import SLOW, moves_to_the_end, seems_to_hold, speeds
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import FRAMES_PER_SECOND, Event, Truth
from phase_ppl.world.goals import goal_index, goal_literal
from phase_ppl.world.hypothesis import (
    RELATION_OF_SCENARIO,
    RELATIONS,
    SCENARIOS,
    STRENGTH_LEVELS,
    Roles,
    scenario,
)
from phase_ppl.world.names import Predicate
from phase_ppl.world.scene import PHASE as PHASE_WORLD
from phase_ppl.world.scene import World

FRAME_EDGES: Final = (*range(0, 101, 10), 102)
SPEED_EDGES: Final = tuple(range(0, 71, 2))
"""Edges of the histograms of durations [frames] and speeds [units/s]; the last bins are open."""

GOAL_TYPES: Final = ("LMO+", "LMO-", "LMA+", "LMA-", "TE+", "TE-")
"""Item to (+) or away from (-) a landmark, agent likewise, to or away from the other agent."""

LEVELS: Final = tuple(f"{level:g}" for level in STRENGTH_LEVELS)
"""Names of the strengths of the original world, newtons."""

OTHER: Final = "other"  # what is none of the original strengths or sizes
_RESAMPLINGS: Final = 200


# --- the original events ---------------------------------------------------------------------


def _counted(units: int, counts: Mapping[str, int]) -> dict[str, Any]:
    total = max(sum(counts.values()), 1)
    shares = {label: count / total for label, count in counts.items()}
    return {"units": units, "counts": dict(counts), "shares": shares}


_ALL, _WITHOUT_TEST, _TEST = 500, 400, 100  # events

PHASE: Final[Mapping[str, Any]] = {
    "name": "PHASE",
    "events": _ALL,
    "tables": {
        "relation": _counted(_ALL, {"friendly": 200, "neutral": 108, "adversarial": 192}),
        "scenario": _counted(
            _ALL, {"collaborative": 200, "independent": 108, "competing": 54, "opposing": 138}
        ),
        # of 1000 agents
        "goal_type": _counted(_ALL, dict(zip(GOAL_TYPES, (584, 7, 215, 68, 63, 63), strict=True))),
        # of 800 agents
        "strength": _counted(_WITHOUT_TEST, dict(zip(LEVELS, (125, 200, 204, 271), strict=True))),
        "agent_size": _counted(_WITHOUT_TEST, {"0.8": 484, "1.01": 120, "1.2": 136, "1.6": 60}),
        "reflection": _counted(
            _TEST, {"none": 25, "up-down": 12, "left-right": 18, "about y=x": 21, "about y=-x": 24}
        ),
        "split": _counted(_ALL, {"train": 320, "validation": 80, "test": 100}),
    },
    "values": {
        name: {
            "units": _TEST,
            "value": value,
            # of rest, the least and the greatest of the four strengths are known
            "between": [0.19, 0.31] if value is None else None,
        }
        for name, value in {
            **{"frames_min": 33, "frames_median": 75, "frames_max": 101, "untrimmed": 0.38},
            **{
                f"speed_{what}_{level}": figure
                for what, figures in {
                    "mean": (4.5, 6.6, 8.4, 9.1),
                    "p99": (21, 30, 39, 47),
                    "max": (28, 42, 55, 63),
                }.items()
                for level, figure in zip(LEVELS, figures, strict=True)
            },
            **dict.fromkeys(("at_rest", *(f"at_rest_{level}" for level in LEVELS))),
            **{"step_median": 0.38, "step_max": 5.1, "items_move": 0.24, "holding": 0.25},
        }.items()
    },
}
"""The original events in figures. A value's ``between`` is all that is known of it."""

_ORIGINAL_ORDER: Final = [
    label for key in ("reflection", "split") for label in PHASE["tables"][key]["counts"]
]

Statistics = dict[str, Any]


def statistics(
    events: Sequence[Event], manifest: Mapping[str, Any] | None = None, *, name: str = "this set"
) -> Statistics:
    """Return the statistics of a set of events, as plain data fit for JSON.

    Keys of the result:

    * ``name``, ``events``; ``landmarks`` of their world; ``units``: events without their copies,
      which the manifest knows; ``without_truth``: events; ``without_strength``: agents.
    * ``tables``: per name ``counts`` and ``shares`` of labels, and ``units``, the events (without
      copies) behind them. ``relation``, ``scenario``, ``goal_type``, ``goal``, ``strength``
      [newtons], ``agent_size``, ``item_size`` [units]; from a manifest also ``family``,
      ``layout``, ``split``, ``reflection``.
    * ``values``: per name ``value``, its standard error ``se`` (bootstrap over events, None for
      extremes and single events) and ``units``. ``frames_min``, ``frames_median``,
      ``frames_max``; ``untrimmed``, share of events that move to the end; per strength
      ``speed_mean_150``, ``speed_p99_150``, ``speed_max_150`` and so on, the agents' speeds
      [units/s simulated], also without a strength for all of them; ``at_rest`` (and per
      strength), share of time an agent is slower than 0.5; ``step_median``, ``step_max`` of
      agents [units per frame]; ``items_move``, share of time an item is not slower than 0.5;
      ``holding``, share of time an agent holds an item.
    * ``holding_from``: "recorded", or "geometry" where the manifest does not tell and it is an
      estimate (:func:`phase_ppl.dataset.motion.seems_to_hold`).
    * ``histograms``: ``edges`` and ``counts`` of ``frames``, ``speed`` and per strength
      ``speed_150``; what is beyond the last edge is in the last bin.
    * ``draws``, from a manifest: cell -> ``kept``, ``tried``, ``share`` kept, ``reasons`` against
      the others, with their counts; else None.

    In other worlds than PHASE every pair of agents has a relation and a scenario.

    What there is nothing to tell about is left out of ``tables`` and ``values``.

    Args:
        events: the set; those without truth count where none is needed.
        manifest: of a generated set, see :mod:`phase_ppl.dataset.generation`.
        name: of the set, as figures and tables call it.

    Raises:
        InvalidEventError: there are no events, or they are of several worlds.
        InvalidSettingError: the manifest is none.
    """
    if not events:
        raise InvalidEventError("there are no events to describe")
    if isinstance(events, GeneratedEvents) and isinstance(manifest, Mapping):
        manifest = {**manifest, "entries": events.entries}  # which that of a large set has not
    events = list(events)  # gone through many times; those of a stored set are read each time
    world = events[0].scene.world
    if any(event.scene.world != world for event in events):
        raise InvalidEventError("the events are of several worlds, which are described one by one")
    entries = _entries(manifest)
    told = [entries.get(event.id, {}) for event in events]
    units = [str(entry.get("group", event.id)) for event, entry in zip(events, told, strict=True)]
    held, holding_from = _holding(events, told)
    moves = [_moves(event, of_event) for event, of_event in zip(events, held, strict=True)]
    numbers = {name: [of_event[name] for of_event in moves] for name in moves[0]}
    values = {name: _value(numbers[of], units, how) for name, (of, how) in _VALUES.items()}
    return {
        "name": name,
        "events": len(events),
        "landmarks": list(world.landmark_names),
        "units": len(set(units)),
        "without_truth": sum(event.truth is None for event in events),
        "without_strength": sum(force is None for event in events for force in _strengths(event)),
        "tables": _tables(events, told, units),
        "values": {name: value for name, value in values.items() if value is not None},
        "holding_from": holding_from,
        "histograms": {
            name: _histogram(numbers[name], FRAME_EDGES if name == "frames" else SPEED_EDGES)
            for name in ("frames", "speed", *(f"speed_{level}" for level in LEVELS))
        },
        "draws": None if manifest is None else _draws(manifest),
    }


def _moves(event: Event, held: FloatArray) -> dict[str, FloatArray]:
    """Return numbers about how bodies move; ``held``: how much of each frame each agent holds."""
    track, n = event.observation.trajectory, len(event.scene.world.agents)
    speed = speeds(track)
    agents = {"": speed[:, :n].ravel()}
    for level, name in zip(STRENGTH_LEVELS, LEVELS, strict=True):
        of_level = [agent for agent, force in enumerate(_strengths(event)) if force == level]
        agents[f"_{name}"] = speed[:, of_level].ravel()
    numbers: dict[str, Any] = {
        "frames": [len(track)],
        "untrimmed": [moves_to_the_end(track)],
        **{f"speed{suffix}": of_agents for suffix, of_agents in agents.items()},
        **{f"at_rest{suffix}": of_agents < SLOW for suffix, of_agents in agents.items()},
        "step": agents[""] / FRAMES_PER_SECOND,
        "items_move": speed[:, n:].ravel() >= SLOW,
        "holding": held,
    }
    return {name: np.asarray(given, np.float64) for name, given in numbers.items()}


_VALUES: Final[Mapping[str, tuple[str, Callable[[FloatArray], Any]]]] = {
    "frames_min": ("frames", np.min),
    "frames_median": ("frames", np.median),
    "frames_max": ("frames", np.max),
    "untrimmed": ("untrimmed", np.mean),
    **{
        f"{name}{suffix}": (f"{of}{suffix}", how)
        for suffix in ("", *(f"_{level}" for level in LEVELS))
        for name, of, how in (
            ("speed_mean", "speed", np.mean),
            ("speed_p99", "speed", functools.partial(np.percentile, q=99)),
            ("speed_max", "speed", np.max),
            ("at_rest", "at_rest", np.mean),
        )
    },
    "step_median": ("step", np.median),
    "step_max": ("step", np.max),
    "items_move": ("items_move", np.mean),
    "holding": ("holding", np.mean),
}
"""Value -> the numbers of which it is, and how."""


def _value(
    per_event: Sequence[FloatArray], units: Sequence[str], how: Callable[[FloatArray], Any]
) -> dict[str, Any] | None:
    """Return ``value``, ``se`` (None where there is none) and ``units``, which are resampled."""
    grouped: dict[str, list[FloatArray]] = {}
    for unit, numbers in zip(units, per_event, strict=True):
        if len(numbers):
            grouped.setdefault(unit, []).append(numbers)
    if not grouped:
        return None
    parts = [np.concatenate(arrays) for arrays in grouped.values()]
    extreme = how in (np.min, np.max)  # whose error no resampling tells
    return {
        "value": float(how(np.concatenate(parts))),
        "se": None if extreme else standard_error(parts, how),
        "units": len(parts),
    }


def _histogram(per_event: Sequence[FloatArray], edges: Sequence[int]) -> dict[str, Any]:
    inside = np.clip(np.concatenate(per_event), edges[0], edges[-1])
    return {"edges": list(edges), "counts": np.histogram(inside, edges)[0].tolist()}


def standard_error(
    parts: Sequence[FloatArray], function: Callable[[FloatArray], Any]
) -> float | None:
    """Return the bootstrap's standard error of a function of all parts together.

    None for a single part.
    """
    n = len(parts)
    if n < 2:
        return None
    rng = np.random.default_rng(0)
    again = [
        float(function(np.concatenate([parts[i] for i in rng.integers(n, size=n)])))
        for _ in range(_RESAMPLINGS)
    ]
    return float(np.std(again, ddof=1))


def _holding(
    events: Sequence[Event], told: Sequence[Mapping[str, Any]]
) -> tuple[list[FloatArray], str]:
    """Return per event, frame and agent how much of it an item is held, and whence it is known."""
    n_agents = len(events[0].scene.world.agents)
    recorded = [(entry.get("measures") or {}).get("held") for entry in told]
    if all(isinstance(held, list) and len(held) == n_agents for held in recorded):
        known = [
            np.repeat(np.asarray(held, np.float64), event.observation.n_frames)
            for event, held in zip(events, recorded, strict=True)
        ]
        return known, "recorded"
    seen = (seems_to_hold(e.observation.trajectory, e.scene.radius, n_agents) for e in events)
    return [flags.ravel().astype(np.float64) for flags in seen], "geometry"


def _tables(
    events: Sequence[Event], told: Sequence[Mapping[str, Any]], units: Sequence[str]
) -> dict[str, Any]:
    world = events[0].scene.world
    n = len(world.agents)
    sizes = sorted(f"{size:g}" for size in SIZES)
    known: dict[str, Sequence[str]] = {
        "relation": RELATIONS,
        "scenario": SCENARIOS,
        "goal_type": GOAL_TYPES,
        "goal": world.goals,
        "strength": LEVELS,
        "agent_size": sizes,
        "item_size": sizes,
        **{key: () for key in ("family", "layout", "split", "reflection")},
    }
    labels: dict[str, list[tuple[str, str]]] = {key: [] for key in known}
    for event, entry, unit in zip(events, told, units, strict=True):
        size = [
            next((f"{one:g}" for one in SIZES if abs(radius - one) < 1e-3), OTHER)
            for radius in event.scene.radius
        ]
        forces = [force for force in _strengths(event) if force is not None]
        goals, pairs = _goals_and_scenarios(event.truth)
        of_event: dict[str, Iterable[str]] = {
            "relation": [relation for relation, _ in pairs],
            "scenario": [name for _, name in pairs],
            "goal_type": [goal_type(goal, world) for goal in goals],
            "goal": [world.goals[goal] for goal in goals],
            "strength": [f"{force:g}" if force in STRENGTH_LEVELS else OTHER for force in forces],
            "agent_size": size[:n],
            "item_size": size[n:],
        }
        for key in known.keys() - of_event:
            of_event[key] = [] if entry.get(key) is None else [str(entry[key])]
        for key, given in of_event.items():
            labels[key] += [(label, unit) for label in given]
    found = {}
    for key, told_of in labels.items():
        first = known[key] or sorted({label for label, _ in told_of}, key=_place)
        counts = Counter(dict.fromkeys(first, 0))
        counts.update(label for label, _ in told_of)
        if told_of:
            found[key] = _counted(len({unit for _, unit in told_of}), counts)
    return found


def _goals_and_scenarios(
    truth: Truth | Roles | None,
) -> tuple[Sequence[int], list[tuple[str, str]]]:
    """Return (agent,) effective goals, and relation and scenario of every pair of agents."""
    if truth is None:
        return [], []
    if isinstance(truth, Truth):
        goals = [goal_index(goal) for goal in (truth.goal_red, truth.goal_green)]
        return goals, [(truth.relation, truth.scenario)]
    pairs = itertools.combinations(enumerate(truth.effective_goals), 2)
    names = [
        scenario(goal, goal_of_other, truth.world, (one, other))
        for (one, goal), (other, goal_of_other) in pairs
    ]
    return truth.effective_goals, [(RELATION_OF_SCENARIO[name], name) for name in names]


def goal_type(goal: str | int, world: World = PHASE_WORLD) -> str:
    """Return which of :data:`GOAL_TYPES` a goal is; "other" for a predicate of one's own."""
    literal = goal_literal(goal, 0, world)
    if literal.predicate is Predicate.OWN:
        return OTHER
    if literal.predicate is Predicate.TOUCH:
        kind = "TE"
    else:
        kind = "LMA" if literal.subject < len(world.agents) else "LMO"
    return kind + ("+" if literal.positive else "-")


def _strengths(event: Event) -> tuple[float | None, ...]:
    """Return (agent,) strengths, newtons, as far as they are known."""
    if isinstance(event.truth, Roles):
        return event.truth.strengths
    if event.truth is not None:
        return event.truth.strength_red, event.truth.strength_green
    return (None,) * len(event.scene.world.agents)


def _place(label: str) -> tuple[int, int, str]:
    """Return the sorting key of a label: those of the original events, numbers, others."""
    if label in _ORIGINAL_ORDER:
        return 0, _ORIGINAL_ORDER.index(label), ""
    return (1, int(label), "") if label.isdecimal() else (2, 0, label)


def _entries(manifest: Mapping[str, Any] | None) -> dict[str, Mapping[str, Any]]:
    """Return id -> entry."""
    if manifest is None:
        return {}
    entries = manifest.get("entries") if isinstance(manifest, Mapping) else None
    if not isinstance(entries, Sequence) or not all(
        isinstance(entry, Mapping) and isinstance(entry.get("id"), str) for entry in entries
    ):
        raise InvalidSettingError(
            f"manifest={shown(manifest)}, expected one with a list 'entries' of objects with an id"
        )
    return {entry["id"]: entry for entry in entries}


def _draws(manifest: Mapping[str, Any]) -> dict[str, Any] | None:
    kept, rejected = manifest.get("kept"), manifest.get("rejected")
    if not isinstance(kept, Mapping) or not isinstance(rejected, Mapping):
        return None
    found = {}
    for cell in sorted({*kept, *rejected}):
        reasons = Counter({str(why): int(n) for why, n in rejected.get(cell, {}).items()})
        n = int(kept.get(cell, 0))
        tried = n + reasons.total()
        found[cell] = {
            "kept": n,
            "tried": tried,
            "share": n / tried if tried else None,
            "reasons": dict(reasons.most_common()),
        }
    return found
