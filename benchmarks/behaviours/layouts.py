"""The layouts and starting places of the original generator that the scenes use."""

from __future__ import annotations

from typing import Final

import numpy as np

from phase_ppl.world.rooms import RAY_DIRECTIONS
from phase_ppl.world.scene import Scene

WALLS: Final[dict[int | str, tuple[float, float, float, float]]] = {
    0: (0, 0, 0, 0),
    6: (10, 0, 5, 0),
    7: (10, 5, 5, 0),
    8: (10, 7.5, 5, 0),
    12: (10, 0, 7.5, 0),
    13: (10, 5, 7.5, 0),
    14: (10, 7.5, 7.5, 0),
    16: (10, 5, 5, 5),
    "near room": (10, 5, 0, 7.5),
}
"""Lengths of the walls up, left, down, right of the layouts E 0, E 6, ..., and of one of ours."""

SMALL, MIDDLE, LARGE = 0.8, 1.2, 1.6
CENTRE: Final = np.array([16.0, 12.0])

Place = tuple[float, float]


def scene(
    layout: int | str,
    red: Place,
    green: Place,
    blue: Place,
    pink: Place,
    rng: np.random.Generator,
    radius: tuple[float, float, float, float] = (SMALL,) * 4,
    headings: tuple[float, float] | None = None,
) -> Scene:
    """Return a scene whose agents look anywhere, unless told where."""
    angles = rng.uniform(-np.pi, np.pi, 2) if headings is None else headings
    walls = [
        [CENTRE, CENTRE + length * direction]
        for length, direction in zip(WALLS[layout], RAY_DIRECTIONS, strict=True)
        if length > 0
    ]
    start = [(*red, angles[0]), (*green, angles[1]), (*blue, 0.0), (*pink, 0.0)]
    return Scene(
        start=np.array(start), radius=np.array(radius), walls=np.array(walls).reshape(-1, 2, 2)
    )
