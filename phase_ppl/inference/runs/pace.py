"""How many iterations a run takes: a number of them, or until a budget is spent.

Whether another iteration begins follows from what those before really cost, not from what a kernel
declares that a step may cost. With a budget of simulations or frames it follows from the
run alone, so that it is the same for any number of workers and after every resumption.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from phase_ppl.inference.runs.length import Length
from phase_ppl.models.bridge import Record

clock = time.perf_counter
"""Seconds of wall time."""

RECENT: Final = 3
"""Iterations whose mean is what the next one is expected to take."""


IDLE: Final = 100
"""Iterations in a row without a simulation, after which a budget will never be spent: so it is
where all hypotheses have been simulated and their noise is fixed."""


class Tally(NamedTuple):
    """What the initial particles and the finished iterations have cost.

    Attributes:
        simulations: made; those run again because they failed do not count.
        frames: simulated by them.
        idle: how many of the last iterations in a row took no simulation.
    """

    simulations: int = 0
    frames: int = 0
    idle: int = 0


NOTHING: Final = Tally()


class Account:
    """Keeps the :class:`Tally` of a run.

    Args:
        records: all simulations of the run; more will be appended.
        done: iterations that are finished, all of whose simulations are there.

    Attributes:
        tally: as of the last call of :meth:`settle`.
        before: as of the call before it.
    """

    def __init__(self, records: Sequence[Record], done: int = 0) -> None:
        self._records = records
        self._settled = 0
        self.tally = self.before = NOTHING
        if records:
            last = [record for record in records if record.iteration == done]
            self._settled = len(records) - len(last)
            paid = records[: self._settled]
            idle = max(done - 1 - max((r.iteration for r in paid), default=0), 0)
            self.tally = Tally(len(paid), sum(r.result.frames_simulated for r in paid), idle)
            self.settle()

    def settle(self) -> None:
        """Count the simulations of the initial particles, or of an iteration, which ended."""
        new = self._records[self._settled :]
        self._settled += len(new)
        self.before = self.tally
        self.tally = Tally(
            self.before.simulations + len(new),
            self.before.frames + sum(record.result.frames_simulated for record in new),
            0 if new else self.before.idle + 1,
        )


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

    def another(self, done: int, spent: Tally = NOTHING) -> bool:
        """Return whether another iteration is to begin.

        Args:
            done: iterations so far.
            spent: what they and the initial particles cost.
        """
        length = self._length
        if length.simulations is not None or length.frames is not None:
            return not self.is_spent(spent) and spent.idle < IDLE
        return done < self.expected(done)

    def is_spent(self, spent: Tally) -> bool:
        """Return whether a budget of simulations or frames is used up."""
        simulations, frames = self._length.simulations, self._length.frames
        return (simulations is not None and spent.simulations >= simulations) or (
            frames is not None and spent.frames >= frames
        )

    def expected(self, done: int) -> int:
        """Return how many iterations there will be in all, as far as the clock can tell."""
        if self._length.iterations is not None:
            return self._length.iterations
        if self._length.seconds is None or not self._recent:
            return done
        each = max(math.fsum(self._recent) / len(self._recent), 1e-6)
        return done + max(int((self._length.seconds - self.spent) / each), 0)
