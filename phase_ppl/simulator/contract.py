"""The contract of a simulator, and the comparison of one simulation with the observation.

A simulator yields frames for a scene, a hypothesis and a random generator. It is a black box:
inference sees only its frames.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import threading
import time
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import PhasePPLError, SimulationError, shown
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene

_FINITE: Final = 1e30
"""Larger numbers count as infinite; in single precision, their distances would be."""

_STREAM: Final = 0x5EED
"""Keeps simulations' random streams apart from others that a user derives from one seed."""


class Simulator(Protocol):
    """Yields frames (entity, 3) = x, y [units], angle [rad] until it is closed.

    The first frame is compared with the first observed one. ``scene`` is the start. ``hypothesis``
    has effective goals as stated ones; no agent in it helps or hinders. All randomness comes from
    ``rng``. A simulation fails if it ends early, raises, or yields a value that is not finite.

    A simulator may have more methods:

    * ``settings() -> dict``: all else that determines its simulations, as plain data, to be stored
      with a run.
    * ``warm_up()``: does once the work that all processes can share, such as compiling.

    For the closed loop (:class:`phase_ppl.ClosedLoopLikelihood`) a simulator needs one of the two
    methods below; then ``__call__`` is optional. ``seen``, (time, entity, 3), is the earlier
    frames. If a simulator has both methods, only the first is called:

    * ``log_prob_next(scene, hypothesis, seen, frame) -> float``: log density of the next frame,
      (entity, 3); -inf if it is impossible. Events in which a body was not seen are refused, since
      the density is one of whole frames.
    * ``next_frames(scene, hypothesis, seen, rng, n) -> (n, entity, 3)``: ``n`` independent next
      frames. ``rng`` starts the same under all hypotheses. Where a body was not seen, ``seen`` is
      NaN, and its positions in the next frames do not count.
    """

    def __call__(
        self, scene: Scene, hypothesis: Any, rng: np.random.Generator, /
    ) -> Iterable[NDArray[Any]]: ...


LOG_PROB_NEXT: Final = "log_prob_next(scene, hypothesis, seen, frame) -> float"
NEXT_FRAMES: Final = "next_frames(scene, hypothesis, seen, rng, n) -> (n, entity, 3)"


def has_density(simulator: object) -> bool:
    """Whether a simulator gives the density of a next frame."""
    return callable(getattr(simulator, "log_prob_next", None))


def goes_on(simulator: object) -> bool:
    """Whether a simulator can continue from earlier frames, and so serve the closed loop."""
    return has_density(simulator) or callable(getattr(simulator, "next_frames", None))


class Cancelled(PhasePPLError):
    """The run was cancelled by other code."""


class OutOfTime(Cancelled):
    """The run has used up its time."""


@dataclasses.dataclass(frozen=True, eq=False)
class SimulationResult:
    """One simulation, complete or not."""

    hypothesis: Hypothesis  # as requested (stated goals and relations)
    seed: int  # as requested
    # (time, entity, coord) x, y [units], angle [rad]; NaN where not simulated
    trajectory: FloatArray
    # (time,) distance ||s - s^|| over the x, y of all entities that were seen, units; inf where
    # not simulated
    errors: FloatArray
    frames_simulated: int  # frames taken from the simulator
    completed: bool  # all frames were simulated
    seconds: float = 0.0  # time spent simulating
    failure: str | None = None  # what went wrong, class and message of the error, or None

    @property
    def total_error(self) -> float:
        """Sum of the errors of the simulated frames, units."""
        return float(self.errors[: self.frames_simulated].sum())

    @classmethod
    def failed(
        cls, hypothesis: Hypothesis, seed: int, n_frames: int, why: str, seconds: float = 0
    ) -> SimulationResult:
        """Return the result of a simulation without frames."""
        trajectory = np.full((n_frames, len(hypothesis.world.entities), 3), np.nan)
        errors = np.full(n_frames, np.inf)
        return cls(hypothesis, int(seed), trajectory, errors, 0, False, seconds, why)


def random_generator(seed: int) -> np.random.Generator:
    """Return the generator of the simulation with this seed, of which only 32 bits count."""
    return np.random.default_rng([int(seed) & 0xFFFFFFFF, _STREAM])


def simulate_one(
    simulator: Simulator,
    scene: Scene,
    hypothesis: Hypothesis,
    seed: int,
    observed_positions: FloatArray,
    error_ceiling: float = math.inf,
    *,
    limit: float = math.inf,
    stop: Sequence[Future[Any]] = (),
    deadline: float = math.inf,
) -> SimulationResult:
    """Simulate and compare with the observation, no further than needed.

    Any error of the simulator gives a failed result, which keeps the frames before. With a limit, a
    deadline or futures the simulator runs in a thread. One that hangs within a frame goes on,
    ignored, and does not keep its process from ending.

    Args:
        observed_positions: (time, entity, 2) observed x, y, units; NaN where unseen.
        error_ceiling: the simulation is closed once its summed error exceeds this, units. Below
            zero nothing is simulated. Results under it are the same as without a ceiling.
        limit: seconds after which the simulation fails.
        stop: futures; any that is done ends the simulation.
        deadline: time, by ``time.perf_counter``, that ends it.
    """

    def start() -> Iterable[NDArray[Any]]:
        return simulator(scene, hypothesis.effective(), random_generator(seed))

    ended = threading.Event()
    follow = functools.partial(
        _follow, start, hypothesis, seed, observed_positions, error_ceiling, ended
    )
    if error_ceiling < 0 or (limit == math.inf == deadline and not stop):
        return follow()
    found: Future[SimulationResult] = Future()

    def serve() -> None:
        try:
            found.set_result(follow())
        except BaseException as error:
            found.set_exception(error)

    n_frames, why = len(observed_positions), too_long(limit)
    if limit <= 0:
        return SimulationResult.failed(hypothesis, seed, n_frames, why, limit)
    threading.Thread(target=serve, name="phase_ppl-simulation", daemon=True).start()
    left = min(limit, deadline - time.perf_counter())
    try:
        wait([found, *stop], None if left == math.inf else max(left, 0.0), FIRST_COMPLETED)
        if any(future.done() for future in stop):
            raise Cancelled("the simulation was cancelled")
        if found.done():
            return found.result()
        if time.perf_counter() >= deadline:
            raise OutOfTime("the time of the run is over")
        return SimulationResult.failed(hypothesis, seed, n_frames, why, limit)
    finally:
        ended.set()


def too_long(limit: float) -> str:
    """Return in words that a simulation took longer than its limit."""
    if limit <= 0:
        return "no time was left for it"
    return f"it took longer than the {limit:g} s that a simulation may take"


def simulate_trajectory(
    simulator: Simulator, scene: Scene, hypothesis: Hypothesis, seed: int, n_frames: int
) -> FloatArray:
    """Return a simulated trajectory (time, entity, coord) x, y [units], angle [rad].

    Raises:
        SimulationError: the simulator raised, ended early, or yielded a bad frame.
    """
    shape = len(scene.world.entities), 3
    start = functools.partial(simulator, scene, hypothesis.effective(), random_generator(seed))
    try:
        with contextlib.closing(_checked(start, n_frames, shape)) as incoming:
            # a simulator may reuse its array for the next frame
            return np.array([next(incoming).copy() for _ in range(n_frames)])
    except (Exception, SystemExit) as error:
        raise SimulationError(
            f"simulation of [{hypothesis}] with seed {seed} failed: {error_text(error)}"
        ) from error


def log_prob_next(
    simulator: Any,
    scene: Scene,
    hypothesis: Hypothesis,
    seen: FloatArray,
    frame: FloatArray,
) -> float:
    """Return a simulator's own log density of the next frame (entity, 3), -inf included.

    Raises:
        SimulationError: it raised, or did not return a log density.
    """
    with _named("log_prob_next", hypothesis, seen):
        given = simulator.log_prob_next(scene, hypothesis, seen, frame)
        value = np.asarray(given)
        if value.shape != () or value.dtype.kind not in "biuf" or not value < np.inf:
            raise SimulationError(f"it returned {shown(given)}, expected a log density")
        return float(value)


def next_frames(
    simulator: Any,
    scene: Scene,
    hypothesis: Hypothesis,
    seen: FloatArray,
    rng: np.random.Generator,
    n: int,
) -> FloatArray:
    """Return (n, entity, 3) next frames drawn by a simulator.

    Raises:
        SimulationError: it raised, or returned a wrong shape or value.
    """
    with _named("next_frames", hypothesis, seen):
        given = simulator.next_frames(scene, hypothesis, seen, rng, n)
        frames, expected = np.asarray(given), (n, len(scene.world.entities), 3)
        if frames.shape != expected:
            raise SimulationError(f"it returned shape {frames.shape}, expected {expected}")
        if frames.dtype.kind not in "biuf" or not (np.abs(frames) < _FINITE).all():
            unseen = "; seen is NaN where a body was not seen" if np.isnan(seen).any() else ""
            raise SimulationError(f"it returned a value that is not finite{unseen}")
        return frames.astype(np.float64, copy=False)


@contextlib.contextmanager
def _named(method: str, hypothesis: Hypothesis, seen: FloatArray) -> Iterator[None]:
    """Add the frame and the hypothesis to an error's message."""
    try:
        yield
    except (Exception, SystemExit) as error:
        why = str(error) if isinstance(error, SimulationError) else error_text(error)
        raise SimulationError(
            f"{method} failed at frame {len(seen)} under [{hypothesis}]: {why}"
        ) from error


def _follow(
    start: Callable[[], Iterable[NDArray[Any]]],
    hypothesis: Hypothesis,
    seed: int,
    observed_positions: FloatArray,
    error_ceiling: float,
    ended: threading.Event,
) -> SimulationResult:
    """Compare frame by frame; close the simulation once its result is decided, or it is ended."""
    n_frames, shape = len(observed_positions), (observed_positions.shape[1], 3)
    flat = observed_positions.reshape(n_frames, -1)
    seen = ~np.isnan(flat)  # only what was seen is compared
    observed = [row[shown].tolist() for row, shown in zip(flat, seen, strict=True)]
    trajectory = np.full((n_frames, *shape), np.nan)
    errors = np.full(n_frames, np.inf)
    total, done = 0.0, 0
    failure = None
    clock = time.perf_counter()
    try:
        with contextlib.closing(_checked(start, n_frames, shape)) as incoming:
            while done < n_frames and total <= error_ceiling:
                frame = next(incoming)
                error = math.dist(frame[:, :2].ravel()[seen[done]].tolist(), observed[done])
                trajectory[done], errors[done] = frame, error
                total += error
                done += 1
                if ended.is_set():
                    raise Cancelled("the simulation was cancelled")
    except Cancelled:
        raise
    except (Exception, SystemExit) as error:  # a simulator may raise anything
        failure = error_text(error)
    completed = done == n_frames and failure is None
    seconds = time.perf_counter() - clock
    return SimulationResult(
        hypothesis, int(seed), trajectory, errors, done, completed, seconds, failure
    )


def _checked(
    start: Callable[[], Iterable[NDArray[Any]]], n_frames: int, shape: tuple[int, int]
) -> Generator[FloatArray, None, None]:
    """Yield frames until closed, which closes the simulator too; raise at a bad one."""
    produced = start()
    if not isinstance(produced, Iterable):
        raise SimulationError(
            f"the simulator returned {shown(produced)}, expected frames; did it forget to yield?"
        )
    incoming = iter(produced)
    count = 0
    try:
        for count, given in enumerate(incoming, start=1):
            values = np.asarray(given)
            if values.dtype.kind not in "biuf" or np.ma.is_masked(given):
                raise SimulationError(f"frame {count - 1} holds {shown(given)}, expected numbers")
            frame = values.astype(np.float64, copy=False)
            if frame.shape != shape:
                found = f"has shape {frame.shape}"
                raise SimulationError(f"frame {count - 1} {found}, expected {shape}")
            if not (np.abs(frame) < _FINITE).all():
                raise SimulationError(f"frame {count - 1} holds a value that is not finite")
            yield frame
        raise SimulationError(f"the simulator ended after {count} of {n_frames} frames")
    finally:
        if hasattr(incoming, "close"):
            incoming.close()


def error_text(error: BaseException) -> str:
    """Return class and message of ``error`` in one line, and where a user's code raised it."""
    # str() of a user's exception may itself raise; this does not
    trace = traceback.TracebackException.from_exception(error, limit=-1, lookup_lines=False)
    message = " ".join(str(trace).split())
    text = f"{type(error).__name__}: {message}" if message else type(error).__name__
    if isinstance(error, SimulationError) or not trace.stack:
        return text
    place = trace.stack[-1]
    return f"{text} ({Path(place.filename).name}, line {place.lineno}, in {place.name})"


@dataclasses.dataclass
class Statistics:
    """Costs of a runner's simulations."""

    simulations: int = 0  # run, failed ones included; identical requests count once
    frames: int = 0  # simulated
    frames_saved: int = 0  # not simulated because the result was decided
    seconds_simulating: float = 0.0  # summed over workers
    seconds_waiting: float = 0.0  # wall time spent in ``run``
    failures: int = 0  # simulations that failed
    retries: int = 0  # run again because they were lost, mostly with their worker
