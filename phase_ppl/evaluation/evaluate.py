"""One call that asks a model about many events and scores what it answers."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phase_ppl.dataset.hdf5 import SIGNATURE, with_event_id
from phase_ppl.evaluation.answer import Predict
from phase_ppl.evaluation.evaluation import Evaluation, cost_of
from phase_ppl.evaluation.folder import METRICS, POSTERIOR, ResultsFolder
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.progress import Progress
from phase_ppl.evaluation.registry import ReadyModel, ready
from phase_ppl.evaluation.resuming import open_folder, settings_of
from phase_ppl.evaluation.sources import all_events, judged
from phase_ppl.evaluation.work import Job, Outcome, outcomes
from phase_ppl.world.checks import number_of_workers, whole_number
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.files import locked, writable_folder, write_json

if TYPE_CHECKING:
    from phase_ppl.evaluation.judgments import Study
    from phase_ppl.models.model import Model


class EvaluationInterrupted(KeyboardInterrupt):
    """The evaluation was interrupted; what was finished is kept.

    Attributes:
        evaluation: of the events that were finished.
    """

    def __init__(self, evaluation: Evaluation) -> None:
        done, folder = len(evaluation.predictions), evaluation.folder
        where = "see .evaluation" if folder is None else f"kept in {folder.path}"
        super().__init__(
            f"the evaluation was interrupted; {done} of {len(evaluation.events)} events are "
            f"finished, {where}"
        )
        self.evaluation = evaluation


def evaluate(
    events: str | os.PathLike[str] | Event | Sequence[Event],
    model: str | Model | Predict = "simple",
    *,
    out: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    resume: bool = False,
    split: str | None = None,
    limit: int | None = None,
    seed: int = 0,
    judgments: str | os.PathLike[str] | Study | None = None,
    progress: bool | None = None,
    **options: Any,
) -> Evaluation:
    """Ask a model of social perception about many events, and score its answers.

    The model gets each event's scene and observation and a seed, nothing else. Longest events
    come first. An event at which the model fails is reported in ``failures`` and does not stop
    the rest, unless it is a setting of a model given by name and nothing has succeeded before.
    One whose worker process dies is tried again once.

    The seed of an event follows from ``seed`` and from what is seen of the event
    (:func:`event_seed`): the result is the same for any number of workers, order and choice of
    events.

    Args:
        events: an event file, a folder of event files or of a generated data set, the name of a
            bundled event, or events.
        model: a name (:func:`phase_ppl.available_models`); a :class:`phase_ppl.Model`, for SIMPLE
            with that prior, simulator and likelihood; or a function ``(scene, observation, seed)``
            that returns a :class:`phase_ppl.Prediction` or a mapping such as
            ``{"goal_red": {"get to green agent": 0.9, ...}, "relation": "friendly"}``.
        out: folder to keep everything in (:mod:`phase_ppl.evaluation.folder`), event by event;
            by default nothing is kept.
        workers: processes, at most; by default one per usable core. 1 runs the model in this
            process, as do models that are not to run side by side.
        resume: go on with the evaluation in ``out``, if there is one. Finished events are not
            predicted again, failed ones are. Settings and events must be the same, but there may
            be more events after those; truth and judgments may have changed.
        split: only the events of that split of a generated data set, such as "test".
        limit: only the first so many events.
        seed: a whole number >= 0.
        judgments: people's judgments, a file (:func:`phase_ppl.load_judgments`) or a study, in
            place of those in the events.
        progress: whether to show a bar on stderr; by default where that is a terminal.
        **options: of a model given by name.

    Raises:
        InvalidEventError: the events, their judgments or predictions cannot be read, two have
            the same id, or the results in ``out`` are damaged.
        InvalidSettingError, UnknownNameError: a setting that cannot be used; or ``out`` holds an
            evaluation with others, the message says which.
        OutputError: ``out`` cannot be written, or holds an evaluation and ``resume`` is not set.
        EvaluationInterrupted: Ctrl-C; it carries what was finished.
    """
    clock = time.monotonic()
    whole_number("seed", seed, minimum=0)
    slots = number_of_workers(workers)
    chosen = judged(all_events(events, split), judgments)
    if limit is not None:
        chosen = chosen[: whole_number("limit", limit)]
    asked = ready(model, options)
    settings = settings_of(asked, seed, chosen)
    with locked(None if out is None else writable_folder(out)):
        folder: ResultsFolder | None = None
        done: dict[str, Prediction] = {}
        notes: list[str] = []
        if out is not None:
            folder, done, notes = open_folder(out, settings, chosen, resume)
            settings = folder.settings
        digests: Mapping[str, str] = settings["events"]
        jobs = [
            Job(event.id, event.scene, event.observation, event_seed(seed, digests[event.id]))
            for event in sorted(chosen, key=lambda event: -event.observation.n_frames)
            if event.id not in done
        ]
        session = _Session(asked, folder, done, slots if asked.parallel else 1, progress)

        def evaluation() -> Evaluation:
            kept = {event.id: done[event.id] for event in chosen if event.id in done}
            cost = cost_of(kept, session.workers, time.monotonic() - clock)
            return Evaluation(chosen, kept, session.failures, settings, cost, folder, tuple(notes))

        try:
            session.work(jobs, notes)
        except KeyboardInterrupt as stop:
            raise EvaluationInterrupted(evaluation()) from stop
        found = evaluation()
        if folder is not None:
            write_json(folder.path / METRICS, found.metrics)
        return found


def event_seed(seed: int, digest: str) -> int:
    """Return the seed that a model gets for an event, below 2**31.

    Args:
        seed: of the evaluation.
        digest: of what is seen of the event (:func:`phase_ppl.world.identity.event_digest`).
    """
    found = hashlib.sha256(f"{seed} {digest}".encode()).digest()
    return int.from_bytes(found[:4], "big") >> 1


class _Session:
    """An evaluation at work.

    Args:
        model: is asked.
        folder: keeps what it answers, if there is one.
        done: event id -> prediction, to which new ones are added.
        workers, progress: as of :func:`evaluate`.

    Attributes:
        failures: event id -> what went wrong.
    """

    def __init__(
        self,
        model: ReadyModel,
        folder: ResultsFolder | None,
        done: dict[str, Prediction],
        workers: int,
        progress: bool | None,
    ) -> None:
        self.workers = workers
        self.failures: dict[str, str] = {}
        self._model, self._folder, self._done = model, folder, done
        self._progress = progress

    def work(self, jobs: Sequence[Job], notes: Sequence[str]) -> None:
        """Do the jobs."""
        frames = {job.key: job.observation.n_frames for job in jobs}
        with (
            Progress(frames, len(self._done), self.workers, self._progress) as bar,
            contextlib.closing(
                outcomes(self._model.predict, jobs, self.workers, self._folder is not None)
            ) as results,
        ):
            for note in notes:
                bar.say(note)
            for job, outcome in results:
                self._take(job, outcome, bar)

    def _take(self, job: Job, outcome: Outcome, bar: Progress) -> None:
        if outcome.prediction is not None:
            prediction = dataclasses.replace(outcome.prediction, event_id=job.key)
            if self._folder is not None:
                self._folder.add(
                    prediction, lambda folder: _write(folder, outcome.artefacts, job.key)
                )
            self._done[job.key] = prediction
            bar.one_more(job.key, prediction.cost["seconds"])
            return
        failure = f"model {self._model.name!r}, event {job.key!r}: {outcome.failure}"
        if outcome.of_settings and self._model.registered and not self._done:
            raise InvalidSettingError(failure)
        self.failures[job.key] = outcome.failure
        if self._folder is not None:
            self._folder.write_failures(self.failures)
        bar.say(failure)
        bar.one_more(job.key, None)


def _write(folder: Path, artefacts: Mapping[str, bytes], event_id: str) -> None:
    for name, content in artefacts.items():
        if name == POSTERIOR and content.startswith(SIGNATURE):
            # the model did not know of which event it is
            content = with_event_id(content, event_id)
        (folder / name).write_bytes(content)
