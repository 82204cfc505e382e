"""Many independent jobs on worker processes, whatever becomes of a single one."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import secrets
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from typing import Any, Final, Generic, TypeVar

import cloudpickle

from phase_ppl.simulator.contract import Cancelled, OutOfTime, described, too_long
from phase_ppl.simulator.processes import BorrowedExecutor, CannotLoad, OwnWorkers, Unknown
from phase_ppl.world.errors import InvalidSettingError, SimulationError

Thing = TypeVar("Thing")
Job = TypeVar("Job")
RUNS: Final = 2  # how often a job of ``results`` is tried whose worker process dies

_POLL_SECONDS: Final = 1.0
"""How often is looked for what nobody tells: an executor that was closed, a worker that hangs."""

_PATIENCE: Final = 2.0
_STARTUP_SECONDS: Final = 10.0
"""A worker that cannot end a job itself is killed after twice its limit and these."""


@dataclasses.dataclass(eq=False)
class _Task(Generic[Job]):
    """A job on its way: how often it was lost, and whether its worker needs the thing."""

    job: Job
    losses: int = 0
    with_thing: bool = False
    begun: float = 0.0


class Dispatch(Generic[Job]):
    """Gets jobs through a pool: each in its own time, and again where it was lost.

    When a worker of ours dies, everything that was running is lost with it. Those jobs then run
    again one at a time, so that only the one that kills its worker is given up.

    A worker calls ``function``, of a module, with the pool's thing and ``arguments(job)``; jobs
    begin in their order. ``failed`` returns the result of a job that is given up, from the reason
    in words and what was raised, if anything was; ``limit`` the seconds that a job may take that
    begins now. Everything ends once ``stop`` is done, or at the ``deadline``, by
    ``time.perf_counter``. ``retries`` jobs were run again so far.
    """

    def __init__(
        self,
        pool: OwnWorkers | BorrowedExecutor,
        function: Callable[..., Any],
        jobs: Sequence[Job],
        arguments: Callable[[Job], tuple[Any, ...]],
        failed: Callable[[Job, str, BaseException | None], Any],
        max_retries: int,
        stop: Future[None] | None = None,
        limit: Callable[[], float] = lambda: math.inf,
        deadline: float = math.inf,
    ) -> None:
        self.retries = 0
        self._pool, self._function, self._arguments = pool, function, arguments
        self._failed, self._max_retries = failed, max_retries
        self._stop: Future[None] = Future() if stop is None else stop
        self._limit, self._deadline = limit, deadline
        self._hung: set[int] = set()
        self._waiting = deque(_Task(job) for job in jobs)
        self._suspects: deque[_Task[Job]] = deque()
        self._running: dict[Future[Any], _Task[Job]] = {}
        if isinstance(pool, OwnWorkers):
            pool.suffice(len(jobs))

    def results(self) -> Generator[tuple[Job, Any], None, None]:
        """Yield each job with its result, as they finish. Closing this ends what runs."""
        try:
            self._warm_up()
            while self._waiting or self._suspects or self._running:
                self._check_cancelled()
                self._send()
                for future in self._finished():
                    task = self._running.pop(future)
                    if not self._again(task, future):
                        yield task.job, self._result(task, future)
        except BaseException:
            self._pool.stop(self._running)
            raise

    def _warm_up(self) -> None:
        """Let one worker do what all can then share; what it raises, the jobs will raise again."""
        future = self._pool.warm_up()
        if future is None:
            return
        while not wait([future, self._stop], _POLL_SECONDS, FIRST_COMPLETED).done:
            self._check_cancelled()
        self._check_cancelled()
        if isinstance(_error_of(future), BrokenExecutor):
            self._pool.stop(())

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
            task = source.popleft()
            self._running[future] = task
            if task.losses and self._pool.restarts:
                return

    def _submit(self, task: _Task[Job]) -> Future[Any]:
        task.begun = time.perf_counter()
        return self._pool.submit(self._function, self._arguments(task.job), task.with_thing)

    def _finished(self) -> list[Future[Any]]:
        """Wait; return what has ended, or all that runs where the pool had to be stopped."""
        finished: list[Future[Any]] = []
        self._hung.clear()
        while not finished:
            wait([*self._running, self._stop], _POLL_SECONDS, FIRST_COMPLETED)
            self._check_cancelled()
            # whoever waits is not told of what was cancelled
            finished = [future for future in self._running if future.done()]
            if not finished and self._pool.restarts:
                patience = _PATIENCE * self._limit() + _STARTUP_SECONDS
                late = time.perf_counter() - patience
                self._hung = {id(task) for task in self._running.values() if task.begun < late}
                if self._hung:
                    break
        broken = any(isinstance(_error_of(future), BrokenExecutor) for future in finished)
        if self._hung or (broken and self._pool.restarts):
            self._pool.stop(self._running)
            return list(self._running)
        return finished

    def _again(self, task: _Task[Job], future: Future[Any]) -> bool:
        """Queue a task again that is worth another try; return whether it is."""
        error = _error_of(future)
        if error is None:
            task.with_thing = future.result() is Unknown.THING
            if task.with_thing:
                self._waiting.appendleft(task)
            return task.with_thing
        if self._hung:  # its pool was stopped for those
            if id(task) not in self._hung:
                self._waiting.appendleft(task)
            return id(task) not in self._hung
        if isinstance(error, (SimulationError, CannotLoad)) or not isinstance(error, Exception):
            raise error
        died = isinstance(error, BrokenExecutor)
        if died and not self._pool.restarts:
            raise SimulationError(f"the executor is broken: {error}") from error
        task.losses += 1
        # what is raised in a worker of ours would be raised again
        if task.losses > self._max_retries or (self._pool.restarts and not died):
            return False
        self.retries += 1
        (self._suspects if self._pool.restarts else self._waiting).append(task)
        return True

    def _result(self, task: _Task[Job], future: Future[Any]) -> Any:
        error = _error_of(future)
        if error is None:
            return future.result()
        if self._hung:
            return self._failed(task.job, too_long(self._limit()), None)
        if isinstance(error, BrokenExecutor):
            times = f"in {task.losses} of {task.losses} runs"
            return self._failed(task.job, f"its worker process died, {times}", None)
        return self._failed(task.job, described(error), error)

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


# --- jobs that may fail one by one --------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Failure:
    """Why there is no result."""

    reason: str  # in one line
    error: BaseException | None = None  # what was raised, if anything was


def results(
    function: Callable[[Thing, Job], Any],
    thing: Thing,
    jobs: Sequence[Job],
    workers: int,
    what: str = "the work",
) -> Generator[tuple[Job, Any], None, None]:
    """Yield each job with ``function(thing, job)``, as they finish; they begin in the order given.

    A job whose function raises, or whose process dies in :data:`RUNS` runs, gets a
    :class:`Failure`. Closing the generator ends what runs.

    Args:
        function: of a module, to be found by its name in worker processes.
        thing: what all jobs work with; sent to each process once. If it has a method
            ``warm_up``, that is called once before the jobs.
        jobs: what differs.
        workers: processes; 1 does everything in this process.
        what: name of the thing in error messages.
    """
    if not jobs:
        return
    if workers < 2:
        _warm_up(thing)
        for job in jobs:
            yield job, _attempt(thing, function, job)
        return
    # processes even for a single job, which may be the one that kills its process
    try:
        packed = cloudpickle.dumps(thing)
    except Exception as error:
        raise InvalidSettingError(
            f"{what} cannot be sent to worker processes ({described(error)}); workers=1 needs none"
        ) from error
    warm_up = _warm_up if hasattr(thing, "warm_up") else None
    pool = OwnWorkers(workers, secrets.token_hex(8), packed, warm_up)
    dispatch = Dispatch(
        pool, _attempt, jobs, lambda job: (function, job), _given_up, max_retries=RUNS - 1
    )
    try:
        with contextlib.closing(dispatch.results()) as found:
            yield from found
    except CannotLoad as error:
        raise InvalidSettingError(
            f"{what} cannot be loaded in worker processes ({error}); workers=1 needs none"
        ) from None
    finally:
        pool.close()


def _attempt(thing: Any, function: Callable[[Any, Any], Any], job: Any) -> Any:
    try:
        return function(thing, job)
    except (Exception, SystemExit) as error:
        return Failure(described(error), error)


def _given_up(job: Any, reason: str, error: BaseException | None) -> Failure:
    return Failure(reason, error)


def _warm_up(thing: Any) -> None:
    if hasattr(thing, "warm_up"):
        with contextlib.suppress(Exception):  # the jobs will raise it again
            thing.warm_up()
