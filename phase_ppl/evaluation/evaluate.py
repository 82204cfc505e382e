"""One call that asks a model about many events and scores what it answers."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import itertools
import os
import sys
import tempfile
import time
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from phase_ppl.analysis.summary import plain
from phase_ppl.dataset.hdf5 import SIGNATURE, with_event_id
from phase_ppl.evaluation.answer import Answer, Predict, as_prediction
from phase_ppl.evaluation.evaluation import Evaluation, cost_of
from phase_ppl.evaluation.folder import METRICS, POSTERIOR, ResultsFolder, holds_predictions
from phase_ppl.evaluation.judgments import all_events, judged
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.registry import ReadyModel, ready
from phase_ppl.inference.runs.progress import Bar
from phase_ppl.simulator.contract import described
from phase_ppl.simulator.jobs import Failure, results
from phase_ppl.simulator.processes import in_worker
from phase_ppl.world.checks import number_of_workers, whole_number
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.event import Event
from phase_ppl.world.files import locked, writable_folder, write_json
from phase_ppl.world.identity import differences, event_digest, stable, versions
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

if TYPE_CHECKING:
    from phase_ppl.evaluation.judgments import Study
    from phase_ppl.models.model import Model


COMPILED_OF: Final = 8
"""Events after which a worker lets go of what JAX has compiled.

Programs of events of other lengths would pile up, some 80 MB for each of SIMPLE's; those of events
of the same length are worth keeping, as they take 10 s to compile.
"""

_asked = itertools.count(1)


class Job(NamedTuple):
    """An event to be predicted, as a model sees it.

    Attributes:
        key: by which the caller knows it; models and worker processes do not get it.
        scene, observation: what is seen.
        seed: for the model.
    """

    key: str
    scene: Scene
    observation: Observation
    seed: int


@dataclasses.dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a job.

    Attributes:
        prediction: the answer, its ``cost`` with the ``seconds`` that it took, and the
            ``cpu_seconds`` of its process; None: there is none.
        artefacts: file name -> content, of files that belong to the answer.
        failure: what went wrong, where there is no prediction.
        of_settings: whether the model said that a setting cannot be used.
    """

    prediction: Prediction | None = None
    artefacts: Mapping[str, bytes] = dataclasses.field(default_factory=dict)
    failure: str = ""
    of_settings: bool = False


def ask(
    predict: Predict, scene: Scene, observation: Observation, seed: int, with_artefacts: bool
) -> Outcome:
    """Ask a model about one event; whatever it raises is an outcome."""
    clock, used = time.perf_counter(), time.process_time()
    try:
        given = predict(scene, observation, seed)
    except (Exception, SystemExit) as error:
        of_settings = isinstance(error, InvalidSettingError | UnknownNameError)
        return Outcome(failure=described(error), of_settings=of_settings)
    seconds, cpu = time.perf_counter() - clock, time.process_time() - used
    try:
        answer = given if isinstance(given, Answer) else Answer(given)
        prediction = as_prediction(answer.given)
        cost = {**stable(plain(prediction.cost)), "seconds": seconds, "cpu_seconds": cpu}
        prediction = dataclasses.replace(prediction, cost=cost)
        return Outcome(prediction, _written(answer) if with_artefacts else {})
    except Exception as error:
        return Outcome(failure=described(error))


def _written(answer: Answer) -> dict[str, bytes]:
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, write in answer.artefacts.items():
            path = Path(folder) / name
            write(path)
            found[name] = path.read_bytes()
    return found


def outcomes(
    predict: Predict, jobs: Sequence[Job], workers: int, with_artefacts: bool
) -> Generator[tuple[Job, Outcome], None, None]:
    """Yield each job with its outcome, as they finish; they begin in the order given.

    Args:
        predict: the model.
        jobs: what to ask.
        workers: processes; 1 asks in this process.
        with_artefacts: whether files that belong to the answers are wanted.

    Raises:
        InvalidSettingError: the model cannot be sent to worker processes, or not be loaded there.
    """
    given = [(job.scene, job.observation, job.seed, with_artefacts) for job in jobs]
    by_place = dict(enumerate(jobs))
    asked = results(_ask, predict, list(enumerate(given)), workers, "the model")
    with contextlib.closing(asked):
        for (place, _), result in asked:
            failed = isinstance(result, Failure)
            yield by_place[place], Outcome(failure=result.reason) if failed else result


def _ask(predict: Predict, job: tuple[int, tuple[Scene, Observation, int, bool]]) -> Outcome:
    try:
        return ask(predict, *job[1])
    finally:
        jax = sys.modules.get("jax")
        if in_worker() and jax is not None and next(_asked) % COMPILED_OF == 0:
            jax.clear_caches()


# --- the progress bar of an evaluation: events done, and the time that is left --------------------


class Progress(Bar):
    """A bar on stderr that counts events.

    Long events come first and take longer, so the time left rests on the seconds per frame.

    Args:
        frames: event id -> frames, of the events to be done.
        done: events done before.
        workers: that work side by side.
        shown: True or False; None: where stderr is a terminal, and in notebooks.
    """

    def __init__(
        self, frames: Mapping[str, int], done: int, workers: int, shown: bool | None = None
    ) -> None:
        self._left = dict(frames)
        self._workers = workers
        self._frames = 0
        self._seconds = 0.0
        super().__init__(done + len(frames), done, shown, "event", "predicting")

    def one_more(self, event_id: str, seconds: float | None) -> None:
        """Count an event that took so many seconds; None: it failed."""
        frames = self._left.pop(event_id)
        if seconds is not None:
            self._frames += frames
            self._seconds += seconds
        left = self.seconds_left()
        self._bar.steady_rate = len(self._left) / left if left else None
        self._bar.update(1)

    def seconds_left(self) -> float | None:
        """Return how long the rest takes at the pace until now; None: too early to say."""
        if not self._frames:
            return None
        each = self._seconds / self._frames
        together = min(self._workers, max(len(self._left), 1))
        return each * sum(self._left.values()) / together

    def say(self, text: str) -> None:
        """Write a line above the bar, where there is one."""
        if not self._bar.disable:
            self._bar.write(text, file=sys.stderr)


# --- the folder of an evaluation that begins, or goes on where it was left ------------------------

_DETERMINE: Final = ("model", "options", "model_settings", "function", "function_source", "seed")


def settings_of(model: ReadyModel, seed: int, events: Sequence[Event]) -> dict[str, Any]:
    """Return what determines the predictions, in JSON's types."""
    digests = {event.id: event_digest(event) for event in events}
    return {
        **model.record,
        "seed": seed,
        "versions": stable(versions()),
        "events": digests,
    }


def open_folder(
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
    if not resume or not holds_predictions(Path(path)):
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


def check_resumable(path: str | os.PathLike[str], settings: Mapping[str, Any]) -> None:
    """Raise what :func:`open_folder` would for other settings or events; change nothing.

    Raises:
        InvalidSettingError: the evaluation has other settings or events.
        InvalidEventError: it is damaged.
    """
    if holds_predictions(Path(path)):
        _check_same(ResultsFolder.open(path), settings)


def _check_same(folder: ResultsFolder, settings: Mapping[str, Any]) -> None:
    before, now = (
        {name: given.get(name) for name in _DETERMINE} for given in (folder.settings, settings)
    )
    found = differences(before, now)
    if before["model"] != now["model"]:  # of which the rest follows
        found = found[:1]
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


# --- one call that asks a model about many events and scores what it answers ----------------------


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
