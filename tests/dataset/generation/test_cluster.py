"""Data sets made on a dask cluster, and in shards: the same bytes, whatever becomes of a worker."""

from __future__ import annotations

import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.dataset.generated import COST, verify
from phase_ppl.dataset.generation import generate
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    SimulationError,
)
from phase_ppl.world.hypothesis import Roles
from tests.simulator.clusters import local_cluster, note, the_third_killed

SOLO = ppl.worlds.SOLO
SET: dict[str, Any] = {
    "world": SOLO,
    "frames": 24,
    "seed": 2,
    "keep_rejected": True,
    "max_tries": 9,
}
N = 5


class Homewards:
    """Whoever it is, it wants to be home; said some time after having said in which process."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder

    def __call__(self, world: ppl.World, seed: int) -> Roles:
        if self.folder is not None:
            note(self.folder)
            time.sleep(0.2)
        return Roles.of(world, {"red agent": "red agent to home"})


def make(out: Path, **more: Any) -> Any:
    given = {"roles": Homewards(), "progress": False, **SET, **more}
    if "executor" not in given:
        given.setdefault("workers", 1)
    return ppl.generate(out, N, **given)


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a set with what is in them, but for what it cost."""
    files = (file for file in folder.rglob("*") if file.is_file() and file.name != COST)
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sets") / "whole"
    make(folder)
    return folder


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folders = [tmp_path_factory.mktemp("shards") / str(i) for i in (1, 2, 3)]
    for i, folder in enumerate(folders, 1):
        assert make(folder, shard=f"{i}/3") == folder
    return folders


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills a process")
def test_a_killed_worker_changes_no_byte(tmp_path: Path, whole: Path) -> None:
    notes = tmp_path / "notes"
    notes.mkdir()
    with local_cluster() as (_, client), the_third_killed(notes):
        make(tmp_path / "set", roles=Homewards(notes), executor=client.get_executor())
    made = ppl.GeneratedEvents(tmp_path / "set")
    draws = len(made.manifest["given_up"]) * SET["max_tries"] + sum(
        entry["attempt"] + 1 for entry in made.entries
    )
    assert len(list(notes.iterdir())) > draws  # those of the killed one were made again
    assert contents(tmp_path / "set") == contents(whole)


def test_an_executor_that_is_shut_down_leaves_what_another_can_finish(
    tmp_path: Path, whole: Path
) -> None:
    out = tmp_path / "set"
    with ThreadPoolExecutor(1) as executor:
        pass
    with pytest.raises(SimulationError, match=f"no more work.*{N} of {N} .*resume goes on"):
        make(out, executor=executor)
    with ThreadPoolExecutor(1) as executor:
        make(out, executor=executor, resume=True)
    assert contents(out) == contents(whole)


def test_shards_make_the_set_of_one_process_byte_for_byte_in_blocks_where_it_is_large(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: Path, shards: list[Path]
) -> None:
    one = ppl.merge([shards[1], shards[2], shards[0]], tmp_path / "one")
    assert contents(one.path) == contents(whole)
    assert verify(one.path) == []
    monkeypatch.setattr(generate, "BLOCK", 2)
    blocks = ppl.merge(shards, tmp_path / "set")
    assert len(list((tmp_path / "set" / "blocks").iterdir())) == 3
    assert blocks.ids == one.ids
    assert list(blocks.entries) == list(one.entries)
    assert list(blocks[::-2].entries) == list(one[::-2].entries)
    assert [event.id for event in blocks[::-2]] == one.ids[::-2]
    assert blocks.split("train").ids == one.split("train").ids
    found, known = (ppl.statistics(each) for each in (blocks, one))
    assert "split" in found.index
    assert found.equals(known)
    assert [(e.id, why) for e, why in blocks.rejected()] == [
        (e.id, why) for e, why in one.rejected()
    ]
    assert verify(blocks.path) == []
    other = tmp_path / "set" / "blocks" / "00001" / "entries.json"
    shutil.copy(tmp_path / "set" / "blocks" / "00000" / "entries.json", other)
    with pytest.raises(InvalidEventError, match=r"events.nc and entries.json are not of the same"):
        list(ppl.load_events(blocks.path).entries)  # type: ignore[attr-defined]


def test_merge_refuses_in_one_line(tmp_path: Path, shards: list[Path], whole: Path) -> None:
    one, two, three = shards
    out = tmp_path / "out"

    def refused(folders: Any, match: str, kind: type[Exception] = InvalidSettingError) -> None:
        with pytest.raises(kind, match=match) as caught:
            ppl.merge(folders, out)
        assert "\n" not in str(caught.value)

    refused([], "no shards")
    refused([one, three], "the shard 2/3 is missing")
    refused([one, two, three, two], "the shard 2/3 is there twice")
    refused([one, two, whole], f"{whole} is no shard", InvalidEventError)
    refused([one, two, tmp_path / "none"], "none is no shard", InvalidEventError)
    refused([tmp_path / "none", one], "is no shard: it has no plan.json or", InvalidEventError)
    other = make(tmp_path / "other", shard="3/3", seed=3)
    refused([one, two, other], r"are of different requests: seed is 3, was 2")
    halves = make(tmp_path / "halves", shard="2/2")
    refused([one, halves], "are of different requests: 2/2 and 1/3")
    cut = tmp_path / "cut"
    shutil.copytree(three, cut)
    next((cut / "parts").iterdir()).unlink()
    refused([one, two, cut], "cut is not finished: 0 of 1 events", InvalidEventError)
    shutil.copytree(whole, out, dirs_exist_ok=True)
    refused(shards, "holds a data set already", OutputError)


def test_a_shard_is_resumed_as_that_shard(tmp_path: Path, shards: list[Path]) -> None:
    with pytest.raises(OutputError, match="shard is '1/3', was '3/3'"):
        make(shards[2], shard="1/3", resume=True)
    with pytest.raises(OutputError, match="shard is None, was '3/3'"):
        make(shards[2], resume=True)
    assert make(shards[2], shard="3/3", resume=True) == shards[2]
    with pytest.raises(InvalidSettingError, match="'6/9' would be empty: there is work for 5"):
        make(tmp_path / "none", shard="6/9")
    with pytest.raises(InvalidSettingError, match="'0/3', expected one such as 1/8"):
        make(tmp_path / "none", shard="0/3")


def test_the_commands_make_shards_and_merge_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["generate", "--world", "solo", "--n", "2", "--quiet", "--workers", "1"]
    folders = [str(tmp_path / name) for name in "ab"]
    for number, folder in enumerate(folders, 1):
        assert main([*given, "--shard", f"{number}/2", "--out", folder]) == 0
    assert "Shard 2/2" in capsys.readouterr().out
    assert main(["merge", *folders, "--out", str(tmp_path / "set")]) == 0
    assert "2 generated events" in capsys.readouterr().out
    assert main(["merge", folders[0], "--out", str(tmp_path / "other")]) == 2
    assert "the shard 2/2 is missing" in capsys.readouterr().err
