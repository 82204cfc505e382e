"""The original world's tables: layouts of walls, sizes, strengths, places to start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.rooms import RAY_DIRECTIONS
from phase_ppl.world.scene import ARENA

LAYOUTS: Final[Mapping[int, tuple[float, float, float, float]]] = {
    0: (0, 0, 0, 0), 2: (10, 5, 0, 0), 4: (10, 7.5, 0, 0), 6: (10, 0, 5, 0), 7: (10, 5, 5, 0),
    8: (10, 7.5, 5, 0), 9: (5, 10, 5, 0), 10: (7.5, 10, 5, 0), 12: (10, 0, 7.5, 0),
    13: (10, 5, 7.5, 0), 14: (10, 7.5, 7.5, 0), 15: (7.5, 10, 7.5, 0), 16: (10, 5, 5, 5),
    17: (10, 7.5, 5, 5), 18: (10, 5, 7.5, 5), 19: (10, 7.5, 7.5, 5), 20: (7.5, 10, 7.5, 5),
    21: (10, 7.5, 7.5, 7.5),
}  # fmt: skip
"""Layout -> lengths of the walls up, left, down and right of the centre, units. Numbers as in
the original files; those that are missing were never used."""

LAYOUTS_OF_A_KIND: Final = ((4, 8, 17), (12, 13, 18), (14, 19), (15, 20))
"""Layouts in which the same doors are narrow: a situation of one can be planned in another."""

SIZES: Final = (0.8, 1.2, 1.6, 1.01)
"""Sizes R by the original ids, units."""

SPOTS: Final[tuple[tuple[tuple[float, float], ...], ...]] = (
    ((8, 20), (8, 14), (14, 16), (14, 20)),
    ((24, 20), (24, 14), (18, 16), (18, 20)),
    ((24, 10), (24, 4), (18, 8), (18, 4)),
    ((8, 10), (8, 4), (14, 8), (14, 4)),
)
"""Room -> places where entities start, units."""

NARROW: Final = 2.5
"""Width of the narrowest doors, units: only agents of the smallest size drive through them."""


def walls_of(layout: int) -> NDArray[np.float64]:
    """Return the (n, 2, 2) inner walls of a layout, units."""
    return walls_of_lengths(LAYOUTS[layout])


def walls_of_lengths(lengths: Sequence[float]) -> NDArray[np.float64]:
    """Return the (n, 2, 2) inner walls of lengths up, left, down and right of the centre, units."""
    x0, x1, y0, y1 = ARENA
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    walls = [
        np.stack([centre, centre + length * ray])
        for length, ray in zip(lengths, RAY_DIRECTIONS, strict=True)
        if length
    ]
    return np.array(walls, np.float64).reshape(-1, 2, 2)
