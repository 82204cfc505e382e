"""Inference: from an event and a model to a posterior."""

from __future__ import annotations

import dataclasses
import platform
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, NoReturn

import jax
from jax import random
from tqdm import tqdm

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.inference.draws import Chains, make_tree
from phase_ppl.inference.program import Program
from phase_ppl.inference.proposals import bottom_up
from phase_ppl.inference.registry import kernel_info, make_kernel
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.model import Model
from phase_ppl.simulator.contract import Cancelled, SimulationResult
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.errors import InvalidSettingError, PhasePPLError, SimulationError
from phase_ppl.world.event import Event

__all__ = ["Interrupted", "SimpleSettings", "Simulations", "infer", "simulations"]

CHAINS = 15
"""M, the paper's number of particles."""

ITERATIONS = 6
"""L, the paper's number of iterations."""

_POLL_SECONDS = 0.1


@dataclasses.dataclass(frozen=True)
class Simulations:
    """A budget: at most this many simulations, initial ones included."""

    count: int


def simulations(count: int) -> Simulations:
    """Return a budget of ``count`` simulations, for ``infer(budget=...)``."""
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise InvalidSettingError(f"simulations({count!r}), expected a whole number >= 1")
    return Simulations(count)


class Interrupted(PhasePPLError):
    """A run was interrupted.

    Attributes:
        posterior: of what was done until then; None if the initial particles were not complete.
    """

    def __init__(self, posterior: Posterior | None) -> None:
        self.posterior = posterior
        kept = "nothing was complete yet" if posterior is None else "see .posterior"
        super().__init__(f"the run was interrupted; {kept}")


def infer(
    event: Event,
    model: Model | None = None,
    *,
    kernel: str | Callable[[Program], Any] = "local_mh",
    chains: int = CHAINS,
    iterations: int | None = None,
    budget: Simulations | None = None,
    seed: int = 0,
    planner: str | PlannerConfig | None = None,
    settings: SimpleSettings | None = None,
    workers: int | None = None,
    progress: bool = True,
    **kernel_options: Any,
) -> Posterior:
    """Infer who wants what.

    Args:
        event: only its scene and observation are read.
        model: prior, simulator and likelihood; default SIMPLE's.
        kernel: name of a registered kernel, or a factory that makes one from a program.
        chains: M, number of particles.
        iterations: L, draws per chain; default 6.
        budget: ``ppl.simulations(n)`` instead of iterations; the initial ones count.
        seed: the same seed gives the same posterior, whatever the number of workers.
        planner: "fast", "paper" or a ``PlannerConfig``, instead of the model's.
        settings: eta, gamma, Delta T and the rest of SIMPLE's proposals.
        workers: processes that simulate; None: one per usable core.
        progress: show a bar in simulations.
        **kernel_options: passed to the kernel, such as ``rule="paper"``.

    Raises:
        UnknownNameError: an unknown kernel or planner.
        InvalidSettingError: a number outside its range, or a prior that cannot work.
        SimulationError: all initial simulations failed.
        Interrupted: Ctrl-C; carries the posterior of what was done.
    """
    model = Model() if model is None else model
    if planner is not None:
        model = dataclasses.replace(model, planner=planner)
    settings = SimpleSettings() if settings is None else settings
    _check_counts(chains=chains, iterations=iterations, seed=seed)
    n_iterations = _iterations(iterations, budget, chains, kernel)
    if isinstance(kernel, str):
        kernel_info(kernel)
    observation = event.observation
    with Runner(model.make_simulator(), event.scene, observation, workers=workers) as runner:
        bridge = SimulatorBridge(runner, model.noise)
        program = Program(
            prior=model.prior,
            bridge=bridge,
            likelihood=model.likelihood,
            proposals=bottom_up(event.scene, observation, settings),
            n_frames=observation.n_frames,
            own_sites=model.own_sites(),
        )
        name = kernel if isinstance(kernel, str) else getattr(kernel, "__name__", str(kernel))
        chosen = (
            make_kernel(kernel, program, **kernel_options)
            if isinstance(kernel, str)
            else kernel(program, **kernel_options)
        )
        run = _Run(chosen, runner, bridge, chains, n_iterations, seed, progress)
        begin = time.perf_counter()
        interrupted = run.drive()
        wall = time.perf_counter() - begin
    if run.initial is None:
        raise Interrupted(None)
    attributes = {
        "kernel": name,
        "validity": _validity(chosen, kernel),
        "settings": {
            "kernel": {"name": name, **kernel_options},
            "chains": chains,
            "iterations": n_iterations,
            "seed": seed,
            "turning": event.scene.turning,
            "n_frames": observation.n_frames,
            "simple": settings.to_dict(),
            "model": model.to_dict(),
            "interrupted_after": len(run.states) if interrupted else None,
        },
        "cost": _cost(runner, wall),
    }
    tree = make_tree(event, program, Chains(run.initial, run.states), bridge.records, attributes)
    posterior = Posterior(tree)
    if interrupted:
        raise Interrupted(posterior)
    return posterior


def _check_counts(chains: int, iterations: int | None, seed: int) -> None:
    for name, value, least in (("chains", chains, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise InvalidSettingError(f"{name}={value!r}, expected a whole number >= {least}")
    if iterations is not None and (not isinstance(iterations, int) or iterations < 1):
        raise InvalidSettingError(f"iterations={iterations!r}, expected a whole number >= 1")


def _iterations(
    iterations: int | None,
    budget: Simulations | None,
    chains: int,
    kernel: str | Callable[[Program], Any],
) -> int:
    if budget is None:
        return ITERATIONS if iterations is None else iterations
    if iterations is not None:
        raise InvalidSettingError("give either iterations or a budget, not both")
    per_step = kernel_info(kernel).sims_per_step if isinstance(kernel, str) else 1
    affordable = int((budget.count - chains) // (chains * per_step))
    if affordable < 1:
        least = int(chains * (1 + per_step))
        raise InvalidSettingError(
            f"a budget of {budget.count} simulations is too small: {chains} chains need {least} "
            "for the initial particles and one iteration"
        )
    return affordable


def _validity(kernel: Any, asked: str | Callable[[Program], Any]) -> str:
    if hasattr(kernel, "validity"):
        return str(kernel.validity)
    return kernel_info(asked).validity if isinstance(asked, str) else "unknown"


def _cost(runner: Runner, wall: float) -> dict[str, Any]:
    statistics = runner.statistics
    return {
        "simulations": statistics.simulations,
        "frames": statistics.frames,
        "frames_saved": statistics.frames_saved,
        "failures": statistics.failures,
        "retries": statistics.retries,
        "seconds": round(wall, 3),
        "seconds_simulating": round(statistics.seconds_simulating, 3),
        "seconds_overhead": round(wall - statistics.seconds_waiting, 3),
        "workers": runner.workers,
        "host": platform.node(),
    }


class _Run:
    """Drives a kernel one iteration at a time, so that an interrupt loses nothing."""

    def __init__(
        self,
        kernel: Any,
        runner: Runner,
        bridge: SimulatorBridge,
        chains: int,
        iterations: int,
        seed: int,
        progress: bool,
    ) -> None:
        self.kernel = kernel
        self.runner = runner
        self.bridge = bridge
        self.chains = chains
        self.iterations = iterations
        self.keys = random.split(random.key(seed), chains)
        self.progress = progress
        self.initial: Any = None
        self.states: list[Any] = []

    def drive(self) -> bool:
        """Run all iterations; return whether it was interrupted.

        The compiled steps run in a thread of their own: the main thread stays free to notice
        Ctrl-C, which a thread inside compiled code does not.
        """
        total = self.chains * (1 + self.iterations)
        with tqdm(
            total=total,
            desc="simulations",
            unit="sim",
            file=sys.stderr,
            disable=not self.progress,
            dynamic_ncols=True,
        ) as bar:
            self.runner.on_result = lambda _: bar.update()
            thread = threading.Thread(target=self._work, args=(bar,), daemon=True)
            self._failure: BaseException | None = None
            thread.start()
            try:
                while thread.is_alive():
                    thread.join(_POLL_SECONDS)
            except KeyboardInterrupt:
                self.runner.cancel()
                thread.join()
                return True
            # rows outside the prior's support cost no simulation
            bar.total = bar.n
            bar.refresh()
        if self._failure is not None:
            raise self._failure
        return False

    def _work(self, bar: Any) -> None:
        try:
            init = jax.jit(lambda keys: self.kernel.init(keys, 0, None, (), {}))
            step = jax.jit(lambda state: self.kernel.sample(state, (), {}))
            state = jax.block_until_ready(init(self.keys))
            self._check_initial([record.result for record in self.bridge.records])
            self.initial = jax.device_get(_plain(state))
            for _ in range(self.iterations):
                state = jax.block_until_ready(step(state))
                self.states.append(jax.device_get(_plain(state)))
                rate = float(state.accepted.mean()) if hasattr(state, "accepted") else None
                bar.set_postfix_str("" if rate is None else f"accepted {rate:.0%}")
        except Exception as error:
            cause = self.bridge.error or error
            if not isinstance(cause, Cancelled):
                self._failure = cause

    def _check_initial(self, results: list[SimulationResult]) -> None:
        failed = [r for r in results if r.failure is not None]
        if results and len(failed) == len(results):
            _raise_failed(failed[0])


def _raise_failed(result: SimulationResult) -> NoReturn:
    raise SimulationError(
        f"all initial simulations failed; the first, [{result.hypothesis}] with seed "
        f"{result.seed}: {result.failure}"
    )


def _plain(state: Any) -> Any:
    """Return a state without its random key, which NumPy cannot hold."""
    return state._replace(rng_key=None) if hasattr(state, "_replace") else state
