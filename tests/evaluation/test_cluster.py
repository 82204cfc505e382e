"""Evaluations on a dask cluster: the same answers, also where a worker is killed."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.world.errors import SimulationError
from tests.evaluation.toys import evaluate, guesses, several
from tests.simulator.clusters import local_cluster, note, the_third_killed

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills a process")

EVENTS = several(8)


class Slow:
    """Guesses, some time after having said in which process; warming up leaves a note too."""

    def __init__(self, folder: Path) -> None:
        self.begun, self.warmed = folder / "begun", folder / "warmed"
        for one in (self.begun, self.warmed):
            one.mkdir(exist_ok=True)
        self.seconds = 0.2

    def warm_up(self) -> None:
        note(self.warmed)
        time.sleep(self.seconds)
        note(self.warmed)

    def __call__(self, scene: Any, observation: Any, seed: int) -> Any:
        note(self.begun)
        time.sleep(self.seconds)
        return guesses(scene, observation, seed)


def same(one: ppl.Evaluation, other: ppl.Evaluation) -> None:
    """Assert that two evaluations differ in costs and settings at most."""
    assert list(one.predictions) == list(other.predictions)
    for name, prediction in one.predictions.items():
        of_other = other.predictions[name].to_dict()
        assert {**prediction.to_dict(), "cost": None} == {**of_other, "cost": None}
    for name, value in other.metrics.items():
        if name not in ("cost", "settings", "seconds", "cpu_seconds"):
            assert one.metrics[name] == value, name


@pytest.mark.slow
def test_a_killed_worker_changes_no_answer(tmp_path: Path) -> None:
    model = Slow(tmp_path)
    with local_cluster() as (_, client), the_third_killed(model.begun):
        found = ppl.evaluate(EVENTS, model, executor=client.get_executor(), progress=False)
    notes = sorted(model.warmed.iterdir(), key=lambda file: int(file.name.split("-")[1]))
    assert len(list(model.begun.iterdir())) > len(EVENTS)  # that of the killed one was asked again
    same(found, evaluate(EVENTS, guesses))
    # one process of a machine warms up after the other, so that only the first compiles
    pids = [file.name.split("-")[0] for file in notes]
    assert len(pids) >= 4
    assert pids[::2] == pids[1::2]


@pytest.mark.usefixtures("own_models")
def test_the_command_works_on_a_cluster_and_one_that_is_closed_leaves_what_can_be_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ppl.register_model("guessing")(lambda: guesses)
    ppl.save_events(EVENTS, tmp_path / "events.json")
    given = ["evaluate", str(tmp_path / "events.json"), "--model", "guessing"]
    out, kept = tmp_path / "out", str(tmp_path / "command")
    with local_cluster(1) as (cluster, client):
        address = ["--dask", cluster.scheduler_address]
        assert main([*given, "--out", kept, "--quiet", *address]) == 0
        executor = client.get_executor()
        evaluate(EVENTS[:3], guesses, executor=executor, out=out)
        cluster.close()
        with pytest.raises(SimulationError, match="the executor takes no more work") as caught:
            evaluate(EVENTS, guesses, executor=executor, out=out, resume=True)
    assert ppl.Evaluation.load(kept).finished
    assert set(caught.value.evaluation.predictions) == {"a", "b", "c"}
    resumed = evaluate(EVENTS, guesses, out=out, resume=True)
    same(resumed, evaluate(EVENTS, guesses))
    capsys.readouterr()
    assert main([*given, "--dask", "nonsense://1"]) == 2
    assert "--dask nonsense://1: no scheduler answers" in capsys.readouterr().err
