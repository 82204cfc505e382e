"""Events from the pickles of PHASE's authors.

Two kinds of file are read. Both are described in words only, so that none of this was tried on an
original:

* a list of videos, the processed form: per video ``name`` (of its film), ``trajectories`` (per body
  rows of x, y, vx, vy, angle; one per frame), ``entity_sizes``, ``entity_color_code``,
  ``wall_segs``, ``landmark_centers`` and ``social_goals`` (the relation that most raters saw);
* one record of the generator, whose file has the film's name: ``sizes`` in place of
  ``entity_sizes``, and one row per substep.

What is done to them:

* Bodies are put into the order of their colours (:mod:`phase_ppl.dataset.authors.colours`).
* Goals and strengths are those of the name (:mod:`phase_ppl.dataset.authors.names`), which has
  them in that order; ``physical_goals`` mixes two numberings and is not read.
* Items' tracks are cut to the length of the agents', after which nothing moves.
* A record's substeps are averaged in fives, as the processed form has them. It starts with the
  initial state, or, in reflected copies, with the first substep.
* Angles of agents in copies about a diagonal are unwrapped, and repaired where averaging spoiled
  them (:mod:`phase_ppl.dataset.authors.angles`). Those of items are 0 in all copies.
* Velocities are left out: in copies, those of the agents were reflected as if they were points,
  and those of the items not at all.
* The scene starts as the first frame shows it; ``turning`` is read off the angles.
"""

from __future__ import annotations

import dataclasses
import functools
import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.dataset.authors.angles import repaired
from phase_ppl.dataset.authors.colours import bodies_by_colour
from phase_ppl.dataset.authors.names import Recorded, parse_name
from phase_ppl.dataset.authors.unpickle import read_pickle
from phase_ppl.dataset.fields import Entries, event_id, require
from phase_ppl.dataset.turning import observed_turning
from phase_ppl.physics.constants import SUBSTEPS
from phase_ppl.world.errors import InvalidEventError, shown, unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS
from phase_ppl.world.observation import Observation
from phase_ppl.world.relations import RELATIONS
from phase_ppl.world.scene import Scene, finite_array

CHANNELS: Final = ("x", "y", "vx", "vy", "angle")
FloatArray = NDArray[np.float64]


def read(path: str | os.PathLike[str]) -> Entries:
    """Return the videos of the pickle ``path``, in memory, each still to be checked.

    Two videos whose stamp and place are the same go by their whole names.

    Raises:
        InvalidEventError: it is no pickle of videos that can be read without running code.
    """
    content = read_pickle(path)
    if isinstance(content, dict):
        said = parse_name(Path(path).name)
        return [(event_id({"id": said.id}), functools.partial(_event, content, said, raw=True))]
    if not isinstance(content, list):
        raise InvalidEventError(f"holds {_kind(content)}, expected a list of videos or one record")
    names = [_name(video, index) for index, video in enumerate(content)]
    ids = [_id(name) for name in names]
    given = Counter(ids)
    return [
        (id, functools.partial(_processed, video, id))
        for video, id in zip(
            content,
            (id if given[id] == 1 else name for id, name in zip(ids, names, strict=True)),
            strict=True,
        )
    ]


def _name(video: object, index: int) -> str:
    where = f"videos[{index}]"
    if not isinstance(video, dict):
        raise InvalidEventError(f"{where} is {_kind(video)}, expected a dict")
    name = require(video, "name", str, where)
    return event_id({"id": name}, where)


def _id(name: str) -> str:
    try:
        return parse_name(name).id
    except InvalidEventError:  # reported when the video is read
        return name


def _processed(video: Mapping[str, Any], id: str) -> Event:
    said = parse_name(video["name"])
    return _event(video, said._replace(id=id), raw=False)


def _event(video: Mapping[str, Any], said: Recorded, raw: bool) -> Event:
    bodies = bodies_by_colour(require(video, "entity_color_code", dict))
    sizes = finite_array("entity_sizes", _get(video, "sizes" if raw else "entity_sizes"), (4,))
    radius = sizes[list(bodies)]
    tracks = _tracks(_get(video, "trajectories"), bodies)
    wrapped = said.place is not None and said.place.is_diagonal
    if raw:
        tracks = [
            _averaged(track, body, wrapped) for body, track in zip(bodies, tracks, strict=True)
        ]
    trajectory = _cut(tracks, bodies)
    landmarks = _get(video, "landmark_centers")
    scene = Scene(  # refuses impossible sizes, before they are used
        start=trajectory[0],
        radius=radius,
        walls=finite_array("wall_segs", _get(video, "wall_segs"), (None, 2, 2)),
        landmark_centres=finite_array("landmark_centers", landmarks, (len(LANDMARKS), 2)),
    )
    if wrapped and not raw:
        for agent in range(len(AGENTS)):
            trajectory[:, agent, 2] = repaired(trajectory[:, agent, 2], float(radius[agent]))
    turning = observed_turning(trajectory, radius)
    return Event(
        scene=dataclasses.replace(scene, start=trajectory[0], turning=turning),
        observation=Observation(trajectory),
        id=said.id,
        truth=said.truth,
        judgments=_judgments(video.get("social_goals")),
    )


def _get(video: Mapping[str, Any], name: str) -> Any:
    if name not in video:
        raise InvalidEventError(f"has no {name}")
    return video[name]


def _tracks(given: object, bodies: tuple[int, ...]) -> list[FloatArray]:
    """Return the rows of each entity, (time, channel)."""
    tracks = list(given) if isinstance(given, np.ndarray) and given.ndim else given
    if not isinstance(tracks, (list, tuple)):
        raise InvalidEventError(f"trajectories is {_kind(tracks)}, expected a list of tracks")
    if len(tracks) != len(ENTITIES):
        raise InvalidEventError(f"trajectories has {len(tracks)} tracks, expected {len(ENTITIES)}")
    shape = (None, len(CHANNELS))
    return [finite_array(f"trajectories[{body}]", tracks[body], shape) for body in bodies]


def _averaged(track: FloatArray, body: int, wrapped: bool) -> FloatArray:
    """Return a row per frame of a track with a row per substep."""
    first = len(track) % SUBSTEPS
    if first > 1 or len(track) < SUBSTEPS:
        raise InvalidEventError(
            f"trajectories[{body}] has {len(track)} rows, expected a multiple of {SUBSTEPS}, or "
            "one more"
        )
    rows = np.array(track)
    with np.errstate(over="ignore", invalid="ignore"):  # means beyond all numbers are refused later
        if wrapped:
            rows[:, -1] = np.unwrap(rows[:, -1])
        means = rows[first:].reshape(-1, SUBSTEPS, rows.shape[1]).mean(axis=1)
    return np.concatenate([rows[:1], means])


def _cut(tracks: list[FloatArray], bodies: tuple[int, ...]) -> FloatArray:
    """Return the trajectory, (time, entity, coord), as long as the agents' tracks."""
    length = len(tracks[0])
    if any(len(track) != length for track in tracks[: len(AGENTS)]) or any(
        len(track) < length for track in tracks
    ):
        listed = ", ".join(
            f"{len(track)} of body {body}" for body, track in zip(bodies, tracks, strict=True)
        )
        raise InvalidEventError(
            f"trajectories have {listed} rows, expected equally many of both agents and no fewer "
            "of items"
        )
    columns = [0, 1, CHANNELS.index("angle")]
    rows = np.stack([track[:length, columns] for track in tracks], axis=1)
    return np.array(Observation(rows).trajectory)  # refuses what is too short


def _judgments(relation: object) -> dict[str, Any] | None:
    if relation is None:
        return None
    if not isinstance(relation, str) or relation not in RELATIONS:
        raise unknown_name("relation in social_goals", _kind(relation), RELATIONS)
    return {"majority": relation}


def _kind(value: object) -> str:
    """Return what a message says of ``value``: arrays and containers may be long."""
    if value is None or isinstance(value, (str, bytes, int, float)):
        return shown(value)
    return type(value).__name__
