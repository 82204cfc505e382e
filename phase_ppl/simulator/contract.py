"""The contract of a simulator, and one simulation compared with what was observed.

A simulator is anything that, given a scene, a hypothesis and a random generator, yields frames.
It is a black box: inference sees its frames only.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import threading
import time
from collections.abc import Iterator
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.errors import PhasePPLError, SimulationError
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import ENTITIES
from phase_ppl.world.scene import Scene

FloatArray = NDArray[np.float64]

FRAME_SHAPE: Final = (len(ENTITIES), 3)
_STREAM: Final = 0x5EED
"""Keeps simulations' random streams apart from others that a user derives from the same seed."""


class Simulator(Protocol):
    """Yields frames (4, 3) = x, y [units], angle [rad] per entity until it is closed.

    The first frame is compared with the first observed one. ``hypothesis`` holds effective goals
    and alpha = (0, 0). Ending early, or a value that is not finite, is a failed simulation.
    """

    def __call__(
        self, scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
    ) -> Iterator[FloatArray]: ...


class Cancelled(PhasePPLError):
    """The run was cancelled from elsewhere."""


@dataclasses.dataclass(frozen=True, eq=False)
class SimulationResult:
    """One simulation, complete or not.

    Attributes:
        hypothesis: as requested (stated goals and alpha).
        seed: as requested.
        trajectory: (time, entity, coord) float32; NaN where not simulated.
        errors: (time,) distance ||s - s^|| over the x, y of all entities, units; inf where not
            simulated.
        frames_simulated: frames taken from the simulator.
        completed: all frames were simulated.
        seconds: time spent simulating.
        failure: what went wrong, or None.
    """

    hypothesis: Hypothesis
    seed: int
    trajectory: NDArray[np.float32]
    errors: FloatArray
    frames_simulated: int
    completed: bool
    seconds: float = 0.0
    failure: str | None = None

    @property
    def total_error(self) -> float:
        """Sum of the errors of the frames that were simulated, units."""
        return float(self.errors[: self.frames_simulated].sum())

    @classmethod
    def failed(
        cls, hypothesis: Hypothesis, seed: int, n_frames: int, failure: str, seconds: float = 0.0
    ) -> SimulationResult:
        """Return the result of a simulation that gave nothing."""
        trajectory = np.full((n_frames, *FRAME_SHAPE), np.nan, np.float32)
        errors = np.full(n_frames, np.inf)
        return cls(hypothesis, seed, trajectory, errors, 0, False, seconds, failure)


def random_generator(seed: int) -> np.random.Generator:
    """Return the generator of the simulation with this seed."""
    return np.random.default_rng([int(seed) & 0xFFFFFFFF, _STREAM])


def _checked(frame: object, index: int) -> FloatArray:
    array = np.asarray(frame, dtype=float)
    if array.shape != FRAME_SHAPE:
        raise ValueError(f"frame {index} has shape {array.shape}, expected {FRAME_SHAPE}")
    if not np.isfinite(array).all():
        raise ValueError(f"frame {index} holds a value that is not finite")
    return array


def frames_of(
    simulator: Simulator, scene: Scene, hypothesis: Hypothesis, seed: int, n_frames: int
) -> Iterator[FloatArray]:
    """Yield ``n_frames`` checked frames; the simulator is closed whenever this is closed.

    Raises:
        ValueError: a frame of the wrong shape or not finite, or too few frames.
    """
    frames = iter(simulator(scene, hypothesis.effective(), random_generator(seed)))
    close = getattr(frames, "close", None)
    with contextlib.ExitStack() as stack:
        if close is not None:
            stack.callback(close)
        count = 0
        for count, frame in enumerate(itertools.islice(frames, n_frames), start=1):
            yield _checked(frame, count - 1)
        if count < n_frames:
            raise ValueError(f"the simulator ended after {count} of {n_frames} frames")


def simulate_one(
    simulator: Simulator,
    scene: Scene,
    hypothesis: Hypothesis,
    seed: int,
    observed: FloatArray,
    error_ceiling: float = np.inf,
    cancelled: threading.Event | None = None,
) -> SimulationResult:
    """Run one simulation against what was observed, no further than it can matter.

    Args:
        simulator, scene, hypothesis, seed: what to simulate.
        observed: (time, entity, 2) observed x, y, units.
        error_ceiling: the simulation is closed once its summed error exceeds this, units.
        cancelled: checked between frames.

    Raises:
        Cancelled: ``cancelled`` was set.
    """
    n_frames = len(observed)
    trajectory = np.full((n_frames, *FRAME_SHAPE), np.nan, np.float32)
    errors = np.full(n_frames, np.inf)
    total, t = 0.0, 0
    begin = time.perf_counter()
    failure = None
    try:
        with contextlib.closing(
            frames_of(simulator, scene, hypothesis, seed, n_frames)  # type: ignore[type-var]
        ) as frames:
            for frame in frames:
                if cancelled is not None and cancelled.is_set():
                    raise Cancelled("the simulation was cancelled")
                trajectory[t] = frame
                errors[t] = np.linalg.norm(frame[:, :2] - observed[t])
                total += errors[t]
                t += 1
                if total > error_ceiling:
                    break
    except Cancelled:
        raise
    except Exception as error:  # a user's simulator may raise anything; it must not be lost
        failure = f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - begin
    if failure is not None:
        return SimulationResult.failed(hypothesis, seed, n_frames, failure, seconds)
    return SimulationResult(
        hypothesis,
        seed,
        trajectory,
        errors,
        frames_simulated=t,
        completed=bool(t == n_frames and total <= error_ceiling),
        seconds=seconds,
    )


def simulate_trajectory(
    simulator: Simulator, scene: Scene, hypothesis: Hypothesis, seed: int, n_frames: int
) -> FloatArray:
    """Return a simulated trajectory (time, entity, coord).

    Raises:
        SimulationError: the simulator raised, ended early or gave a value that is not finite.
    """
    try:
        return np.array(list(frames_of(simulator, scene, hypothesis, seed, n_frames)))
    except Exception as error:
        raise SimulationError(
            f"simulation of [{hypothesis}] with seed {seed} failed: {error}"
        ) from error
