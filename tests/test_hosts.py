"""The package in other people's programs: their threads, pools, folders, drives and objects."""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.errors import InvalidSettingError, number_of_workers
from phase_ppl.world.event import Observation
from tests.analysis.readings import reading
from tests.inference import runs
from tests.simulator.toys import AT_REST, GO, SCENE, WEAK, drift
from tests.world.examples import check_refused

ROOT = Path(__file__).parent.parent

SHADOWING = ("random.py", "signal.py", "copy.py", "argparse.py")
SCRIPT = """
    import multiprocessing, os
    import jax
    import phase_ppl as ppl
    from phase_ppl.models.density import on_cpu
    from phase_ppl.simulator.processes import mapped
    from phase_ppl.simulator.runner import Runner
    from tests.simulator.toys import AT_REST, GO, SCENE, WEAK

    def simulator(scene, hypothesis, rng):
        assert "PYTHONSAFEPATH" not in os.environ  # of what it starts itself
        while True:
            yield scene.start

    with Runner(simulator, SCENE, AT_REST, workers=2) as runner:
        print([result.failure for result in runner.run([GO, WEAK], [1, 2])])
    print(list(mapped(pow, [(2, 3), (3, 2)], workers=2, unit="power")))

    def infer():
        for start in (on_cpu().__enter__, lambda: ppl.watch(SCENE, model)):
            try:
                start()
                print("was not refused", flush=True)
            except ValueError as error:
                print(error, flush=True)

    model = ppl.Model()
    jax.devices()
    child = multiprocessing.get_context("fork").Process(target=infer)
    child.start()
    child.join()
"""


def test_workers_run_nothing_of_the_current_folder_and_a_forked_process_is_told_to_be_spawned(
    tmp_path: Path,
) -> None:
    program, folder = tmp_path / "script.py", tmp_path / "somebody's ünd\n else"
    program.write_text(textwrap.dedent(SCRIPT))
    folder.mkdir()
    for name in SHADOWING:
        (folder / name).write_text("raise SystemExit('the folder was run')")
    done = subprocess.run(
        [sys.executable, "-W", "ignore", str(program)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stderr) == (0, "")
    first, second, third, fourth = done.stdout.splitlines()
    assert (first, second) == ("[None, None]", "[8, 9]")
    assert "forked" in third
    assert third == fourth
    assert 'multiprocessing.get_context("spawn")' in third


def test_runs_in_threads_are_as_one_after_the_other() -> None:
    def run(prior: str) -> ppl.Posterior:
        model = ppl.Model(simulator=runs.MODEL.simulator, prior=prior)
        return ppl.infer(runs.EVENT, model, **{**runs.OPTIONS, "iterations": 1})

    priors = ["uniform", "sparse_social", "uniform"]
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(run, priors))
    for prior, post in zip(priors[:2], found, strict=False):
        runs.assert_same_draws(post.tree, run(prior).tree)
    runs.assert_same_draws(found[0].tree, found[2].tree)


SETTINGS = {
    "jax_enable_x64": True,
    "jax_default_prng_impl": "rbg",
    "jax_numpy_dtype_promotion": "strict",
    "jax_numpy_rank_promotion": "raise",
    "jax_transfer_guard": "disallow",
}


def test_settings_of_jax_and_numpy_in_the_program_around_change_nothing() -> None:
    options = {"kernel": "local_mh", "iterations": 1}
    before = {name: getattr(jax.config, name) for name in SETTINGS}
    doubles: list[Any] = []

    def simulator(scene: Any, hypothesis: Any, rng: Any) -> Any:
        doubles.append(jax.config.jax_enable_x64)  # its own settings are as they are
        return runs.MODEL.simulator(scene, hypothesis, rng)  # type: ignore[misc]

    model = ppl.Model(simulator=simulator)
    usual = ppl.infer(runs.EVENT, model, **{**runs.OPTIONS, **options})
    try:
        for name, value in SETTINGS.items():
            jax.config.update(name, value)
        with np.errstate(all="raise"):
            found = ppl.infer(runs.EVENT, model, **{**runs.OPTIONS, **options})
    finally:
        for name, value in before.items():
            jax.config.update(name, value)
    runs.assert_same_draws(usual.tree, found.tree)
    assert doubles[0] is False
    assert doubles[-1] is True


def test_a_daemonic_process_does_without_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)  # type: ignore[attr-defined]
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "4")
    assert number_of_workers(None) == 1
    assert number_of_workers(1) == 1
    with pytest.raises(InvalidSettingError, match=r"workers=2, but .* daemonic.*workers=1 needs"):
        Runner(drift, SCENE, AT_REST, workers=2)
    with Runner(drift, SCENE, AT_REST) as runner:
        assert all(result.completed for result in runner.run([GO, WEAK], [1, 2]))


def test_files_are_read_without_locks(tmp_path: Path) -> None:
    path, post = tmp_path / "run.nc", runs.infer(iterations=1)
    post.save(path)
    with path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        runs.assert_same_draws(ppl.load_posterior(path).tree, post.tree)


def test_tracks_of_sixty_frames_a_second_are_read_as_what_they_show() -> None:
    event = ppl.load_event("independent")
    world, poses, frames = PymunkWorld(event.scene, (450.0, 300.0)), [], []
    poses.append(world.state.pose)
    frames.append(poses[0])
    for k in range(12):
        of_step = [world.state.pose for _ in world.substeps([2 + k % 8, 9 - k % 8])]
        poses += of_step
        frames.append(np.mean(of_step, axis=0))
    read = Observation.at_rate(poses, 60).trajectory
    np.testing.assert_allclose(read, frames, atol=1e-9)
    np.testing.assert_array_equal(Observation.at_rate(frames, 12).trajectory, frames)
    assert Observation.at_rate(poses[::10], fps=6).n_frames == len(frames)
    check_refused(lambda: Observation.at_rate(poses, fps=0), "fps=0, expected a positive")
    check_refused(lambda: Observation.at_rate(poses[:3], fps=60), "has 1 frame")


def test_an_attribute_that_no_file_can_hold_is_named_before_it_is_written(tmp_path: Path) -> None:
    post = ClosedLoopPosterior(reading())
    post.dataset.attrs["note"] = {"a": 1}
    with pytest.raises(InvalidSettingError, match=r"attribute 'note' of group '/' is .*json"):
        post.save(tmp_path / "post.nc")
    assert not list(tmp_path.iterdir())
