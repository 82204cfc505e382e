"""The statistics of small sets, worked out by hand, and of the real videos."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import phase_ppl as ppl
from phase_ppl.data.generated import GeneratedEvents
from phase_ppl.data.motion import seems_to_hold
from phase_ppl.data.statistics import GOAL_TYPES, standard_error, statistics
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.geometry import rotation
from phase_ppl.world.goals import GOALS
from tests.analysis.pages import texts_apart
from tests.models.walks import make_set
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
    chase = ("get to green agent", "get away from red agent")
    return [
        event(track(5, red=0.1, pink=0.2), "one"),
        event(track(3, green=-0.5), "two", chase, (600.0, None)),
    ]


def made(events: list[Event], tmp_path: Path) -> GeneratedEvents:
    """Return them as a generated set: the second is a copy of the first."""
    told: list[dict[str, Any]] = [
        {"group": "one", "family": "collab", "layout": 10, "reflection": "none"},
        {"group": "one", "family": "chasing", "layout": 8, "reflection": "up-down"},
    ]
    return GeneratedEvents(make_set(tmp_path, events, ["train", "mine"], told))


def test_kinds_goals_strengths_sizes_durations_and_speeds(events: list[Event]) -> None:
    found = statistics(events)
    numbers = {"events": 2, "units": 2, "without_truth": 0, "without_strength": 1}
    assert found.attrs == numbers
    counts = {name: found.loc[name, "count"].to_dict() for name in found.index.levels[0]}
    assert counts["relation"] == {"friendly": 1, "neutral": 0, "adversarial": 1}
    assert found.loc[("relation", "friendly"), ["value", "phase"]].tolist() == [0.5, 0.4]
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
        ("frames", "min"): 3, ("frames", "median"): 4, ("frames", "max"): 5,
        ("speed_150", "mean"): 1.2, ("speed_600", "mean"): 0, ("speed", "max"): 6.0,
        ("speed", "mean"): (4 * 1.2 + 2 * 6) / 12, ("agent_rests", "mean"): 6 / 12,
        ("step", "max"): 0.5, ("item_moves", "mean"): 4 / 12, ("moves_to_the_end", "mean"): 1,
    }  # fmt: skip
    assert {name: found.loc[name, "value"] for name in expected} == pytest.approx(expected)
    assert found.loc["frames", "count"].isna().all()
    assert found.loc["frames", "error"].isna().tolist() == [True, False, True]


def test_generated_sets_tell_of_copies_families_splits(events: list[Event], tmp_path: Path) -> None:
    found = statistics(made(events, tmp_path))
    assert (found.attrs["events"], found.attrs["units"]) == (2, 1)
    assert found.loc[("speed", "mean"), "error"] != found.loc[("speed", "mean"), "error"]  # NaN
    assert found.loc["family", "count"].to_dict() == {"chasing": 1, "collab": 1}
    assert list(found.loc["layout"].index) == ["8", "10"]
    assert list(found.loc["split"].index) == ["train", "validation", "test", "mine"]
    assert found.loc[("split", "mine"), ["value", "phase"]].tolist() == [0.5, 0.0]


def test_the_standard_error_of_a_mean_is_the_textbooks() -> None:
    numbers = np.random.default_rng(1).normal(size=400)
    found = standard_error([np.array([number]) for number in numbers], np.mean)
    assert found == pytest.approx(numbers.std(ddof=1) / 20, rel=0.15)


@pytest.mark.usefixtures("unpainted")
def test_the_card_draws_shares_beside_the_originals(events: list[Event], tmp_path: Path) -> None:
    found = statistics(made(events, tmp_path))
    figure = ppl.plot.data_card(found, tmp_path / "card.png")
    assert (tmp_path / "card.png").exists()
    assert len(figure.axes) == 5
    assert texts_apart(figure) > 40
    bars = [bar.get_width() for bar in figure.axes[0].patches]  # type: ignore[attr-defined]
    shown = found.loc[["relation", "scenario"]]
    assert bars == pytest.approx([*shown["value"], *shown["phase"]])
    without_truth = [dataclasses.replace(event, truth=None) for event in events]
    assert len(ppl.plot.data_card(statistics(without_truth)).axes) == 2


def test_an_item_that_stays_at_a_grab_point_is_held() -> None:
    radius = np.array([0.8, 1.2, 1.01, 1.6])
    held = track(12, red=0.3)
    held[:, 0, 2] = np.linspace(0, 2, 12)
    for frame in range(4, 9):
        place = (0.8 + 1.01) * rotation(held[frame, 0, 2]) @ np.array([0, 1])
        held[frame, 2, :2] = held[frame, 0, :2] + place
    found = seems_to_hold(held, radius)
    assert found[:, 0].tolist() == [4 <= frame < 9 for frame in range(12)]
    assert not found[:, 1].any()
    held[6, 2, :2] += 0.3  # a blurred frame
    assert seems_to_hold(held, radius)[4:9, 0].all()
    held[[4, 5], 2, :2] = START[2, :2]  # too short to count
    assert not seems_to_hold(held[:8], radius)[:, 0].any()


@needs_dev
def test_half_of_the_test_videos_is_like_the_whole() -> None:
    found = statistics(ppl.load_events(DEV))
    value, whole = found["value"], found["phase"]
    for level in (150, 300, 450, 600):
        for what in ("mean", "p99"):
            name = (f"speed_{level}", what)
            assert value[name] == pytest.approx(whole[name], rel=0.15)
    for of in ("moves_to_the_end", "item_moves", "agent_holds"):
        assert value[of, "mean"] == pytest.approx(whole[of, "mean"], abs=0.04)
    assert 0.19 < value["agent_rests", "mean"] < 0.31
    assert value["frames", "median"] == pytest.approx(whole["frames", "median"], abs=5)


def test_a_set_of_another_world_is_described_by_its_own_names() -> None:
    trio = ppl.worlds.TRIO
    goals = {"red agent": "Get blue ball to home", "green agent": "get to pink ball"}
    event = ppl.simulate(
        trio.random_scene(0),
        goals=goals,
        relation={("purple agent", "red agent"): "hinder"},
        frames=4,
        planner=ppl.PlannerConfig(simulations=2, particles=4),
    )
    found = statistics([event])
    counts = {name: found.loc[name, "count"].to_dict() for name in found.index.levels[0]}
    assert counts["relation"] == {"friendly": 0, "neutral": 2, "adversarial": 1}
    assert counts["scenario"]["opposing"] == 1
    assert {goal for goal, n in counts["goal"].items() if n} == {
        *goals.values(), "Get blue ball away from home"
    }  # fmt: skip
    assert (counts["goal_type"]["LMO+"], counts["goal_type"]["LMO-"]) == (1, 1)
    assert sum(counts["agent_size"].values()) == 3
    with pytest.raises(InvalidEventError, match="several worlds"):
        statistics([event, ppl.load_event("compete")])
