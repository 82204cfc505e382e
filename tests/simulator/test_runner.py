"""Many simulations: the same results on any workers, in order, counted and never lost."""

from __future__ import annotations

import concurrent.futures as futures
import dataclasses
import re
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phase_ppl.simulator import processes
from phase_ppl.simulator.contract import Cancelled, SimulationResult
from phase_ppl.simulator.processes import OwnWorkers
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.errors import InvalidSettingError, SimulationError, UnknownNameError
from phase_ppl.world.event import Observation
from tests.simulator import toys
from tests.simulator.toys import AT_REST, GO, HELP, N_FRAMES, SCENE, WEAK, runner

REQUESTS: Any = ([GO, HELP, WEAK, GO, HELP], [1, 2, 3, 4, 2], [np.inf, np.inf, 0.9, 0.9, 0.5])


def assert_same(first: list[SimulationResult], second: list[SimulationResult]) -> None:
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        assert (a.hypothesis, a.seed, a.failure) == (b.hypothesis, b.seed, b.failure)
        assert (a.frames_simulated, a.completed) == (b.frames_simulated, b.completed)
        np.testing.assert_array_equal(a.trajectory, b.trajectory)
        np.testing.assert_array_equal(a.errors, b.errors)


# --- on any workers --------------------------------------------------------------------------


def test_results_counts_and_errors_of_the_callback_are_the_same_for_any_number_of_workers() -> None:
    def complains(result: SimulationResult) -> None:
        raise LookupError("no such bar")

    one, two = (runner(toys.fails_for_weak, workers=n) for n in (1, 2))
    with one, two:
        assert_same(one.run(*REQUESTS), two.run(*REQUESTS))
        for counted in (one, two):
            before, seen = dataclasses.replace(counted.statistics), list[SimulationResult]()
            counted.on_result = seen.append
            results = counted.run([GO, GO, WEAK, GO], [1, 2, 3, 1], [np.inf, -1.0, np.inf, np.inf])
            now = counted.statistics
            assert [r.failure is not None for r in results] == [False, False, True, False]
            assert {r.completed for r in results} == {True, False}
            assert len(seen) == now.simulations - before.simulations == 3
            assert {id(r) for r in seen} == {id(r) for r in results}
            assert now.frames - before.frames == N_FRAMES
            assert now.frames_saved - before.frames_saved == N_FRAMES
            assert (now.failures - before.failures, now.retries) == (1, 0)
            took = now.seconds_simulating - before.seconds_simulating
            assert took == pytest.approx(sum(r.seconds for r in seen))
            assert now.seconds_waiting > before.seconds_waiting
            counted.on_result = complains
            with pytest.raises(LookupError, match="no such bar"):
                counted.run([GO, WEAK], [1, 2])
            counted.on_result = None
        assert_same(one.run(*REQUESTS), two.run(*REQUESTS))


def test_results_come_in_the_order_of_requests_and_are_told_of_as_they_finish(
    tmp_path: Path,
) -> None:
    marker = tmp_path / "one is done"

    def the_first_waits(scene: Any, hypothesis: Any, rng: Any) -> Any:
        while hypothesis == GO and not marker.exists():
            time.sleep(0.01)
        yield from toys.drift(scene, hypothesis, rng)

    def note(result: SimulationResult) -> None:
        finished.append((result.hypothesis, threading.current_thread()))
        marker.touch()

    finished: list[Any] = []
    with runner(the_first_waits, workers=2) as two:
        two.on_result = note
        results = two.run([GO, WEAK], [1, 2])
    assert [r.hypothesis for r in results] == [GO, WEAK]
    assert finished == [(WEAK, threading.current_thread()), (GO, threading.current_thread())]


def test_workers_start_light_are_as_many_as_there_is_to_do_and_get_the_work_once(
    tmp_path: Path,
) -> None:
    with runner(toys.Slips(tmp_path), workers=1000) as many:
        assert many.run([], []) == []
        assert isinstance(many._pool, OwnWorkers)
        (result,) = many.run([WEAK], [1])
        assert many._pool.slots == 1
        for _ in range(3):
            assert all(r.failure is None for r in many.run([GO, HELP], [2, 3]))
        assert many._pool.slots == 2
    # one process for the first run, two that took its place; nothing was run for nothing
    processes = [file.name.split("-")[0] for file in tmp_path.glob("[0-9]*")]
    assert len(processes) == len(set(processes)) <= 3
    assert len(list(tmp_path.glob("warm-*"))) == 1
    assert "heavy [], threads ['1'], interrupts blocked True" in str(result.failure)


# --- on an executor of somebody else ---------------------------------------------------------


def test_any_executor_gives_the_same_results_gets_the_work_once_and_is_left_alone(
    tmp_path: Path,
) -> None:
    requests = [GO, HELP, GO, HELP, GO], range(5)
    with runner(toys.drift, workers=1) as one, futures.ThreadPoolExecutor(2) as threads:
        for workers in (None, 1):
            folder = tmp_path / str(workers)
            folder.mkdir()
            with runner(toys.Slips(folder), executor=threads, workers=workers) as other:
                for _ in range(2):
                    assert_same(other.run(*requests), one.run(*requests))
            assert len(list(folder.glob("[0-9]*"))) == 1
        assert threads.submit(len, "alive").result() == 5


class Breaks(futures.ThreadPoolExecutor):
    """Loses a red agent's tasks so often, as dask does when a machine goes away."""

    def __init__(self, losses: int) -> None:
        super().__init__(1)
        self.losses = losses

    def submit(self, *task: Any, **more: Any) -> Any:
        if self.losses and GO in task[-1]:
            self.losses -= 1
            future: futures.Future[Any] = futures.Future()
            future.set_exception(OSError("machine gone"))
            return future
        return super().submit(*task, **more)


@pytest.mark.parametrize(("losses", "failures"), [(1, 0), (2, 1)])
def test_what_an_executor_loses_is_run_again_once(losses: int, failures: int) -> None:
    with Breaks(losses) as executor, runner(toys.drift, executor=executor, workers=1) as other:
        results = other.run([GO, WEAK], [1, 2])
    assert [r.failure for r in results if r.failure] == ["OSError: machine gone"] * failures
    assert other.statistics.retries == 1


# --- what cannot work ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *[({"workers": n}, f"workers={n!r}, expected a w") for n in (0, 1.5)],
        *[({"simulation_seconds": s}, "simulation_seconds=") for s in (0, "5")],
        ({"on_failure": "ignore"}, "'reject', 'raise'"),
    ],
)
def test_settings_that_cannot_be_are_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises((InvalidSettingError, UnknownNameError), match=message):
        runner(toys.drift, **options)


def test_what_cannot_be_simulated_is_refused_before_the_run() -> None:
    with pytest.raises(InvalidSettingError, match="simulator='drift' cannot be called"):
        runner("drift")
    assert runner(toys.drift).workers >= 1
    lock = threading.Lock()
    with pytest.raises(InvalidSettingError, match=r"cannot be sent to worker processes .*lock"):
        runner(lambda scene, hypothesis, rng: lock, workers=2)
    with pytest.raises(InvalidSettingError, match="an error ceiling is nan"):
        runner(toys.drift, workers=1).run([GO], [1], [float("nan")])


# --- stopping --------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [1, 2])
def test_after_cancel_or_close_nothing_runs(workers: int) -> None:
    for end in (Runner.cancel, Runner.close):
        stopped = runner(toys.drift, workers=workers)
        end(stopped)
        with pytest.raises(Cancelled):
            stopped.run([GO], [1])
        stopped.close()
        stopped.close()


@pytest.mark.parametrize(
    ("how", "end"),
    [
        ("here, within a frame", Runner.close),
        ("workers", Runner.cancel),
        ("executor", Runner.close),
    ],
)
def test_a_run_is_cancelled_from_another_thread(how: str, end: Any, tmp_path: Path) -> None:
    marker, awake = tmp_path / "begun", tmp_path / "awake"

    def patient(scene: Any, hypothesis: Any, rng: Any) -> Any:
        while True:
            marker.touch()
            time.sleep(0.001)
            yield scene.start

    with futures.ThreadPoolExecutor(1) as threads, futures.ThreadPoolExecutor(1) as caller:
        if how == "here":
            many = Observation(np.repeat(AT_REST.trajectory[:1], 60_000, axis=0))
            stopped = Runner(patient, SCENE, many, workers=1)
        elif how != "executor":
            stopped = runner(toys.Sleeps(marker), workers=2 if how == "workers" else 1)
        else:
            stopped = runner(toys.Sleeps(marker, until=awake), executor=threads)
        running = caller.submit(stopped.run, [GO, WEAK], [1, 2])
        while not marker.exists():
            assert not running.done()
            time.sleep(0.01)
        end(stopped)
        with pytest.raises(Cancelled):
            running.result(timeout=60)
        awake.touch()
        stopped.close()
    assert stopped.statistics.simulations == 0


# --- what hangs ------------------------------------------------------------------------------


def sleeps_for_weak(scene: Any, hypothesis: Any, rng: Any) -> Any:
    yield scene.start
    if hypothesis == WEAK:
        time.sleep(1000)
    yield from toys.drift(scene, hypothesis, rng)


def yields_on_for_weak(scene: Any, hypothesis: Any, rng: Any) -> Any:
    while hypothesis == WEAK:
        time.sleep(max(toys.LIMITS) / (N_FRAMES - 1))
        yield scene.start
    yield from toys.drift(scene, hypothesis, rng)


def keeps_python_busy(scene: Any, hypothesis: Any, rng: Any) -> Any:
    time.sleep(0.1)  # so that both workers get something
    if hypothesis == WEAK:  # years within one call, in which no other thread gets its turn
        re.match("(a+)+$", "a" * 64 + "b")
    yield from toys.drift(scene, hypothesis, rng)


@pytest.mark.parametrize(
    ("how", "simulator"),
    [
        ("here", sleeps_for_weak),
        ("workers", sleeps_for_weak),
        ("executor", yields_on_for_weak),
    ],
)
def test_a_simulation_that_hangs_is_a_counted_failure_and_ends_at_its_next_frame(
    how: str, simulator: Any
) -> None:
    before = set(threading.enumerate())
    with futures.ThreadPoolExecutor(1) as threads:
        where: Any = {"here": {"workers": 1}, "workers": {"workers": 2}}.get(how)
        where = where or {"executor": threads}
        for seconds in toys.LIMITS:
            with runner(simulator, simulation_seconds=seconds, **where) as limited:
                results = limited.run([GO, WEAK, HELP], [1, 2, 3])
            if results[0].completed and results[2].completed:
                break
    assert [r.completed for r in results] == [True, False, True]
    why = f"it took longer than the {seconds:g} s that a simulation may take"
    assert results[1].failure == why
    assert limited.statistics.failures == 1
    with runner(simulator, workers=1) as free:
        assert_same(free.run([GO, HELP], [1, 3]), [results[0], results[2]])
    if simulator is not sleeps_for_weak:
        toys.wait_until(lambda: not set(threading.enumerate()) - before)


def test_a_worker_that_cannot_end_its_simulation_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_POLL_SECONDS", 0.1)
    for seconds in toys.LIMITS:
        with runner(keeps_python_busy, simulation_seconds=seconds, workers=2) as limited:
            limited.run([GO, HELP], [1, 2])  # the workers have started up
            with monkeypatch.context() as patch:
                patch.setattr(processes, "_STARTUP_SECONDS", 3 * seconds)
                results = limited.run([GO, WEAK, HELP], [1, 2, 3])
        if results[0].completed and results[2].completed:
            break
    assert [r.completed for r in results] == [True, False, True]
    assert f"took longer than the {seconds:g} s" in str(results[1].failure)
    assert limited.statistics.retries == 0


# --- what fails ------------------------------------------------------------------------------


def test_raise_names_hypothesis_and_seed() -> None:
    with runner(toys.fails_for_weak, workers=1, on_failure="raise") as strict:
        assert strict.run([GO], [1])[0].completed
        with pytest.raises(SimulationError, match=r"150.* with seed 2 failed: ValueError: too w"):
            strict.run([GO, WEAK, GO], [1, 2, 3])
