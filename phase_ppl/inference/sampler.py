"""Execution of a run, one iteration at a time, so that finished work is never lost.

:func:`sample` begins or continues a :class:`~phase_ppl.inference.run.Run` under
:class:`RunOptions`, and returns its posterior.
"""

from __future__ import annotations

import concurrent.futures as futures
import contextlib
import dataclasses
import functools
import json
import math
import os
import platform
import time
import warnings
import weakref
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any, Final, TypeVar

import jax
import numpy as np
from jax import random
from numpy.typing import NDArray

from phase_ppl.analysis.diagnostics import untried_rivals
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.weights import WEIGHTINGS, log_sum_exp
from phase_ppl.inference import run as runs
from phase_ppl.inference.draws import Columns, build_tree, particles_of, sites_of
from phase_ppl.inference.run import (
    Length,
    Pace,
    Run,
    Stages,
    compiled,
    compiled_given,
    make_kernel,
)
from phase_ppl.inference.settings import Budget
from phase_ppl.models.bridge import Record, Request, SimulatorBridge, request_key
from phase_ppl.models.compiled import Compiled
from phase_ppl.models.density import is_stepped, on_cpu
from phase_ppl.models.world_priors import drawn_stated
from phase_ppl.simulator.contract import Cancelled, OutOfTime, SimulationResult, Statistics
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.errors import (
    InvalidSettingError,
    OutputError,
    SimulationError,
    check_memory,
    check_name,
)
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.identity import versions
from phase_ppl.world.progress import Progress
from phase_ppl.world.space import ALPHA_SITE, space_of

if TYPE_CHECKING:
    from phase_ppl.inference.checkpoint import Checkpoint

POLL_SECONDS: Final = 0.1  # how long Ctrl-C may go unnoticed
_RECORD_BYTES, _FRAME_BYTES = 3000, 104  # of memory that a simulation takes, and each of its frames
_STARTS: Final = 3  # times that all particles start anew, where no simulation succeeds
_ROUNDS: Final = 3  # rounds of rivals, if each round changes the leading goals
_APART: Final = 0.5  # units by which a first frame may be off the start

_NEGLIGIBLE: Final = 16.0
"""Nats below the best simulation at which a simulation no longer affects any mean likelihood."""

_OVERTIME: Final = 1.1
"""Overtime, as a share of the budget of seconds plus one second, after which an iteration stops."""

OF_RUNNER: Final = ("executor", "on_failure", "simulation_seconds")
"""Options of a run that are the runner's."""

_known_simulators: Final[weakref.WeakSet[Any]] = weakref.WeakSet()

Result = TypeVar("Result")


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in a run that samples. Finished iterations are kept.

    It is a ``KeyboardInterrupt``, so no ``except Exception`` in a loop over events swallows it.

    Attributes:
        posterior: posterior from the finished iterations or, if there are none, from the initial
            particles; None if the initial particles were not complete.
    """

    def __init__(self, posterior: Posterior | None) -> None:
        kept = "nothing was complete yet" if posterior is None else "see .posterior"
        super().__init__(f"the run was interrupted; {kept}")
        self.posterior = posterior


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """Options of one call of a run; those without a comment are as in :func:`~phase_ppl.infer`."""

    iterations: int | None = None
    budget: Budget | None = None
    on_failure: str = "reject"
    simulation_seconds: float | None = None
    workers: int | None = None
    executor: Executor | None = None
    progress: bool | None = None
    checkpoint: str | os.PathLike[str] | None = None
    weights: str | None = None
    # versions that made the run so far, oldest first
    versions: Sequence[Mapping[str, Any]] = dataclasses.field(default_factory=lambda: [versions()])
    # when the call began, by ``clock``
    began: float = dataclasses.field(default_factory=lambda: runs.clock())

    def __post_init__(self) -> None:
        if self.weights is not None:
            check_name("weights", self.weights, WEIGHTINGS)


def sample(
    run: Run,
    options: RunOptions,
    saved: Checkpoint | None = None,
    checked: Callable[[], None] = lambda: None,
) -> Posterior:
    """Do a run, or the rest of a saved one, and return its posterior.

    ``checked`` is called after all checks, before the run begins.
    """
    given = {name: getattr(options, name) for name in OF_RUNNER}
    place = run.model.build_simulator(), run.event.scene, run.event.observation
    with contextlib.closing(Runner(*place, workers=options.workers, **given)) as runner:
        sampler = Sampler(run, options, runner, saved)
        checked()
        try:
            sampler.advance()
        except (KeyboardInterrupt, Cancelled):
            # Ctrl-C may have come while the file was being written; the posterior comes first
            with contextlib.suppress(OutputError):
                sampler.keep()
            raise Interrupted(sampler.posterior(interrupted=True)) from None
        except Exception as error:
            posterior = sampler.posterior(interrupted=True)
            with contextlib.suppress(AttributeError):  # the class may allow no new attribute
                error.posterior = posterior  # type: ignore[attr-defined]
                if posterior is not None:
                    error.add_note(
                        "What was done until then is the attribute posterior of this error."
                    )
            raise
    posterior = sampler.posterior(interrupted=False)
    assert posterior is not None, "a run that ended well has at least its initial particles"
    return posterior


_split: Final = Compiled(
    lambda number, chains: random.split(random.key(number), len(chains)), "keys of chains"
)
"""Random keys of chains; the argument is an array, since code is compiled for shapes."""


class Sampler:
    """One call's work on the particles of a run; arguments as of :func:`sample`.

    The compiled step runs in its own thread, so the main thread notices Ctrl-C at once. It then
    cancels the simulations, waits for the thread, and ends.
    """

    def __init__(
        self, run: Run, options: RunOptions, runner: Runner, saved: Checkpoint | None
    ) -> None:
        self._run, self._options, self._runner = run, options, runner
        self._n_frames = run.n_frames
        self._bridge = SimulatorBridge(runner, self._n_frames, space_of(run.event.scene.world))
        # all checks come before the video is read
        self._data = run.data(self._bridge.handle, unread=True)
        self._kernel = make_kernel(run.recipe, self._data)
        self._length = Length.of(
            *(self._kernel, run.info, run.chains, options.iterations, options.budget),
            self._n_frames,
        )
        self._check_memory()
        self._steps = compiled(run.recipe)
        self._state: Any = None
        self._particles: list[Columns] = []  # the initial ones, and those after every iteration
        self._written = -1
        self._rivals_from: int | None = None  # the iteration that rivals count as
        self._n_rivals = 0  # simulations of rivals
        self._calls = 1
        self._pace = Pace(self._length, options.began)
        if saved is not None:
            self._go_on(saved)
        try:
            threads = options.workers if options.executor is None else None
            began = runs.clock()
            self._data = run.data(self._bridge.handle, options.progress, threads)
            # an earlier reading of the video counts like a new one
            self._kept_seconds = max(0.0, run.reading_cost.seconds - (runs.clock() - began))
            self._adaptation = run.adaptation(self._data)
            for iteration, particles in enumerate(self._particles):
                self._adapt(iteration, particles)
        except KeyboardInterrupt as stop:  # while the closed loop reads the video
            raise Interrupted(None) from stop

    @property
    def _done(self) -> int:
        """Finished iterations; -1: not even the initial particles are there."""
        return len(self._particles) - 1

    def _check_memory(self) -> None:
        limit, most = self._length.limit, self._length.at_most(self._length.iterations or 0)
        if self._length.is_counted:
            most = max(int(min(limit("simulations"), limit("frames") // self._n_frames)), most)
        check_memory(
            f"chains={self._run.chains}, {most} simulations of {self._n_frames} frames",
            most * (_RECORD_BYTES + _FRAME_BYTES * self._n_frames),
        )

    def _keys(self, *place: int) -> jax.Array:
        """Return a key for each particle; ``place`` tells parts of the run apart."""
        number = int(np.random.SeedSequence(self._run.seed, spawn_key=place).generate_state(1)[0])
        return _split(np.uint32(number), np.zeros(self._run.chains, np.bool_))

    def _go_on(self, saved: Checkpoint) -> None:
        wanted = self._length.iterations
        if wanted is not None and wanted < saved.done:
            raise InvalidSettingError(
                f"iterations={wanted}, but {saved.path} has {saved.done} already"
            )
        with on_cpu():
            blank = self._steps.shapes("starts", self._data, self._keys(), None)
        self._state, self._particles = saved.state(blank), list(saved.particles)
        pace = self._pace = Pace(
            self._length, self._options.began, seconds=saved.seconds, recent=saved.recent
        )
        pace.count(saved.records, saved.done - 1)
        if saved.done and pace.is_spent:
            raise InvalidSettingError(
                f"a budget of {self._length.budget} is too small: {saved.path} went on after "
                f"{pace.simulations} simulations of {pace.frames} frames"
            )
        pace.count(saved.records, saved.done)
        self._runner.statistics = dataclasses.replace(saved.statistics)
        self._calls = saved.calls + 1
        # rivals follow from the answer, which will change
        last = saved.done + (not pace.goes_on)
        for record in saved.records:
            if record.iteration <= last:
                self._bridge.remember(record)
        if any(record.iteration > saved.done for record in self._bridge.records):
            self._rivals_from = last
        self._bridge.iteration = self._written = saved.done

    def advance(self) -> None:
        """Do the rest of the run."""
        before = 0 if self._done < 0 else self._simulations()
        seconds, runner = self._length.limit("seconds"), self._runner
        with Progress(self._expected(), self._options.progress, done=before) as bar:
            runner.on_result = bar.one_more
            # an iteration that time cuts off does not count
            with contextlib.suppress(OutOfTime):
                if self._done < 0:
                    self._start(seconds)
                left = _OVERTIME * seconds + 1.0 - self._pace.seconds
                runner.deadline = time.perf_counter() + left
                while self._pace.goes_on:
                    bar.reach(self._simulations())
                    bar.expect(self._expected())
                    self._iterate(lambda: self._computed("moves", self._state))
                bar.reach(self._simulations())
                self._try_rivals(bar)
                bar.expect(self._simulations())
                bar.reach(self._simulations())

    def _start(self, seconds: float) -> None:
        """Make the initial particles; no simulation may take longer than ``seconds``."""
        runner, limit = self._runner, self._runner.limit
        runner.limit = min(limit, seconds)
        runner.patience = time.perf_counter() + seconds - self._pace.seconds
        self._iterate(lambda: self._computed("starts", self._keys(), None))
        runner.limit = limit
        if self._run.model.simulator is not None:
            results = [record.result for record in self._bridge.records]
            _check_once(runner, self._run.model.simulator, results)

    def _answer(self, request: Request) -> NDArray[np.float32]:
        return self._bridge.answer(request, self._run.recipe.n_frames)

    def _computed(self, what: Stages, *given: Any) -> Any:
        """Return the state after a start, given keys and None, or after a move, given a state."""
        return self._steps.run(what, self._answer, self._data, *given)

    def _iterate(self, compute: Callable[[], Any]) -> None:
        """Do the initial particles, or an iteration, which counts once it is complete."""
        initial = self._done < 0
        self._bridge.iteration = self._done + 1
        self._pace.begin()
        state = self._in_thread(compute)
        if initial:
            for again in range(_STARTS):
                # a kernel that weighs its start would look better than it is
                if self._completed(state).any() or hasattr(state, "log_weight"):
                    break
                keys = self._keys(again)
                state = self._in_thread(functools.partial(self._computed, "starts", keys, None))
            state = self._all_started(state)
        self._particles.append(particles_of(state))
        self._state = state
        self._adapt(self._done, self._particles[-1])
        self._pace.end(initial=initial)
        self._pace.count(self._bridge.records, self._done)
        self.keep()

    def _adapt(self, iteration: int, particles: Columns) -> None:
        """Fit the proposal of a kernel that adapts to a batch of draws."""
        if self._adaptation is not None:
            records = [one for one in self._bridge.records if one.iteration == iteration]
            with on_cpu():
                self._adaptation.add(sites_of(particles), particles["log_weight"], records)
            self._data = self._data._replace(proposal=self._adaptation.proposal)

    def _weighed(self) -> list[Columns]:
        """Return the particles with their final weights."""
        if self._adaptation is not None:
            with on_cpu():
                weights = self._adaptation.log_weights()
        elif self._run.info.name == "importance":
            weights = np.stack([particles["log_weight"] for particles in self._particles])
        else:
            return self._particles
        # weights are relative to a likelihood without any error
        perfect = self._run.model.error_likelihood.log_prob(np.zeros(self._n_frames)).sum()
        evidence = log_sum_exp(weights) - math.log(weights.size) + float(perfect)
        given = {"log_evidence": np.full(self._run.chains, evidence)}
        pairs = zip(self._particles, weights, strict=True)
        return [{**particles, **given, "log_weight": one} for particles, one in pairs]

    def _try_rivals(self, bar: Progress) -> None:
        """Simulate untried rivals of the leading goals, if the run weighs all simulations.

        The particles share the rivals, one simulation each. If other goals lead afterwards, their
        rivals follow.
        """
        chains = self._run.chains
        if self._length.budget is not None or self._rivals_from is not None:  # by an earlier call
            return
        if self._run.info.weighted:  # draws are weighed, not simulations
            return
        tried: set[tuple[int, ...]] = set()
        for round_ in range(_ROUNDS):
            post = self.posterior(interrupted=False)
            assert post is not None, "there are particles"
            if post.weights != "stratified":
                return
            self._rivals_from = self._bridge.iteration = self._done + 1
            found = untried_rivals(post.tree, post.leaders())
            # failed ones are not tried again
            rivals = [pair for pair in map(tuple, found.tolist()) if pair not in tried]
            tried |= set(rivals)
            simulations = post.tree["simulations"].dataset
            known = simulations["log_likelihood"].values[simulations["completed"].values]
            floor = np.full(chains, known.max() - _NEGLIGIBLE, np.float32)
            for first in range(0, len(rivals), chains):
                self._n_rivals += chains
                bar.expect(self._simulations())
                goals = np.take(rivals, range(first, first + chains), axis=0, mode="wrap")
                work = functools.partial(self._simulate_goals, goals, floor, round_, first)
                self._in_thread(work)
            if not rivals:
                break
        self._written = -1
        self.keep(self._bridge.records)

    def _simulate_goals(
        self, goals: NDArray[np.int64], log_floor: NDArray[np.float32], *place: int
    ) -> None:
        """Simulate effective goals (chain, agent), one pair per particle."""
        run, space = self._run, space_of(self._run.event.scene.world)
        usual = np.full(goals.shape, np.mean(STRENGTH_RANGE))
        seed = (run.seed, self._done, *place)
        stated, log_drawn = drawn_stated(run.model.prior, goals, usual, seed)
        names = (*space.goal_sites, ALPHA_SITE)
        given = dict(zip(names, stated.T.astype(np.int32), strict=True))
        keys = self._keys(self._done, *place)
        drawn = log_drawn.astype(np.float32)
        self._answer(compiled_given(run.recipe)(self._data, keys, given, drawn, log_floor))

    def _completed(self, state: Any) -> NDArray[np.bool_]:
        """Return (chain,) whether the initial simulation succeeded."""
        for field in ("z", "sim_seed", "rng_key"):
            if not hasattr(state, field):
                raise InvalidSettingError(
                    f"{type(state).__name__}, the state of the kernel, has no field {field!r}"
                )
        records, chain = self._bridge.records, np.arange(self._run.chains)
        done = [record for record in records if record.result.completed]
        keys = {request_key(record.sites, record.result.seed) for record in done}
        sites = {name: np.asarray(values) for name, values in state.z.items()}
        # a request that two chains share is recorded for one of them
        return np.array(
            [
                request_key({name: values[c] for name, values in sites.items()}, int(seed)) in keys
                for c, seed in enumerate(np.asarray(state.sim_seed))
            ]
        ) | np.isin(chain, [record.chain for record in done])

    def _all_started(self, state: Any) -> Any:
        """Return the initial state; failed particles start where the next completed one does.

        The stationary law does not depend on the start.
        """
        records, completed = self._bridge.records, self._completed(state)
        if not records:
            raise SimulationError("no initial hypothesis has prior mass: nothing was simulated")
        if not completed.any():
            first = records[0].result
            raise SimulationError(
                f"all initial simulations failed; the first, of [{first.hypothesis}] with seed "
                f"{first.seed}: {first.failure}"
            )
        return started_again(state, completed)

    def _in_thread(self, work: Callable[[], Result]) -> Result:
        stepped = is_stepped()  # a setting that JAX keeps by thread

        def worked() -> Result:
            with on_cpu(), jax.disable_jit() if stepped else contextlib.nullcontext():
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

    def _simulations(self) -> int:
        """Return the simulations so far; without a budget of them, the most there can be."""
        if self._length.is_counted:
            return self._pace.simulations
        return self._length.at_most(self._done) + self._n_rivals

    def _expected(self) -> int:
        """Return the expected number of simulations at the end."""
        spent, limit = self._pace, self._length.limit
        if not self._length.is_counted:
            return self._length.at_most(spent.expected)
        each = spent.frames / spent.simulations if spent.frames else self._n_frames
        total = min(limit("simulations"), limit("frames") / each)
        return max(math.ceil(total), spent.simulations)

    def keep(self, records: Sequence[Record] | None = None) -> None:
        """Write the checkpoint, if there is one and it is not up to date.

        It gets ``records``, by default those of complete iterations.
        """
        options, ends = self._options, self._length
        if options.checkpoint is None or self._written == self._done:
            return
        from phase_ppl.inference.checkpoint import write_checkpoint

        if records is None:  # an interrupted iteration will be run again
            records = [one for one in self._bridge.records if one.iteration <= self._done]
        about = {
            "identity": self._run.identity(),
            "again": self._run.again(),
            "target": {
                "iterations": ends.iterations,
                "budget": ends.budget and dataclasses.astuple(ends.budget),
                "weights": options.weights,
                "on_failure": self._runner.on_failure,
                "simulation_seconds": options.simulation_seconds,
            },
            "spent": {
                "statistics": dataclasses.asdict(self._runner.statistics),
                "seconds": self._pace.seconds,
                "recent": list(self._pace.recent),
                "calls": self._calls,
            },
            "versions": list(options.versions),
        }
        particles, event = self._particles, self._run.event
        write_checkpoint(options.checkpoint, about, event, self._state, particles, records)
        self._written = self._done

    def posterior(self, *, interrupted: bool) -> Posterior | None:
        """Return the posterior of the finished work; None without initial particles."""
        run, kernel = self._run, self._run.info
        if self._done < 0:
            return None
        *earlier, now = self._options.versions
        attrs: dict[str, Any] = {
            "kernel": kernel.name,
            "validity": getattr(self._kernel, "validity", kernel.validity),
            "settings": json.dumps(self._settings(), default=repr),
            "cost": json.dumps(self._cost(interrupted)),
            "versions": json.dumps(now),
        }
        if earlier:
            attrs["earlier_versions"] = json.dumps(earlier)
        if self._rivals_from is not None:
            attrs["rivals_from"] = self._rivals_from
        if self._options.weights is not None:
            attrs["weights"] = self._options.weights
        records = self._bridge.records
        return Posterior(build_tree(run.event, run.model, kernel, self._weighed(), records, attrs))

    def _settings(self) -> dict[str, Any]:
        return {
            **self._run.record(self._done),  # an interrupted run equals a shorter one
            "on_failure": self._runner.on_failure,
            "simulation_seconds": self._options.simulation_seconds,
        }

    def _cost(self, interrupted: bool) -> dict[str, Any]:
        """Return the cost of the run; seconds are wall time unless named otherwise."""
        statistics, reading = self._runner.statistics, self._run.reading_cost
        seconds = self._pace.seconds + self._kept_seconds
        wanted = statistics.frames + statistics.frames_saved
        return {
            "budget": self._length.budget and str(self._length.budget),
            **dataclasses.asdict(statistics),
            "frames_saved_share": statistics.frames_saved / wanted if wanted else 0.0,
            "seconds": seconds,
            "seconds_overhead": seconds - statistics.seconds_waiting,
            "seconds_reading": reading.seconds,
            "searches": reading.searches,
            "workers": self._runner.workers,
            "host": f"{platform.node()} ({platform.system()}, {platform.machine()})",
            "calls": self._calls,
            "interrupted": interrupted,
        }


def started_again(state: Any, completed: NDArray[np.bool_]) -> Any:
    """Return a state in which failed chains start where the next completed chain does."""
    if completed.all():
        return state
    chain = np.arange(len(completed))
    source = np.array([next(c for c in np.roll(chain, -i) if completed[c]) for i in chain])
    copied = jax.tree.map(lambda leaf: leaf[source], state)
    state = copied._replace(rng_key=state.rng_key)
    if hasattr(state, "log_weight"):
        weight = jax.numpy.where(completed, state.log_weight, -np.inf)
        state = state._replace(log_weight=weight)
    return state


def _check_once(runner: Runner, simulator: Any, results: Sequence[SimulationResult]) -> None:
    """Warn of a simulator that ignores the start of the scene or its seed."""
    first = next((result for result in results if result.completed), None)
    with contextlib.suppress(TypeError):  # a simulator may not be hashable
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
