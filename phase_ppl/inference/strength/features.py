"""What the network of strengths sees of a window: forces, speeds and grips, pooled over time.

An agent that moves freely shows its strength as the force m a + friction along its heading; one
that carries an item shows it as the force that moves both. Second differences of jittered
positions are useless long before the motion itself is, so forces and speeds are also taken from
parabolas fitted to five and seven frames, and the amount of jitter, read off whatever rests, is
a feature too. Nothing depends on where the event takes place or which way it faces.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.physics.constants import FLOOR_FRICTION, STEP, mass
from phase_ppl.world.names import AGENTS, BLUE_ITEM, PINK_ITEM

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

REACHES: Final = (1, 2, 3)
"""Frames to either side that a parabola is fitted to."""

BINS: Final = np.linspace(125.0, 650.0, 22)
"""Centres of the histograms of forces, newtons; 25 apart."""

FORCE_UNIT: Final = 300.0
SPEED_UNIT: Final = 10.0

N_FEATURES: Final = 8 + len(REACHES) * (6 * 3 + 2 * len(BINS))
"""Eight of the whole window; for each reach three statistics of six channels, two histograms."""

_STILL: Final = 0.3
"""Below this the direction of the friction is uncertain, units per second."""
_NEAR: Final = 0.3
"""Gap between two bodies' circles below which they may touch, units."""
_ROUNDING: Final = 0.002
"""Jitter that is not told from none, units and radians."""
_LOWER_QUARTILE: Final = 0.3186 * np.sqrt(2)
"""Lower quartile of the absolute difference of two standard normal numbers."""


class Jitter(NamedTuple):
    """Standard deviation of the noise on positions, units, and on angles, rad."""

    position: float
    angle: float


def observed_jitter(trajectory: FloatArray) -> Jitter:
    """Return the jitter of a trajectory (time, entity, coord), read off what rests.

    At least a quarter of all differences between frames are those of something at rest; their
    quartile is that of the jitter.
    """
    steps = np.abs(np.diff(trajectory, axis=0))
    positions, angles = steps[..., :2], steps[:, : len(AGENTS), 2]
    return Jitter(
        float(np.quantile(positions, 0.25) / _LOWER_QUARTILE),
        float(np.quantile(angles, 0.25) / _LOWER_QUARTILE),
    )


class Motion(NamedTuple):
    """Motion of all entities by parabolas of one reach; the first entry is of frame ``reach``.

    Attributes:
        reach: frames to either side.
        velocity, acceleration: (time - 2 reach, entity, 2) units and seconds.
        friction: (time - 2 reach, entity, 2) force that the floor friction takes, newtons.
        noise: standard deviation of the acceleration's components by the jitter.
    """

    reach: int
    velocity: FloatArray
    acceleration: FloatArray
    friction: FloatArray
    noise: float


def fitted_motion(positions: FloatArray, reach: int, jitter: float) -> Motion:
    """Return the motion by least-squares parabolas through ``2 reach + 1`` frames.

    Args:
        positions: (time, entity, 2) units.
        reach: frames to either side.
        jitter: standard deviation of the positions, units.
    """
    offsets = np.arange(-reach, reach + 1.0)
    centred = offsets**2 - (offsets**2).mean()
    slope = offsets / (offsets**2).sum() / STEP
    curvature = 2 * centred / (centred**2).sum() / STEP**2
    n = max(len(positions) - 2 * reach, 0)
    frames = np.stack([positions[k : k + n] for k in range(len(offsets))])
    velocity = np.tensordot(slope, frames, 1)
    speed_noise = jitter * float(np.sqrt((slope**2).sum()))
    size = np.sqrt((velocity**2).sum(axis=-1, keepdims=True) + (_STILL / 3 + speed_noise) ** 2)
    return Motion(
        reach,
        velocity,
        np.tensordot(curvature, frames, 1),
        FLOOR_FRICTION * velocity / size,
        jitter * float(np.sqrt((curvature**2).sum())),
    )


def window_features(
    trajectory: FloatArray, radius: FloatArray, windows: IntArray
) -> NDArray[np.float32]:
    """Return (window, agent, feature); always finite.

    Args:
        trajectory: (time, entity, coord) x, y [units], angle [rad]; at least two frames.
        radius: (4,) sizes of the entities, units.
        windows: (window, 2) first and last frame of each.
    """
    jitter = observed_jitter(trajectory)
    motions = [fitted_motion(trajectory[..., :2], reach, jitter.position) for reach in REACHES]
    per_agent = []
    for agent in range(len(AGENTS)):
        grips = _grips(trajectory, radius, agent, jitter.position)
        seen = [_channels(m, trajectory, radius, agent, grips, jitter) for m in motions]
        size = float(radius[agent])
        rows = []
        for first, last in windows:
            parts = [_scalars(size, int(last - first), jitter, motions[0].noise)]
            parts.append(grips[:, first : last + 1].max(axis=0).mean(axis=0))
            for motion, (pooled, counted) in zip(motions, seen, strict=True):
                inside = slice(first, max(last + 1 - 2 * motion.reach, first))
                parts += [_pooled(pooled[inside]), _histograms(counted[inside])]
            rows.append(np.concatenate(parts))
        per_agent.append(rows)
    return np.array(per_agent, np.float32).swapaxes(0, 1)


def _scalars(size: float, length: int, jitter: Jitter, noise: float) -> FloatArray:
    force_noise = mass(0, size) * noise / FORCE_UNIT
    return np.array(
        [
            np.log(size),
            np.log(length) - 2.0,
            np.log(jitter.position + _ROUNDING) + 4.0,
            np.log(jitter.angle + _ROUNDING) + 4.0,
            np.log(force_noise + 0.01),
        ]
    )


def _grips(trajectory: FloatArray, radius: FloatArray, agent: int, jitter: float) -> FloatArray:
    """Return (item, time, 3): held by the agent, held by both, near the item; each in 0..1."""
    p = trajectory[..., :2]
    found = []
    for item in (BLUE_ITEM, PINK_ITEM):
        gaps = [
            np.linalg.norm(p[:, holder] - p[:, item], axis=-1) - radius[holder] - radius[item]
            for holder in (agent, 1 - agent)
        ]
        # a held item's centre is at exactly this distance
        own, other = (np.exp(-0.5 * (gap / (0.05 + 1.5 * jitter)) ** 2) for gap in gaps)
        found.append(np.stack([own, own * other, gaps[0] < _NEAR], axis=-1))
    return np.array(found)


def _channels(
    motion: Motion,
    trajectory: FloatArray,
    radius: FloatArray,
    agent: int,
    grips: FloatArray,
    jitter: Jitter,
) -> tuple[FloatArray, FloatArray]:
    """Return what is pooled (time, channel) and what is counted (time, kind, [force, weight])."""
    n, reach = len(motion.velocity), motion.reach
    if n == 0:
        return np.empty((0, 6)), np.empty((0, 2, 2))
    own_mass = mass(agent, float(radius[agent]))
    force = own_mass * motion.acceleration[:, agent] + motion.friction[:, agent]
    angles = np.stack([trajectory[k : k + n, agent, 2] for k in range(2 * reach + 1)])
    angle = angles.mean(axis=0)
    along = force[:, 1] * np.cos(angle) - force[:, 0] * np.sin(angle)
    across = force[:, 0] * np.cos(angle) + force[:, 1] * np.sin(angle)
    noise = own_mass * motion.noise
    straight = _closeness(across, 10.0 + noise) * _closeness(
        np.ptp(angles, axis=0), 0.02 + 3.0 * jitter.angle
    )
    # the same force in the next frame or the one before: driven all the time
    change = np.linalg.norm(np.diff(force, axis=0), axis=-1)
    same = _closeness(change, 3.0 + 2.0 * noise)
    steady = straight * np.maximum(np.append(same, 0.0), np.append(0.0, same))
    speed = np.linalg.norm(motion.velocity[:, agent], axis=-1)

    inner = grips[:, reach : reach + n]
    held = inner[..., 0].argmax(axis=0)
    rows = np.arange(n)
    item = np.where(held == 0, BLUE_ITEM, PINK_ITEM)
    item_mass = np.array([mass(i, float(radius[i])) for i in (BLUE_ITEM, PINK_ITEM)])[held]
    alone = inner[held, rows, 0] - inner[held, rows, 1]
    carried = force + item_mass[:, None] * motion.acceleration[rows, item]
    carried = np.linalg.norm(carried + motion.friction[rows, item], axis=-1)
    item_speed = np.linalg.norm(motion.velocity[rows, item], axis=-1)
    pooled = [along, along * straight, along * steady, carried * alone]
    pooled = [channel / FORCE_UNIT for channel in pooled]
    pooled += [speed / SPEED_UNIT, item_speed * alone / SPEED_UNIT]
    counted = [np.stack([along, steady], -1), np.stack([carried, alone], -1)]
    return np.stack(pooled, axis=-1), np.stack(counted, axis=1)


def _closeness(deviation: FloatArray, tolerance: float) -> FloatArray:
    return np.exp(-0.5 * (deviation / tolerance) ** 2)


def _pooled(channels: FloatArray) -> FloatArray:
    """Return maximum, mean of the three largest and median of each channel, 0 without frames."""
    n, width = channels.shape
    if n == 0:
        return np.zeros(3 * width)
    ordered = np.sort(channels, axis=0)
    return np.concatenate([ordered[-1], ordered[-3:].mean(axis=0), ordered[n // 2]])


def _histograms(counted: FloatArray) -> FloatArray:
    """Return how often each force was seen, on a logarithmic scale; shared by adjacent bins."""
    force, weight = counted[..., 0], counted[..., 1]
    shares = np.maximum(0.0, 1 - np.abs(force[..., None] - BINS) / (BINS[1] - BINS[0]))
    return np.log1p((shares * weight[..., None]).sum(axis=0)).ravel()
