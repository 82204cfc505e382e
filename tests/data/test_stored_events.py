"""Events of a file that are read when they are asked for."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import loky
import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.data import events_netcdf
from phase_ppl.data.events_netcdf import StoredEvents, checksum
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event
from tests.world.examples import make_event

N = 40


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Event]]:
    """A file of events of different lengths, and those events."""
    events = [make_event(2 + number % 5, f"event {number}") for number in range(N)]
    path = tmp_path_factory.mktemp("events") / "all.nc"
    ppl.save_events(events, path)
    return path, events


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The ids of the events that were read."""
    ids: list[str] = []
    event_at: Callable[..., Event] = events_netcdf.event_at

    def counted(*given: object) -> Event:
        event = event_at(*given)
        ids.append(event.id)
        return event

    monkeypatch.setattr(events_netcdf, "event_at", counted)
    return ids


def open_files() -> int:
    return len(h5py.h5f.get_obj_ids(h5py.h5f.OBJ_ALL, h5py.h5f.OBJ_FILE))


def same(one: Event, other: Event) -> bool:
    return checksum(one) == checksum(other)


def test_only_what_is_asked_for_is_read(whole: tuple[Path, list[Event]], read: list[str]) -> None:
    path, events = whole
    found = StoredEvents(path)
    assert (len(found), found.ids, read) == (N, [event.id for event in events], [])
    part = found[10:2:-3][1:]
    assert (part.ids, len(found[5:5]), read) == (["event 7", "event 4"], 0, [])
    assert same(found[31], events[31])
    assert same(found[-1], events[-1])
    assert same(found[np.int64(3)], events[3])  # type: ignore[call-overload]
    assert same(part[1], events[4])
    assert read == ["event 31", f"event {N - 1}", "event 3", "event 4"]
    with pytest.raises(IndexError):
        found[N]


def test_all_come_in_order_and_the_file_is_closed(whole: tuple[Path, list[Event]]) -> None:
    path, events = whole
    before = open_files()
    for one, other in zip(StoredEvents(path), events, strict=True):
        assert same(one, other)
        assert open_files() == before


@pytest.mark.parametrize(
    "pool", [ThreadPoolExecutor, pytest.param(loky.ProcessPoolExecutor, marks=pytest.mark.slow)]
)
def test_they_can_be_pickled_and_read_by_threads_and_processes(
    whole: tuple[Path, list[Event]], pool: Any
) -> None:
    path, events = whole
    found = pickle.loads(pickle.dumps(StoredEvents(path)))
    with pool(4) as started:
        got = list(started.map(found.__getitem__, range(0, N, 5)))
    assert all(same(one, other) for one, other in zip(got, events[::5], strict=True))
    assert {event.scene.turning for event in StoredEvents(path, "cw")[:3]} == {"cw"}


def test_what_is_damaged_or_changed_or_no_set_is_named(tmp_path: Path) -> None:
    path = tmp_path / "all.nc"
    ppl.save_events([make_event(4, name) for name in ("one", "two", "three")], path)
    with h5py.File(path, "r+") as file:
        file["sha256"][1] = "0" * 64
    found = StoredEvents(path)
    assert [found[0].id, found[2].id] == ["one", "three"]
    with pytest.raises(InvalidEventError, match=r"all\.nc, video two: .*sha256"):
        found[1]
    os.utime(path, (1, 1))
    with pytest.raises(InvalidEventError, match=r"all\.nc: was changed since"):
        found[0]
    path.unlink()
    with pytest.raises(InvalidEventError, match=r"all\.nc: no such file"):
        found[0]
    ppl.save_event(make_event(4, "one"), tmp_path / "one.nc")
    (tmp_path / "none.nc").write_text("nothing")
    for name, said in (("one.nc", "phase-ppl-events-1"), ("none.nc", r"none\.nc")):
        with pytest.raises(InvalidEventError, match=said):
            StoredEvents(tmp_path / name)
