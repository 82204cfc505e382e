"""The frames of an event as graphs, and events as training examples in all equivalent looks.

Nodes are the four entities, followed, except in the original variant, by the four landmarks. The
paper's variants see unscaled numbers, units and radians. Message passing sees places scaled to the
arena [-1, 1] x [-1, 1], from its centre in halves of its width.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.data.generation.making import Recording, recoloured, reflected
from phase_ppl.data.generation.plan import REFLECTION_SHARES, UNCHANGED, Look
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.geometry import TOUCH_ENLARGEMENT, touches
from phase_ppl.world.goals import goal_index
from phase_ppl.world.hypothesis import RELATIONS, Hypothesis
from phase_ppl.world.names import AGENTS, BLUE_ITEM, ENTITIES, LANDMARKS
from phase_ppl.world.rooms import RAY_DIRECTIONS
from phase_ppl.world.scene import Scene

SingleArray = NDArray[np.float32]
SmallIntArray = NDArray[np.int32]

Variant = Literal["extended", "original", "message_passing"]
VARIANTS: Final = ("extended", "original", "message_passing")

NEAR: Final = 5.0
"""Units between an entity and a landmark's centre below which an edge joins them: the side of a
landmark's square in the original world."""

N_FEATURES: Final = 7
"""Number of features of a node in a frame.

The paper's variants: x, y, their change per simulated second, angle (0 except for agents), size R,
and 0 for agents, 1 for items, 2 for landmarks. Message passing: x, y, their change since the last
frame in units, heading x and y (0 except for agents), size R. A landmark's size is half its width.
"""

CONTACT_FACTOR: Final = 1.2
"""In the paper's variants two entities touch if they are nearer than this times R1 + R2."""

_RATE: Final = 12.0  # frames per simulated second

CONTACT, PROXIMITY = 0, 1  # kinds of edges: two entities touch; an entity is near a landmark

_LONGEST_REACH: Final = 1.81
"""Farthest corner of an agent from its origin, in units of its size (sqrt(3.25), rounded up)."""


class Graphs(NamedTuple):
    """The frames of one event."""

    nodes: SingleArray  # (time, node, feature), see ``N_FEATURES``
    # (edge, 4) frame, sender, receiver, kind; every edge is there in both directions
    edges: SmallIntArray
    # (number,) context of all edges: the walls on the four rays and, in the original variant, the
    # landmarks' centres. The paper's variants have both ends of a wall (0: no wall), message
    # passing the outer end (the centre: no wall)
    context: SingleArray


class Batch(NamedTuple):
    """The frames of several events, one after the other."""

    nodes: SingleArray  # (frame, node, feature)
    edges: IntArray  # (edge, 4) frame, sender, receiver, kind
    context: SingleArray  # (event, number)
    event: IntArray  # (frame,) event that a frame belongs to
    lengths: IntArray  # (event,) frames


def n_nodes(variant: Variant) -> int:
    """Return how many nodes the graph of a frame has."""
    return len(ENTITIES) + (0 if variant == "original" else len(LANDMARKS))


def n_context(variant: Variant) -> int:
    """Return the length of the context of all edges."""
    ends = 1 if variant == "message_passing" else 2
    landmarks = len(LANDMARKS) if variant == "original" else 0
    return 2 * (ends * len(RAY_DIRECTIONS) + landmarks)


def edge_slots(variant: Variant) -> IntArray:
    """Return (sender, receiver) the slot of each possible edge; -1: impossible."""
    n = n_nodes(variant)
    entity = np.arange(n) < len(ENTITIES)
    possible = (entity[:, None] | entity) & ~np.eye(n, dtype=bool)
    return np.where(possible, np.cumsum(possible).reshape(n, n) - 1, -1)


def touching(scene: Scene, observation: Observation, variant: Variant) -> NDArray[np.bool_]:
    """Return (time, entity, entity) who touches whom, by the variant's definition."""
    if variant == "message_passing":
        return contacts(scene, observation)
    places, walls = observation.positions, scene.rooms.wall_length > 0
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    found = apart < CONTACT_FACTOR * (scene.radius[:, None] + scene.radius)
    found &= ~np.eye(len(ENTITIES), dtype=bool)
    for ends in _walls(scene)[walls]:
        found &= ~_crosses(places[:, :, None], places[:, None], *ends)
    return found


def _walls(scene: Scene) -> FloatArray:
    """Return (ray, end, coord), 0 where a ray has no wall."""
    length = scene.rooms.wall_length[:, None]
    outer = scene.centre + length * RAY_DIRECTIONS
    ends = np.stack([np.broadcast_to(scene.centre, outer.shape), outer], axis=1)
    return np.where(length[:, None] > 0, ends, 0.0)


def _crosses(
    one: FloatArray, other: FloatArray, start: FloatArray, end: FloatArray
) -> NDArray[np.bool_]:
    """Return whether straight paths between places (..., coord) cross the wall."""

    def side(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
        along, to = b - a, c - a
        return np.asarray(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0])

    apart = side(start, end, one) * side(start, end, other) <= 0
    return np.asarray(apart & (side(one, other, start) * side(one, other, end) <= 0))


def contacts(scene: Scene, observation: Observation) -> NDArray[np.bool_]:
    """Return (time, entity, entity) who touches whom: one of them enlarged meets the other."""
    n = len(ENTITIES)
    found = np.zeros((observation.n_frames, n, n), np.bool_)
    places, radius = observation.positions, scene.radius
    for one, other in itertools.combinations(range(n), 2):
        apart = np.linalg.norm(places[:, one] - places[:, other], axis=1)
        reach = TOUCH_ENLARGEMENT * _LONGEST_REACH * (radius[one] + radius[other])
        for frame in np.flatnonzero(apart < reach):
            poses = observation.trajectory[frame]
            touch = touches(one, other, poses, radius) or touches(other, one, poses, radius)
            found[frame, [one, other], [other, one]] = touch
    return found


def frame_graphs(
    scene: Scene, observation: Observation, variant: Variant, touch: NDArray[np.bool_] | None = None
) -> Graphs:
    """Return the frames of an event as graphs; ``touch`` is as of :func:`touching`."""
    observation = observation.whole("SocialGNN")
    touch = touching(scene, observation, variant) if touch is None else touch
    nodes, context = (_scaled if variant == "message_passing" else _as_they_are)(scene, observation)
    frame, one, other = np.nonzero(touch)
    edges = [np.stack([frame, one, other, np.full_like(frame, CONTACT)], axis=1)]
    if variant == "original":
        nodes, context = nodes[:, : len(ENTITIES)], np.append(context, scene.landmark_centres)
    else:
        apart = np.linalg.norm(observation.positions[:, :, None] - scene.landmark_centres, axis=-1)
        frame, entity, landmark = np.nonzero(apart < NEAR)
        kind = np.full_like(frame, PROXIMITY)
        node = len(ENTITIES) + landmark
        edges += [np.stack([frame, entity, node, kind], axis=1),
                  np.stack([frame, node, entity, kind], axis=1)]  # fmt: skip
    return Graphs(nodes, np.concatenate(edges).astype(np.int32), context.astype(np.float32))


def _as_they_are(scene: Scene, observation: Observation) -> tuple[SingleArray, FloatArray]:
    """Return the features of entities and landmarks, and the walls, of the paper's variants."""
    nodes = _empty(observation)
    nodes[:, : len(ENTITIES), :2] = observation.positions
    nodes[1:, : len(ENTITIES), 2:4] = _RATE * np.diff(observation.positions, axis=0)
    angles = observation.angles[:, : len(AGENTS)]
    nodes[:, : len(AGENTS), 4] = angles - 2 * np.pi * np.round(angles[0] / (2 * np.pi))
    nodes[:, : len(ENTITIES), 5] = scene.radius
    nodes[:, len(AGENTS) : len(ENTITIES), 6] = 1
    nodes[:, len(ENTITIES) :, :2] = scene.landmark_centres
    nodes[:, len(ENTITIES) :, 5:] = scene.landmark_half_width, 2
    return nodes, _walls(scene).ravel()


def _scaled(scene: Scene, observation: Observation) -> tuple[SingleArray, FloatArray]:
    """Return the features of entities and landmarks, and the walls, for message passing."""
    half = (scene.arena[1] - scene.arena[0]) / 2
    nodes = _empty(observation)
    entities = nodes[:, : len(ENTITIES)]
    entities[..., :2] = (observation.positions - scene.centre) / half
    entities[1:, :, 2:4] = np.diff(observation.positions, axis=0)
    agents = observation.angles[:, : len(AGENTS)]
    entities[:, : len(AGENTS), 4:6] = np.stack([-np.sin(agents), np.cos(agents)], axis=-1)
    entities[..., 6] = scene.radius
    nodes[:, len(ENTITIES) :, :2] = (scene.landmark_centres - scene.centre) / half
    nodes[:, len(ENTITIES) :, 6] = scene.landmark_half_width
    return nodes, (scene.rooms.wall_length[:, None] * RAY_DIRECTIONS / half).ravel()


def _empty(observation: Observation) -> SingleArray:
    n = len(ENTITIES) + len(LANDMARKS)
    return np.zeros((observation.n_frames, n, N_FEATURES), np.float32)


def batch(graphs: Sequence[Graphs]) -> Batch:
    """Return the graphs of several events as one batch."""
    lengths = np.array([len(one.nodes) for one in graphs], np.int64)
    first = np.cumsum(lengths) - lengths
    edges = [one.edges + np.array([n, 0, 0, 0]) for one, n in zip(graphs, first, strict=True)]
    return Batch(
        nodes=np.concatenate([one.nodes for one in graphs]),
        edges=np.concatenate(edges),
        context=np.stack([one.context for one in graphs]),
        event=np.repeat(np.arange(len(graphs)), lengths),
        lengths=lengths,
    )


LOOKS: Final = tuple(
    Look(*look) for look in itertools.product(REFLECTION_SHARES, (False, True), (False, True))
)
"""The 20 equivalent looks of an event: reflections and exchanges of colours."""

AS_IT_IS: Final = LOOKS.index(Look(UNCHANGED, agents=False, items=False))


class Example(NamedTuple):
    """An event in one look: graphs, index of the relation, effective goals of red and green."""

    graphs: Graphs
    relation: int
    goals: tuple[int, int]


class Examples:
    """Events with known truth, in any look; examples are cached.

    Raises:
        InvalidEventError: the truth of an event is not known.
    """

    def __init__(self, events: Sequence[Event], variant: Variant) -> None:
        for event in events:
            if event.truth is None:
                raise InvalidEventError(f"event {event.id!r} has no truth to learn from")
        self._recordings = [_recording(event) for event in events]
        self.relations = [RELATIONS.index(event.truth.relation) for event in events]  # type: ignore[union-attr]
        """Relation of each event, as an index."""
        self._touching = [touching(e.scene, e.observation, variant) for e in events]
        self._variant = variant
        self._kept = functools.cache(self._make)

    def __len__(self) -> int:
        return len(self._recordings)

    def __call__(self, event: int, look: int = AS_IT_IS) -> Example:
        """Return an event in one of :data:`LOOKS`."""
        return self._kept(event, LOOKS[look])

    def _make(self, event: int, look: Look) -> Example:
        seen = self._recordings[event]
        if look.reflection != UNCHANGED:
            seen = reflected(seen, look.reflection)
        seen = recoloured(seen, agents=look.agents, items=look.items)
        # who touches whom is the same in a mirror
        order = np.arange(len(seen.scene.start))
        for swap, first in ((look.agents, 0), (look.items, BLUE_ITEM)):
            if swap:
                order[[first, first + 1]] = order[[first + 1, first]]
        touch = self._touching[event][:, order][:, :, order]
        observation = Observation(seen.trajectory)
        red, green = seen.hypothesis.effective_goals
        return Example(
            frame_graphs(seen.scene, observation, self._variant, touch),
            self.relations[event],
            (red, green),
        )


def _recording(event: Event) -> Recording:
    """Return an event as a recording to copy; agents' actions are unknown and not needed."""
    truth, track = event.truth, event.observation.trajectory
    assert truth is not None
    goals = goal_index(truth.goal_red), goal_index(truth.goal_green)
    nothing = np.zeros((len(track), len(AGENTS)), np.bool_)
    return Recording(event.scene, Hypothesis(*goals), 0, track, nothing, nothing)
