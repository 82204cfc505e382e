"""The full physical state of the world at one moment."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.names import AGENTS, ENTITIES, NOTHING
from phase_ppl.world.scene import Scene


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """Poses, velocities and holds of all entities.

    Attributes:
        pose: (4, 3) x, y of the body origin [units], angle [rad].
        velocity: (4, 2) velocity of the centre of mass, units per simulated second.
        spin: (4,) angular velocity, rad per simulated second.
        held: (2,) entity index of the item each agent holds, or ``NOTHING``.
        weld: (2, 3) while an agent holds an item: where the item's centre is kept in the
            agent's frame about its centre of mass [units], and the kept relative angle [rad].
    """

    pose: NDArray[np.float64]
    velocity: NDArray[np.float64]
    spin: NDArray[np.float64]
    held: NDArray[np.int64]
    weld: NDArray[np.float64]

    @classmethod
    def at_start(cls, scene: Scene) -> State:
        """Return the start state of ``scene``: at rest, holding nothing."""
        n, n_agents = len(ENTITIES), len(AGENTS)
        return cls(
            pose=scene.start.copy(),
            velocity=np.zeros((n, 2)),
            spin=np.zeros(n),
            held=np.full(n_agents, NOTHING, np.int64),
            weld=np.zeros((n_agents, 3)),
        )
