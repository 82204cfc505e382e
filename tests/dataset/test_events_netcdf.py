"""Events as xarray datasets and NetCDF files: nothing is lost, and what is no event is refused."""

from __future__ import annotations

import dataclasses
import json
import math
import pickle
import random
import re
import tempfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from numpy.typing import NDArray

from phase_ppl import event_dataset, event_from_dataset
from phase_ppl.dataset import hdf5, load_event, load_events, save_event, save_events
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.event import Event
from phase_ppl.world.names import ENTITIES
from phase_ppl.world.observation import Observation
from tests.dataset.test_bad_files import refused
from tests.dataset.test_events_json import assert_same, events
from tests.world.examples import DEV, make_event, make_scene, make_trajectory, needs_dev, walls

# --- as a dataset ----------------------------------------------------------------------------


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


@settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(events)
def test_a_dataset_gives_the_same_event_back(event: Event) -> None:
    assert_same(event_from_dataset(event_dataset(event)), event)


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


# --- as a file -------------------------------------------------------------------------------


@settings(max_examples=12, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(events)
def test_a_file_gives_the_same_event_back(event: Event) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "one.nc"
        save_event(event, path)
        assert_same(load_event(path), event)
        assert_same(load_events(path)[0], event)


def various() -> list[Event]:
    """Events of different lengths, with and without walls and truth."""
    plain = Event(make_scene(walls=[]), Observation(make_trajectory(9)), id="plain")
    return [make_event(5, "b"), plain, make_event(2, "a, Δ"), make_event(20, "c")]


def test_events_of_one_file_come_back_in_order(tmp_path: Path) -> None:
    save_events(various(), tmp_path / "all.nc")
    for loaded, event in zip(load_events(tmp_path / "all.nc"), various(), strict=True):
        assert_same(loaded, event)
    assert_same(load_event(tmp_path / "all.nc", video="plain"), various()[1])
    with pytest.raises(InvalidSettingError, match=r"holds 4 videos; name one of them: 'b', "):
        load_event(tmp_path / "all.nc")
    with pytest.raises(UnknownNameError, match=r"all.nc: unknown video 'plane'; .* 'plain'"):
        load_event(tmp_path / "all.nc", video="plane")
    assert load_events(tmp_path / "all.nc", turning="cw")[2].scene.turning == "cw"


def test_several_events_without_a_wall_between_them(tmp_path: Path) -> None:
    bare = [dataclasses.replace(various()[1], id=name) for name in ("one", "two")]
    save_events(bare, tmp_path / "all.nc")
    assert [len(e.scene.walls) for e in load_events(tmp_path / "all.nc")] == [0, 0]


def test_xarray_reads_the_files_by_itself(tmp_path: Path) -> None:
    save_event(make_event(), tmp_path / "one.nc")
    with xr.open_dataset(tmp_path / "one.nc") as one:
        assert one["trajectory"].dims == ("time", "entity", "coord")
        assert one["time"].values.tolist() == [0, 1 / 12, 2 / 12, 3 / 12]
        assert_same(event_from_dataset(one), make_event())
    save_events(various(), tmp_path / "all.nc")
    with xr.open_dataset(tmp_path / "all.nc") as many:
        assert many["n_frames"].values.tolist() == [5, 9, 2, 20]
        assert many["n_walls"].values.tolist() == [2, 0, 2, 2]
        assert many["goal_red"].sel(event="c").item() == "Get blue item to red lm"
        assert many["goal_red"].sel(event="plain").item() == ""
        assert many["trajectory"].sizes["time"] == 36


@needs_dev
def test_the_real_videos_survive_bit_for_bit(tmp_path: Path) -> None:
    real = load_events(DEV)
    save_events(real, tmp_path / "dev.nc")
    for loaded, event in zip(load_events(tmp_path / "dev.nc"), real, strict=True):
        assert_same(loaded, event)


def test_the_name_of_the_file_does_not_matter(tmp_path: Path) -> None:
    save_event(make_event(), tmp_path / "one.nc")
    (tmp_path / "one.nc").rename(tmp_path / "event")
    assert load_event(tmp_path / "event").id == "example"


@pytest.mark.parametrize("value", [math.nan, {1, 2}, np.arange(3)])
def test_judgments_without_a_json_form_are_not_written(tmp_path: Path, value: object) -> None:
    event = dataclasses.replace(make_event(), judgments={"odd": value})
    with pytest.raises(InvalidEventError, match=r"one.nc: cannot be written as JSON"):
        save_event(event, tmp_path / "one.nc")
    with pytest.raises(InvalidEventError, match=r"one.nc: id is"):
        save_event(dataclasses.replace(make_event(), id="a\nb"), tmp_path / "one.nc")
    assert list(tmp_path.iterdir()) == []


# --- what is no file of events ---------------------------------------------------------------


def _edited(path: Path, edit: str) -> None:
    with h5py.File(path, "r+") as file:
        if edit == "trajectory":
            file["trajectory"][1, 2, 0] += 1e-9
        elif edit == "turning":
            file["turning"][()] = "cw"
        elif edit == "judgments":
            file["judgments"][()] = '{"relation_counts": {}}'
        else:
            file["landmark_half_width"][()] = 2.4


@pytest.mark.parametrize("edit", ["trajectory", "turning", "judgments", "half_width"])
def test_content_that_is_not_what_the_checksum_says_is_refused(tmp_path: Path, edit: str) -> None:
    path = tmp_path / "one.nc"
    save_event(make_event(), path)
    _edited(path, edit)
    assert "its content is not what sha256 says" in refused(path)
    with xr.open_dataset(path) as stored:
        edited = stored.load()
    save_event(event_from_dataset(edited), path)
    load_event(path)
    edited.drop_vars("sha256").to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    load_event(tmp_path / "other.nc")


def test_a_flipped_bit_of_an_array_is_noticed_by_any_reader(tmp_path: Path) -> None:
    path = tmp_path / "one.nc"
    save_event(make_event(), path)
    with h5py.File(path) as file:
        offset = file["trajectory"].id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[offset + 5] ^= 0x01
    path.write_bytes(content)
    assert "cannot be read as NetCDF" in refused(path)


def test_damaged_files_are_the_same_events_or_refused_by_name(tmp_path: Path) -> None:
    path, rng = tmp_path / "damaged.nc", random.Random(0)
    save_events(various(), path)
    whole = path.read_bytes()
    complaints: list[str] = []
    for case in range(60):
        content = bytearray(whole)
        if case < 10:
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
    assert len(complaints) > 20
    assert all(line.startswith(str(path)) and "\n" not in line for line in complaints)


def _hostile(path: Path, change: str) -> None:
    """Make a file of an event that reaches out of itself or grows in memory."""
    with h5py.File(path, "r+") as file:
        if change == "huge":
            del file["radius"]
            file.create_dataset("radius", (2**40,), "f8", chunks=(2**10,))
        elif change == "texts":
            del file["judgments"]
            many = file.create_dataset("judgments", (200_000,), h5py.string_dtype())
            many[0] = "x" * 100_000
        elif change == "virtual":
            layout = h5py.VirtualLayout((4,), "f8")
            layout[:] = h5py.VirtualSource("other.nc", "radius", (4,))
            del file["radius"]
            file.create_virtual_dataset("radius", layout)
        elif change == "external":
            del file["radius"]
            file.create_dataset("radius", (4,), "f8", external=[("/etc/passwd", 0, 32)])
        elif change == "link":
            file["more"] = h5py.ExternalLink("other.nc", "/radius")
        elif change == "soft":
            file["more"] = h5py.SoftLink("/more")
        elif change == "group":
            file["more/radius"] = [1.0]
        elif change == "empty":
            file["more"] = h5py.Empty("f8")
        else:
            file["more"] = np.zeros(3, [("a", "f8"), ("b", "i4")])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("huge", "is larger than the 512 MB that are read"),
        ("texts", "is larger than the 512 MB that are read"),
        ("virtual", "array 'radius' lies in another file"),
        ("external", "array 'radius' lies in another file"),
        ("link", "holds a link, 'more'"),
        ("soft", "holds a link, 'more'"),
        ("group", "holds a group, 'more'"),
        ("empty", "array 'more' is without a shape"),
        ("compound", "array 'more' holds neither numbers nor texts"),
    ],
)
def test_a_file_made_to_do_harm_is_refused_unread(
    tmp_path: Path, change: str, message: str
) -> None:
    path = tmp_path / "one.nc"
    save_event(make_event(), path)
    _hostile(path, change)
    assert message in refused(path)


def test_a_file_that_is_too_large_is_neither_read_nor_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_event(make_event(), tmp_path / "one.nc")
    monkeypatch.setattr(hdf5, "MAX_BYTES", 10_000)
    assert "is larger than" in refused(tmp_path / "one.nc")
    with pytest.raises(InvalidEventError, match=r"two.nc: is larger than"):
        save_event(make_event(), tmp_path / "two.nc")
    assert not (tmp_path / "two.nc").exists()


def _packed(tmp_path: Path) -> xr.Dataset:
    save_events(various(), tmp_path / "all.nc")
    with xr.open_dataset(tmp_path / "all.nc") as stored:
        return stored.load()


@pytest.mark.parametrize("lengths", [[5, 9, 2, 21], [-1, 15, 2, 20], [2**62] * 4, [5.0, 9, 2, 20]])
def test_lengths_that_do_not_add_up_are_refused(tmp_path: Path, lengths: list[float]) -> None:
    path = tmp_path / "all.nc"
    packed = _packed(tmp_path).assign(n_frames=("event", lengths))
    packed.to_netcdf(path, engine="h5netcdf")
    assert "n_frames does not add up to the 36 along time" in refused(path)


def test_a_file_of_several_is_refused_without_its_ids_or_lengths(tmp_path: Path) -> None:
    path = tmp_path / "all.nc"
    packed = _packed(tmp_path)
    for drop, message in (("event", "has no coordinate event"), ("n_walls", "has no n_walls")):
        packed.drop_vars(drop).to_netcdf(path, engine="h5netcdf")
        assert message in refused(path)
    packed.isel(event=[], time=[], wall=[]).to_netcdf(path, engine="h5netcdf")
    assert "the list is empty" in refused(path)


def _bytes(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def _foreign(path: Path, attrs: dict[str, str]) -> None:
    xr.Dataset({"t": ("city", [1.0])}, attrs=attrs).to_netcdf(path, engine="h5netcdf")


FOREIGN: dict[str, tuple[Any, str]] = {
    "empty": (lambda p: _bytes(p, b""), "is no NetCDF 4 file"),
    "netcdf3": (lambda p: _bytes(p, b"CDF\x01" + bytes(100)), "is no NetCDF 4 file"),
    "json": (lambda p: _bytes(p, b'{"format": "phase-ppl-event-1"}'), "is no NetCDF 4 file"),
    "pickle": (lambda p: _bytes(p, pickle.dumps([1])), "is no NetCDF 4 file"),
    "truncated": (lambda p: _bytes(p, hdf5.SIGNATURE), "cannot be read as NetCDF"),
    "other": (lambda p: _foreign(p, {}), "has no format, expected 'phase-ppl-event-1' or"),
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


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    assert "no such file" in refused(tmp_path / "none.nc")
    (tmp_path / "folder.nc").mkdir()
    assert "is a folder" in refused(tmp_path / "folder.nc")


def test_bodies_keep_their_order(tmp_path: Path) -> None:
    wall: NDArray[np.float64] = walls(up=10, left=5, down=7.5)
    event = Event(make_scene(walls=wall), Observation(make_trajectory()))
    save_event(event, tmp_path / "one.nc")
    assert np.array_equal(load_event(tmp_path / "one.nc").scene.walls, wall)
