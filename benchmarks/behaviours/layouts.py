"""Layouts and start positions of the original generator that the scenes use."""

from __future__ import annotations

from typing import Final

import numpy as np

from phase_ppl.data.generation.situation import LAYOUTS, walls_of_lengths
from phase_ppl.world.scene import Scene

WALLS: Final[dict[int | str, tuple[float, float, float, float]]] = {
    **dict(LAYOUTS.items()),
    "near room": (10, 5, 0, 7.5),
}
"""Lengths of the walls up, left, down, right of the original layouts, and of one of ours."""

SMALL, MIDDLE, LARGE = 0.8, 1.2, 1.6

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
    """Return a scene; agents look anywhere, or along ``headings``."""
    angles = rng.uniform(-np.pi, np.pi, 2) if headings is None else headings
    start = [(*red, angles[0]), (*green, angles[1]), (*blue, 0.0), (*pink, 0.0)]
    walls = walls_of_lengths(WALLS[layout])
    return Scene(start=np.array(start), radius=np.array(radius), walls=walls)
