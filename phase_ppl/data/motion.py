"""Motion of the bodies of an event, from their tracks."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.physics.constants import (
    FLOOR_FRICTION,
    STEP,
    SUBSTEPS,
    inertia,
    mass,
    turn_torque,
)
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import FRAMES_PER_SECOND
from phase_ppl.world.geometry import GRAB_POINTS
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.names import AGENTS, NOTHING
from phase_ppl.world.scene import Scene, Turning

Flags = NDArray[np.bool_]
SLOW: Final = 0.5  # units per simulated second below which a body is at rest

TAIL: Final = 5
"""Fewest frames after the last motion if a track was cut there. Original tracks that were cut go on
for 5 to 9 frames."""

_MOVING: Final = 0.02  # units per frame that count as motion when its end is sought

_ENOUGH: Final = 40  # frames in which an agent must move before its changes of speed are judged
_MANY: Final = 100  # such frames from which on the usual limit holds; half of it with fewer
_PACE_AT: Final = 0.9  # quantile of changes of speed that leaves out only the rarest

HELD_WITHIN: Final = 0.05
"""Largest distance of a held item from its place at a grab point, units. Frames are means over a
step, which blurs a body that turns."""

_HELD_FRAMES: Final = 3
_GAP_FRAMES: Final = 3


def speeds(trajectory: FloatArray) -> FloatArray:
    """Return (time - 1, entity) speeds from frame to frame, units per simulated second."""
    steps = np.linalg.norm(np.diff(trajectory[..., :2], axis=0), axis=2)
    return np.asarray(steps * FRAMES_PER_SECOND)


def odd_pace(trajectory: FloatArray, scene: Scene) -> str:
    """Return "slow" or "fast" if agents move as no agents of a world can, else "".

    Slow ones change their speed less than the floor's friction alone would make them, as happens
    with more frames a second than twelve; fast ones more than the strongest push against it could.
    What counts is the change that a tenth of the frames in which they move exceed. In recordings
    with twelve frames it takes 1.9 to 6.6 times the friction, and the limits are 1 and 7; with 60
    at most 0.4, with 30 mostly below 1, with 6 mostly above 7. In simulated videos of 31 frames,
    where few frames tell, it takes 0.6 or more, and the lower limit is 0.5.
    """
    n_agents = len(scene.world.agents)
    change = np.diff(trajectory[:, :n_agents, :2], axis=0)
    speed = np.linalg.norm(change, axis=2)
    moves = np.maximum(speed[1:], speed[:-1]) > _MOVING  # not where it was not seen
    if moves.sum() < _ENOUGH or scene.resets_velocity:
        return ""
    masses = [mass(agent, float(scene.radius[agent]), n_agents) for agent in range(n_agents)]
    per_newton = STEP**2 / np.array(masses)  # units per frame, each frame
    forces = np.linalg.norm(np.diff(change, axis=0), axis=2) / per_newton
    force = np.quantile(forces[moves], _PACE_AT)
    if force < FLOOR_FRICTION * (1.0 if moves.sum() >= _MANY else 0.5):
        return "slow"
    return "fast" if force > max(STRENGTH_RANGE) + FLOOR_FRICTION else ""


def last_motion(trajectory: FloatArray) -> int:
    """Return the last frame in which something has moved; 0: nothing ever does."""
    steps = np.abs(np.diff(trajectory[..., :2], axis=0)).max(axis=(1, 2))
    return int(np.flatnonzero(steps > _MOVING).max(initial=-1)) + 1


def moves_to_the_end(trajectory: FloatArray) -> bool:
    """Whether something still moves in the last frames, so that the track was not cut at rest."""
    last = last_motion(trajectory)
    return last > 0 and len(trajectory) - 1 - last < TAIL


def seems_to_hold(trajectory: FloatArray, radius: FloatArray, n_agents: int = len(AGENTS)) -> Flags:
    """Return (time, agent): whether the agent seems to hold an item (:func:`items_held`)."""
    return np.asarray(items_held(trajectory, radius, n_agents=n_agents) != NOTHING)


def items_held(
    trajectory: FloatArray,
    radius: FloatArray,
    within: float = HELD_WITHIN,
    n_agents: int = len(AGENTS),
) -> NDArray[np.int64]:
    """Return the index of the entity that each agent seems to hold, (time, agent); -1: nothing.

    A held item is fixed in front of, behind or beside its holder; the two shapes touch at a grab
    point. An item that is near that place for three frames counts as held. If there are two, the
    nearer one counts. An item that is pushed dead centre, or lies where it was let go of, counts
    wrongly; an item held for a moment is missed. In simulated events, the share of time in which an
    agent holds an item has an error of some 0.015.

    Args:
        trajectory: (time, entity, coord) x, y [units], angle [rad]; agents first, then items.
        radius: (entity,) sizes R, units.
        within: largest distance between a held item and its place, units. Default: 0.05.
        n_agents: number of entities that are agents.
    """
    n_items = trajectory.shape[1] - n_agents
    if not n_items:
        return np.full((len(trajectory), n_agents), NOTHING)
    off = np.full((len(trajectory), n_agents, n_items), np.inf)
    for agent in range(n_agents):
        cos, sin = np.cos(trajectory[:, agent, 2]), np.sin(trajectory[:, agent, 2])
        for which in range(n_items):
            item = n_agents + which
            x, y = (trajectory[:, item, :2] - trajectory[:, agent, :2]).T
            local = np.column_stack([cos * x + sin * y, cos * y - sin * x])
            for point in GRAB_POINTS:
                place = point * (radius[agent] + radius[item])
                distance = np.linalg.norm(local - place, axis=1)
                held = _lasting(distance < within)
                off[held, agent, which] = np.minimum(off[held, agent, which], distance[held])
    nearest = n_agents + off.argmin(axis=2)
    return np.where(np.isfinite(off.min(axis=2)), nearest, NOTHING)


def _lasting(flags: Flags) -> Flags:
    """Return the flags with short gaps between true values closed, then without short runs."""
    from scipy import ndimage

    # a gap at either end cannot be closed
    padded = np.pad(flags, _GAP_FRAMES + 1)
    closed = ndimage.binary_closing(padded, np.ones(_GAP_FRAMES + 1))
    lasting = ndimage.binary_opening(closed, np.ones(_HELD_FRAMES))
    return np.asarray(lasting[_GAP_FRAMES + 1 : -_GAP_FRAMES - 1])


# --- which way agents turn by themselves -----------------------------------------------------
# The agents of the authors' recordings turn counter-clockwise only, those of the reflected copies
# clockwise only. A model in which they can turn either way explains something else.

MIN_TURNS: Final = 3  # turns that must be seen before agents are taken to turn one way only
MIN_SHARE: Final = 0.8  # share of all turns that must go the same way

RATE_TOLERANCE: Final = 0.05
"""Relative deviation of a turn from the full rate. Floor friction acts beside the centre of mass
and slows or speeds a turn by up to 4 %."""

FIRST_PART: Final = (0.4, 0.5)
"""Share of a lone one-step turn that shows in the first of its two frames: 7/15 with the original
engine, which averages the angle over five substeps."""


def full_turn(radius: float) -> float:
    """Return the angle by which a free agent of size ``radius`` turns in one step, rad.

    The torque acts in all substeps. Each updates the spin, then the angle; the end of the step
    resets the spin. For the sizes 0.8, 1.01, 1.2 and 1.6 the angles are 1.06, 0.66, 0.47 and 0.26.
    """
    substep = STEP / SUBSTEPS
    updates = SUBSTEPS * (SUBSTEPS + 1) / 2
    return updates * substep**2 * turn_torque(radius) / inertia(0, radius)


def count_turns(trajectory: NDArray[np.float64], radius: NDArray[np.float64]) -> tuple[int, int]:
    """Return how often (counter-clockwise, clockwise) an agent turned at its full rate.

    Frames are means over a step. So a turn of several steps shows as increments of the full rate
    between a smaller first and last one, which add up to one more turn. Only increments of the full
    rate, and lone turns spread over two frames, are counted.
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
    """Return "ccw" or "cw" if the two agents of PHASE clearly turn one way only, else "both".

    "ccw" is counter-clockwise. A turn is one step of an agent at its full turning rate. Over both
    agents at least 3 must be seen, 80 % or more of them one way.

    Args:
        trajectory: (time, entity, coord) x, y [units], angle [rad]; agents first.
        radius: (entity,) sizes R, units.
    """
    counter_clockwise, clockwise = count_turns(trajectory, radius)
    total = counter_clockwise + clockwise
    if total < MIN_TURNS or max(counter_clockwise, clockwise) < MIN_SHARE * total:
        return "both"
    return "ccw" if counter_clockwise > clockwise else "cw"
