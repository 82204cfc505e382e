"""The runner: same results whatever the workers, early stops, failures counted, nothing lost."""

from __future__ import annotations

import multiprocessing
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.simulator.contract import (
    Cancelled,
    SimulationResult,
    simulate_one,
    simulate_trajectory,
)
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.errors import InvalidSettingError, SimulationError
from tests.agents.scenes import scene
from tests.simulator import simulators

SCENE = scene()
N_FRAMES = 12
OBSERVED = ppl.Observation(np.repeat(SCENE.start[None], N_FRAMES, axis=0))


def hypothesis(strength: float = 450.0) -> ppl.Hypothesis:
    return ppl.Hypothesis("Get red agent to red lm", "get to red agent", strength_red=strength)


def runner(simulator: Any, workers: int = 1, **options: Any) -> Runner:
    return Runner(simulator, SCENE, OBSERVED, workers=workers, **options)


def one(simulator: Any, ceiling: float = np.inf) -> SimulationResult:
    return simulate_one(simulator, SCENE, hypothesis(), 0, OBSERVED.positions, ceiling)


def test_errors_are_distances_over_all_entities() -> None:
    result = one(lambda s, h, rng: iter([s.start + np.array([1.0, 0.0, 9.0])] * N_FRAMES))
    np.testing.assert_allclose(result.errors, 2.0)
    assert result.completed
    assert result.total_error == pytest.approx(2.0 * N_FRAMES)


def test_results_are_the_same_for_one_and_for_two_workers() -> None:
    hypotheses = [hypothesis(200 + 50 * (i % 4)) for i in range(8)]
    seeds = list(range(8))
    ceilings = [np.inf, 5.0] * 4
    found = []
    for workers in (1, 2):
        with runner(simulators.drifting, workers) as run:
            found.append(run.run(hypotheses, seeds, ceilings))
    for a, b in zip(*found, strict=True):
        np.testing.assert_array_equal(a.errors, b.errors)
        np.testing.assert_array_equal(a.trajectory, b.trajectory)
        assert (a.completed, a.frames_simulated) == (b.completed, b.frames_simulated)


def test_a_simulation_stops_as_soon_as_its_error_passes_the_ceiling() -> None:
    far = simulators.drifting
    whole = one(far)
    total = np.cumsum(whole.errors)
    stopped = one(far, ceiling=float(total[5]) + 1e-9)
    assert not stopped.completed
    assert stopped.frames_simulated == 7
    np.testing.assert_array_equal(stopped.errors[:7], whole.errors[:7])
    assert np.isinf(stopped.errors[7:]).all()
    assert np.isnan(stopped.trajectory[7:]).all()


def test_a_ceiling_never_changes_what_survives_it() -> None:
    whole = one(simulators.drifting)
    spared = one(simulators.drifting, ceiling=whole.total_error + 1.0)
    np.testing.assert_array_equal(whole.errors, spared.errors)
    assert spared.completed


def test_an_early_stop_closes_the_simulator(tmp_path: Path) -> None:
    note = tmp_path / "note"
    result = one(simulators.Closable(note), ceiling=4.0)
    assert result.frames_simulated < N_FRAMES
    assert note.read_text() == "closed"


@pytest.mark.parametrize(
    ("simulator", "message"),
    [
        (simulators.broken, "ZeroDivisionError: no such luck"),
        (simulators.not_a_number, "frame 1 holds a value that is not finite"),
        (simulators.short, "ended after 1 of 12 frames"),
        (simulators.flat, r"frame 0 has shape \(12,\)"),
    ],
)
def test_failures_are_told_and_counted(simulator: Callable[..., Any], message: str) -> None:
    with runner(simulator) as run:
        (result,) = run.run([hypothesis()], [3])
        assert run.statistics.failures == 1
    assert result.failure is not None
    assert re.search(message, result.failure)
    assert not result.completed
    assert result.seed == 3
    with pytest.raises(SimulationError, match=r"seed 3.*" + message.split(":")[-1]):
        simulate_trajectory(simulator, SCENE, hypothesis(), 3, N_FRAMES)


def test_identical_requests_are_run_once() -> None:
    with runner(simulators.drifting) as run:
        results = run.run([hypothesis()] * 3, [1, 1, 2])
        assert run.statistics.simulations == 2
    assert results[0] is results[1]


def test_every_result_is_reported_as_it_comes() -> None:
    seen: list[SimulationResult] = []
    with runner(simulators.still, 2, on_result=seen.append) as run:
        run.run([hypothesis()] * 4, [0, 1, 2, 3])
    assert sorted(r.seed for r in seen) == [0, 1, 2, 3]


def test_the_simulator_sees_effective_goals() -> None:
    seen = []

    def spy(scene: Any, h: ppl.Hypothesis, rng: Any) -> Any:
        seen.append(h)
        return simulators.still(scene, h, rng)

    helping = ppl.Hypothesis("get to green agent", "Get blue item to red lm", (1, 0))
    with runner(spy) as run:
        run.run([helping], [0])
    assert ppl.GOALS[seen[0].goal_red] == "Get blue item to red lm"
    assert seen[0].alpha == (0, 0)


def test_a_dead_worker_is_noticed_and_its_simulation_repeated(tmp_path: Path) -> None:
    hypotheses = [hypothesis(600.0), hypothesis(300.0), hypothesis(450.0)]
    with runner(simulators.Deadly(tmp_path, times=1), 2) as run:
        results = run.run(hypotheses, [0, 1, 2])
        assert run.statistics.retries >= 1
    assert all(result.completed for result in results)


def test_a_worker_that_keeps_dying_fails_its_simulation_and_no_other(tmp_path: Path) -> None:
    hypotheses = [hypothesis(300.0), hypothesis(600.0), hypothesis(450.0)]
    with runner(simulators.Deadly(tmp_path, times=9), 2) as run:
        results = run.run(hypotheses, [0, 1, 2])
    assert [result.completed for result in results] == [True, False, True]
    assert "died" in str(results[1].failure)


@pytest.mark.parametrize("workers", [1, 2])
def test_cancel_stops_a_run_and_leaves_no_worker(workers: int) -> None:
    run = runner(simulators.sleepy, workers)
    threading.Timer(1.0, run.cancel).start()
    with pytest.raises(Cancelled), run:
        run.run([hypothesis()] * 2, [0, 1])
    assert not [p for p in multiprocessing.active_children() if "Loky" in p.name]


def test_a_simulator_defined_in_a_script_runs_on_workers(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import numpy as np, phase_ppl as ppl\n"
        "from phase_ppl.simulator.runner import Runner\n"
        "def mine(scene, hypothesis, rng):\n"
        "    while True:\n"
        "        yield scene.start + rng.normal(0, 0.1, (4, 3))\n"
        "event = ppl.load_event('collaborate')\n"
        "h = ppl.Hypothesis('Get red agent to red lm', 'get to red agent')\n"
        "with Runner(mine, event.scene, event.observation, workers=2) as run:\n"
        "    print([r.completed for r in run.run([h, h], [0, 1])])\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "[True, True]", done.stderr


@pytest.mark.parametrize("workers", [0, -1, 1.5, "2", True])
def test_workers_must_be_a_whole_number_of_at_least_one(workers: Any) -> None:
    with pytest.raises(InvalidSettingError, match="workers"):
        runner(simulators.still, workers)


def test_workers_start_light() -> None:
    heavy = "{'jax', 'numpyro', 'arviz', 'xarray', 'matplotlib', 'torch', 'pandas'}"
    modules = "sys, phase_ppl.simulator.runner, phase_ppl.simulator.joint"
    code = f"import {modules}; print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
