"""Estimators of agents' strengths: the paper's network and an analytic rule."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from importlib import resources
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.physics.constants import FLOOR_FRICTION, STEP, SUBSTEP, SUBSTEPS, mass
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.event import Observation
from phase_ppl.world.hypothesis import STRENGTH_LEVELS, STRENGTH_RANGE
from phase_ppl.world.names import AGENTS, BLUE_ITEM, PINK_ITEM
from phase_ppl.world.scene import Scene

# --- features of a window for the network: forces, speeds and grips, pooled over time -------------

# A freely moving agent shows its strength as the force m a + friction along its heading. An agent
# that carries an item shows it as the force that moves both. Jitter spoils second differences of
# positions long before the motion itself. So forces and speeds are also taken from parabolas fitted
# to five and seven frames. The amount of jitter, measured on resting bodies, is a feature too. All
# features are invariant to place and direction.

REACHES: Final = (1, 2, 3)  # frames to either side that a parabola is fitted to
BINS: Final = np.linspace(100.0, 650.0, 12)  # centres of the histogram of forces, newtons; 50 apart
FORCE_UNIT: Final = 300.0
SPEED_UNIT: Final = 10.0

N_FEATURES: Final = 8 + len(REACHES) * (1 + 6 * 3) + 2 + len(BINS)
"""Number of features: eight of the whole window; for each reach the noise and three statistics of
six channels; the largest steady force; the histogram of steady forces."""

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
    """Return the jitter of a trajectory (time, entity, coord), measured on resting bodies.

    Usually at least a quarter of all coordinates belong to bodies at rest, so the lower quartile of
    changes is the jitter's. Agents that push each other always turn a little; hence the decile of
    the angles.
    """
    steps = np.abs(np.diff(trajectory, axis=0))
    positions, angles = steps[..., :2], steps[:, : len(AGENTS), 2]
    return Jitter(
        float(np.quantile(positions, 0.25) / _QUARTILE), float(np.quantile(angles, 0.1) / _DECILE)
    )


class Motion(NamedTuple):
    """Motion of all entities, from parabolas of one reach; the first entry is frame ``reach``."""

    reach: int  # frames to either side
    velocity: FloatArray  # (time - 2 reach, entity, 2) units and seconds
    acceleration: FloatArray
    friction: FloatArray  # (time - 2 reach, entity, 2) force that the floor friction takes, newtons
    noise: float  # standard deviation of the acceleration's components due to jitter


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
    """Return features (window, agent, feature); always finite.

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
            parts = [
                _scalars(size, int(last - first), jitter),
                grips[:, first : last + 1].max(axis=0).mean(axis=0),
                meets[first : last + 1].mean(keepdims=True),
            ]
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
    """Return channels (time, channel) to pool, and forward forces with steadiness (time, 2)."""
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
    # a steady force equals that of the next or the previous frame
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
    """Return the largest steady force, 0 without any, and how often it was seen."""
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


# --- estimators -----------------------------------------------------------------------------------


class StrengthEstimates(NamedTuple):
    """Normal distributions of the agents' strengths, to be cut to the range of strengths."""

    # (window, agent) newtons; NaN where there is no estimate, which means the prior
    mean: FloatArray
    sd: FloatArray  # (window, agent) newtons; NaN where ``mean`` is


Estimator = Callable[[Scene, Observation, NDArray[np.int64]], StrengthEstimates]
"""Estimates all agents' strengths from windows of what was observed.

Windows are (window, 2), the first and the last frame of each; they differ by 1 or more."""

TOLERANCE: Final = 0.01  # relative deviation from a level that still counts as a hit

MAX_OFF_HEADING: Final = 0.05
"""Angle between the driving force and the agent's heading that still counts as forward, rad."""

MIN_SPEED: Final = 0.3  # below this the direction of the friction is uncertain, units per second

VALIDATION_SD: Final = 40.0
"""Root mean square error of the rule on the 50 development videos, newtons: 39 on whole videos,
35 on windows of 10 steps. Whole videos give a level for 59 of 100 agents: 58 are right, one is two
levels off."""


def analytic_strengths(
    scene: Scene, observation: Observation, windows: NDArray[np.int64]
) -> StrengthEstimates:
    """Return strengths by the analytic rule; a window without free driving has no estimate.

    A free agent that drives forward accelerates by (F - 100 N) / m against the floor friction. So
    m a + 100 is its strength F, one of four levels in the original world. Three frames in a row
    that hit a level nearly exactly reveal the strength. An agent that is slowed down only seems
    weaker, so the largest hit counts. Frames are means over five substeps. Their second differences
    equal those of the motion if the acceleration is constant over the three frames.

    If agents stand still after each step, two frames in a row suffice. Driving from rest moves an
    agent by (F - 100 N) / m times the sum over the substeps of the remaining time.

    Arguments as of :data:`~phase_ppl.inference.strength.Estimator`.
    """
    radius = scene.radius[: len(scene.world.agents)]
    hits = _driving_hits(observation.trajectory, radius, scene.resets_velocity)
    inside = [hits[first : max(last - 1, first)] for first, last in windows]
    largest = np.array([found.max(axis=0, initial=0.0) for found in inside])
    mean = np.where(largest > 0, largest, np.nan)
    return StrengthEstimates(mean, np.where(largest > 0, VALIDATION_SD, np.nan))


_FROM_REST: Final = SUBSTEP**2 * SUBSTEPS * (SUBSTEPS + 1) / 2
"""Distance covered in a step from rest, per acceleration, s^2."""


def _driving_hits(trajectory: FloatArray, radius: FloatArray, resets: bool) -> FloatArray:
    """Return (time - 2, agent) the level that frames k, k + 1, k + 2 hit; 0: none.

    Radii are (agent,), units.
    """
    levels = np.array(STRENGTH_LEVELS)
    driving_force = _force_from_rest if resets else _driving_force
    n_agents = len(radius)
    hits = np.zeros((max(len(trajectory) - 2, 0), n_agents))
    for agent, size in enumerate(radius.tolist()):
        force = driving_force(trajectory[:, agent], mass(agent, size, n_agents))
        angle = trajectory[1:-1, agent, 2]
        heading = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        newtons = np.linalg.norm(force, axis=-1)
        nearest = np.abs(newtons[:, None] - levels).argmin(axis=1)
        exact = np.abs(newtons - levels[nearest]) < TOLERANCE * levels[nearest]
        forward = (force * heading).sum(axis=-1) > np.cos(MAX_OFF_HEADING) * newtons
        hits[:, agent] = np.where(exact & forward, levels[nearest], 0.0)
    return hits


def _driving_force(track: FloatArray, agent_mass: float) -> FloatArray:
    """Return the force (time - 2, 2) that explains an agent's free motion."""
    steps = np.diff(track[:, :2], axis=0)
    acceleration = np.diff(steps, axis=0) / STEP**2
    velocity = (steps[1:] + steps[:-1]) / (2 * STEP)
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    moving = speed > MIN_SPEED
    friction = np.where(moving, FLOOR_FRICTION * velocity / np.where(moving, speed, 1.0), 0.0)
    return np.where(moving, agent_mass * acceleration + friction, 0.0)


def _force_from_rest(track: FloatArray, agent_mass: float) -> FloatArray:
    """Return the same as :func:`_driving_force` for agents that stand still after each step."""
    way = np.diff(track[:, :2], axis=0)
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    moves = length > 0
    direction = np.where(moves, way / np.where(moves, length, 1.0), 0.0)
    force = direction * (FLOOR_FRICTION + agent_mass * length / _FROM_REST)
    # a frame lies within its step: only evenly driven steps show the motion of a whole step
    even = np.linalg.norm(np.diff(way, axis=0), axis=-1, keepdims=True) < TOLERANCE * length[1:]
    return np.where(even, force[1:], 0.0)


SD_RANGE: Final = (5.0, 800.0)
"""Bounds of the standard deviation, newtons; the upper one is practically uniform."""

FARTHEST: Final = 6.0
"""Scaled features are cut here, so that a scene unlike those of the training stays harmless."""


class StrengthNetwork:
    """The paper's network: two hidden layers of 64 units (Appendix 4B), an estimator.

    For each window it gives the mean and standard deviation of a normal distribution, truncated to
    the range of strengths. SIMPLE proposes strengths from it. If a window shows nothing, the
    standard deviation is large and the distribution close to uniform.

    Args:
        weights: arrays by name: ``centre`` and ``scale`` of the features, then ``weight_N`` and
            ``bias_N`` of the layers, N from 1 to 3.
    """

    def __init__(self, weights: Mapping[str, NDArray[Any]]) -> None:
        self.weights = {name: array.astype(np.float64) for name, array in weights.items()}

    def outputs(self, features: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """Return (mean, standard deviation), newtons, for features (..., feature)."""
        w = self.weights
        x = np.clip((features - w["centre"]) / w["scale"], -FARTHEST, FARTHEST)
        x = np.maximum(x @ w["weight_1"] + w["bias_1"], 0.0)
        x = np.maximum(x @ w["weight_2"] + w["bias_2"], 0.0)
        x = x @ w["weight_3"] + w["bias_3"]
        share = 0.5 * (1 + np.tanh(x / 2))
        (low, high), (least, most) = STRENGTH_RANGE, np.log(SD_RANGE)
        mean = low + (high - low) * share[..., 0]
        return mean, np.exp(least + (most - least) * share[..., 1])

    def __call__(
        self, scene: Scene, observation: Observation, windows: NDArray[np.int64]
    ) -> StrengthEstimates:
        """Return the estimates of each window; see :data:`Estimator`."""
        features = window_features(observation.trajectory, scene.radius, windows)
        return StrengthEstimates(*self.outputs(features))


@functools.cache
def shipped_network() -> StrengthNetwork:
    """Return the package's own network; ``strength_weights.json`` records how it was trained."""
    file = resources.files(__package__) / "strength_weights.npz"
    with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
        return StrengthNetwork(stored)


def network_strengths(
    scene: Scene, observation: Observation, windows: NDArray[np.int64]
) -> StrengthEstimates:
    """Return the estimates of the package's own network; see :data:`Estimator`.

    It was trained on agents that keep their velocities; for others the analytic rule is used.
    """
    if scene.resets_velocity:
        return analytic_strengths(scene, observation, windows)
    return shipped_network()(scene, observation, windows)


ESTIMATORS: Final[Mapping[str, Estimator]] = MappingProxyType(
    {"analytic": analytic_strengths, "network": network_strengths}
)
"""By name: the analytic rule, and the paper's network."""
