"""HDF5 files on a full disk, and files that were made to do harm to whoever opens them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl.analysis import Posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.dataset.hdf5 import read_netcdf
from phase_ppl.world.errors import InvalidEventError
from tests.analysis.factory import random_tree

ROOT = Path(ppl.__file__).parents[1]

_FULL = """
import resource, sys
from pathlib import Path
import numpy as np
import phase_ppl as ppl
from phase_ppl.analysis import Posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.inference.runs.checkpoint import write_archive
from phase_ppl.world.errors import OutputError
from tests.analysis.factory import random_tree
from tests.analysis.readings import reading

folder = Path(sys.argv[1])
event = ppl.load_event("collaborate")
read = StepwisePosterior(reading())
tree = Posterior(random_tree(1))
for room in (5000, 3):
    # what a disk does that has room for a little more
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    for name, write in {
        "tree.nc": tree.save,
        "read.nc": read.save,
        "event.nc": lambda path: ppl.save_event(event, path),
        "events.nc": lambda path: ppl.save_events([event], path),
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
    assert len(lines) == 10
    assert all("cannot write" in line and "large" in line for line in lines)
    left = {path.name: path.read_text() for path in tmp_path.iterdir()}
    names = ("tree.nc", "read.nc", "event.nc", "events.nc", "run.ckpt")
    assert left == dict.fromkeys(names, "old")


# --- files that somebody else made -------------------------------------------------------------


@pytest.fixture(scope="module")
def posterior(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return Posterior(random_tree(1)).save(tmp_path_factory.mktemp("one") / "run.nc").read_bytes()


def _external(group: h5py.Group) -> None:
    if "radius" in group:
        del group["radius"]
    group.create_dataset("radius", (4,), "f8", external=[("/etc/passwd", 0, 99)])


def _link(group: h5py.Group) -> None:
    group["more"] = h5py.ExternalLink("/etc/passwd", "/")


def _grows(group: h5py.Group) -> None:
    group.create_dataset("more", (2**30,), "f8", chunks=(2**20,), compression=9)


def _large_chunk(group: h5py.Group) -> None:
    options = {"maxshape": (None,), "chunks": (2**28,), "compression": 9}
    group.create_dataset("more", (4,), "f8", **options)


def _sparse_texts(group: h5py.Group) -> None:
    group.create_dataset("more", (10**8,), h5py.string_dtype(), chunks=(2**20,))


def _texts_of_attribute(group: h5py.Group) -> None:
    group.attrs.create("more", ["x"] * 1000, dtype=h5py.string_dtype())


def _group_in_group(group: h5py.Group) -> None:
    group.create_group("more/inner")


def _itself(group: h5py.Group) -> None:
    group["more"] = group


def _soft_link(group: h5py.Group) -> None:
    group["more"] = h5py.SoftLink("/more")


def _virtual(group: h5py.Group) -> None:
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource("other.nc", "radius", (4,))
    group.create_virtual_dataset("more", layout)


def _long_text(group: h5py.Group) -> None:
    many = group.create_dataset("more", (200_000,), h5py.string_dtype())
    many[0] = "x" * 100_000


def _empty(group: h5py.Group) -> None:
    group["more"] = h5py.Empty("f8")


def _compound(group: h5py.Group) -> None:
    group["more"] = np.zeros(3, [("a", "f8"), ("b", "i4")])


TRICKS: dict[str, tuple[Callable[[h5py.Group], None], str]] = {
    "external": (_external, "array 'radius' lies in another file"),
    "link": (_link, "holds a link, 'more'"),
    "grows": (_grows, "is larger than the 512 MB"),
    "large chunk": (_large_chunk, "is larger than the 512 MB"),
    "sparse texts": (_sparse_texts, "has more entries than the file has bytes"),
    "texts of attribute": (_texts_of_attribute, "attribute 'more' has 1000 entries"),
    "group in group": (_group_in_group, "holds a group, 'more'"),
    "itself": (_itself, "holds a group, 'more'"),
    "soft link": (_soft_link, "holds a link, 'more'"),
    "virtual": (_virtual, "array 'more' lies in another file"),
    "long text": (_long_text, "is larger than the 512 MB"),
    "empty": (_empty, "array 'more' is without a shape"),
    "compound": (_compound, "array 'more' holds neither numbers nor texts"),
}


@pytest.mark.parametrize("trick", TRICKS)
@pytest.mark.parametrize("load", [ppl.load_posterior, StepwisePosterior.load])
def test_a_posterior_made_to_do_harm_is_refused_unread(
    tmp_path: Path, posterior: bytes, load: Callable[[Path], object], trick: str
) -> None:
    change, message = TRICKS[trick]
    path = tmp_path / "run.nc"
    path.write_bytes(posterior)
    with h5py.File(path, "r+") as file:
        change(file["constant_data"])
    with pytest.raises(InvalidEventError, match=f"run.nc: .*{message}") as raised:
        load(path)
    assert "\n" not in str(raised.value)


def test_what_a_terminal_would_obey_is_taken_out_of_a_posterior(
    tmp_path: Path, posterior: bytes
) -> None:
    path = tmp_path / "run.nc"
    path.write_bytes(posterior)
    with h5py.File(path, "r+") as file:
        del file.attrs["sha256"]
        file.attrs["event_id"] = "one\x1b[2J\x9btwo"
        file.attrs["settings"] = '{"kernel": {"name": "\\u001b[31m"}, "chains": 1}'
    post = Posterior.load(path)
    assert post.event_id == "one\ufffd[2J\ufffdtwo"
    assert post.settings["kernel"]["name"] == "\ufffd[31m"


@pytest.mark.parametrize("place", ["weights", "settings", "posterior/alpha", "a label"])
def test_a_posterior_that_is_not_what_it_was_is_refused(
    tmp_path: Path, posterior: bytes, place: str
) -> None:
    path = tmp_path / "run.nc"
    path.write_bytes(posterior)
    with h5py.File(path, "r+") as file:
        if place == "posterior/alpha":
            file[place][0, 0] += 1
        elif place == "a label":
            labels = file["observed_data/entity"]
            labels[0] = "rod agent"
        else:
            file.attrs[place] += " "
    with pytest.raises(InvalidEventError, match="its content is not what sha256 says"):
        Posterior.load(path)


def test_texts_are_read_a_few_at_a_time_and_come_back(tmp_path: Path) -> None:
    path, words = tmp_path / "texts.nc", [["a", "", "ccc"], ["dd", "é", "f"]]
    xr.Dataset({"word": (("x", "y"), np.array(words, object))}).to_netcdf(path, engine="h5netcdf")
    assert read_netcdf(path)["/"]["word"].values.tolist() == words


def test_a_file_whose_root_cannot_be_opened_is_refused_by_name(
    tmp_path: Path, posterior: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    def damaged(*_: object, **__: object) -> None:
        raise KeyError("Unable to synchronously open object")

    (tmp_path / "run.nc").write_bytes(posterior)
    monkeypatch.setattr(h5py, "File", damaged)
    with pytest.raises(InvalidEventError, match=r"run\.nc: cannot be read as NetCDF"):
        ppl.load_posterior(tmp_path / "run.nc")
