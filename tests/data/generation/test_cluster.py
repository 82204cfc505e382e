"""Data sets made on a dask cluster: the same bytes, whatever becomes of a worker."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.world.errors import SimulationError
from phase_ppl.world.hypothesis import Hypothesis
from tests.simulator.clusters import local_cluster, note, the_third_killed

SOLO = ppl.worlds.SOLO
SET: dict[str, Any] = {
    "world": SOLO,
    "frames": 24,
    "seed": 2,
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
    """Return the files of a set with what is in them."""
    files = (file for file in folder.rglob("*") if file.is_file())
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
