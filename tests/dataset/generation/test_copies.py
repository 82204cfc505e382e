"""Copies look different and mean the same."""

from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.dataset.generation.copies import REFLECTIONS, Recording, recoloured, reflected
from phase_ppl.dataset.generation.making import measures
from phase_ppl.world.geometry import heading
from phase_ppl.world.goals import GOALS
from tests.dataset.generation.recordings import recording


def goals(made: Recording) -> tuple[str, str]:
    red, green = made.hypothesis.effective_goals
    return GOALS[red], GOALS[green]


def assert_same(one: Recording, other: Recording) -> None:
    assert one.hypothesis == other.hypothesis
    assert one.scene.turning == other.scene.turning
    for name in ("trajectory", "actions", "held"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-12)
    for name in ("start", "radius", "walls"):
        np.testing.assert_allclose(getattr(one.scene, name), getattr(other.scene, name), atol=1e-12)


@pytest.mark.parametrize("name", REFLECTIONS)
def test_a_reflection_of_a_reflection_is_the_original(name: str) -> None:
    made = recording(red="Get blue item to yellow lm", green="get away from red agent")
    assert_same(reflected(reflected(made, name), name), made)


@pytest.mark.parametrize("name", REFLECTIONS)
def test_what_can_be_seen_is_the_same_in_a_mirror(name: str) -> None:
    made = recording()
    before, after = measures(made), measures(reflected(made, name))
    assert before["at_end"] == [True, False]
    for key in ("closest", "moved"):
        assert after.pop(key) == pytest.approx(before.pop(key))
    assert after == before


@pytest.mark.parametrize(
    ("name", "goal"),
    [
        ("up-down", "Get red agent to yellow lm"),
        ("left-right", "Get red agent to green lm"),
        ("about y=x", "Get red agent to red lm"),
        ("about y=-x", "Get red agent to blue lm"),
    ],
)
def test_goals_follow_the_reflection(name: str, goal: str) -> None:
    assert goals(reflected(recording(), name))[0] == goal


@pytest.mark.parametrize("name", REFLECTIONS)
def test_agents_still_look_where_they_looked(name: str) -> None:
    made = recording()
    matrix = REFLECTIONS[name].matrix
    for before, after in zip(
        made.trajectory[3, :2], reflected(made, name).trajectory[3, :2], strict=True
    ):
        np.testing.assert_allclose(heading(after[2]), matrix @ heading(before[2]), atol=1e-12)


def test_reflections_are_those_of_the_original_files() -> None:
    point = recording().scene.start[0, :2]
    x, y = point
    expected = {
        "up-down": (x, 24 - y),
        "left-right": (32 - x, y),
        "about y=x": (y + 4, x - 4),
        "about y=-x": (28 - y, 28 - x),
    }
    for name, place in expected.items():
        np.testing.assert_allclose(reflected(recording(), name).scene.start[0, :2], place)


def test_turns_go_the_other_way_in_a_mirror() -> None:
    made = recording(actions=np.array([[0, 1]] * 21))
    mirrored = reflected(made, "up-down")
    assert mirrored.scene.turning == "cw"
    assert mirrored.actions[5].tolist() == [1, 0]


def test_colours_change_with_all_that_is_said_about_them() -> None:
    made = recording(red="Get blue item to yellow lm", green="Get red agent to red lm")
    other = recoloured(made, agents=True, items=True)
    assert goals(other) == ("Get green agent to red lm", "Get pink item to yellow lm")
    assert other.hypothesis.strengths == (450.0, 150.0)
    assert other.scene.radius.tolist() == [1.2, 0.8, 1.01, 0.8]
    np.testing.assert_array_equal(other.trajectory[:, 1], made.trajectory[:, 0])
    assert_same(recoloured(other, agents=True, items=True), made)


def test_who_helps_whom_and_who_chases_whom_change_with_the_colours() -> None:
    made = recording(red="get to green agent", green="get to red agent", alpha=(0, -1))
    assert goals(made) == ("get to green agent", "get away from red agent")
    other = recoloured(made, agents=True, items=False)
    assert goals(other) == ("get away from green agent", "get to red agent")
    assert other.hypothesis.alpha == (-1, 0)
    assert other.hypothesis.scenario == made.hypothesis.scenario == "opposing"


def test_held_items_keep_their_colour() -> None:
    made = recording()
    made.held[4] = [2, -1]
    assert recoloured(made, agents=False, items=True).held[4].tolist() == [3, -1]
    assert recoloured(made, agents=True, items=False).held[4].tolist() == [-1, 2]
