"""How long a run is and what it may cost, known before anything is simulated."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from phase_ppl.inference.registry import KernelInfo
from phase_ppl.inference.settings import Budget, FrameBudget, TimeBudget
from phase_ppl.models.bridge import Record
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, shown

ITERATIONS: Final = 6
"""L, the paper's number of iterations."""


class Length(NamedTuple):
    """Length of a run.

    Attributes:
        iterations: L, after the initial particles; None: until the budget is spent.
        sims_at_start: the most simulations of each initial particle.
        sims_per_step: the most simulations that an iteration takes per particle. Kernels declare
            it; what they spend is counted.
        seconds: of wall time that the run may take; None: any.
        simulations: to be made; None: any number.
        frames: to be simulated; None: any number.
    """

    iterations: int | None
    sims_at_start: int
    sims_per_step: int
    seconds: float | None = None
    simulations: int | None = None
    frames: int | None = None

    def at_most(self, chains: int, iterations: int) -> int:
        """Return the most simulations that so many iterations take."""
        return chains * (self.sims_at_start + iterations * self.sims_per_step)

    @property
    def target(self) -> dict[str, Any]:
        """What ends the run, as a file keeps it."""
        names = ("iterations", "seconds", "simulations", "frames")
        return {name: getattr(self, name) for name in names}


def budget_of(target: Mapping[str, Any]) -> Budget | FrameBudget | TimeBudget | None:
    """Return the budget of a :attr:`Length.target`; None: it is a number of iterations."""
    if target.get("simulations") is not None:
        return Budget(target["simulations"])
    if target.get("frames") is not None:
        return FrameBudget(target["frames"])
    return None if target.get("seconds") is None else TimeBudget(target["seconds"])


def run_length(
    kernel: Any,
    info: KernelInfo,
    chains: int,
    iterations: int | None,
    budget: Budget | FrameBudget | TimeBudget | None,
    n_frames: int,
) -> Length:
    """Return the length of a run.

    Args:
        kernel: as made for the event.
        info: what is known of it.
        chains: number of particles.
        iterations, budget: as the user gave them.
        n_frames: of a complete simulation.

    Raises:
        InvalidSettingError: both are given, or they are not what the kernel can do.
    """
    if budget is not None and iterations is not None:
        raise InvalidSettingError("give either iterations or a budget, not both")
    if not isinstance(budget, Budget | FrameBudget | TimeBudget | None):
        raise InvalidSettingError(
            f"budget={shown(budget)}, expected phase_ppl.simulations(n), phase_ppl.frames(n) or "
            "phase_ppl.seconds(n)"
        )
    length = Length(
        0,
        getattr(kernel, "sims_at_start", 1),
        getattr(kernel, "sims_per_step", info.sims_per_step),
    )
    own = getattr(kernel, "n_iterations", None)
    if own is not None:
        needed = own(chains)
        _check_own(info.name, length.at_most(chains, needed), needed, chains, iterations, budget,
                   n_frames)  # fmt: skip
        return length._replace(iterations=needed)
    if budget is None:
        wanted = ITERATIONS if iterations is None else whole_number("iterations", iterations)
        return length._replace(iterations=wanted)
    at_start = length.at_most(chains, 0)
    if isinstance(budget, TimeBudget):
        return length._replace(iterations=None, seconds=budget.seconds)
    if isinstance(budget, Budget):
        # what an iteration takes is not known before, but a simulation for each particle is little
        if budget.simulations < at_start + chains:
            raise InvalidSettingError(
                f"a budget of {budget.simulations} simulations is too small: {chains} initial "
                f"particles and one iteration need {at_start + chains}"
            )
        return length._replace(iterations=None, simulations=budget.simulations)
    if budget.frames <= at_start * n_frames:
        raise InvalidSettingError(
            f"a budget of {budget.frames} frames is too small: {chains} initial particles need "
            f"{at_start * n_frames}, and iterations come on top"
        )
    return length._replace(iterations=None, frames=budget.frames)


def _check_own(
    name: str,
    simulations: int,
    needed: int,
    chains: int,
    iterations: int | None,
    budget: Budget | FrameBudget | TimeBudget | None,
    n_frames: int,
) -> None:
    """Raise InvalidSettingError if something contradicts a kernel that decides its own length."""
    if isinstance(budget, TimeBudget):
        raise InvalidSettingError(
            f"a budget of seconds is of no use to kernel {name!r}: with {chains} chains it takes "
            f"{needed} iterations, whatever their time"
        )
    if iterations is not None and iterations != needed:
        raise InvalidSettingError(
            f"iterations={iterations}, but kernel {name!r} decides itself: with {chains} chains "
            f"it takes {needed}; leave iterations out"
        )
    if isinstance(budget, Budget) and budget.simulations < simulations:
        raise InvalidSettingError(
            f"a budget of {budget.simulations} simulations is too small: kernel {name!r} takes "
            f"{simulations}"
        )
    if isinstance(budget, FrameBudget) and budget.frames < simulations * n_frames:
        raise InvalidSettingError(
            f"a budget of {budget.frames} frames is too small: kernel {name!r} takes "
            f"{simulations * n_frames}"
        )


def check_chains(info: KernelInfo, chains: int) -> None:
    """Raise InvalidSettingError if the kernel cannot work with so many chains."""
    whole_number("chains", chains)
    if info.even_chains and chains % 2:
        raise InvalidSettingError(
            f"chains={chains}: kernel {info.name!r} needs an even number, such as {chains + 1}"
        )


# --- how many iterations a run takes: a number of them, or until a budget is spent ----------------
# Whether another iteration begins follows from what those before really cost, not from what a
# kernel declares that a step may cost. With a budget of simulations or frames it follows from the
# run alone, so that it is the same for any number of workers and after every resumption.

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
