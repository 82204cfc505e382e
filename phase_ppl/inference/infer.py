"""``infer`` returns the posterior of an event; ``resume`` continues a run from its checkpoint."""

from __future__ import annotations

import dataclasses
import functools
import os
import warnings
from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any, Final, overload

from phase_ppl.analysis.verdict import ODD_PACE
from phase_ppl.data.load import load_event
from phase_ppl.data.motion import odd_pace
from phase_ppl.inference.settings import (
    KERNEL,
    Budget,
    SimpleSettings,
    check_event,
    check_settings,
)
from phase_ppl.models.density import on_cpu
from phase_ppl.models.likelihood import is_closed_loop
from phase_ppl.models.model import Model
from phase_ppl.world.errors import InvalidSettingError, OutputError, instance_of, shown
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, check_output, locked

if TYPE_CHECKING:
    from phase_ppl.agents.config import PlannerConfig
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
    from phase_ppl.analysis.posterior import Posterior
    from phase_ppl.inference.checkpoint import Checkpoint
    from phase_ppl.inference.run import Kernel, Run

CHAINS: Final = 15  # M, the paper's number of particles


@overload
def infer(
    event: str | os.PathLike[str] | Event,
    model: Model | None = None,
    *,
    kernel: None = None,
    seed: int = 0,
    planner: str | PlannerConfig | None = None,
    workers: int | None = None,
    progress: bool | None = None,
) -> ClosedLoopPosterior: ...
@overload
def infer(
    event: str | os.PathLike[str] | Event | ClosedLoopPosterior,
    model: Model | None = None,
    *,
    kernel: Kernel,
    **options: Any,
) -> Posterior: ...
@on_cpu()
def infer(
    event: str | os.PathLike[str] | Event | ClosedLoopPosterior,
    model: Model | None = None,
    *,
    kernel: Kernel | None = None,
    chains: int = CHAINS,
    iterations: int | None = None,
    seed: int = 0,
    planner: str | PlannerConfig | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    budget: Budget | None = None,
    on_failure: str = "reject",
    simulation_seconds: float | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
    settings: SimpleSettings | None = None,
    weights: str | None = None,
    **kernel_options: Any,
) -> Posterior | ClosedLoopPosterior:
    """Return the posterior over goals, relation and strengths, given the video.

    Without a kernel, the closed loop reads the video once under all hypotheses. It predicts every
    frame from the frames before it. The result is a :class:`phase_ppl.ClosedLoopPosterior`. It has
    the posterior at every moment of the video.

    With a kernel, hypotheses are sampled. The result is a :class:`phase_ppl.Posterior`.
    ``kernel="local_mh"`` is SIMPLE, the paper's inference. It simulates each hypothesis and
    compares the simulation with the whole video.

    A kernel can also sample from a result of the closed loop, as in
    ``infer(infer(event), kernel="smc")``. This tests the kernel: nothing is simulated, and the
    exact answer is known.

    A run of fewer than 20 iterations weighs all simulations, accepted or not, if the densities of
    the kernel's proposals are known, as SIMPLE's are. At its end, rivals of the leading goals are
    simulated, unless they were before. A rival is a hypothesis in which one agent wants the same
    thing at another landmark. Rivals count in the posterior, not in the chains. They cost each
    particle one to three further simulations, and are left out if there is a ``budget``.

    Only ``event.scene`` and ``event.observation`` are used; the id is kept as a name. Results
    depend on ``seed``, not on the number of workers.

    The treatment of failed simulations (``on_failure``) is part of the model:

    * "reject": the likelihood is zero. If a third of a hypothesis's simulations fail, its mean
      likelihood is a third lower.
    * "raise": the run ends with the error.

    Args:
        event: the event to explain, or the name of an event file or of a bundled event. With a
            kernel, also a result of the closed loop.
        model: prior, simulator and likelihood; by default the paper's prior and simulator.
        kernel: how to sample: a name of :func:`phase_ppl.available_kernels`, a kernel class, or a
            function that takes the event's :class:`phase_ppl.EventProgram` and returns a NumPyro
            kernel. None: the closed loop reads the video.
        chains: number of particles, M in the paper; each is a chain. Default: 15.
        iterations: number of draws per particle, L in the paper. Default: 6, or 1000 on a result of
            the closed loop.
        seed: a whole number >= 0, the seed of everything random.
        planner: settings of the package's own planner: "fast" (the default), "paper", another name
            of :meth:`phase_ppl.PlannerConfig.named`, or a ``PlannerConfig``. It replaces the
            model's.
        workers: number of processes, or of the closed loop's threads; by default one per usable
            core. With an ``executor``: how many simulations to give it at a time; by default all.
        executor: any PEP 3148 executor to simulate in, such as that of a ``dask.distributed``
            client. It is not shut down.
        budget: limit on the cost, in place of ``iterations``: ``phase_ppl.simulations(n)``,
            ``phase_ppl.frames(n)`` or ``phase_ppl.seconds(n)``. The initial particles count, and
            are simulated in any case. The last iteration may exceed a budget of simulations or
            frames; such a run also ends after 100 iterations in a row without a simulation.
        on_failure: "reject" or "raise", see above.
        simulation_seconds: seconds after which a simulation fails; by default never. With a budget
            of seconds, no initial simulation may take longer than the budget.
        checkpoint: new file, ending in .ckpt, for :func:`phase_ppl.resume`. It is written after the
            initial particles and after every iteration. It must not exist yet.
        progress: whether to show a bar on stderr; None: if stderr is a terminal.
        settings: settings of SIMPLE; by default those of the preset "simple".
        weights: "count": the chains' draws count, alike or by the kernel's own weights.
            "stratified": all simulations count, accepted or not (see the glossary). Default: the
            one that is valid for the kernel and the length. In chains of twenty or more draws the
            first quarter is burn-in: it is kept and does not count. ``Posterior(post.tree,
            burn_in=0)`` counts it.
        **kernel_options: options of the kernel, such as ``rule="paper"``.

    Raises:
        InvalidSettingError, UnknownNameError: a setting cannot be used.
        InvalidEventError: ``event`` is no event, or cannot be read.
        OutputError: the checkpoint exists, or cannot be written.
        SimulationError: all initial simulations failed; or, with "raise", one simulation failed.
        Interrupted: Ctrl-C while a kernel samples.
        ClosedLoopInterrupted: Ctrl-C while the closed loop reads.

    Any error that ends a run has the posterior so far as its attribute ``posterior``. It is None if
    the initial particles were not complete.
    """
    options: dict[str, Any] = {
        "iterations": iterations,
        "budget": budget,
        "on_failure": on_failure,
        "simulation_seconds": simulation_seconds,
        "executor": executor,
        "checkpoint": checkpoint,
        "weights": weights,
    }
    if "preset" in kernel_options:
        raise InvalidSettingError(
            f"preset={shown(kernel_options['preset'])} stands for several arguments: write "
            "infer(event, **phase_ppl.preset(...))"
        )
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior

    if isinstance(event, str | os.PathLike):
        event = load_event(event)
    if kernel is None:
        of_sampling = {**options, "chains": chains, "settings": settings, **kernel_options}
        usual = {"on_failure": "reject", "chains": CHAINS}
        for name, value in of_sampling.items():
            if value != usual.get(name):
                raise InvalidSettingError(
                    f"{name}={shown(value)} is for sampling, and no kernel is named: add "
                    f'kernel="{KERNEL}", which is SIMPLE, or another; without one the closed loop '
                    "sums over all hypotheses"
                )
        from phase_ppl.inference.closed_loop import filtered_frames

        model = _complete_model(model, planner)
        event = check_event(event)
        _check_rate(event, model)
        found = filtered_frames(event, model, seed, workers, progress)
        return ClosedLoopPosterior(found, prior=model.prior)
    from phase_ppl.inference.run import Run
    from phase_ppl.inference.sampler import RunOptions, sample

    given = RunOptions(**options, workers=workers, progress=progress)
    settings = SimpleSettings() if settings is None else settings
    check_settings(settings)
    of_run = kernel, kernel_options, settings, chains, seed
    if isinstance(event, ClosedLoopPosterior):
        from phase_ppl.inference.table_run import event_of, model_of, sample_table

        if planner is not None:
            raise InvalidSettingError(
                f"planner={shown(planner)} is for simulations: the video was read before"
            )
        model = model_of(event, model)
        return sample_table(event, Run(event_of(event), model, *of_run), given)
    model = _complete_model(model, planner)
    run = Run(check_event(event), model, *of_run)
    if is_closed_loop(model.likelihood):
        from phase_ppl.inference.table_run import check_looked_up, sample_table

        check_looked_up(given)
        run.check(iterations, budget)  # before it is read
        read = infer(event, model, seed=seed, workers=workers, progress=progress)
        return sample_table(read, run, given)
    if checkpoint is not None:
        from phase_ppl.inference.checkpoint import SUFFIXES

        if as_path(checkpoint).exists():
            raise OutputError(
                f"{checkpoint} exists and may hold a run: continue it with phase_ppl.resume, or "
                "delete it"
            )
        check_output(checkpoint, SUFFIXES)
    with locked(checkpoint):
        return sample(run, given, checked=functools.partial(_check_rate, event, model, 5))


@on_cpu()
def resume(
    path: str | os.PathLike[str],
    event: Event | None = None,
    model: Model | None = None,
    *,
    kernel: Kernel | None = None,
    iterations: int | None = None,
    planner: str | PlannerConfig | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    budget: Budget | None = None,
    progress: bool | None = None,
    settings: SimpleSettings | None = None,
    other_versions: bool = False,
    **kernel_options: Any,
) -> Posterior:
    """Continue a run from the checkpoint of ``infer(..., checkpoint=path)``; return its posterior.

    The draws equal those of an uninterrupted run, with any number of workers. The checkpoint is
    kept up to date. The posterior of a complete run is returned at once; a larger number of
    ``iterations`` extends the run.

    A checkpoint that another version of this package or its dependencies wrote is refused unless
    ``other_versions`` is true: the result could change.

    Args:
        path: the checkpoint's file.
        event: the event, to check that the run is about it. Optional: the file holds the event.
        model: the run's model; needed if its prior, simulator or likelihood is your own, since a
            file holds no code.
        kernel: the run's kernel; needed if it was not given by name.
        iterations, budget: length of the whole run, including what was done before; by default the
            length that was asked for before.
        planner: the run's planner, if it is not in ``model``.
        workers, executor, progress: as in :func:`phase_ppl.infer`.
        other_versions: whether to continue a run of other versions. The attributes ``versions`` and
            ``earlier_versions`` of the posterior's tree keep all versions.
        settings, **kernel_options: the run's settings of SIMPLE and options of the kernel; needed
            if they have values other than plain data, such as functions.

    Raises:
        InvalidEventError: there is no such file, or it is damaged or no checkpoint.
        InvalidSettingError: event, model, kernel or version differs from the run's (the message
            says how), one of them must be given, or a setting cannot be used.
        OutputError: the checkpoint cannot be written.
        SimulationError, Interrupted: as in :func:`phase_ppl.infer`.
    """
    from phase_ppl.inference import run as runs
    from phase_ppl.inference.checkpoint import SUFFIXES, Checkpoint
    from phase_ppl.inference.sampler import RunOptions, sample
    from phase_ppl.world.identity import versions_so_far

    began = runs.clock()
    saved = Checkpoint(path)
    if settings is None:
        stored = _stored(saved, "settings", "the settings {settings} are not all plain data")
        settings = saved.made(SimpleSettings, stored)
    check_settings(settings)
    if model is None:
        own = "prior {model[prior]}, simulator {model[simulator]}, {model[likelihood]}"
        reason = f"the model has parts of its own ({own}), which a file cannot hold"
        model = saved.made(runs.model_again, {"stored": _stored(saved, "model", reason)})
    if kernel is None:
        reason = "the kernel {kernel[name]} was given as an object, which a file cannot hold"
        kernel = _stored(saved, "kernel", reason)
    if not kernel_options:
        reason = "the kernel options {kernel[options]} are not all plain data"
        kernel_options = _stored(saved, "options", reason)
    run = runs.Run(
        saved.event if event is None else event,
        _complete_model(model, planner),
        kernel,
        kernel_options,
        settings,
        saved.identity["chains"],
        saved.identity["seed"],
    )
    _check_same(saved, run)
    if iterations is None and budget is None:
        iterations, budget = saved.asked["iterations"], saved.asked["budget"]
    check_output(path, SUFFIXES)
    versions = saved.versions
    if budget is not None or iterations != saved.done:
        versions = versions_so_far(saved.versions, path, other_versions)
    options = RunOptions(
        **{**saved.asked, "iterations": iterations, "budget": budget},
        workers=workers,
        executor=executor,
        progress=progress,
        checkpoint=path,
        versions=versions,
        began=began,
    )
    with locked(path):
        return sample(run, options, saved)


def _check_rate(event: Event, model: Model, level: int = 4) -> None:
    """Warn of tracks that the joint simulator's agents can make at another frame rate only."""
    if model.simulator is None and (pace := odd_pace(event.observation.trajectory, event.scene)):
        warnings.warn(f"event {shown(event.id)}: {ODD_PACE[pace]}", stacklevel=level)


def _complete_model(model: Model | None, planner: str | PlannerConfig | None) -> Model:
    """Return the model with the planner, the paper's model by default."""
    model = Model() if model is None else model
    instance_of("model", model, Model, "a phase_ppl.Model")
    return model if planner is None else dataclasses.replace(model, planner=planner)


def _stored(saved: Checkpoint, name: str, reason: str) -> Any:
    """Return a stored part of a run; InvalidSettingError: it must be given again."""
    if saved.again[name] is None:
        argument = "**options" if name == "options" else f"{name}=..."
        raise InvalidSettingError(
            f"{saved.path}: {reason.format(**saved.identity)}: give it again, "
            f"resume(path, {argument})"
        )
    return saved.again[name]


def _check_same(saved: Checkpoint, run: Run) -> None:
    from phase_ppl.world.identity import differences, event_digest

    if event_digest(run.event) != saved.identity["event"]:
        raise InvalidSettingError(
            f"{saved.path} is a run of another event ({saved.event.id!r}): its scene or "
            "observation differ"
        )
    found = differences(saved.identity, run.identity())
    if found:
        raise InvalidSettingError(f"{saved.path} is another run: {'; '.join(found)}")
