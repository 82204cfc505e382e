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
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.names import AGENTS, BLUE_ITEM, PINK_ITEM

REACHES: Final = (1, 2, 3)  # frames to either side that a parabola is fitted to
BINS: Final = np.linspace(100.0, 650.0, 12)  # centres of the histogram of forces, newtons; 50 apart
FORCE_UNIT: Final = 300.0
SPEED_UNIT: Final = 10.0

N_FEATURES: Final = 8 + len(REACHES) * (1 + 6 * 3) + 2 + len(BINS)
"""Eight of the whole window; for each reach the noise and three statistics of six channels; the
largest steady force; the histogram of steady forces."""

_STILL: Final = 0.3  # below this the direction of the friction is uncertain, units per second
_NEAR: Final = 0.3  # gap between two bodies' circles below which they may touch, units
_ROUNDING: Final = 0.002  # jitter that is not told from none, units and radians
_QUARTILE: Final = 0.3186 * np.sqrt(2)
_DECILE: Final = 0.1257 * np.sqrt(2)
"""Lower quartile and decile of the absolute difference of two standard normal numbers."""


class Jitter(NamedTuple):
    """Standard deviation of the noise on positions, units, and on angles, rad."""

    position: float
    angle: float


def observed_jitter(trajectory: FloatArray) -> Jitter:
    """Return the jitter of a trajectory (time, entity, coord), read off what rests.

    Mostly at least a quarter of all coordinates are those of something at rest, which makes their
    lower quartile that of the jitter. Agents that push each other turn all the time, by a little;
    hence the decile of the angles.
    """
    steps = np.abs(np.diff(trajectory, axis=0))
    positions, angles = steps[..., :2], steps[:, : len(AGENTS), 2]
    return Jitter(
        float(np.quantile(positions, 0.25) / _QUARTILE), float(np.quantile(angles, 0.1) / _DECILE)
    )


class Motion(NamedTuple):
    """Motion of all entities by parabolas of one reach; the first entry is of frame ``reach``."""

    reach: int  # frames to either side
    velocity: FloatArray  # (time - 2 reach, entity, 2) units and seconds
    acceleration: FloatArray
    friction: FloatArray  # (time - 2 reach, entity, 2) force that the floor friction takes, newtons
    noise: float  # standard deviation of the acceleration's components by the jitter


def fitted_motion(positions: FloatArray, reach: int, jitter: float) -> Motion:
    """Return the motion by least-squares parabolas through ``2 reach + 1`` frames.

    Positions are (time, entity, 2), and have a standard deviation ``jitter``, both in units.
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

    Trajectories are (time, entity, coord) x, y [units], angle [rad], of at least two frames;
    windows (window, 2) the first and last frame of each.
    """
    jitter = observed_jitter(trajectory)
    motions = [fitted_motion(trajectory[..., :2], reach, jitter.position) for reach in REACHES]
    apart = np.linalg.norm(trajectory[:, 0, :2] - trajectory[:, 1, :2], axis=-1)
    meets = apart < 1.5 * radius[: len(AGENTS)].sum() + _NEAR  # their broad sides included
    per_agent = []
    for agent in range(len(AGENTS)):
        grips = _grips(trajectory, radius, agent, jitter.position)
        seen = [_channels(m, trajectory, radius, agent, grips, jitter) for m in motions]
        size = float(radius[agent])
        rows = []
        for first, last in windows:
            parts = [_scalars(size, int(last - first), jitter)]
            parts.append(grips[:, first : last + 1].max(axis=0).mean(axis=0))
            parts.append(meets[first : last + 1].mean(keepdims=True))
            for motion, (pooled, driven) in zip(motions, seen, strict=True):
                inside = slice(first, max(last + 1 - 2 * motion.reach, first))
                noise = mass(agent, size) * motion.noise / FORCE_UNIT
                parts += [np.array([min(noise, 2.0)]), _pooled(pooled[inside])]
                if motion.reach == 1:
                    parts += [_largest(driven[inside]), _histogram(driven[inside])]
            rows.append(np.concatenate(parts))
        per_agent.append(rows)
    return np.array(per_agent, np.float32).swapaxes(0, 1)


def _scalars(size: float, length: int, jitter: Jitter) -> FloatArray:
    return np.array(
        [
            np.log(size),
            np.log(length) - 2.0,
            np.log(jitter.position + _ROUNDING) + 4.0,
            np.log(jitter.angle + _ROUNDING) + 4.0,
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
    """Return what is pooled (time, channel), and forward forces with their steadiness (time, 2)."""
    n, reach = len(motion.velocity), motion.reach
    if n == 0:
        return np.empty((0, 6)), np.empty((0, 2))
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
    return np.stack(pooled, axis=-1), np.stack([along, steady], axis=-1)


def _closeness(deviation: FloatArray, tolerance: float) -> FloatArray:
    return np.exp(-0.5 * (deviation / tolerance) ** 2)


def _pooled(channels: FloatArray) -> FloatArray:
    """Return maximum, mean of the three largest and median of each channel, 0 without frames."""
    n, width = channels.shape
    if n == 0:
        return np.zeros(3 * width)
    ordered = np.sort(channels, axis=0)
    return np.concatenate([ordered[-1], ordered[-3:].mean(axis=0), ordered[n // 2]])


def _largest(driven: FloatArray) -> FloatArray:
    """Return the largest force among the steady ones, 0 without any, and how often it was seen."""
    moves = (driven[:, 0] > FLOOR_FRICTION) & (driven[:, 1] > 0.5)
    force, weight = driven[moves].T
    if len(force) == 0:
        return np.zeros(2)
    largest = force.max()
    near = _closeness(force - largest, 0.05 * largest)
    return np.array([largest / FORCE_UNIT, np.log1p((near * weight).sum())])


def _histogram(driven: FloatArray) -> FloatArray:
    """Return how often each force was seen, on a logarithmic scale; shared by adjacent bins."""
    force, weight = driven.T
    shares = np.maximum(0.0, 1 - np.abs(force[:, None] - BINS) / (BINS[1] - BINS[0]))
    return np.log1p((shares * weight[:, None]).sum(axis=0))
