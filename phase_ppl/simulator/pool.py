"""Where simulations run: worker processes of our own, or an executor that a user brings."""

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

from phase_ppl.simulator.contract import Cancelled, FloatArray, SimulationResult, simulate_one
from phase_ppl.world.errors import SimulationError
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene

ENVIRONMENT: Final = dict.fromkeys(
    (
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
    ),
    "1",
)
"""Of our workers: the cores are shared out among processes, not threads."""

_PARENT_CHECK_SECONDS: Final = 1.0
_LOADED_AT_MOST: Final = 8


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

_packed: dict[str, bytes] = {}
_loaded: dict[str, Work] = {}
_lock = threading.Lock()


def start_worker(token: str, packed: bytes) -> None:
    """Prepare a worker process of our own for the simulations of one runner."""
    # a group of its own: Ctrl-C in the terminal is for the parent alone, which decides what it
    # means; and what a simulator starts can be ended together with its worker
    os.setpgid(0, 0)
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    _packed[token] = packed


def _end_with_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_PARENT_CHECK_SECONDS)
    os._exit(1)


def work_in_worker(
    token: str, packed: bytes | None, hypothesis: Hypothesis, seed: int, error_ceiling: float
) -> SimulationResult | None:
    """Run one simulation; None if this process does not know the runner's work yet.

    Raises:
        SimulationError: the simulator cannot be loaded here.
    """
    work = _load(token, packed)
    if work is None:
        return None
    return simulate_one(
        work.simulator, work.scene, hypothesis, seed, work.observed_positions, error_ceiling
    )


def warm_up_in_worker(token: str) -> None:
    """Let the simulator do once what all workers can then share, such as compiling."""
    work = _load(token, None)
    if work is not None:
        work.simulator.warm_up()


def _load(token: str, packed: bytes | None) -> Work | None:
    with _lock:
        if token not in _loaded:
            packed = _packed.get(token, packed)
            if packed is None:
                return None
            try:
                work: Work = pickle.loads(packed)
            except Exception as error:
                raise SimulationError(
                    f"the simulator cannot be loaded in a worker process: "
                    f"{type(error).__name__}: {error}"
                ) from None
            if len(_loaded) >= _LOADED_AT_MOST:  # workers of other people live long
                del _loaded[next(iter(_loaded))]
            _loaded[token] = work
        return _loaded[token]


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
        self, hypothesis: Hypothesis, seed: int, error_ceiling: float, with_work: bool
    ) -> Future[SimulationResult | None]:
        """Begin one simulation; ``with_work`` where a worker did not know the work."""
        ...

    def stop(self, running: Iterable[Future[Any]]) -> None:
        """End what is running, whatever it takes."""
        ...

    def close(self) -> None:
        """Stop for good."""
        ...


class OwnWorkers:
    """Worker processes that live until they are closed.

    loky's processes know simulators from ``__main__``, notebooks and lambdas, and need no guard
    around the main module.

    Args:
        workers: number of processes.
        token: names the work.
        packed: the pickled :class:`Work`.
        warm_up: let one worker warm up before the first simulation.
    """

    restarts = True

    def __init__(self, workers: int, token: str, packed: bytes, warm_up: bool) -> None:
        self.slots: int | None = workers
        self._workers = workers
        self._token, self._packed = token, packed
        self._cold = warm_up
        self._closed = False
        self._lock = threading.RLock()
        self._executor: Any = None
        self._processes: dict[int, multiprocessing.process.BaseProcess] = {}

    def warm_up(self) -> Future[None] | None:
        """Let one worker warm up, before the first simulation."""
        if not self._cold:
            return None
        self._cold = False
        return self._submit(warm_up_in_worker, self._token)

    def submit(
        self, hypothesis: Hypothesis, seed: int, error_ceiling: float, with_work: bool
    ) -> Future[SimulationResult | None]:
        """Begin one simulation; the workers know the work."""
        return self._submit(work_in_worker, self._token, None, hypothesis, seed, error_ceiling)

    def stop(self, running: Iterable[Future[Any]]) -> None:
        """Kill all workers; the next simulation starts new ones."""
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
        """Kill all workers; no simulation can follow."""
        self._closed = True
        self.stop(())

    def _submit(self, *task: Any) -> Any:
        with self._lock:
            if self._closed:
                raise Cancelled("the runner is closed")
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
                    return self._executor.submit(*task)
            finally:
                self._note_processes()

    def _note_processes(self) -> None:
        # loky forgets them when it breaks, or where Ctrl-C came while it started them
        self._processes.update(self._executor._processes)


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
        self, hypothesis: Hypothesis, seed: int, error_ceiling: float, with_work: bool
    ) -> Future[SimulationResult | None]:
        """Begin one simulation.

        Raises:
            SimulationError: the executor takes none.
        """
        packed = self._packed if with_work else None
        try:
            return self._executor.submit(
                work_in_worker, self._token, packed, hypothesis, seed, error_ceiling
            )
        except RuntimeError as error:  # shut down, or broken
            raise SimulationError(f"the executor takes no simulation: {error}") from error

    def stop(self, running: Iterable[Future[Any]]) -> None:
        """Withdraw what has not begun; what has runs to its end, unheeded."""
        for future in running:
            future.cancel()

    def close(self) -> None:
        """Do nothing: the executor is not ours."""


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
