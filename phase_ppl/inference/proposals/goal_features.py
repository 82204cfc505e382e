"""What a stretch of the observation shows of each goal that an agent may have.

A goal is about a subject (the agent itself, the other one, an item) and a place: a landmark, or
the other agent. Its features say where the subject is, whether it has come nearer, and what the
agent itself did: whether it went to the subject, touched it, moved towards the place. They are
computed from positions alone, so that they hold for any scene and are blind to which landmark or
item it is.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.goals import N_GOALS, goal_literal
from phase_ppl.world.names import AGENTS, Predicate
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

FEATURES: Final = (
    "constant",
    "distance at the end",
    "distance at the start",
    "achieved at the end",
    "achieved at the start",
    "in the room at the end",
    "in the room at the start",
    "agent's gap to the subject at the end",
    "agent's smallest gap to the subject",
    "share of time touching the subject",
    "progress",
    "agent's way towards the subject",
    "agent's way towards the place",
    "the same, while at the subject",
    "agent's path",
    "progress while touching the subject",
)
"""Of a goal in a stretch of time; lengths in units of 10, ways in units of 3."""

KINDS: Final = ("item", "not item", "self", "not self", "other", "not other", "touch", "not touch")
"""What a goal is about, and whether it is to be so or not; kinds have weights of their own."""

TOUCHING: Final = 0.4
"""Gap below which two bodies count as touching, units; frames are means over a step."""

_TOUCHED: Final = 0.6
"""Gap of the agents below which "get to" counts as achieved at that moment, units."""

_FAR: Final = 10.0
_LENGTH, _WAY = 10.0, 3.0


class _Goals(NamedTuple):
    """(agent, goal) what the goals are about.

    Attributes:
        kind: index into ``KINDS``.
        subject: entity.
        about_agent: whether the place is an agent instead of a landmark.
        agent, landmark: the place; 0 where it is of the other sort.
    """

    kind: IntArray
    subject: IntArray
    about_agent: NDArray[np.bool_]
    agent: IntArray
    landmark: IntArray


def _goals() -> _Goals:
    rows = []
    for holder in range(len(AGENTS)):
        for goal in range(N_GOALS):
            literal = goal_literal(goal, holder)
            touch = literal.predicate is Predicate.TOUCH
            if touch:
                about = "touch"
            elif literal.subject >= len(AGENTS):
                about = "item"
            else:
                about = "self" if literal.subject == holder else "other"
            number = KINDS.index(about) + (not literal.positive)
            place = (literal.target, 0) if touch else (0, literal.target)
            rows.append((number, literal.subject, touch, *place))
    columns = np.array(rows).reshape(len(AGENTS), N_GOALS, -1)
    kind, subject, about_agent, agent, landmark = (columns[..., i] for i in range(5))
    return _Goals(kind, subject, about_agent.astype(bool), agent, landmark)


GOAL_PARTS: Final = _goals()


def goal_features(
    scene: Scene, observation: Observation, first: IntArray, last: IntArray
) -> FloatArray:
    """Return (stretch, agent, goal, feature), in the order of ``FEATURES``.

    Args:
        scene, observation: what was seen.
        first, last: (stretch,) first and last frame of each stretch.
    """
    tracks = _Tracks(scene, observation)
    columns = [
        _features_of(tracks, agent, np.asarray(first), np.asarray(last))
        for agent in range(len(AGENTS))
    ]
    return np.stack(columns, axis=1)


class _Tracks:
    """What is read off all frames once, with sums over time up to each frame."""

    def __init__(self, scene: Scene, observation: Observation) -> None:
        position, places = observation.positions, scene.landmark_centres
        to_place = places[None, None] - position[:, :, None]
        apart = position[:, None] - position[:, :, None]
        self.distance_to_landmark = np.linalg.norm(to_place, axis=-1)
        self.distance_to_entity = np.linalg.norm(apart, axis=-1)
        self.gap = self.distance_to_entity - scene.radius[:, None] - scene.radius
        self.on: NDArray[np.bool_] = np.all(np.abs(to_place) < scene.landmark_half_width, axis=-1)
        self.room = scene.rooms.room_of(position.reshape(-1, 2)).reshape(position.shape[:2])
        self.room_of_landmark = scene.rooms.room_of(places)
        agents = slice(0, len(AGENTS))
        step = np.diff(position[:, agents], axis=0)[:, :, None]
        self.way_to_landmark = _summed((step * _unit(to_place[:-1, agents])).sum(axis=-1))
        self.way_to_entity = _summed((step * _unit(apart[:-1, agents])).sum(axis=-1))
        self.path = _summed(np.linalg.norm(step[:, :, 0], axis=-1))
        self.touching = _summed((self.gap < TOUCHING).astype(float))


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-6)


def _summed(values: FloatArray) -> FloatArray:
    """Return (time + 1, ...) the sums of all values before each time."""
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])


def _features_of(tracks: _Tracks, agent: int, first: IntArray, last: IntArray) -> FloatArray:
    """Return (stretch, goal, feature) of one agent."""
    _, subject, about_agent, named, landmark = (part[agent] for part in GOAL_PARTS)
    own = subject == agent

    def of_place(of_agents: NDArray[Any], of_landmarks: NDArray[Any]) -> FloatArray:
        return np.where(about_agent, of_agents, of_landmarks).astype(float)

    distance = of_place(
        tracks.distance_to_entity[:, subject, named],
        tracks.distance_to_landmark[:, subject, landmark],
    )
    achieved = of_place(tracks.gap[:, subject, named] < _TOUCHED, tracks.on[:, subject, landmark])
    in_room = of_place(
        tracks.room[:, subject] == tracks.room[:, named],
        tracks.room[:, subject] == tracks.room_of_landmark[landmark],
    )
    gap = np.minimum(tracks.gap[:, agent, subject], _FAR)
    nearest = np.stack([gap[a : b + 1].min(axis=0) for a, b in zip(first, last, strict=True)])
    touching = tracks.touching[last + 1] - tracks.touching[first]
    share = touching[:, agent, subject] / (last - first + 1)[:, None]
    to_entity = (tracks.way_to_entity[last] - tracks.way_to_entity[first])[:, agent]
    to_landmark = (tracks.way_to_landmark[last] - tracks.way_to_landmark[first])[:, agent]
    to_place = of_place(to_entity[:, named], to_landmark[:, landmark]) / _WAY
    path = (tracks.path[last] - tracks.path[first])[:, agent, None] / _WAY
    progress = (distance[first] - distance[last]) / _WAY
    share = np.where(own, 0.0, share)
    at_subject = ~own & (gap[last] < TOUCHING)
    columns = (
        np.ones_like(progress),
        distance[last] / _LENGTH,
        distance[first] / _LENGTH,
        achieved[last],
        achieved[first],
        in_room[last],
        in_room[first],
        np.where(own, 0.0, gap[last] / _LENGTH),
        np.where(own, 0.0, nearest / _LENGTH),
        share,
        progress,
        np.where(own, 0.0, to_entity[:, subject] / _WAY),
        to_place,
        np.where(at_subject, to_place, 0.0),
        np.broadcast_to(path, progress.shape),
        share * progress,
    )
    return np.stack(columns, axis=-1)
