"""What an estimator of strengths is, and how good its estimates are."""

from __future__ import annotations

import functools
import io
import math
import zipfile
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from phase_ppl.inference.proposals.strength_features import N_FEATURES, window_features
from phase_ppl.physics.constants import FLOOR_FRICTION, STEP, SUBSTEP, SUBSTEPS, mass
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name
from phase_ppl.world.hypothesis import STRENGTH_LEVELS, STRENGTH_RANGE
from phase_ppl.world.identity import qualified_name
from phase_ppl.world.names import AGENTS
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

_GRID = np.linspace(*STRENGTH_RANGE, 901)


class StrengthEstimates(NamedTuple):
    """Normal distributions of the agents' strengths, to be cut to the range of strengths."""

    # (window, agent) newtons; NaN where there is no estimate, which means the prior
    mean: FloatArray
    sd: FloatArray  # (window, agent) newtons; NaN where ``mean`` is


class Estimator(Protocol):
    """Estimates both agents' strengths from windows of what was observed.

    ``windows`` is (window, 2), the first and the last frame of each; they differ by 1 or more.
    """

    def __call__(
        self, scene: Scene, observation: Observation, windows: NDArray[np.int64], /
    ) -> StrengthEstimates: ...


class Quality(NamedTuple):
    """How good estimates are, as proposals from normal distributions cut to the range."""

    share: float  # of estimates among all
    rmse: float  # of the proposals' mean, newtons; of the prior's mean where there is no estimate
    # mean log density of the true strength; without an estimate that of the uniform prior, -6.11
    log_density: float
    log_mixture: float  # the same, of a mixture with a tenth of the prior, as in SIMPLE's proposal
    # share of the estimates that are no farther off than their standard deviation; nan without any
    coverage: float


def quality(estimates: StrengthEstimates, strength: FloatArray) -> Quality:
    """Return how good estimates are, given the true strengths (of the same shape), newtons."""
    known = ~np.isnan(estimates.mean).ravel()
    mean = np.where(known, estimates.mean.ravel(), 0.0)[:, None]
    sd = np.where(known, estimates.sd.ravel(), math.inf)[:, None]  # cut, that is uniform
    truth = strength.ravel()[:, None]
    density = np.exp(-0.5 * ((_GRID - mean) / sd) ** 2)
    mass = np.trapezoid(density, _GRID, axis=1)
    middle = np.trapezoid(density * _GRID, _GRID, axis=1) / mass
    log_density = -0.5 * ((truth - mean) / sd)[:, 0] ** 2 - np.log(mass)
    log_prior = -math.log(STRENGTH_RANGE[1] - STRENGTH_RANGE[0])
    mixture = np.logaddexp(log_density + math.log(0.9), log_prior + math.log(0.1))
    inside = (np.abs(truth - mean) <= sd)[known]
    return Quality(
        share=float(known.mean()),
        rmse=float(np.sqrt(((middle - truth[:, 0]) ** 2).mean())),
        log_density=float(log_density.mean()),
        log_mixture=float(mixture.mean()),
        coverage=float(inside.mean()) if known.any() else math.nan,
    )


TOLERANCE: Final = 0.01  # relative deviation from a level that still counts as a hit

MAX_OFF_HEADING: Final = 0.05
"""Angle between the driving force and the agent's heading that still counts as forward, rad."""

MIN_SPEED: Final = 0.3  # below this the direction of the friction is uncertain, units per second

VALIDATION_SD: Final = 40.0
"""Root mean square error of the rule on the 50 development videos, newtons: 39 on whole videos
(59 of 100 agents give one; 58 are right, one is two levels off), 35 on windows of 10 steps."""


def analytic_strengths(
    scene: Scene, observation: Observation, windows: NDArray[np.int64]
) -> StrengthEstimates:
    """Return the level that each window gives away by the analytic rule; none without free driving.

    A free agent that drives forward accelerates by (F - 100 N) / m against the floor friction, so
    m a + 100 is its strength F, and in the original world that is one of four levels. Three frames
    in a row that hit a level nearly exactly give the strength away; an agent that is slowed by
    something only seems weaker, so the largest hit counts. Frames are means over five substeps:
    second differences of such means are those of the motion itself as long as the acceleration is
    constant over all three frames.

    Where agents stand still after each step, two frames in a row tell: driving from rest moves an
    agent by (F - 100 N) / m times the sum over the substeps of the time that is left.

    Arguments as for :class:`~phase_ppl.inference.proposals.strength.Estimator`.
    """
    hits = _driving_hits(observation.trajectory, scene.radius, scene.resets_velocity)
    inside = [hits[first : max(last - 1, first)] for first, last in windows]
    largest = np.array([found.max(axis=0, initial=0.0) for found in inside])
    mean = np.where(largest > 0, largest, np.nan)
    return StrengthEstimates(mean, np.where(largest > 0, VALIDATION_SD, np.nan))


_FROM_REST: Final = SUBSTEP**2 * SUBSTEPS * (SUBSTEPS + 1) / 2
"""Way in a step from rest per acceleration, s^2."""


def _driving_hits(trajectory: FloatArray, radius: FloatArray, resets: bool) -> FloatArray:
    """Return (time - 2, agent) the level that frames k, k + 1, k + 2 give away; 0 where none."""
    levels = np.array(STRENGTH_LEVELS)
    driving_force = _force_from_rest if resets else _driving_force
    hits = np.zeros((max(len(trajectory) - 2, 0), len(AGENTS)))
    for agent in range(len(AGENTS)):
        force, heading = driving_force(trajectory[:, agent], mass(agent, float(radius[agent])))
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


def _force_from_rest(track: FloatArray, agent_mass: float) -> tuple[FloatArray, FloatArray]:
    """As :func:`_driving_force`, for agents that stand still after each step."""
    way = np.diff(track[:, :2], axis=0)
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    moves = length > 0
    direction = np.where(moves, way / np.where(moves, length, 1.0), 0.0)
    force = direction * (FLOOR_FRICTION + agent_mass * length / _FROM_REST)
    # a frame lies within its step: only evenly driven steps show what a step does
    even = np.linalg.norm(np.diff(way, axis=0), axis=-1, keepdims=True) < TOLERANCE * length[1:]
    angle = track[1:-1, 2]
    heading = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    return np.where(even, force[1:], 0.0), heading


HIDDEN: Final = 64  # units of each of the two hidden layers, as in the paper

SHAPES: Final[dict[str, tuple[int, ...]]] = {
    "centre": (N_FEATURES,),
    "scale": (N_FEATURES,),
    "weight_1": (N_FEATURES, HIDDEN),
    "bias_1": (HIDDEN,),
    "weight_2": (HIDDEN, HIDDEN),
    "bias_2": (HIDDEN,),
    "weight_3": (HIDDEN, 2),
    "bias_3": (2,),
}
"""The arrays of a file of weights; features are centred and scaled first."""

SD_RANGE: Final = (5.0, 800.0)
"""Bounds of the standard deviation, newtons. The upper one is as good as uniform."""

FARTHEST: Final = 6.0
"""Scaled features are cut here, so that a scene unlike those of the training stays harmless."""


class StrengthNetwork:
    """The paper's network: two hidden layers of 64 units (Appendix 4B), an estimator.

    It says how strong an agent seems by a window, and how sure that is: the mean and the standard
    deviation of a normal distribution that is cut to the range of strengths, which is what SIMPLE
    proposes from. Where a window shows nothing the standard deviation is large and the
    distribution close to uniform. ``SimpleSettings(strength=...)`` takes one of one's own.

    Args:
        weights: arrays by name, see :data:`SHAPES`.

    Raises:
        InvalidSettingError: an array is missing, has another shape or is not finite.
    """

    def __init__(self, weights: dict[str, NDArray[Any]]) -> None:
        for name, shape in SHAPES.items():
            if name not in weights:
                raise InvalidSettingError(f"the array {name} is missing")
            array = weights[name]
            if array.shape != shape:
                raise InvalidSettingError(f"{name} has shape {array.shape}, expected {shape}")
            if array.dtype.kind != "f" or not np.isfinite(array).all():
                raise InvalidSettingError(f"{name} holds something else than finite numbers")
        if not (weights["scale"] > 0).all():
            raise InvalidSettingError("scale holds a number that is not positive")
        self._weights = {name: weights[name].astype(np.float64) for name in SHAPES}

    @classmethod
    def load(cls, file: str | Path) -> StrengthNetwork:
        """Return the network with the weights of an npz file."""
        try:
            # from memory: NumPy leaves a damaged file open
            with np.load(io.BytesIO(Path(file).read_bytes()), allow_pickle=False) as kept:
                return cls({name: kept[name] for name in kept.files})
        except (OSError, EOFError, ValueError, AttributeError, zipfile.BadZipFile) as error:
            raise InvalidSettingError(
                f"{file} holds no weights of a strength network: {error}"
            ) from error

    def save(self, file: str | Path) -> None:
        """Write the weights to an npz file, in single precision."""
        single = {name: array.astype(np.float32) for name, array in self._weights.items()}
        np.savez_compressed(file, allow_pickle=False, **single)

    def outputs(self, features: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """Return (mean, standard deviation), newtons, for features (..., feature)."""
        w = self._weights
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
        """Return what each window says; see :class:`Estimator`."""
        features = window_features(observation.trajectory, scene.radius, windows)
        return StrengthEstimates(*self.outputs(features))


@functools.cache
def shipped_network() -> StrengthNetwork:
    """Return the package's own network; ``strength_weights.json`` says how it was made."""
    file = resources.files(__package__) / "strength_weights.npz"
    with resources.as_file(file) as path:
        return StrengthNetwork.load(path)


def network_strengths(
    scene: Scene, observation: Observation, windows: NDArray[np.int64]
) -> StrengthEstimates:
    """Return what the network that comes with the package says; see :class:`Estimator`.

    It knows agents that keep their velocities: of others it says what the analytic rule does.
    """
    if scene.resets_velocity:
        return analytic_strengths(scene, observation, windows)
    return shipped_network()(scene, observation, windows)


ESTIMATORS: Final[Mapping[str, Estimator]] = MappingProxyType(
    {"analytic": analytic_strengths, "network": network_strengths}
)
"""By name: the analytic rule, and the paper's network."""

DEFAULT_ESTIMATOR: Final = "network"


def strength_estimator(strength: str | Estimator) -> Estimator:
    """Return the estimator of that name, or ``strength`` itself if it is one."""
    if isinstance(strength, str):
        if strength not in ESTIMATORS:
            raise unknown_name("estimator of strengths", strength, ESTIMATORS)
        return ESTIMATORS[strength]
    if not callable(strength):
        raise InvalidSettingError(
            f"strength={shown(strength)}, expected the name of an estimator or a function"
        )
    return strength


def estimated_strengths(
    strength: str | Estimator, scene: Scene, observation: Observation, windows: NDArray[np.int64]
) -> StrengthEstimates:
    """Return what an estimator says of each window."""
    found = strength_estimator(strength)(scene, observation, windows)
    mean, sd = (np.asarray(part, float) for part in found)
    wanted = (len(windows), len(AGENTS))
    if mean.shape != wanted or sd.shape != wanted:
        raise InvalidSettingError(
            f"the estimator of strengths {estimator_name(strength)} returned shapes {mean.shape} "
            f"and {sd.shape}, expected {wanted} twice: mean and standard deviation"
        )
    known = ~np.isnan(mean)
    good = known & np.isfinite(mean) & np.isfinite(sd) & (sd > 0)
    if (known & ~good).any():
        window, agent = np.argwhere(known & ~good)[0]
        raise InvalidSettingError(
            f"the estimator of strengths {estimator_name(strength)} returned mean "
            f"{mean[window, agent]:g} and standard deviation {sd[window, agent]:g}, expected "
            "finite numbers, the second above 0; or nan for no estimate"
        )
    return StrengthEstimates(mean, np.where(known, sd, np.nan))


def estimator_name(strength: str | Estimator) -> str:
    """Return a name for the settings that a run records."""
    return strength if isinstance(strength, str) else qualified_name(strength)
