"""Driving the particles, one iteration at a time, so that nothing done is ever lost."""

from __future__ import annotations

import concurrent.futures as futures
import contextlib
from collections.abc import Callable
from typing import Any, Final, NamedTuple, Protocol, TypeVar

import jax
import numpy as np
from jax import random
from numpy.typing import NDArray
from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.world.errors import InvalidSettingError, SimulationError

POLL_SECONDS: Final = 0.1
"""How long Ctrl-C may go unnoticed."""

Result = TypeVar("Result")


class Cancels(Protocol):
    """What the driver needs of a runner."""

    def cancel(self) -> None:
        """Make a running simulation stop, and later ones not start."""
        ...


class Step(NamedTuple):
    """The particles after one iteration, on the host.

    Attributes:
        sites: site -> (chain, ...) current hypotheses.
        sim_seed: (chain,) seeds of their simulations.
        accepted: (chain,) whether the iteration's proposal was accepted.
        window: (chain,) first frame of the window it came from; -1 where there is none.
    """

    sites: dict[str, NDArray[Any]]
    sim_seed: NDArray[np.int64]
    accepted: NDArray[np.bool_]
    window: NDArray[np.int64]


class Chains:
    """The particles of one run.

    The compiled step runs in a thread of its own, so that the main thread notices Ctrl-C at
    once: it then cancels the simulations, waits for the thread, and raises KeyboardInterrupt.

    Args:
        kernel: bound to the program of an event.
        bridge: the program's.
        runner: the bridge's.
        n_chains: number of particles M.
        seed: any whole number >= 0.

    Attributes:
        start: the initial particles, once there are any.
        steps: what was done since.
    """

    def __init__(
        self,
        kernel: MCMCKernel,
        bridge: SimulatorBridge,
        runner: Cancels,
        n_chains: int,
        seed: int,
    ) -> None:
        self.start: Step | None = None
        self.steps: list[Step] = []
        self._kernel, self._bridge, self._runner = kernel, bridge, runner
        self._n_chains = n_chains
        self._key_number = int(np.random.SeedSequence(seed).generate_state(1)[0])
        self._state: Any = None
        self._step = jax.jit(lambda state: kernel.sample(state, (), {}))

    def initialise(self) -> None:
        """Simulate the initial particles.

        A particle whose initial simulation failed starts where the next one does: any start
        leaves the stationary law as it is.

        Raises:
            SimulationError: all initial simulations failed.
            KeyboardInterrupt: Ctrl-C.
        """
        self._bridge.iteration = 0
        state = self._in_thread(self._initial_state)
        completed = np.zeros(self._n_chains, bool)
        for record in self._bridge.records:
            completed[record.chain] |= record.result.completed
        if not completed.any():
            raise self._nothing_completed()
        chain = np.arange(self._n_chains)
        source = [next(c for c in np.roll(chain, -i) if completed[c]) for i in chain]
        if not completed.all():
            copied = jax.tree.map(lambda leaf: leaf[np.array(source)], state)
            state = copied._replace(rng_key=state.rng_key)
        self._state = state
        self.start = _on_host(state)

    def advance(self) -> None:
        """Do one iteration.

        Raises:
            KeyboardInterrupt: Ctrl-C; the iteration does not count.
        """
        self._bridge.iteration += 1
        state = self._in_thread(lambda: jax.block_until_ready(self._step(self._state)))
        self._state = state
        self.steps.append(_on_host(state))

    def _initial_state(self) -> Any:
        keys = random.split(random.key(self._key_number), self._n_chains)
        state = jax.block_until_ready(self._kernel.init(keys, 0, None, (), {}))
        for field in ("z", "sim_seed", "rng_key"):
            if not hasattr(state, field):
                raise InvalidSettingError(
                    f"the state of kernel {type(self._kernel).__name__} has no field {field!r}"
                )
        return state

    def _nothing_completed(self) -> SimulationError:
        if not self._bridge.records:
            return SimulationError("no initial hypothesis has prior mass: nothing was simulated")
        first = self._bridge.records[0].result
        return SimulationError(
            f"all initial simulations failed; the first, of [{first.hypothesis}] with seed "
            f"{first.seed}: {first.failure}"
        )

    def _in_thread(self, work: Callable[[], Result]) -> Result:
        def on_cpu() -> Result:
            # the programs are tiny, and the same everywhere; an accelerator would not help
            with jax.default_device(jax.local_devices(backend="cpu")[0]):
                return work()

        with futures.ThreadPoolExecutor(1, thread_name_prefix="phase_ppl") as executor:
            future = executor.submit(on_cpu)
            try:
                while not future.done():
                    futures.wait([future], timeout=POLL_SECONDS)
            except KeyboardInterrupt:
                self._runner.cancel()
                with contextlib.suppress(BaseException):
                    future.result()
                raise
            try:
                return future.result()
            except Exception:
                failure = self._bridge.failure
                if failure is None:
                    raise
            raise failure


def _on_host(state: Any) -> Step:
    sites = {name: np.asarray(value) for name, value in state.z.items()}
    seed = np.asarray(state.sim_seed).astype(np.int64)
    window = getattr(state, "window", np.full(seed.shape, -1))
    accepted = getattr(state, "accepted", np.zeros(seed.shape, bool))
    return Step(sites, seed, np.asarray(accepted).astype(bool), np.asarray(window).astype(np.int64))
