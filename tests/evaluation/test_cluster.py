"""Evaluations on a dask cluster: the same answers, also where it is closed in between."""

from __future__ import annotations

from pathlib import Path

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.world.errors import SimulationError
from tests.evaluation.toys import evaluate, guesses, several
from tests.simulator.clusters import local_cluster

EVENTS = several(8)


def same(one: ppl.Evaluation, other: ppl.Evaluation) -> None:
    """Assert that two evaluations differ in costs and settings at most."""
    assert list(one.predictions) == list(other.predictions)
    for name, prediction in one.predictions.items():
        of_other = other.predictions[name].to_dict()
        assert {**prediction.to_dict(), "cost": None} == {**of_other, "cost": None}
    for name, value in other.metrics.items():
        if name not in ("cost", "settings", "seconds", "cpu_seconds"):
            assert one.metrics[name] == value, name


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
