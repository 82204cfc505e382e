"""What a person sees of a video: surface cues, without any inference about goals, and noise."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from phase_ppl.dataset.motion import items_held, moves_to_the_end
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import nonnegative_number, whole_number
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Observation
from phase_ppl.world.names import AGENTS, NOTHING
from phase_ppl.world.scene import Scene

CUES: Final = ("distance", "contact", "working", "impact", "holding", "unsettled", "synchrony")
"""Names of the cues, in order; :func:`surface_cues` says what each is."""

REACH: Final = 1.5  # half the width of an agent's broad side, in its radii
_NEAR: Final = 5.0  # units, half the width of a room: what distance and impact are measured in

_SIDE: Final = 1.2
"""Mean distance of an agent's outline from its centre, in its radii, a little generous."""

_AT: Final = 0.4  # units within which of an item an agent is at it
_MOVES: Final = 0.05  # units per frame from which on a body counts as moving


def surface_cues(scene: Scene, observation: Observation) -> dict[str, float]:
    """Return the cues of one video, each of a size of about 1.

    ``distance``: log of the mean distance between the agents' centres over 5 units; ``contact``:
    share of frames in which their broad sides could touch; ``working``: share of frames in which
    an agent is at an item that moves, the geometric mean of both, of the item for which it is
    larger; ``holding``: 1 where both hold the same
    item at some time; ``unsettled``: 1 where something still moves at the end; ``impact``: by how
    much they close in, within three frames, as contact begins, at most, over 5 units;
    ``synchrony``: mean cosine between their motions, 0 in frames in which one rests.
    """
    trajectory, radius = observation.trajectory, np.asarray(scene.radius)
    red, green = trajectory[:, 0, :2], trajectory[:, 1, :2]
    apart = np.linalg.norm(red - green, axis=1)
    touch = apart < REACH * (radius[0] + radius[1])
    held = items_held(trajectory, radius)
    steps = np.diff(trajectory[:, :2, :2], axis=0)
    speeds = np.linalg.norm(steps, axis=2)
    moving = (speeds > _MOVES).all(axis=1)
    cosine = steps.prod(axis=1).sum(axis=1) / np.maximum(speeds.prod(axis=1), _MOVES**2)
    items = trajectory[:, None, len(AGENTS) :, :2]
    rims = _SIDE * radius[: len(AGENTS), None] + radius[len(AGENTS) :]
    at = np.linalg.norm(trajectory[:, : len(AGENTS), None, :2] - items, axis=-1) < rims + _AT
    shifted = np.linalg.norm(np.diff(items[:, 0], axis=0), axis=-1) > _MOVES
    handled = (at[1:] & shifted[:, None]).mean(axis=0)  # agent, item
    begins = np.flatnonzero(touch[1:] & ~touch[:-1])
    return {
        "distance": float(np.log(max(apart.mean(), 1e-3) / _NEAR)),
        "contact": float(touch.mean()),
        "working": float(np.sqrt(handled.prod(axis=0)).max()),
        "impact": float(max((apart[max(i - 2, 0)] - apart[i + 1] for i in begins), default=0.0))
        / _NEAR,
        "holding": float(((held[:, 0] != NOTHING) & (held[:, 0] == held[:, 1])).any()),
        "unsettled": float(moves_to_the_end(trajectory)),
        "synchrony": float(np.where(moving, cosine, 0.0).mean()),
    }


# --- noisy perception -----------------------------------------------------------------------------


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
