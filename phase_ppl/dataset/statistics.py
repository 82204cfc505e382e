"""The statistics of a set of events, as plain data: what is in it, and how its bodies move."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.dataset.counts import LEVELS, strengths, tables
from phase_ppl.dataset.motion import SLOW, moves_to_the_end, seems_to_hold, speeds
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.names import AGENTS
from phase_ppl.world.observation import FRAMES_PER_SECOND

_RESAMPLINGS: Final = 200


class Estimates:
    """Numbers about a set, with their standard errors.

    Args:
        units: per event the unit that it belongs to; units are what is resampled.

    Attributes:
        found: name -> ``value``, ``se`` (None where there is none), ``units``.
    """

    def __init__(self, units: Sequence[str]) -> None:
        self._units = list(units)
        self.found: dict[str, dict[str, Any]] = {}

    def add(
        self,
        name: str,
        per_event: Sequence[Any],
        function: Callable[[FloatArray], Any] = np.mean,
        *,
        extreme: bool = False,
    ) -> None:
        """Add a function of all numbers, of which each event has some or none.

        Args:
            name: of the result.
            per_event: a sequence of numbers for every event.
            function: of all of them together.
            extreme: whether it is a least or greatest value, whose error no resampling tells.
        """
        grouped: dict[str, list[FloatArray]] = {}
        for unit, numbers in zip(self._units, per_event, strict=True):
            if len(numbers):
                grouped.setdefault(unit, []).append(np.asarray(numbers, np.float64))
        if not grouped:
            return
        parts = [np.concatenate(arrays) for arrays in grouped.values()]
        self.found[name] = {
            "value": float(function(np.concatenate(parts))),
            "se": None if extreme else standard_error(parts, function),
            "units": len(parts),
        }


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


def percentile_99(values: FloatArray) -> float:
    """Return the number that one in a hundred exceeds."""
    return float(np.percentile(values, 99))


# --- the statistics of a set of events, as plain data: what is in it, and how its... --------------

FRAME_EDGES: Final = (*range(0, 101, 10), 102)
SPEED_EDGES: Final = tuple(range(0, 71, 2))
"""Edges of the histograms of durations [frames] and speeds [units/s]; the last bins are open."""

Statistics = dict[str, Any]


def statistics(
    events: Sequence[Event], manifest: Mapping[str, Any] | None = None, *, name: str = "this set"
) -> Statistics:
    """Return the statistics of a set of events, as plain data fit for JSON.

    Keys of the result:

    * ``name``, ``events``; ``units``: events without their copies, which the manifest knows;
      ``without_truth``: events; ``without_strength``: agents.
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

    What there is nothing to tell about is left out of ``tables`` and ``values``.

    Args:
        events: the set; those without truth count where none is needed.
        manifest: of a generated set, see :mod:`phase_ppl.dataset.generation`.
        name: of the set, as figures and tables call it.

    Raises:
        InvalidEventError: there are no events.
        InvalidSettingError: the manifest is none.
    """
    if not events:
        raise InvalidEventError("there are no events to describe")
    events = list(events)  # gone through many times; those of a stored set are read each time
    entries = _entries(manifest)
    units = [str(entries.get(event.id, {}).get("group", event.id)) for event in events]
    tracks = [event.observation.trajectory for event in events]
    frames = [[float(len(track))] for track in tracks]
    moving = _speeds_by_strength(events)
    held, holding_from = _holding(events, entries)
    values = Estimates(units)
    values.add("frames_min", frames, np.min, extreme=True)
    values.add("frames_median", frames, np.median)
    values.add("frames_max", frames, np.max, extreme=True)
    values.add("untrimmed", [[moves_to_the_end(track)] for track in tracks])
    for suffix, agents in moving.items():
        values.add(f"speed_mean{suffix}", agents)
        values.add(f"speed_p99{suffix}", agents, percentile_99)
        values.add(f"speed_max{suffix}", agents, np.max, extreme=True)
        values.add(f"at_rest{suffix}", [speed < SLOW for speed in agents])
    steps = [speed / FRAMES_PER_SECOND for speed in moving[""]]
    values.add("step_median", steps, np.median)
    values.add("step_max", steps, np.max, extreme=True)
    values.add("items_move", [speeds(track)[:, len(AGENTS) :].ravel() >= SLOW for track in tracks])
    values.add("holding", held)
    drawn = {"frames": (np.concatenate(frames), FRAME_EDGES)} | {
        f"speed{suffix}": (np.concatenate(agents), SPEED_EDGES) for suffix, agents in moving.items()
    }
    return {
        "name": name,
        "events": len(events),
        "units": len(set(units)),
        "without_truth": sum(event.truth is None for event in events),
        "without_strength": sum(force is None for event in events for force in strengths(event)),
        "tables": tables(events, entries, units),
        "values": values.found,
        "holding_from": holding_from,
        "histograms": {key: _histogram(*given) for key, given in drawn.items()},
        "draws": None if manifest is None else _draws(manifest),
    }


def _speeds_by_strength(events: Sequence[Event]) -> dict[str, list[FloatArray]]:
    """Return the agents' speeds per event, of all (key "") and of each strength ("_150", ...)."""
    found: dict[str, list[FloatArray]] = {"": []}
    found.update({f"_{level}": [] for level in LEVELS})
    for event in events:
        agents = speeds(event.observation.trajectory)[:, : len(AGENTS)]
        found[""].append(agents.ravel())
        for level, name in zip(STRENGTH_LEVELS, LEVELS, strict=True):
            of_level = [agent for agent, force in enumerate(strengths(event)) if force == level]
            found[f"_{name}"].append(agents[:, of_level].ravel())
    return found


def _histogram(numbers: FloatArray, edges: Sequence[float]) -> dict[str, list[float]]:
    inside = np.clip(numbers, edges[0], edges[-1])
    return {"edges": list(edges), "counts": np.histogram(inside, edges)[0].tolist()}


def _holding(
    events: Sequence[Event], entries: Mapping[str, Mapping[str, Any]]
) -> tuple[list[FloatArray], str]:
    """Return per event, frame and agent how much of it an item is held, and whence it is known."""
    recorded = [(entries.get(event.id, {}).get("measures") or {}).get("held") for event in events]
    if all(isinstance(held, list) and len(held) == len(AGENTS) for held in recorded):
        known = [
            np.repeat(np.asarray(held, np.float64), event.observation.n_frames)
            for event, held in zip(events, recorded, strict=True)
        ]
        return known, "recorded"
    seen = [
        seems_to_hold(event.observation.trajectory, event.scene.radius).ravel().astype(np.float64)
        for event in events
    ]
    return seen, "geometry"


# --- what the manifest tells -------------------------------------------------------------------


def _entries(manifest: Mapping[str, Any] | None) -> dict[str, Mapping[str, Any]]:
    """Return id -> entry.

    Raises:
        InvalidSettingError: the manifest has no list of entries with an id.
    """
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
