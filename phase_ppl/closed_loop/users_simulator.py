"""Reading a video by a simulator of one's own: how probable each frame is under every hypothesis.

The simulator goes on from what was seen. It says itself how probable the next frame is
(``log_prob_next``), or draws next frames (``next_frames``), around which a kernel density is put.
Under all hypotheses draws begin with the same random state, so that what is chance in them is so
alike, and what they differ in is what hypotheses mean.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.closed_loop.hidden_state import Tracking
from phase_ppl.closed_loop.kernel_density import PARTS, log_density
from phase_ppl.simulator.contract import has_density, log_prob_next, next_frames
from phase_ppl.simulator.processes import (
    BorrowedExecutor,
    CannotLoad,
    Dispatch,
    OwnWorkers,
    pool_for,
)
from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.errors import SimulationError, shown
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene

_STREAM: Final = 0x4E87
"""Keeps draws of next frames apart from other numbers that are drawn from the same seed."""

_TOGETHER: Final = 8  # hypotheses whose samples are weighed at once, whoever does it
_PER_WORKER: Final = 4  # jobs of a frame for each process
WORTH_PROCESSES: Final = 0.3
"""Seconds of a frame from which on processes are started, which takes longer than that."""


class FrameJob(NamedTuple):
    """What a worker needs to say how probable frames are."""

    simulator: Any
    scene: Scene
    hypotheses: Sequence[Hypothesis]  # with effective goals
    samples: int  # 0: the simulator has a density
    scale: float  # of kernels, see ``kernel_density.log_density``; and so the next
    noise: float

    def read(
        self, seen: FloatArray, frame: FloatArray, seed: tuple[int, ...], first: int, last: int
    ) -> tuple[FloatArray, float]:
        """Return log densities of a frame under some hypotheses, given those seen before it.

        (set, hypothesis): with all samples, and without each part of them if there are any. Also
        by how many nats the frame is less probable than on the sample nearest to it, NaN without.
        """
        seen.setflags(write=False)
        frame.setflags(write=False)
        chosen = self.hypotheses[first:last]
        at = frame[:, :2].ravel()
        shown = ~np.isnan(at)
        if not self.samples:
            given = self.simulator, self.scene
            return np.array([[log_prob_next(*given, h, seen, frame) for h in chosen]]), np.nan
        found, far = [], []
        for start in range(0, len(chosen), _TOGETHER):
            drawn = [self._drawn(h, seen, seed) for h in chosen[start : start + _TOGETHER]]
            axes = np.compress(shown, np.array(drawn), axis=2)
            densities, nearest = log_density(axes, at[shown], self.scale, self.noise)
            found.append(densities)
            far.append(nearest.min())
        return np.concatenate(found, axis=1), float(min(far))

    def _drawn(self, hypothesis: Hypothesis, seen: FloatArray, seed: tuple[int, ...]) -> FloatArray:
        rng = np.random.default_rng(seed)
        frames = next_frames(self.simulator, self.scene, hypothesis, seen, rng, self.samples)
        return frames[:, :, :2].reshape(self.samples, -1)

    def warm_up(self) -> None:
        """Do once what all workers can then share."""
        if hasattr(self.simulator, "warm_up"):
            self.simulator.warm_up()


class SimulatorReading(NamedTuple):
    """What one frame says, by a simulator of one's own."""

    log_likelihood: FloatArray  # (goals, combination), NaN where it was not read
    log_likelihood_without: FloatArray  # (part, goals, combination) without parts of the samples
    unexplained: float  # nats by which it is less probable than on the nearest sample; or NaN
    calls: int  # of the simulator


class SimulatorFilter:
    """Reads a video frame by frame; the likelihood of a frame never changes afterwards.

    Args:
        simulator: a simulator that can continue from the frames that were seen.
        scene: where everything starts.
        hypotheses: the hypotheses to read, in the order in which ``read`` is true.
        read: (goals, combination) whether a hypothesis is read.
        frames: the frames seen so far. Their owner adds each frame after it was read.
        tracking: scale of kernel densities, and noise of the observed positions.
        samples: number for each hypothesis and frame, if the simulator has no density.
        seed: seed of the samples.
        workers: most processes. They are started only if frames take long enough. The result does
            not depend on their number.

    Attributes:
        samples: as above; 0 if the simulator has a density.
        n_parts: number of parts of the samples. The jackknife leaves out each once.
    """

    def __init__(
        self,
        simulator: Any,
        scene: Scene,
        hypotheses: Sequence[Hypothesis],
        read: BoolArray,
        frames: Sequence[FloatArray],
        tracking: Tracking,
        samples: int,
        seed: int,
        workers: int,
    ) -> None:
        self.samples = 0 if has_density(simulator) else samples
        self.n_parts = PARTS if self.samples else 0
        noise = tracking.noise or 0.0
        given = simulator, scene, hypotheses, self.samples, tracking.scale, noise
        self._next = FrameJob(*given)
        self._read, self._frames, self._seed, self._workers = read, frames, seed, workers
        self._pool: OwnWorkers | BorrowedExecutor | None = None
        self._so_far = np.zeros(len(hypotheses))
        self._next.warm_up()

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.close()

    def at_start(self) -> SimulatorReading:
        """Return what is known before the first frame: nothing."""
        return self._reading(np.zeros((1 + self.n_parts, len(self._so_far))), 0.0, 0)

    def read(self, frame: FloatArray) -> SimulatorReading:
        """Take in the next frame, (entity, 3) x, y [units], angle [rad], NaN where unseen.

        Raises:
            SimulationError: the simulator failed, or the frames so far are impossible under all
                hypotheses.
        """
        seen, n, clock = np.array(self._frames), len(self._so_far), time.perf_counter()
        if np.isnan(frame[:, :2]).all():  # which tells nothing
            return self._reading(np.zeros((1 + self.n_parts, n)), 0.0, 0)
        seen[0] = np.where(np.isnan(seen[0]), self._next.scene.start, seen[0])
        given = seen, frame.copy(), (self._seed, _STREAM, len(seen))
        if self._pool is None:
            found, far = self._next.read(*given, 0, n)
            if self._workers > 1 and time.perf_counter() - clock > WORTH_PROCESSES:
                what = f"simulator={shown(self._next.simulator)}"
                self._pool = pool_for(self._next, what, self._workers, None, True)
        else:
            found, far = self._read_in(self._pool, given, n)
        self._so_far += found[0]
        if not np.isfinite(self._so_far).any():
            raise SimulationError(
                f"frame {len(seen)} leaves no hypothesis possible that has prior mass: "
                "log_prob_next is -inf; expected some chance of every frame, however small"
            )
        return self._reading(found, far, n)

    def _read_in(
        self, pool: OwnWorkers | BorrowedExecutor, given: tuple[Any, ...], n: int
    ) -> tuple[FloatArray, float]:
        block = _TOGETHER if self.samples else 1
        size = -(-n // (self._workers * _PER_WORKER * block)) * block
        jobs = list(range(0, n, size))
        dispatch = Dispatch(
            pool,
            FrameJob.read,
            jobs,
            arguments=lambda first: (*given, first, first + size),
            failed=_lost,
        )
        try:
            with contextlib.closing(dispatch.results()) as results:
                done = dict(results)
        except CannotLoad as error:
            raise SimulationError(
                f"the simulator cannot be loaded in a worker process: {error}; workers=1 needs none"
            ) from None
        parts = [done[first] for first in jobs]
        return np.concatenate([one for one, _ in parts], axis=1), min(far for _, far in parts)

    def _reading(self, found: FloatArray, far: float, calls: int) -> SimulatorReading:
        every = np.full((len(found), *self._read.shape), np.nan)
        every[:, self._read] = found
        return SimulatorReading(every[0], every[1:].astype(np.float32), far, calls)


def _lost(first: int, reason: str, error: BaseException | None) -> Any:
    raise SimulationError(f"reading by the simulator failed: {reason}") from error
