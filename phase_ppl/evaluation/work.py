"""Asking a model about many events, in worker processes, whatever becomes of a single one."""

from __future__ import annotations

import contextlib
import dataclasses
import secrets
import tempfile
import time
import traceback
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from pathlib import Path
from typing import Any, Final, NamedTuple

import cloudpickle

from phase_ppl.analysis.summary import plain
from phase_ppl.evaluation.answer import Answer, Predict, as_prediction
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.simulator.processes import Processes, loaded
from phase_ppl.world.errors import InvalidSettingError, PhasePPLError, UnknownNameError
from phase_ppl.world.identity import stable
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

RUNS: Final = 2
"""How often an event is tried whose worker process dies."""


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
        prediction: the answer, its ``cost`` with the ``seconds`` that it took; None: there is none.
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
    clock = time.perf_counter()
    try:
        given = predict(scene, observation, seed)
    except (Exception, SystemExit) as error:
        of_settings = isinstance(error, InvalidSettingError | UnknownNameError)
        return Outcome(failure=described(error), of_settings=of_settings)
    seconds = time.perf_counter() - clock
    try:
        answer = given if isinstance(given, Answer) else Answer(given)
        prediction = as_prediction(answer.given)
        cost = {**stable(plain(prediction.cost)), "seconds": seconds}
        prediction = dataclasses.replace(prediction, cost=cost)
        return Outcome(prediction, _written(answer) if with_artefacts else {})
    except Exception as error:
        return Outcome(failure=described(error))


def described(error: BaseException) -> str:
    """Return in one line what was raised, and where, unless the message was made to explain."""
    message = " ".join(str(error).split())
    words = f"{type(error).__name__}: {message}" if message else type(error).__name__
    frames = traceback.extract_tb(error.__traceback__)
    if not frames or isinstance(error, PhasePPLError):
        return words
    last = frames[-1]
    return f"{words} ({Path(last.filename).name}, line {last.lineno}, in {last.name})"


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
    if not jobs:
        return
    if workers > 1:
        # processes even for a single job, which may be the one that kills its process
        dispatch = _Dispatch(predict, jobs, min(workers, len(jobs)), with_artefacts)
        yield from dispatch.outcomes()
        return
    _warm_up(predict)
    for job in jobs:
        yield job, ask(predict, job.scene, job.observation, job.seed, with_artefacts)


def _warm_up(predict: Predict) -> None:
    if hasattr(predict, "warm_up"):
        with contextlib.suppress(Exception):  # the events will raise it again
            predict.warm_up()


# --- in a worker -----------------------------------------------------------------------------


def _ask_in_worker(token: str, *given: Any) -> Outcome | str:
    predict = _model(token)
    return predict if isinstance(predict, str) else ask(predict, *given)


def _warm_up_in_worker(token: str) -> None:
    predict = _model(token)
    if not isinstance(predict, str):
        _warm_up(predict)


def _model(token: str) -> Predict | str:
    """Return the model, or why it cannot be loaded here."""
    try:
        predict: Predict = loaded(token)
        return predict
    except Exception as error:
        return described(error)


# --- in the parent ---------------------------------------------------------------------------


@dataclasses.dataclass(eq=False)
class _Task:
    """A job on its way, and how often it was lost with its worker."""

    job: Job
    losses: int = 0


class _Dispatch:
    """Jobs on worker processes.

    When a worker dies, everything that was running is lost with it. Those jobs then run again
    one at a time, so that only the one that kills its worker is given up.
    """

    def __init__(
        self, predict: Predict, jobs: Sequence[Job], workers: int, with_artefacts: bool
    ) -> None:
        try:
            packed = cloudpickle.dumps(predict)
        except Exception as error:
            raise InvalidSettingError(
                f"the model cannot be sent to worker processes ({described(error)}); workers=1 "
                "needs none"
            ) from error
        self._token = secrets.token_hex(8)
        self._workers = workers
        self._processes = Processes(workers, self._token, packed)
        self._cold = hasattr(predict, "warm_up")
        self._with_artefacts = with_artefacts
        self._waiting = deque(_Task(job) for job in jobs)
        self._suspects: deque[_Task] = deque()
        self._running: dict[Future[Any], _Task] = {}

    def outcomes(self) -> Iterator[tuple[Job, Outcome]]:
        """Yield each job with its outcome, as they finish. Closing this ends what runs."""
        try:
            self._warm_up()
            while self._waiting or self._suspects or self._running:
                self._send()
                wait(self._running, return_when=FIRST_COMPLETED)
                yield from self._finished()
        finally:
            self._processes.close()

    def _warm_up(self) -> None:
        """Let one worker do what all can then share."""
        if self._cold:
            future = self._processes.begin(_warm_up_in_worker, self._token)
            wait([future])
            if isinstance(future.exception(), BrokenExecutor):
                self._processes.kill()

    def _send(self) -> None:
        while len(self._running) < self._workers:
            source = self._suspects or self._waiting
            if not source or (self._suspects and self._running):
                return
            try:
                future = self._begin(source[0].job)
            except BrokenExecutor:
                if self._running:  # they are about to end as lost
                    return
                # a worker died while there was nothing to do
                self._processes.kill()
                future = self._begin(source[0].job)
            task = source.popleft()
            self._running[future] = task
            if task.losses:
                return

    def _begin(self, job: Job) -> Future[Any]:
        given = (job.scene, job.observation, job.seed, self._with_artefacts)
        return self._processes.begin(_ask_in_worker, self._token, *given)

    def _finished(self) -> Iterator[tuple[Job, Outcome]]:
        done = [(future, task) for future, task in self._running.items() if future.done()]
        broken = any(isinstance(future.exception(), BrokenExecutor) for future, _ in done)
        if broken:
            self._processes.kill()
        lost = dict(self._running) if broken else {}
        for future, task in done:
            error = future.exception()
            if isinstance(error, BrokenExecutor):
                continue
            lost.pop(future, None)
            del self._running[future]
            yield task.job, self._outcome(future, error)
        for future, task in lost.items():
            del self._running[future]
            task.losses += 1
            if task.losses < RUNS:
                self._suspects.append(task)
            else:
                times = f"in {task.losses} of {task.losses} runs"
                yield task.job, Outcome(failure=f"its worker process died, {times}")

    def _outcome(self, future: Future[Any], error: BaseException | None) -> Outcome:
        if error is not None:  # such as an answer that cannot be pickled
            return Outcome(failure=described(error))
        result = future.result()
        if isinstance(result, str):
            raise InvalidSettingError(
                f"the model cannot be loaded in worker processes ({result}); workers=1 needs none"
            )
        outcome: Outcome = result
        return outcome
