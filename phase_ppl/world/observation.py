"""The full state of the world, and what an observer sees of it: the trajectories."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.names import NOTHING
from phase_ppl.world.scene import Scene, finite_array


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """Poses, velocities and holds of all entities."""

    pose: NDArray[np.float64]  # (entity, 3) x, y of the body origin [units], angle [rad]
    # (entity, 2) velocity of the centre of mass, units per simulated second
    velocity: NDArray[np.float64]
    spin: NDArray[np.float64]  # (entity,) angular velocity, rad per simulated second
    held: NDArray[np.int64]  # (agent,) entity index of the item each agent holds, or ``NOTHING``
    # (agent, 3) while an agent holds an item: where the item's centre is kept in the agent's frame
    # about its centre of mass [units], and the kept relative angle [rad]
    weld: NDArray[np.float64]

    @classmethod
    def at_start(cls, scene: Scene) -> State:
        """Return the start state of ``scene``: at rest, holding nothing."""
        n, n_agents = len(scene.world.entities), len(scene.world.agents)
        return cls(
            pose=scene.start.copy(),
            velocity=np.zeros((n, 2)),
            spin=np.zeros(n),
            held=np.full(n_agents, NOTHING, np.int64),
            weld=np.zeros((n_agents, 3)),
        )


# --- what an observer sees: the entities' trajectories, and nothing else --------------------------

FRAMES_PER_SECOND: Final = 12.0  # frames per second of simulated time

SHOWN_SECONDS_PER_FRAME: Final = 0.25
"""Playback time of one frame: three times slower than simulated time."""

MIN_FRAMES: Final = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """Observed trajectories of all entities of a world.

    Attributes:
        trajectory: (time, entity, coord) with coord = x, y [units], angle [rad, unwrapped];
            frame 0 is the start, frame k the mean over the five substeps of planner step k.

    Raises:
        InvalidEventError: fewer than 2 frames, a wrong shape, or a value that is not finite.
    """

    trajectory: NDArray[np.float64]

    if TYPE_CHECKING:  # what it can be made of

        def __init__(self, trajectory: ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        trajectory = finite_array("trajectory", self.trajectory, (None, None, 3))
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
