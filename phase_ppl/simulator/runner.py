"""Running many simulations: on worker processes, stopped early, counted, never lost."""

from __future__ import annotations

import concurrent.futures as futures
import dataclasses
import functools
import math
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Final

import cloudpickle
import numpy as np
from numpy.typing import NDArray

from phase_ppl.simulator.contract import Cancelled, SimulationResult, Simulator, simulate_one
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

POLL_SECONDS: Final = 0.2
"""How long a cancel may go unnoticed."""

_ONE_THREAD: Final = {
    name: "1"
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
}

_Request = tuple[Hypothesis, int, float]


@dataclasses.dataclass
class Statistics:
    """What the simulations of a runner have cost.

    Attributes:
        simulations: run; requests merged with an identical one do not count.
        frames: simulated; frames_saved: not simulated because the fate was decided.
        seconds_simulating: summed over workers; seconds_waiting: wall time spent in ``run``.
        failures: simulations that gave nothing; retries: repeated because a worker died.
    """

    simulations: int = 0
    frames: int = 0
    frames_saved: int = 0
    seconds_simulating: float = 0.0
    seconds_waiting: float = 0.0
    failures: int = 0
    retries: int = 0


@functools.lru_cache(maxsize=4)
def _unpack(payload: bytes) -> tuple[Simulator, Scene, NDArray[np.float64]]:
    unpacked: tuple[Simulator, Scene, NDArray[np.float64]] = cloudpickle.loads(payload)
    return unpacked


def _work(payload: bytes, request: _Request) -> SimulationResult:
    """Run one simulation in a worker process."""
    simulator, scene, observed = _unpack(payload)
    hypothesis, seed, ceiling = request
    return simulate_one(simulator, scene, hypothesis, seed, observed, ceiling)


def _ignore_interrupts() -> None:
    # Ctrl-C reaches the whole process group; the parent alone decides what it means
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def usable_cores() -> int:
    """Return the number of cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Runner:
    """Runs simulations of one observed event.

    Args:
        simulator: what to run; may be defined anywhere, also in ``__main__`` or a notebook.
        scene: where it starts.
        observation: what its frames are compared with.
        workers: processes; 1 simulates in this process; None: one per usable core.
        executor: any PEP 3148 executor instead of own workers (it is not shut down).
        max_retries: how often a simulation is repeated whose worker died.
        on_result: called in this process as each simulation finishes.

    Raises:
        InvalidSettingError: ``workers`` is no whole number >= 1.
    """

    def __init__(
        self,
        simulator: Simulator,
        scene: Scene,
        observation: Observation,
        *,
        workers: int | None = None,
        executor: futures.Executor | None = None,
        max_retries: int = 1,
        on_result: Callable[[SimulationResult], None] | None = None,
    ) -> None:
        count = usable_cores() if workers is None else workers
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise InvalidSettingError(f"workers={workers!r}, expected a whole number >= 1")
        self.workers = count
        self.statistics = Statistics()
        self.on_result = on_result
        self._simulator, self._scene = simulator, scene
        self._observed = np.array(observation.positions)
        self._max_retries = max_retries
        self._given = executor
        self._pool: Any = None
        self._payload: bytes | None = None
        self._cancelled = threading.Event()

    # --- life ------------------------------------------------------------------------------

    def __enter__(self) -> Runner:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop all workers. Safe to call twice."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=True, kill_workers=True)

    def cancel(self) -> None:
        """Make a running ``run`` raise :class:`Cancelled`. Safe to call from any thread."""
        self._cancelled.set()

    @property
    def n_frames(self) -> int:
        """Frames of a complete simulation."""
        return len(self._observed)

    # --- work ------------------------------------------------------------------------------

    def run(
        self,
        hypotheses: Sequence[Hypothesis],
        seeds: Sequence[int],
        error_ceilings: Sequence[float] | None = None,
    ) -> list[SimulationResult]:
        """Return the simulations of hypotheses and seeds, in order.

        Args:
            hypotheses, seeds: (n,) what to simulate; identical requests are run once.
            error_ceilings: (n,) summed error beyond which each one is stopped, units.

        Raises:
            Cancelled: :meth:`cancel` was called.
        """
        ceilings = [math.inf] * len(seeds) if error_ceilings is None else error_ceilings
        requests: list[_Request] = [
            (h, int(s), float(c)) for h, s, c in zip(hypotheses, seeds, ceilings, strict=True)
        ]
        distinct = list(dict.fromkeys(requests))
        begin = time.perf_counter()
        try:
            if self._given is None and (self.workers == 1 or len(distinct) == 0):
                done = {request: self._here(request) for request in distinct}
            else:
                done = self._on_workers(distinct)
        finally:
            self.statistics.seconds_waiting += time.perf_counter() - begin
        return [done[request] for request in requests]

    def _here(self, request: _Request) -> SimulationResult:
        hypothesis, seed, ceiling = request
        self._check_cancelled()
        return self._finish(
            simulate_one(
                self._simulator,
                self._scene,
                hypothesis,
                seed,
                self._observed,
                ceiling,
                self._cancelled,
            )
        )

    def _on_workers(self, requests: Sequence[_Request]) -> dict[_Request, SimulationResult]:
        waiting = deque(requests)
        suspects: deque[_Request] = deque()
        tries = dict.fromkeys(requests, 0)
        running: dict[futures.Future[SimulationResult], _Request] = {}
        done: dict[_Request, SimulationResult] = {}
        try:
            while waiting or suspects or running:
                self._check_cancelled()
                # whoever was running when a worker died runs alone, to find out whose fault it was
                if suspects and not running:
                    self._submit(suspects.popleft(), running)
                while waiting and not suspects and len(running) < self.workers:
                    self._submit(waiting.popleft(), running)
                finished, _ = futures.wait(
                    running, timeout=POLL_SECONDS, return_when=futures.FIRST_COMPLETED
                )
                for future in finished:
                    request = running.pop(future)
                    error = future.exception()
                    if error is None:
                        done[request] = self._finish(future.result())
                    elif not isinstance(error, futures.BrokenExecutor):
                        raise error
                    elif tries[request] < self._max_retries:
                        tries[request] += 1
                        self.statistics.retries += 1
                        suspects.append(request)
                    else:
                        done[request] = self._finish(
                            SimulationResult.failed(
                                *request[:2], self.n_frames, "its worker process died"
                            )
                        )
                    if error is not None:
                        self._drop_pool()
        except BaseException:
            for future in running:
                future.cancel()
            self._drop_pool()
            raise
        return done

    def _submit(
        self, request: _Request, running: dict[futures.Future[SimulationResult], _Request]
    ) -> None:
        if self._payload is None:
            self._payload = cloudpickle.dumps((self._simulator, self._scene, self._observed))
        running[self._executor().submit(_work, self._payload, request)] = request

    def _executor(self) -> Any:
        if self._given is not None:
            return self._given
        if self._pool is None:
            from loky import ProcessPoolExecutor

            warm_up = getattr(self._simulator, "warm_up", None)
            if warm_up is not None:
                # compile once here, not once in every worker
                warm_up()
            self._pool = ProcessPoolExecutor(
                max_workers=self.workers, env=_ONE_THREAD, initializer=_ignore_interrupts
            )
        return self._pool

    def _drop_pool(self) -> None:
        """Kill the workers at once; the next request starts new ones."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=True, kill_workers=True)

    def _check_cancelled(self) -> None:
        if self._cancelled.is_set():
            raise Cancelled("the run was cancelled")

    def _finish(self, result: SimulationResult) -> SimulationResult:
        statistics = self.statistics
        statistics.simulations += 1
        statistics.frames += result.frames_simulated
        statistics.seconds_simulating += result.seconds
        if result.failure is not None:
            statistics.failures += 1
        else:
            statistics.frames_saved += self.n_frames - result.frames_simulated
        if self.on_result is not None:
            self.on_result(result)
        return result
