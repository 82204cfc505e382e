"""Filtering a video under all hypotheses at once: frame by frame, or the whole of it."""

from __future__ import annotations

import itertools
import json
import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

import phase_ppl
from phase_ppl.analysis.closed_loop_table import SCHEMA, Table, dimensions, labels, table_of
from phase_ppl.analysis.tree import scene_dataset
from phase_ppl.closed_loop.goal_filter import GoalFilter, Growing, SearchSets
from phase_ppl.models.closed_loop import ClosedLoopLikelihood, closed_loop_prior
from phase_ppl.models.density import on_cpu
from phase_ppl.models.model import Model, for_table
from phase_ppl.models.prior_masses import PriorMasses
from phase_ppl.simulator.contract import LOG_PROB_NEXT, NEXT_FRAMES, goes_on, has_density
from phase_ppl.world.arrays import FloatArray, finite_array
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    instance_of,
    number_of_threads,
    number_or_nan,
    shown,
    whole_number,
)
from phase_ppl.world.event import FRAMES_PER_SECOND, SHOWN_SECONDS_PER_FRAME, Event, Observation
from phase_ppl.world.progress import counted
from phase_ppl.world.scene import Scene, check_inside
from phase_ppl.world.space import space_of
from phase_ppl.world.tracks import Clock

if TYPE_CHECKING:
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
    from phase_ppl.closed_loop.users_simulator import SimulatorFilter

_COUNTED: Final = ("searches", "calls")  # what it cost


class Watch:
    """The closed loop on one event, whose frames it is given one by one.

    The posterior after a frame depends only on the frames so far. After the last frame it is the
    one that :func:`phase_ppl.infer` returns. A ``Watch`` holds threads or processes until
    ``close()``; as a context manager it closes itself.

    Args:
        scene: the scene of the event.
        model: prior, and planner or simulator; its likelihood is None or a
            :class:`phase_ppl.ClosedLoopLikelihood`. Default: the paper's prior and simulator.
        seed: a whole number >= 0, the seed of the agents' beliefs and searches, or of the samples
            of a simulator of your own.
        threads: number of searches at a time; by default one per usable core. With a simulator of
            your own: largest number of processes, which start if a frame takes long. The posterior
            does not depend on this number.
        event_id: name of the event.
        observation: the whole video, if it is known beforehand, for a prior that looks at it.
            Frames must be given one by one all the same.

    Attributes:
        model: the model, with its likelihood.
        threads: number of threads or processes.

    Example:
        ``with ppl.watch(event.scene) as watch:`` and there, for every frame of
        ``event.observation.trajectory``, ``post = watch.update(frame)``

    Raises:
        InvalidSettingError: the model's likelihood compares whole simulations; its simulator cannot
            continue from observed frames, or there are too many hypotheses for it; or its prior
            looks at the video, and ``observation`` is not given.
    """

    @on_cpu()
    def __init__(
        self,
        scene: Scene,
        model: Model | None = None,
        *,
        seed: int = 0,
        threads: int | None = None,
        event_id: str = "",
        observation: Observation | None = None,
    ) -> None:
        self._begun = time.perf_counter()
        model = Model() if model is None else model
        instance_of("model", model, Model, "a phase_ppl.Model")
        self.model = model.for_reading()
        likelihood = self.model.likelihood
        assert isinstance(likelihood, ClosedLoopLikelihood), "it is for reading"
        self._likelihood = likelihood
        simulator = self.model.simulator
        if simulator is not None and not goes_on(simulator):
            raise InvalidSettingError(
                f"simulator={shown(simulator)} cannot go on from what was seen, as the closed loop "
                f"needs: add a method {LOG_PROB_NEXT} or {NEXT_FRAMES}, or name a kernel that "
                'samples whole simulations, as in infer(..., kernel="local_mh")'
            )
        instance_of("scene", scene, Scene, "a phase_ppl.Scene")
        self._scene, self._event_id = scene, event_id
        self._seed = whole_number("seed", seed, minimum=0)
        self.threads = number_of_threads(threads)
        self._frames: list[FloatArray] = []
        self._columns: defaultdict[str, Growing] = defaultdict(Growing)
        self._counts: Counter[str] = Counter()
        self._table: Table | None = None
        self._torn = False  # a frame was begun and not finished
        self._clock: Clock | None = None  # of frames with time stamps
        self._users_simulator = self.model.simulator is not None
        self._weight = likelihood.frame_weight(self._users_simulator)
        self._levels = likelihood.tracking.strengths
        prior = for_table(self.model.prior, scene, observation)
        kept, attrs = closed_loop_prior(prior, scene.world, self._levels)
        self._constant: dict[str, Any] = dict(kept)  # what does not change from frame to frame
        self._attrs: dict[str, Any] = dict(attrs)
        self._filter = self._simulator_filter() if self._users_simulator else self._goal_filter()
        self._keep(self._filter.at_start()._asdict())

    def _prior_masses(self, combinations: FloatArray) -> PriorMasses:
        return PriorMasses(space_of(self._scene.world), self._constant, combinations)

    def _goal_filter(self) -> GoalFilter:
        likelihood, of = self._likelihood, self._scene
        sets = SearchSets(
            *(of, self.model.planner_config(), likelihood.tracking, self._seed, self.threads),
            likelihood.planner_seeds,
        )
        self._constant["combinations"] = combinations = sets.hidden.combinations
        followed = self._prior_masses(combinations).followed()
        log_goals = self._constant.get("log_prior_goals")
        return GoalFilter(sets, likelihood.policy, self._weight, followed, log_goals)

    def _simulator_filter(self) -> SimulatorFilter:
        from phase_ppl.closed_loop.users_simulator import SimulatorFilter

        levels = itertools.product(self._levels, repeat=len(self._scene.world.agents))
        asked = self._prior_masses(np.array(list(levels))).to_read()
        self._constant |= {"combinations": asked.combinations, "goals": asked.goals}
        found = SimulatorFilter(
            self.model.simulator,
            self._scene,
            asked.hypotheses(),
            asked.chosen,
            self._frames,
            self._likelihood.tracking,
            samples=self._likelihood.samples,
            seed=self._seed,
            workers=self.threads,
        )
        self._attrs["samples"] = found.samples
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the threads or processes. The posterior of the frames so far stays available."""
        self._filter.close()

    def take(self, frame: ArrayLike, at: float | None = None) -> None:
        """Take in the next frame without computing the posterior.

        Args:
            frame: (entity, [x, y, angle]), units and rad. The first frame is the start; nothing is
                learnt from it. NaN means that a body was not seen: either all its three numbers are
                NaN, or its angle alone. An unseen body moves on as the model expects, and nothing
                is learnt about it. If a frame is missing, give one that is NaN throughout.
            at: the frame's time stamp, simulated seconds; needed unless there are 12 frames per
                simulated second. Frames with time stamps are converted to 12 per second, as by
                :meth:`phase_ppl.Observation.at_times`. A call then takes in the converted frames
                that are complete at ``at``, perhaps none. All frames have time stamps or none has.

        Raises:
            InvalidEventError: the frame has another shape, an infinite number, or a body outside
                the arena; a body was not seen, and the simulator has a density of whole frames; or
                the time stamp is not later than the last one, or later by more than an hour. The
                frames before stay read, and the next frame can follow.
            InvalidSettingError: reading an earlier frame was interrupted, or only some frames have
                time stamps. The frames before stay read.
            SimulationError: the simulator failed, or no hypothesis is possible any more.
        """
        name = f"frame {len(self._frames)}"
        pose = finite_array(name, frame, (len(self._scene.world.entities), 3), unseen=True)
        check_inside(pose[None], self._scene, name)
        if self._users_simulator and has_density(self.model.simulator) and np.isnan(pose).any():
            raise InvalidEventError(
                f"{name} does not show all bodies, and log_prob_next is a density of whole frames: "
                f"a simulator with {NEXT_FRAMES} instead can be read with gaps"
            )
        if self._torn:
            raise InvalidSettingError(
                f"reading {name} was interrupted, which left agents half way: watch it anew"
            )
        if not self._frames:
            self._clock = None if at is None else Clock()
        if (self._clock is None) != (at is None):
            raise InvalidSettingError(
                f"at={shown(at)} for {name}, expected time stamps of all frames or of none"
            )
        shows = [pose] if self._clock is None else self._clock.put(number_or_nan(at), pose)
        for one in shows:
            if self._frames:
                self._torn = True
                self._keep(self._filter.read(one)._asdict())
            self._columns["trajectory"].add(one)
            self._frames.append(one)
            self._torn = False

    def _keep(self, columns: Mapping[str, Any]) -> None:
        """Keep what one frame says; only :attr:`_frames` says how many count."""
        for name, value in columns.items():
            if name in _COUNTED:
                self._counts[name] += value
            elif value is not None:
                self._columns[name].add(value)

    def update(self, frame: ArrayLike, at: float | None = None) -> ClosedLoopPosterior:
        """Take in the next frame (see :meth:`take`); return the posterior of the frames so far."""
        self.take(frame, at)
        return self.posterior()

    def posterior(self) -> ClosedLoopPosterior:
        """Return the posterior given the frames so far; after the first one it is the prior.

        Raises:
            InvalidSettingError: there was no frame yet.
        """
        from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior

        found = self.dataset()
        last = self._table
        self._table = table_of(found) if last is None else last.extended(found)
        return ClosedLoopPosterior(found, prior=self.model.prior, table=self._table)

    def dataset(self) -> xr.Dataset:
        """Return the table of likelihoods of the frames so far, as a Dataset.

        Its variables are listed in :mod:`phase_ppl.analysis.closed_loop_table`.
        InvalidSettingError: there was no frame yet.
        """
        if not self._frames:
            raise InvalidSettingError("nothing was watched yet: update(frame) takes in a frame")
        scene, likelihood, n = self._scene, self._likelihood, len(self._frames)
        settings = {
            "model": self.model.fingerprint(),
            "likelihood": {**likelihood.to_dict(), "weight": self._weight},
            "seed": self._seed,
            "turning": scene.turning,
            "resets_velocity": scene.resets_velocity,
        }
        cost = {
            "searches": self._counts["searches"],
            **({"calls": self._counts["calls"]} if self._users_simulator else {}),
            "frames": n,
            "seconds": time.perf_counter() - self._begun,
            "video_seconds": (n - 1) * SHOWN_SECONDS_PER_FRAME,
            "threads": self.threads,
        }
        found, space = dict(self._constant), space_of(scene.world)
        known = dimensions(space)
        for name, column in self._columns.items():
            found[name] = np.moveaxis(column.first(n), 0, known[name].index("time"))
        variables = {name: (known[name], values) for name, values in found.items()}
        used = {dim for dims, _ in variables.values() for dim in dims}
        every = labels(space, self._levels).items()
        coords: dict[str, Any] = {name: told for name, told in every if name in used}
        coords["time"] = "time", np.arange(n) / FRAMES_PER_SECOND, {"units": "s"}
        attrs = {
            "schema": SCHEMA,
            **self._attrs,
            "event_id": self._event_id,
            "weight": self._weight,
            "settings": json.dumps(settings, default=repr),
            "cost": json.dumps(cost),
            "version": phase_ppl.__version__,
        }
        read = xr.Dataset(variables, coords, attrs)
        return read.merge(scene_dataset(scene), combine_attrs="no_conflicts")


watch = Watch


# --- the whole video ------------------------------------------------------------------------------


class ClosedLoopInterrupted(KeyboardInterrupt):
    """Ctrl-C while the closed loop reads a video: a ``KeyboardInterrupt``.

    Attributes:
        posterior: posterior given the frames that were read until then.
    """

    def __init__(self, posterior: ClosedLoopPosterior) -> None:
        n = len(posterior.observed())
        super().__init__(f"interrupted after {n} frames; see .posterior")
        self.posterior = posterior


def filtered_frames(
    event: Event,
    model: Model,
    seed: int = 0,
    threads: int | None = None,
    progress: bool | None = None,
) -> xr.Dataset:
    """Return what the frames of a whole video say (:mod:`phase_ppl.analysis.closed_loop_table`).

    Args:
        event: what to explain; only scene, observation and id are read.
        model: prior, and planner or simulator.
        seed, threads: as of :class:`Watch`; by default one per usable core.
        progress: whether to show a bar on stderr, with the time that is left; by default where
            that is a terminal.
    """
    scene, seen = event.scene, event.observation
    options: dict[str, Any] = {"seed": seed, "threads": threads, "event_id": event.id}
    with Watch(scene, model, observation=seen, **options) as watching:
        frames = list(seen.trajectory)
        watching.take(frames[0])
        try:
            for frame in counted(frames[1:], progress, "frame", "reading"):
                watching.take(frame)
        except KeyboardInterrupt as stop:
            raise ClosedLoopInterrupted(watching.posterior()) from stop
        return watching.dataset()
