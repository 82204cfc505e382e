"""Jobs on our own worker processes, or in a user's executor.

All tasks share a *thing*, such as a simulator and its observation. It is pickled once and sent to
each process once, under a token.
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import math
import multiprocessing
import os
import pickle
import secrets
import signal
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import cloudpickle
import loky
from loky.backend import resource_tracker as loky_tracker

from phase_ppl.simulator.contract import Cancelled, OutOfTime, error_text, too_long
from phase_ppl.world.errors import InvalidSettingError, SimulationError, number_of_workers, shown

Result = TypeVar("Result")
Thing = TypeVar("Thing")
Job = TypeVar("Job")

GROWTH_BYTES: Final = 2_000_000_000
"""Growth of a worker after which a fresh one replaces it; compiled programs take memory."""

_SAFE_PATH: Final = "PYTHONSAFEPATH"

ENVIRONMENT: Final = {
    **{f"{name}_NUM_THREADS": "1" for name in ("MKL", "NUMBA", "NUMEXPR", "OMP", "OPENBLAS")},
    "VECLIB_MAXIMUM_THREADS": "1",
    "LOKY_MAX_MEMORY_LEAK_SIZE": str(GROWTH_BYTES),
    _SAFE_PATH: "1",
}
"""Environment of our workers: cores are shared out among processes, not threads."""

_PARENT_CHECK_SECONDS: Final = 1.0
_STARTING_SECONDS: Final = 3.0  # that a worker may take to start up before it is killed
_LOADED_AT_MOST: Final = 8
RUNS: Final = 2  # tries of a job whose worker process dies
AT_ONCE: Final = 1000  # jobs of ``results`` for an executor: waiting takes longer for more
_POLL_SECONDS: Final = 1.0  # closed executors and hanging workers do not report themselves
_PATIENCE: Final = 2.0
_STARTUP_SECONDS: Final = 10.0
"""A worker that cannot end a job itself is killed after twice its limit plus this."""


# --- in a worker -----------------------------------------------------------------------------

_packed: dict[str, bytes] = {}
_loaded: dict[str, Any] = {}
_lock = threading.Lock()


class CannotLoad(Exception):
    """The tasks' thing cannot be loaded in a worker process; the message says why."""


def _start_worker(things: Mapping[str, bytes], safe_path: bool) -> None:
    """Prepare a worker process of our own for pickled things, given by token.

    ``safe_path``: whether the parent keeps the current folder out of its path.
    """
    # a group of its own, so that Ctrl-C in the terminal reaches only the parent, which decides.
    # Also, processes that the work starts can be ended together with their worker
    os.setpgid(0, 0)
    parent = os.getppid()
    if not safe_path:  # processes that the work starts are not ours
        os.environ.pop(_SAFE_PATH, None)

    def end_with_parent() -> None:
        while os.getppid() == parent:
            time.sleep(_PARENT_CHECK_SECONDS)
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
    _packed.update(things)


def in_worker() -> bool:
    """Return whether this process works for another."""
    own = f"{os.getpid()}-"  # for executors whose workers are threads
    return bool(_packed) or not all(token.startswith(own) for token in _loaded)


def _do_in_worker(
    token: str, packed: bytes, function: Callable[..., Any], arguments: tuple[Any, ...]
) -> Any:
    """Return ``function(thing, *arguments)``; processes of our own know the thing already."""
    with _lock:
        if token not in _loaded:
            try:
                thing = pickle.loads(_packed.get(token, packed))
            except Exception as error:
                raise CannotLoad(error_text(error)) from None
            if token not in _packed:
                _warm_up_in_turn(thing)
            if len(_loaded) >= _LOADED_AT_MOST:  # workers of other executors live long
                del _loaded[next(iter(_loaded))]
            _loaded[token] = thing
        thing = _loaded[token]
    return function(thing, *arguments)


def _warm_up_in_turn(thing: Any) -> None:
    """Warm up a machine's processes one by one: the first compiles, the others load."""
    with (Path(tempfile.gettempdir()) / f".phase_ppl-{os.getuid()}").open("w") as lock:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        _warm_up(thing)


# --- in the parent ---------------------------------------------------------------------------


def slots_of(workers: int | None, executor: Executor | None) -> int | None:
    """Return how many tasks run at a time; None: the executor decides.

    InvalidSettingError: the number is out of range, or ``executor`` is none.
    """
    if executor is not None:
        if hasattr(executor, "get_executor"):
            raise InvalidSettingError(
                f"executor={shown(executor)} is a client; its executor is client.get_executor()"
            )
        if not callable(getattr(executor, "submit", None)):
            raise InvalidSettingError(
                f"executor={shown(executor)} is no PEP 3148 executor, such as "
                "concurrent.futures.ProcessPoolExecutor or client.get_executor() of dask"
            )
    return None if executor is not None and workers is None else number_of_workers(workers)


def pool_for(
    thing: Any, what: str, slots: int | None, executor: Executor | None, warms_up: bool
) -> OwnWorkers | BorrowedExecutor:
    """Return a pool that runs tasks on a thing, in an executor or in our own processes.

    It runs ``slots`` tasks at a time; None: all that the executor takes. The thing is pickled now.
    ``what`` names it in messages. ``warms_up``: whether it has work to do once, for all.

    InvalidSettingError: the thing cannot be sent to processes.
    """
    try:
        packed = cloudpickle.dumps(thing)
    except Exception as error:
        raise InvalidSettingError(
            f"{what} cannot be sent to worker processes ({error_text(error)}); workers=1 needs none"
        ) from error
    token = f"{os.getpid()}-{secrets.token_hex(8)}"
    if executor is not None:
        return BorrowedExecutor(executor, slots, token, packed)
    return OwnWorkers(slots or 1, token, packed, warms_up)


def _own_executor(workers: int, things: Mapping[str, bytes]) -> Any:
    """Return an executor of worker processes that know things by their tokens.

    Neither they nor their supervisor look for modules in the current folder before their path is
    this process's. That folder may be somebody else's, and hold a ``random.py``.
    """
    try:
        os.getcwd()  # the processes begin in it
    except FileNotFoundError:
        raise InvalidSettingError(
            "the current folder is gone, and worker processes begin in it: os.chdir to another "
            "one, or workers=1, which needs none"
        ) from None
    safe_path = _SAFE_PATH in os.environ
    os.environ.setdefault(_SAFE_PATH, "1")
    try:
        # the first to start unblocks interrupts, so they must start before all else
        resource_tracker.ensure_running()
        loky_tracker.ensure_running()
    finally:
        if not safe_path:
            os.environ.pop(_SAFE_PATH, None)
    return loky.ProcessPoolExecutor(
        workers,
        initializer=_start_worker,
        initargs=(things, safe_path),
        env=ENVIRONMENT,
    )


class OwnWorkers:
    """Worker processes that live until they are closed; the tasks' thing is known by a token.

    loky's processes can run functions from ``__main__``, notebooks and lambdas, and need no guard
    around the main module. One worker warms the thing up before the first task. ``slots`` tasks
    run at a time. A broken pool starts anew with the next task (``restarts``).
    """

    restarts: Final = True

    def __init__(self, workers: int, token: str, packed: bytes, warms_up: bool) -> None:
        self.slots: int | None = 0
        self._most, self._token, self._packed = workers, token, packed
        self._warms_up = warms_up
        self._closed = False
        self._lock = threading.RLock()
        self._executor: Any = None
        self._processes: dict[int, multiprocessing.process.BaseProcess] = {}

    def suffice(self, n: int) -> None:
        """Have as many processes as ``n`` tasks need, up to the limit."""
        wanted = min(n, self._most)
        if wanted > (self.slots or 0):
            self.slots = wanted
            self.stop(())

    def warm_up(self) -> Future[Any] | None:
        """Begin the work that one worker does for all; None: there is none."""
        due, self._warms_up = self._warms_up, False
        return self.submit(_warm_up, ()) if due else None

    def submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Any]:
        """Begin ``function(thing, *arguments)``; the workers know the thing."""
        with self._lock:
            if self._closed:
                raise Cancelled("the runner is closed")
            if self._executor is None:
                self._executor = _own_executor(self.slots or 1, {self._token: self._packed})
            # processes started now inherit it, so that Ctrl-C prints no tracebacks of starting ones
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                future: Future[Any] = self._executor.submit(
                    _do_in_worker, self._token, b"", function, arguments
                )
                return future
            finally:
                self._note_processes()
                signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def stop(self, running: Iterable[Future[Any]]) -> None:
        """Kill all workers; the next task starts new ones."""
        with self._lock:
            if self._executor is None:
                return
            self._note_processes()
            # a worker that starts up while its executor ends would print its failure
            latest = time.monotonic() + _STARTING_SECONDS
            for pid, process in self._processes.items():
                with contextlib.suppress(ProcessLookupError):
                    # a worker leads its group once it has started up
                    while process.is_alive() and os.getpgid(pid) != pid:
                        if time.monotonic() > latest:
                            break
                        time.sleep(0.01)
            # loky would look for each worker's children with a program that not every machine has;
            # without it, loky leaves the worker alive. So they are taken from loky
            self._executor._processes.clear()
            self._executor.shutdown(wait=True, kill_workers=True)
            for pid, process in self._processes.items():
                # the worker, and its group
                for kill in (os.kill, os.killpg) if process.is_alive() else ():
                    with contextlib.suppress(ProcessLookupError, PermissionError):
                        kill(pid, signal.SIGKILL)
                process.join()
            self._processes.clear()
            self._executor = None

    def close(self) -> None:
        """Kill all workers; no task can follow."""
        self._closed = True
        self.stop(())

    def _note_processes(self) -> None:
        # loky forgets them if it breaks, or if Ctrl-C came while it started them
        self._processes.update(self._executor._processes)


class BorrowedExecutor:
    """A user's executor (PEP 3148), such as dask's; it is never shut down.

    It gets ``slots`` tasks at a time (None: all), each with the tasks' thing.
    """

    restarts: Final = False

    def __init__(self, executor: Executor, slots: int | None, token: str, packed: bytes) -> None:
        self.slots = slots
        self._executor, self._token, self._packed = executor, token, packed

    def warm_up(self) -> None:
        """Do nothing: the workers warm up when they load the thing."""

    def submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Any]:
        """Begin ``function(thing, *arguments)`` with the thing, which each process loads once."""
        known = self._token, self._packed
        try:
            found = self._executor.submit(_do_in_worker, *known, function, arguments)
        except Exception as error:  # the executor is shut down, or broken
            raise SimulationError(f"the executor takes no more work: {error}") from error
        if not isinstance(found, Future):
            raise InvalidSettingError(
                f"executor={shown(self._executor)} is no PEP 3148 executor: its submit gives "
                f"{shown(found)}, expected a concurrent.futures.Future"
            )
        return found

    def stop(self, running: Iterable[Future[Any]]) -> None:
        """Withdraw tasks that have not begun; the others run to their end, ignored."""
        for future in running:
            future.cancel()

    def close(self) -> None:
        """Do nothing: the executor is not ours."""


def mapped(
    function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]], workers: int, unit: str
) -> Iterator[Result]:
    """Yield a function's result for each task, in their order, with a bar.

    A single worker is this process. This is for tasks that cannot fail; the rest of the module is
    for tasks that can.
    """
    from phase_ppl.world.progress import counted  # imports tqdm, which workers do without

    with contextlib.ExitStack() as stack:
        run: Callable[..., Iterable[Result]] = map
        if workers > 1 and len(tasks) > 1:
            run = stack.enter_context(_own_executor(min(workers, len(tasks)), {})).map
        columns = zip(*tasks, strict=True)
        yield from counted(run(function, *columns), None, unit, "simulating", len(tasks))


# --- many independent jobs; no failure of one ends the others ------------------------------------


@dataclasses.dataclass(eq=False)
class _Task(Generic[Job]):
    """A running job, and how often it was lost."""

    job: Job
    losses: int = 0
    begun: float = 0.0


@dataclasses.dataclass(eq=False)
class Dispatch(Generic[Job]):
    """Runs jobs in a pool: each within its own time, and again if it was lost.

    If one of our workers dies, all running jobs are lost with it. They then run again one at a
    time, so that only the job that kills its worker is given up.

    A worker calls ``function``, of a module, with the pool's thing and ``arguments(job)``. Jobs
    begin in their order. ``failed`` returns the result of a job that is given up, from the reason
    in words and the exception, if any. ``limit`` returns the seconds for a job that begins now.
    Everything ends once ``stop`` is done, or at the ``deadline``, by ``time.perf_counter``.
    ``retries`` counts the jobs that were run again.
    """

    pool: OwnWorkers | BorrowedExecutor
    function: Callable[..., Any]
    jobs: dataclasses.InitVar[Sequence[Job]]
    arguments: Callable[[Job], tuple[Any, ...]]
    failed: Callable[[Job, str, BaseException | None], Any]
    stop: Future[None] = dataclasses.field(default_factory=Future)
    limit: Callable[[], float] = lambda: math.inf
    deadline: float = math.inf

    def __post_init__(self, jobs: Sequence[Job]) -> None:
        self.retries = 0
        self._hung: set[int] = set()
        self._waiting = deque(_Task(job) for job in jobs)
        self._suspects: deque[_Task[Job]] = deque()
        self._running: dict[Future[Any], _Task[Job]] = {}
        if isinstance(self.pool, OwnWorkers):
            self.pool.suffice(len(jobs))

    def results(self) -> Generator[tuple[Job, Any], None, None]:
        """Yield each job with its result, as they finish. Closing it ends running jobs."""
        try:
            if self._waiting:
                self._warm_up()
            while self._waiting or self._suspects or self._running:
                self._check_cancelled()
                self._send()
                for future in self._finished():
                    task = self._running.pop(future)
                    if not self._again(task, future):
                        yield task.job, self._result(task, future)
        except BaseException:
            self.pool.stop(self._running)
            raise

    def _warm_up(self) -> None:
        """Let one worker do the work that all share; its errors will recur in the jobs."""
        future = self.pool.warm_up()
        if future is None:
            return
        while not wait([future, self.stop], _POLL_SECONDS, FIRST_COMPLETED).done:
            self._check_cancelled()
        self._check_cancelled()
        if isinstance(_error_of(future), BrokenExecutor):
            self.pool.stop(())

    def _send(self) -> None:
        """Give the pool no more than it can run now, so that it can be stopped at once."""
        while self.pool.slots is None or len(self._running) < self.pool.slots:
            source = self._suspects or self._waiting
            if not source or (self._suspects and self._running):
                return
            task = source[0]
            given = self.function, self.arguments(task.job)
            try:
                future = self.pool.submit(*given)
            except BrokenExecutor:
                if self._running:  # they will soon be reported as lost
                    return
                # a worker died while it was idle
                self.pool.stop(())
                future = self.pool.submit(*given)
            self._running[future] = source.popleft()
            task.begun = time.perf_counter()
            if task.losses and self.pool.restarts:
                return

    def _finished(self) -> list[Future[Any]]:
        """Wait; return the futures that ended, or all running ones if the pool was stopped."""
        finished: list[Future[Any]] = []
        self._hung.clear()
        while not finished:
            wait([*self._running, self.stop], _POLL_SECONDS, FIRST_COMPLETED)
            self._check_cancelled()
            # waiting does not report cancelled futures
            finished = [future for future in self._running if future.done()]
            if not finished and self.pool.restarts:
                patience = _PATIENCE * self.limit() + _STARTUP_SECONDS
                late = time.perf_counter() - patience
                self._hung = {id(task) for task in self._running.values() if task.begun < late}
                if self._hung:
                    break
        broken = any(isinstance(_error_of(future), BrokenExecutor) for future in finished)
        if self._hung or (broken and self.pool.restarts):
            self.pool.stop(self._running)
            return list(self._running)
        return finished

    def _again(self, task: _Task[Job], future: Future[Any]) -> bool:
        """Queue a lost task again if it is worth another try; return whether it is."""
        error = _error_of(future)
        if error is None:
            return False
        if self._hung:  # the pool was stopped because of those
            if id(task) not in self._hung:
                self._waiting.appendleft(task)
            return id(task) not in self._hung
        if isinstance(error, (SimulationError, CannotLoad)) or not isinstance(error, Exception):
            raise error
        died = isinstance(error, BrokenExecutor)
        if died and not self.pool.restarts:
            raise SimulationError(f"the executor is broken: {error}") from error
        task.losses += 1
        # an exception in one of our workers would recur
        if task.losses >= RUNS or (self.pool.restarts and not died):
            return False
        self.retries += 1
        (self._suspects if self.pool.restarts else self._waiting).append(task)
        return True

    def _result(self, task: _Task[Job], future: Future[Any]) -> Any:
        error = _error_of(future)
        if error is None:
            return future.result()
        if self._hung:
            why, error = too_long(self.limit()), None
        elif isinstance(error, BrokenExecutor):
            why, error = f"its worker process died, in {task.losses} of {task.losses} runs", None
        else:
            why = error_text(error)
        return self.failed(task.job, why, error)

    def _check_cancelled(self) -> None:
        if self.stop.done():
            raise Cancelled("the run was cancelled")
        if time.perf_counter() >= self.deadline:
            raise OutOfTime("the time of the run is over")


def _error_of(future: Future[Any]) -> BaseException | None:
    if future.cancelled():
        return CancelledError("the executor cancelled it")
    if not future.done():  # the pool was stopped
        return BrokenExecutor("the pool was stopped")
    return future.exception()


@dataclasses.dataclass(frozen=True)
class Failure:
    """Why there is no result, in one line, and the exception, if any."""

    reason: str
    error: BaseException | None = None


def results(
    function: Callable[[Thing, Job], Any],
    thing: Thing,
    jobs: Sequence[Job],
    workers: int | None,
    what: str = "the work",
    executor: Executor | None = None,
) -> Generator[tuple[Job, Any], None, None]:
    """Yield each job with ``function(thing, job)``, as they finish; they begin in the order given.

    A job whose function raises, or whose process dies in :data:`RUNS` runs, gets a
    :class:`Failure`. Closing the generator ends running jobs.

    Args:
        function: of a module, so that worker processes find it by its name.
        thing: shared by all jobs, called ``what`` in messages; sent to each process once. If it has
            a method ``warm_up``, that is called once before the jobs.
        workers: processes; 1 does everything in this process. With an ``executor``, how many jobs
            it gets at a time; None: up to :data:`AT_ONCE`.
        executor: any PEP 3148 executor to work in instead; it is not shut down.

    Raises:
        InvalidSettingError: the thing cannot be sent to processes, or cannot be loaded there.
        SimulationError: the executor takes no more work.
    """
    if not jobs:
        return
    own = number_of_workers(workers) if executor is None else None
    if own == 1 and (workers or multiprocessing.current_process().daemon):
        _warm_up(thing)
        for job in jobs:
            yield job, _attempt(thing, function, job)
        return
    # processes even for a single job, which might kill its process
    slots = own or workers or AT_ONCE
    pool = pool_for(thing, what, slots, executor, hasattr(thing, "warm_up"))
    dispatch = Dispatch(
        pool,
        _attempt,
        jobs,
        arguments=lambda job: (function, job),
        failed=lambda _, *why: Failure(*why),
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
        return Failure(error_text(error), error)


def _warm_up(thing: Any) -> None:
    if hasattr(thing, "warm_up"):
        with contextlib.suppress(Exception):  # the error will recur in the jobs
            thing.warm_up()
