"""The statistics of small sets, worked out by hand, and of the real videos."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import phase_ppl
from phase_ppl.analysis.figures.data_card import data_table
from phase_ppl.dataset.motion import moves_to_the_end, seems_to_hold, speeds
from phase_ppl.dataset.statistics import GOAL_TYPES, PHASE, standard_error, statistics
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.geometry import rotation
from phase_ppl.world.goals import GOALS
from tests.world.examples import DEV, make_scene, needs_dev

START = np.array([[8.0, 20.0, 0.0], [24.0, 14.0, 1.0], [12.0, 8.0, 0.0], [20.0, 8.0, 0.0]])


def track(n_frames: int, **steps: float) -> NDArray[np.float64]:
    """Return a trajectory in which some entities go right by so much per frame."""
    found = np.repeat(START[None], n_frames, axis=0)
    for entity, name in enumerate(("red", "green", "blue", "pink")):
        found[:, entity, 0] += steps.get(name, 0.0) * np.arange(n_frames)
    return found


def event(
    trajectory: NDArray[np.float64],
    id: str,
    goals: tuple[str, str] | None = ("Get blue item to red lm", "Get blue item to red lm"),
    strengths: tuple[float | None, float | None] = (150.0, 600.0),
) -> Event:
    truth = None
    if goals is not None:
        truth = Truth(*goals, strength_red=strengths[0], strength_green=strengths[1])
    return Event(make_scene(), Observation(trajectory), id=id, truth=truth)


@pytest.fixture
def events() -> list[Event]:
    """A collaborative event of 5 frames and an opposing one of 3."""
    chase = ("get to green agent", "get away from red agent")
    return [
        event(track(5, red=0.1, pink=0.2), "one"),
        event(track(3, green=-0.5), "two", chase, (600.0, None)),
    ]


MANIFEST: dict[str, Any] = {
    "entries": [
        {"id": "one", "group": "one", "family": "collab", "layout": 10, "split": "train",
         "reflection": "none", "measures": {"held": [0.5, 0.0]}},
        {"id": "two", "group": "one", "family": "chasing", "layout": 8, "split": "test",
         "reflection": "up-down", "measures": {"held": [1.0, 0.0]}},
    ],
    "kept": {"collab": 3, "chasing": 1},
    "rejected": {
        "collab": {"an agent is stuck": 1, "a goal is not reached": 4}, "compete": {"dull": 2},
    },
}  # fmt: skip


def test_kinds_goals_strengths_sizes_durations_and_speeds(events: list[Event]) -> None:
    found = statistics(events, name="two")
    assert (found["name"], found["events"], found["units"]) == ("two", 2, 2)
    assert (found["without_strength"], found["draws"]) == (1, None)
    json.dumps(found, allow_nan=False)
    counts = {name: table["counts"] for name, table in found["tables"].items()}
    assert counts["relation"] == {"friendly": 1, "neutral": 0, "adversarial": 1}
    assert found["tables"]["relation"]["shares"]["friendly"] == 0.5
    assert counts["scenario"]["opposing"] == 1
    assert counts["goal_type"] == dict(zip(GOAL_TYPES, (2, 0, 0, 0, 1, 1), strict=True))
    assert len(counts["goal"]) == len(GOALS)
    assert counts["goal"]["Get blue item to red lm"] == 2
    assert counts["strength"] == {"150": 1, "300": 0, "450": 0, "600": 2}
    # red 0.8, green 1.2; blue 1.01, pink 1.6
    assert counts["agent_size"] == {"0.8": 2, "1.01": 0, "1.2": 2, "1.6": 0}
    assert counts["item_size"] == {"0.8": 0, "1.01": 2, "1.2": 0, "1.6": 2}
    assert "family" not in counts
    # red of 150 N goes 0.1 per frame, four times; green of 600 N stands, and so does red in "two"
    expected = {
        "frames_min": 3, "frames_median": 4, "frames_max": 5, "speed_mean_150": 1.2,
        "speed_mean_600": 0, "speed_max": 6.0, "speed_mean": (4 * 1.2 + 2 * 6) / 12,
        "at_rest": 6 / 12, "at_rest_150": 0, "at_rest_600": 1, "step_max": 0.5,
        "items_move": 4 / 12, "untrimmed": 1,
    }  # fmt: skip
    assert {name: found["values"][name]["value"] for name in expected} == pytest.approx(expected)
    bins = {name: histogram["counts"] for name, histogram in found["histograms"].items()}
    assert (bins["frames"][0], bins["speed"][:4]) == (2, [10, 0, 0, 2])
    assert sum(bins["speed_600"]) == 6


def test_what_is_none_of_the_original_strengths_and_sizes_is_other() -> None:
    odd = event(track(3), "odd", strengths=(200.0, 450.0))
    odd = dataclasses.replace(odd, scene=make_scene(radius=[0.9, 1.2, 1.01, 1.6]))
    found = statistics([odd])
    assert found["tables"]["strength"]["counts"]["other"] == 1
    assert found["tables"]["agent_size"]["counts"]["other"] == 1
    assert "speed_mean_450" in found["values"]
    assert "speed_mean_300" not in found["values"]


def test_a_manifest_tells_of_copies_families_holding_and_draws(events: list[Event]) -> None:
    found = statistics(events, MANIFEST)
    tables = found["tables"]
    assert found["units"] == tables["relation"]["units"] == 1
    assert tables["family"]["counts"] == {"chasing": 1, "collab": 1}
    for name, values in (
        ("layout", ["8", "10"]), ("reflection", ["none", "up-down"]), ("split", ["train", "test"]),
    ):  # fmt: skip
        assert list(tables[name]["counts"]) == values
    # 5 frames of (0.5, 0), 3 of (1, 0)
    assert found["holding_from"] == "recorded"
    assert found["values"]["holding"]["value"] == pytest.approx((5 * 0.5 + 3) / 16)
    assert found["values"]["holding"]["se"] is None
    assert found["draws"]["collab"] == {
        "kept": 3, "tried": 8, "share": 3 / 8,
        "reasons": {"a goal is not reached": 4, "an agent is stuck": 1},
    }  # fmt: skip
    assert found["draws"]["compete"]["share"] == 0
    # holding is estimated where it does not tell of all
    part = {**MANIFEST, "entries": [MANIFEST["entries"][0], {"id": "two", "measures": None}]}
    found = statistics(events, part)
    assert found["holding_from"] == "geometry"
    assert found["values"]["holding"]["value"] == 0


def test_events_without_truth_count_where_none_is_needed(events: list[Event]) -> None:
    unknown = event(track(9), "unknown", goals=None)
    found = statistics([*events, unknown])
    assert found["without_truth"] == 1
    assert found["tables"]["relation"]["units"] == 2
    assert found["tables"]["agent_size"]["units"] == 3
    assert found["values"]["frames_max"]["value"] == 9
    alone = statistics([unknown])
    assert set(alone["tables"]) == {"agent_size", "item_size"}
    assert alone["values"]["frames_median"]["se"] is None
    json.dumps(alone, allow_nan=False)


def test_what_cannot_be_described_is_refused(events: list[Event]) -> None:
    with pytest.raises(InvalidEventError, match="no events"):
        statistics([])
    for wrong in ({}, {"entries": 3}, {"entries": [{"family": "collab"}]}):
        with pytest.raises(InvalidSettingError, match="entries"):
            statistics(events, wrong)


def test_the_standard_error_of_a_mean_is_the_textbooks() -> None:
    numbers = np.random.default_rng(1).normal(size=400)
    found = standard_error([np.array([number]) for number in numbers], np.mean)
    assert found == pytest.approx(numbers.std(ddof=1) / 20, rel=0.15)


# --- motion ------------------------------------------------------------------------------------


def test_a_track_that_stands_for_long_at_its_end_was_cut() -> None:
    assert speeds(track(3, red=0.5))[:, 0] == pytest.approx([6.0, 6.0])  # per simulated second
    still = track(3, blue=1.0)
    assert moves_to_the_end(still)
    assert moves_to_the_end(np.concatenate([still, np.repeat(still[-1:], 4, axis=0)]))
    assert not moves_to_the_end(np.concatenate([still, np.repeat(still[-1:], 5, axis=0)]))
    assert not moves_to_the_end(track(3))


@pytest.mark.parametrize("point", [(0, 1), (0, -1), (1, 0), (-1, 0)])
def test_an_item_that_stays_at_a_grab_point_is_held(point: tuple[int, int]) -> None:
    radius = np.array([0.8, 1.2, 1.01, 1.6])
    held = track(12, red=0.3)
    held[:, 0, 2] = np.linspace(0, 2, 12)
    for frame in range(4, 9):
        place = (0.8 + 1.01) * rotation(held[frame, 0, 2]) @ np.array(point)
        held[frame, 2, :2] = held[frame, 0, :2] + place
    found = seems_to_hold(held, radius)
    assert found[:, 0].tolist() == [4 <= frame < 9 for frame in range(12)]
    assert not found[:, 1].any()
    held[6, 2, :2] += 0.3  # a blurred frame
    assert seems_to_hold(held, radius)[4:9, 0].all()
    held[[4, 5], 2, :2] = START[2, :2]  # too short to count
    assert not seems_to_hold(held[:8], radius)[:, 0].any()


# --- the original events -----------------------------------------------------------------------


@needs_dev
def test_half_of_the_test_videos_is_like_the_whole() -> None:
    found = statistics(phase_ppl.load_events(DEV))
    value = {name: entry["value"] for name, entry in found["values"].items()}
    whole = {name: entry["value"] for name, entry in PHASE["values"].items()}
    for level in (150, 300, 450, 600):
        for what in ("mean", "p99"):
            name = f"speed_{what}_{level}"
            assert value[name] == pytest.approx(whole[name], rel=0.15)
    for name in ("untrimmed", "items_move", "holding"):
        assert value[name] == pytest.approx(whole[name], abs=0.04)
    assert 0.19 < value["at_rest"] < 0.31
    assert value["frames_median"] == pytest.approx(whole["frames_median"], abs=5)


# --- other worlds -------------------------------------------------------------------------------


def test_a_set_of_another_world_is_described_by_its_own_names() -> None:
    trio = phase_ppl.worlds.TRIO
    goals = {"red agent": "Get blue ball to home", "green agent": "get to pink ball"}
    event = phase_ppl.simulate(
        trio.random_scene(0),
        goals=goals,
        relation={("purple agent", "red agent"): "hinder"},
        frames=4,
        planner=phase_ppl.PlannerConfig(simulations=2, particles=4),
    )
    found = statistics([event])
    counts = {name: found["tables"][name]["counts"] for name in found["tables"]}
    assert found["landmarks"] == list(trio.landmark_names)
    assert counts["relation"] == {"friendly": 0, "neutral": 2, "adversarial": 1}
    assert counts["scenario"]["opposing"] == 1
    assert {goal for goal, n in counts["goal"].items() if n} == {
        *goals.values(), "Get blue ball away from home"
    }  # fmt: skip
    assert (counts["goal_type"]["LMO+"], counts["goal_type"]["LMO-"]) == (1, 1)
    assert sum(counts["agent_size"].values()) == 3
    assert "home" in data_table(found, PHASE)
    with pytest.raises(InvalidEventError, match="several worlds"):
        statistics([event, phase_ppl.load_event("compete")])
