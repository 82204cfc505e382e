"""HDF5 files on a full disk, and files that were made to do harm to whoever opens them."""

from __future__ import annotations

import io
import json
import math
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
import xarray as xr

import phase_ppl as ppl
from phase_ppl import event_dataset, event_from_dataset
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.data import events_netcdf, hdf5
from phase_ppl.data.load import load_event, load_events, save_event
from phase_ppl.world.errors import InvalidEventError, UnknownNameError
from phase_ppl.world.names import ENTITIES
from tests.analysis.factory import random_tree
from tests.data.test_bad_files import refused
from tests.data.test_events_json import assert_same, various
from tests.world.examples import check_refused, make_event, make_trajectory

ROOT = Path(ppl.__file__).parents[1]

_FULL = """
import resource, sys
from pathlib import Path
import numpy as np
import phase_ppl as ppl
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.inference.checkpoint import write_archive
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
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Posterior(random_tree(1)).save(tmp_path_factory.mktemp("one") / "run.nc")


@pytest.fixture(scope="module")
def one() -> bytes:
    """Content of a file of one event; writing it anew takes longer than a copy."""
    return events_netcdf.event_bytes(make_event())


@pytest.fixture(scope="module")
def several() -> bytes:
    """Content of a file of several events."""
    return events_netcdf.events_bytes(various())


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
def test_a_file_made_to_do_harm_is_refused_unread(
    tmp_path: Path, saved: Path, one: bytes, message: str
) -> None:
    for change in TRICKS[message]:
        posterior, event = Path(shutil.copy(saved, tmp_path)), tmp_path / "one.nc"
        event.write_bytes(one)
        with h5py.File(posterior, "r+") as file:
            change(file["constant_data"])
        with h5py.File(event, "r+") as file:
            change(file)
        with pytest.raises(InvalidEventError, match=f"run.nc: .*{message}") as raised:
            ppl.load_posterior(posterior)
        assert "\n" not in str(raised.value)
        assert message in refused(event)


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


# --- events as Datasets ---------------------------------------------------------------------------


def test_a_dataset_has_the_trajectory_by_names_and_seconds() -> None:
    event = make_event(n_frames=13)
    dataset = event_dataset(event)
    x = dataset["trajectory"].sel(entity="blue item", coord="x", time=1.0)
    assert x.item() == event.observation.trajectory[12, 2, 0]
    assert dataset["radius"].sel(entity="green agent").item() == 1.2
    names = ("goal_green", "relation", "scenario", "strength_red", "event")
    assert [dataset[name].item() for name in names] == [
        "Get blue item to green lm", "adversarial", "competing", 300.0, "example"
    ]  # fmt: skip
    assert math.isnan(dataset["strength_green"].item())
    assert json.loads(dataset["judgments"].item()) == event.judgments


def test_a_dataset_may_be_turned_and_cut_and_know_less() -> None:
    event = make_event()
    dataset = event_dataset(event)
    turned = dataset.transpose("xy", "coord", "end", "entity", ...)
    shuffled = turned.isel(
        entity=[2, 0, 3, 1], coord=[2, 0, 1], xy=[1, 0], landmark=[3, 1, 0, 2], bound=[3, 0, 2, 1]
    )
    assert_same(event_from_dataset(shuffled.assign(speed=("time", np.zeros(4)))), event)
    part = event_from_dataset(dataset.isel(time=slice(1, 3))).observation.trajectory
    assert np.array_equal(part, make_trajectory()[1:3])
    known = ["goal_red", "goal_green", "relation", "scenario", "strength_red", "strength_green"]
    bare = event_from_dataset(dataset.drop_vars([*known, "judgments", "predictions", "time"]))
    assert (bare.truth, bare.judgments, bare.predictions) == (None, None, None)
    # it does not share the arrays of the event
    dataset["trajectory"][0, 0, 0] = 9.0
    assert event.observation.trajectory[0, 0, 0] == 8.0
    assert event_from_dataset(dataset).observation.trajectory[0, 0, 0] == 9.0


def _dropped(*names: str) -> xr.Dataset:
    return event_dataset(make_event()).drop_vars(names)


def _with(**changes: Any) -> xr.Dataset:
    return event_dataset(make_event()).assign(changes)


WRONG: list[tuple[Any, str]] = [
    ({"trajectory": 3}, "{'trajectory': 3} is no xarray Dataset"),
    (_dropped("trajectory"), "has no variable trajectory"),
    (_dropped("turning"), "has no turning"),
    (_dropped("event"), "has no event"),
    (_dropped("entity"), "has no coordinate entity"),
    (_with(radius=((), 1.0)), "radius has dimensions (), expected (entity)"),
    (event_dataset(make_event()).expand_dims("draw"), "trajectory has dimensions"),
    (_with(turning=((), 7)), "turning is 7, expected a string"),
    (_with(resets_velocity=((), 2)), "resets_velocity is 2, expected 0 or 1"),
    (_with(resets_velocity=((), math.nan)), "resets_velocity is None, expected 0"),
    (_with(time=np.arange(4) / 4), "time goes on by 0.25 s, expected 1/12 s"),
    (_with(time=["a", "b", "c", "d"]), "time holds 'a', expected numbers"),
    (_with(judgments=((), "{")), "judgments: is not JSON: line 1"),
    (_with(predictions=((), "[]")), "predictions: is no JSON object: Expected `object`"),
    (_with(entity=["red agent", "red agent", "x", "y"]), "entity has twice the label 'red agent'"),
    (event_dataset(make_event()).isel(entity=[0, 1, 2, 3, 0]), "has twice the label 'red agent'"),
    (_with(entity=["x", *ENTITIES[1:]]), "unknown field of coordinate entity 'x'"),
    (_with(entity=[*ENTITIES[:3], "pink ball"]),
     "coordinate entity 'pink ball'; did you mean 'pink item'"),
]  # fmt: skip


def test_a_dataset_that_is_no_event_is_refused() -> None:
    for dataset, message in WRONG:
        check_refused(lambda dataset=dataset: event_from_dataset(dataset), message)  # type: ignore[misc]


# --- whatever is offered as NetCDF: events, or one line that says why not -------------------------


def test_content_that_is_not_what_the_checksum_says_is_refused(tmp_path: Path, one: bytes) -> None:
    path = tmp_path / "one.nc"
    edits: dict[str, tuple[tuple[int, ...], Any]] = {
        "trajectory": ((1, 2, 0), make_event().observation.trajectory[1, 2, 0] + 1e-9),
        "turning": ((), "cw"),
        "judgments": ((), '{"relation_counts": {}}'),
        "landmark_half_width": ((), 2.4),
    }
    for name, (where, value) in edits.items():
        path.write_bytes(one)
        with h5py.File(path, "r+") as file:
            assert file["trajectory"].fletcher32, "other readers notice a flipped bit as well"
            file[name][where] = value
        assert "its content is not what sha256 says" in refused(path)
    with xr.open_dataset(path) as stored:
        edited = stored.load()
    save_event(event_from_dataset(edited), path)
    load_event(path)
    edited.drop_vars("sha256").to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    load_event(tmp_path / "other.nc")


def test_damaged_files_are_the_same_events_or_refused_by_name(
    tmp_path: Path, several: bytes
) -> None:
    path, rng = tmp_path / "damaged.nc", random.Random(0)
    complaints: list[str] = []
    for case in range(30):
        content = bytearray(several)
        if case < 6:
            content = content[: rng.randrange(len(content))]
        for _ in range(rng.choice([1, 3, 30])):
            if content:
                content[rng.randrange(len(content))] = rng.randrange(256)
        path.write_bytes(content)
        try:
            loaded = load_events(path)
        except (InvalidEventError, UnknownNameError) as error:
            complaints.append(str(error))
        else:
            for first, second in zip(loaded, various(), strict=True):
                assert_same(first, second)
    assert len(complaints) > 10
    assert all(line.startswith(str(path)) and "\n" not in line for line in complaints)


def test_a_file_that_is_too_large_is_neither_read_nor_written(
    tmp_path: Path, one: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "one.nc").write_bytes(one)
    monkeypatch.setattr(hdf5, "MAX_BYTES", 10_000)
    assert "is larger than" in refused(tmp_path / "one.nc")
    with pytest.raises(InvalidEventError, match=r"two.nc: is larger than"):
        save_event(make_event(), tmp_path / "two.nc")
    assert not (tmp_path / "two.nc").exists()


def test_a_file_of_several_is_refused_without_its_ids_or_with_lengths_that_do_not_add_up(
    tmp_path: Path, several: bytes
) -> None:
    path = tmp_path / "all.nc"
    for lengths in ([5, 9, 2, 21], [-1, 15, 2, 20], [2**62] * 4):
        path.write_bytes(several)
        with h5py.File(path, "r+") as file:
            file["n_frames"][...] = lengths
        assert "n_frames does not add up to the 36 along time" in refused(path)
    with xr.open_dataset(io.BytesIO(several), engine="h5netcdf") as stored:
        packed = stored.load()
    for dataset, message in (
        (packed.drop_vars("event"), "has no coordinate event"),
        (packed.drop_vars("n_walls"), "has no n_walls"),
        (packed.isel(event=[], time=[], wall=[]), "the list is empty"),
    ):
        dataset.to_netcdf(path, engine="h5netcdf")
        assert message in refused(path)


def _foreign(**attrs: Any) -> xr.Dataset:
    return xr.Dataset({"t": ("city", [1.0])}, attrs=attrs)


FOREIGN: list[tuple[bytes | xr.Dataset, str]] = [
    (b"", "is no NetCDF 4 file"),
    (b"CDF\x01" + bytes(100), "is no NetCDF 4 file"),
    (b'{"format": "phase-ppl-event-1"}', "is no NetCDF 4 file"),
    (hdf5.SIGNATURE, "cannot be read as NetCDF"),
    (_foreign(), "has no format, expected 'phase-ppl-event-1' or"),
    (_foreign(format=[1, 2]), "has no format"),
    (_foreign(format="phase-ppl-event-2"), "'phase-ppl-event-2'"),
    (
        _foreign(schema="phase-ppl-posterior-1"),
        "is a posterior, not an event; phase_ppl.load_posterior reads it",
    ),
    *(
        (_dropped("event").assign(event=(dims, name)), " is ")
        for dims, name in (((), "a\nb"), ((), " "), ((), 7), ("id", ["a", "b"]))
    ),
]


def test_a_file_of_another_kind_or_without_an_id_is_refused_in_one_line(
    tmp_path: Path, one: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "event.nc"
    for content, message in FOREIGN:
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            content.to_netcdf(path, engine="h5netcdf")
        assert message in refused(path)

    def forbidden(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    path.write_bytes(one)
    monkeypatch.setattr("builtins.open", forbidden)
    assert "cannot be read: Permission denied" in refused(path)
