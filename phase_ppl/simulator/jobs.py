"""Many independent jobs on worker processes, whatever becomes of a single one."""

from __future__ import annotations

import contextlib
import dataclasses
import secrets
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import cloudpickle

from phase_ppl.simulator.processes import Processes, loaded
from phase_ppl.world.errors import InvalidSettingError

Thing = TypeVar("Thing")
Job = TypeVar("Job")

RUNS: Final = 2
"""How often a job is tried whose worker process dies."""


@dataclasses.dataclass(frozen=True)
class Failure:
    """Why there is no result.

    Attributes:
        reason: in one line.
        error: what was raised, if anything was.
    """

    reason: str
    error: BaseException | None = None


def described(error: BaseException) -> str:
    """Return in one line what was raised, and where."""
    message = " ".join(str(error).split())
    words = f"{type(error).__name__}: {message}" if message else type(error).__name__
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return words
    last = frames[-1]
    return f"{words} ({Path(last.filename).name}, line {last.lineno}, in {last.name})"


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

    Raises:
        InvalidSettingError: the thing cannot be sent to worker processes, or not be loaded there.
    """
    if not jobs:
        return
    if workers > 1:
        # processes even for a single job, which may be the one that kills its process
        yield from _Dispatch(function, thing, jobs, min(workers, len(jobs)), what).results()
        return
    _warm_up(thing)
    for job in jobs:
        yield job, _attempt(function, thing, job)


def _attempt(function: Callable[[Any, Any], Any], thing: Any, job: Any) -> Any:
    try:
        return function(thing, job)
    except (Exception, SystemExit) as error:
        return Failure(described(error), error)


def _warm_up(thing: Any) -> None:
    if hasattr(thing, "warm_up"):
        with contextlib.suppress(Exception):  # the jobs will raise it again
            thing.warm_up()


# --- in a worker -----------------------------------------------------------------------------


class _CannotLoad(str):
    """Why the thing cannot be loaded in a worker."""


def _do_in_worker(token: str, function: Callable[[Any, Any], Any], job: Any) -> Any:
    thing = _thing(token)
    return thing if isinstance(thing, _CannotLoad) else _attempt(function, thing, job)


def _warm_up_in_worker(token: str) -> None:
    thing = _thing(token)
    if not isinstance(thing, _CannotLoad):
        _warm_up(thing)


def _thing(token: str) -> Any:
    try:
        return loaded(token)
    except Exception as error:
        return _CannotLoad(described(error))


# --- in the parent ---------------------------------------------------------------------------


@dataclasses.dataclass(eq=False)
class _Task(Generic[Job]):
    """A job on its way, and how often it was lost with its worker."""

    job: Job
    losses: int = 0


class _Dispatch(Generic[Job]):
    """Jobs on worker processes.

    When a worker dies, everything that was running is lost with it. Those jobs then run again
    one at a time, so that only the one that kills its worker is given up.
    """

    def __init__(
        self,
        function: Callable[[Any, Any], Any],
        thing: Any,
        jobs: Sequence[Job],
        workers: int,
        what: str,
    ) -> None:
        self._what = what
        try:
            packed = cloudpickle.dumps(thing)
        except Exception as error:
            raise InvalidSettingError(
                f"{what} cannot be sent to worker processes ({described(error)}); workers=1 "
                "needs none"
            ) from error
        self._function = function
        self._token = secrets.token_hex(8)
        self._workers = workers
        self._processes = Processes(workers, self._token, packed)
        self._cold = hasattr(thing, "warm_up")
        self._waiting = deque(_Task(job) for job in jobs)
        self._suspects: deque[_Task[Job]] = deque()
        self._running: dict[Future[Any], _Task[Job]] = {}

    def results(self) -> Iterator[tuple[Job, Any]]:
        """Yield each job with its result, as they finish. Closing this ends what runs."""
        try:
            self._warm_up()
            while self._waiting or self._suspects or self._running:
                self._send()
                wait(self._running, return_when=FIRST_COMPLETED)
                yield from self._finished()
        finally:
            self._processes.close()

    def _warm_up(self) -> None:
        """Let one worker do what all can then share."""
        if self._cold:
            future = self._processes.begin(_warm_up_in_worker, self._token)
            wait([future])
            if isinstance(future.exception(), BrokenExecutor):
                self._processes.kill()

    def _send(self) -> None:
        while len(self._running) < self._workers:
            source = self._suspects or self._waiting
            if not source or (self._suspects and self._running):
                return
            try:
                future = self._begin(source[0].job)
            except BrokenExecutor:
                if self._running:  # they are about to end as lost
                    return
                # a worker died while there was nothing to do
                self._processes.kill()
                future = self._begin(source[0].job)
            task = source.popleft()
            self._running[future] = task
            if task.losses:
                return

    def _begin(self, job: Job) -> Future[Any]:
        return self._processes.begin(_do_in_worker, self._token, self._function, job)

    def _finished(self) -> Iterator[tuple[Job, Any]]:
        done = [(future, task) for future, task in self._running.items() if future.done()]
        broken = any(isinstance(future.exception(), BrokenExecutor) for future, _ in done)
        if broken:
            self._processes.kill()
        lost = dict(self._running) if broken else {}
        for future, task in done:
            error = future.exception()
            if isinstance(error, BrokenExecutor):
                continue
            lost.pop(future, None)
            del self._running[future]
            yield task.job, self._result(future, error)
        for future, task in lost.items():
            del self._running[future]
            task.losses += 1
            if task.losses < RUNS:
                self._suspects.append(task)
            else:
                times = f"in {task.losses} of {task.losses} runs"
                yield task.job, Failure(f"its worker process died, {times}")

    def _result(self, future: Future[Any], error: BaseException | None) -> Any:
        if error is not None:  # such as a result that cannot be pickled
            return Failure(described(error), error)
        result = future.result()
        if isinstance(result, _CannotLoad):
            raise InvalidSettingError(
                f"{self._what} cannot be loaded in worker processes ({result}); workers=1 needs "
                "none"
            )
        return result
