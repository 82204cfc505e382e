"""Whatever is offered as NetCDF: either events, or one line that says why not."""

from __future__ import annotations

import io
import pickle
import random
import re
from pathlib import Path
from typing import Any

import h5py
import pytest
import xarray as xr

from phase_ppl import event_dataset, event_from_dataset
from phase_ppl.dataset import hdf5
from phase_ppl.dataset.load import load_event, load_events, save_event, save_events
from phase_ppl.world.errors import InvalidEventError, UnknownNameError
from tests.dataset.test_bad_files import refused
from tests.dataset.test_events_json import assert_same, various
from tests.dataset.test_hdf5 import TRICKS
from tests.world.examples import make_event


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Content of a file of one event; writing it anew takes longer than a copy."""
    path = tmp_path_factory.mktemp("one") / "one.nc"
    save_event(make_event(), path)
    return path.read_bytes()


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Content of a file of several events."""
    path = tmp_path_factory.mktemp("several") / "all.nc"
    save_events(various(), path)
    return path.read_bytes()


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
