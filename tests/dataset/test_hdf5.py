"""HDF5 files on a full disk, and files that were made to do harm to whoever opens them."""

from __future__ import annotations

import io
import json
import math
import os
import pickle
import random
import re
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
from phase_ppl.dataset import events_netcdf, hdf5
from phase_ppl.dataset.hdf5 import read_netcdf
from phase_ppl.dataset.load import load_event, load_events, save_event
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.names import ENTITIES
from tests.analysis.factory import random_tree
from tests.dataset.test_bad_files import refused
from tests.dataset.test_events_json import assert_same, various
from tests.world.examples import make_event, make_trajectory

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
    many[0] = "x" * 100_000


TEXT = h5py.string_dtype()
TRICKS: dict[str, tuple[Change, str]] = {
    "external": (_external, "array 'radius' lies in another file"),
    "virtual": (_virtual, "array 'more' lies in another file"),
    "link": (_put(h5py.ExternalLink("/etc/passwd", "/")), "holds a link, 'more'"),
    "soft link": (_put(h5py.SoftLink("/more")), "holds a link, 'more'"),
    "itself": (lambda group: group.__setitem__("more", group), "holds a group, 'more'"),
    "group in group": (lambda group: group.create_group("more/inner"), "holds a group, 'more'"),
    "grows": (
        _array((2**30,), "f8", chunks=(2**20,), compression=9),
        "is larger than the 512 MB",
    ),
    "large chunk": (
        _array((4,), "f8", maxshape=(None,), chunks=(2**28,), compression=9),
        "is larger than the 512 MB",
    ),
    "long text": (_long_text, "is larger than the 512 MB"),
    "sparse texts": (
        _array((10**8,), TEXT, chunks=(2**20,)),
        "has more entries than the file has bytes",
    ),
    "texts of attribute": (
        lambda group: group.attrs.create("more", ["x"] * 1000, dtype=TEXT),
        "attribute 'more' has 1000 entries",
    ),
    "empty": (_put(h5py.Empty("f8")), "array 'more' is without a shape"),
    "compound": (
        _put(np.zeros(3, [("a", "f8"), ("b", "i4")])),
        "array 'more' holds neither numbers nor texts",
    ),
}


@pytest.mark.parametrize("trick", TRICKS)
def test_a_posterior_made_to_do_harm_is_refused_unread(posterior: Path, trick: str) -> None:
    change, message = TRICKS[trick]
    with h5py.File(posterior, "r+") as file:
        change(file["constant_data"])
    for load in (ppl.load_posterior, Posterior.load):
        with pytest.raises(InvalidEventError, match=f"run.nc: .*{message}") as raised:
            load(posterior)
        assert "\n" not in str(raised.value)


def test_what_a_terminal_would_obey_is_taken_out_of_a_posterior(posterior: Path) -> None:
    with h5py.File(posterior, "r+") as file:
        del file.attrs["sha256"]
        file.attrs["event_id"] = "one\x1b[2J\x9btwo"
        file.attrs["settings"] = '{"kernel": {"name": "\\u001b[31m"}, "chains": 1}'
    post = Posterior.load(posterior)
    assert post.event_id == "one\ufffd[2J\ufffdtwo"
    assert post.settings["kernel"]["name"] == "\ufffd[31m"


@pytest.mark.parametrize("place", ["weights", "settings", "posterior/alpha", "a label"])
def test_a_posterior_that_is_not_what_it_was_is_refused(posterior: Path, place: str) -> None:
    with h5py.File(posterior, "r+") as file:
        if place == "posterior/alpha":
            file[place][0, 0] += 1
        elif place == "a label":
            labels = file["observed_data/entity"]
            labels[0] = "rod agent"
        else:
            file.attrs[place] += " "
    with pytest.raises(InvalidEventError, match="its content is not what sha256 says"):
        Posterior.load(posterior)


def test_texts_are_read_a_few_at_a_time_and_come_back(tmp_path: Path) -> None:
    path, words = tmp_path / "texts.nc", [["a", "", "ccc"], ["dd", "é", "f"]]
    xr.Dataset({"word": (("x", "y"), np.array(words, object))}).to_netcdf(path, engine="h5netcdf")
    assert read_netcdf(path)["/"]["word"].values.tolist() == words


def test_a_file_whose_root_cannot_be_opened_is_refused_by_name(
    posterior: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def damaged(*_: object, **__: object) -> None:
        raise KeyError("Unable to synchronously open object")

    monkeypatch.setattr(h5py, "File", damaged)
    with pytest.raises(InvalidEventError, match=r"run\.nc: cannot be read as NetCDF"):
        ppl.load_posterior(posterior)


# --- events as Datasets ---------------------------------------------------------------------------


def test_a_dataset_has_the_trajectory_by_names_and_seconds() -> None:
    event = make_event(n_frames=13)
    dataset = event_dataset(event)
    assert dict(dataset["trajectory"].sizes) == {"time": 13, "entity": 4, "coord": 3}
    x = dataset["trajectory"].sel(entity="blue item", coord="x", time=1.0)
    assert x.item() == event.observation.trajectory[12, 2, 0]
    assert dataset["radius"].sel(entity="green agent").item() == 1.2
    assert dataset["goal_green"].item() == "Get blue item to green lm"
    assert (dataset["relation"].item(), dataset["scenario"].item()) == ("adversarial", "competing")
    assert dataset["strength_red"].item() == 300.0
    assert math.isnan(dataset["strength_green"].item())
    assert json.loads(dataset["judgments"].item()) == event.judgments
    assert dataset["event"].item() == "example"


def test_a_dataset_does_not_share_the_arrays_of_its_event() -> None:
    event = make_event()
    dataset = event_dataset(event)
    dataset["trajectory"][0, 0, 0] = 9.0
    assert event.observation.trajectory[0, 0, 0] == 8.0
    assert event_from_dataset(dataset).observation.trajectory[0, 0, 0] == 9.0


def test_dimensions_and_names_may_come_in_any_order() -> None:
    event = make_event()
    turned = event_dataset(event).transpose("xy", "coord", "end", "entity", ...)
    shuffled = turned.isel(
        entity=[2, 0, 3, 1], coord=[2, 0, 1], xy=[1, 0], landmark=[3, 1, 0, 2], bound=[3, 0, 2, 1]
    )
    assert_same(event_from_dataset(shuffled.assign(speed=("time", np.zeros(4)))), event)


def test_a_part_of_the_frames_is_an_event_too() -> None:
    part = event_dataset(make_event(n_frames=8)).isel(time=slice(3, 6))
    trajectory = event_from_dataset(part).observation.trajectory
    assert np.array_equal(trajectory, make_trajectory(8)[3:6])


def test_what_is_known_about_an_event_may_be_missing() -> None:
    known = ["goal_red", "goal_green", "relation", "scenario", "strength_red", "strength_green"]
    bare = event_dataset(make_event()).drop_vars([*known, "judgments", "predictions", "time"])
    event = event_from_dataset(bare)
    assert (event.truth, event.judgments, event.predictions) == (None, None, None)


def _dropped(*names: str) -> xr.Dataset:
    return event_dataset(make_event()).drop_vars(names)


def _with(**changes: Any) -> xr.Dataset:
    return event_dataset(make_event()).assign(changes)


WRONG: dict[str, tuple[Any, str]] = {
    "no_dataset": ({"trajectory": 3}, "{'trajectory': 3} is no xarray Dataset"),
    "no_trajectory": (_dropped("trajectory"), "has no variable trajectory"),
    "no_turning": (_dropped("turning"), "has no turning"),
    "no_id": (_dropped("event"), "has no event"),
    "no_names": (_dropped("entity"), "has no coordinate entity"),
    "dims": (_with(radius=((), 1.0)), "radius has dimensions (), expected (entity)"),
    "extra_dim": (event_dataset(make_event()).expand_dims("draw"), "trajectory has dimensions"),
    "nan": (_with(radius=("entity", [1.0, math.nan, 1.0, 1.0])), "radius[1] is nan"),
    "text": (_with(radius=("entity", ["a", "b", "c", "d"])), "scene.radius holds 'a'"),
    "outside": (_with(start=(("entity", "coord"), np.zeros((4, 3)))), "is at (0, 0)"),
    "number": (_with(turning=((), 7)), "turning is 7, expected a string"),
    "reset": (_with(resets_velocity=((), 2)), "resets_velocity is 2, expected 0 or 1"),
    "reset_nan": (_with(resets_velocity=((), math.nan)), "resets_velocity is None, expected 0"),
    "shown_time": (_with(time=np.arange(4) / 4), "time goes on by 0.25 s, expected 1/12 s"),
    "odd_time": (_with(time=["a", "b", "c", "d"]), "time holds 'a', expected numbers"),
    "json": (_with(judgments=((), "{")), "judgments: is not JSON: line 1"),
    "json_list": (_with(predictions=((), "[]")), "predictions: holds [], expected a JSON object"),
    "twice": (_with(entity=["red agent", "red agent", "x", "y"]), "has a label twice"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_dataset_that_is_no_event_is_refused(case: str) -> None:
    dataset, message = WRONG[case]
    with pytest.raises(InvalidEventError, match=re.escape(message)):
        event_from_dataset(dataset)


def test_a_strength_that_is_none_is_refused() -> None:
    with pytest.raises(InvalidSettingError, match=r"truth.strength_red=-1.0 is no positive force"):
        event_from_dataset(_with(strength_red=((), -1.0)))


@pytest.mark.parametrize(
    ("dataset", "message"),
    [
        (_with(entity=[*ENTITIES[:3], "pink ball"]), "coordinate entity 'pink ball'.*'pink item'"),
        (_with(goal_red=((), "Get blue ball to red lm")), "unknown goal 'Get blue ball"),
        (_with(turning=((), "left")), "unknown turning 'left'"),
    ],
)
def test_unknown_names_are_answered_with_those_there_are(dataset: xr.Dataset, message: str) -> None:
    with pytest.raises(UnknownNameError, match=message):
        event_from_dataset(dataset)


# --- whatever is offered as NetCDF: events, or one line that says why not -------------------------


@pytest.fixture(scope="module")
def one() -> bytes:
    """Content of a file of one event; writing it anew takes longer than a copy."""
    return events_netcdf.event_bytes(make_event())


@pytest.fixture(scope="module")
def several() -> bytes:
    """Content of a file of several events."""
    return events_netcdf.events_bytes(various())


EDITS: dict[str, tuple[tuple[int, ...], Any]] = {
    "trajectory": ((1, 2, 0), 12.1 + 1e-9),
    "turning": ((), "cw"),
    "judgments": ((), '{"relation_counts": {}}'),
    "landmark_half_width": ((), 2.4),
}


def test_content_that_is_not_what_the_checksum_says_is_refused(tmp_path: Path, one: bytes) -> None:
    path = tmp_path / "one.nc"
    assert make_event().observation.trajectory[1, 2, 0] == 12.1
    for name, (where, value) in EDITS.items():
        path.write_bytes(one)
        with h5py.File(path, "r+") as file:
            file[name][where] = value
        assert "its content is not what sha256 says" in refused(path)
    with xr.open_dataset(path) as stored:
        edited = stored.load()
    save_event(event_from_dataset(edited), path)
    load_event(path)
    edited.drop_vars("sha256").to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    load_event(tmp_path / "other.nc")


def test_a_flipped_bit_of_an_array_is_noticed_by_any_reader(tmp_path: Path, one: bytes) -> None:
    path = tmp_path / "one.nc"
    path.write_bytes(one)
    with h5py.File(path) as file:
        offset = file["trajectory"].id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[offset + 5] ^= 0x01
    path.write_bytes(content)
    assert "cannot be read as NetCDF" in refused(path)


def test_damaged_files_are_the_same_events_or_refused_by_name(
    tmp_path: Path, several: bytes
) -> None:
    path, rng = tmp_path / "damaged.nc", random.Random(0)
    whole = several
    complaints: list[str] = []
    for case in range(36):
        content = bytearray(whole)
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
    assert len(complaints) > 12
    assert all(line.startswith(str(path)) and "\n" not in line for line in complaints)


@pytest.mark.parametrize("trick", TRICKS)
def test_a_file_made_to_do_harm_is_refused_unread(tmp_path: Path, one: bytes, trick: str) -> None:
    change, message = TRICKS[trick]
    path = tmp_path / "one.nc"
    path.write_bytes(one)
    with h5py.File(path, "r+") as file:
        change(file)
    assert message in refused(path)


def test_a_file_that_is_too_large_is_neither_read_nor_written(
    tmp_path: Path, one: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "one.nc").write_bytes(one)
    monkeypatch.setattr(hdf5, "MAX_BYTES", 10_000)
    assert "is larger than" in refused(tmp_path / "one.nc")
    with pytest.raises(InvalidEventError, match=r"two.nc: is larger than"):
        save_event(make_event(), tmp_path / "two.nc")
    assert not (tmp_path / "two.nc").exists()


@pytest.fixture(scope="module")
def packed(several: bytes) -> xr.Dataset:
    with xr.open_dataset(io.BytesIO(several), engine="h5netcdf") as stored:
        return stored.load()


@pytest.mark.parametrize("lengths", [[5, 9, 2, 21], [-1, 15, 2, 20], [2**62] * 4, [5.0, 9, 2, 20]])
def test_lengths_that_do_not_add_up_are_refused(
    tmp_path: Path, packed: xr.Dataset, lengths: list[float]
) -> None:
    path = tmp_path / "all.nc"
    packed.assign(n_frames=("event", lengths)).to_netcdf(path, engine="h5netcdf")
    assert "n_frames does not add up to the 36 along time" in refused(path)


def test_a_file_of_several_is_refused_without_its_ids_or_lengths(
    tmp_path: Path, packed: xr.Dataset
) -> None:
    path = tmp_path / "all.nc"
    for drop, message in (("event", "has no coordinate event"), ("n_walls", "has no n_walls")):
        packed.drop_vars(drop).to_netcdf(path, engine="h5netcdf")
        assert message in refused(path)
    packed.isel(event=[], time=[], wall=[]).to_netcdf(path, engine="h5netcdf")
    assert "the list is empty" in refused(path)


def _bytes(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def _foreign(path: Path, attrs: dict[str, Any]) -> None:
    xr.Dataset({"t": ("city", [1.0])}, attrs=attrs).to_netcdf(path, engine="h5netcdf")


FOREIGN: dict[str, tuple[Any, str]] = {
    "empty": (lambda p: _bytes(p, b""), "is no NetCDF 4 file"),
    "netcdf3": (lambda p: _bytes(p, b"CDF\x01" + bytes(100)), "is no NetCDF 4 file"),
    "json": (lambda p: _bytes(p, b'{"format": "phase-ppl-event-1"}'), "is no NetCDF 4 file"),
    "pickle": (lambda p: _bytes(p, pickle.dumps([1])), "is no NetCDF 4 file"),
    "truncated": (lambda p: _bytes(p, hdf5.SIGNATURE), "cannot be read as NetCDF"),
    "other": (lambda p: _foreign(p, {}), "has no format, expected 'phase-ppl-event-1' or"),
    "no text": (lambda p: _foreign(p, {"format": [1, 2]}), "has no format"),
    "later": (lambda p: _foreign(p, {"format": "phase-ppl-event-2"}), "'phase-ppl-event-2'"),
    "posterior": (
        lambda p: _foreign(p, {"schema": "phase-ppl-posterior-1"}),
        "is a posterior, not an event; phase_ppl.Posterior.load reads it",
    ),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_a_file_of_another_kind_is_refused(tmp_path: Path, case: str) -> None:
    make, message = FOREIGN[case]
    make(tmp_path / "event.nc")
    assert message in refused(tmp_path / "event.nc")


@pytest.mark.parametrize("name", ["a\nb", " ", 7, ["a", "b"]], ids=repr)
def test_an_id_that_is_none_is_refused_in_one_line(tmp_path: Path, name: Any) -> None:
    dims = ("id",) if isinstance(name, list) else ()
    dataset = event_dataset(make_event()).drop_vars("event").assign(event=(dims, name))
    dataset.to_netcdf(tmp_path / "one.nc", engine="h5netcdf")
    assert re.search("(id|event) is ", refused(tmp_path / "one.nc"))


def test_a_file_that_may_not_be_read_is_refused_with_the_reason(
    tmp_path: Path, one: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    (tmp_path / "one.nc").write_bytes(one)
    monkeypatch.setattr("builtins.open", forbidden)
    assert "cannot be read: Permission denied" in refused(tmp_path / "one.nc")
