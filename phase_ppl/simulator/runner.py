"""Running many simulations on worker processes, with early stopping, and costs."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, InvalidStateError
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.simulator.contract import (
    Cancelled,
    SimulationResult,
    Simulator,
    Statistics,
    simulate_one,
    too_long,
)
from phase_ppl.simulator.processes import (
    BorrowedExecutor,
    CannotLoad,
    Dispatch,
    OwnWorkers,
    pool_for,
    slots_of,
)
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    SimulationError,
    check_name,
    positive_number,
    shown,
)
from phase_ppl.world.event import Observation
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene

Job = tuple[Hypothesis, int, float]  # hypothesis, seed, error ceiling

POLICIES: Final = ("reject", "raise")
"""A failed simulation is a result without likelihood; or ends the run."""


class Work(NamedTuple):
    """All that a runner's simulations share; sent to a worker once."""

    simulator: Any
    scene: Scene
    observed_positions: FloatArray  # (time, entity, 2) x, y, units

    def simulate(
        self,
        what: Hypothesis,
        seed: int,
        ceiling: float,
        limit: float = math.inf,
        **more: Any,
    ) -> SimulationResult:
        """Run one simulation; arguments as for :func:`simulate_one`."""
        observed = self.observed_positions
        return simulate_one(
            self.simulator, self.scene, what, seed, observed, ceiling, limit=limit, **more
        )

    def warm_up(self) -> None:
        """Do once the work that all workers share, such as compiling."""
        self.simulator.warm_up()


class Runner:
    """Runs simulations of one observed event.

    The results are in the order of the requests, and do not depend on the number of workers. A
    simulation whose worker died is run again once. An exception in the simulator would recur, and
    is a failure at once.

    Args:
        simulator, scene: what to run; may be defined anywhere, also in ``__main__`` or a notebook.
        observation: the frames are compared with it.
        workers: processes; 1 simulates in this process; None: one per usable core. With an
            ``executor``, how many simulations it gets at a time; None: all.
        executor: any PEP 3148 executor instead of our own workers. It is not shut down, and
            running simulations go on after a cancel, ignored.
        on_failure: "reject": a failed simulation is a result without likelihood; "raise": the
            first failure ends the run.
        simulation_seconds: seconds after which a simulation fails; None: no limit. One that
            hangs within a frame goes on, ignored; in our own workers until their processes end.

    Attributes:
        on_result: called in this process as each simulation finishes.
        statistics: costs of the simulations so far.
        workers: number of processes; None: an executor decides.
        limit: seconds that a simulation may take.
        patience: time, by ``time.perf_counter``. Once a simulation took too long, all that would
            begin after this time fail.
        deadline: time at which ``run`` raises :class:`~phase_ppl.simulator.contract.OutOfTime`.

    Raises:
        InvalidSettingError: ``workers`` is out of range, or the simulator cannot be called or sent
            to workers.
        UnknownNameError: an unknown ``on_failure``.
    """

    def __init__(
        self,
        simulator: Simulator,
        scene: Scene,
        observation: Observation,
        *,
        workers: int | None = None,
        executor: Executor | None = None,
        on_failure: str = "reject",
        simulation_seconds: float | None = None,
    ) -> None:
        if not callable(simulator):
            raise InvalidSettingError(f"simulator={shown(simulator)} cannot be called")
        slots = self.workers = slots_of(workers, executor)
        check_name("on_failure", on_failure, POLICIES)
        self.on_failure = on_failure
        self.limit = math.inf
        if simulation_seconds is not None:
            self.limit = positive_number("simulation_seconds", simulation_seconds)
        self.patience = self.deadline = math.inf
        self._cut = False
        self.statistics = Statistics()
        self.on_result: Callable[[SimulationResult], None] | None = None
        self.scene = scene
        self._work = Work(simulator, scene, np.array(observation.positions))
        self._stop: Future[None] = Future()
        self._one_run = threading.Lock()
        self._pool: OwnWorkers | BorrowedExecutor | None = None
        if executor is not None or (slots or 1) > 1:
            what, warms_up = f"simulator={shown(simulator)}", hasattr(simulator, "warm_up")
            self._pool = pool_for(self._work, what, slots, executor, warms_up)

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def cancel(self) -> None:
        """Make ``run`` raise :class:`Cancelled`, now and at any later call.

        Safe to call from any thread. A simulation in this process stops after its next frame;
        workers are killed.
        """
        with contextlib.suppress(InvalidStateError):
            self._stop.set_result(None)

    def close(self) -> None:
        """Cancel, and leave no worker behind. Safe to call twice, and from any thread."""
        self.cancel()
        if self._pool is not None:
            self._pool.close()

    @property
    def n_frames(self) -> int:
        """Frames of a complete simulation."""
        return len(self._work.observed_positions)

    def run(
        self,
        hypotheses: Sequence[Hypothesis],
        seeds: Sequence[int],
        error_ceilings: Sequence[float] | None = None,
    ) -> list[SimulationResult]:
        """Return the simulations of hypotheses and seeds, in order.

        Args:
            hypotheses, seeds: (n,) what to simulate. Identical requests are run once and share one
                result.
            error_ceilings: (n,) summed error beyond which each one is stopped, units.

        Raises:
            Cancelled, OutOfTime: the run was cancelled, or its deadline has passed.
            InvalidSettingError: an error ceiling is nan.
            SimulationError: a simulation failed, with "raise"; or the executor takes no more work.
        """
        ceilings = [math.inf] * len(seeds) if error_ceilings is None else error_ceilings
        if any(map(math.isnan, ceilings)):
            raise InvalidSettingError("an error ceiling is nan, expected a number or inf")
        asked = zip(hypotheses, map(int, seeds), map(float, ceilings), strict=True)
        requests: list[Job] = list(asked)
        with self._one_run:
            clock = time.perf_counter()
            try:
                distinct = list(dict.fromkeys(requests))
                if self._pool is None:
                    done = self._run_here(distinct)
                else:
                    done = self._run_in(self._pool, distinct)
            finally:
                self.statistics.seconds_waiting += time.perf_counter() - clock
        return [done[request] for request in requests]

    def _run_here(self, requests: Sequence[Job]) -> dict[Job, SimulationResult]:
        self._check_cancelled()
        until: dict[str, Any] = {"stop": [self._stop], "deadline": self.deadline}
        return {
            one: self._count(self._work.simulate(*one, self._limit(), **until)) for one in requests
        }

    def _limit(self) -> float:
        """Return the seconds for a simulation that begins now."""
        over = self._cut and time.perf_counter() > self.patience
        return 0.0 if over else self.limit

    def _run_in(
        self, pool: OwnWorkers | BorrowedExecutor, requests: Sequence[Job]
    ) -> dict[Job, SimulationResult]:
        dispatch = Dispatch(
            pool,
            Work.simulate,
            requests,
            arguments=lambda request: (*request, self._limit()),
            failed=self._failed,
            stop=self._stop,
            limit=self._limit,
            deadline=self.deadline,
        )
        try:
            with contextlib.closing(dispatch.results()) as results:
                return {request: self._count(result) for request, result in results}
        except CannotLoad as error:
            raise SimulationError(
                f"the simulator cannot be loaded in a worker process: {error}"
            ) from None
        finally:
            self.statistics.retries += dispatch.retries

    def _failed(
        self, request: Job, reason: str, error: BaseException | None = None
    ) -> SimulationResult:
        hypothesis, seed, _ = request
        return SimulationResult.failed(hypothesis, seed, self.n_frames, reason)

    def _check_cancelled(self) -> None:
        if self._stop.done():
            raise Cancelled("the run was cancelled")

    def _count(self, result: SimulationResult) -> SimulationResult:
        statistics = self.statistics
        statistics.simulations += 1
        statistics.frames += result.frames_simulated
        statistics.seconds_simulating += result.seconds
        if result.failure is not None:
            statistics.failures += 1
            self._cut |= result.failure == too_long(self.limit)
            if self.on_failure == "raise":
                raise SimulationError(
                    f"simulation of [{result.hypothesis}] with seed {result.seed} failed: "
                    f"{result.failure}"
                )
        else:
            statistics.frames_saved += self.n_frames - result.frames_simulated
        if self.on_result is not None:
            self.on_result(result)
        return result
