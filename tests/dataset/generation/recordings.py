"""Recordings made by hand, without a simulator."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phase_ppl.dataset.generation.copies import Recording
from phase_ppl.dataset.generation.situation import walls_of
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import NOTHING
from phase_ppl.world.scene import Scene

RED_TO_BLUE = "Get red agent to blue lm"
GREEN_TO_RED = "Get green agent to red lm"

START = np.array([[8.0, 10.0, 0.5], [24.0, 14.0, -0.7], [14.0, 20.0, 0.0], [18.0, 4.0, 0.0]])


def recording(
    trajectory: NDArray[np.float64] | None = None,
    red: str = RED_TO_BLUE,
    green: str = GREEN_TO_RED,
    alpha: tuple[int, int] = (0, 0),
    actions: NDArray[np.int64] | None = None,
    layout: int = 8,
) -> Recording:
    """Return a recording; by default red walks straight up to the blue landmark."""
    if trajectory is None:
        trajectory = np.repeat(START[None], 21, axis=0)
        trajectory[:, 0, 1] += np.linspace(0, 10, 21)
    frames = len(trajectory)
    scene = Scene(trajectory[0], np.array([0.8, 1.2, 0.8, 1.01]), walls_of(layout), "ccw")
    if actions is None:
        actions = np.full((frames, 2), 2, np.int64)
    return Recording(
        scene,
        Hypothesis(red, green, alpha, 150.0, 450.0),  # type: ignore[arg-type]
        layout,
        trajectory,
        actions,
        np.full((frames, 2), NOTHING, np.int64),
    )
