"""How noisy the observed positions are, and how far a filter should follow them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.names import BLUE_ITEM

UNSEEN: Final = 0.05
"""Units that are assumed before there is anything to estimate the noise from."""

_MEDIAN: Final = 0.6745
"""Median of |x| for a standard normal x."""

_MOST: Final = 0.9
"""Share of a deviation that is taken over where observations are exact: the rest is the means'
lag behind the state at the end of a step."""

_MOST_VELOCITY: Final = 0.5
_ANGLE: Final = 0.9


class NoiseEstimate:
    """The standard deviation of the observed positions, estimated on the way.

    Items lie still most of the time: the median of the absolute second differences of their
    positions is that of the noise alone, however they move in the rest.

    Args:
        known: units; None: to be estimated.
        start: (4, 3) the first frame.

    Attributes:
        now: the estimate from the frames so far, units; before there are three, ``UNSEEN``. A
            frame is to be scored with the one from the frames before it.
    """

    def __init__(self, known: float | None, start: FloatArray) -> None:
        self._known = known
        self._last: list[FloatArray] = [start[BLUE_ITEM:, :2]]
        self._differences: list[FloatArray] = []
        self.now = UNSEEN if known is None else known

    def update(self, observed: FloatArray) -> None:
        """Take in a frame, (4, 3)."""
        if self._known is not None:
            return
        self._last = [*self._last[-2:], observed[BLUE_ITEM:, :2]]
        if len(self._last) == 3:
            before, between, now = self._last
            self._differences.append(np.abs(now - 2 * between + before))
            self.now = float(np.median(self._differences)) / (_MEDIAN * math.sqrt(6))


def filter_gains(drift: float, noise: float) -> FloatArray:
    """Return the shares of a deviation by which position, velocity and angle are corrected.

    Those of the stationary alpha-beta filter of a position that drifts by ``drift`` units a step
    and is observed with ``noise`` units, at most 0.9 and 0.5; angles are taken as seen.
    """
    if noise <= 0:
        return np.array([_MOST, _MOST_VELOCITY, _ANGLE])
    ratio = (drift / noise) ** 2
    alpha = min(_MOST, (math.sqrt(ratio * ratio + 4 * ratio) - ratio) / 2)
    beta = min(_MOST_VELOCITY, alpha * alpha / (2 - alpha))
    return np.array([alpha, beta, _ANGLE])
