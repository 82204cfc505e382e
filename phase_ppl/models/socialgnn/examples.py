"""Events as examples to learn from, each in all looks that mean the same; no PyTorch is needed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.dataset.generation.copies import Recording, recoloured, reflected
from phase_ppl.dataset.generation.plan import REFLECTION_SHARES, UNCHANGED, Look
from phase_ppl.models.socialgnn.graphs import Graphs, Variant, frame_graphs, touching
from phase_ppl.physics.actions import NO_ACTION
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event
from phase_ppl.world.goals import goal_index
from phase_ppl.world.hypothesis import RELATIONS, Hypothesis
from phase_ppl.world.names import AGENTS, BLUE_ITEM, NOTHING
from phase_ppl.world.observation import Observation

LOOKS: Final = tuple(
    Look(*look) for look in itertools.product(REFLECTION_SHARES, (False, True), (False, True))
)
"""Reflections and exchanges of colours that generated events, like PHASE's, come in: 20."""

AS_IT_IS: Final = LOOKS.index(Look(UNCHANGED, agents=False, items=False))


class Example(NamedTuple):
    """An event in one look: what is seen, index of the relation, effective goals of red, green."""

    graphs: Graphs
    relation: int
    goals: tuple[int, int]


class Examples:
    """Events with known truth, in any look; what was made once is kept.

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
        self._made: dict[tuple[int, int], Example] = {}

    def __len__(self) -> int:
        return len(self._recordings)

    def __call__(self, event: int, look: int = AS_IT_IS) -> Example:
        """Return an event in one of :data:`LOOKS`."""
        key = event, look
        if key not in self._made:
            self._made[key] = self._make(event, LOOKS[look])
        return self._made[key]

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
        return Example(
            frame_graphs(seen.scene, observation, self._variant, touch),
            self.relations[event],
            seen.hypothesis.effective_goals,
        )


def _recording(event: Event) -> Recording:
    """Return an event as what the copies are made of; actions are not known, nor needed."""
    truth = event.truth
    assert truth is not None
    goals = goal_index(truth.goal_red), goal_index(truth.goal_green)
    shape = event.observation.n_frames, len(AGENTS)
    return Recording(
        event.scene,
        Hypothesis(*goals),
        0,
        event.observation.trajectory,
        np.full(shape, NO_ACTION, np.int64),
        np.full(shape, NOTHING, np.int64),
    )
