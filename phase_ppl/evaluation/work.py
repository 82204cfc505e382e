"""Asking a model about many events, in worker processes, whatever becomes of a single one."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import sys
import tempfile
import time
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from phase_ppl.analysis.summary import plain
from phase_ppl.evaluation.answer import Answer, Predict, as_prediction
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.simulator.jobs import Failure, described, results
from phase_ppl.simulator.processes import in_worker
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.identity import stable
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

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
