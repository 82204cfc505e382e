"""Frames with time stamps, put on the grid of frames that worlds have."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError

FRAMES_PER_SECOND: Final = 12.0  # frames per second of simulated time

PARTS: Final = 5  # of a planner step, over which a frame is the mean
GAP: Final = 0.25
"""Seconds between two time stamps, at most, over which bodies are taken to move straight."""

LONGEST: Final = 3600.0
"""Seconds between two time stamps, at most: more are no seconds, or belong to another video."""

_ROUNDING: Final = 1e-7  # seconds


class Clock:
    """Turns poses with time stamps into frames, one by one.

    The first pose is the start. Frame k is the mean over the five parts of the twelfth of a second
    that ends k twelfths later. In between, bodies move straight and turn the shorter way. A body is
    NaN in a frame if it was not seen before and after one of the parts, or these are too far apart.

    Args:
        gap: longest time between two poses, seconds.
    """

    def __init__(self, gap: float = GAP) -> None:
        self._gap = gap
        self._first = self._last = math.nan
        self._pose = self._turned = np.empty(0)
        self._parts: list[FloatArray] = []
        self._n = 0  # parts so far

    def put(self, seconds: float, pose: FloatArray) -> list[FloatArray]:
        """Return the frames that are complete with a pose, (entity, 3), NaN where unseen.

        Raises:
            InvalidEventError: the time stamp is not later than the last one, or later by more than
                an hour. What was put before stays.
        """
        if not math.isfinite(seconds) or seconds <= self._last:
            raise InvalidEventError(
                f"time stamp {seconds:g} after {self._last:g}: expected seconds, each later than "
                "the one before"
            )
        if seconds - self._last > max(LONGEST, self._gap):
            raise InvalidEventError(
                f"time stamp {seconds:g} after {self._last:g}: expected seconds, at most "
                f"{LONGEST:g} after the one before"
            )
        pose = np.array(pose)
        if math.isnan(self._last):
            self._first = self._last = seconds
            self._pose, self._turned = pose, np.nan_to_num(pose[:, 2])
            return [pose]
        turns = np.round((pose[:, 2] - self._turned) / (2 * np.pi))
        pose[:, 2] -= 2 * np.pi * turns
        self._turned = np.where(np.isnan(pose[:, 2]), self._turned, pose[:, 2])
        found, before, unseen = [], self._pose, np.full(pose.shape, np.nan)
        while (at := self._first + (self._n + 1) / (PARTS * FRAMES_PER_SECOND)) < (
            seconds + _ROUNDING
        ):
            share = min(1.0, (at - self._last) / (seconds - self._last))
            if share == 1.0:
                part = pose
            elif seconds - self._last > self._gap + _ROUNDING:
                part = unseen
            else:
                part = (1 - share) * before + share * pose
            self._parts.append(part)
            self._n += 1
            if len(self._parts) == PARTS:
                found.append(np.mean(self._parts, axis=0))
                self._parts = []
        self._last, self._pose = seconds, pose
        return found
