"""One call that asks a model about many events and scores what it answers."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import loky

from phase_ppl.dataset.load import load_events
from phase_ppl.evaluation.answer import Predict
from phase_ppl.evaluation.evaluation import Evaluation, cost_of
from phase_ppl.evaluation.folder import METRICS, ResultsFolder, write_json
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.progress import Progress
from phase_ppl.evaluation.references import reference_predictions
from phase_ppl.evaluation.registry import ReadyModel, ready
from phase_ppl.evaluation.votes import event_judgments
from phase_ppl.evaluation.work import Job, Outcome, outcomes
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.identity import differences, event_digest, stable, versions

if TYPE_CHECKING:
    from phase_ppl.evaluation.judgments import Study
    from phase_ppl.models.model import Model

EVENT_FILES: Final = (".json",)
"""Endings of the files that are read from a folder of events."""

_DETERMINE: Final = ("model", "options", "model_settings", "function", "function_source", "seed")


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
        events: an event file, a folder of event files, the name of a bundled event, or events.
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
    slots = loky.cpu_count() if workers is None else whole_number("workers", workers)
    chosen = _judged(_all_events(events), judgments)
    if limit is not None:
        chosen = chosen[: whole_number("limit", limit)]
    asked = ready(model, options)
    settings = _settings(asked, seed, chosen)
    folder: ResultsFolder | None = None
    done: dict[str, Prediction] = {}
    notes: list[str] = []
    if out is not None:
        folder, done, notes = _open(out, settings, chosen, resume)
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
                self._folder.add(prediction, lambda folder: _write(folder, outcome.artefacts))
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


def _write(folder: Path, artefacts: Mapping[str, bytes]) -> None:
    for name, content in artefacts.items():
        (folder / name).write_bytes(content)


# --- events ------------------------------------------------------------------------------------


def _all_events(events: str | os.PathLike[str] | Event | Sequence[Event]) -> list[Event]:
    """Return the events of a file or folder, or those given.

    Raises:
        InvalidEventError: there are none, or two with the same id.
    """
    if isinstance(events, Event):
        sources = [("", [events])]
    elif isinstance(events, str | os.PathLike):
        sources = [(f" in {file}", load_events(file)) for file in _files(events)]
    else:
        sources = [("", list(events))]
    seen: dict[str, str] = {}
    for where, found in sources:
        for event in found:
            if not isinstance(event, Event):
                raise InvalidEventError(f"{shown(event)} is no event; phase_ppl.load_events reads")
            if event.id in seen:
                both = f"{seen[event.id]} and{where}" if where else ""
                raise InvalidEventError(f"there are two events with the id {event.id!r}{both}")
            seen[event.id] = where
    if not seen:
        raise InvalidEventError("there are no events to evaluate")
    return [event for _, found in sources for event in found]


def _files(path: str | os.PathLike[str]) -> list[Path]:
    source = Path(path)
    if not source.is_dir():
        return [source]
    files = sorted(file for file in source.iterdir() if file.suffix.lower() in EVENT_FILES)
    if not files:
        raise InvalidEventError(f"{source}: the folder holds no event files (.json)")
    return files


def _judged(
    events: list[Event], judgments: str | os.PathLike[str] | Study | None
) -> Sequence[Event]:
    """Return the events with people's judgments; what cannot be scored is found out now.

    Raises:
        InvalidEventError, UnknownNameError: judgments or stored predictions cannot be read.
    """
    if judgments is not None:
        from phase_ppl.evaluation.judgments import Study, load_judgments, with_judgments

        study = judgments if isinstance(judgments, Study) else load_judgments(judgments, events)
        events = with_judgments(events, study)
    reference_predictions(events)
    for event in events:
        event_judgments(event)
    return events


# --- what was done before ----------------------------------------------------------------------


def _settings(model: ReadyModel, seed: int, events: Sequence[Event]) -> dict[str, Any]:
    """Return what determines the predictions, in JSON's types."""
    digests = {event.id: event_digest(event) for event in events}
    return {
        **model.record,
        "seed": seed,
        "versions": stable(versions()),
        "events": digests,
    }


def _open(
    path: str | os.PathLike[str],
    settings: Mapping[str, Any],
    events: Sequence[Event],
    resume: bool,
) -> tuple[ResultsFolder, dict[str, Prediction], list[str]]:
    """Return the folder of results, the predictions that are in it, and notes.

    Raises:
        OutputError: it holds an evaluation that is not to be resumed, or cannot be written.
        InvalidSettingError: the evaluation has other settings or events.
        InvalidEventError: it is damaged.
    """
    if not resume or not (Path(path) / "settings.json").exists():
        return ResultsFolder.create(path, settings, events), {}, []
    folder = ResultsFolder.open(path)
    _check_same(folder, settings)
    done: dict[str, Prediction] = {}
    notes = []
    for event in folder.events:
        try:
            prediction = folder.prediction(event.id)
        except InvalidEventError as error:
            notes.append(f"{error}; the event is predicted again")
            continue
        if prediction is not None:
            done[event.id] = prediction
    before = folder.settings.get("versions") or {}
    other = differences(before, settings["versions"])
    if other and len(done) < len(events):
        raise InvalidSettingError(f"{path} was made with other versions: {'; '.join(other)}")
    folder.update({**settings, "versions": before}, events)
    return folder, done, notes


def _check_same(folder: ResultsFolder, settings: Mapping[str, Any]) -> None:
    before, now = (
        {name: given.get(name) for name in _DETERMINE} for given in (folder.settings, settings)
    )
    found = differences(before, now)
    if found:
        raise InvalidSettingError(
            f"{folder.path} holds an evaluation with other settings: {'; '.join(found)}"
        )
    old, new = folder.settings.get("events"), settings["events"]
    if not isinstance(old, dict) or list(old) != [event.id for event in folder.events][: len(old)]:
        raise InvalidEventError(f"{folder.path}: settings.json and events.json do not fit together")
    if len(old) > len(new):
        raise InvalidSettingError(
            f"{folder.path} holds an evaluation of {len(old)} events, but {len(new)} are given"
        )
    for place, (was, given) in enumerate(zip(old, new, strict=False), start=1):
        if was != given:
            raise InvalidSettingError(
                f"{folder.path} holds an evaluation of other events: number {place} is "
                f"{given!r}, was {was!r}"
            )
        if old[was] != new[given]:
            raise InvalidSettingError(
                f"{folder.path} holds an evaluation of another event {was!r}: its scene or "
                "observation differ"
            )
