"""Getting simulations through a pool: in its own time, and again where they were lost."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from typing import Any, Final

from phase_ppl.simulator.contract import Cancelled, OutOfTime, SimulationResult, too_long
from phase_ppl.simulator.processes import Pool
from phase_ppl.world.errors import SimulationError
from phase_ppl.world.hypothesis import Hypothesis

Request = tuple[Hypothesis, int, float]
"""Hypothesis, seed, error ceiling."""

_POLL_SECONDS: Final = 1.0
"""How often is looked for what nobody tells: an executor that was closed, a worker that hangs."""

_PATIENCE: Final = 2.0
_STARTUP_SECONDS: Final = 10.0
"""A worker that cannot end a simulation itself is killed after twice its limit and these."""


@dataclasses.dataclass(eq=False)
class _Job:
    """A request on its way: how often it was lost, and whether its worker needs the work."""

    request: Request
    losses: int = 0
    with_work: bool = False
    begun: float = 0.0


class Dispatch:
    """The requests of one run.

    When a worker of ours dies, everything that was running is lost with it. Those simulations
    then run again one at a time, so that only the one that kills its worker is given up.

    Args:
        pool: runs them.
        requests: what to run.
        n_frames: frames of a complete simulation.
        max_retries: how often a lost simulation is run again.
        stop: done once the run is cancelled.
        limit: returns the seconds that a simulation may take that begins now.
        deadline: time, by ``time.perf_counter``, at which everything ends.

    Attributes:
        retries: simulations run again so far.
    """

    def __init__(
        self,
        pool: Pool,
        requests: Sequence[Request],
        n_frames: int,
        max_retries: int,
        stop: Future[None],
        limit: Callable[[], float] = lambda: math.inf,
        deadline: float = math.inf,
    ) -> None:
        self.retries = 0
        self._limit, self._deadline = limit, deadline
        self._hung: set[int] = set()
        self._pool, self._stop = pool, stop
        self._n_frames, self._max_retries = n_frames, max_retries
        self._waiting = deque(_Job(request) for request in requests)
        self._suspects: deque[_Job] = deque()
        self._running: dict[Future[Any], _Job] = {}

    def results(self) -> Generator[tuple[Request, SimulationResult], None, None]:
        """Yield each request with its result, as they finish. Closing this ends what runs.

        Raises:
            Cancelled: ``stop`` was done, or the deadline is over.
            SimulationError: no simulation can be run.
        """
        try:
            self._warm_up()
            while self._waiting or self._suspects or self._running:
                self._check_cancelled()
                self._send()
                for future in self._finished():
                    job = self._running.pop(future)
                    result = self._result(job, future)
                    if result is not None:
                        yield job.request, result
        except BaseException:
            self._pool.stop(self._running)
            raise

    def _warm_up(self) -> None:
        future = self._pool.warm_up()
        if future is None:
            return
        while not wait([future, self._stop], _POLL_SECONDS, FIRST_COMPLETED).done:
            self._check_cancelled()
        self._check_cancelled()
        if _is_broken(future):
            self._pool.stop(())
        # what else it may have raised, the simulations will raise again

    def _send(self) -> None:
        """Give the pool as much as it takes and no more, so that it can be stopped at once."""
        while self._pool.slots is None or len(self._running) < self._pool.slots:
            source = self._suspects or self._waiting
            if not source or (self._suspects and self._running):
                return
            try:
                future = self._submit(source[0])
            except BrokenExecutor:
                if self._running:  # they are about to end as lost
                    return
                # a worker died while there was nothing to do
                self._pool.stop(())
                future = self._submit(source[0])
            job = source.popleft()
            self._running[future] = job
            if job.losses and self._pool.restarts:
                return

    def _submit(self, job: _Job) -> Future[SimulationResult | None]:
        job.begun = time.perf_counter()
        return self._pool.submit(*job.request, self._limit(), job.with_work)

    def _finished(self) -> set[Future[Any]]:
        pending: list[Future[Any]] = [*self._running, self._stop]
        finished: set[Future[Any]] = set()
        self._hung.clear()
        while not finished:
            wait(pending, timeout=_POLL_SECONDS, return_when=FIRST_COMPLETED)
            self._check_cancelled()
            # whoever waits is not told of what was cancelled
            finished = {future for future in self._running if future.done()}
            if not finished and self._pool.restarts:
                patience = _PATIENCE * self._limit() + _STARTUP_SECONDS
                late = time.perf_counter() - patience
                self._hung = {id(job) for job in self._running.values() if job.begun < late}
                if self._hung:
                    self._pool.stop(self._running)
                    return set(self._running)
        if self._pool.restarts and any(_is_broken(future) for future in finished):
            self._pool.stop(self._running)
            return set(self._running)
        return finished

    def _result(self, job: _Job, future: Future[Any]) -> SimulationResult | None:
        """Return the result, if there is one; else the job was queued again."""
        error = _error_of(future)
        if error is None:
            result: SimulationResult | None = future.result()
            if result is None:
                job.with_work = True
                self._waiting.appendleft(job)
            return result
        if self._hung:  # its pool was stopped for those
            if id(job) in self._hung:
                return self._failed(job, too_long(self._limit()))
            self._waiting.appendleft(job)
            return None
        if isinstance(error, SimulationError) or not isinstance(error, Exception):
            raise error
        if isinstance(error, BrokenExecutor) and not self._pool.restarts:
            raise SimulationError(f"the executor is broken: {error}") from error
        job.losses += 1
        if job.losses <= self._max_retries:
            self.retries += 1
            (self._suspects if self._pool.restarts else self._waiting).append(job)
            return None
        if isinstance(error, BrokenExecutor):
            failure = f"its worker process died, in {job.losses} of {job.losses} runs"
        else:
            failure = f"{type(error).__name__}: {error}"
        return self._failed(job, failure)

    def _failed(self, job: _Job, failure: str) -> SimulationResult:
        hypothesis, seed, _ = job.request
        return SimulationResult.failed(hypothesis, seed, self._n_frames, failure)

    def _check_cancelled(self) -> None:
        if self._stop.done():
            raise Cancelled("the run was cancelled")
        if time.perf_counter() >= self._deadline:
            raise OutOfTime("the time of the run is over")


def _error_of(future: Future[Any]) -> BaseException | None:
    if future.cancelled():
        return CancelledError("the executor cancelled it")
    if not future.done():  # its pool was stopped
        return BrokenExecutor("the pool was stopped")
    return future.exception()


def _is_broken(future: Future[Any]) -> bool:
    return isinstance(_error_of(future), BrokenExecutor)
