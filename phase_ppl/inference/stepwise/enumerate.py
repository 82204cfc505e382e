"""The exact posterior of a whole video, by reading it step by step under all hypotheses."""

from __future__ import annotations

from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.inference.runs.progress import counted
from phase_ppl.inference.stepwise.watch import Watch
from phase_ppl.models.model import Model
from phase_ppl.world.event import Event


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
        progress: whether to show a bar on stderr; by default where that is a terminal.

    Raises:
        InvalidSettingError: the model cannot be read step by step.
        StepwiseInterrupted: Ctrl-C.
    """
    with Watch(event.scene, model, seed=seed, threads=threads, event_id=event.id) as watch:
        frames = list(event.observation.trajectory)
        watch.take(frames[0])
        try:
            for frame in counted(frames[1:], progress, "frame", "reading"):
                watch.take(frame)
        except KeyboardInterrupt as stop:
            raise StepwiseInterrupted(watch.posterior()) from stop
        return watch.posterior()
