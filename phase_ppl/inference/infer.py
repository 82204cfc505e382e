"""From an event to a posterior."""

from __future__ import annotations

import dataclasses
import json
import platform
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.inference.chains import Chains, Step
from phase_ppl.inference.draws import build_tree
from phase_ppl.inference.guide import bottom_up_guide
from phase_ppl.inference.progress import Progress
from phase_ppl.inference.proposals import bottom_up_tables
from phase_ppl.inference.registry import Factory, KernelInfo, described
from phase_ppl.inference.settings import Budget, SimpleSettings, simulations, whole_number
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram, event_salt
from phase_ppl.simulator.contract import Cancelled
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event

if TYPE_CHECKING:
    from phase_ppl.agents.config import PlannerConfig

__all__ = ["Budget", "Interrupted", "SimpleSettings", "infer", "simulations"]


class Interrupted(KeyboardInterrupt):  # noqa: N818  (as KeyboardInterrupt itself)
    """The run was interrupted; what was done until then is kept.

    A ``KeyboardInterrupt``, so that no ``except Exception`` in a loop over events swallows it.

    Attributes:
        posterior: of the iterations that were finished, of the initial particles where none
            was; None where not even those were.
    """

    def __init__(self, message: str, posterior: Posterior | None) -> None:
        super().__init__(message)
        self.posterior = posterior


def infer(
    event: Event,
    model: Model | None = None,
    *,
    kernel: str | Factory | MCMCKernel = "local_mh",
    chains: int = 15,
    iterations: int = 6,
    seed: int = 0,
    planner: str | PlannerConfig | None = None,
    workers: int | None = None,
    budget: Budget | None = None,
    progress: bool | None = None,
    settings: SimpleSettings | None = None,
) -> Posterior:
    """Return the posterior over goals, relation and strengths, given what was seen.

    Only ``event.scene`` and ``event.observation`` are read. The same seed gives the same result
    with any number of workers.

    Args:
        event: what to explain.
        model: prior, simulator and likelihood; by default the paper's.
        kernel: a name (:func:`phase_ppl.available_kernels`), a kernel class or a function that
            makes a NumPyro kernel from the program of the event, or an instance of one of ours.
        chains: particles M.
        iterations: L; the draws per particle.
        seed: a whole number >= 0.
        planner: "fast" (the default), "paper" or a ``PlannerConfig``, for the joint simulator.
        workers: processes; by default one per usable core.
        budget: ``phase_ppl.simulations(n)``: as many iterations as n simulations allow, the
            initial ones included, instead of ``iterations``.
        progress: whether to show a bar on stderr; by default where that is a terminal.
        settings: of SIMPLE; by default the paper's.

    Raises:
        InvalidSettingError, UnknownNameError: a setting that cannot be used.
        InvalidEventError: ``event`` is no event.
        SimulationError: all initial simulations failed.
        Interrupted: Ctrl-C; it carries what was done.
    """
    begin = time.perf_counter()
    if not isinstance(event, Event):
        raise InvalidEventError(f"{shown(event)} is no event; phase_ppl.load_event reads one")
    settings = SimpleSettings() if settings is None else settings
    model = _model(model, planner, settings)
    chosen = described(kernel)
    whole_number("chains", chains)
    whole_number("seed", seed, minimum=0)
    if budget is None:
        whole_number("iterations", iterations)
    else:
        iterations = budget.iterations(chains, chosen.sims_per_step)

    scene, observation = event.scene, event.observation
    n_simulations = chains * (1 + iterations * chosen.sims_per_step)
    with Runner(model.build_simulator(), scene, observation, workers=workers) as runner:
        bridge = SimulatorBridge(runner, observation.n_frames)
        salt = event_salt(scene, observation)
        program = EventProgram(model, bridge, observation.n_frames, salt)
        built = chosen.factory(program, **_supplies(chosen, event, model, settings))
        run = Chains(built, bridge, runner, chains, seed)
        interrupted = False
        with Progress(n_simulations, progress) as bar:
            runner.on_result = bar.one_more
            try:
                run.initialise()
                for done in range(iterations):
                    bar.reach(chains * (1 + done * chosen.sims_per_step))
                    run.advance()
                bar.reach(n_simulations)
            except (KeyboardInterrupt, Cancelled):
                interrupted = True
    if run.start is None:
        raise Interrupted("interrupted before the initial particles were simulated", None)
    steps = run.steps or [run.start]
    tree = build_tree(
        event,
        model.likelihood,
        steps,
        bridge.records,
        {
            "kernel": chosen.name,
            "validity": getattr(built, "validity", chosen.validity),
            "settings": json.dumps(_settings(chosen, model, settings, chains, run.steps, seed)),
            "cost": json.dumps(_cost(runner, begin, interrupted)),
        },
    )
    posterior = Posterior(tree)
    if interrupted:
        message = f"interrupted after {len(run.steps)} of {iterations} iterations"
        raise Interrupted(message, posterior)
    return posterior


def _model(
    model: Model | None, planner: str | PlannerConfig | None, settings: SimpleSettings
) -> Model:
    model = Model() if model is None else model
    if planner is not None:
        model = dataclasses.replace(model, planner=planner)
    if settings.beta is not None:
        if not isinstance(model.likelihood, RadialLikelihood):
            raise InvalidSettingError(
                "beta is that of the radial likelihood; the model has another"
            )
        model = dataclasses.replace(model, likelihood=RadialLikelihood(settings.beta))
    return model


def _supplies(
    chosen: KernelInfo, event: Event, model: Model, settings: SimpleSettings
) -> dict[str, Any]:
    supplies: dict[str, Any] = {}
    if "settings" in chosen.needs:
        supplies["settings"] = settings
    if "guide" in chosen.needs:
        tables = bottom_up_tables(
            event.scene,
            event.observation,
            window=settings.window,
            gamma=settings.gamma,
            sign=settings.sign,
        )
        supplies["guide"] = bottom_up_guide(
            model.prior, model.sites, tables, prior_share=settings.prior_share
        )
    return supplies


def _settings(
    chosen: KernelInfo,
    model: Model,
    settings: SimpleSettings,
    chains: int,
    steps: Sequence[Step],
    seed: int,
) -> dict[str, Any]:
    """Return all that determines the result; an interrupted run equals a shorter one."""
    record = dataclasses.asdict(settings)
    del record["beta"]  # the likelihood of the model says it
    return {
        "kernel": chosen.name,
        "chains": chains,
        "iterations": len(steps),
        "seed": seed,
        **record,
        **model.fingerprint(),
    }


def _cost(runner: Runner, begin: float, interrupted: bool) -> dict[str, Any]:
    """Return what the run cost; seconds are of wall time unless they say otherwise."""
    statistics = runner.statistics
    seconds = time.perf_counter() - begin
    return {
        "simulations": statistics.simulations,
        "frames": statistics.frames,
        "frames_saved": statistics.frames_saved,
        "failures": statistics.failures,
        "retries": statistics.retries,
        "seconds": seconds,
        "seconds_simulating": statistics.seconds_simulating,  # summed over workers
        "seconds_waiting": statistics.seconds_waiting,
        "seconds_overhead": seconds - statistics.seconds_waiting,
        "workers": runner.workers,
        "host": f"{platform.node()} ({platform.system()}, {platform.machine()})",
        "interrupted": interrupted,
    }
