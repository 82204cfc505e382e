"""The frames of an event as graphs, and events as training examples.

Nodes are the four entities, followed, except in the original variant, by the four landmarks.
Networks see unscaled numbers, units and radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.goals import goal_index
from phase_ppl.world.hypothesis import RELATIONS
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS
from phase_ppl.world.rooms import RAY_DIRECTIONS
from phase_ppl.world.scene import Scene

SingleArray = NDArray[np.float32]
SmallIntArray = NDArray[np.int32]

Variant = Literal["extended", "original"]
VARIANTS: Final = ("extended", "original")

NEAR: Final = 5.0
"""Units between an entity and a landmark's centre below which an edge joins them: the side of a
landmark's square in the original world."""

N_FEATURES: Final = 7
"""Number of features of a node in a frame.

They are x, y, their change per simulated second, angle (0 except for agents), size R, and 0 for
agents, 1 for items, 2 for landmarks. A landmark's size is half its width.
"""

CONTACT_FACTOR: Final = 1.2
"""Two entities touch if they are nearer than this times R1 + R2."""

_RATE: Final = 12.0  # frames per simulated second


class Graphs(NamedTuple):
    """The frames of one event."""

    nodes: SingleArray  # (time, node, feature), see ``N_FEATURES``
    # (edge, 3) frame, sender, receiver; every edge is there in both directions
    edges: SmallIntArray
    # (number,) context of all edges: both ends of the walls on the four rays (0: no wall) and, in
    # the original variant, the landmarks' centres
    context: SingleArray


class Batch(NamedTuple):
    """The frames of several events, one after the other."""

    nodes: SingleArray  # (frame, node, feature)
    edges: IntArray  # (edge, 3) frame, sender, receiver
    context: SingleArray  # (event, number)
    event: IntArray  # (frame,) event that a frame belongs to
    lengths: IntArray  # (event,) frames


def n_nodes(variant: Variant) -> int:
    """Return how many nodes the graph of a frame has."""
    return len(ENTITIES) + (0 if variant == "original" else len(LANDMARKS))


def n_context(variant: Variant) -> int:
    """Return the length of the context of all edges."""
    landmarks = len(LANDMARKS) if variant == "original" else 0
    return 2 * (2 * len(RAY_DIRECTIONS) + landmarks)


def edge_slots(variant: Variant) -> IntArray:
    """Return (sender, receiver) the slot of each possible edge; -1: impossible."""
    n = n_nodes(variant)
    entity = np.arange(n) < len(ENTITIES)
    possible = (entity[:, None] | entity) & ~np.eye(n, dtype=bool)
    return np.where(possible, np.cumsum(possible).reshape(n, n) - 1, -1)


def touching(scene: Scene, observation: Observation) -> NDArray[np.bool_]:
    """Return (time, entity, entity) who touches whom."""
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


def frame_graphs(scene: Scene, observation: Observation, variant: Variant) -> Graphs:
    """Return the frames of an event as graphs."""
    observation = observation.whole("SocialGNN")
    nodes, context = _features(scene, observation), _walls(scene).ravel()
    edges = [np.argwhere(touching(scene, observation))]
    if variant == "original":
        nodes, context = nodes[:, : len(ENTITIES)], np.append(context, scene.landmark_centres)
    else:
        apart = np.linalg.norm(observation.positions[:, :, None] - scene.landmark_centres, axis=-1)
        frame, entity, landmark = np.nonzero(apart < NEAR)
        node = len(ENTITIES) + landmark
        edges += [np.stack(ends, axis=1) for ends in ((frame, entity, node), (frame, node, entity))]
    return Graphs(nodes, np.concatenate(edges).astype(np.int32), context.astype(np.float32))


def _features(scene: Scene, observation: Observation) -> SingleArray:
    """Return (time, node, feature) the features of entities and landmarks."""
    n = len(ENTITIES) + len(LANDMARKS)
    nodes = np.zeros((observation.n_frames, n, N_FEATURES), np.float32)
    nodes[:, : len(ENTITIES), :2] = observation.positions
    nodes[1:, : len(ENTITIES), 2:4] = _RATE * np.diff(observation.positions, axis=0)
    angles = observation.angles[:, : len(AGENTS)]
    nodes[:, : len(AGENTS), 4] = angles - 2 * np.pi * np.round(angles[0] / (2 * np.pi))
    nodes[:, : len(ENTITIES), 5] = scene.radius
    nodes[:, len(AGENTS) : len(ENTITIES), 6] = 1
    nodes[:, len(ENTITIES) :, :2] = scene.landmark_centres
    nodes[:, len(ENTITIES) :, 5:] = scene.landmark_half_width, 2
    return nodes


def batch(graphs: Sequence[Graphs]) -> Batch:
    """Return the graphs of several events as one batch."""
    lengths = np.array([len(one.nodes) for one in graphs], np.int64)
    first = np.cumsum(lengths) - lengths
    edges = [one.edges + np.array([n, 0, 0]) for one, n in zip(graphs, first, strict=True)]
    return Batch(
        nodes=np.concatenate([one.nodes for one in graphs]),
        edges=np.concatenate(edges),
        context=np.stack([one.context for one in graphs]),
        event=np.repeat(np.arange(len(graphs)), lengths),
        lengths=lengths,
    )


class Example(NamedTuple):
    """An event to learn from: graphs, index of the relation, effective goals of red and green."""

    graphs: Graphs
    relation: int
    goals: tuple[int, int]


def example(event: Event, variant: Variant) -> Example:
    """Return an event with known truth as an example (InvalidEventError: it is not known)."""
    truth = event.truth
    if truth is None:
        raise InvalidEventError(f"event {event.id!r} has no truth to learn from")
    return Example(
        frame_graphs(event.scene, event.observation, variant),
        RELATIONS.index(truth.relation),
        (goal_index(truth.goal_red), goal_index(truth.goal_green)),
    )
