"""Where simulations run: worker processes of our own, or an executor that a user brings."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Executor, Future
from typing import Any, NamedTuple, Protocol

from phase_ppl.simulator.contract import Cancelled, SimulationResult, simulate_one
from phase_ppl.simulator.processes import Closed, Processes, loaded
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import SimulationError
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene


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
