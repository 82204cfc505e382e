"""From tracks to a symbolic trajectory: which predicates hold in each frame, by thresholds.

The predicates are those of the paper's table as SIMPLE's planner uses them: CLOSE(entity,
landmark) is being in that landmark's room (in an arena without inner walls, its quarter), ATTACH
is read off the tracks, TOUCH is being near enough to stop or to grab, ON to count as arrived.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.symbols import NEAR_AGENT_ON, NEAR_ITEM_ON, NEAR_TOUCH
from phase_ppl.dataset.motion import HELD_WITHIN, items_held
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import positive_number, whole_number
from phase_ppl.world.geometry import GRAB_POINTS, GRAB_REACH
from phase_ppl.world.names import AGENTS, ENTITIES
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

Flags = NDArray[np.bool_]

FACTOR: Final = 3.0
"""By how much wider ON, and TOUCH of items, are here than where SIMPLE's planner is done with them:
recorded agents stop a little short. Chosen on half of 50 real videos
(``benchmarks/predicate.py``)."""

_PREDICATES: Final = ("rooms", "held", "near", "placed")


@dataclasses.dataclass(frozen=True)
class Thresholds:
    """When a predicate holds, units. The defaults: SIMPLE's planner's, but for :data:`FACTOR`.

    Attributes:
        on_agent: ON(agent, landmark): from its centre to the landmark's centre.
        on_item: ON(item, landmark): likewise.
        touch_agent: TOUCH(agent, agent): from centre to centre.
        touch_item: TOUCH(agent, item): from a grab point of the agent to the item's rim. As for
            the planner, only those in the same room touch.
        attach: ATTACH(agent, item): how far the item may be from its place at a grab point; it is
            to stay there for three frames.
        lasting: frames for which a predicate must hold, or not hold, to count.

    Raises:
        InvalidSettingError: a threshold that is no positive number, or ``lasting`` no whole one.
    """

    on_agent: float = FACTOR * NEAR_AGENT_ON
    on_item: float = FACTOR * NEAR_ITEM_ON
    touch_agent: float = NEAR_TOUCH
    touch_item: float = FACTOR * GRAB_REACH
    attach: float = HELD_WITHIN
    lasting: int = 3

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            check = whole_number if field.name == "lasting" else positive_number
            check(field.name, value)


class SymbolicState(NamedTuple):
    """The predicates that hold at one moment.

    Attributes:
        rooms: CLOSE: id of the landmark whose room each entity is in.
        held: ATTACH: item that each agent holds, or ``NOTHING``.
        near: TOUCH: per agent, whether it touches each entity.
        placed: ON: whether each entity is on the landmark of its room.
    """

    rooms: tuple[int, ...]
    held: tuple[int, ...]
    near: tuple[tuple[bool, ...], ...]
    placed: tuple[bool, ...]


def symbolic_trajectory(
    scene: Scene, observation: Observation, thresholds: Thresholds | None = None
) -> list[SymbolicState]:
    """Return the symbolic state of every frame."""
    given = Thresholds() if thresholds is None else thresholds
    trajectory = observation.trajectory
    found = {
        "rooms": scene.rooms.room_of(trajectory[..., :2]),
        "held": items_held(trajectory, scene.radius, given.attach),
        "near": _near(trajectory, scene, given),
        "placed": _placed(trajectory, scene, given),
    }
    for name in _PREDICATES:
        shape = found[name].shape
        columns = found[name].reshape(shape[0], -1).T
        lasting = [_lasting(column, given.lasting) for column in columns]
        found[name] = np.stack(lasting, axis=1).reshape(shape)
    return [
        SymbolicState(
            tuple(rooms), tuple(held), tuple(tuple(agent) for agent in near), tuple(placed)
        )
        for rooms, held, near, placed in zip(
            *(found[name].tolist() for name in _PREDICATES), strict=True
        )
    ]


def _near(trajectory: FloatArray, scene: Scene, given: Thresholds) -> Flags:
    """Return (time, agent, entity)."""
    near = np.zeros((len(trajectory), len(AGENTS), len(ENTITIES)), bool)
    place = trajectory[..., :2]
    apart = np.linalg.norm(place[:, 0] - place[:, 1], axis=1)
    near[:, 0, 1] = near[:, 1, 0] = apart < given.touch_agent
    for agent in range(len(AGENTS)):
        cos, sin = np.cos(trajectory[:, agent, 2]), np.sin(trajectory[:, agent, 2])
        for local in GRAB_POINTS * scene.radius[agent]:
            offset = np.column_stack(
                [cos * local[0] - sin * local[1], sin * local[0] + cos * local[1]]
            )
            for item in range(len(AGENTS), len(ENTITIES)):
                distance = np.linalg.norm(place[:, agent] + offset - place[:, item], axis=1)
                near[:, agent, item] |= distance < scene.radius[item] + given.touch_item
    rooms = scene.rooms.room_of(place)
    near &= rooms[:, : len(AGENTS), None] == rooms[:, None]
    return near


def _placed(trajectory: FloatArray, scene: Scene, given: Thresholds) -> Flags:
    """Return (time, entity)."""
    placed = np.zeros(trajectory.shape[:2], bool)
    for entity in range(len(ENTITIES)):
        place = trajectory[:, entity, :2]
        centre = scene.landmark_centres[scene.rooms.room_of(place)]
        limit = given.on_agent if entity < len(AGENTS) else given.on_item
        placed[:, entity] = np.linalg.norm(place - centre, axis=1) < limit
    return placed


def _lasting(values: NDArray[Any], frames: int) -> NDArray[Any]:
    """Return a series in which runs shorter than ``frames`` go on with what was before them."""
    result = values.copy()
    edges = np.flatnonzero(values[1:] != values[:-1]) + 1
    bounds = [0, *edges.tolist(), len(values)]
    for start, end in itertools.pairwise(bounds[1:]):
        if end - start < frames:
            result[start:end] = result[start - 1]
    return result
