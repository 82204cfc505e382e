"""Windows of simulated events, blurred and cut, that the network learns from."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from phase_ppl.inference.proposals.strength.features import window_features
from phase_ppl.inference.proposals.strength.scenes import Simulated
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.names import AGENTS

LARGEST_JITTER: Final = 0.35
"""Of the positions in the training, units."""

ANGLE_SHARE: Final = 0.2
"""Jitter of the angles, rad, for a unit of that of the positions: an agent of size 1 whose rim
is seen with that precision at some ten points. In the training it is up to twice that."""

WINDOWS_PER_CUT: Final = 5

VALIDATION_JITTER: Final = (0.0, 0.05, 0.1, 0.3)
VALIDATION_LENGTHS: Final = (1, 2, 5, 10, 20, 0)
"""Steps of the windows; 0 stands for the whole event."""


class Examples(NamedTuple):
    """One window and one agent each.

    Attributes:
        features: (example, feature).
        strength: (example,) newtons.
        jitter: (example,) of the positions, units.
        length: (example,) steps of the window; 0 where it is the whole event.
    """

    features: NDArray[np.float32]
    strength: NDArray[np.float32]
    jitter: FloatArray
    length: NDArray[np.int64]


def blurred(
    trajectory: FloatArray, jitter: float, rng: np.random.Generator, angle: float = ANGLE_SHARE
) -> FloatArray:
    """Return a trajectory (time, entity, coord) with independent normal noise on all coordinates.

    Args:
        trajectory: (time, entity, coord) x, y [units], angle [rad].
        jitter: standard deviation of x and y, units.
        rng: of the noise.
        angle: standard deviation of the angles, rad, for a unit of jitter.
    """
    return trajectory + rng.normal(0, 1, trajectory.shape) * [jitter, jitter, jitter * angle]


def training_examples(events: Simulated, rounds: int, seed: int) -> Examples:
    """Return examples of each event, blurred and cut anew in each round.

    A third of the rounds is without jitter, half of the events are cut short before their jitter
    is estimated, and windows are short ones, those of SIMPLE's length and all of a cut.
    """
    parts = []
    for round_, index in tqdm(
        np.ndindex(rounds, len(events.strength)),
        desc="examples",
        total=rounds * len(events.strength),
        disable=None,
    ):
        rng = np.random.default_rng([seed, 1, round_, index])
        trajectory = events.trajectory[index].astype(np.float64)
        if rng.random() < 0.5:
            length = int(np.exp(rng.uniform(np.log(2), np.log(len(trajectory)))))
            first = int(rng.integers(len(trajectory) - length + 1))
            trajectory = trajectory[first : first + length]
        jitter = _drawn_jitter(rng)
        trajectory = blurred(trajectory, jitter, rng, 2 * ANGLE_SHARE * rng.random())
        windows = _drawn_windows(len(trajectory), rng)
        parts.append(_of_windows(events, index, trajectory, windows, jitter))
    return _together(parts)


def validation_examples(events: Simulated, seed: int) -> Examples:
    """Return one window of each length, with each jitter, of each event."""
    parts = []
    for index in range(len(events.strength)):
        for jitter in VALIDATION_JITTER:
            rng = np.random.default_rng([seed, 2, index])
            trajectory = blurred(events.trajectory[index].astype(np.float64), jitter, rng)
            last = len(trajectory) - 1
            windows = []
            for length in VALIDATION_LENGTHS:
                steps = length or last
                first = int(rng.integers(max(last - steps, 0) + 1))
                windows.append((first, min(first + steps, last)))
            found = _of_windows(events, index, trajectory, np.array(windows), jitter)
            lengths = np.repeat(VALIDATION_LENGTHS, len(AGENTS))
            parts.append(found._replace(length=lengths))
    return _together(parts)


def _drawn_jitter(rng: np.random.Generator) -> float:
    kind = rng.integers(3)
    if kind == 0:
        return 0.0
    if kind == 1:
        return float(np.exp(rng.uniform(np.log(0.003), np.log(LARGEST_JITTER))))
    return float(rng.uniform(0.0, LARGEST_JITTER))


def _drawn_windows(n_frames: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return windows (window, 2): the whole, some of ten steps, some of any length."""
    windows = [(0, n_frames - 1)]
    for number in range(WINDOWS_PER_CUT):
        steps = 10 if number % 2 == 0 else int(np.exp(rng.uniform(0, np.log(n_frames))))
        steps = min(steps, n_frames - 1)
        first = int(rng.integers(n_frames - steps))
        windows.append((first, first + steps))
    return np.unique(windows, axis=0)


def _of_windows(
    events: Simulated,
    index: int,
    trajectory: FloatArray,
    windows: NDArray[np.int64],
    jitter: float,
) -> Examples:
    features = window_features(trajectory, events.radius[index], windows)
    n = len(windows) * len(AGENTS)
    return Examples(
        features.reshape(n, -1),
        np.tile(events.strength[index], len(windows)).astype(np.float32),
        np.full(n, jitter),
        np.repeat(windows[:, 1] - windows[:, 0], len(AGENTS)),
    )


def _together(parts: list[Examples]) -> Examples:
    return Examples(*(np.concatenate(column) for column in zip(*parts, strict=True)))
