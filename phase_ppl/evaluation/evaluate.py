"""``evaluate`` asks a model about many events and scores its answers."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import itertools
import os
import sys
import tempfile
import time
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from phase_ppl.analysis.event_posterior import EventPosterior
from phase_ppl.data.hdf5 import SIGNATURE, with_event_id
from phase_ppl.evaluation.evaluation import Evaluation
from phase_ppl.evaluation.folder import METRICS, POSTERIOR, ResultsFolder, all_events
from phase_ppl.evaluation.judgments import Study, judged
from phase_ppl.evaluation.prediction import Prediction, until_moments
from phase_ppl.evaluation.ratings import moments_of
from phase_ppl.evaluation.registry import (
    Answer,
    Onlooker,
    Predict,
    ReadyModel,
    check_world,
    ready,
    seen_through,
)
from phase_ppl.evaluation.table import world_of
from phase_ppl.simulator.contract import error_text
from phase_ppl.simulator.processes import Failure, in_worker, results, slots_of
from phase_ppl.world.errors import (
    AnswerError,
    InvalidSettingError,
    SimulationError,
    UnknownNameError,
    whole_number,
)
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.files import locked, writable_folder, write_json
from phase_ppl.world.identity import event_digest, stable, versions
from phase_ppl.world.picture import plain
from phase_ppl.world.progress import Bar
from phase_ppl.world.scene import Scene

if TYPE_CHECKING:
    from phase_ppl.models.model import Model

COMPILED_OF: Final = 8
"""Events after which a worker drops JAX's compiled programs.

Programs for events of other lengths would pile up, some 80 MB for each of SIMPLE's. Those for
events of the same length are worth keeping: they take 10 s to compile.
"""

_asked = itertools.count(1)


class EvaluationInterrupted(KeyboardInterrupt):
    """A KeyboardInterrupt: the evaluation was interrupted; finished events are kept.

    Attributes:
        evaluation: the evaluation of the events that were finished.
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
    model: str | Model | Predict = "closed_loop",
    *,
    out: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    resume: bool = False,
    limit: int | None = None,
    seed: int = 0,
    judgments: str | os.PathLike[str] | Study | None = None,
    progress: bool | None = None,
    observer: str | os.PathLike[str] | Onlooker | None = None,
    **options: Any,
) -> Evaluation:
    """Ask a model of social perception about many events, and score its answers.

    The model gets each event's scene and observation and a seed, nothing else. The longest events
    come first. If the model fails at an event, ``failures`` reports it, and the other events
    follow. A bad setting of a named model is raised at once. If a worker process dies, its event is
    tried once more.

    If people judged at moments of a film, a posterior is read at the frame of each moment. A
    kernel's posterior is read in hindsight: its simulations were chosen by the whole film. A model
    without a posterior is asked about the film cut at that frame.

    The seed of an event follows from ``seed``, scene and observation (:func:`event_seed`). So
    results do not depend on the number of workers, nor on order and choice of events.

    Args:
        events: an event file, a folder of event files or of a generated data set, the name of a
            bundled event, or events. All must be of one world.
        model: one of three. The default is the closed loop.

            * A name (:func:`phase_ppl.available_models`). Of the package's own models, these also
              work in other worlds than PHASE: "closed_loop", "simple", "predicate", "last_frame",
              "no_physics", "noisy_physics", "full_observation", "true_state", "no_cost_weight" and
              "no_social_goals".
            * A :class:`phase_ppl.Model`. :func:`phase_ppl.infer` runs it with the closed loop, or
              with the kernel that ``kernel=...`` names.
            * A function ``(scene, observation, seed)``. It returns a :class:`phase_ppl.Prediction`,
              a posterior or a mapping such as
              ``{"goal_red": {"get to green agent": 0.9, ...}, "relation": "friendly"}``.
              :func:`phase_ppl.questions_of` has the keys in other worlds.
        out: folder to keep all results in (:mod:`phase_ppl.evaluation.folder`), event by event; by
            default nothing is kept.
        workers: largest number of processes; by default one per usable core. With 1 the model runs
            in this process; so do models that cannot run in parallel. With an ``executor``: how
            many events to give it at a time; by default up to 1000.
        executor: any PEP 3148 executor to run the model in, such as that of a ``dask.distributed``
            client. It is not shut down. Models that cannot run in parallel do not use it.
        resume: whether to continue the evaluation in ``out``, if there is one. Finished events are
            not predicted again, failed events are. Settings and events must be the same. Further
            events may be added; truth and judgments may have changed.
        limit: number of events to ask about, the first in the order given; by default all.
        seed: the seed that the events' seeds follow from, a whole number >= 0.
        judgments: people's judgments, in place of those in the events: a file
            (:func:`phase_ppl.load_judgments`) or a study.
        progress: whether to show a bar on stderr; by default if stderr is a terminal.
        observer: turns the model's answers into those of a person who watches: "people" (the
            package's own), the file of a fitted observer, a result of :func:`phase_ppl.fit_people`,
            or any other :class:`phase_ppl.Onlooker`. None: the model's answers stay.
        **options: options of a named model; for a ``Model``, options of :func:`phase_ppl.infer`. A
            function takes none.

    Raises:
        InvalidEventError: the events, their judgments or predictions cannot be read; two events
            have the same id; or the results in ``out`` are damaged.
        InvalidSettingError, UnknownNameError: a setting cannot be used; events are of several
            worlds, or of a world that the model does not know; or ``out`` holds an evaluation with
            other settings, which the message names.
        OutputError: ``out`` cannot be written, or holds an evaluation and ``resume`` is not set.
        SimulationError: the executor takes no more work.
        AnswerError: the model failed at every event; the message has the first failure.
        EvaluationInterrupted: Ctrl-C was pressed.

    The last three errors have the evaluation of the finished events as ``.evaluation``.
    """
    whole_number("seed", seed, minimum=0)
    slots = slots_of(workers, executor)
    given = all_events(events)
    world = world_of(given)
    chosen = judged(given, judgments)
    check_world(model, world)
    if limit is not None:
        chosen = chosen[: whole_number("limit", limit)]
    ready_model = ready(model, options)
    if observer is not None:
        ready_model = seen_through(ready_model, observer, world)
    if not ready_model.parallel:
        executor, slots = None, 1
    settings = settings_of(ready_model, seed, chosen)
    with locked(None if out is None else writable_folder(out)):
        folder: ResultsFolder | None = None
        done: dict[str, Prediction] = {}
        notes: list[str] = []
        if out is not None:
            folder, done, notes = ResultsFolder.begin(out, settings, chosen, resume)
            settings = folder.settings
        failures: dict[str, str] = {}

        def evaluation() -> Evaluation:
            kept = {event.id: done[event.id] for event in chosen if event.id in done}
            return Evaluation(chosen, kept, failures, settings, folder, tuple(notes))

        for event in chosen:
            if event.id in done and not set(moments_of(event)) <= set(done[event.id].moments):
                del done[event.id]
        left = sorted(
            (event for event in chosen if event.id not in done),
            key=lambda event: -event.observation.n_frames,
        )
        outcomes = _outcomes(ready_model, left, settings, folder is not None, slots, executor)
        try:
            # longer events take longer: the remaining time is estimated by frames
            frames = {event.id: event.observation.n_frames for event in chosen}
            ready_before = sum(frames[event_id] for event_id in done)
            with (
                Bar(sum(frames.values()), ready_before, progress, "frame", "predicting") as bar,
                contextlib.closing(outcomes),
            ):

                def say(text: str) -> None:
                    if not bar.disable:
                        bar.write(text, file=sys.stderr)

                def count(event_id: str) -> None:
                    finished = f"{len(done) + len(failures)} of {len(chosen)} events"
                    bar.set_postfix_str(finished, refresh=False)
                    bar.update(frames[event_id])

                for note in notes:
                    say(note)
                for event_id, outcome in outcomes:
                    if outcome.prediction is not None:
                        prediction = dataclasses.replace(outcome.prediction, event_id=event_id)
                        if folder is not None:
                            folder.add(prediction, functools.partial(_write, outcome, event_id))
                        done[event_id] = prediction
                        count(event_id)
                        continue
                    failure = f"model {ready_model.name!r}, event {event_id!r}: {outcome.failure}"
                    if outcome.of_settings and ready_model.registered and not done:
                        raise InvalidSettingError(failure)
                    failures[event_id] = outcome.failure
                    if folder is not None:
                        folder.write_failures(failures)
                    say(failure)
                    count(event_id)
        except KeyboardInterrupt as stop:
            if folder is not None:  # a prediction may have been written just now
                done.update(folder.predictions([]))
            raise EvaluationInterrupted(evaluation()) from stop
        except SimulationError as error:
            error.evaluation = evaluation()  # type: ignore[attr-defined]
            raise
        found = evaluation()
        if folder is not None:
            write_json(folder.path / METRICS, found.metrics)
        if failures and not done:
            first = next(event.id for event in chosen if event.id in failures)
            n = len(failures)
            failed = AnswerError(
                f"model {ready_model.name!r} failed at {n} of {n} events; event {first!r}: "
                f"{failures[first]}"
            )
            failed.evaluation = found  # type: ignore[attr-defined]
            raise failed
        return found


def settings_of(model: ReadyModel, seed: int, events: Sequence[Event]) -> dict[str, Any]:
    """Return all that determines the predictions of the events, in JSON's types."""
    return {
        **model.record,
        "seed": seed,
        "versions": stable(versions()),
        "events": {event.id: event_digest(event) for event in events},
    }


def event_seed(seed: int, digest: str) -> int:
    """Return the seed that a model gets for an event, below 2**31."""
    found = hashlib.sha256(f"{seed} {digest}".encode()).digest()
    return int.from_bytes(found[:4], "big") >> 1


def _outcomes(
    model: ReadyModel,
    events: Sequence[Event],
    settings: Mapping[str, Any],
    with_artefacts: bool,
    workers: int | None,
    executor: Executor | None,
) -> Generator[tuple[str, _Outcome], None, None]:
    """Ask about the events, begun in the given order; yield each id and outcome."""
    seed, digests = settings["seed"], settings["events"]
    jobs = [
        # the rest of the event is hidden from models and worker processes
        _Job(i, e.scene, e.observation, event_seed(seed, digests[e.id]), with_artefacts, m)
        for i, e in enumerate(events)
        for m in [moments_of(e)]
    ]
    answers = results(_ask, model.predict, jobs, workers, "the model", executor)
    with contextlib.closing(answers):
        for job, result in answers:
            lost = isinstance(result, Failure)
            yield events[job.place].id, _Outcome(failure=result.reason) if lost else result


def _write(outcome: _Outcome, event_id: str, folder: Path) -> None:
    """Write the files that belong to an answer."""
    for name, content in outcome.artefacts.items():
        if name == POSTERIOR and content.startswith(SIGNATURE):
            # the model did not know the event's id
            content = with_event_id(content, event_id)
        (folder / name).write_bytes(content)


# --- asking about one event, here or in a worker --------------------------------------------------


class _Job(NamedTuple):
    """An event to predict; the index is its place among the chosen events."""

    place: int
    scene: Scene
    observation: Observation
    seed: int
    with_artefacts: bool
    moments: tuple[float, ...] = ()  # of the film, at which the model's answer is read off


class _Outcome(NamedTuple):
    """The result of a job."""

    # the answer; its ``cost`` has ``seconds`` and the ``cpu_seconds`` of its process. None: none
    prediction: Prediction | None = None
    artefacts: Mapping[str, bytes] = {}  # file name -> content, of files that belong to the answer
    failure: str = ""  # what went wrong, where there is no prediction
    of_settings: bool = False  # whether the model said that a setting cannot be used


def _ask(predict: Predict, job: _Job) -> _Outcome:
    """Ask a model about one event; any exception becomes an outcome."""
    clock, used = time.perf_counter(), time.process_time()
    given: Any = None
    try:
        given = predict(job.scene, job.observation, job.seed)
        seconds, cpu = time.perf_counter() - clock, time.process_time() - used
        answer = Answer.of(given)
        prediction = Prediction.of(answer.given, world=job.scene.world)
        if job.moments:
            prediction = _at_moments(prediction, answer, predict, job)
        cost = {**stable(plain(prediction.cost)), "seconds": seconds, "cpu_seconds": cpu}
        prediction = dataclasses.replace(prediction, cost=cost)
        return _Outcome(prediction, _contents(answer) if job.with_artefacts else {})
    except (Exception, SystemExit) as error:
        of_settings = given is None and isinstance(error, InvalidSettingError | UnknownNameError)
        return _Outcome(failure=error_text(error), of_settings=of_settings)
    finally:
        jax = sys.modules.get("jax")
        if in_worker() and jax is not None and next(_asked) % COMPILED_OF == 0:
            jax.clear_caches()


def _at_moments(prediction: Prediction, answer: Answer, predict: Predict, job: _Job) -> Prediction:
    """Return a prediction with ``moments``: of the posterior, or of the film until then."""
    if isinstance(answer.given, EventPosterior):
        moments, hindsight = until_moments(answer.given, job.moments)
        return dataclasses.replace(prediction, moments=moments, hindsight=hindsight)
    found = {}
    for at in job.moments:
        given = predict(job.scene, job.observation.until(at), job.seed)
        made = Prediction.of(Answer.of(given).given, world=job.scene.world)
        found[at] = made.probabilities
    return dataclasses.replace(prediction, moments=found)


def _contents(answer: Answer) -> dict[str, bytes]:
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, write in answer.artefacts.items():
            path = Path(folder) / name
            write(path)
            found[name] = path.read_bytes()
    return found
