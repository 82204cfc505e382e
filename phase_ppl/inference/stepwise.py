"""Filtering a video under all hypotheses at once: frame by frame, or the whole of it."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

import phase_ppl
from phase_ppl.analysis.stepwise_table import STRENGTHS, kind_of_table, summed_by_pair
from phase_ppl.analysis.tree import scene_dataset
from phase_ppl.closed_loop.goal_filter import PairFilter, PolicyFilter, SearchSets, stacked
from phase_ppl.models.model import Model, checked_sites
from phase_ppl.models.stepwise import StepwiseLikelihood, stepwise_prior
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    instance_of,
    number_of_workers,
    whole_number,
)
from phase_ppl.world.event import FRAMES_PER_SECOND, SHOWN_SECONDS_PER_FRAME, Event
from phase_ppl.world.progress import counted, is_shown
from phase_ppl.world.scene import PHASE, Scene, check_inside, finite_array

if TYPE_CHECKING:
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

_OF_FRAMES: Final = ("strengths", "actions", "held", "unexplained", "log_peak")


class Watch:
    """An observer of one event, to be given its frames one by one.

    What it says after a frame is the same whatever follows, and after the last frame it is what
    :func:`phase_ppl.infer` returns. It holds threads until ``close()``; as a context manager it
    closes itself.

    Args:
        scene: where everything starts.
        model: prior and planner, with a :class:`phase_ppl.StepwiseLikelihood`.
        seed: of the agents' beliefs and searches.
        threads: searches at a time; the result does not depend on it.
        event_id: name of the event.

    Raises:
        InvalidSettingError: the model has another likelihood, or a simulator of its own.
    """

    def __init__(
        self,
        scene: Scene,
        model: Model | None = None,
        *,
        seed: int = 0,
        threads: int | None = None,
        event_id: str = "",
    ) -> None:
        self._clock = time.perf_counter()
        model = Model() if model is None else model
        instance_of("model", model, Model, "a phase_ppl.Model")
        self.model = model.for_reading()
        likelihood = self._likelihood = self.model.likelihood
        assert isinstance(likelihood, StepwiseLikelihood), "it is for reading"
        if self.model.simulator is not None:
            raise InvalidSettingError(
                "the stepwise likelihood asks the agents of the joint simulator for their "
                "policies; the model has a simulator of its own"
            )
        instance_of("scene", scene, Scene, "a phase_ppl.Scene")
        self._scene, self._event_id = scene, event_id
        self._seed = whole_number("seed", seed, minimum=0)
        self.threads = number_of_workers(threads, "threads")
        self._frames: list[FloatArray] = []
        self._torn = False  # a frame was begun and not finished
        tracking, in_phase = likelihood.tracking, scene.world == PHASE
        if in_phase:
            checked_sites(self.model.prior)
        prior, self._attrs = stepwise_prior(self.model.prior, scene.world, tracking.strengths)
        sets = SearchSets(
            *(scene, self.model.planner_config(), tracking, self._seed, self.threads),
            likelihood.planner_seeds,
        )
        kind = PairFilter if in_phase else PolicyFilter
        of_goals = summed_by_pair(prior["log_prior"]) if in_phase else prior["log_prior_goals"]
        self._prior = prior
        self._filter = kind(sets, likelihood.conduct, likelihood.weight, of_goals)
        self._readings = [self._filter.at_start()]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the threads; what was read stays."""
        self._filter.close()

    def take(self, frame: ArrayLike) -> None:
        """Take in the next frame without asking for the posterior.

        Args:
            frame: (entity, [x, y, angle]), units and rad; the first one shows the start, from
                which nothing is learnt.

        Raises:
            InvalidEventError: another shape, a number that is not finite, or a body outside of
                the arena. What was read before stays, and the next frame can follow.
            InvalidSettingError: an earlier frame was interrupted while it was read. What was
                read before that stays.
        """
        name = f"frame {len(self._frames)}"
        pose = finite_array(name, frame, (len(self._scene.world.entities), 3))
        check_inside(pose[None], self._scene, name)
        if self._torn:
            raise InvalidSettingError(
                f"reading {name} was interrupted, which left agents half way: watch it anew"
            )
        if self._frames:
            self._torn = True
            self._readings.append(self._filter.read(pose))
        self._frames.append(pose)
        self._torn = False

    def update(self, frame: ArrayLike) -> StepwisePosterior:
        """Take in the next frame, as :meth:`take`, and return the posterior now."""
        self.take(frame)
        return self.posterior()

    def posterior(self) -> StepwisePosterior:
        """Return the posterior given the frames so far, the prior before the second.

        Raises:
            InvalidSettingError: not even the start was seen.
        """
        from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

        return StepwisePosterior(self.dataset(), prior=self.model.prior)

    def dataset(self) -> xr.Dataset:
        """Return what the frames so far say (:mod:`phase_ppl.analysis.stepwise_table`)."""
        if not self._frames:
            raise InvalidSettingError("nothing was watched yet: update(frame) takes in a frame")
        scene, likelihood, n = self._scene, self._likelihood, len(self._frames)
        readings, kind = self._readings[:n], kind_of_table(scene.world)
        settings = {
            "model": self.model.fingerprint(),
            "likelihood": likelihood.to_dict(),
            "seed": self._seed,
            "turning": scene.turning,
            "resets_velocity": scene.resets_velocity,
        }
        cost = {
            "searches": sum(one.searches for one in readings),
            "frames": n,
            "seconds": time.perf_counter() - self._clock,
            "video_seconds": (n - 1) * SHOWN_SECONDS_PER_FRAME,
            "threads": self.threads,
        }
        columns = {name: [getattr(one, name) for one in readings] for name in _OF_FRAMES}
        columns |= {name: [one.of_goals[name] for one in readings] for name in readings[0].of_goals}
        columns["trajectory"] = self._frames
        found: dict[str, Any] = {"combinations": self._filter.combinations, **self._prior}
        for name, values in columns.items():
            along = kind.dimensions[name].index("time")
            found[name] = stacked(list(map(np.asarray, values)), along)
        coords: dict[str, Any] = dict(kind.labels(scene.world))
        if scene.world == PHASE:
            levels = list(likelihood.tracking.strengths)
            found["strengths"] = found["strengths"].reshape(-1, len(levels), len(levels))
            coords |= {name: levels for name in STRENGTHS}
        coords["time"] = "time", np.arange(n) / FRAMES_PER_SECOND, {"units": "s"}
        attrs = {
            "schema": kind.schema,
            **self._attrs,
            "event_id": self._event_id,
            "weight": float(likelihood.weight),
            "settings": json.dumps(settings, default=repr),
            "cost": json.dumps(cost),
            "version": phase_ppl.__version__,
        }
        variables = {name: (dims, found[name]) for name, dims in kind.dimensions.items()}
        read = xr.Dataset(variables, coords, attrs)
        return read.merge(scene_dataset(scene), combine_attrs="no_conflicts")


def watch(
    scene: Scene,
    model: Model | None = None,
    *,
    seed: int = 0,
    threads: int | None = None,
    event_id: str = "",
) -> Watch:
    """Return an observer of an event, to be given its frames: all as of :class:`Watch`.

    Example:
        ``with ppl.watch(event.scene) as watch:`` and there, for every frame of
        ``event.observation.trajectory``, ``post = watch.update(frame)``
    """
    return Watch(scene, model, seed=seed, threads=threads, event_id=event_id)


# --- the whole video ------------------------------------------------------------------------------

_TIMED: Final = 10  # frames after which the time of all is estimated
_LONG: Final = 60.0  # seconds that are worth saying where no bar is shown


class StepwiseInterrupted(KeyboardInterrupt):
    """The reading was interrupted; what was read until then is kept.

    Attributes:
        posterior: given the frames that were read.
    """

    def __init__(self, posterior: StepwisePosterior) -> None:
        n = len(posterior.observed())
        super().__init__(f"interrupted after {n} frames; see .posterior")
        self.posterior = posterior


def filter_event(
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
    """
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

    return StepwisePosterior(
        filtered_frames(event, model, seed, threads, progress), prior=model.prior
    )


def filtered_frames(
    event: Event,
    model: Model,
    seed: int = 0,
    threads: int | None = None,
    progress: bool | None = None,
) -> xr.Dataset:
    """Return what the posterior of :func:`filter_event` is made of."""
    with Watch(event.scene, model, seed=seed, threads=threads, event_id=event.id) as watching:
        frames = list(event.observation.trajectory)
        watching.take(frames[0])
        try:
            for frame in _timed(frames[1:], progress):
                watching.take(frame)
        except KeyboardInterrupt as stop:
            raise StepwiseInterrupted(watching.posterior()) from stop
        return watching.dataset()


def _timed(frames: list[FloatArray], progress: bool | None) -> Iterator[FloatArray]:
    """Yield the frames, and say on stderr how long all of them will take."""
    if progress is False or is_shown(progress):
        yield from counted(frames, progress, "frame", "reading")
        return
    begun: list[float] = []
    for index, frame in enumerate(frames):
        begun.append(time.monotonic())
        if index == _TIMED:
            # the median, as whatever is not compiled yet is in the first frames that need it
            left = float(np.median(np.diff(begun))) * (len(frames) - _TIMED)
            if left > _LONG:
                print(
                    f"reading {len(frames)} more frames takes about {left / 60:.0f} min",
                    file=sys.stderr,
                )
        yield frame
