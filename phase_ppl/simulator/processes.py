"""Worker processes of our own: started once, given what they work with, gone with their parent."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future
from multiprocessing import resource_tracker
from typing import Any, Final, NamedTuple, Protocol

import loky

from phase_ppl.simulator.contract import Cancelled, SimulationResult, simulate_one
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import SimulationError
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene

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


# --- where simulations run: worker processes of our own, or an executor that a user... ------------


class Work(NamedTuple):
    """What all simulations of a runner have in common; sent to a worker once.

    Attributes:
        simulator, scene: what to simulate.
        observed_positions: (time, entity, 2) x, y, units.
    """

    simulator: Any
    scene: Scene
    observed_positions: FloatArray


# --- in a worker -----------------------------------------------------------------------------


def work_in_worker(
    token: str,
    packed: bytes | None,
    hypothesis: Hypothesis,
    seed: int,
    error_ceiling: float,
    limit: float,
) -> SimulationResult | None:
    """Run one simulation; None if this process does not know the runner's work yet.

    Raises:
        SimulationError: the simulator cannot be loaded here.
    """
    work = _load(token, packed)
    if work is None:
        return None
    return simulate_one(
        *(work.simulator, work.scene, hypothesis, seed, work.observed_positions, error_ceiling),
        limit=limit,
    )


def warm_up_in_worker(token: str) -> None:
    """Let the simulator do once what all workers can then share, such as compiling."""
    work = _load(token, None)
    if work is not None:
        work.simulator.warm_up()


def _load(token: str, packed: bytes | None) -> Work | None:
    try:
        work: Work | None = loaded(token, packed)
    except Exception as error:
        raise SimulationError(
            f"the simulator cannot be loaded in a worker process: {type(error).__name__}: {error}"
        ) from None
    return work


# --- in the parent ---------------------------------------------------------------------------


class Pool(Protocol):
    """Takes simulations.

    Attributes:
        slots: how many it takes at a time; None: any number.
        restarts: whether a pool that broke starts anew with the next simulation.
    """

    slots: int | None
    restarts: bool

    def warm_up(self) -> Future[None] | None:
        """Begin to warm up; None where there is nothing to do."""
        ...

    def submit(
        self, hypothesis: Hypothesis, seed: int, error_ceiling: float, limit: float, with_work: bool
    ) -> Future[SimulationResult | None]:
        """Begin one simulation of ``limit`` seconds at most.

        ``with_work``: a worker did not know the work.
        """
        ...

    def stop(self, running: Iterable[Future[Any]]) -> None:
        """End what is running, whatever it takes."""
        ...

    def close(self) -> None:
        """Stop for good."""
        ...


class OwnWorkers:
    """Worker processes that live until they are closed.

    Args:
        workers: number of processes, at most.
        token: names the work.
        packed: the pickled :class:`Work`.
        warm_up: let one worker warm up before the first simulation.
    """

    restarts = True

    def __init__(self, workers: int, token: str, packed: bytes, warm_up: bool) -> None:
        self.slots: int | None = 0
        self._most, self._packed = workers, packed
        self._token, self._cold = token, warm_up
        self._processes = Processes(1, token, packed)

    def suffice(self, n: int) -> None:
        """Have as many processes as ``n`` simulations need, and no more than there may be."""
        wanted = min(n, self._most)
        if wanted > (self.slots or 0):
            self.slots = wanted
            self._processes.resize(wanted)

    def warm_up(self) -> Future[None] | None:
        """Let one worker warm up, before the first simulation."""
        if not self._cold:
            return None
        self._cold = False
        return self._begin(warm_up_in_worker, self._token)

    def submit(
        self, hypothesis: Hypothesis, seed: int, error_ceiling: float, limit: float, with_work: bool
    ) -> Future[SimulationResult | None]:
        """Begin one simulation; the workers know the work."""
        return self._begin(
            work_in_worker, self._token, None, hypothesis, seed, error_ceiling, limit
        )

    def stop(self, running: Iterable[Future[Any]]) -> None:
        """Kill all workers; the next simulation starts new ones."""
        self._processes.kill()

    def close(self) -> None:
        """Kill all workers; no simulation can follow."""
        self._processes.close()

    def _begin(self, *task: Any) -> Future[Any]:
        try:
            return self._processes.begin(*task)
        except Closed:
            raise Cancelled("the runner is closed") from None


class BorrowedExecutor:
    """Somebody else's executor (PEP 3148); it is never shut down.

    Args:
        executor: such as ``concurrent.futures.ProcessPoolExecutor``, or that of a
            ``dask.distributed`` client or of ``mpi4py.futures``.
        slots: how many simulations to give it at a time; None: all.
        token: names the work.
        packed: the pickled :class:`Work`.
    """

    restarts = False

    def __init__(self, executor: Executor, slots: int | None, token: str, packed: bytes) -> None:
        self.slots = slots
        self._executor, self._token, self._packed = executor, token, packed

    def warm_up(self) -> Future[None] | None:
        """Do nothing: what its workers share is not known."""
        return None

    def submit(
        self, hypothesis: Hypothesis, seed: int, error_ceiling: float, limit: float, with_work: bool
    ) -> Future[SimulationResult | None]:
        """Begin one simulation.

        Raises:
            SimulationError: the executor takes none.
        """
        packed = self._packed if with_work else None
        try:
            return self._executor.submit(
                work_in_worker, self._token, packed, hypothesis, seed, error_ceiling, limit
            )
        except Exception as error:  # shut down, or broken
            raise SimulationError(f"the executor takes no simulation: {error}") from error

    def stop(self, running: Iterable[Future[Any]]) -> None:
        """Withdraw what has not begun; what has runs to its end, unheeded."""
        for future in running:
            future.cancel()

    def close(self) -> None:
        """Do nothing: the executor is not ours."""
