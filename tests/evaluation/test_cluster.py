"""Evaluations on a dask cluster: the same answers, also where a worker is killed."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, SimulationError
from tests.evaluation.toys import FailsAt, evaluate, guesses, raises, several
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
        if name not in ("cost", "settings"):
            assert one.metrics[name] == value, name


@pytest.mark.slow
def test_a_killed_worker_changes_no_answer(tmp_path: Path) -> None:
    model = Slow(tmp_path)
    with local_cluster() as (_, client), the_third_killed(model.begun):
        found = ppl.evaluate(EVENTS, model, executor=client.get_executor(), progress=False)
    notes = sorted(model.warmed.iterdir(), key=lambda file: int(file.name.split("-")[1]))
    assert len(list(model.begun.iterdir())) > len(EVENTS)  # that of the killed one was asked again
    assert found.cost["workers"] is None
    assert "workers" not in str(found)
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
    given = ["evaluate", str(tmp_path / "events.json"), "--model", "guessing", "--no-figures"]
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


@pytest.mark.parametrize("model", [guesses, FailsAt(5, raises)], ids=["guesses", "fails"])
def test_shards_make_the_evaluation_of_one_process(model: Any, tmp_path: Path) -> None:
    folders = [tmp_path / f"{i}" for i in (1, 2, 3)]
    for i, folder in enumerate(folders, 1):
        evaluate(EVENTS, model, out=folder, shard=f"{i}/3")
    merged = ppl.merge(folders[::-1], tmp_path / "merged")
    whole = evaluate(EVENTS, model, out=tmp_path / "whole")
    assert isinstance(merged, ppl.Evaluation)
    assert bool(merged.failures) == (model is not guesses)
    for found in (merged, ppl.Evaluation.load(tmp_path / "merged")):
        assert [event.id for event in found.events] == [event.id for event in EVENTS]
        assert found.settings == whole.settings
        same(found, whole)
    of_merged, of_whole = (
        {path.name for path in (tmp_path / name / "events").iterdir()}
        for name in ("merged", "whole")
    )
    assert of_merged == of_whole


def test_the_commands_make_shards_of_several_models(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ppl.save_events(EVENTS, tmp_path / "events.json")
    given = ["evaluate", str(tmp_path / "events.json"), "--no-figures", "--quiet"]
    given += ["--model", "one=last_frame", "--model", "two=last_frame", "--workers", "1"]
    for number in (1, 2):
        command = [*given, "--shard", f"{number}/2", "--out", str(tmp_path / f"{number}")]
        assert main(command) == 0
        assert main([*command, "--resume"]) == 0
    capsys.readouterr()
    folders = [str(tmp_path / number / "two") for number in "12"]
    assert main(["merge", *folders, "--out", str(tmp_path / "two")]) == 0
    assert "8 of 8 events" in capsys.readouterr().out


def test_shards_that_do_not_fit_together_are_refused(tmp_path: Path) -> None:
    def shard(name: str, share: str, events: Any = EVENTS, **more: Any) -> Path:
        evaluate(events, guesses, shard=share, out=tmp_path / name, **more)
        return tmp_path / name

    def refused(folders: Any, match: str, kind: type[Exception] = InvalidSettingError) -> None:
        with pytest.raises(kind, match=match):
            ppl.merge(folders, tmp_path / "out")

    one, two = shard("one", "1/2"), shard("two", "2/2")
    refused([one], "the shard 2/2 is missing")
    refused([one, two, one], "the shard 1/2 is there twice")
    refused([one, shard("other", "2/2", seed=1)], "different requests: seed is 1, was 0")
    refused([one, shard("fewer", "2/2", EVENTS[:6])], "different requests: whole is")
    shutil.rmtree(next((two / "events").iterdir()))
    refused([one, two], "two is not finished: 3 of 4 events", InvalidEventError)
    with pytest.raises(InvalidSettingError, match="shard is '1/2', was '2/2'"):
        shard("two", "1/2", resume=True)
