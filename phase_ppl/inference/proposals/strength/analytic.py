"""Strengths read off the observed motion, by the analytic rule.

A free agent that drives forward accelerates by (F - 100 N) / m against the floor friction, so
m a + 100 is its strength F, and in the original world that is one of four levels. Three frames
in a row that hit a level nearly exactly give the strength away; an agent that is slowed by
something only seems weaker, so the largest hit counts.

Frames are means over five substeps. Second differences of such means are those of the motion
itself as long as the acceleration is constant over all three frames.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.inference.proposals.strength.estimates import StrengthEstimates
from phase_ppl.physics.constants import FLOOR_FRICTION, STEP, mass
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.names import AGENTS
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

TOLERANCE: Final = 0.01
"""Relative deviation from a level that still counts as a hit."""

MAX_OFF_HEADING: Final = 0.05
"""Angle between the driving force and the agent's heading that still counts as forward, rad."""

MIN_SPEED: Final = 0.3
"""Below this the direction of the friction is uncertain, units per second."""

VALIDATION_SD: Final = 40.0
"""Root mean square error of the rule on the 50 development videos, newtons: 39 on whole videos
(59 of 100 agents give one; 58 are right, one is two levels off), 35 on windows of 10 steps."""


def analytic_strengths(
    scene: Scene, observation: Observation, windows: NDArray[np.int64]
) -> StrengthEstimates:
    """Return the level that each window gives away; none without free driving.

    Arguments as for :class:`~phase_ppl.inference.proposals.strength.estimates.Estimator`.
    """
    hits = driving_hits(observation.trajectory, scene.radius)
    mean = np.array([estimated_strength(hits, first, last) for first, last in windows])
    return StrengthEstimates(mean, np.where(np.isnan(mean), np.nan, VALIDATION_SD))


def driving_hits(trajectory: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the level that each inner frame gives away, newtons, 0 where none.

    Args:
        trajectory: (time, entity, coord) with coord = x, y [units], angle [rad].
        radius: (4,) sizes of the entities.

    Returns:
        (time - 2, agent): entry k rests on the frames k, k + 1, k + 2.
    """
    levels = np.array(STRENGTH_LEVELS)
    hits = np.zeros((max(len(trajectory) - 2, 0), len(AGENTS)))
    for agent in range(len(AGENTS)):
        force, heading = _driving_force(trajectory[:, agent], mass(agent, float(radius[agent])))
        size = np.linalg.norm(force, axis=-1)
        nearest = np.abs(size[:, None] - levels).argmin(axis=1)
        exact = np.abs(size - levels[nearest]) < TOLERANCE * levels[nearest]
        forward = (force * heading).sum(axis=-1) > np.cos(MAX_OFF_HEADING) * size
        hits[:, agent] = np.where(exact & forward, levels[nearest], 0.0)
    return hits


def _driving_force(track: FloatArray, agent_mass: float) -> tuple[FloatArray, FloatArray]:
    """Return the force (time - 2, 2) that explains an agent's free motion, and its heading."""
    steps = np.diff(track[:, :2], axis=0)
    acceleration = np.diff(steps, axis=0) / STEP**2
    velocity = (steps[1:] + steps[:-1]) / (2 * STEP)
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    moving = speed > MIN_SPEED
    friction = np.where(moving, FLOOR_FRICTION * velocity / np.where(moving, speed, 1.0), 0.0)
    force = np.where(moving, agent_mass * acceleration + friction, 0.0)
    angle = track[1:-1, 2]
    return force, np.stack([-np.sin(angle), np.cos(angle)], axis=-1)


def estimated_strength(hits: FloatArray, first: int, last: int) -> FloatArray:
    """Return (agent,) the estimate from the frames ``first`` to ``last``, NaN without free driving.

    Args:
        hits: what :func:`driving_hits` returned.
        first, last: first and last frame of the window.
    """
    inside = hits[first : max(last - 1, first)]
    largest = inside.max(axis=0, initial=0.0)
    return np.where(largest > 0, largest, np.nan)
