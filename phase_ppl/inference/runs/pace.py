"""How many iterations a run takes: a number of them, or as many as the time allows."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable
from typing import Final

from phase_ppl.inference.runs.length import Length

clock = time.perf_counter
"""Seconds of wall time."""

RECENT: Final = 3
"""Iterations whose mean is what the next one is expected to take."""


class Pace:
    """Says whether another iteration is to begin.

    Args:
        length: of the run.
        began: time of the call, by :func:`clock`.
        spent: seconds that the run took before, in other calls.
        recent: seconds that its last iterations took there.
    """

    def __init__(
        self, length: Length, began: float, *, spent: float = 0.0, recent: Iterable[float] = ()
    ) -> None:
        self._length = length
        self._begin = began - spent
        self._recent = deque(recent, maxlen=RECENT)
        self._first_guess = False
        self._mark = 0.0

    @property
    def spent(self) -> float:
        """Seconds that the run has taken so far, in all calls."""
        return clock() - self._begin

    @property
    def recent(self) -> list[float]:
        """Seconds that the last iterations took."""
        return list(self._recent)

    def begin(self) -> None:
        """Note that the initial particles or an iteration begin."""
        self._mark = clock()

    def end(self, *, initial: bool = False) -> None:
        """Note that they ended.

        Until there is an iteration, the initial particles say what one takes: they compile and
        simulate too, and are never stopped early.
        """
        taken = clock() - self._mark
        if initial:
            taken *= self._length.sims_per_step / max(self._length.sims_at_start, 1)
        elif self._first_guess:
            self._recent.clear()
        self._first_guess = initial
        self._recent.append(taken)

    def another(self, done: int) -> bool:
        """Return whether another iteration is to begin after ``done`` of them."""
        return done < self.expected(done)

    def expected(self, done: int) -> int:
        """Return how many iterations there will be in all, as far as one can tell."""
        if self._length.iterations is not None:
            return self._length.iterations
        if self._length.seconds is None or not self._recent:
            return done
        each = max(math.fsum(self._recent) / len(self._recent), 1e-6)
        return done + max(int((self._length.seconds - self.spent) / each), 0)
