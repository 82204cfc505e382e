"""Compiling all that reading a video needs, before there is one."""

from __future__ import annotations

import numpy as np

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.closed_loop.hidden_state import Tracking
from phase_ppl.closed_loop.reader import Conduct, Reader
from phase_ppl.world.scene import Scene


def warm_up() -> None:
    """Compile the kernels, or load them from the cache on disk."""
    spots = [[8.0, 20.0, 0.0], [24.0, 20.0, 0.0], [24.0, 4.0, 0.0], [8.0, 4.0, 0.0]]
    scene = Scene(start=np.array(spots), radius=np.full(4, 0.8))
    conduct = Conduct(1.0, 1.0, 0.5, 0.5)
    with Reader(scene, PlannerConfig(simulations=2), Tracking(states=1), conduct) as reader:
        for _ in range(2):
            reader.read(scene.start)
