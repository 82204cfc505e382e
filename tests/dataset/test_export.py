"""Events in other formats: what comes back, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import pickle
import pickletools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phase_ppl.dataset.authors.videos import video
from phase_ppl.dataset.generation.making import event_of, recoloured
from phase_ppl.dataset.generation.situation import LAYOUTS, walls_of
from phase_ppl.dataset.load import bundled_events, export_events, load_event, load_events
from phase_ppl.world.errors import InvalidEventError, OutputError, UnknownNameError
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.goals import GOALS
from tests.dataset.authors.pickles import KINDS, expected, processed
from tests.world.examples import DEV, make_event, needs_dev

FORMATS = {"json": "x.json", "netcdf": "x.nc", "phase-test": "x.json", "phase-processed": "x.pkl"}


def copies() -> list[Event]:
    """Return an event and its reflected copies, two of them with other colours too."""
    made = []
    for number, copy in enumerate(KINDS):
        recording = recoloured(expected(copy), agents=number > 2, items=number > 3)
        made.append(event_of(recording, "made" if copy is None else f"made.{number}"))
    return made


def exported(events: list[Event], folder: Path, format: str) -> list[Event]:
    path = folder / FORMATS[format]
    export_events(events, path, format)
    assert [file.name for file in folder.iterdir()] == [path.name]
    return load_events(path, format="phase-pickle" if format == "phase-processed" else None)


def assert_same(one: Event, other: Event) -> None:
    assert (one.id, one.truth) == (other.id, other.truth)
    np.testing.assert_array_equal(one.observation.trajectory, other.observation.trajectory)
    for name in ("start", "radius", "walls", "landmark_centres", "arena"):
        np.testing.assert_array_equal(getattr(one.scene, name), getattr(other.scene, name))


@pytest.mark.parametrize("format", FORMATS)
def test_copies_and_bundled_events_come_back_the_same(tmp_path: Path, format: str) -> None:
    events = [*copies(), *map(load_event, bundled_events())]
    for event, back in zip(events, exported(events, tmp_path, format), strict=True):
        assert_same(event, back)


@needs_dev
@pytest.mark.parametrize("format", FORMATS)
def test_the_real_videos_come_back_the_same(tmp_path: Path, format: str) -> None:
    events = load_events(DEV)
    for event, back in zip(events, exported(events, tmp_path, format), strict=True):
        assert_same(event, back)
        assert event.scene.turning == back.scene.turning
        if format == "phase-processed":
            assert event.judgments is not None
            assert back.judgments == {"majority": event.judgments["majority"]}
        else:
            assert (event.judgments, event.predictions) == (back.judgments, back.predictions)


@pytest.mark.parametrize("format", FORMATS)
def test_an_event_without_truth_has_none_when_it_comes_back(tmp_path: Path, format: str) -> None:
    event = dataclasses.replace(make_event(), truth=None, judgments=None, predictions=None)
    (back,) = exported([event], tmp_path, format)
    assert_same(event, back)
    assert (back.judgments, back.predictions) == (None, None)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_place_is_a_layout_with_the_walls_of_the_event(layout: int) -> None:
    recording = expected(None)
    scene = dataclasses.replace(recording.scene, walls=walls_of(layout))
    name = video(dataclasses.replace(event_of(recording, "x"), scene=scene))["name"]
    assert f"_E{layout}_" in name


@pytest.mark.parametrize("copy", KINDS)
def test_a_video_is_as_the_authors_have_it(copy: int | None) -> None:
    id = "D082020_1817530_E8" + ("" if copy is None else f".{copy}")
    made = video(event_of(expected(copy), id))
    wanted = processed(copy, {0: 0, 1: 1, 3: 2, 4: 3})
    assert set(made) == set(wanted)
    assert made["name"].split("_SZ")[0].split("_A0")[0] == wanted["name"].split("_SZ")[0]
    assert made["landmark_centers"] == wanted["landmark_centers"]
    assert {tuple(map(tuple, wall)) for wall in made["wall_segs"]} == {
        tuple(map(tuple, wall)) for wall in wanted["wall_segs"]
    }
    # bodies of the made-up files are in another order; velocities come of differences of means
    for entity, body in enumerate((1, 0, 3, 2)):
        rows, other = made["trajectories"][entity], wanted["trajectories"][body][:40]
        assert rows.shape == (40, 5)
        np.testing.assert_allclose(rows[:, :2], other[:, :2], atol=1e-9)
        np.testing.assert_allclose(rows[2:-1, 2:4], other[2:-1, 2:4], atol=1.5)


def test_an_agent_at_rest_in_a_copy_has_the_velocity_that_a_point_would_have() -> None:
    offsets = []
    for copy in KINDS:
        recording = expected(copy)
        still = np.repeat(recording.trajectory[:1], 5, axis=0)
        recording = dataclasses.replace(recording, trajectory=still)
        tracks = video(event_of(recording, "x"))["trajectories"]
        offsets.append(tuple(tracks[0][3, 2:4].tolist()))
        assert (tracks[2][:, 2:4] == 0).all()
    assert offsets == [(0, 0), (0, 24), (32, 0), (4, -4), (28, 28)]


def test_the_pickle_loads_anywhere_as_plain_data(tmp_path: Path) -> None:
    path = tmp_path / "all.pkl"
    export_events(copies(), path, "phase-processed")
    content = path.read_bytes()
    asked = {arg for opcode, arg, _ in pickletools.genops(content) if opcode.name == "GLOBAL"}
    assert asked == {"numpy.core.multiarray _reconstruct", "numpy ndarray", "numpy dtype"}
    videos = pickle.loads(content)
    assert [type(video) for video in videos] == [dict] * 5
    assert videos[0]["trajectories"][0].dtype == np.float64


def test_phase_test_has_the_head_of_the_published_file(tmp_path: Path) -> None:
    path = tmp_path / "all.json"
    export_events(copies(), path, "phase-test")
    document = json.loads(path.read_text())
    assert document["format"] == "phase-test-1"
    assert document["goal_labels"] == list(GOALS)
    assert document["arena"] == {"x": [6.0, 26.0], "y": [2.0, 22.0]}
    assert document["videos"][0]["truth"]["strength_id"] == {"red agent": 3, "green agent": 0}


ODD = make_event().scene
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "start": (
        {"scene": dataclasses.replace(ODD, start=ODD.start + 0.1)},
        "does not start as its first frame shows",
    ),
    "reset": (
        {"scene": dataclasses.replace(ODD, resets_velocity=True)},
        "its agents stand still after each step",
    ),
    "strength": (
        {"truth": Truth(GOALS[0], GOALS[1], strength_red=333.0)},
        "a strength is 333 N, expected one of 150, 300, 450, 600",
    ),
}
NO_PLACE: dict[str, tuple[dict[str, Any], str]] = {
    "walls": (
        {"scene": dataclasses.replace(ODD, walls=[[[16, 12], [16, 15]]])},
        "its walls are those of no original layout",
    ),
    "landmarks": (
        {"scene": dataclasses.replace(ODD, landmark_half_width=2.0)},
        "its arena is not the original one",
    ),
    "id": ({"id": "x" * 990}, "of more than 1000 characters"),
    "self": (
        {"truth": Truth("get to red agent", GOALS[0])},
        "'get to red agent' names its own holder",
    ),
}


@pytest.mark.parametrize(
    ("format", "case"),
    [
        *(("phase-test", case) for case in REFUSED),
        *(("phase-processed", case) for case in (*REFUSED, *NO_PLACE)),
    ],
)
def test_what_a_format_has_no_place_for_is_refused(tmp_path: Path, format: str, case: str) -> None:
    changes, message = {**REFUSED, **NO_PLACE}[case]
    odd = dataclasses.replace(make_event(id="odd"), **changes)
    path = tmp_path / FORMATS[format]
    with pytest.raises(InvalidEventError) as raised:
        export_events([make_event(), odd], path, format)
    assert str(raised.value).startswith(f"{path}, video {odd.id}: ")
    assert message in str(raised.value)
    assert not any(tmp_path.iterdir())


def test_angles_that_jump_like_wrapped_ones_are_refused() -> None:
    event = event_of(expected(2), "x")
    trajectory = event.observation.trajectory.copy()
    trajectory[:, 0, 2] = np.where(np.arange(len(trajectory)) < 9, -0.1, -6.2)
    scene = dataclasses.replace(event.scene, start=trajectory[0])
    event = dataclasses.replace(event, scene=scene, observation=Observation(trajectory))
    with pytest.raises(InvalidEventError, match="its angles jump as in damaged files"):
        video(event)


def test_phase_test_holds_one_arena(tmp_path: Path) -> None:
    scene = dataclasses.replace(ODD, landmark_half_width=2.0)
    other = dataclasses.replace(make_event(id="other"), scene=scene)
    with pytest.raises(InvalidEventError, match="video other: its arena is not that of the first"):
        export_events([make_event(), other], tmp_path / "x.json", "phase-test")
    export_events([other], tmp_path / "x.json", "phase-test")
    assert load_events(tmp_path / "x.json")[0].scene.landmark_half_width == 2.0


@pytest.mark.parametrize("format", FORMATS)
def test_what_cannot_be_one_file_is_refused(tmp_path: Path, format: str) -> None:
    path = tmp_path / FORMATS[format]
    with pytest.raises(InvalidEventError, match="the list is empty"):
        export_events([], path, format)
    with pytest.raises(InvalidEventError, match="two videos with the id 'example'"):
        export_events([make_event(), make_event()], path, format)
    with pytest.raises(OutputError, match="expected a name in"):
        export_events([make_event()], tmp_path / "x.txt", format)


def test_an_unknown_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown format 'phase-pickle'; did you mean"):
        export_events([make_event()], tmp_path / "x.pkl", "phase-pickle")
