"""Evaluations on a dask cluster: the same answers, also where it is closed in between."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.world.errors import SimulationError
from tests.evaluation.toys import evaluate, guesses, several
from tests.simulator.clusters import local_cluster, note

EVENTS = several(8)


class Warms:
    """Guesses; leaves notes of the begin and the end of its warming up."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def warm_up(self) -> None:
        for _ in range(2):
            note(self.folder)
            time.sleep(0.2)

    def __call__(self, *given: Any) -> Any:
        time.sleep(0.2)
        return guesses(*given)


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
def test_processes_of_a_machine_warm_up_in_turn(tmp_path: Path) -> None:
    with local_cluster() as (_, client):
        ppl.evaluate(EVENTS, Warms(tmp_path), executor=client.get_executor(), progress=False)
    notes = sorted(tmp_path.iterdir(), key=lambda file: int(file.name.split("-")[1]))
    pids = [file.name.split("-")[0] for file in notes]
    assert len(pids) == 4
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
