"""The posterior of a whole video, by reading it step by step under all hypotheses."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.inference.runs.progress import counted, is_shown
from phase_ppl.inference.stepwise.watch import Watch
from phase_ppl.models.model import Model
from phase_ppl.world.event import Event

_TIMED: Final = 10
"""Frames after which the time of all is estimated."""

_LONG: Final = 60.0
"""Seconds that are worth saying where no bar is shown."""


class StepwiseInterrupted(KeyboardInterrupt):
    """The reading was interrupted; what was read until then is kept.

    Attributes:
        posterior: given the frames that were read.
    """

    def __init__(self, posterior: StepwisePosterior) -> None:
        n = len(posterior.observed())
        super().__init__(f"interrupted after {n} frames; see .posterior")
        self.posterior = posterior


def read_event(
    event: Event,
    model: Model,
    *,
    seed: int = 0,
    threads: int | None = None,
    progress: bool | None = None,
) -> StepwisePosterior:
    """Return the posterior over all hypotheses given the whole video.

    Args:
        event: what to explain; only scene, observation and id are read.
        model: with a :class:`phase_ppl.StepwiseLikelihood`.
        seed: of the agents' beliefs and searches.
        threads: searches at a time; by default one per usable core.
        progress: whether to show a bar on stderr, with the time that is left; by default where
            that is a terminal. Elsewhere one line says how long it will take, if that is more
            than a minute; with False nothing does.

    Raises:
        InvalidSettingError: the model cannot be read step by step.
        StepwiseInterrupted: Ctrl-C.
    """
    with Watch(event.scene, model, seed=seed, threads=threads, event_id=event.id) as watch:
        frames = list(event.observation.trajectory)
        watch.take(frames[0])
        try:
            for frame in _timed(frames[1:], progress):
                watch.take(frame)
        except KeyboardInterrupt as stop:
            raise StepwiseInterrupted(watch.posterior()) from stop
        return watch.posterior()


def _timed(
    frames: list[NDArray[np.float64]], progress: bool | None
) -> Iterator[NDArray[np.float64]]:
    """Yield the frames, and say on stderr how long all of them will take."""
    if progress is False or is_shown(progress):
        yield from counted(frames, progress, "frame", "reading")
        return
    began = time.monotonic()
    for index, frame in enumerate(frames):
        if index == _TIMED:
            left = (time.monotonic() - began) / _TIMED * (len(frames) - _TIMED)
            if left > _LONG:
                print(
                    f"reading {len(frames)} more frames takes about {left / 60:.0f} min",
                    file=sys.stderr,
                )
        yield frame
