"""The authors' PHASE test videos."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phase_ppl.dataset import load_event, load_events
from phase_ppl.world.errors import InvalidEventError, PhasePPLError, UnknownNameError
from phase_ppl.world.names import ENTITIES, LANDMARKS
from phase_ppl.world.scene import LANDMARK_CENTRES
from tests.world.examples import DEV, RADIUS, make_trajectory, needs_dev, walls

FIRST = "D081920_1135270_E13.2"


def video(id: str = "v1") -> dict[str, Any]:
    """A made-up video in the format of the published ones."""
    trajectory = make_trajectory(5)
    return {
        "id": id,
        "mirror_of_original": "none",
        "observed": {
            "n_frames": 5,
            "wall_segments": walls(up=10, left=7.5).tolist(),
            "landmarks": [
                {"name": name, "colour": name.split()[0], "centre": centre}
                for name, centre in zip(LANDMARKS, LANDMARK_CENTRES.tolist(), strict=True)
            ],
            "entities": [
                {"name": name, "kind": name.split()[1], "radius": radius}
                for name, radius in zip(ENTITIES, RADIUS, strict=True)
            ],
            "trajectories": {
                name: trajectory[:, entity].tolist() for entity, name in enumerate(ENTITIES)
            },
        },
        "truth": {
            "goals": {
                "red agent": "Get blue item to red lm",
                "green agent": "Get blue item to yellow lm",
            },
            "relation": "adversarial",
            "scenario": "competing",
            "strength_id": {"red agent": 3, "green agent": 0},
            "alpha": {"red agent": 0.0, "green agent": 0.0},
        },
        "human": {"relation_counts": {"friendly": 1, "neutral": 2, "adversarial": 9}},
        "models": {"simple_authors": {"relation": "friendly"}},
    }


def write(folder: Path, *videos: dict[str, Any]) -> Path:
    path = folder / "videos.json"
    document = {
        "format": "phase-test-1",
        "arena": {"x": [6.0, 26.0], "y": [2.0, 22.0]},
        "landmark_half_width": 2.5,
        "videos": list(videos),
    }
    path.write_text(json.dumps(document))
    return path


def test_a_video_becomes_an_event(tmp_path: Path) -> None:
    event = load_event(write(tmp_path, video()))
    assert event.id == "v1"
    assert np.array_equal(event.observation.trajectory, make_trajectory(5))
    assert np.array_equal(event.scene.start, make_trajectory(5)[0])
    assert event.scene.radius.tolist() == RADIUS
    assert event.scene.rooms.wall_length.tolist() == [10, 7.5, 0, 0]
    assert event.truth is not None
    assert (event.truth.goal_red, event.truth.scenario) == ("Get blue item to red lm", "competing")
    assert (event.truth.strength_red, event.truth.strength_green) == (600.0, 150.0)
    assert event.judgments == {"relation_counts": {"friendly": 1, "neutral": 2, "adversarial": 9}}
    assert event.predictions == {"simple_authors": {"relation": "friendly"}}


def test_entities_and_landmarks_are_known_by_name_not_by_place(tmp_path: Path) -> None:
    shuffled = video()
    for field in ("entities", "landmarks"):
        shuffled["observed"][field].reverse()
    scene = load_event(write(tmp_path, shuffled)).scene
    assert scene.radius.tolist() == RADIUS
    assert np.array_equal(scene.landmark_centres, LANDMARK_CENTRES)


def test_truth_judgments_and_predictions_may_be_missing(tmp_path: Path) -> None:
    bare = {name: video()[name] for name in ("id", "observed")}
    event = load_event(write(tmp_path, bare))
    assert (event.truth, event.judgments, event.predictions) == (None, None, None)


def test_a_bad_video_does_not_keep_the_others_from_being_read(tmp_path: Path) -> None:
    broken = video("broken")
    del broken["observed"]["trajectories"]["red agent"]
    path = write(tmp_path, video("fine"), broken)
    assert load_event(path, video="fine").id == "fine"
    with pytest.raises(InvalidEventError, match=r"video broken: observed\.trajectories has no red"):
        load_events(path)


CHANGES = {
    "strength": (("truth", "strength_id", "red agent"), 4, "truth.strength_id is 4"),
    "goal": (("truth", "goals", "red agent"), "Get ball", "unknown goal 'Get ball'"),
    "scenario": (("truth", "scenario"), "racing", "unknown scenario 'racing'"),
    "n_frames": (("observed", "n_frames"), 6, "observed.n_frames is 6"),
    "walls": (("observed", "wall_segments"), [[[16, 12]]], "observed.wall_segments has shape"),
    "wall_off": (
        ("observed", "wall_segments"),
        [[[10, 10], [10, 20]]],
        "does not run from the arena's centre",
    ),
    "entities": (("observed", "entities"), [], "observed.entities has no red agent and no green"),
    "entity": (("observed", "entities", 0), {"name": "red agent"}, "the red agent, has no radius"),
    "twice": (("observed", "entities", 0, "name"), "blue item", "names 'blue item' twice"),
    "stranger": (("observed", "entities", 0, "name"), "red item", "'red item'; did you mean"),
    "radius": (
        ("observed", "entities", 1, "radius"),
        "big",
        "observed.entities.radius holds 'big'",
    ),
    "landmark": (("observed", "landmarks", 2, "centre"), [0, 0], "scene.landmark_centres"),
    "observed": (("observed",), None, "observed is None, expected an object"),
}


@pytest.mark.parametrize("case", CHANGES)
def test_a_wrong_value_is_named_with_file_and_video(tmp_path: Path, case: str) -> None:
    where, value, message = CHANGES[case]
    changed: Any = video()
    part = changed
    for step in where[:-1]:
        part = part[step]
    part[where[-1]] = value
    path = write(tmp_path, changed)
    with pytest.raises(PhasePPLError) as raised:
        load_event(path)
    assert str(raised.value).startswith(f"{path}, video v1: ")
    assert message in str(raised.value)


@needs_dev
def test_all_published_videos_are_read() -> None:
    events = load_events(DEV)
    raw = json.loads(DEV.read_text())["videos"]
    assert [event.id for event in events] == [record["id"] for record in raw]
    for event, record in zip(events, raw, strict=True):
        rows = record["observed"]["trajectories"]
        assert event.observation.trajectory[:, 2].tolist() == rows["blue item"]
        assert event.observation.n_frames == record["observed"]["n_frames"]
        assert event.truth is not None
        assert event.truth.goal_green == record["truth"]["goals"]["green agent"]
        level = record["truth"]["strength_id"]["red agent"]
        assert event.truth.strength_red == 150.0 * (level + 1)


@needs_dev
def test_one_published_video_is_found_by_its_id() -> None:
    event = load_event(DEV, video=FIRST)
    assert event.id == FIRST
    assert event.observation.trajectory.shape == (48, 4, 3)
    assert event.scene.radius.tolist() == [0.8, 0.8, 0.8, 1.01]


@needs_dev
def test_an_unknown_video_gets_close_matches() -> None:
    with pytest.raises(UnknownNameError, match=f"unknown video .*did you mean '{FIRST}'"):
        load_event(DEV, video=FIRST[:-2])


@needs_dev
def test_what_generated_a_video_does_not_change_its_scene_and_observation(tmp_path: Path) -> None:
    document = json.loads(DEV.read_text())
    document["videos"] = document["videos"][:8]
    scrambled = copy.deepcopy(document)
    for record in scrambled["videos"]:
        record["mirror_of_original"] = "left-right"
        record.pop("truth")
        record.pop("human")
        record.pop("models")
    for name, content in (("a.json", document), ("b.json", scrambled)):
        (tmp_path / name).write_text(json.dumps(content))
    pairs = zip(load_events(tmp_path / "a.json"), load_events(tmp_path / "b.json"), strict=True)
    for first, second in pairs:
        assert np.array_equal(first.observation.trajectory, second.observation.trajectory)
        assert first.scene.turning == second.scene.turning
        assert np.array_equal(first.scene.walls, second.scene.walls)
