"""The authors' PHASE test videos."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.data.load import load_event, load_events
from phase_ppl.data.motion import count_turns, full_turn, observed_turning
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.errors import PhasePPLError
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
        ("observed", "entities", 0, "name"),
        "blue item",
        "observed.entities has twice the name 'blue item'",
    ),
    (("observed", "landmarks", 2, "centre"), [0, 0], "scene.landmark_centres"),
    (("observed", "entities", 0), 3, "observed.entities[0]: Expected 'object', got 'int'"),
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
