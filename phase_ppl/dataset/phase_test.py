"""The ``phase-test-1`` format: the authors' PHASE test videos, converted to JSON.

One object; its head gives the arena and the landmarks' half width, ``videos`` is a list. Per
video, ``observed`` holds what an observer may use (walls, landmarks, sizes, trajectories),
``truth`` the generating parameters, ``human`` counts of people's relation judgments, ``models``
the predictions of other models. Goals in ``truth`` are effective ones: helper and helpee share a
goal, a hinderer holds the negation. ``mirror_of_original`` is not read.

Any events of one arena can be written in this format. It has no place for a start other than the
first frame, for ``turning``, which is read off the angles, or for ``resets_velocity``.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.dataset.documents import event_id, optional, per_name, require
from phase_ppl.dataset.events_json import (
    Entries,
    arena_record,
    entries_of,
    read_observation,
    read_truth,
    to_text,
    tracks_record,
    truth_record,
)
from phase_ppl.dataset.motion import observed_turning
from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.event import FRAMES_PER_SECOND, SHOWN_SECONDS_PER_FRAME, Event, Observation
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS, STRENGTH_LEVELS
from phase_ppl.world.names import ENTITIES, LANDMARKS
from phase_ppl.world.scene import LANDMARK_HALF_WIDTH, Scene, check_is_phase, finite_array

FORMAT: Final = "phase-test-1"


def read(document: Mapping[str, Any]) -> Entries:
    """Return the videos of a document in :data:`FORMAT`, not yet read."""
    return entries_of(document, "videos", functools.partial(_event, head=document))


def _event(record: Mapping[str, Any], *, head: Mapping[str, Any]) -> Event:
    observed = require(record, "observed", dict)
    where = "observed.trajectories"
    observation = read_observation(require(observed, "trajectories", dict, "observed"), where)
    n_frames = optional(observed, "n_frames", int, "observed")
    if n_frames not in (None, observation.n_frames):
        raise InvalidEventError(
            f"observed.n_frames is {n_frames}, but the trajectories have {observation.n_frames}"
        )
    scene = _scene(observed, head, observation)
    turning = observed_turning(observation.trajectory, scene.radius)
    truth = optional(record, "truth", dict)
    return Event(
        scene=dataclasses.replace(scene, turning=turning),
        observation=observation,
        id=event_id(record),
        truth=None if truth is None else read_truth(truth, "strength_id", _newtons),
        judgments=optional(record, "human", dict),
        predictions=optional(record, "models", dict),
    )


def _scene(observed: Mapping[str, Any], head: Mapping[str, Any], observation: Observation) -> Scene:
    arena = require(head, "arena", dict)
    x0, x1 = finite_array("arena.x", require(arena, "x", list, "arena"), (2,))
    y0, y1 = finite_array("arena.y", require(arena, "y", list, "arena"), (2,))
    walls = require(observed, "wall_segments", list, "observed")
    half_width = head.get("landmark_half_width", LANDMARK_HALF_WIDTH)
    return Scene(
        start=observation.trajectory[0],
        radius=_by_name(observed, "entities", ENTITIES, "radius", (len(ENTITIES),)),
        walls=finite_array("observed.wall_segments", walls, (None, 2, 2)),
        arena=(x0, x1, y0, y1),
        landmark_centres=_by_name(observed, "landmarks", LANDMARKS, "centre", (len(LANDMARKS), 2)),
        landmark_half_width=half_width,
    )


def _by_name(
    observed: Mapping[str, Any],
    field: str,
    names: Sequence[str],
    value: str,
    shape: tuple[int, ...],
) -> NDArray[np.float64]:
    """Return ``value`` of each object of the list ``field``, in the order of ``names``."""
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
    return finite_array(f"{where}.{value}", per_name(found, names, where), shape)


def _newtons(level: Any) -> float | None:
    if level is None:
        return None
    if isinstance(level, bool) or level not in range(len(STRENGTH_LEVELS)):
        raise InvalidEventError(
            f"truth.strength_id is {shown(level)}, expected one of 0..{len(STRENGTH_LEVELS) - 1}"
        )
    return STRENGTH_LEVELS[int(level)]


# --- writing ----------------------------------------------------------------------------------


def videos_bytes(videos: Sequence[Mapping[str, Any]], scene: Scene) -> bytes:
    """Return the content of a file of events, each as :func:`video` has it, in a scene's arena."""
    document = {
        "format": FORMAT,
        "n_videos": len(videos),
        "arena": arena_record(scene.arena),
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
    scene, truth, trajectory = event.scene, event.truth, event.observation.trajectory
    check_is_phase(scene.world, "this format")
    check_start(event)
    if (scene.arena, scene.landmark_half_width) != (like.arena, like.landmark_half_width):
        raise InvalidEventError("its arena is not that of the first event")
    record: dict[str, Any] = {
        "id": event_id({"id": event.id}),
        "observed": {
            "n_frames": len(trajectory),
            "wall_segments": scene.walls.tolist(),
            "landmarks": [
                {"name": name, "colour": name.split()[0], "centre": centre}
                for name, centre in zip(LANDMARKS, scene.landmark_centres.tolist(), strict=True)
            ],
            "entities": [
                {"name": name, "kind": name.split()[1], "colour": name.split()[0], "radius": size}
                for name, size in zip(ENTITIES, scene.radius.tolist(), strict=True)
            ],
            "trajectories": tracks_record(trajectory),
        },
    }
    if truth is not None:
        record["truth"] = truth_record(truth, "strength_id", strength_level)
    if event.judgments is not None:
        record["human"] = dict(event.judgments)
    if event.predictions is not None:
        record["models"] = dict(event.predictions)
    return record


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
