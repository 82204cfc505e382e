"""From an event to a posterior."""

from __future__ import annotations

import dataclasses
import json
import platform
import time
from typing import TYPE_CHECKING, Any, Final

from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.inference.chains import Chains, EventData, Recipe
from phase_ppl.inference.draws import build_tree
from phase_ppl.inference.progress import Progress
from phase_ppl.inference.proposals import bottom_up_tables
from phase_ppl.inference.registry import Factory, KernelInfo, described
from phase_ppl.inference.settings import Budget, SimpleSettings, simulations, whole_number
from phase_ppl.inference.strength.estimators import estimator_name
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.models.program import event_salt
from phase_ppl.simulator.contract import Cancelled
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event

if TYPE_CHECKING:
    from phase_ppl.agents.config import PlannerConfig

__all__ = ["Budget", "Interrupted", "SimpleSettings", "infer", "simulations"]


CHAINS: Final = 15
"""M, the paper's number of particles."""

ITERATIONS: Final = 6
"""L, the paper's number of iterations."""


class Interrupted(KeyboardInterrupt):
    """The run was interrupted; what was done until then is kept.

    A ``KeyboardInterrupt``, so that no ``except Exception`` in a loop over events swallows it.

    Attributes:
        posterior: of the iterations that were finished, of the initial particles where none
            was; None where not even those were.
    """

    def __init__(self, posterior: Posterior | None) -> None:
        kept = "nothing was complete yet" if posterior is None else "see .posterior"
        super().__init__(f"the run was interrupted; {kept}")
        self.posterior = posterior


def infer(
    event: Event,
    model: Model | None = None,
    *,
    kernel: str | Factory | MCMCKernel = "local_mh",
    chains: int = CHAINS,
    iterations: int | None = None,
    seed: int = 0,
    planner: str | PlannerConfig | None = None,
    workers: int | None = None,
    budget: Budget | None = None,
    progress: bool | None = None,
    settings: SimpleSettings | None = None,
    **kernel_options: Any,
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
        iterations: L, the draws per particle; by default 6.
        seed: a whole number >= 0.
        planner: "fast" (the default), "paper" or a ``PlannerConfig``, for the joint simulator.
        workers: processes; by default one per usable core.
        budget: ``phase_ppl.simulations(n)`` instead of ``iterations``: as many as n simulations
            allow, the initial ones included.
        progress: whether to show a bar on stderr; by default where that is a terminal.
        settings: of SIMPLE; by default the paper's.
        **kernel_options: for the kernel, such as ``rule="paper"``.

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
    n_iterations = _iterations(iterations, budget, chains, chosen)

    scene, observation = event.scene, event.observation
    options = tuple(kernel_options.items())
    recipe = Recipe(chosen, options, model, settings, observation.n_frames)
    n_simulations = chains * (1 + n_iterations * chosen.sims_per_step)
    with Runner(model.build_simulator(), scene, observation, workers=workers) as runner:
        bridge = SimulatorBridge(runner, observation.n_frames)
        tables = bottom_up_tables(
            scene,
            observation,
            window=settings.window,
            gamma=settings.gamma,
            sign=settings.sign,
            strength=settings.strength,
        )
        data = EventData(tables, event_salt(scene, observation), bridge.handle)
        built = recipe.build(data)
        run = Chains(recipe, data, bridge, runner, chains, seed)
        interrupted = False
        with Progress(n_simulations, progress) as bar:
            runner.on_result = bar.one_more
            try:
                run.initialise()
                for done in range(n_iterations):
                    bar.reach(chains * (1 + done * chosen.sims_per_step))
                    run.advance()
                bar.reach(n_simulations)
            except (KeyboardInterrupt, Cancelled):
                interrupted = True
    if run.start is None:
        raise Interrupted(None)
    steps = run.steps or [run.start]
    tree = build_tree(
        event,
        model,
        steps,
        bridge.records,
        {
            "kernel": chosen.name,
            "validity": getattr(built, "validity", chosen.validity),
            "settings": json.dumps(
                {
                    "kernel": {"name": chosen.name, **kernel_options},
                    "chains": chains,
                    "iterations": len(run.steps),  # an interrupted run equals a shorter one
                    "seed": seed,
                    "turning": scene.turning,
                    "simple": _plain(settings),
                    "model": model.fingerprint(),
                },
                default=repr,
            ),
            "cost": json.dumps(_cost(runner, begin, interrupted)),
        },
    )
    posterior = Posterior(tree)
    if interrupted:
        raise Interrupted(posterior)
    return posterior


def _iterations(
    iterations: int | None, budget: Budget | None, chains: int, chosen: KernelInfo
) -> int:
    if budget is None:
        return ITERATIONS if iterations is None else whole_number("iterations", iterations)
    if iterations is not None:
        raise InvalidSettingError("give either iterations or a budget, not both")
    return budget.iterations(chains, chosen.sims_per_step)


def _model(
    model: Model | None, planner: str | PlannerConfig | None, settings: SimpleSettings
) -> Model:
    model = Model() if model is None else model
    if planner is not None:
        model = dataclasses.replace(model, planner=planner)
    if settings.beta is not None:
        if not isinstance(model.likelihood, RadialLikelihood):
            raise InvalidSettingError("beta is of the radial likelihood; the model has another")
        model = dataclasses.replace(model, likelihood=RadialLikelihood(settings.beta))
    return model


def _plain(settings: SimpleSettings) -> dict[str, Any]:
    """Return the settings; beta is left to the model's likelihood, which has it."""
    plain = {f.name: getattr(settings, f.name) for f in dataclasses.fields(settings)}
    return {k: v for k, v in plain.items() if k != "beta"} | {
        "strength": estimator_name(settings.strength)
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
