"""Evaluations in worker processes: the same results, and what survives a death, -9 and Ctrl-C."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.simulator.processes import in_worker
from phase_ppl.world.errors import AnswerError, InvalidSettingError
from phase_ppl.world.event import Truth
from tests.evaluation.toys import Counted, FailsAt, evaluate, guesses, still
from tests.simulator.test_runner_processes import PATIENCE, is_alive, started
from tests.simulator.toys import wait_until


def test_workers_answer_as_one_process_does_and_get_to_know_no_more(tmp_path: Path) -> None:
    class Local:
        """Cannot be imported anywhere; looks for what it must not see."""

        def __init__(self, folder: Path) -> None:
            folder.mkdir()
            self.warm = folder / "warm"

        def warm_up(self) -> None:
            self.warm.touch(exist_ok=False)

        def __call__(self, scene: Any, observation: Any, seed: int) -> Any:
            assert self.warm.exists()
            found = of_events() if in_worker() else []
            if found:
                raise AssertionError(f"found {found}")
            where = f"{os.getpid()} {in_worker()}"
            answer = {"relation": np.random.default_rng(seed).dirichlet(np.ones(3))}
            return ppl.Answer(answer, {"where.txt": lambda path: path.write_text(where)})

    def of_events() -> list[str]:
        """Return events, truths and ids of events in the memory of this process."""
        import gc

        things = gc.get_objects()
        found = [repr(type(thing)) for thing in things if type(thing) in (ppl.Event, Truth)]
        for thing in things:
            if type(thing) in (dict, list, tuple):
                values = thing.values() if type(thing) is dict else thing
                found += [v for v in values if type(v) is str and v[::-1].startswith("tneve-eht-")]
        return found

    said = {"predictions": {"someone": {"relation": "friendly"}}}
    events = [still(f"name-{i}-of-the-event", 3 + i, shift=0.1 * i, **said) for i in range(3)]
    assert of_events(), "they are found where they are"
    results = []
    for workers in (1, 2):
        folder = tmp_path / f"{workers}"
        found = evaluate(events, Local(folder), workers=workers, out=folder / "out")
        assert not found.failures
        where = [path.read_text().split() for path in folder.glob("out/events/*/where.txt")]
        here = [(process == f"{os.getpid()}", worker) for process, worker in where]
        assert here == [(workers == 1, f"{workers == 2}")] * 3
        answers = {
            (name, question): shares.tobytes()
            for name, given in found.predictions.items()
            for question, shares in given.probabilities.items()
        }
        results.append((list(found.predictions), answers, found.settings))
    assert results[0] == results[1]


def test_an_event_that_kills_its_process_is_tried_twice(tmp_path: Path) -> None:
    model = Counted(tmp_path / "calls", FailsAt(3, lambda: os._exit(1)))
    with pytest.raises(AnswerError, match="event 'still': its worker process died, in 2 of 2 runs"):
        evaluate(still(), model, workers=2)
    assert model.calls() == {3: 2}


def _falls_apart() -> None:
    raise ImportError("no module named elsewhere")


def test_a_model_that_cannot_be_loaded_is_refused_and_a_thread_is_no_worker() -> None:
    class CannotLoad:
        def __call__(self, scene: Any, observation: Any, seed: int) -> Any:
            raise AssertionError

        def __reduce__(self) -> Any:
            return _falls_apart, ()

    def asks(scene: Any, observation: Any, seed: int) -> Any:
        return {"relation": "neutral" if in_worker() else "friendly"}

    with ThreadPoolExecutor(1) as threads:
        with pytest.raises(InvalidSettingError, match=r"cannot be loaded.*named elsewhere"):
            evaluate(model=CannotLoad(), executor=threads)
        found = evaluate(still(), asks, executor=threads)
    assert found.predictions["still"].answers["relation"] == "friendly"


# without a guard, so that a worker that imported it would start it again
SCRIPT = """
    import sys, time
    from pathlib import Path
    import phase_ppl as ppl
    from phase_ppl.world.progress import Progress
    from tests.evaluation.toys import Counted, several, guesses

    folder = Path(sys.argv[1])

    def slow(scene, observation, seed):
        # events of fewer frames come later, and wait
        while observation.n_frames < 5:
            time.sleep(0.05)
        with Progress(1, shown=False):
            return guesses(scene, observation, seed)

    ppl.evaluate(several(4), Counted(folder / "calls", slow), out=folder / "out",
                 workers=2, resume=True, progress=False)
"""


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_a_script_that_is_stopped_goes_on_and_repeats_nothing(tmp_path: Path) -> None:
    """And leaves nothing behind."""
    model, out = Counted(tmp_path / "calls", guesses), tmp_path / "out"

    def finished() -> int:
        return len(list(out.glob("events/[!.]*/prediction.json")))

    def stop(signal_: signal.Signals) -> str:
        """Stop it at its third event; return what it has printed."""
        before = max(2, sum(model.calls().values()))
        with started(SCRIPT, tmp_path) as run:
            wait_until(
                lambda: (
                    run.poll() is not None
                    or (finished() == 2 and sum(model.calls().values()) > before)
                )
            )
            assert run.poll() is None, run.communicate()[1]
            os.kill(run.pid, signal_)
            printed, errors = run.communicate(timeout=PATIENCE)
        assert run.returncode != 0
        processes = {int(path.name.split("-")[2]) for path in (tmp_path / "calls").iterdir()}
        wait_until(lambda: not any(map(is_alive, processes)))
        assert finished() == 2
        assert not (out / "metrics.json").exists()
        return printed + errors

    interrupted = "EvaluationInterrupted: the evaluation was interrupted; 2 of 4 events"
    assert interrupted in stop(signal.SIGINT)
    stop(signal.SIGKILL)
    before = model.calls()
    found = evaluate(model=model, out=out, resume=True).predictions
    assert model.calls() == {**before, 4: before.get(4, 0) + 1, 3: before.get(3, 0) + 1}
    assert (before[6], before[5]) == (1, 1)
    for name, whole in evaluate(model=guesses).predictions.items():
        assert found[name].answers == whole.answers
