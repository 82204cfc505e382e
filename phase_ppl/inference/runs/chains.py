"""Driving the particles, one iteration at a time, so that nothing done is ever lost."""

from __future__ import annotations

import concurrent.futures as futures
import contextlib
import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Final, NamedTuple, Protocol, TypeVar

import jax
import numpy as np
from jax import random
from numpy.typing import NDArray
from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.inference.proposals.guide import bottom_up_guide
from phase_ppl.inference.proposals.tables import BottomUpTables
from phase_ppl.inference.registry import KernelInfo
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.density import compiled_quickly
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError, SimulationError

POLL_SECONDS: Final = 0.1
"""How long Ctrl-C may go unnoticed."""

_KEPT_PROGRAMS: Final = 16

Result = TypeVar("Result")


class EventData(NamedTuple):
    """All that compiled code is told of an event, beside its number of frames.

    Attributes:
        tables: what the windows say.
        salt: stands for the event.
        bridge: handle of the bridge that simulates.
    """

    tables: BottomUpTables
    salt: jax.Array | int
    bridge: jax.Array | int


@dataclasses.dataclass(frozen=True)
class Recipe:
    """How to make the kernel of a run; events with as many frames share a compiled recipe.

    Attributes:
        kernel: what is known of the kernel.
        options: its options, name and value.
        model: prior, simulator, likelihood.
        settings: of SIMPLE.
        n_frames: length T of the observation.
    """

    kernel: KernelInfo
    options: tuple[tuple[str, Any], ...]
    model: Model
    settings: SimpleSettings
    n_frames: int

    def build(self, data: EventData) -> MCMCKernel:
        """Return the kernel for an event."""
        program = EventProgram(self.model, data.bridge, self.n_frames, data.salt)
        supplies: dict[str, Any] = {}
        if "settings" in self.kernel.needs:
            supplies["settings"] = self.settings
        if "guide" in self.kernel.needs:
            supplies["guide"] = bottom_up_guide(
                self.model.prior,
                self.model.sites,
                data.tables,
                prior_share=self.settings.prior_share,
            )
        return self.kernel.make(program, **supplies, **dict(self.options))


class Compiled(NamedTuple):
    """The two compiled functions of a recipe: (keys, data) and (state, data) -> state."""

    init: Callable[[jax.Array, EventData], Any]
    step: Callable[[Any, EventData], Any]


def _compiled(recipe: Recipe) -> Compiled:
    def init(keys: jax.Array, data: EventData) -> Any:
        return recipe.build(data).init(keys, 0, None, (), {})

    def step(state: Any, data: EventData) -> Any:
        kernel = recipe.build(data)
        if getattr(kernel, "_sample_fn", True) is None:
            # NumPyro's own kernels are made ready by init
            jax.eval_shape(lambda keys: kernel.init(keys, 0, None, (), {}), state.rng_key)
        return kernel.sample(state, (), {})

    return Compiled(compiled_quickly(init), compiled_quickly(step))


_compiled_once = functools.lru_cache(_KEPT_PROGRAMS)(_compiled)


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
        log_weight: (chain,) of the draws, up to a constant; 0 where the kernel gives none.
        log_evidence: of the observation, where the kernel estimates it, else NaN.
    """

    sites: dict[str, NDArray[Any]]
    sim_seed: NDArray[np.int64]
    accepted: NDArray[np.bool_]
    window: NDArray[np.int64]
    log_weight: NDArray[np.float64]
    log_evidence: NDArray[np.float64]


class Chains:
    """The particles of one run.

    The compiled step runs in a thread of its own, so that the main thread notices Ctrl-C at
    once: it then cancels the simulations, waits for the thread, and raises KeyboardInterrupt.

    Args:
        recipe: makes the kernel.
        data: of the event.
        bridge: the one that ``data`` names.
        runner: the bridge's.
        n_chains: number of particles M.
        seed: any whole number >= 0.

    Attributes:
        start: the initial particles, once there are any.
        steps: what was done since.
        state: of the kernel, from which the next iteration starts.
    """

    def __init__(
        self,
        recipe: Recipe,
        data: EventData,
        bridge: SimulatorBridge,
        runner: Cancels,
        n_chains: int,
        seed: int,
    ) -> None:
        self.start: Step | None = None
        self.steps: list[Step] = []
        self._data, self._bridge, self._runner = data, bridge, runner
        bridge.defers = True
        self._n_chains = n_chains
        self._key_number = int(np.random.SeedSequence(seed).generate_state(1)[0])
        self.state: Any = None
        try:
            self._compiled = _compiled_once(recipe)
        except TypeError:  # a part of the user's cannot be hashed, so cannot be recognised
            self._compiled = _compiled(recipe)

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
        if not completed.all():
            chain = np.arange(self._n_chains)
            source = [next(c for c in np.roll(chain, -i) if completed[c]) for i in chain]
            copied = jax.tree.map(lambda leaf: leaf[np.array(source)], state)
            state = copied._replace(rng_key=state.rng_key)
            if hasattr(state, "log_weight"):
                weight = jax.numpy.where(completed, state.log_weight, -np.inf)
                state = state._replace(log_weight=weight)
        self.state = state
        self.start = _on_host(state)

    def advance(self) -> None:
        """Do one iteration.

        Raises:
            KeyboardInterrupt: Ctrl-C; the iteration does not count.
        """
        self._bridge.iteration += 1
        step = self._compiled.step
        state = self._in_thread(lambda: step(self.state, self._data))
        self.state = state
        self.steps.append(_on_host(state))

    def blank_state(self) -> Any:
        """Return the shapes and types of the kernel's state; nothing is simulated."""
        with on_cpu():
            return jax.eval_shape(self._compiled.init, self._keys(), self._data)

    def go_on(self, state: Any, start: Step, steps: list[Step]) -> None:
        """Continue another run: from its state, with the steps that it has done."""
        self.state, self.start, self.steps = state, start, steps
        self._bridge.iteration = len(steps)

    def _keys(self) -> jax.Array:
        return random.split(random.key(self._key_number), self._n_chains)

    def _initial_state(self) -> Any:
        state = self._compiled.init(self._keys(), self._data)
        for field in ("z", "sim_seed", "rng_key"):
            if not hasattr(state, field):
                raise InvalidSettingError(
                    f"{type(state).__name__}, the state of the kernel, has no field {field!r}"
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
        def worked() -> Result:
            with on_cpu():
                return jax.block_until_ready(work())

        with futures.ThreadPoolExecutor(1, thread_name_prefix="phase_ppl") as executor:
            future = executor.submit(worked)
            try:
                while not future.done():
                    futures.wait([future], timeout=POLL_SECONDS)
            except KeyboardInterrupt:
                self._runner.cancel()
                with contextlib.suppress(BaseException):
                    future.result()
                raise
            result = future.result()
        if self._bridge.failure is not None:
            raise self._bridge.failure
        return result


def on_cpu() -> contextlib.AbstractContextManager[Any]:
    """Return a context in which JAX works on the processor."""
    # the programs are tiny, and the same everywhere; an accelerator would not help
    return jax.default_device(jax.local_devices(backend="cpu")[0])


def _on_host(state: Any) -> Step:
    sites = {name: np.asarray(value) for name, value in state.z.items()}
    seed = np.asarray(state.sim_seed).astype(np.int64)
    window = getattr(state, "window", np.full(seed.shape, -1))
    accepted = getattr(state, "accepted", np.zeros(seed.shape, bool))
    log_weight = getattr(state, "log_weight", np.zeros(seed.shape))
    log_evidence = getattr(state, "log_evidence", np.full(seed.shape, np.nan))
    return Step(
        sites,
        seed,
        np.asarray(accepted).astype(bool),
        np.asarray(window).astype(np.int64),
        np.asarray(log_weight).astype(np.float64),
        np.asarray(log_evidence).astype(np.float64),
    )
