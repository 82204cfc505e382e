"""The authors' PHASE test videos."""

from __future__ import annotations

import copy
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from phase_ppl.dataset.load import load_event, load_events
from phase_ppl.dataset.motion import count_turns, full_turn, observed_turning
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.errors import InvalidEventError, PhasePPLError
from phase_ppl.world.names import ENTITIES, LANDMARKS
from phase_ppl.world.scene import LANDMARK_CENTRES
from tests.world.examples import DEV, RADIUS, START, make_scene, make_trajectory, needs_dev, walls


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


def test_a_bad_video_does_not_keep_the_others_from_being_read(tmp_path: Path) -> None:
    broken = video("broken")
    del broken["observed"]["trajectories"]["red agent"]
    path = write(tmp_path, video("fine"), broken)
    assert load_event(path, video="fine").id == "fine"
    with pytest.raises(InvalidEventError, match="video broken: trajectories has no red"):
        load_events(path)


CHANGES = {
    "strength": (("truth", "strength_id", "red agent"), 4, "truth.strength_id is 4"),
    "goal": (("truth", "goals", "red agent"), "Get ball", "unknown goal 'Get ball'"),
    "scenario": (("truth", "scenario"), "racing", "unknown scenario 'racing'"),
    "n_frames": (("observed", "n_frames"), 6, "observed.n_frames is 6"),
    "walls": (("observed", "wall_segments"), [[[16, 12]]], "scene.walls has shape"),
    "wall_off": (
        ("observed", "wall_segments"),
        [[[10, 10], [10, 20]]],
        "does not run from the arena's centre",
    ),
    "entities": (("observed", "entities"), [], "scene.radius has no red agent and no green"),
    "entity": (("observed", "entities", 0), {"name": "red agent"}, "the red agent, has no radius"),
    "twice": (("observed", "entities", 0, "name"), "blue item", "names 'blue item' twice"),
    "stranger": (("observed", "entities", 0, "name"), "red item", "'red item'; did you mean"),
    "radius": (
        ("observed", "entities", 1, "radius"),
        "big",
        "scene.radius holds 'big'",
    ),
    "landmark": (("observed", "landmarks", 2, "centre"), [0, 0], "scene.landmark_centres"),
    "observed": (("observed",), None, "observed is None, expected an object"),
}


@pytest.mark.parametrize("case", CHANGES)
def test_a_wrong_value_is_named_with_file_and_video(tmp_path: Path, case: str) -> None:
    where, value, message = CHANGES[case]
    changed = video()
    put(changed, where, value)
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


# --- which way agents turn ------------------------------------------------------------------------

SIZES = (0.8, 1.01, 1.2, 1.6)
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


@pytest.mark.parametrize(("radius", "angle"), [(0.8, 1.06), (1.01, 0.66), (1.2, 0.47), (1.6, 0.26)])
def test_a_full_turn_is_what_the_torque_gives_in_one_step(radius: float, angle: float) -> None:
    assert full_turn(radius) == pytest.approx(angle, abs=0.005)


def test_every_step_of_a_turn_is_counted_once() -> None:
    assert count_turns(turned([1, 0]), RADII) == (1, 0)  # spread over two frames
    assert count_turns(turned([1, 1, 1, 0]), RADII) == (2, 0)  # its first and last are partial
    assert count_turns(turned([0, -1, 0, 0, -1, 0], [1, 1, 0]), RADII) == (1, 2)
    assert count_turns(turned([0, 0, 0]), RADII) == (0, 0)


@pytest.mark.parametrize(
    ("red", "green", "way"),
    [
        ([1, 1, 0, 1, 0], [], "both"),
        ([1, 1, 1, 1, 0], [], "ccw"),
        ([-1, 0, -1, 0], [0, -1, -1], "cw"),
        ([1] * 6, [-1] * 6, "both"),
        ([1, 1, 1, 0], [], "both"),  # too few turns
        ([0], [], "both"),
        ([1] * 9, [0, -1, 0], "ccw"),  # one contrary turn does not outweigh many
    ],
)
def test_the_way_that_agents_turn_is_recognised(red: list[int], green: list[int], way: str) -> None:
    assert observed_turning(turned(red, green), RADII) == way


def test_being_pushed_round_is_no_turn() -> None:
    trajectory = turned([0] * 12)
    trajectory[:, 0, 2] -= 0.6 * full_turn(RADII[0]) * np.arange(13)
    assert count_turns(trajectory, RADII) == (0, 0)


ways = st.lists(st.sampled_from([-1, 0, 1]), min_size=1, max_size=30)


@settings(deadline=None)
@given(ways, ways)
def test_in_a_mirror_agents_turn_the_other_way(red: list[int], green: list[int]) -> None:
    trajectory = turned(red, green)
    mirrored = trajectory * [1, 1, -1]
    assert count_turns(mirrored, RADII) == count_turns(trajectory, RADII)[::-1]


@pytest.mark.parametrize("radius", SIZES)
def test_turns_of_the_physics_are_recognised(radius: float) -> None:
    scene = make_scene(radius=[radius, radius, 0.8, 0.8], walls=[])
    world = PymunkWorld(scene, (450.0, 450.0))
    frames = [scene.start]
    frames += [world.step((Action.TURN_LEFT, Action.NO_FORCE)) for _ in range(5)]
    assert observed_turning(np.array(frames), scene.radius) == "ccw"
    frames += [world.step((Action.NO_FORCE, Action.TURN_RIGHT)) for _ in range(5)]
    assert observed_turning(np.array(frames), scene.radius) == "both"


@needs_dev
def test_the_published_originals_turn_left_and_their_reflected_copies_right() -> None:
    mirrors = [record["mirror_of_original"] for record in json.loads(DEV.read_text())["videos"]]
    found = Counter(
        (mirror == "none", event.scene.turning)
        for mirror, event in zip(mirrors, load_events(DEV), strict=True)
    )
    assert found == {(True, "ccw"): 10, (True, "both"): 1, (False, "cw"): 37, (False, "both"): 2}
