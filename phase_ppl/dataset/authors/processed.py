"""Events in the processed form of PHASE's authors, which programs made for their data can read.

The counterpart of :mod:`phase_ppl.dataset.authors.videos`, where the form is described. A video
claims to be a reflected copy where its walls are those of a reflected layout, and is then written
as such copies are, wrong velocities included: who reads the authors' files puts them right.
Velocities are differences of the positions, per simulated second. The form has no place for
another arena, another start than the first frame, ``turning``, predictions, or judgments beyond
the relation that most people saw.
"""

from __future__ import annotations

import itertools
import pickle
import pickletools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.dataset.authors.angles import repaired
from phase_ppl.dataset.authors.colours import COLOUR_CODE
from phase_ppl.dataset.authors.names import Place, file_name, goal_numbers, place_in_id
from phase_ppl.dataset.fields import event_id
from phase_ppl.dataset.generation.copies import REFLECTIONS
from phase_ppl.dataset.generation.tables import LAYOUTS
from phase_ppl.dataset.phase_test import check_start
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event
from phase_ppl.world.names import AGENTS
from phase_ppl.world.observation import FRAMES_PER_SECOND
from phase_ppl.world.relations import RELATIONS
from phase_ppl.world.rooms import RAY_DIRECTIONS
from phase_ppl.world.scene import ARENA, LANDMARK_HALF_WIDTH, Scene

FloatArray = NDArray[np.float64]

_COPIES: Final = tuple(REFLECTIONS.values())
"""The reflections in the order of their numbers in file names."""

_PROTOCOL: Final = 3
"""The newest protocol that every Python 3 reads, and that names its modules in plain lines."""


def pickled(videos: Sequence[Mapping[str, Any]]) -> bytes:
    """Return the pickle of a list of videos, which loads under any version of NumPy."""
    content = pickle.dumps(list(videos), _PROTOCOL)
    parts, done = [], 0
    for start, end in _lines_that_name_modules(content):
        line = content[start:end]
        parts += [content[done:start], line.replace(b"numpy._core.", b"numpy.core.")]
        done = end
    return b"".join([*parts, content[done:]])


def _lines_that_name_modules(content: bytes) -> Iterator[tuple[int, int]]:
    ops = [(opcode.name, place or 0) for opcode, _, place in pickletools.genops(content)]
    for (name, start), (_, end) in itertools.pairwise(ops):
        if name == "GLOBAL":
            yield start, end


def video(event: Event) -> dict[str, Any]:
    """Return an event as one video of the processed form.

    Raises:
        InvalidEventError: the event has something that the form has no place for.
    """
    scene, truth, trajectory = event.scene, event.truth, event.observation.trajectory
    if scene.arena != ARENA or scene.landmark_half_width != LANDMARK_HALF_WIDTH:
        raise InvalidEventError(
            "its arena is not the original one, and the format has no place for it"
        )
    check_start(event)
    place = _place(event)
    if place.is_diagonal:
        _check_angles(event)
    velocity = _velocity(trajectory, place.copy, scene)
    rows = np.concatenate([trajectory[..., :2], velocity, trajectory[..., 2:]], axis=-1)
    goals = [] if truth is None else [truth.goal_red, truth.goal_green]
    return {
        "name": file_name(event_id({"id": event.id}), place, truth, len(rows)),
        "trajectories": [np.array(rows[:, entity]) for entity in range(rows.shape[1])],
        "entity_sizes": scene.radius.tolist(),
        "entity_color_code": dict(COLOUR_CODE),
        "physical_goals": [list(goal_numbers(goal, holder)) for holder, goal in enumerate(goals)],
        "wall_segs": [[tuple(end) for end in wall] for wall in scene.walls.tolist()],
        "landmark_centers": [tuple(centre) for centre in scene.landmark_centres.tolist()],
        "social_goals": _majority(event.judgments),
    }


def _place(event: Event) -> Place:
    """Return a layout, reflected or not, with the event's walls: that of its id if it fits.

    Raises:
        InvalidEventError: there is none.
    """
    lengths = event.scene.rooms.wall_length
    in_id = place_in_id(event.id)
    copies = (None, *range(len(_COPIES)))
    known = [Place(layout, copy) for copy in copies for layout in LAYOUTS]
    for place in [in_id, *known] if in_id in known else known:
        if place is not None and np.allclose(_lengths(place), lengths):
            return place
    raise InvalidEventError(
        "its walls are those of no original layout, by whose number such files know them"
    )


def _check_angles(event: Event) -> None:
    """Raise InvalidEventError if the agents' angles would be taken for wrapped ones."""
    for agent in range(len(AGENTS)):
        angles = event.observation.trajectory[:, agent, 2]
        if not np.array_equal(repaired(angles, float(event.scene.radius[agent])), angles):
            raise InvalidEventError("its angles jump as in damaged files, and would be repaired")


def _lengths(place: Place) -> FloatArray:
    """Return the lengths of the walls up, left, down and right, units."""
    lengths = np.array(LAYOUTS[place.layout], np.float64)
    if place.copy is None:
        return lengths
    matrix = _COPIES[place.copy].matrix
    mirrored = np.empty_like(lengths)
    mirrored[(RAY_DIRECTIONS @ matrix @ RAY_DIRECTIONS.T).argmax(axis=0)] = lengths
    return mirrored


def _velocity(trajectory: FloatArray, copy: int | None, scene: Scene) -> FloatArray:
    """Return (time, entity, 2) velocities as recordings of that kind have them.

    In copies, velocities of agents were reflected as points, not as directions, about the line
    that the positions were reflected about; those of items were not reflected.
    """
    velocity = np.gradient(trajectory[..., :2], 1 / FRAMES_PER_SECOND, axis=0)
    velocity[0] = 0.0  # at rest
    if copy is not None:
        matrix, n = _COPIES[copy].matrix, len(AGENTS)
        velocity[:, :n] += scene.centre - matrix @ scene.centre
        velocity[:, n:] = velocity[:, n:] @ matrix  # its own inverse
    return velocity


def _majority(judgments: Mapping[str, Any] | None) -> str | None:
    majority = (judgments or {}).get("majority")
    return majority if isinstance(majority, str) and majority in RELATIONS else None
