"""Evaluations in worker processes: the same results, and what survives a death, -9 and Ctrl-C."""

from __future__ import annotations

import functools
import os
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.evaluate import COMPILED_OF
from phase_ppl.evaluation.evaluation import ResultsFolder
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Truth
from tests.evaluation import toys
from tests.evaluation.toys import EVENTS, Counted, FailsAt, guesses, several, still
from tests.simulator.test_runner_processes import PATIENCE, is_alive, started, wait_until


def evaluate(model: Any, events: Any = EVENTS, **more: Any) -> ppl.Evaluation:
    return toys.evaluate(events, model, **{"workers": 2, **more})


def test_the_result_is_the_same_for_any_number_of_workers() -> None:
    one, two = (evaluate(guesses, workers=workers) for workers in (1, 2))
    assert list(one.predictions) == list(two.predictions) == list("abcd")
    for name, given in one.predictions.items():
        for question, values in given.probabilities.items():
            again = two.predictions[name].probabilities[question]
            assert values.tobytes() == again.tobytes()
    assert one.settings == two.settings
    assert (one.cost["workers"], two.cost["workers"]) == (1, 2)


@pytest.mark.parametrize("workers", [1, 2])
def test_models_from_anywhere_warm_up_once_work_in_workers_and_their_files_come_back(
    workers: int, tmp_path: Path
) -> None:
    label, warm = "friendly", tmp_path / "warm"

    class Local:
        def __call__(self, scene: Any, observation: Any, seed: int) -> Any:
            def write(path: Path) -> None:
                path.write_text(str(os.getpid()))

            assert warm.exists()
            return ppl.Answer({"relation": label}, {"process.txt": write})

        def warm_up(self) -> None:
            warm.touch(exist_ok=False)

    found = evaluate(Local(), out=tmp_path / "out", workers=workers)
    answers = [given.answers["relation"] for given in found.predictions.values()]
    assert answers == [label] * 4
    processes = {int(path.read_text()) for path in tmp_path.glob("out/events/*/process.txt")}
    assert (os.getpid() in processes) == (workers == 1)


def test_truth_judgments_ids_and_predictions_never_reach_a_worker() -> None:
    def searches(scene: Any, observation: Any, seed: int) -> Any:
        import gc

        things = gc.get_objects()
        found = [repr(type(thing)) for thing in things if type(thing) in (ppl.Event, Truth)]
        for thing in things:
            if type(thing) in (dict, list, tuple):
                values = thing.values() if type(thing) is dict else thing
                found += [v for v in values if type(v) is str and v[::-1].startswith("tneve-eht-")]
        if found:
            raise AssertionError(f"found {found}")
        return {"relation": "friendly"}

    names = ("name-1-of-the-event", "name-2-of-the-event")
    given = {"predictions": {"someone": {"relation": "friendly"}}}
    events = [still(name, 3 + i, **given) for i, name in enumerate(names)]
    assert not evaluate(searches, events).failures


def test_an_event_that_kills_its_process_is_tried_twice_and_costs_no_other(tmp_path: Path) -> None:
    out = tmp_path / "out"
    model = Counted(tmp_path / "calls", FailsAt(5, lambda: os._exit(1)))
    found = evaluate(model, out=out)
    assert found.failures == {"c": "its worker process died, in 2 of 2 runs"}
    assert list(found.predictions) == ["a", "b", "d"]
    assert model.calls()[5] == 2
    # one event is left: it must not take the evaluation itself with it
    again = evaluate(model, out=out, resume=True)
    assert list(again.failures) == ["c"]


def test_an_event_whose_process_dies_once_is_made_good(tmp_path: Path) -> None:
    died = tmp_path / "died"

    def dies_once(scene: Any, observation: Any, seed: int) -> Any:
        if observation.n_frames == 5 and not died.exists():
            died.touch()
            os._exit(1)
        return {"relation": "friendly"}

    found = evaluate(dies_once)
    assert died.exists()
    assert (len(found.predictions), found.failures) == (4, {})


def test_a_model_that_cannot_be_sent_is_refused_and_one_process_needs_no_sending() -> None:
    import threading

    lock = threading.Lock()

    def holds_a_lock(scene: Any, observation: Any, seed: int) -> Any:
        with lock:
            return {"relation": "friendly"}

    with pytest.raises(InvalidSettingError, match=r"cannot be sent to worker.*workers=1"):
        evaluate(holds_a_lock)
    assert len(evaluate(holds_a_lock, workers=1).predictions) == 4


def _falls_apart() -> None:
    raise ImportError("no module named elsewhere")


def test_a_model_that_cannot_be_loaded_there_is_refused() -> None:
    class CannotLoad:
        def __call__(self, scene: Any, observation: Any, seed: int) -> Any:
            raise AssertionError

        def __reduce__(self) -> Any:
            return _falls_apart, ()

    with pytest.raises(InvalidSettingError, match=r"cannot be loaded.*named elsewhere"):
        evaluate(CannotLoad())


# --- -9 and Ctrl-C -----------------------------------------------------------------------------

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
        while observation.n_frames < 5 and not (folder / "go").exists():
            time.sleep(0.05)
        with Progress(1, shown=False):
            return guesses(scene, observation, seed)

    ppl.evaluate(several(4), Counted(folder / "calls", slow), out=folder / "out",
                 workers=2, resume=True, progress=False)
"""


def finished(folder: Path) -> int:
    return len(list(folder.glob("out/events/[!.]*/prediction.json")))


def begun(folder: Path) -> int:
    return len(list(folder.glob("calls/*")))


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
@pytest.mark.parametrize("signal_", [signal.SIGKILL, signal.SIGINT])
def test_a_script_that_is_stopped_goes_on_without_repeating_what_is_finished(
    signal_: signal.Signals, tmp_path: Path
) -> None:
    """And leaves nothing behind, nor has its workers print anything."""
    with started(SCRIPT, tmp_path) as run:
        wait_until(lambda: run.poll() is not None or begun(tmp_path) > finished(tmp_path) == 2)
        assert run.poll() is None, run.communicate()[1]
        os.kill(run.pid, signal_)
        _, errors = run.communicate(timeout=PATIENCE)
    assert run.returncode != 0
    if signal_ == signal.SIGINT:
        assert "EvaluationInterrupted: the evaluation was interrupted; 2 of 4 events" in errors
    processes = {int(path.name.split("-")[2]) for path in (tmp_path / "calls").iterdir()}
    wait_until(lambda: not any(map(is_alive, processes)))
    assert finished(tmp_path) == 2
    assert not (tmp_path / "out" / "metrics.json").exists()

    (tmp_path / "go").touch()
    model = Counted(tmp_path / "calls", guesses)
    before = model.calls()
    assert (before[6], before[5]) == (1, 1)
    with started(SCRIPT, tmp_path) as again:
        assert (*again.communicate(timeout=PATIENCE), again.returncode) == ("", "", 0)
    after = model.calls()
    assert (after[6], after[5]) == (1, 1)
    assert (after[4], after[3]) == (before.get(4, 0) + 1, before.get(3, 0) + 1)
    found = ppl.Evaluation.load(tmp_path / "out").predictions
    assert list(found) == list("abcd")
    for name, whole in evaluate(guesses, workers=1).predictions.items():
        assert found[name].answers == whole.answers


def test_ctrl_c_in_this_process_keeps_what_was_done(tmp_path: Path) -> None:
    def stops() -> Any:
        raise KeyboardInterrupt

    with pytest.raises(ppl.EvaluationInterrupted, match=r"2 of 4 events.*kept in") as caught:
        evaluate(FailsAt(4, stops), workers=1, out=tmp_path)
    assert list(caught.value.evaluation.predictions) == ["c", "d"]
    assert caught.value.evaluation.metrics["n_events"] == 2
    assert not (tmp_path / "metrics.json").exists()


def test_what_was_kept_just_before_ctrl_c_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = ResultsFolder.add

    def adds_the_last_thing(folder: ResultsFolder, *given: Any) -> None:
        add(folder, *given)
        raise KeyboardInterrupt

    monkeypatch.setattr(ResultsFolder, "add", adds_the_last_thing)
    with pytest.raises(ppl.EvaluationInterrupted, match=r"1 of 4 events.*kept in") as caught:
        evaluate(guesses, workers=1, out=tmp_path)
    assert list(caught.value.evaluation.predictions) == ["d"]


def test_compiled_programs_do_not_pile_up_in_workers() -> None:
    def compiles(scene: Any, observation: Any, seed: int) -> Any:
        import jax.numpy as jnp

        before = _doubled()._cache_size()
        _doubled()(jnp.zeros(observation.n_frames))
        return ppl.Prediction("", answers={"relation": "friendly"}, cost={"kept": before})

    # one of the two gets more than so many
    found = evaluate(compiles, several(2 * COMPILED_OF + 1), workers=2)
    assert max(given.cost["kept"] for given in found.predictions.values()) == COMPILED_OF - 1
    # those of the caller's own process are left alone, also where its threads do the work
    with ThreadPoolExecutor(1) as thread:
        for given in ({"workers": 1}, {"executor": thread, "workers": 1}):
            _doubled().clear_cache()
            here = evaluate(compiles, several(COMPILED_OF + 1), **given)
            assert max(one.cost["kept"] for one in here.predictions.values()) == COMPILED_OF


@functools.cache
def _doubled() -> Any:
    import jax

    return jax.jit(lambda x: 2 * x)
