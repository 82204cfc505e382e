"""The package's own event files: nothing is lost; people read the JSON, xarray the NetCDF."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import phase_ppl as ppl
from phase_ppl import event_dataset
from phase_ppl.data import load
from phase_ppl.data.events_json import event_from_record, event_record, to_text
from phase_ppl.data.load import bundled_events, load_event, load_events, save_event, save_events
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    UnknownNameError,
)
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import scenario
from phase_ppl.world.scene import TURNINGS
from tests.world.examples import RADIUS, START, make_event, make_scene, make_trajectory, walls


def assert_same(first: Event, second: Event) -> None:
    assert np.array_equal(first.observation.trajectory, second.observation.trajectory)
    for name in ("start", "radius", "walls", "landmark_centres"):
        assert np.array_equal(getattr(first.scene, name), getattr(second.scene, name)), name
    for name in ("arena", "turning", "landmark_half_width", "resets_velocity"):
        assert getattr(first.scene, name) == getattr(second.scene, name), name
    for name in ("id", "truth", "judgments", "predictions"):
        assert getattr(first, name) == getattr(second, name), name


def inside(*, rows: st.SearchStrategy[int]) -> st.SearchStrategy[np.ndarray]:
    shapes = rows.map(lambda n: (n, 4, 3))
    x = hnp.arrays(np.float64, shapes, elements=st.floats(0, 1))
    return x.map(lambda a: a * [20.0, 20.0, 50.0] + [6.0, 2.0, -25.0])


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)  # fmt: skip
events = st.builds(
    Event,
    scene=st.builds(
        make_scene,
        walls=st.sampled_from([walls(), walls(up=10), walls(up=10, left=7.5, down=5, right=7.5)]),
        turning=st.sampled_from(TURNINGS),
        resets_velocity=st.booleans(),
        radius=hnp.arrays(np.float64, 4, elements=st.floats(0.1, 3)),
    ),
    observation=inside(rows=st.integers(2, 6)).map(Observation),
    id=st.text(st.characters(categories=["L", "N", "P"]), min_size=1, max_size=12),
    truth=st.none()
    | st.builds(
        Truth,
        st.sampled_from(GOALS),
        st.sampled_from(GOALS),
        strength_red=st.none() | st.floats(150, 600),
        strength_green=st.none() | st.floats(150, 600),
    ),
    judgments=st.none() | st.dictionaries(st.text(), plain, max_size=3),
    predictions=st.none() | st.dictionaries(st.text(), plain, max_size=3),
)


@settings(max_examples=30)
@given(events)
def test_writing_and_reading_changes_nothing(event: Event) -> None:
    assert_same(event_from_record(json.loads(to_text(event_record(event)))), event)


def various() -> list[Event]:
    """Events of different lengths, with and without walls and truth."""
    plain = Event(make_scene(walls=[]), Observation(make_trajectory(9)), id="plain")
    return [make_event(5, "b"), plain, make_event(2, "a, Δ"), make_event(20, "c")]


def test_events_of_one_file_come_back_in_order_each_with_its_rules(tmp_path: Path) -> None:
    path = tmp_path / "all.json"
    first, *others = various()
    # who reads one event of many reads it by another way
    steered = dataclasses.replace(
        first, scene=dataclasses.replace(first.scene, resets_velocity=True)
    )
    given = [*others, steered]
    save_events(given, path)
    for loaded, event in zip(load_events(path), given, strict=True):
        assert_same(loaded, event)
    assert_same(load_event(path, video="plain"), given[0])
    assert load_event(path, video="b").scene.resets_velocity
    with pytest.raises(InvalidSettingError, match=r"holds 4 videos; name one of them: 'plain', "):
        load_event(path)
    with pytest.raises(UnknownNameError, match=r"all.json: unknown video 'plane'; .* 'plain'"):
        load_event(path, video="plane")
    assert load_events(path, turning="cw")[1].scene.turning == "cw"
    assert load_event(path, "b", turning="ccw").scene.turning == "ccw"
    with pytest.raises(UnknownNameError, match="unknown turning 'left'"):
        load_event(path, "b", turning="left")  # type: ignore[arg-type]
    (tmp_path / "renamed").write_bytes(path.read_bytes())
    assert len(load_events(tmp_path / "renamed")) == 4
    # a set of which none has walls
    save_events([dataclasses.replace(given[0], id=name) for name in ("one", "two")], path)
    assert [len(event.scene.walls) for event in load_events(path)] == [0, 0]


def test_a_dataset_has_the_trajectory_by_names_and_seconds() -> None:
    event = make_event(n_frames=13)
    dataset = event_dataset(event)
    x = dataset["trajectory"].sel(entity="blue item", coord="x", time=1.0)
    assert x.item() == event.observation.trajectory[12, 2, 0]
    assert dataset["radius"].sel(entity="green agent").item() == 1.2
    assert dataset.attrs["event"] == "example"
    assert json.loads(dataset.attrs["truth"])["goals"]["green agent"] == "Get blue item to green lm"
    # it does not share the arrays of the event
    dataset["trajectory"][0, 0, 0] = 9.0
    assert event.observation.trajectory[0, 0, 0] == 8.0


def handwritten() -> dict:
    """What a person has to write at least."""
    tracks = np.array([START, START]).transpose(1, 0, 2).tolist()
    names = ["red agent", "green agent", "blue item", "pink item"]
    return {
        "format": "phase-ppl-event-1",
        "id": "mine",
        "scene": {"radius": dict(zip(names, RADIUS, strict=True))},
        "trajectories": dict(zip(names, tracks, strict=True)),
    }


def test_the_shortest_file_is_the_original_world_without_inner_walls() -> None:
    record = handwritten()
    event = event_from_record(record)
    assert event.scene.rooms.is_open
    assert event.scene.turning == "both"
    assert np.array_equal(event.scene.start, START)
    assert (event.truth, event.judgments, event.predictions) == (None, None, None)
    # entities come in any order, and goals alone imply the rest of a truth
    goals = {"red agent": "get to green agent", "green agent": "get away from red agent"}
    record["trajectories"] = dict(reversed(record["trajectories"].items()))
    event = event_from_record({**record, "truth": {"goals": goals}})
    assert np.array_equal(event.observation.trajectory[0], START)
    assert event.truth == Truth(*goals.values())


def test_what_no_file_can_say_is_not_written(tmp_path: Path) -> None:
    odd: list[tuple[dict[str, Any], str]] = [
        *(
            ({"judgments": {"odd": value}}, "cannot be written as JSON")
            for value in (math.nan, {1, 2}, np.arange(3), 1j)
        ),
        *(({"id": id}, "id is .*, expected printable text") for id in ("", " ", "a\nb", "\ud800")),
    ]
    for changes, said in odd:
        with pytest.raises(InvalidEventError, match=f"one.json: {said}"):
            save_event(dataclasses.replace(make_event(), **changes), tmp_path / "one.json")
    with pytest.raises(OutputError, match=r"one\.txt: expected a name in .json"):
        save_event(make_event(), tmp_path / "one.txt")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def two_bundled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "events"
    folder.mkdir()
    for name in ("meet", "chase"):
        save_event(make_event(id=name), folder / f"{name}.json")
    (folder / "README.md").write_text("not an event")
    monkeypatch.setattr(load, "_folder", lambda: folder)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")


@pytest.mark.usefixtures("two_bundled")
def test_a_bundled_event_is_loaded_by_its_name_unless_a_file_has_it() -> None:
    assert bundled_events() == ["chase", "meet"]
    for name in ("chase", "chase.json", Path("chase.json")):
        assert load_event(name).id == load_events(name)[0].id == "chase"
    assert load_event("chase", turning="cw").scene.turning == "cw"
    save_event(make_event(id="my own"), "chase.json")
    Path("chase").mkdir()
    assert (load_event("chase.json").id, load_event("chase").id) == ("my own", "chase")
    with pytest.raises(UnknownNameError, match="chase: unknown video 'other'"):
        load_event("chase", video="other")
    # nothing else stands for one
    Path("results").mkdir()
    for name, said in (
        ("results", "results: is a folder"),
        ("data/chase.json", r"data/chase.json: no such file"),
        ("chasing", r"chasing: no such file, .* chase, meet"),
    ):
        with pytest.raises(InvalidEventError, match=said):
            load_event(name)


def test_every_bundled_event_carries_its_name_and_a_consistent_truth(tmp_path: Path) -> None:
    for name in bundled_events():
        event = load_event(name)
        assert event.id == name
        assert event.truth.scenario == scenario(event.truth.goal_red, event.truth.goal_green)
        # what was written before agents could stand still after each step is written as it was
        assert not event.scene.resets_velocity
        save_event(event, tmp_path / f"{name}.json")
        bundled = Path(ppl.__file__).parent / "data" / "events" / f"{name}.json"
        assert (tmp_path / f"{name}.json").read_bytes() == bundled.read_bytes()
