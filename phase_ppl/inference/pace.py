"""How many iterations a run takes: a number of them, or as many as the time allows."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import deque
from collections.abc import Iterable
from typing import Final

from phase_ppl.inference.settings import Budget, TimeBudget
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, shown

clock = time.perf_counter
"""Seconds of wall time."""

ITERATIONS: Final = 6
"""L, the paper's number of iterations."""

RECENT: Final = 3
"""Iterations whose mean is what the next one is expected to take."""


@dataclasses.dataclass(frozen=True)
class Target:
    """When a run is complete: exactly one of the two is a number.

    Attributes:
        iterations: how many there are to be in all.
        seconds: of wall time that the run may take in all.
    """

    iterations: int | None = None
    seconds: float | None = None

    @classmethod
    def of(
        cls,
        iterations: int | None,
        budget: Budget | TimeBudget | None,
        chains: int,
        sims_per_step: int,
    ) -> Target:
        """Return what ``infer`` was asked for; by default the paper's number of iterations.

        Raises:
            InvalidSettingError: both were given, or one that is none or too small.
        """
        if budget is None:
            return cls(ITERATIONS if iterations is None else whole_number("iterations", iterations))
        if iterations is not None:
            raise InvalidSettingError("give either iterations or a budget, not both")
        if isinstance(budget, TimeBudget):
            return cls(seconds=budget.seconds)
        if isinstance(budget, Budget):
            return cls(budget.iterations(chains, sims_per_step))
        raise InvalidSettingError(
            f"budget={shown(budget)}, expected phase_ppl.simulations(n) or phase_ppl.seconds(n)"
        )


class Pace:
    """Says whether another iteration is to begin.

    Args:
        target: when the run is complete.
        sims_per_step: simulations per particle and iteration.
        spent: seconds that the run took before, in other calls.
        recent: seconds that its last iterations took there.

    Attributes:
        target: as given.
    """

    def __init__(
        self,
        target: Target,
        sims_per_step: int,
        *,
        spent: float = 0.0,
        recent: Iterable[float] = (),
    ) -> None:
        self.target = target
        self._sims_per_step = sims_per_step
        self._begin = clock() - spent
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
        if self._first_guess:
            self._recent.clear()
        self._first_guess = initial
        self._recent.append(taken * self._sims_per_step if initial else taken)

    def another(self, done: int) -> bool:
        """Return whether another iteration is to begin after ``done`` of them."""
        return done < self.expected(done)

    def expected(self, done: int) -> int:
        """Return how many iterations there will be in all, as far as one can tell."""
        if self.target.iterations is not None:
            return self.target.iterations
        if self.target.seconds is None or not self._recent:
            return done
        each = max(math.fsum(self._recent) / len(self._recent), 1e-6)
        return done + max(int((self.target.seconds - self.spent) / each), 0)
