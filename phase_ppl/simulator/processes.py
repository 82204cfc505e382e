"""Worker processes of our own: started once, given what they work with, gone with their parent."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from multiprocessing import resource_tracker
from typing import Any, Final

import loky

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


def start_worker(token: str, packed: bytes) -> None:
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


def loaded(token: str, packed: bytes | None = None) -> Any:
    """Return what was pickled under a token; None if this process does not know it.

    Raises:
        Exception: whatever loading it raises.
    """
    with _lock:
        if token not in _loaded:
            packed = _packed.get(token, packed)
            if packed is None:
                return None
            thing = pickle.loads(packed)
            if len(_loaded) >= _LOADED_AT_MOST:  # workers of other people live long
                del _loaded[next(iter(_loaded))]
            _loaded[token] = thing
        return _loaded[token]


# --- in the parent ---------------------------------------------------------------------------


class Closed(RuntimeError):
    """A task was given to workers that are closed."""


class Processes:
    """Worker processes that live until they are closed.

    loky's processes know functions from ``__main__``, notebooks and lambdas, and need no guard
    around the main module.

    Args:
        workers: number of processes.
        token: names what they work with, for :func:`loaded`.
        packed: it, pickled.
    """

    def __init__(self, workers: int, token: str, packed: bytes) -> None:
        self._workers = workers
        self._token, self._packed = token, packed
        self._closed = False
        self._lock = threading.RLock()
        self._executor: Any = None
        self._processes: dict[int, multiprocessing.process.BaseProcess] = {}

    def begin(self, *task: Any) -> Future[Any]:
        """Begin a task, a function and its arguments.

        Raises:
            Closed: the processes are closed.
            BrokenExecutor: a worker died; after :meth:`kill` there are new ones.
        """
        with self._lock:
            if self._closed:
                raise Closed("the workers are closed")
            if self._executor is None:
                # it unblocks interrupts when it starts, so it has to start first
                resource_tracker.ensure_running()
                self._executor = loky.ProcessPoolExecutor(
                    self._workers,
                    initializer=start_worker,
                    initargs=(self._token, self._packed),
                    env=ENVIRONMENT,
                )
            try:
                with _interrupts_blocked():
                    future: Future[Any] = self._executor.submit(*task)
                    return future
            finally:
                self._note_processes()

    def resize(self, workers: int) -> None:
        """Have another number of processes, from the next task on; nothing may be running."""
        self._workers = workers
        self.kill()

    def kill(self) -> None:
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
        self.kill()

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
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.kill(pid, signal.SIGKILL)
    # the worker's own group, which exists once it has started up
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)
