"""How long a run is: a number of iterations, or until a budget is spent.

Whether another iteration begins follows from what those before really cost, not from what a kernel
declares that a step may cost. With a budget of simulations or frames it follows from the run alone,
so that it is the same for any number of workers and after every resumption.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, NamedTuple

from phase_ppl.inference.registry import KernelInfo
from phase_ppl.inference.settings import BUDGETS, Budget
from phase_ppl.models.bridge import Record
from phase_ppl.world.checks import instance_of, whole_number
from phase_ppl.world.errors import InvalidSettingError

ITERATIONS: Final = 6  # L, the paper's number of iterations
RECENT: Final = 3  # iterations whose mean is what the next one is expected to take

IDLE: Final = 100
"""Iterations in a row without a simulation, after which a budget will never be spent: so it is
where all hypotheses have been simulated and their noise is fixed."""

clock: Callable[[], float] = time.perf_counter  # seconds of wall time


class Length(NamedTuple):
    """When a run ends."""

    chains: int  # number of particles M
    iterations: int | None = None  # L, after the initial particles; None: until the budget is spent
    budget: Budget | None = None  # none where there is a number of iterations
    sims_at_start: int = 1  # the most simulations of each initial particle
    sims_per_step: int = 1  # the most simulations that an iteration takes per particle

    @classmethod
    def of(
        cls,
        kernel: Any,
        info: KernelInfo,
        chains: int,
        iterations: int | None,
        budget: Budget | None,
        n_frames: int,
    ) -> Length:
        """Return the length of a run, as the user gave it, with a kernel made for the event."""
        if budget is not None and iterations is not None:
            raise InvalidSettingError("give either iterations or a budget, not both")
        if budget is not None:
            instance_of("budget", budget, Budget, BUDGETS)
        length = cls(
            chains,
            iterations,
            budget,
            getattr(kernel, "sims_at_start", 1),
            getattr(kernel, "sims_per_step", info.sims_per_step),
        )
        own = getattr(kernel, "n_iterations", None)
        if own is not None:
            _check_own(info.name, length, own(chains), n_frames)
            return length._replace(iterations=own(chains), budget=None)
        if budget is None:
            wanted = ITERATIONS if iterations is None else whole_number("iterations", iterations)
            return length._replace(iterations=wanted)
        at_start = length.at_most(0)
        # what an iteration takes is not known before, but a simulation for each particle is little
        if length.limit("simulations") < at_start + chains:
            raise InvalidSettingError(
                f"a budget of {budget} is too small: {chains} initial particles and one iteration "
                f"need {at_start + chains}"
            )
        if length.limit("frames") <= at_start * n_frames:
            raise InvalidSettingError(
                f"a budget of {budget} is too small: {chains} initial particles need "
                f"{at_start * n_frames}, and iterations come on top"
            )
        return length

    def at_most(self, iterations: int) -> int:
        """Return the most simulations that so many iterations take."""
        return self.chains * (self.sims_at_start + iterations * self.sims_per_step)

    def limit(self, unit: str) -> float:
        """Return the budget, where it is in that unit; else inf."""
        return self.budget.amount if self.budget and self.budget.unit == unit else math.inf

    @property
    def counts(self) -> bool:
        """Whether the run ends when so many simulations or frames were made."""
        return self.budget is not None and self.budget.unit != "seconds"


def _check_own(name: str, asked: Length, needed: int, n_frames: int) -> None:
    """Raise InvalidSettingError if something contradicts a kernel that decides its own length."""
    takes = f"with {asked.chains} chains it takes {needed}"
    if asked.limit("seconds") < math.inf:
        raise InvalidSettingError(
            f"a budget of seconds is of no use to kernel {name!r}: {takes} iterations, whatever "
            "their time"
        )
    if asked.iterations not in (None, needed):
        raise InvalidSettingError(
            f"iterations={asked.iterations}, but kernel {name!r} decides itself: {takes}; leave "
            "iterations out"
        )
    simulations = asked.at_most(needed)
    for unit, least in (("simulations", simulations), ("frames", simulations * n_frames)):
        if asked.limit(unit) < least:
            raise InvalidSettingError(
                f"a budget of {asked.budget} is too small: kernel {name!r} takes {least}"
            )


class Pace:
    """What a run has cost so far, and whether another iteration is to begin.

    The call began at that :func:`clock`; ``seconds`` the run took before, in other calls, and
    ``recent`` its last iterations there.

    Attributes:
        done: finished iterations; -1: not even the initial particles are there.
        simulations: made by the initial particles and the finished iterations; those run again
            because they failed do not count.
        frames: simulated by them.
    """

    def __init__(
        self, length: Length, began: float, *, seconds: float = 0.0, recent: Iterable[float] = ()
    ) -> None:
        self.done, self.simulations, self.frames = -1, 0, 0
        self._length = length
        self._begin = began - seconds
        self._recent = deque(recent, maxlen=RECENT)
        self._first_guess = False
        self._mark = 0.0
        self._last = 0  # the last iteration that took a simulation

    def count(self, records: Sequence[Record], done: int) -> None:
        """Take in what so many iterations have cost, at least as many as before."""
        new = [record for record in records[self.simulations :] if record.iteration <= done]
        self.done = done
        self.simulations += len(new)
        self.frames += sum(record.result.frames_simulated for record in new)
        self._last = new[-1].iteration if new else self._last

    @property
    def is_spent(self) -> bool:
        """Whether a budget of simulations or frames is used up."""
        most_simulations, most_frames = map(self._length.limit, ("simulations", "frames"))
        return self.simulations >= most_simulations or self.frames >= most_frames

    @property
    def seconds(self) -> float:
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

    @property
    def goes_on(self) -> bool:
        """Whether another iteration is to begin."""
        if self._length.counts:
            return not self.is_spent and self.done - self._last < IDLE
        return self.done < self.expected

    @property
    def expected(self) -> int:
        """How many iterations there will be in all, as far as the clock can tell."""
        if self._length.iterations is not None:
            return self._length.iterations
        done, left = max(self.done, 0), self._length.limit("seconds") - self.seconds
        if left == math.inf or not self._recent:
            return done
        each = max(math.fsum(self._recent) / len(self._recent), 1e-6)
        return done + max(int(left / each), 0)
