"""Events as JSON that a person can read and write, and the authors' test videos in theirs.

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

The ``phase-test-1`` format has the authors' PHASE test videos: one object, whose head gives the
arena and the landmarks' half width, and ``videos``, a list. Per video, ``observed`` holds what an
observer may use (walls, landmarks, sizes, trajectories), ``truth`` the generating parameters,
``human`` counts of people's relation judgments, ``models`` the predictions of other models. Goals
are effective ones: helper and helpee share a goal, a hinderer holds the negation.
``mirror_of_original`` is not read. Any events of one arena can be written so. It has no place for a
start other than the first frame, for ``turning``, which is read off the angles, or for
``resets_velocity``.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.data.documents import event_id, only, optional, per_name, require
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, UnknownNameError, instance_of, shown
from phase_ppl.world.event import (
    FRAMES_PER_SECOND,
    SHOWN_SECONDS_PER_FRAME,
    Event,
    Observation,
    Truth,
)
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS, STRENGTH_LEVELS, Roles
from phase_ppl.world.names import AGENTS
from phase_ppl.world.scene import (
    LANDMARK_HALF_WIDTH,
    PHASE,
    Scene,
    Turning,
    World,
    check_is_phase,
    finite_array,
    one_or_all,
)

EVENT_FORMAT: Final = "phase-ppl-event-1"
EVENTS_FORMAT: Final = "phase-ppl-events-1"
VIDEOS_FORMAT: Final = "phase-test-1"

Entries = list[tuple[str, Callable[[], Event]]]
"""What a file holds: per event its id and the function that reads it."""

ARRAYS: Final = ("start", "radius", "walls", "landmark_centres", "landmark_half_width", "arena")
"""Of a scene, which also has ``turning``, a text, and perhaps ``resets_velocity``."""

DOCUMENTS: Final = ("judgments", "predictions")  # of any content
_EVENT_FIELDS: Final = ("format", "id", "world", "scene", "trajectories", "truth", *DOCUMENTS)
_TRUTH_FIELDS: Final = ("goals", "relation", "scenario", "strengths")
_SCENE_FIELDS: Final = (
    *("arena", "walls", "landmarks", "landmark_half_width", "turning"),
    *("resets_velocity", "radius", "start"),
)
_LINE_CHARACTERS = 100


# --- reading ---------------------------------------------------------------------------------


def read(document: Mapping[str, Any]) -> Entries:
    """Return the events of a document in one of these formats, each still to be read."""
    tag = document.get("format")
    if tag == EVENT_FORMAT:
        return [(event_id(document), functools.partial(event_from_record, document))]
    if tag == EVENTS_FORMAT:
        only(document, ("format", "events"), "a file of events")
        return _entries_of(document, "events", event_from_record)
    if tag == VIDEOS_FORMAT:
        return _entries_of(document, "videos", functools.partial(_event_of_video, head=document))
    known = ", ".join(map(repr, (EVENT_FORMAT, EVENTS_FORMAT, VIDEOS_FORMAT)))
    if tag is None:
        raise InvalidEventError(f"is not an event file: it has no format, such as {known}")
    raise InvalidEventError(f"has format {shown(tag)}, expected one of {known}")


def _entries_of(
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
    observation = _observation(tracks, world.entities)
    truth = optional(record, "truth", dict)
    known: Truth | Roles | None = None
    if truth is not None:
        only(truth, _TRUTH_FIELDS, "truth")
        known = _truth(truth) if world == PHASE else Roles.from_dict(truth, world)
    return Event(
        scene=_scene(require(record, "scene", dict), observation.trajectory[0], world),
        observation=observation,
        id=event_id(record),
        truth=known,
        judgments=optional(record, "judgments", dict),
        predictions=optional(record, "predictions", dict),
    )


def _observation(record: Mapping[str, Any], entities: Sequence[str]) -> Observation:
    tracks = [
        finite_array(f"trajectories[{name!r}]", rows, (None, 3))
        for name, rows in zip(entities, per_name(record, entities, "trajectories"), strict=True)
    ]
    lengths = [len(track) for track in tracks]
    if len(set(lengths)) > 1:
        listed = ", ".join(f"{n} {name}" for n, name in zip(lengths, entities, strict=True))
        raise InvalidEventError(f"trajectories differ in length: {listed}")
    return Observation(np.stack(tracks, axis=1))


def _scene(record: Mapping[str, Any], first_frame: FloatArray, world: World) -> Scene:
    only(record, _SCENE_FIELDS, "scene")
    given: dict[str, Any] = {"start": first_frame, "world": world}
    for name in ("walls", "turning", "landmark_half_width", "resets_velocity"):
        if name in record:
            given[name] = record[name]
    bodies, marks = world.entities, world.landmark_names
    for name, key, names, each in (
        ("arena", "arena", ("x", "y"), (2,)),
        ("landmark_centres", "landmarks", marks, (2,)),
        ("start", "start", bodies, (3,)),
        ("radius", "radius", bodies, ()),
    ):
        if key in record or name == "radius":
            values = per_name(require(record, key, dict, "scene"), names, f"scene.{key}")
            given[name] = finite_array(f"scene.{key}", values, (len(names), *each))
    if "arena" in given:
        given["arena"] = given["arena"].ravel()
    return Scene(**given)


def _truth(record: Mapping[str, Any]) -> Truth:
    red, green = per_name(require(record, "goals", dict, "truth"), AGENTS, "truth.goals")
    forces = optional(record, "strengths", dict, "truth")
    return Truth(
        red,
        green,
        optional(record, "relation", str, "truth") or "",
        optional(record, "scenario", str, "truth") or "",
        *((None, None) if forces is None else per_name(forces, AGENTS, "truth.strengths")),
    )


def turned(event: Event, turning: Turning) -> Event:
    """Return the event with agents that can turn in other ways."""
    return dataclasses.replace(event, scene=dataclasses.replace(event.scene, turning=turning))


# --- writing ---------------------------------------------------------------------------------


def event_record(event: Event) -> dict[str, Any]:
    """Return the JSON object that :func:`event_from_record` turns back into ``event``."""
    instance_of("event", event, Event, "a phase_ppl.Event")
    scene, world, truth = event.scene, event.scene.world, event.truth
    arrays = {name: np.asarray(getattr(scene, name)).tolist() for name in ARRAYS}
    arrays["landmark_half_width"] = one_or_all(scene.half_widths.tolist())
    tracks = np.moveaxis(event.observation.trajectory, 1, 0).tolist()
    record: dict[str, Any] = {
        "format": EVENT_FORMAT,
        "id": event_id({"id": event.id}),
        **({} if world == PHASE else {"world": world.to_dict()}),
        "scene": scene_record(arrays, scene.turning, scene.resets_velocity, world),
        "trajectories": dict(zip(world.entities, tracks, strict=True)),
    }
    if isinstance(truth, Truth):
        goals, forces = (
            (truth.goal_red, truth.goal_green),
            (truth.strength_red, truth.strength_green),
        )
        record["truth"] = truth_record(goals, truth.relation, truth.scenario, forces)
    elif truth is not None:
        record["truth"] = truth.to_dict()
    given = ((name, getattr(event, name)) for name in DOCUMENTS)
    return record | {name: dict(content) for name, content in given if content is not None}


def scene_record(
    arrays: Mapping[str, Any], turning: str, resets_velocity: bool = False, world: World = PHASE
) -> dict[str, Any]:
    """Return the JSON object of a scene, given its :data:`ARRAYS` and its rules."""
    return {
        "arena": _arena_record(arrays["arena"]),
        "walls": arrays["walls"],
        "landmarks": dict(zip(world.landmark_names, arrays["landmark_centres"], strict=True)),
        "landmark_half_width": arrays["landmark_half_width"],
        "turning": turning,
        **({"resets_velocity": True} if resets_velocity else {}),
        "radius": dict(zip(world.entities, arrays["radius"], strict=True)),
        "start": dict(zip(world.entities, arrays["start"], strict=True)),
    }


def truth_record(
    goals: Iterable[str], relation: str, scenario: str, strengths: Iterable[float | None]
) -> dict[str, Any]:
    """Return the JSON object of a truth of PHASE."""
    return {
        "goals": dict(zip(AGENTS, goals, strict=True)),
        "relation": relation,
        "scenario": scenario,
        "strengths": dict(zip(AGENTS, strengths, strict=True)),
    }


def _arena_record(arena: Sequence[float]) -> dict[str, list[float]]:
    """Return the JSON object of x_min, x_max, y_min, y_max."""
    x0, x1, y0, y1 = arena
    return {"x": [x0, x1], "y": [y0, y1]}


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


# --- the authors' test videos --------------------------------------------------------------------

_AUTHORS_DOCUMENTS: Final = {"judgments": "human", "predictions": "models"}
"""What the package calls them -> what the authors do."""

_AUTHORS_PLACES: Final = {
    "scene.arena": "arena",
    "scene.walls": "observed.wall_segments",
    "scene.landmarks": "observed.landmarks",
    "scene.radius": "observed.entities",
    "trajectories": "observed.trajectories",
    "truth.strengths": "truth.strength_id",
    **_AUTHORS_DOCUMENTS,
}
"""Place in an event's record -> that in the authors' files, as errors have to name it."""


def _event_of_video(record: Mapping[str, Any], *, head: Mapping[str, Any]) -> Event:
    """Return what a video is in the package's own words, read."""
    observed = require(record, "observed", dict)
    truth = optional(record, "truth", dict)
    if truth is not None:
        levels = optional(truth, "strength_id", dict, "truth")
        if levels is not None:
            levels = {agent: _newtons(level) for agent, level in levels.items()}
        known = {name: truth[name] for name in ("goals", "relation", "scenario") if name in truth}
        truth = {**known, "strengths": levels}
    own = {
        "id": record.get("id"),
        "scene": {
            "arena": require(head, "arena", dict),
            "walls": require(observed, "wall_segments", list, "observed"),
            "landmarks": _by_its_name(observed, "landmarks", "centre"),
            "landmark_half_width": head.get("landmark_half_width", LANDMARK_HALF_WIDTH),
            "radius": _by_its_name(observed, "entities", "radius"),
        },
        "trajectories": require(observed, "trajectories", dict, "observed"),
        "truth": truth,
        **{name: record.get(theirs) for name, theirs in _AUTHORS_DOCUMENTS.items()},
    }
    try:
        event = event_from_record(own)
    except (InvalidEventError, UnknownNameError) as error:
        raise type(error)(_in_their_words(str(error))) from None
    n_frames = optional(observed, "n_frames", int, "observed")
    if n_frames not in (None, event.observation.n_frames):
        raise InvalidEventError(
            f"observed.n_frames is {n_frames}, but the trajectories have "
            f"{event.observation.n_frames}"
        )
    from phase_ppl.data.motion import observed_turning

    return turned(event, observed_turning(event.observation.trajectory, event.scene.radius))


def _in_their_words(message: str) -> str:
    """Return what an error says of a place in the package's records, of that in the file."""
    for ours, theirs in _AUTHORS_PLACES.items():
        if message.startswith((ours, f"unknown field of {ours}")):
            return message.replace(ours, theirs, 1)
    return message


def _by_its_name(observed: Mapping[str, Any], field: str, value: str) -> dict[str, Any]:
    """Return name -> ``value`` of each object of the list ``field``."""
    where = f"observed.{field}"
    found: dict[str, Any] = {}
    for index, part in enumerate(require(observed, field, list, "observed")):
        if not isinstance(part, dict):
            raise InvalidEventError(f"{where}[{index}] is no JSON object")
        name = require(part, "name", str, f"{where}[{index}]")
        if name in found:
            raise InvalidEventError(f"{where} names {name!r} twice")
        if value not in part:
            raise InvalidEventError(f"{where}[{index}], the {name}, has no {value}")
        found[name] = part[value]
    return found


def _newtons(level: Any) -> float | None:
    if level is None:
        return None
    if isinstance(level, bool) or level not in range(len(STRENGTH_LEVELS)):
        raise InvalidEventError(
            f"truth.strength_id is {shown(level)}, expected one of 0..{len(STRENGTH_LEVELS) - 1}"
        )
    return STRENGTH_LEVELS[int(level)]


def videos_bytes(videos: Sequence[Mapping[str, Any]], scene: Scene) -> bytes:
    """Return the content of a file of events, each as :func:`video` has it, in a scene's arena."""
    document = {
        "format": VIDEOS_FORMAT,
        "n_videos": len(videos),
        "arena": _arena_record(scene.arena),
        "landmark_half_width": scene.landmark_half_width,
        "physics_seconds_per_frame": 1 / FRAMES_PER_SECOND,
        "display_seconds_per_frame": SHOWN_SECONDS_PER_FRAME,
        "trajectory_columns": ["x", "y", "angle"],
        "goal_labels": list(GOALS),
        "relation_labels": list(RELATIONS),
        "scenario_types": list(SCENARIOS),
        "videos": list(videos),
    }
    return to_text(document).encode()


def video(event: Event, like: Scene) -> dict[str, Any]:
    """Return the JSON object of one event of a document, in the arena of the scene ``like``."""
    scene = event.scene
    check_is_phase(scene.world, "this format")
    check_start(event)
    if (scene.arena, scene.landmark_half_width) != (like.arena, like.landmark_half_width):
        raise InvalidEventError("its arena is not that of the first event")
    own = event_record(event)
    record: dict[str, Any] = {
        "id": event.id,
        "observed": {
            "n_frames": event.observation.n_frames,
            "wall_segments": own["scene"]["walls"],
            "landmarks": [
                {"name": name, "colour": name.split()[0], "centre": centre}
                for name, centre in own["scene"]["landmarks"].items()
            ],
            "entities": [
                {"name": name, "kind": name.split()[1], "colour": name.split()[0], "radius": size}
                for name, size in own["scene"]["radius"].items()
            ],
            "trajectories": own["trajectories"],
        },
    }
    if "truth" in own:
        strengths = own["truth"].pop("strengths")
        levels = {agent: strength_level(force) for agent, force in strengths.items()}
        record["truth"] = {**own["truth"], "strength_id": levels}
    return record | {
        _AUTHORS_DOCUMENTS[name]: own[name] for name in _AUTHORS_DOCUMENTS if name in own
    }


def check_start(event: Event) -> None:
    """Raise InvalidEventError unless the event starts as its first frame shows, and goes on."""
    if not np.array_equal(event.scene.start, event.observation.trajectory[0]):
        raise InvalidEventError(
            "it does not start as its first frame shows, and the format has no place for that"
        )
    if event.scene.resets_velocity:
        raise InvalidEventError(
            "its agents stand still after each step, and the format has no place for that"
        )


def strength_level(force: float | None) -> int | None:
    """Return the original id of a strength in newtons, which must have one; None for None."""
    if force is None:
        return None
    if force not in STRENGTH_LEVELS:
        levels = ", ".join(f"{level:g}" for level in STRENGTH_LEVELS)
        raise InvalidEventError(f"a strength is {force:g} N, expected one of {levels}")
    return STRENGTH_LEVELS.index(force)
