"""What an observer sees: the entities' trajectories, and nothing else."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.names import ENTITIES
from phase_ppl.world.scene import finite_array

FRAMES_PER_SECOND: Final = 12.0
"""Frames per second of simulated time."""

SHOWN_SECONDS_PER_FRAME: Final = 0.25
"""Playback time of one frame: three times slower than simulated time."""

MIN_FRAMES: Final = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """Observed trajectories of all four entities.

    Attributes:
        trajectory: (time, entity, coord) with coord = x, y [units], angle [rad, unwrapped];
            frame 0 is the start, frame k the mean over the five substeps of planner step k.

    Raises:
        InvalidEventError: fewer than 2 frames, a wrong shape, or a value that is not finite.
    """

    trajectory: NDArray[np.float64]

    def __post_init__(self) -> None:
        trajectory = finite_array("trajectory", self.trajectory, (None, len(ENTITIES), 3))
        if len(trajectory) < MIN_FRAMES:
            raise InvalidEventError(
                f"trajectory has {len(trajectory)} frame(s), expected at least {MIN_FRAMES}"
            )
        object.__setattr__(self, "trajectory", trajectory)

    @property
    def n_frames(self) -> int:
        return len(self.trajectory)

    @property
    def positions(self) -> NDArray[np.float64]:
        """(time, entity, 2): x, y, units."""
        return self.trajectory[..., :2]

    @property
    def angles(self) -> NDArray[np.float64]:
        """(time, entity): radians."""
        return self.trajectory[..., 2]
