"""The authors' PHASE test videos, and events written in their formats."""

from __future__ import annotations

import dataclasses
import json
import pickle
import pickletools
from collections import Counter
from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.data.authors import videos as authors
from phase_ppl.data.generation.making import event_of, recoloured
from phase_ppl.data.generation.situation import LAYOUTS, walls_of
from phase_ppl.data.load import bundled_events, export_events, load_event, load_events
from phase_ppl.data.motion import count_turns, full_turn, observed_turning
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.errors import InvalidEventError, OutputError, PhasePPLError, UnknownNameError
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.goals import GOALS
from phase_ppl.world.names import ENTITIES, LANDMARKS
from phase_ppl.world.scene import LANDMARK_CENTRES
from tests.data.authors.pickles import KINDS, expected, processed
from tests.world.examples import (
    DEV,
    RADIUS,
    START,
    make_event,
    make_scene,
    make_trajectory,
    needs_dev,
    walls,
)


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


def put(record: Any, where: Sequence[str | int], value: Any) -> None:
    """Change a value in a record."""
    for step in where[:-1]:
        record = record[step]
    record[where[-1]] = value


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


def test_a_video_becomes_an_event_by_the_names_in_it(tmp_path: Path) -> None:
    given = video()
    for field in ("entities", "landmarks"):
        given["observed"][field].reverse()
    event = load_event(write(tmp_path, given))
    assert event.id == "v1"
    assert np.array_equal(event.observation.trajectory, make_trajectory(5))
    assert np.array_equal(event.scene.start, make_trajectory(5)[0])
    assert np.array_equal(event.scene.landmark_centres, LANDMARK_CENTRES)
    assert event.scene.radius.tolist() == RADIUS
    assert event.scene.rooms.wall_length.tolist() == [10, 7.5, 0, 0]
    assert event.truth is not None
    assert (event.truth.goal_red, event.truth.scenario) == ("Get blue item to red lm", "competing")
    assert (event.truth.strength_red, event.truth.strength_green) == (600.0, 150.0)
    assert event.judgments == {"relation_counts": {"friendly": 1, "neutral": 2, "adversarial": 9}}
    assert event.predictions == {"simple_authors": {"relation": "friendly"}}


CHANGES: list[tuple[tuple[str | int, ...], Any, str]] = [
    (("truth", "strength_id", "red agent"), 4, "truth.strength_id[...]: Expected 'int' <= 3"),
    (("observed", "n_frames"), 6, "observed.n_frames is 6"),
    (("observed", "entities"), [], "observed.entities has no red agent and no green"),
    (
        ("observed", "entities", 0),
        {"name": "red agent"},
        "observed.entities[0]: Object missing required field 'radius'",
    ),
    (
        ("observed", "entities", 0, "name"),
        "blue item",
        "observed.entities has twice the name 'blue item'",
    ),
    (("observed", "entities", 0, "name"), "red item", "'red item'; did you mean"),
    (
        ("observed", "entities", 1, "radius"),
        "big",
        "observed.entities[1].radius: Expected 'float', got 'str'",
    ),
    (("observed", "landmarks", 2, "centre"), [0, 0], "scene.landmark_centres"),
    (("observed", "entities", 0), 3, "observed.entities[0]: Expected 'object', got 'int'"),
    (("observed",), None, "observed: Expected 'object', got 'null'"),
]


def test_a_wrong_value_is_named_with_file_and_video(tmp_path: Path) -> None:
    for where, value, message in CHANGES:
        changed = video()
        put(changed, where, value)
        path = write(tmp_path, video("fine"), changed)
        with pytest.raises(PhasePPLError) as raised:
            load_events(path)
        assert str(raised.value).startswith(f"{path}, video v1: ")
        assert message in str(raised.value)
        assert load_event(path, video="fine").id == "fine"  # it is no harm to others


@needs_dev
def test_all_published_videos_are_read_originals_turning_left_and_reflected_copies_right() -> None:
    events = load_events(DEV)
    raw = json.loads(DEV.read_text())["videos"]
    found: Counter[tuple[bool, str]] = Counter()
    for event, record in zip(events, raw, strict=True):
        rows = record["observed"]["trajectories"]
        assert event.id == record["id"]
        assert event.observation.trajectory[:, 2].tolist() == rows["blue item"]
        assert event.observation.n_frames == record["observed"]["n_frames"]
        assert event.truth is not None
        assert event.truth.goal_green == record["truth"]["goals"]["green agent"]
        level = record["truth"]["strength_id"]["red agent"]
        assert event.truth.strength_red == 150.0 * (level + 1)
        found[record["mirror_of_original"] == "none", event.scene.turning] += 1
    assert found == {(True, "ccw"): 10, (True, "both"): 1, (False, "cw"): 37, (False, "both"): 2}


@needs_dev
def test_what_generated_a_video_does_not_change_its_scene_and_observation(tmp_path: Path) -> None:
    document = json.loads(DEV.read_text())
    document["videos"] = document["videos"][:8]
    scrambled = deepcopy(document)
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


# --- which way agents turn ------------------------------------------------------------------------

RADII = np.array([0.8, 1.6, 1.0, 1.0])


def turned(red: Sequence[int], green: Sequence[int] = ()) -> NDArray[np.float64]:
    """Return the frames of agents that turn (+1), turn back (-1) or rest (0) in each step.

    Each substep updates the spin and then the angle; a step begins without spin; a frame is the
    mean of a step.
    """
    trajectory = np.tile(np.array(START), (max(len(red), len(green)) + 1, 1, 1))
    shares = np.cumsum(np.arange(1, 6)) / 15  # of the turn, after each substep
    for agent, ways in enumerate((red, green)):
        angle = trajectory[0, agent, 2]
        for step, way in enumerate(ways, start=1):
            turn = way * full_turn(RADII[agent])
            trajectory[step, agent, 2] = angle + turn * shares.mean()
            angle += turn
        trajectory[len(ways) + 1 :, agent, 2] = angle
    return trajectory


def test_every_step_of_a_turn_is_counted_once() -> None:
    for radius, angle in ((0.8, 1.06), (1.01, 0.66), (1.2, 0.47), (1.6, 0.26)):
        assert full_turn(radius) == pytest.approx(angle, abs=0.005)
    assert count_turns(turned([1, 0]), RADII) == (1, 0)  # spread over two frames
    assert count_turns(turned([1, 1, 1, 0]), RADII) == (2, 0)  # its first and last are partial
    assert count_turns(turned([0, -1, 0, 0, -1, 0], [1, 1, 0]), RADII) == (1, 2)
    assert count_turns(turned([0, 0, 0]), RADII) == (0, 0)
    pushed = turned([0] * 12)
    pushed[:, 0, 2] -= 0.6 * full_turn(RADII[0]) * np.arange(13)
    assert count_turns(pushed, RADII) == (0, 0)


def test_the_way_that_agents_turn_is_recognised() -> None:
    for red, green, way in (
        ([1, 1, 0, 1, 0], [], "both"),
        ([1, 1, 1, 1, 0], [], "ccw"),
        ([-1, 0, -1, 0], [0, -1, -1], "cw"),
        ([1] * 6, [-1] * 6, "both"),
        ([1, 1, 1, 0], [], "both"),  # too few turns
        ([1] * 9, [0, -1, 0], "ccw"),  # one contrary turn does not outweigh many
    ):
        trajectory = turned(red, green)
        assert observed_turning(trajectory, RADII) == way
        # and the other way in a mirror
        mirrored = trajectory * [1, 1, -1]
        assert count_turns(mirrored, RADII) == count_turns(trajectory, RADII)[::-1]


@pytest.mark.parametrize("radius", [0.8, 1.6])
def test_turns_of_the_physics_are_recognised(radius: float) -> None:
    scene = make_scene(radius=[radius, radius, 0.8, 0.8], walls=[])
    world = PymunkWorld(scene, (450.0, 450.0))
    frames = [scene.start]
    frames += [world.step((Action.TURN_LEFT, Action.NO_FORCE)) for _ in range(5)]
    assert observed_turning(np.array(frames), scene.radius) == "ccw"
    frames += [world.step((Action.NO_FORCE, Action.TURN_RIGHT)) for _ in range(5)]
    assert observed_turning(np.array(frames), scene.radius) == "both"


# --- events in other formats: what comes back, and what is refused --------------------------------

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
    return load_events(path)


def assert_same(one: Event, other: Event) -> None:
    assert (one.id, one.truth) == (other.id, other.truth)
    np.testing.assert_array_equal(one.observation.trajectory, other.observation.trajectory)
    for name in ("start", "radius", "walls", "landmark_centres", "arena"):
        np.testing.assert_array_equal(getattr(one.scene, name), getattr(other.scene, name))


@pytest.mark.parametrize("format", FORMATS)
def test_copies_bundled_events_and_one_without_truth_come_back_the_same(
    tmp_path: Path, format: str
) -> None:
    bare = dataclasses.replace(make_event(), truth=None, judgments=None, predictions=None)
    events = [*copies(), *map(load_event, bundled_events()), bare]
    found = exported(events, tmp_path, format)
    for event, back in zip(events, found, strict=True):
        assert_same(event, back)
    assert (found[-1].judgments, found[-1].predictions) == (None, None)


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


@pytest.mark.parametrize(
    ("copy", "at_rest"), [*zip(KINDS, [(0, 0), (0, 24), (32, 0), (4, -4), (28, 28)], strict=True)]
)
def test_a_video_is_as_the_authors_have_it(copy: int | None, at_rest: tuple[int, int]) -> None:
    id = "D082020_1817530_E8" + ("" if copy is None else f".{copy}")
    recording = expected(copy)
    made = authors.video(event_of(recording, id))
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
    # of agents they were reflected as if they were points
    still = np.repeat(recording.trajectory[:1], 5, axis=0)
    recording = dataclasses.replace(recording, trajectory=still)
    tracks = authors.video(event_of(recording, "x"))["trajectories"]
    assert tuple(tracks[0][3, 2:4]) == at_rest
    assert (tracks[2][:, 2:4] == 0).all()


def test_the_pickle_loads_anywhere_as_plain_data_and_phase_test_has_its_head(
    tmp_path: Path,
) -> None:
    path = tmp_path / "all.pkl"
    export_events(copies(), path, "phase-processed")
    content = path.read_bytes()
    asked = {arg for opcode, arg, _ in pickletools.genops(content) if opcode.name == "GLOBAL"}
    assert asked == {"numpy.core.multiarray _reconstruct", "numpy ndarray", "numpy dtype"}
    videos = pickle.loads(content)
    assert [type(video) for video in videos] == [dict] * 5
    assert videos[0]["trajectories"][0].dtype == np.float64
    export_events(copies(), tmp_path / "all.json", "phase-test")
    document = json.loads((tmp_path / "all.json").read_text())
    assert document["format"] == "phase-test-1"
    assert document["goal_labels"] == list(GOALS)
    assert document["arena"] == {"x": [6.0, 26.0], "y": [2.0, 22.0]}
    assert document["videos"][0]["truth"]["strength_id"] == {"red agent": 3, "green agent": 0}


ODD = make_event().scene
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"scene": dataclasses.replace(ODD, start=ODD.start + 0.1)},
     "does not start as its first frame shows"),
    ({"scene": dataclasses.replace(ODD, resets_velocity=True)},
     "its agents stand still after each step"),
    ({"truth": Truth(GOALS[0], GOALS[1], strength_red=333.0)},
     "a strength is 333 N, expected one of 150, 300, 450, 600"),
]  # fmt: skip
NO_PLACE: list[tuple[dict[str, Any], str]] = [
    ({"scene": dataclasses.replace(ODD, walls=[[[16, 12], [16, 15]]])},
     "its walls are those of no original layout"),
    ({"scene": dataclasses.replace(ODD, landmark_half_width=2.0)},
     "its arena is not the original one"),
    ({"id": "x" * 990}, "of more than 1000 characters"),
    ({"truth": Truth("get to red agent", GOALS[0])}, "'get to red agent' names its own holder"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("format", "cases"), [("phase-test", REFUSED), ("phase-processed", REFUSED + NO_PLACE)]
)
def test_what_a_format_has_no_place_for_is_refused(
    tmp_path: Path, format: str, cases: list[tuple[dict[str, Any], str]]
) -> None:
    path = tmp_path / FORMATS[format]
    for changes, message in cases:
        odd = dataclasses.replace(make_event(id="odd"), **changes)
        with pytest.raises(InvalidEventError) as raised:
            export_events([make_event(), odd], path, format)
        assert str(raised.value).startswith(f"{path}, video {odd.id}: ")
        assert message in str(raised.value)
    for events, message in (
        ([], "the list is empty"),
        ([make_event(), make_event()], "two videos with the id 'example'"),
    ):
        with pytest.raises(InvalidEventError, match=message):
            export_events(events, path, format)
    assert not any(tmp_path.iterdir())


def test_the_place_is_a_layout_with_the_walls_and_angles_that_jump_are_refused() -> None:
    recording = expected(None)
    for layout in LAYOUTS:
        scene = dataclasses.replace(recording.scene, walls=walls_of(layout))
        made = authors.video(dataclasses.replace(event_of(recording, "x"), scene=scene))
        assert f"_E{layout}_" in made["name"]
    event = event_of(expected(2), "x")
    trajectory = event.observation.trajectory.copy()
    trajectory[:, 0, 2] = np.where(np.arange(len(trajectory)) < 9, -0.1, -6.2)  # as wrapped ones
    scene = dataclasses.replace(event.scene, start=trajectory[0])
    event = dataclasses.replace(event, scene=scene, observation=Observation(trajectory))
    with pytest.raises(InvalidEventError, match="its angles jump as in damaged files"):
        authors.video(event)


def test_phase_test_holds_one_arena_and_formats_have_their_names(tmp_path: Path) -> None:
    scene = dataclasses.replace(ODD, landmark_half_width=2.0)
    other = dataclasses.replace(make_event(id="other"), scene=scene)
    with pytest.raises(InvalidEventError, match="video other: its arena is not that of the first"):
        export_events([make_event(), other], tmp_path / "x.json", "phase-test")
    export_events([other], tmp_path / "x.json", "phase-test")
    assert load_events(tmp_path / "x.json")[0].scene.landmark_half_width == 2.0
    with pytest.raises(OutputError, match="expected a name in"):
        export_events([other], tmp_path / "x.txt", "phase-test")
    with pytest.raises(UnknownNameError, match=r"unknown format 'phase-tests'; did you mean"):
        export_events([other], tmp_path / "x.json", "phase-tests")
