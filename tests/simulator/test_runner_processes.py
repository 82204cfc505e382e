"""Worker processes: they come and go with their runner, and a dead one is made good."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import phase_ppl
from phase_ppl.simulator.contract import Cancelled
from tests.simulator import toys
from tests.simulator.test_runner import assert_same
from tests.simulator.toys import GO, HELP, WEAK, runner, wait_until

ROOT = Path(phase_ppl.__file__).parents[1]
PATIENCE = 60.0
SLEEPER = """
    import pathlib, sys, time
    from phase_ppl.simulator.runner import Runner
    from tests.simulator.toys import AT_REST, GO, SCENE, WEAK

    folder = pathlib.Path(sys.argv[1])

    def sleeps(scene, hypothesis, rng):
        import os
        (folder / f"{os.getpid()}.pid").touch()
        while True:
            time.sleep(1000)
            yield scene.start

    with Runner(sleeps, SCENE, AT_REST, workers=2) as runner:
        runner.run([GO, WEAK], [1, 2])
"""


@contextlib.contextmanager
def started(text: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    path = folder / "script.py"
    path.write_text(textwrap.dedent(text))
    process = subprocess.Popen(
        [sys.executable, str(path), str(folder)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def workers_in(folder: Path) -> list[int]:
    return [int(file.stem) for file in folder.glob("*.pid")]


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with contextlib.suppress(OSError):  # a dead one that nobody has buried, where it can be told
        return ") Z " not in Path(f"/proc/{pid}/stat").read_text()
    return True


def test_what_a_dead_worker_lost_is_run_again(tmp_path: Path) -> None:
    with (
        runner(toys.drift, workers=1) as sound,
        runner(toys.KillsItsWorker(tmp_path, times=1), workers=2) as two,
    ):
        requests = [WEAK, GO, HELP, GO, GO], [1, 2, 3, 4, 5]
        found = two.run(*requests)
        assert_same(found, sound.run(*requests))
        assert all(result.completed for result in found)
        assert len(list(tmp_path.iterdir())) == 1
        assert two.statistics.retries >= 1
        assert two.statistics.failures == 0


def test_only_the_simulation_that_kills_its_worker_fails(tmp_path: Path) -> None:
    # the sound one is slow: it would be lost with each of the others that runs beside it
    killer = toys.KillsItsWorker(tmp_path, times=100, seconds_of_others=0.3)
    with runner(killer, workers=2) as two:
        results = two.run([GO, WEAK, WEAK], [1, 2, 3])
    assert [(r.hypothesis, r.seed) for r in results if r.failure] == [(WEAK, s) for s in (2, 3)]
    assert results[0].completed
    assert "worker process died" in str(results[1].failure)
    assert (two.statistics.failures, two.statistics.simulations) == (2, 3)


def test_a_worker_that_died_between_two_runs_is_replaced() -> None:
    with runner(toys.drift, workers=2) as two:
        two.run([GO, HELP], [1, 2])
        victim = multiprocessing.active_children()[0]
        os.kill(victim.pid or 0, signal.SIGKILL)
        wait_until(lambda: not multiprocessing.active_children())  # the other goes with it
        wait_until(lambda: two._pool._executor._flags.broken)  # type: ignore[union-attr]
        assert all(r.completed for r in two.run([GO, WEAK, HELP], [1, 2, 3]))
        assert two.statistics.retries == 0


def test_cancelling_leaves_no_worker_not_even_busy_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "/nonexistent")  # slim containers do not have pgrep and the like
    marker = tmp_path / "asleep"
    with runner(toys.Sleeps(marker), workers=2) as two:

        def cancel() -> None:
            wait_until(marker.exists)
            workers.extend(multiprocessing.active_children())
            two.cancel()

        workers: list[Any] = []
        other = threading.Thread(target=cancel)
        other.start()
        with pytest.raises(Cancelled):
            two.run([GO, WEAK], [1, 2])
        other.join()
        assert [is_alive(worker.pid) for worker in workers] == [False, False]


def test_closing_leaves_no_worker_and_nothing_that_a_simulator_has_started(tmp_path: Path) -> None:
    def starts_an_engine(scene: Any, hypothesis: Any, rng: Any) -> Any:
        engine = subprocess.Popen(["sleep", "1000"])
        (tmp_path / f"{engine.pid}.pid").touch()
        yield from toys.drift(scene, hypothesis, rng)

    with runner(starts_an_engine, workers=2) as two:
        two.run([GO, GO], [1, 2])
        workers, engines = multiprocessing.active_children(), workers_in(tmp_path)
        assert all(map(is_alive, engines))
    assert [is_alive(worker.pid or 0) for worker in workers] == [False, False]
    assert multiprocessing.active_children() == []
    wait_until(lambda: not any(map(is_alive, engines)))


@pytest.mark.parametrize("after", ["all workers began", "the first worker started"])
def test_ctrl_c_ends_a_script_and_its_workers_in_silence(tmp_path: Path, after: str) -> None:
    with started(SLEEPER, tmp_path) as process:
        began = after == "all workers began"
        wait_until(lambda: len(workers_in(tmp_path)) == 2 if began else _children(process.pid))
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == -signal.SIGINT
        assert errors.count("Traceback") == 1
        assert errors.rstrip().endswith("KeyboardInterrupt")
        assert not any(is_alive(pid) for pid in workers_in(tmp_path))


def _children(pid: int) -> list[str]:
    tasks = Path(f"/proc/{pid}/task")
    if not tasks.exists():
        pytest.skip("this system does not list the children of a process")
    commands = []
    with contextlib.suppress(OSError):  # who ends meanwhile is looked for again
        pids = [p for task in tasks.iterdir() for p in (task / "children").read_text().split()]
        commands = [Path(f"/proc/{p}/cmdline").read_text() for p in pids]
    return [command for command in commands if "popen_loky" in command]


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    with started(SLEEPER, tmp_path) as process:
        wait_until(lambda: len(workers_in(tmp_path)) == 2)
        process.kill()
        wait_until(lambda: not any(is_alive(pid) for pid in workers_in(tmp_path)))


def test_a_script_needs_no_guard_and_is_not_kept_alive_by_open_runners(tmp_path: Path) -> None:
    text = """
        import dataclasses
        import numpy as np
        from phase_ppl.simulator.runner import Runner
        from tests.simulator.toys import AT_REST, GO, SCENE

        @dataclasses.dataclass
        class Mine:
            pace: float

            def __call__(self, scene, hypothesis, rng):
                while True:
                    yield scene.start + self.pace * helper(rng)

        def helper(rng):
            return rng.normal(size=(4, 3))

        runners = []
        for simulator in (Mine(0.1), lambda *given: Mine(0.1)(*given)):
            for workers in (1, 2):
                runners.append(Runner(simulator, SCENE, AT_REST, workers=workers))
                first, second = runners[-1].run([GO, GO], [1, 2])
                print(first.errors.sum(), second.errors.sum(), first.failure, second.failure)
    """
    with started(text, tmp_path) as process:
        output, errors = process.communicate(timeout=PATIENCE)
    assert (errors, process.returncode) == ("", 0)
    lines = output.splitlines()
    assert lines == [lines[0]] * 4
    assert lines[0].endswith("None None")
