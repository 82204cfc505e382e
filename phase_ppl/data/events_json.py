"""Events as JSON that people can read and write, and the JSON of the authors' test videos.

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

A row is null throughout where the body was not seen, and has null as angle where that was not.

Lengths are in units of the world, y up. Angles are in radians (counter-clockwise, 0 looks up, not
wrapped). A row is [x, y, angle]; frame 0 is the start, frame k the mean over planner step k. Walls
are inner walls [[x, y], [x, y]]; strengths are in newtons. ``scene`` requires only ``radius``: the
rest defaults to the original world without inner walls, ``start`` to where bodies are seen first.
``"resets_velocity": true`` means that agents stand still after each step, as people steer them; it
is left out elsewhere. ``truth`` (effective goals), ``judgments`` and ``predictions`` may be missing
or null.

An event of another world than PHASE has that world's names, and a field ``world``::

      "world": {"name": "yard", "agents": ["red agent", "green agent"], "items": ["ball"],
                "landmarks": {"home": [4.0, 4.0, 2.5]}, "arena": [0.0, 36.0, 0.0, 24.0],
                "walls": [], "colours": {"ball": [117, 216, 230], ...},
                "touchable": ["red agent", "green agent", "ball"], "quadrants": false},
      "truth": {"goals": {"red agent": "Get ball to home"},
                "relation": [["green agent", "red agent", "hinder"]],
                "strengths": {"red agent": 450.0, "green agent": 300.0}}

Its goals are the agents' own; agents that help or hinder have none.

Several events: ``{"format": "phase-ppl-events-1", "events": [...]}``, each as above (without
``format``), with different ids.

Writing and reading changes no number.

The ``phase-test-1`` format has the authors' PHASE test videos. It is one object, whose head gives
the arena and the landmarks' half width, and a list ``videos``. Per video, ``observed`` is what an
observer may use (walls, landmarks, sizes, trajectories), ``truth`` the generating parameters,
``human`` counts of people's relation judgments, ``models`` the predictions of other models. Goals
are effective ones: helper and helpee share a goal, a hinderer holds the negation.
``mirror_of_original`` is not read, and ``turning`` is inferred from the angles. This format is not
written.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Final

import msgspec
import numpy as np

from phase_ppl.data.documents import check_once, converted, event_id, per_name
from phase_ppl.world.errors import InvalidEventError, instance_of, shown
from phase_ppl.world.event import (
    Event,
    Observation,
    Truth,
    truth_class,
)
from phase_ppl.world.hypothesis import STRENGTH_LEVELS, Hypothesis
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS
from phase_ppl.world.scene import (
    LANDMARK_HALF_WIDTH,
    PHASE,
    Scene,
    Turning,
    World,
    one_or_all,
    world_in_files,
)

EVENT_FORMAT: Final = "phase-ppl-event-1"
EVENTS_FORMAT: Final = "phase-ppl-events-1"
VIDEOS_FORMAT: Final = "phase-test-1"

Entries = list[tuple[str, Callable[[], Event]]]
"""The events of a file: for each its id and the function that reads it."""

_LINE_CHARACTERS = 100


# --- reading ---------------------------------------------------------------------------------

_Point = tuple[float, float]
_Pose = tuple[float, float, float]
_Seen = tuple[float | None, float | None, float | None]
_Document = dict[str, Any]


class _Strict(msgspec.Struct, forbid_unknown_fields=True):
    """A record in the package's own format: unknown fields are refused, null means the default."""


class _Arena(_Strict):
    x: _Point
    y: _Point


class _Scene(_Strict):
    radius: _Document
    arena: _Arena | None = None
    walls: list[tuple[_Point, _Point]] | None = None
    landmarks: _Document | None = None
    landmark_half_width: float | list[float] | None = None
    turning: Any = "both"
    resets_velocity: bool = False
    start: _Document | None = None


class _Truth(_Strict):
    goals: _Document
    relation: str | None = None
    scenario: str | None = None
    strengths: _Document | None = None


class _Event(_Strict):
    id: Any
    scene: _Document
    trajectories: _Document
    format: Any = EVENT_FORMAT
    world: _Document | None = None
    truth: _Document | None = None
    judgments: _Document | None = None
    predictions: _Document | None = None


class _Events(_Strict):
    format: str
    events: list[_Document]


def read(document: Mapping[str, Any]) -> Entries:
    """Return the events of a document in one of these formats; each is read when it is used."""
    tag, reader = document.get("format"), event_from_record
    if tag == EVENT_FORMAT:
        records = [dict(document)]
    elif tag == EVENTS_FORMAT:
        records = converted(document, _Events).events
    elif tag == VIDEOS_FORMAT:
        head = converted(document, _Videos)
        records, reader = head.videos, functools.partial(_event_of_video, head=head)
    else:
        known = ", ".join(map(repr, (EVENT_FORMAT, EVENTS_FORMAT, VIDEOS_FORMAT)))
        has = "no format" if tag is None else f"format {shown(tag)}"
        raise InvalidEventError(f"is no event file: it has {has}, expected one of {known}")
    return [(event_id(record.get("id")), functools.partial(reader, record)) for record in records]


def event_from_record(record: Mapping[str, Any]) -> Event:
    """Return the event that a JSON object describes."""
    own = converted(record, _Event)
    world = PHASE if own.world is None else World.from_dict(own.world)
    observation = _observation(own.trajectories, world, "trajectories")
    scene, bodies = converted(own.scene, _Scene, "scene"), world.entities
    start, centres, arena = scene.start, scene.landmarks, scene.arena
    return Event(
        Scene(
            observation.start if start is None else _by_name(start, bodies, _Pose, "scene.start"),
            _by_name(scene.radius, bodies, float, "scene.radius"),
            scene.walls,
            scene.turning,
            None if arena is None else (*arena.x, *arena.y),
            None
            if centres is None
            else _by_name(centres, world.landmark_names, _Point, "scene.landmarks"),
            scene.landmark_half_width,
            scene.resets_velocity,
            world,
        ),
        observation,
        event_id(own.id),
        None if own.truth is None else _truth(own.truth, world),
        own.judgments,
        own.predictions,
    )


def _by_name(record: Mapping[str, Any], names: Sequence[str], form: Any, where: str) -> list[Any]:
    """Return the values of an object that has exactly these names, in their order."""
    values = zip(names, per_name(record, names, where), strict=True)
    return [converted(value, form, f"{where}[{name!r}]") for name, value in values]


def _observation(record: Mapping[str, Any], world: World, where: str) -> Observation:
    tracks = _by_name(record, world.entities, list[_Seen], where)
    if len(set(map(len, tracks))) > 1:
        listed = (f"{len(rows)} {name}" for rows, name in zip(tracks, world.entities, strict=True))
        raise InvalidEventError(f"{where} differ in length: {', '.join(listed)}")
    return Observation(np.array(tracks, float).reshape(len(tracks), -1, 3).swapaxes(0, 1))


def _truth(record: _Document, world: World) -> Truth | Hypothesis:
    if truth_class(world) is Hypothesis:
        return Hypothesis.from_dict(record, world)
    told = converted(record, _Truth, "truth")
    red, green = _by_name(told.goals, AGENTS, str, "truth.goals")
    forces = told.strengths or dict.fromkeys(AGENTS)
    one, other = _by_name(forces, AGENTS, float | None, "truth.strengths")
    return Truth(red, green, told.relation or "", told.scenario or "", one, other)


def turned(event: Event, turning: Turning) -> Event:
    """Return the event with agents that can turn in other ways."""
    return dataclasses.replace(event, scene=dataclasses.replace(event.scene, turning=turning))


# --- writing ---------------------------------------------------------------------------------


def event_record(event: Event) -> dict[str, Any]:
    """Return the JSON object that :func:`event_from_record` turns back into ``event``."""
    instance_of("event", event, Event, "a phase_ppl.Event")
    scene, world, truth = event.scene, event.scene.world, event.truth
    kept = world_in_files(world)
    x0, x1, y0, y1 = np.asarray(scene.arena).tolist()
    centres = scene.landmark_centres.tolist()
    tracks: Any = np.moveaxis(event.observation.trajectory, 1, 0)
    if event.observation.has_gaps:
        tracks = np.where(np.isnan(tracks), np.array(None), tracks)
    record: dict[str, Any] = {
        "format": EVENT_FORMAT,
        "id": event_id(event.id),
        **({} if kept is None else {"world": kept}),
        "scene": {
            "arena": {"x": [x0, x1], "y": [y0, y1]},
            "walls": np.asarray(scene.walls).tolist(),
            "landmarks": dict(zip(world.landmark_names, centres, strict=True)),
            "landmark_half_width": one_or_all(scene.half_widths.tolist()),
            "turning": scene.turning,
            **({"resets_velocity": True} if scene.resets_velocity else {}),
            "radius": dict(zip(world.entities, scene.radius.tolist(), strict=True)),
            "start": dict(zip(world.entities, scene.start.tolist(), strict=True)),
        },
        "trajectories": dict(zip(world.entities, tracks.tolist(), strict=True)),
    }
    if truth is not None:
        record["truth"] = truth.to_dict()
    given = {"judgments": event.judgments, "predictions": event.predictions}
    return record | {name: dict(one) for name, one in given.items() if one is not None}


def event_bytes(event: Event) -> bytes:
    """Return the content of a file of one event."""
    return to_text(event_record(event)).encode()


def events_bytes(events: Sequence[Event]) -> bytes:
    """Return the content of a file of several events."""
    records = [event_record(event) for event in events]
    for record in records:
        del record["format"]
    return to_text({"format": EVENTS_FORMAT, "events": records}).encode()


def checksum(event: Event) -> str:
    """Return the SHA-256 of all contents of an event, as hexadecimal digits."""
    # names of judgments may be numbers; JSON has strings
    record = json.loads(to_text(event_record(event), compact=True))
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


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


# --- the authors' test videos --------------------------------------------------------------------


class _Mark(msgspec.Struct):
    name: str
    centre: _Point


class _Body(msgspec.Struct):
    name: str
    radius: float


class _Observed(msgspec.Struct):
    wall_segments: list[tuple[_Point, _Point]]
    landmarks: list[_Mark]
    entities: list[_Body]
    trajectories: _Document
    n_frames: int | None = None


class _Generated(msgspec.Struct):
    goals: _Document
    relation: str | None = None
    scenario: str | None = None
    strength_id: dict[str, Annotated[int, msgspec.Meta(ge=0, le=3)] | None] | None = None


class _Video(msgspec.Struct):
    id: Any
    observed: _Observed
    truth: _Generated | None = None
    human: _Document | None = None
    models: _Document | None = None


class _Videos(msgspec.Struct):
    arena: _Arena
    videos: list[_Document]
    landmark_half_width: float = LANDMARK_HALF_WIDTH


def _event_of_video(record: Mapping[str, Any], *, head: _Videos) -> Event:
    from phase_ppl.data.motion import observed_turning

    own = converted(record, _Video)
    observed, told = own.observed, own.truth
    truth = None
    if told is not None:
        levels = (told.strength_id or {}).items()
        forces = {
            name: level if level is None else STRENGTH_LEVELS[level] for name, level in levels
        }
        fields = {"relation": told.relation, "scenario": told.scenario, "strengths": forces or None}
        truth = _truth({"goals": told.goals, **fields}, PHASE)
    observation = _observation(observed.trajectories, PHASE, "observed.trajectories")
    if observed.n_frames not in (None, observation.n_frames):
        raise InvalidEventError(
            f"observed.n_frames is {observed.n_frames}, but the trajectories have "
            f"{observation.n_frames}"
        )
    sizes = [(one.name, one.radius) for one in observed.entities]
    centres = [(one.name, one.centre) for one in observed.landmarks]
    for where, pairs in (("entities", sizes), ("landmarks", centres)):
        check_once((name for name, _ in pairs), f"observed.{where} has twice the name")
    scene = Scene(
        observation.trajectory[0],
        per_name(dict(sizes), ENTITIES, "observed.entities"),
        observed.wall_segments,
        arena=(*head.arena.x, *head.arena.y),
        landmark_centres=per_name(dict(centres), LANDMARKS, "observed.landmarks"),
        landmark_half_width=head.landmark_half_width,
    )
    event = Event(scene, observation, event_id(own.id), truth, own.human, own.models)
    return turned(event, observed_turning(observation.trajectory, scene.radius))
