"""Where work runs: on worker processes of our own, or in an executor that a user has.

What all tasks work with, such as a simulator and what it is compared with, is pickled once and
sent to each process once; a token names it.
"""

from __future__ import annotations

import contextlib
import enum
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future
from multiprocessing import resource_tracker
from typing import Any, Final, TypeVar

import loky

from phase_ppl.simulator.contract import Cancelled, described
from phase_ppl.world.errors import SimulationError

Result = TypeVar("Result")

GROWTH_BYTES: Final = 2_000_000_000
"""How much a worker may grow before a fresh one takes its place; compiled programs take room."""

ENVIRONMENT: Final = {
    **dict.fromkeys(
        (
            "MKL_NUM_THREADS",
            "NUMBA_NUM_THREADS",
            "NUMEXPR_NUM_THREADS",
            "OMP_NUM_THREADS",
            "OPENBLAS_NUM_THREADS",
            "VECLIB_MAXIMUM_THREADS",
        ),
        "1",
    ),
    "LOKY_MAX_MEMORY_LEAK_SIZE": str(GROWTH_BYTES),
}
"""Of our workers: the cores are shared out among processes, not threads."""

_PARENT_CHECK_SECONDS: Final = 1.0
_LOADED_AT_MOST: Final = 8


# --- in a worker -----------------------------------------------------------------------------

_packed: dict[str, bytes] = {}
_loaded: dict[str, Any] = {}
_lock = threading.Lock()


class CannotLoad(Exception):
    """What tasks work with cannot be loaded in a worker process; the message says why."""


class Unknown(enum.Enum):
    """Instead of a result: this process does not know yet what the task works with."""

    THING = enum.auto()


def _start_worker(token: str, packed: bytes) -> None:
    """Prepare a worker process of our own; ``packed`` is the pickled thing it works with."""
    # a group of its own: Ctrl-C in the terminal is for the parent alone, which decides what it
    # means; and what work starts can be ended together with its worker
    os.setpgid(0, 0)
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    _packed[token] = packed


def in_worker() -> bool:
    """Return whether this process is a worker of ours."""
    return bool(_packed)


def _end_with_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_PARENT_CHECK_SECONDS)
    os._exit(1)


def _do_in_worker(
    token: str, packed: bytes | None, function: Callable[..., Any], arguments: tuple[Any, ...]
) -> Any:
    """Return ``function(thing, *arguments)``, or ``Unknown.THING``."""
    with _lock:
        if token not in _loaded:
            packed = _packed.get(token, packed)
            if packed is None:
                return Unknown.THING
            try:
                thing = pickle.loads(packed)
            except Exception as error:
                raise CannotLoad(described(error)) from None
            if len(_loaded) >= _LOADED_AT_MOST:  # workers of other people live long
                del _loaded[next(iter(_loaded))]
            _loaded[token] = thing
        thing = _loaded[token]
    return function(thing, *arguments)


# --- in the parent ---------------------------------------------------------------------------


class OwnWorkers:
    """Worker processes that live until they are closed; the tasks' thing is known by a token.

    loky's processes know functions from ``__main__``, notebooks and lambdas, and need no guard
    around the main module. One worker runs ``warm_up``, a function of the thing, before the first
    task; ``slots`` tasks run at a time. A pool that broke starts anew with the next task
    (``restarts``).
    """

    restarts: Final = True

    def __init__(
        self, workers: int, token: str, packed: bytes, warm_up: Callable[[Any], None] | None
    ) -> None:
        self.slots: int | None = 0
        self._most, self._token, self._packed = workers, token, packed
        self._warm_up = warm_up
        self._closed = False
        self._lock = threading.RLock()
        self._executor: Any = None
        self._processes: dict[int, multiprocessing.process.BaseProcess] = {}

    def suffice(self, n: int) -> None:
        """Have as many processes as ``n`` tasks need, and no more than there may be."""
        wanted = min(n, self._most)
        if wanted > (self.slots or 0):
            self.slots = wanted
            self.stop(())

    def warm_up(self) -> Future[Any] | None:
        """Begin what one worker does for all; None where there is nothing to do."""
        function, self._warm_up = self._warm_up, None
        return None if function is None else self.submit(function, ())

    def submit(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], with_thing: bool = False
    ) -> Future[Any]:
        """Begin ``function(thing, *arguments)``; the workers know the thing."""
        with self._lock:
            if self._closed:
                raise Cancelled("the runner is closed")
            if self._executor is None:
                # it unblocks interrupts when it starts, so it has to start first
                resource_tracker.ensure_running()
                self._executor = loky.ProcessPoolExecutor(
                    self.slots or 1,
                    initializer=_start_worker,
                    initargs=(self._token, self._packed),
                    env=ENVIRONMENT,
                )
            try:
                with _interrupts_blocked():
                    future: Future[Any] = self._executor.submit(
                        _do_in_worker, self._token, None, function, arguments
                    )
                    return future
            finally:
                self._note_processes()

    def stop(self, running: Iterable[Future[Any]]) -> None:
        """Kill all workers; the next task starts new ones."""
        with self._lock:
            if self._executor is None:
                return
            self._note_processes()
            # loky would look for each worker's children by a program that not every machine
            # has, and without it leaves the worker alive: they are taken from it
            self._executor._processes.clear()
            self._executor.shutdown(wait=True, kill_workers=True)
            for process in self._processes.values():
                if process.is_alive():
                    _kill(process.pid)
                process.join()
            self._processes.clear()
            self._executor = None

    def close(self) -> None:
        """Kill all workers; no task can follow."""
        self._closed = True
        self.stop(())

    def _note_processes(self) -> None:
        # loky forgets them when it breaks, or where Ctrl-C came while it started them
        self._processes.update(self._executor._processes)


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    # processes started meanwhile inherit it: Ctrl-C does not print their half-started traces
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _kill(pid: int | None) -> None:
    if pid is None:
        return
    # the worker, and its own group, which exists once it has started up
    for kill in (os.kill, os.killpg):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            kill(pid, signal.SIGKILL)


class BorrowedExecutor:
    """Somebody else's executor (PEP 3148); it is never shut down.

    Args:
        executor: such as ``concurrent.futures.ProcessPoolExecutor``, or that of a
            ``dask.distributed`` client or of ``mpi4py.futures``.
        slots: how many tasks to give it at a time; None: all.
        token: names what they work with.
        packed: it, pickled.
    """

    restarts: Final = False

    def __init__(self, executor: Executor, slots: int | None, token: str, packed: bytes) -> None:
        self.slots = slots
        self._executor, self._token, self._packed = executor, token, packed

    def warm_up(self) -> None:
        """Do nothing: what its workers share is not known."""

    def submit(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], with_thing: bool = False
    ) -> Future[Any]:
        """Begin ``function(thing, *arguments)``, sending the thing where it is not known."""
        packed = self._packed if with_thing else None
        try:
            return self._executor.submit(_do_in_worker, self._token, packed, function, arguments)
        except Exception as error:  # shut down, or broken
            raise SimulationError(f"the executor takes no simulation: {error}") from error

    def stop(self, running: Iterable[Future[Any]]) -> None:
        """Withdraw what has not begun; what has runs to its end, unheeded."""
        for future in running:
            future.cancel()

    def close(self) -> None:
        """Do nothing: the executor is not ours."""


def mapped(
    function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]], workers: int, unit: str
) -> Iterator[Result]:
    """Yield what a function gives for the arguments of each task, in their order, with a bar.

    A single worker is this process. For tasks that cannot fail; the rest of the module is for those
    that can.
    """
    from tqdm.auto import tqdm

    with contextlib.ExitStack() as stack:
        run: Callable[..., Iterable[Result]] = map
        if workers > 1 and len(tasks) > 1:
            run = stack.enter_context(loky.ProcessPoolExecutor(min(workers, len(tasks)))).map
        columns = zip(*tasks, strict=True)
        yield from tqdm(run(function, *columns), total=len(tasks), unit=unit, disable=None)
