"""Small scenes and events that the tests of several folders use."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.world.errors import PhasePPLError
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.scene import Scene

DEV = Path(__file__).parents[2].parent / "shared" / "phase-test" / "dev.json"

needs_dev = pytest.mark.skipif(
    not DEV.is_file(), reason="the PHASE test videos (../shared/phase-test/dev.json) are not here"
)

CENTRE = (16.0, 12.0)
DIRECTIONS = {"up": (0, 1), "left": (-1, 0), "down": (0, -1), "right": (1, 0)}
START = [[8.0, 20.0, 0.0], [24.0, 14.0, 1.0], [12.0, 8.0, 0.0], [20.0, 8.0, 0.0]]
RADIUS = [0.8, 1.2, 1.01, 1.6]


def check_refused(
    make: Callable[[], object], message: str, error: type[Exception] = PhasePPLError
) -> None:
    with pytest.raises(error, match=re.escape(message)) as raised:
        make()
    assert "\n" not in str(raised.value)


def walls(**length: float) -> NDArray[np.float64]:
    """Return wall segments from the centre, such as ``walls(up=10, left=5)``."""
    ends = [
        [CENTRE, (CENTRE[0] + r * DIRECTIONS[d][0], CENTRE[1] + r * DIRECTIONS[d][1])]
        for d, r in length.items()
    ]
    return np.array(ends, float).reshape(-1, 2, 2)


def make_scene(**changes: object) -> Scene:
    fields: dict[str, object] = {"start": START, "radius": RADIUS, "walls": walls(up=10, left=7.5)}
    return Scene(**{**fields, **changes})  # type: ignore[arg-type]


def make_trajectory(n_frames: int = 4) -> NDArray[np.float64]:
    """Return a trajectory in which everybody drifts a little and the red agent turns."""
    steps = np.arange(n_frames)[:, None, None] * np.array([0.1, -0.05, 0.0])
    trajectory = np.array(START) + steps
    trajectory[:, 0, 2] += 0.3 * np.arange(n_frames)
    return trajectory


def make_event(n_frames: int = 4, id: str = "example") -> Event:
    return Event(
        scene=make_scene(),
        observation=Observation(make_trajectory(n_frames)),
        id=id,
        truth=Truth("Get blue item to red lm", "Get blue item to green lm", strength_red=300.0),
        judgments={"relation_counts": {"friendly": 3, "neutral": 0, "adversarial": 7}},
        predictions={"someone": {"relation": "adversarial", "probabilities": [0.1, 0.2, 0.7]}},
    )
