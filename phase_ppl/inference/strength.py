"""Bottom-up estimates of the agents' strengths from how they accelerate.

In free forward driving an agent of mass m and strength F accelerates by (F - friction) / m, so
m a + friction is its strength. Three frames of constant acceleration give a exactly, because
frames are means over the same number of substeps. Stands in the place of the paper's strength
network (Appendix 4B).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.physics.constants import FLOOR_FRICTION
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.names import AGENTS
from phase_ppl.world.observation import FRAMES_PER_SECOND, Observation
from phase_ppl.world.scene import Scene

FloatArray = NDArray[np.float64]

HIT: Final = 2.0
"""An apparent force this close to a strength level counts as that level, newtons."""

STRAIGHT: Final = 0.2
"""The heading must be constant to this, and the push along it, rad."""

VALIDATION_SD: Final = 20.0
"""Standard deviation of an estimate, newtons. On 50 recorded videos of known strength all 53
estimates (of 100 agents) were exact, so this only leaves room for what those did not show."""


def apparent_forces(scene: Scene, observation: Observation) -> FloatArray:
    """Return the force that each agent seems to exert in free forward driving.

    Returns:
        (time, agent) m a + friction, newtons; NaN in frames in which the agent does not push
        straight ahead. Frame t is the middle one of three.
    """
    x, angle = observation.positions, observation.angles
    forces = np.full((observation.n_frames, len(AGENTS)), np.nan)
    for agent in range(len(AGENTS)):
        mass = 4 * scene.radius[agent] ** 2
        acceleration = np.diff(x[:, agent], 2, axis=0) * FRAMES_PER_SECOND**2
        ahead = np.column_stack([-np.sin(angle[1:-1, agent]), np.cos(angle[1:-1, agent])])
        forward = (acceleration * ahead).sum(axis=1)
        sideways = np.abs(acceleration[:, 0] * ahead[:, 1] - acceleration[:, 1] * ahead[:, 0])
        turn = np.abs(np.diff(angle[:, agent]))
        straight = (turn[1:] < STRAIGHT) & (turn[:-1] < STRAIGHT) & (forward > 0)
        straight &= sideways < STRAIGHT * forward
        forces[1:-1, agent] = np.where(straight, mass * forward + FLOOR_FRICTION, np.nan)
    return forces


def strength_levels_hit(scene: Scene, observation: Observation) -> FloatArray:
    """Return (time, agent) the strength level shown in each frame, newtons, or NaN."""
    forces = apparent_forces(scene, observation)[..., None]
    off = np.abs(forces - np.array(STRENGTH_LEVELS))
    nearest = np.array(STRENGTH_LEVELS)[np.argmin(np.nan_to_num(off, nan=np.inf), axis=-1)]
    with np.errstate(invalid="ignore"):
        return np.where(np.nanmin(np.nan_to_num(off, nan=np.inf), axis=-1) < HIT, nearest, np.nan)


def estimate(levels: FloatArray) -> FloatArray:
    """Return (agent,) the largest level shown in some frames (time, agent), or NaN.

    The largest, because part of a push, or a push against something, shows as less.
    """
    shown = np.nan_to_num(levels, nan=-np.inf).max(axis=0, initial=-np.inf)
    return np.where(np.isfinite(shown), shown, np.nan)
