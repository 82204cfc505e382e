"""The frames of an event as graphs.

Nodes are the four entities and, in the extended variant, the four landmarks after them. Places
count from the arena's centre in halves of its width, so that the arena is [-1, 1] x [-1, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.arrays import IntArray
from phase_ppl.world.errors import unknown_name
from phase_ppl.world.geometry import TOUCH_ENLARGEMENT, touches
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS
from phase_ppl.world.observation import Observation
from phase_ppl.world.rooms import RAY_DIRECTIONS
from phase_ppl.world.scene import Scene

SingleArray = NDArray[np.float32]
SmallIntArray = NDArray[np.int32]

Variant = Literal["extended", "original"]
VARIANTS: Final = ("extended", "original")

NEAR: Final = 5.0
"""Units between an entity and a landmark's centre below which an edge joins them: the side of a
landmark's square in the original world."""

FEATURES: Final = (
    "x, halves of the arena's width",
    "y, halves of the arena's width",
    "x gained since the last frame, units",
    "y gained since the last frame, units",
    "heading x; 0 but for agents",
    "heading y; 0 but for agents",
    "size R, units; of landmarks half their width",
)
"""Of a node in a frame; which node it is follows, one-hot."""

CONTACT, PROXIMITY = 0, 1
"""Kinds of edges: two entities touch; an entity is near a landmark."""

_LONGEST_REACH: Final = 1.81
"""Farthest corner of an agent from its origin, in units of its size (sqrt(3.25), rounded up)."""


class Graphs(NamedTuple):
    """The frames of one event.

    Attributes:
        nodes: (time, node, feature), see :data:`FEATURES`.
        edges: (edge, 4) frame, sender, receiver, kind; every edge is there in both directions.
        context: (number,) what all edges are told: the ends of the walls on the four rays (the
            centre where there is none), and in the original variant the landmarks' centres.
    """

    nodes: SingleArray
    edges: SmallIntArray
    context: SingleArray


class Batch(NamedTuple):
    """The frames of several events, one after the other.

    Attributes:
        nodes: (frame, node, feature).
        edges: (edge, 4) frame, sender, receiver, kind.
        context: (event, number).
        event: (frame,) event that a frame belongs to.
        lengths: (event,) frames.
    """

    nodes: SingleArray
    edges: IntArray
    context: SingleArray
    event: IntArray
    lengths: IntArray


def checked_variant(variant: str) -> Variant:
    """Return ``variant``; raise UnknownNameError if it is none of :data:`VARIANTS`."""
    if variant not in VARIANTS:
        raise unknown_name("variant", variant, VARIANTS)
    return variant  # type: ignore[return-value]


def n_nodes(variant: Variant) -> int:
    """Return how many nodes the graph of a frame has."""
    return len(ENTITIES) + (len(LANDMARKS) if variant == "extended" else 0)


def n_context(variant: Variant) -> int:
    """Return how many numbers all edges are told."""
    return 2 * len(RAY_DIRECTIONS) + (2 * len(LANDMARKS) if variant == "original" else 0)


def contacts(scene: Scene, observation: Observation) -> NDArray[np.bool_]:
    """Return (time, entity, entity) who touches whom: one of them enlarged meets the other."""
    n = len(ENTITIES)
    found = np.zeros((observation.n_frames, n, n), np.bool_)
    places, radius = observation.positions, scene.radius
    for one in range(n):
        for other in range(one + 1, n):
            apart = np.linalg.norm(places[:, one] - places[:, other], axis=1)
            reach = TOUCH_ENLARGEMENT * _LONGEST_REACH * (radius[one] + radius[other])
            for frame in np.flatnonzero(apart < reach):
                poses = observation.trajectory[frame]
                found[frame, one, other] = found[frame, other, one] = touches(
                    one, other, poses, radius
                ) or touches(other, one, poses, radius)
    return found


def frame_graphs(
    scene: Scene,
    observation: Observation,
    variant: Variant,
    touching: NDArray[np.bool_] | None = None,
) -> Graphs:
    """Return the frames of an event as graphs; ``touching`` is as of :func:`contacts`."""
    if touching is None:
        touching = contacts(scene, observation)
    half = (scene.arena[1] - scene.arena[0]) / 2
    places = observation.positions
    nodes = np.zeros((observation.n_frames, n_nodes(variant), len(FEATURES)), np.float32)
    entities = nodes[:, : len(ENTITIES)]
    entities[..., :2] = (places - scene.centre) / half
    entities[1:, :, 2:4] = np.diff(places, axis=0)
    agents = observation.angles[:, : len(AGENTS)]
    entities[:, : len(AGENTS), 4:6] = np.stack([-np.sin(agents), np.cos(agents)], axis=-1)
    entities[..., 6] = scene.radius
    frame, one, other = np.nonzero(touching)
    edges = [np.stack([frame, one, other, np.full_like(frame, CONTACT)], axis=1)]
    landmarks = (scene.landmark_centres - scene.centre) / half
    walls = scene.rooms.wall_length[:, None] * RAY_DIRECTIONS / half
    if variant == "extended":
        nodes[:, len(ENTITIES) :, :2] = landmarks
        nodes[:, len(ENTITIES) :, 6] = scene.landmark_half_width
        apart = np.linalg.norm(places[:, :, None] - scene.landmark_centres, axis=-1)
        frame, entity, landmark = np.nonzero(apart < NEAR)
        kind = np.full_like(frame, PROXIMITY)
        node = len(ENTITIES) + landmark
        edges += [np.stack([frame, entity, node, kind], axis=1),
                  np.stack([frame, node, entity, kind], axis=1)]  # fmt: skip
        context = walls.ravel()
    else:
        context = np.concatenate([walls.ravel(), landmarks.ravel()])
    return Graphs(nodes, np.concatenate(edges).astype(np.int32), context.astype(np.float32))


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
