"""The package's own event files: JSON that a person can read and write.

One event::

    {
      "format": "phase-ppl-event-1",
      "id": "collaborate",
      "scene": {
        "arena": {"x": [6.0, 26.0], "y": [2.0, 22.0]},
        "walls": [[[16.0, 12.0], [16.0, 22.0]]],
        "landmarks": {"blue lm": [8.5, 19.5], "green lm": [23.5, 19.5],
                      "red lm": [23.5, 4.5], "yellow lm": [8.5, 4.5]},
        "landmark_half_width": 2.5,
        "turning": "both",
        "radius": {"red agent": 0.8, "green agent": 1.2, "blue item": 0.8, "pink item": 1.01},
        "start": {"red agent": [8.0, 20.0, 0.0], ...}
      },
      "trajectories": {"red agent": [[8.0, 20.0, 0.0], ...], ...},
      "truth": {
        "goals": {"red agent": "Get blue item to red lm", "green agent": "..."},
        "relation": "friendly", "scenario": "collaborative",
        "strengths": {"red agent": 450.0, "green agent": null}
      },
      "judgments": {...},
      "predictions": {...}
    }

Lengths are in units of the world, y up, angles in radians (counter-clockwise, 0 looks up, not
wrapped); a row is [x, y, angle], frame 0 the start, frame k the mean over planner step k; walls
are inner walls [[x, y], [x, y]]; strengths are in newtons. In ``scene`` only ``radius`` must be
given: the rest defaults to the original world without inner walls, ``start`` to the first frame.
``truth`` (effective goals), ``judgments`` and ``predictions`` may be missing or null.

Several events: ``{"format": "phase-ppl-events-1", "events": [...]}``, each as above (without
``format``), with different ids.

Writing and reading changes no number.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.checks import instance_of
from phase_ppl.world.errors import InvalidEventError, shown, unknown_name
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene, finite_array

T = TypeVar("T")
Entries = list[tuple[str, Callable[[], Event]]]
"""What a file holds: per event its id and the function that reads it."""

_WORDS = {dict: "an object", list: "a list", str: "a string", int: "a whole number"}


def require(record: Mapping[str, Any], name: str, kind: type[T], where: str = "") -> T:
    """Return ``record[name]``, which must be there and of JSON type ``kind``.

    Args:
        record: the JSON object.
        name: the wanted field.
        kind: dict, list, str or int.
        where: path of ``record`` in the file, for the error message.

    Raises:
        InvalidEventError: the field is missing or of another type.
    """
    path = f"{where}.{name}" if where else name
    if name not in record:
        raise InvalidEventError(f"has no {path}")
    value = record[name]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InvalidEventError(f"{path} is {shown(value)}, expected {_WORDS[kind]}")
    return value


def optional(record: Mapping[str, Any], name: str, kind: type[T], where: str = "") -> T | None:
    """Return ``record[name]`` as :func:`require` does, or None where it is missing or null."""
    return None if record.get(name) is None else require(record, name, kind, where)


def only(record: Mapping[str, Any], allowed: Sequence[str], where: str) -> None:
    """Raise UnknownNameError if ``record`` has a field that is none of ``allowed``."""
    for name in record:
        if name not in allowed:
            raise unknown_name(f"field of {where}", name, allowed)


def per_name(record: Mapping[str, Any], names: Sequence[str], where: str) -> list[Any]:
    """Return the values of an object whose fields are exactly ``names``, in that order.

    Raises:
        InvalidEventError: a name is missing.
        UnknownNameError: another name is there.
    """
    only(record, names, where)
    missing = [name for name in names if name not in record]
    if missing:
        raise InvalidEventError(f"{where} has no {' and no '.join(missing)}")
    return [record[name] for name in names]


def event_id(record: Mapping[str, Any], where: str = "") -> str:
    """Return the field ``id``: a string that can be printed."""
    name = require(record, "id", str, where)
    if not name.strip() or not name.isprintable():
        raise InvalidEventError(f"id is {shown(name)}, expected printable text")
    return name


def read_observation(record: Mapping[str, Any], where: str) -> Observation:
    """Return the observation in an object that maps entity names to rows of [x, y, angle].

    Raises:
        InvalidEventError: entities are missing, rows are not three finite numbers, lengths
            differ, or there are fewer than 2 frames.
    """
    tracks: list[NDArray[np.float64]] = [
        finite_array(f"{where}[{name!r}]", rows, (None, 3))
        for name, rows in zip(ENTITIES, per_name(record, ENTITIES, where), strict=True)
    ]
    lengths = [len(track) for track in tracks]
    if len(set(lengths)) > 1:
        listed = ", ".join(f"{n} {name}" for n, name in zip(lengths, ENTITIES, strict=True))
        raise InvalidEventError(f"{where} differ in length: {listed}")
    return Observation(np.stack(tracks, axis=1))


# --- the package's own event files: JSON that a person can read and write -------------------------
# One event::
#
# { "format": "phase-ppl-event-1", "id": "collaborate", "scene": { "arena": {"x": [6.0, 26.0],
# "y": [2.0, 22.0]}, "walls": [[[16.0, 12.0], [16.0, 22.0]]], "landmarks": {"blue lm": [8.5,
# 19.5], "green lm": [23.5, 19.5], "red lm": [23.5, 4.5], "yellow lm": [8.5, 4.5]},
# "landmark_half_width": 2.5, "turning": "both", "radius": {"red agent": 0.8, "green agent": 1.2,
# "blue item": 0.8, "pink item": 1.01}, "start": {"red agent": [8.0, 20.0, 0.0], ...} },
# "trajectories": {"red agent": [[8.0, 20.0, 0.0], ...], ...}, "truth": { "goals": {"red agent":
# "Get blue item to red lm", "green agent": "..."}, "relation": "friendly", "scenario":
# "collaborative", "strengths": {"red agent": 450.0, "green agent": null} }, "judgments": {...},
# "predictions": {...} }
#
# Lengths are in units of the world, y up, angles in radians (counter-clockwise, 0 looks up, not
# wrapped); a row is [x, y, angle], frame 0 the start, frame k the mean over planner step k; walls
# are inner walls [[x, y], [x, y]]; strengths are in newtons. In ``scene`` only ``radius`` must be
# given: the rest defaults to the original world without inner walls, ``start`` to the first
# frame. ``truth`` (effective goals), ``judgments`` and ``predictions`` may be missing or null.
#
# Several events: ``{"format": "phase-ppl-events-1", "events": [...]}``, each as above (without
# ``format``), with different ids.
#
# Writing and reading changes no number.

EVENT_FORMAT: Final = "phase-ppl-event-1"
EVENTS_FORMAT: Final = "phase-ppl-events-1"

_EVENT_FIELDS = ("format", "id", "scene", "trajectories", "truth", "judgments", "predictions")
_SCENE_FIELDS = (
    "arena",
    "walls",
    "landmarks",
    "landmark_half_width",
    "turning",
    "radius",
    "start",
)
_TRUTH_FIELDS = ("goals", "relation", "scenario", "strengths")
_LINE_CHARACTERS = 100


def read_one(document: Mapping[str, Any]) -> Entries:
    """Return the one event of a document in :data:`EVENT_FORMAT`, not yet read."""
    return [(event_id(document), functools.partial(event_from_record, document))]


def read_many(document: Mapping[str, Any]) -> Entries:
    """Return the events of a document in :data:`EVENTS_FORMAT`, not yet read."""
    only(document, ("format", "events"), "a file of events")
    entries: Entries = []
    for index, record in enumerate(require(document, "events", list)):
        if not isinstance(record, dict):
            raise InvalidEventError(f"events[{index}] is no JSON object")
        name = event_id(record, f"events[{index}]")
        entries.append((name, functools.partial(event_from_record, record)))
    return entries


def event_from_record(record: Mapping[str, Any]) -> Event:
    """Return the event that a parsed JSON object describes.

    Raises:
        InvalidEventError: something is missing, of the wrong type or impossible.
        UnknownNameError: a field, goal, relation or scenario is unknown.
    """
    only(record, _EVENT_FIELDS, "an event")
    observation = read_observation(require(record, "trajectories", dict), "trajectories")
    truth = optional(record, "truth", dict)
    return Event(
        scene=_scene(require(record, "scene", dict), observation.trajectory[0]),
        observation=observation,
        id=event_id(record),
        truth=None if truth is None else _truth(truth),
        judgments=optional(record, "judgments", dict),
        predictions=optional(record, "predictions", dict),
    )


def _scene(record: Mapping[str, Any], first_frame: NDArray[np.float64]) -> Scene:
    only(record, _SCENE_FIELDS, "scene")

    def named(name: str, names: Sequence[str], shape: tuple[int, ...]) -> NDArray[np.float64]:
        values = per_name(require(record, name, dict, "scene"), names, f"scene.{name}")
        return finite_array(f"scene.{name}", values, shape)

    given: dict[str, Any] = {
        name: record[name] for name in ("walls", "turning", "landmark_half_width") if name in record
    }
    if "arena" in record:
        given["arena"] = named("arena", ("x", "y"), (2, 2)).ravel()
    if "landmarks" in record:
        given["landmark_centres"] = named("landmarks", LANDMARKS, (len(LANDMARKS), 2))
    start = named("start", ENTITIES, (len(ENTITIES), 3)) if "start" in record else first_frame
    return Scene(start=start, radius=named("radius", ENTITIES, (len(ENTITIES),)), **given)


def _truth(record: Mapping[str, Any]) -> Truth:
    only(record, _TRUTH_FIELDS, "truth")
    goals = per_name(require(record, "goals", dict, "truth"), AGENTS, "truth.goals")
    strengths = optional(record, "strengths", dict, "truth")
    red, green = (
        (None, None) if strengths is None else per_name(strengths, AGENTS, "truth.strengths")
    )
    return Truth(
        goal_red=goals[0],
        goal_green=goals[1],
        relation=optional(record, "relation", str, "truth") or "",
        scenario=optional(record, "scenario", str, "truth") or "",
        strength_red=red,
        strength_green=green,
    )


def event_record(event: Event) -> dict[str, Any]:
    """Return the JSON object that :func:`event_from_record` turns back into ``event``.

    Raises:
        InvalidEventError: the id is no printable text.
    """
    instance_of("event", event, Event, "a phase_ppl.Event")
    scene, truth = event.scene, event.truth
    x0, x1, y0, y1 = scene.arena
    record: dict[str, Any] = {
        "format": EVENT_FORMAT,
        "id": event_id({"id": event.id}),
        "scene": {
            "arena": {"x": [x0, x1], "y": [y0, y1]},
            "walls": scene.walls.tolist(),
            "landmarks": dict(zip(LANDMARKS, scene.landmark_centres.tolist(), strict=True)),
            "landmark_half_width": scene.landmark_half_width,
            "turning": scene.turning,
            "radius": dict(zip(ENTITIES, scene.radius.tolist(), strict=True)),
            "start": dict(zip(ENTITIES, scene.start.tolist(), strict=True)),
        },
        "trajectories": {
            name: event.observation.trajectory[:, entity].tolist()
            for entity, name in enumerate(ENTITIES)
        },
    }
    if truth is not None:
        record["truth"] = {
            "goals": dict(zip(AGENTS, (truth.goal_red, truth.goal_green), strict=True)),
            "relation": truth.relation,
            "scenario": truth.scenario,
            "strengths": dict(zip(AGENTS, (truth.strength_red, truth.strength_green), strict=True)),
        }
    if event.judgments is not None:
        record["judgments"] = dict(event.judgments)
    if event.predictions is not None:
        record["predictions"] = dict(event.predictions)
    return record


def events_record(events: Sequence[Event]) -> dict[str, Any]:
    """Return the JSON object of a file of several events."""
    records = [event_record(event) for event in events]
    for record in records:
        del record["format"]
    return {"format": EVENTS_FORMAT, "events": records}


def to_text(record: Mapping[str, Any], compact: bool = False) -> str:
    """Return ``record`` as JSON text, with what is short, or all if ``compact``, on one line.

    Raises:
        InvalidEventError: a value has no JSON form, such as NaN.
    """
    try:
        return json.dumps(record, allow_nan=False) if compact else _layout(record, 0) + "\n"
    except (TypeError, ValueError, RecursionError) as error:
        raise InvalidEventError(f"cannot be written as JSON: {error}") from None


def _layout(value: Any, indent: int) -> str:
    line = json.dumps(value, allow_nan=False)
    if len(line) + indent <= _LINE_CHARACTERS or not isinstance(value, (dict, list, tuple)):
        return line
    pad = " " * (indent + 2)
    if isinstance(value, dict):
        parts = [f"{json.dumps(k)}: {_layout(v, indent + 2)}" for k, v in value.items()]
        opening, closing = "{", "}"
    else:
        parts = [_layout(v, indent + 2) for v in value]
        opening, closing = "[", "]"
    inside = ",\n".join(pad + part for part in parts)
    return f"{opening}\n{inside}\n{' ' * indent}{closing}"
