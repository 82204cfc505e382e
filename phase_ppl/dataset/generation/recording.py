"""From a situation to what happened in it."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.dataset.generation.situation import Situation
from phase_ppl.physics.actions import NO_ACTION
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import AGENTS, NOTHING
from phase_ppl.world.scene import Scene

AT_REST: Final = 0.02
"""Units per frame below which nothing is said to move."""

AFTER_MOTION: Final = 8
"""Frames kept after the last motion, as in the original recordings: 2 s of video."""

SHORTEST: Final = 33
"""Frames that are always kept: the shortest original recording."""


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """A simulated situation.

    Attributes:
        scene: what was known at the start.
        hypothesis: stated goals, alpha, strengths.
        layout: number of the layout, before any reflection.
        trajectory: (time, entity, coord) x, y [units], angle [rad].
        actions: (time, agent) action that led to the frame, ``NO_ACTION`` at the start.
        held: (time, agent) item held when that action was chosen, or ``NOTHING``.
    """

    scene: Scene
    hypothesis: Hypothesis
    layout: int
    trajectory: FloatArray
    actions: NDArray[np.int64]
    held: NDArray[np.int64]


def record(situation: Situation, simulator: JointSimulator, frames: int, seed: int) -> Recording:
    """Simulate a situation and cut the recording after the last motion.

    Args:
        situation: what is simulated.
        simulator: by which it is.
        frames: length before the cut, 12 per simulated second.
        seed: of the simulator.
    """
    steps = simulator.steps(situation.scene, situation.hypothesis, np.random.default_rng(seed))
    taken = list(itertools.islice(steps, frames))
    trajectory = np.array([frame for frame, _ in taken], np.float64)
    decisions = [step for _, step in taken]
    actions = np.full((frames, len(AGENTS)), NO_ACTION, np.int64)
    held = np.full((frames, len(AGENTS)), NOTHING, np.int64)
    for frame, pair in enumerate(decisions):
        for agent, decision in enumerate(pair):
            actions[frame, agent], held[frame, agent] = decision.action, decision.held
    length = after_motion(trajectory)
    return Recording(
        situation.scene,
        situation.hypothesis,
        situation.layout,
        trajectory[:length],
        actions[:length],
        held[:length],
    )


def after_motion(trajectory: FloatArray) -> int:
    """Return how many frames of a (time, entity, coord) trajectory to keep."""
    steps = np.abs(np.diff(trajectory[..., :2], axis=0)).max(axis=(1, 2))
    last = int(np.flatnonzero(steps > AT_REST).max(initial=-1)) + 1
    return min(len(trajectory), max(SHORTEST, last + 1 + AFTER_MOTION))
