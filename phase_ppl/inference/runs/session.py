"""One call that begins a run, or goes on with one, and ends it with a posterior."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import platform
import time
import warnings
import weakref
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.inference.proposals.strength import estimator_name
from phase_ppl.inference.runs.chains import Chains, EventData, Recipe
from phase_ppl.inference.runs.checkpoint import Checkpoint, Progressed, Spent, write_checkpoint
from phase_ppl.inference.runs.draws import Drawn, build_tree
from phase_ppl.inference.runs.length import Account, Pace, budget_of, run_length
from phase_ppl.inference.runs.plan import Plan, fields_of
from phase_ppl.inference.runs.progress import Progress
from phase_ppl.inference.settings import (
    Budget,
    FrameBudget,
    SimpleSettings,
    TimeBudget,
    described_budget,
)
from phase_ppl.inference.stepwise import read_event
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.program import event_salt
from phase_ppl.models.stepwise import StepwiseLikelihood, level_of
from phase_ppl.simulator.contract import Cancelled, OutOfTime, SimulationResult, Statistics
from phase_ppl.simulator.runner import Request, Runner
from phase_ppl.world.checks import check_memory
from phase_ppl.world.errors import InvalidSettingError, OutputError
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene


class ReadingRunner(Runner):
    """Answers requests for simulations from a reading of the video, which is made once.

    The error of a frame is by how many nats, times the likelihood's weight, the best pair of
    goals explains it better; that of the first frame tells the same of the strengths, each of
    which counts as the nearest that was followed, as in the prior of the table of all hypotheses.
    The "trajectory" is the observed one, on which
    every frame is conditioned. Nothing is random, so seeds make no difference.

    Args:
        plan: what is sampled.
        post: what was read.
    """

    def __init__(self, plan: Plan, post: StepwisePosterior) -> None:
        super().__init__(_never, plan.event.scene, plan.event.observation, workers=1)
        found = post.dataset
        likelihood = found["log_likelihood"].values
        worst = likelihood.max(axis=(1, 2), keepdims=True) - likelihood
        self._errors = float(found.attrs["weight"]) * worst
        self._levels = found["strength_red"].values
        with np.errstate(divide="ignore"):
            strengths = np.log(found["strengths"].values[-1])
        self._strength_errors = strengths.max() - strengths
        self._trajectory = np.array(plan.event.observation.trajectory)

    def _run_here(self, request: Request) -> SimulationResult:
        self._check_cancelled()
        hypothesis, seed, _ = request
        red, green = hypothesis.effective_goals
        errors = self._errors[:, red, green].copy()
        place = [level_of(newtons, self._levels) for newtons in hypothesis.strengths]
        errors[0] += self._strength_errors[place[0], place[1]]
        if not np.isfinite(errors).all():
            reason = "impossible given what was seen"
            return self._count(SimulationResult.failed(hypothesis, seed, len(errors), reason))
        return self._count(
            SimulationResult(hypothesis, seed, self._trajectory, errors, len(errors), True)
        )


def reading_runner(
    plan: Plan, threads: int | None, executor: Executor | None, progress: bool | None
) -> ReadingRunner:
    """Read the event of a plan, and return a runner that answers from it.

    Raises:
        InvalidSettingError: an executor is given, in which there is nothing to simulate.
    """
    if executor is not None:
        raise InvalidSettingError("a stepwise likelihood simulates nothing: it takes no executor")
    post = read_event(plan.event, plan.model, seed=plan.seed, threads=threads, progress=progress)
    return ReadingRunner(plan, post)


def _never(
    scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
) -> Iterator[NDArray[np.float64]]:
    raise AssertionError("requests are answered from the reading")


# --- one call that begins a run, or goes on with one, and ends it with a posterior ----------------

_RECORD_BYTES: Final = 3000
_FRAME_BYTES: Final = 104
"""Of memory that a simulation takes, and each of its frames."""

_known_simulators: Final[weakref.WeakSet[Any]] = weakref.WeakSet()

_APART: Final = 0.5
"""Units by which a first frame may be off the start."""

_OVERTIME: Final = 1.1
"""An iteration is given up that goes on for so much of the seconds, and one second."""


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


@dataclasses.dataclass(frozen=True)
class Means:
    """What a call has to work with.

    Attributes:
        iterations, budget: as given; the length of the run.
        on_failure, retries: what becomes of failed simulations; draws depend on it where some fail.
        simulation_seconds: that a simulation may take; None: any.
        workers, executor: where simulations run.
        progress: whether to show a bar.
        path: of the checkpoint; None: none is written.
        versions: of which the run was made so far, the present ones last.
        began: when the call began, by :func:`phase_ppl.inference.runs.length.clock`.
        burn_in: draws at the beginning of each chain that do not count; None: by default.
    """

    iterations: int | None
    budget: Budget | FrameBudget | TimeBudget | None
    on_failure: str
    retries: int | None
    simulation_seconds: float | None
    workers: int | None
    executor: Executor | None
    progress: bool | None
    path: str | os.PathLike[str] | None
    versions: Sequence[Mapping[str, Any]]
    began: float
    burn_in: int | None = None


def carry_out(plan: Plan, means: Means, saved: Checkpoint | None = None) -> Posterior:
    """Do a run, or what is left of it, and return its posterior.

    Args:
        plan: what the run is.
        means: what the call has to work with.
        saved: where to go on; None: at the beginning.

    Raises:
        InvalidSettingError, UnknownNameError: a setting that cannot be used.
        Interrupted: Ctrl-C.
        Exception: whatever ended the run, with what was done as its ``posterior``.
    """
    with _runner(plan, means) as runner:
        session = Session(plan, means, runner, saved)
        ended = session.advance()
    if isinstance(ended, KeyboardInterrupt | Cancelled):
        raise Interrupted(session.posterior(interrupted=True)) from None
    if ended is not None:
        raise with_posterior(ended, session.posterior(interrupted=True))
    posterior = session.posterior(interrupted=False)
    assert posterior is not None, "a run that ended well has at least its initial particles"
    return posterior


def _runner(plan: Plan, means: Means) -> Runner:
    if isinstance(plan.model.likelihood, StepwiseLikelihood):
        return reading_runner(plan, means.workers, means.executor, means.progress)
    return Runner(
        plan.model.build_simulator(),
        plan.event.scene,
        plan.event.observation,
        workers=means.workers,
        executor=means.executor,
        on_failure=means.on_failure,
        retries=means.retries,
        simulation_seconds=means.simulation_seconds,
    )


def with_posterior(error: BaseException, posterior: Posterior | None) -> BaseException:
    """Return ``error`` with what was done until then as its attribute ``posterior``."""
    with contextlib.suppress(AttributeError):  # of a class without room for it
        error.posterior = posterior  # type: ignore[attr-defined]
        if posterior is not None:
            error.add_note("What was done until then is the attribute posterior of this error.")
    return error


class Session:
    """A run in the hands of one call; arguments as of :func:`carry_out`, and the open runner."""

    def __init__(self, plan: Plan, means: Means, runner: Runner, saved: Checkpoint | None) -> None:
        self._plan, self._means, self._runner = plan, means, runner
        scene, observation = plan.event.scene, plan.event.observation
        self._bridge = SimulatorBridge(runner, observation.n_frames)
        tables = plan.settings.tables(scene, observation)
        data = EventData(tables, event_salt(scene, observation), self._bridge.handle)
        options = tuple(plan.options.items())
        recipe = Recipe(plan.info, options, plan.model, plan.settings, observation.n_frames)
        self._kernel = recipe.build(data)
        self._length = run_length(
            self._kernel,
            plan.info,
            plan.chains,
            means.iterations,
            means.budget,
            observation.n_frames,
        )
        length = self._length
        asked = length.simulations or (length.frames or 0) // observation.n_frames
        most = max(asked, length.at_most(plan.chains, length.iterations or 0))
        check_memory(
            f"chains={plan.chains}, {most} simulations of {observation.n_frames} frames",
            most * (_RECORD_BYTES + _FRAME_BYTES * observation.n_frames),
        )
        self._run = Chains(recipe, data, self._bridge, runner, plan.chains, plan.seed)
        before = Spent() if saved is None else saved.spent
        self._pace = Pace(self._length, means.began, spent=before.seconds, recent=before.recent)
        self._calls = before.calls + 1
        self._account = Account(self._bridge.records)
        self._written = -1
        if saved is not None:
            self._go_on(saved)

    def _go_on(self, saved: Checkpoint) -> None:
        wanted, done = self._length.iterations, len(saved.steps)
        if wanted is not None and wanted < done:
            raise InvalidSettingError(f"iterations={wanted}, but {saved.path} has {done} already")
        self._run.go_on(saved.state(self._run.blank_state()), saved.start, list(saved.steps))
        for record in saved.records:
            self._bridge.remember(record)
        self._account = Account(self._bridge.records, done)
        if done and self._pace.is_spent(self._account.before):
            spent = self._account.before
            raise InvalidSettingError(
                f"a budget of {described_budget(budget_of(self._length.target))} is too small: "
                f"{saved.path} went on after {spent.simulations} simulations of "
                f"{spent.frames} frames"
            )
        self._runner.statistics = dataclasses.replace(saved.spent.statistics)
        self._written = done

    def advance(self) -> BaseException | None:
        """Do what is left of the run; return what ended it before its end, or None."""
        batch = self._plan.chains * self._length.sims_per_step
        before = 0 if self._run.start is None else self._simulations()
        with Progress(self._expected(), self._means.progress, done=before, batch=batch) as bar:
            self._runner.on_result = bar.one_more
            try:
                self._advance(bar)
            except OutOfTime:  # the iteration that was under way does not count
                return None
            except (KeyboardInterrupt, Cancelled) as stop:
                # in case that it came while the file was being written; the posterior comes first
                with contextlib.suppress(OutputError):
                    self._keep()
                return stop
            except Exception as error:
                return error
        return None

    def _advance(self, bar: Progress) -> None:
        seconds, runner = self._length.seconds, self._runner
        if self._run.start is None:
            limit = runner.limit
            if seconds is not None:
                runner.limit = min(limit, seconds)
                runner.patience = time.perf_counter() + seconds - self._pace.spent
            self._pace.begin()
            self._run.initialise()
            self._pace.end(initial=True)
            self._account.settle()
            self._keep()
            runner.limit = limit
            if self._plan.model.simulator is not None:
                results = [record.result for record in self._bridge.records]
                _check_once(runner, self._plan.model.simulator, results)
        if seconds is not None:
            left = _OVERTIME * seconds + 1.0 - self._pace.spent
            runner.deadline = time.perf_counter() + left
        while self._pace.another(len(self._run.steps), self._account.tally):
            bar.reach(self._simulations())
            bar.expect(self._expected())
            self._pace.begin()
            self._run.advance()
            self._pace.end()
            self._account.settle()
            self._keep()
        bar.expect(self._simulations())
        bar.reach(self._simulations())

    def _simulations(self) -> int:
        """Return the simulations until now: the most there can be, where those do not decide."""
        if self._length.simulations is not None or self._length.frames is not None:
            return self._account.tally.simulations
        return self._length.at_most(self._plan.chains, len(self._run.steps))

    def _expected(self) -> int:
        """Return how many simulations there will be in the end, as far as one can tell."""
        length, spent = self._length, self._account.tally
        if length.simulations is not None:
            return max(length.simulations, spent.simulations)
        if length.frames is not None:
            each = spent.frames / spent.simulations if spent.frames else self._runner.n_frames
            return max(math.ceil(length.frames / each), spent.simulations)
        return length.at_most(self._plan.chains, self._pace.expected(len(self._run.steps)))

    def _keep(self) -> None:
        """Write the file, if there is to be one that is not up to date."""
        run, path = self._run, self._means.path
        if path is None or run.start is None or self._written == len(run.steps):
            return
        spent = Spent(self._runner.statistics, self._pace.spent, self._pace.recent, self._calls)
        write_checkpoint(
            path,
            self._plan,
            self._length.target,
            {
                "on_failure": self._runner.on_failure,
                "retries": self._means.retries,
                "simulation_seconds": self._means.simulation_seconds,
            },
            Progressed(
                run.state,
                run.start,
                run.steps,
                self._bridge.records,
                spent,
                self._means.versions,
            ),
        )
        self._written = len(run.steps)

    def posterior(self, *, interrupted: bool) -> Posterior | None:
        """Return that of what was done; None without initial particles."""
        plan, run = self._plan, self._run
        if run.start is None:
            return None
        attrs: dict[str, Any] = {
            "kernel": plan.info.name,
            "validity": getattr(self._kernel, "validity", plan.info.validity),
            "settings": json.dumps(self._settings(), default=repr),
            "cost": json.dumps(self._cost(interrupted)),
        }
        *earlier, now = self._means.versions
        attrs["versions"] = json.dumps(now)
        if earlier:
            attrs["earlier_versions"] = json.dumps(earlier)
        drawn = Drawn.kept(run.start, run.steps, plan.info)
        if self._means.burn_in is not None:
            # of an interrupted run at least the last draw counts
            attrs["burn_in"] = min(self._means.burn_in, len(drawn.steps) - 1)
        return Posterior(build_tree(plan.event, plan.model, drawn, self._bridge.records, attrs))

    def _settings(self) -> dict[str, Any]:
        plan = self._plan
        return {
            "kernel": {"name": plan.info.name, **plan.options},
            "chains": plan.chains,
            "iterations": len(self._run.steps),  # an interrupted run equals a shorter one
            "seed": plan.seed,
            "on_failure": self._runner.on_failure,
            "retries": self._runner.retries,
            "simulation_seconds": self._means.simulation_seconds,
            "turning": plan.event.scene.turning,
            "simple": _without_beta(plan.settings),
            "model": plan.model.fingerprint(),
        }

    def _cost(self, interrupted: bool) -> dict[str, Any]:
        """Return what the run cost; seconds are of wall time unless they say otherwise."""
        statistics, seconds = self._runner.statistics, self._pace.spent
        wanted = statistics.frames + statistics.frames_saved
        budget = budget_of(self._length.target)
        return {
            "budget": None if budget is None else described_budget(budget),
            "simulations": statistics.simulations,
            "frames": statistics.frames,
            "frames_saved": statistics.frames_saved,  # by stopping simulations early
            "frames_saved_share": statistics.frames_saved / wanted if wanted else 0.0,
            "failures": statistics.failures,
            "retries": statistics.retries,
            "seconds": seconds,
            "seconds_simulating": statistics.seconds_simulating,  # summed over workers
            "seconds_waiting": statistics.seconds_waiting,
            "seconds_overhead": seconds - statistics.seconds_waiting,
            "workers": self._runner.workers,
            "host": f"{platform.node()} ({platform.system()}, {platform.machine()})",
            "calls": self._calls,
            "interrupted": interrupted,
        }


def _check_once(runner: Runner, simulator: Any, results: Sequence[SimulationResult]) -> None:
    """Warn of a simulator that does not start where it is told to, or draws not from its seed."""
    first = next((result for result in results if result.completed), None)
    with contextlib.suppress(TypeError):  # of one that cannot be told from others
        if simulator in _known_simulators:
            return
        _known_simulators.add(simulator)
    if first is None:
        return
    kept = runner.statistics, runner.on_result, runner.on_failure
    runner.statistics, runner.on_result, runner.on_failure = Statistics(), None, "reject"
    try:
        (again,) = runner.run([first.hypothesis], [first.seed])
    finally:
        runner.statistics, runner.on_result, runner.on_failure = kept
    if not np.array_equal(first.trajectory, again.trajectory, equal_nan=True):
        warnings.warn(
            "the simulator gave another result for the same seed: unless all its randomness comes "
            "from rng, a run can be neither repeated nor resumed",
            stacklevel=2,
        )
    apart = np.abs(first.trajectory[0, :, :2] - runner.scene.start[:, :2]).max()
    if apart > _APART:
        warnings.warn(
            f"the first frame of the simulator is {apart:.3g} units off the start of the scene, "
            "which frame 0 shows",
            stacklevel=2,
        )


def _without_beta(settings: SimpleSettings) -> dict[str, Any]:
    """Return the settings; beta is left to the model's likelihood, which has it."""
    plain = fields_of(settings) | {"strength": estimator_name(settings.strength)}
    return {name: value for name, value in plain.items() if name != "beta"}
