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
``"resets_velocity": true`` is there where agents stand still after each step, as those that people
steer, and is not written elsewhere.
``truth`` (effective goals), ``judgments`` and ``predictions`` may be missing or null.

An event of another world than PHASE has its names in place of these, and a field ``world``::

      "world": {"name": "yard", "agents": ["red agent", "green agent"], "items": ["ball"],
                "landmarks": {"home": [4.0, 4.0, 2.5]}, "arena": [0.0, 36.0, 0.0, 24.0],
                "walls": [], "colours": {"ball": [117, 216, 230], ...},
                "touchable": ["red agent", "green agent", "ball"], "quadrants": false},
      "truth": {"goals": {"red agent": "Get ball to home"},
                "relation": [["green agent", "red agent", "hinder"]],
                "strengths": {"red agent": 450.0, "green agent": 300.0}}

Its goals are the agents' own; who helps or hinders another has none.

Several events: ``{"format": "phase-ppl-events-1", "events": [...]}``, each as above (without
``format``), with different ids.

Writing and reading changes no number.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.dataset.documents import event_id, only, optional, per_name, require
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import instance_of
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.hypothesis import Roles
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS
from phase_ppl.world.scene import PHASE, Scene, Turning, World, finite_array, one_or_all

EVENT_FORMAT: Final = "phase-ppl-event-1"
EVENTS_FORMAT: Final = "phase-ppl-events-1"

Entries = list[tuple[str, Callable[[], Event]]]
"""What a file holds: per event its id and the function that reads it."""

LABELS: Final[Mapping[str, Sequence[str]]] = {
    "entity": ENTITIES,
    "coord": ("x", "y", "angle"),
    "xy": ("x", "y"),
    "landmark": LANDMARKS,
    "bound": ("x_min", "x_max", "y_min", "y_max"),
}
"""Dimension of an array -> names of the places along it."""

LENGTH: Final = "units of length"
POSE: Final = "units of length (x, y), radians (angle)"


def labels_of(world: World) -> Mapping[str, Sequence[str]]:
    """Return :data:`LABELS` with the names of a world."""
    return {**LABELS, "entity": world.entities, "landmark": world.landmark_names}


class Field(NamedTuple):
    """An array of an event, as its files have it."""

    key: str  # its name in a JSON scene
    dims: tuple[str, ...]  # its dimensions; those of ``LABELS`` have named places
    units: str = LENGTH  # in words

    def shape(self, labels: Mapping[str, Sequence[str]]) -> tuple[int | None, ...]:
        """Return the length of each dimension; None for any."""
        return tuple(len(labels[dim]) if dim in labels else None for dim in self.dims)


TRAJECTORY: Final = Field("trajectories", ("time", "entity", "coord"), POSE)
SCENE: Final[Mapping[str, Field]] = {
    "start": Field("start", ("entity", "coord"), POSE),
    "radius": Field("radius", ("entity",)),
    "walls": Field("walls", ("wall", "end", "xy")),
    "landmark_centres": Field("landmarks", ("landmark", "xy")),
    "landmark_half_width": Field("landmark_half_width", ()),
    "arena": Field("arena", ("bound",)),
}
"""Attribute of a scene -> how files have it; beside these there are ``turning``, a text, and
``resets_velocity``, which only a scene that does so has."""

DOCUMENTS: Final = ("judgments", "predictions")  # of any content
_EVENT_FIELDS: Final = ("format", "id", "world", "scene", "trajectories", "truth", *DOCUMENTS)
_TRUTH_FIELDS: Final = ("goals", "relation", "scenario", "strengths")
_SCENE_FIELDS: Final = (
    *("arena", "walls", "landmarks", "landmark_half_width", "turning"),
    *("resets_velocity", "radius", "start"),
)
_LINE_CHARACTERS = 100


# --- reading ---------------------------------------------------------------------------------


def fields_of(world: World) -> Mapping[str, Field]:
    """Return :data:`SCENE`; squares of landmarks have sizes of their own but in PHASE."""
    if world == PHASE:
        return SCENE
    return {**SCENE, "landmark_half_width": Field("landmark_half_width", ("landmark",))}


def read_one(document: Mapping[str, Any]) -> Entries:
    """Return the one event of a document in :data:`EVENT_FORMAT`, not yet read."""
    return [(event_id(document), functools.partial(event_from_record, document))]


def read_many(document: Mapping[str, Any]) -> Entries:
    """Return the events of a document in :data:`EVENTS_FORMAT`, not yet read."""
    only(document, ("format", "events"), "a file of events")
    return entries_of(document, "events", event_from_record)


def entries_of(
    document: Mapping[str, Any], field: str, read: Callable[[dict[str, Any]], Event]
) -> Entries:
    """Return the events in a list of JSON objects, each to be read by ``read``."""
    entries: Entries = []
    for index, record in enumerate(require(document, field, list)):
        where = f"{field}[{index}]"
        if not isinstance(record, dict):
            raise InvalidEventError(f"{where} is no JSON object")
        entries.append((event_id(record, where), functools.partial(read, record)))
    return entries


def event_from_record(record: Mapping[str, Any]) -> Event:
    """Return the event that a JSON object describes; in place of lists it may have arrays."""
    only(record, _EVENT_FIELDS, "an event")
    given = optional(record, "world", dict)
    world = PHASE if given is None else World.from_dict(given)
    tracks = require(record, "trajectories", dict)
    observation = read_observation(tracks, "trajectories", world.entities)
    truth = optional(record, "truth", dict)
    known: Truth | Roles | None = None
    if truth is not None:
        only(truth, _TRUTH_FIELDS, "truth")
        of_phase = world == PHASE
        known = read_truth(truth, "strengths") if of_phase else Roles.from_dict(world, truth)
    return Event(
        scene=_scene(require(record, "scene", dict), observation.trajectory[0], world),
        observation=observation,
        id=event_id(record),
        truth=known,
        judgments=optional(record, "judgments", dict),
        predictions=optional(record, "predictions", dict),
    )


def read_observation(
    record: Mapping[str, Any], where: str, entities: Sequence[str] = ENTITIES
) -> Observation:
    """Return the observation in an object that maps entity names to rows of [x, y, angle]."""
    tracks = [
        finite_array(f"{where}[{name!r}]", rows, (None, 3))
        for name, rows in zip(entities, per_name(record, entities, where), strict=True)
    ]
    lengths = [len(track) for track in tracks]
    if len(set(lengths)) > 1:
        listed = ", ".join(f"{n} {name}" for n, name in zip(lengths, entities, strict=True))
        raise InvalidEventError(f"{where} differ in length: {listed}")
    return Observation(np.stack(tracks, axis=1))


def _scene(record: Mapping[str, Any], first_frame: FloatArray, world: World) -> Scene:
    only(record, _SCENE_FIELDS, "scene")
    given: dict[str, Any] = {"start": first_frame, "world": world}
    labels = labels_of(world)
    for name in ("walls", "turning", "landmark_half_width", "resets_velocity"):
        if name in record:
            given[name] = record[name]
    if "arena" in record:
        given["arena"] = _by_name(record, "arena", ("x", "y"), (2, 2)).ravel()
    for name in ("landmark_centres", "start", "radius"):
        key, dims, _ = SCENE[name]
        if key in record or name == "radius":
            given[name] = _by_name(record, key, labels[dims[0]], SCENE[name].shape(labels))
    return Scene(**given)


def _by_name(
    record: Mapping[str, Any], key: str, names: Sequence[str], shape: tuple[int | None, ...]
) -> FloatArray:
    values = per_name(require(record, key, dict, "scene"), names, f"scene.{key}")
    return finite_array(f"scene.{key}", values, shape)


def read_truth(
    record: Mapping[str, Any], field: str, newtons: Callable[[Any], Any] = lambda force: force
) -> Truth:
    """Return the truth in an object whose ``field`` has the strengths, which ``newtons`` reads."""
    goals = per_name(require(record, "goals", dict, "truth"), AGENTS, "truth.goals")
    levels = optional(record, field, dict, "truth")
    given = [None, None] if levels is None else per_name(levels, AGENTS, f"truth.{field}")
    red, green = (newtons(level) for level in given)
    return Truth(
        goal_red=goals[0],
        goal_green=goals[1],
        relation=optional(record, "relation", str, "truth") or "",
        scenario=optional(record, "scenario", str, "truth") or "",
        strength_red=red,
        strength_green=green,
    )


def turned(event: Event, turning: Turning) -> Event:
    """Return the event with agents that can turn in other ways."""
    return dataclasses.replace(event, scene=dataclasses.replace(event.scene, turning=turning))


# --- writing ---------------------------------------------------------------------------------


def event_record(event: Event) -> dict[str, Any]:
    """Return the JSON object that :func:`event_from_record` turns back into ``event``."""
    instance_of("event", event, Event, "a phase_ppl.Event")
    scene, world = event.scene, event.scene.world
    arrays = {name: np.asarray(getattr(scene, name)).tolist() for name in SCENE}
    arrays["landmark_half_width"] = one_or_all(scene.half_widths.tolist())
    record: dict[str, Any] = {
        "format": EVENT_FORMAT,
        "id": event_id({"id": event.id}),
        **({} if world == PHASE else {"world": world.to_dict()}),
        "scene": scene_record(arrays, scene.turning, scene.resets_velocity, world),
        "trajectories": tracks_record(event.observation.trajectory, world.entities),
    }
    if isinstance(event.truth, Roles):
        record["truth"] = event.truth.to_dict()
    elif event.truth is not None:
        record["truth"] = truth_record(event.truth, "strengths")
    given = ((name, getattr(event, name)) for name in DOCUMENTS)
    return record | {name: dict(content) for name, content in given if content is not None}


def scene_record(
    arrays: Mapping[str, Any], turning: str, resets_velocity: bool = False, world: World = PHASE
) -> dict[str, Any]:
    """Return the JSON object of a scene, given the values of :data:`SCENE` and its rules."""
    return {
        "arena": arena_record(arrays["arena"]),
        "walls": arrays["walls"],
        "landmarks": dict(zip(world.landmark_names, arrays["landmark_centres"], strict=True)),
        "landmark_half_width": arrays["landmark_half_width"],
        "turning": turning,
        **({"resets_velocity": True} if resets_velocity else {}),
        "radius": dict(zip(world.entities, arrays["radius"], strict=True)),
        "start": dict(zip(world.entities, arrays["start"], strict=True)),
    }


def arena_record(arena: Sequence[float]) -> dict[str, list[float]]:
    """Return the JSON object of x_min, x_max, y_min, y_max."""
    x0, x1, y0, y1 = arena
    return {"x": [x0, x1], "y": [y0, y1]}


def tracks_record(
    trajectory: FloatArray, entities: Sequence[str] = ENTITIES
) -> dict[str, list[list[float]]]:
    """Return the JSON object that :func:`read_observation` reads."""
    return {name: trajectory[:, entity].tolist() for entity, name in enumerate(entities)}


def truth_record(
    truth: Truth, field: str, level: Callable[[float | None], Any] = lambda force: force
) -> dict[str, Any]:
    """Return the JSON object that :func:`read_truth` reads; ``level`` tells a strength."""
    forces = (truth.strength_red, truth.strength_green)
    return {
        "goals": dict(zip(AGENTS, (truth.goal_red, truth.goal_green), strict=True)),
        "relation": truth.relation,
        "scenario": truth.scenario,
        field: dict(zip(AGENTS, map(level, forces), strict=True)),
    }


def event_bytes(event: Event) -> bytes:
    """Return the content of a file of one event."""
    return to_text(event_record(event)).encode()


def events_bytes(events: Sequence[Event]) -> bytes:
    """Return the content of a file of several events."""
    records = [event_record(event) for event in events]
    for record in records:
        del record["format"]
    return to_text({"format": EVENTS_FORMAT, "events": records}).encode()


def to_text(record: Mapping[str, Any], compact: bool = False) -> str:
    """Return ``record`` as JSON text, with what is short, or all if ``compact``, on one line."""
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
