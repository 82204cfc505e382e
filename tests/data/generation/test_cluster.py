"""Data sets made on a dask cluster: the same bytes, whatever becomes of a worker."""

from __future__ import annotations

import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.data.generated import COST, verify
from phase_ppl.data.generation import generate
from phase_ppl.world.errors import InvalidEventError, SimulationError
from phase_ppl.world.hypothesis import Hypothesis
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

    def __call__(self, world: ppl.World, seed: int) -> Hypothesis:
        if self.folder is not None:
            note(self.folder)
            time.sleep(0.2)
        return Hypothesis.of(world, {"red agent": "red agent to home"})


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


def test_a_large_set_is_kept_in_blocks_and_has_the_same_events(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: Path
) -> None:
    one = ppl.GeneratedEvents(whole)
    assert verify(one.path) == []
    monkeypatch.setattr(generate, "BLOCK", 2)
    blocks = make(tmp_path / "set")
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
