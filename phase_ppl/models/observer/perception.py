"""Noisy perception: a video as somebody sees it who misses frames and misjudges positions."""

from __future__ import annotations

import dataclasses

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import nonnegative_number, whole_number
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene


@dataclasses.dataclass(frozen=True)
class Perception:
    """Several noisy readings of a video, over which an observer's answers are averaged.

    Attributes:
        noise: standard deviation of each position, units.
        missed: probability that a frame is not seen; what was in between is filled in evenly.
        percepts: number of readings.

    Raises:
        InvalidSettingError: a value that cannot be used.
    """

    noise: float = 0.1
    missed: float = 0.0
    percepts: int = 4

    def __post_init__(self) -> None:
        for name in ("noise", "missed"):
            nonnegative_number(name, getattr(self, name))
        if self.missed >= 1:
            raise InvalidSettingError(f"missed={self.missed!r}, expected a number in [0, 1)")
        whole_number("percepts", self.percepts)

    def readings(self, scene: Scene, observation: Observation, seed: int) -> list[Observation]:
        """Return ``percepts`` readings; the same seed gives the same ones."""
        rng = np.random.default_rng(seed)
        return [self._reading(scene, observation.trajectory, rng) for _ in range(self.percepts)]

    def _reading(
        self, scene: Scene, trajectory: FloatArray, rng: np.random.Generator
    ) -> Observation:
        seen = rng.random(len(trajectory)) >= self.missed
        seen[[0, -1]] = True
        low, high = np.reshape(scene.arena, (2, 2)).T
        flat = np.array(trajectory).reshape(len(trajectory), -1)
        when = np.arange(len(flat))
        filled = np.stack([np.interp(when, when[seen], column[seen]) for column in flat.T], axis=1)
        found = filled.reshape(trajectory.shape)
        noise = rng.normal(0.0, self.noise, found[1:, :, :2].shape) * seen[1:, None, None]
        found[1:, :, :2] = np.clip(found[1:, :, :2] + noise, low, high)
        return Observation(found)
