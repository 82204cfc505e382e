"""Events in NetCDF files: nothing is lost, and xarray reads them by itself."""

from __future__ import annotations

import dataclasses
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from numpy.typing import NDArray

from phase_ppl import event_from_dataset
from phase_ppl.dataset import load_event, load_events, save_event, save_events
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.event import Event
from phase_ppl.world.observation import Observation
from tests.dataset.test_events_json import assert_same, events
from tests.world.examples import DEV, make_event, make_scene, make_trajectory, needs_dev, walls


@settings(max_examples=8, suppress_health_check=[HealthCheck.too_slow], deadline=None)
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


def test_walls_keep_their_order(tmp_path: Path) -> None:
    wall: NDArray[np.float64] = walls(up=10, left=5, down=7.5)
    event = Event(make_scene(walls=wall), Observation(make_trajectory()))
    save_event(event, tmp_path / "one.nc")
    assert np.array_equal(load_event(tmp_path / "one.nc").scene.walls, wall)
