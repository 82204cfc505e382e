"""HDF5 files on a full disk, and files that were made to do harm to whoever opens them."""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.world.errors import InvalidEventError
from tests.analysis.factory import random_tree

ROOT = Path(ppl.__file__).parents[1]

_FULL = """
import resource, sys
from pathlib import Path
import numpy as np
import phase_ppl as ppl
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.inference.checkpoint import write_archive
from phase_ppl.world.errors import OutputError
from tests.analysis.factory import random_tree
from tests.analysis.readings import reading

folder = Path(sys.argv[1])
event = ppl.load_event("collaborate")
read = ClosedLoopPosterior(reading())
tree = Posterior(random_tree(1))
for room in (5000, 3):
    # what a disk does that has room for a little more
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    for name, write in {
        "tree.nc": tree.save,
        "read.nc": read.save,
        "event.json": lambda path: ppl.save_event(event, path),
        "run.ckpt": lambda path: write_archive(path, {}, {"a": np.zeros(10**5)}),
    }.items():
        (folder / name).write_text("old")
        try:
            write(folder / name)
        except OutputError as error:
            print(error)
"""


def test_a_full_disk_ends_no_process_and_leaves_what_was_there(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _FULL, str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        # what XLA compiles could not be kept whole either
        env={**os.environ, "PYTHONPATH": str(ROOT), "JAX_ENABLE_COMPILATION_CACHE": "false"},
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 8
    assert all("cannot write" in line and "large" in line for line in lines)
    left = {path.name: path.read_text() for path in tmp_path.iterdir()}
    names = ("tree.nc", "read.nc", "event.json", "run.ckpt")
    assert left == dict.fromkeys(names, "old")


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Posterior(random_tree(1)).save(tmp_path_factory.mktemp("one") / "run.nc")


@pytest.fixture
def posterior(tmp_path: Path, saved: Path) -> Path:
    return Path(shutil.copy(saved, tmp_path))


Change = Callable[[h5py.Group], object]


def _put(value: Any) -> Change:
    return lambda group: group.__setitem__("more", value)


def _array(*described: Any, **options: Any) -> Change:
    return lambda group: group.create_dataset("more", *described, **options)


def _external(group: h5py.Group) -> None:
    if "radius" in group:
        del group["radius"]
    group.create_dataset("radius", (4,), "f8", external=[("/etc/passwd", 0, 99)])


def _virtual(group: h5py.Group) -> None:
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource("other.nc", "radius", (4,))
    group.create_virtual_dataset("more", layout)


def _long_text(group: h5py.Group) -> None:
    many = group.create_dataset("more", (200_000,), h5py.string_dtype())
    many[199_999] = "x" * 100_000


TEXT = h5py.string_dtype()
TRICKS: dict[str, list[Change]] = {
    "array 'radius' lies in another file": [_external],
    "array 'more' lies in another file": [_virtual],
    "holds a link, 'more'": [_put(h5py.ExternalLink("/etc/passwd", "/")),
                             _put(h5py.SoftLink("/more"))],
    "holds a group, 'more'": [lambda group: group.__setitem__("more", group),
                              lambda group: group.create_group("more/inner")],
    "is larger than the 512 MB": [
        _array((2**30,), "f8", chunks=(2**20,), compression=9),
        _array((4,), "f8", maxshape=(None,), chunks=(2**28,), compression=9),
        _long_text,
    ],
    "has more entries than the file has bytes": [_array((10**8,), TEXT, chunks=(2**20,))],
    "attribute 'more' has 1000 entries": [
        lambda group: group.attrs.create("more", ["x"] * 1000, dtype=TEXT)
    ],
    "array 'more' is without a shape": [_put(h5py.Empty("f8"))],
    "array 'more' holds neither numbers nor texts": [
        _put(np.zeros(3, [("a", "f8"), ("b", "i4")]))
    ],
}  # fmt: skip


@pytest.mark.parametrize("message", TRICKS)
def test_a_harmful_file_is_refused_unread(tmp_path: Path, saved: Path, message: str) -> None:
    for change in TRICKS[message]:
        posterior = Path(shutil.copy(saved, tmp_path))
        with h5py.File(posterior, "r+") as file:
            change(file["constant_data"])
        with pytest.raises(InvalidEventError, match=f"run.nc: .*{message}") as raised:
            ppl.load_posterior(posterior)
        assert "\n" not in str(raised.value)


def test_what_a_terminal_would_obey_is_taken_out_of_a_posterior(posterior: Path) -> None:
    with h5py.File(posterior, "r+") as file:
        del file.attrs["sha256"]
        file.attrs["event_id"] = "one\x1b[2J\x9btwo"
        file.attrs["settings"] = '{"kernel": {"name": "\\u001b[31m"}, "chains": 1}'
    post = ppl.load_posterior(posterior)
    assert post.event_id == "one\ufffd[2J\ufffdtwo"
    assert post.settings["kernel"]["name"] == "\ufffd[31m"


def test_a_posterior_that_is_not_what_it_was_is_refused(
    posterior: Path, saved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("weights", "posterior/alpha", "observed_data/entity"):
        shutil.copy(saved, posterior)
        with h5py.File(posterior, "r+") as file:
            if place == "posterior/alpha":
                assert file[place].fletcher32, "other readers notice a flipped bit as well"
                file[place][0, 0] += 1
            elif place in file:
                file[place][0] = "rod agent"
            else:
                file.attrs[place] += " "
        with pytest.raises(InvalidEventError, match="its content is not what sha256 says"):
            ppl.load_posterior(posterior)

    def damaged(*_: object, **__: object) -> None:
        raise KeyError("Unable to synchronously open object")

    monkeypatch.setattr(h5py, "File", damaged)
    with pytest.raises(InvalidEventError, match=r"run\.nc: cannot be read as NetCDF"):
        ppl.load_posterior(posterior)


def test_a_damaged_posterior_is_the_same_or_refused_by_name(tmp_path: Path, saved: Path) -> None:
    path, rng = tmp_path / "damaged.nc", random.Random(0)
    intact, complaints = str(ppl.load_posterior(saved)), list[str]()
    for case in range(20):
        content = bytearray(saved.read_bytes())
        if case < 4:
            content = content[: rng.randrange(len(content))]
        for _ in range(rng.choice([1, 3, 30])):
            if content:
                content[rng.randrange(len(content))] = rng.randrange(256)
        path.write_bytes(content)
        try:
            found = str(ppl.load_posterior(path))
        except InvalidEventError as error:
            complaints.append(str(error))
        else:
            assert found == intact
    assert len(complaints) > 5
    assert all(str(path) in line and "\n" not in line for line in complaints)
