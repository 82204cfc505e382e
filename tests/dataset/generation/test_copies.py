"""Copies look different and mean the same."""

from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.dataset.generation import families
from phase_ppl.dataset.generation.copies import REFLECTIONS, Recording, recoloured, reflected
from phase_ppl.dataset.generation.families import (
    MOST_CHANGES,
    Change,
    changed,
    family_and_variant,
    register_family,
)
from phase_ppl.dataset.generation.making import measures
from phase_ppl.dataset.generation.situation import (
    LAYOUTS_OF_A_KIND,
    SIZES,
    Draw,
    Situation,
    overlaps,
    walls_of,
)
from phase_ppl.world.geometry import heading
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from tests.dataset.generation.recordings import recording
from tests.dataset.generation.test_situations import CELLS, FREE, rooms_of, situations


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


# --- the same situation elsewhere -----------------------------------------------------------------

SIZE_ID = {size: number for number, size in enumerate(SIZES)}
STRENGTH_ID = {force: number for number, force in enumerate(STRENGTH_LEVELS)}


def changes(cell: str, situation: Situation) -> dict[str, Situation]:
    family, variant = family_and_variant(cell)
    found = changed(family, variant, situation)
    assert len(found) <= MOST_CHANGES
    return {change.name: other for change, other in found}


def ids(situation: Situation) -> list[int]:
    sizes = [SIZE_ID[size] for size in situation.scene.radius.tolist()]
    return sizes + [STRENGTH_ID[force] for force in situation.hypothesis.strengths]


@pytest.mark.parametrize("cell", CELLS)
def test_a_changed_situation_differs_in_one_thing(cell: str) -> None:
    for first in situations(cell):
        for name, other in changes(cell, first).items():
            assert np.array_equal(other.scene.start, first.scene.start)
            assert other.hypothesis.effective_goals == first.hypothesis.effective_goals
            assert other.hypothesis.alpha == first.hypothesis.alpha
            assert other.scene.turning == first.scene.turning
            assert np.array_equal(other.scene.walls, walls_of(other.layout))
            assert not overlaps(other.scene.start, other.scene.radius, other.scene.walls)
            if name.startswith("layout"):
                assert ids(other) == ids(first)
                assert name == f"layout-{other.layout}"
                (kind,) = (kind for kind in LAYOUTS_OF_A_KIND if first.layout in kind)
                assert other.layout in set(kind) - {first.layout}
            else:
                step = {"ids-up": 1, "ids-down": -1}[name]
                assert ids(other) == [number + step for number in ids(first)]
                assert other.layout == first.layout


@pytest.mark.parametrize("cell", CELLS)
def test_there_is_a_changed_situation_in_every_layout_of_the_kind(cell: str) -> None:
    seen = 0
    for first in situations(cell):
        kind = next((kind for kind in LAYOUTS_OF_A_KIND if first.layout in kind), ())
        found = {other.layout for name, other in changes(cell, first).items() if "layout" in name}
        assert found == set(kind) - {first.layout}
        seen += bool(found)
    assert seen > 3


def test_ids_are_moved_only_where_the_rules_of_the_family_hold() -> None:
    # all of them fix a size, or the strength of an agent
    for cell in ("help_blocked", "help_lift", "help_move"):
        for first in situations(cell):
            assert not any("ids" in name for name in changes(cell, first))
    moved = 0
    for first in situations("collab", 150):
        for name, other in changes("collab", first).items():
            if "ids" not in name:
                continue
            moved += 1
            red, green, item, _ = rooms_of(other)
            assert other.hypothesis.strength_red == other.hypothesis.strength_green
            for agent, room in ((0, red), (1, green)):
                if other.scene.radius[agent] > SIZES[0]:
                    assert tuple(sorted((room, item))) in FREE[other.layout]
    assert moved > 5


def test_places_have_to_be_in_the_rooms_of_the_family(monkeypatch: pytest.MonkeyPatch) -> None:
    available = families.available_families()
    monkeypatch.setattr(families.FAMILIES, "entries", dict(families.FAMILIES.entries))
    assert "elsewhere" not in available
    goal = "Get red agent to blue lm"

    @register_family("elsewhere", scenario="collaborative", layouts=[4, 8])
    def elsewhere(draw: Draw) -> Situation:
        red = 2 if draw.layout == 4 else 1
        return draw.situation((goal, goal), (0, 0), (red, 2, 3, 3), (0.8,) * 4, (300.0, 300.0))  # type: ignore[arg-type]

    @register_family("by_itself", scenario="collaborative", layouts=[4, 8])
    def by_itself(draw: Draw) -> Situation:
        size = float(draw.rng.uniform(0.5, 1.0))
        return draw.situation((goal, goal), (0, 0), (1, 2, 3, 3), (size,) * 4, (300.0, 300.0))  # type: ignore[arg-type]

    assert all(not changes("elsewhere", first) for first in situations("elsewhere"))
    assert all(not changes("by_itself", first) for first in situations("by_itself"))


def test_a_situation_that_no_draw_made_has_no_changes() -> None:
    first = situations("chasing", 1)[0]
    family, _ = family_and_variant("chasing")
    assert changed(family, None, Situation(first.scene, first.hypothesis, 8)) == []


def test_changes_are_named() -> None:
    assert [Change(17).name, Change(4, 1).name, Change(4, -1).name] == [
        "layout-17", "ids-up", "ids-down",
    ]  # fmt: skip
