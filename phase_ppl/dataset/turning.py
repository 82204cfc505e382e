"""Which way agents turn by themselves, read off the observed angles.

The agents of the authors' recordings turn counter-clockwise only, those of the reflected copies
clockwise only; an explanation that lets them turn the other way explains something else.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.physics.constants import STEP, SUBSTEPS, inertia, turn_torque
from phase_ppl.world.names import AGENTS
from phase_ppl.world.scene import Turning

MIN_TURNS: Final = 3
"""Turns that must be seen before one direction is believed to be the only one."""

MIN_SHARE: Final = 0.8
"""Share of all turns that must go the same way."""

RATE_TOLERANCE: Final = 0.05
"""Relative deviation of a turn from the full rate: floor friction acts beside the centre of mass
and slows or speeds a turn by up to 4 %."""

FIRST_PART: Final = (0.4, 0.5)
"""Part of a lone one-step turn that shows in the first of the two frames it touches: 7/15 with
the original engine, which averages the angle over five substeps."""


def full_turn(radius: float) -> float:
    """Return the angle by which a free agent of size ``radius`` turns in one step, rad.

    The torque acts through all substeps, each of which first updates the spin and then the
    angle; at the end of the step the spin is reset (1.06, 0.66, 0.47 and 0.26 for the sizes
    0.8, 1.01, 1.2 and 1.6).
    """
    substep = STEP / SUBSTEPS
    updates = SUBSTEPS * (SUBSTEPS + 1) / 2
    return updates * substep**2 * turn_torque(radius) / inertia(0, radius)


def count_turns(trajectory: NDArray[np.float64], radius: NDArray[np.float64]) -> tuple[int, int]:
    """Return how often (counter-clockwise, clockwise) an agent turned at its full rate.

    Frames are means over a step. A turn of several steps therefore shows as increments of the
    full rate between a smaller first and last one, which add up to one more turn; only increments
    of the full rate, and lone turns spread over two frames, are counted.

    Args:
        trajectory: (time, entity, coord) with coord = x, y, angle.
        radius: (4,) sizes of the entities.
    """
    counts = [0, 0]
    low, high = FIRST_PART
    for agent in range(len(AGENTS)):
        with np.errstate(over="ignore", invalid="ignore"):  # an impossible jump is no turn
            steps = np.diff(trajectory[:, agent, 2]) / full_turn(float(radius[agent]))
            both = steps[:-1] + steps[1:]
        for way, sign in enumerate((1.0, -1.0)):
            part = sign * steps
            whole = np.abs(part - 1) < RATE_TOLERANCE
            lone = np.abs(sign * both - 1) < RATE_TOLERANCE
            lone &= (low < part[:-1]) & (part[:-1] < high)
            counts[way] += int(whole.sum() + lone.sum())
    return counts[0], counts[1]


def observed_turning(trajectory: NDArray[np.float64], radius: NDArray[np.float64]) -> Turning:
    """Return "ccw" or "cw" where the agents clearly turn one way only, else "both".

    At least ``MIN_TURNS`` turns must be seen, ``MIN_SHARE`` of them the same way.
    Arguments as for :func:`count_turns`.
    """
    counter_clockwise, clockwise = count_turns(trajectory, radius)
    total = counter_clockwise + clockwise
    if total < MIN_TURNS or max(counter_clockwise, clockwise) < MIN_SHARE * total:
        return "both"
    return "ccw" if counter_clockwise > clockwise else "cw"
