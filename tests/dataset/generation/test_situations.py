"""The eight families draw what their names promise."""

from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.dataset.generation import families
from phase_ppl.dataset.generation.families import (
    available_families,
    family_and_variant,
    register_family,
)
from phase_ppl.dataset.generation.situation import (
    LAYOUTS,
    SIZES,
    CannotDraw,
    Draw,
    Situation,
    overlaps,
)
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.names import BLUE_ITEM, Predicate
from phase_ppl.world.rooms import Rooms

CELLS = [
    "chasing", "collab", "compete", "help_blocked", "help_lift", "help_move", "hinder:LMA",
    "hinder:LMO", "independent:LMA+LMA", "independent:LMO+LMA", "independent:LMO+LMO",
]  # fmt: skip

ALL = frozenset({(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)})
FREE = {
    **dict.fromkeys((4, 8, 10, 17), frozenset({(1, 2), (1, 3), (2, 3)})),
    **dict.fromkeys((12, 13, 18), frozenset({(0, 3), (1, 2)})),
    **dict.fromkeys((14, 15, 19, 20), frozenset({(1, 2)})),
    21: frozenset(),
    **dict.fromkeys((0, 2, 6, 7, 9, 16), ALL),
}
"""Layout -> pairs of rooms that bodies of any size can pass between, as the original lists say."""


def situations(cell: str, n: int = 40) -> list[Situation]:
    family, variant = family_and_variant(cell)
    rng = np.random.default_rng(3)
    return [family.draw(rng, variant) for _ in range(n)]


def rooms_of(situation: Situation) -> list[int]:
    rooms: Rooms = situation.scene.rooms
    return [int(room) for room in rooms.room_of(situation.scene.start[:, :2])]


def test_the_families_are_those_of_the_original_and_every_cell_names_one() -> None:
    assert {cell.partition(":")[0] for cell in CELLS} == set(available_families())


@pytest.mark.parametrize("cell", CELLS)
def test_situations_show_the_scenario_of_their_family_and_nothing_overlaps(cell: str) -> None:
    family, _ = family_and_variant(cell)
    for situation in situations(cell):
        assert situation.hypothesis.scenario == family.scenario
        assert situation.hypothesis.relation == family.relation
        assert situation.layout in family.layouts
        scene = situation.scene
        assert not overlaps(scene.start, scene.radius, scene.walls)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_free_ways_are_those_of_the_original_lists(layout: int) -> None:
    draw = Draw(np.random.default_rng(0), layout)
    free = {(a, b) for a in range(4) for b in range(a + 1, 4) if draw.is_free(a, b)}
    assert free == FREE[layout]
    assert not draw.is_free(2, 2)


def test_situations_depend_on_the_seed_alone() -> None:
    one, other = (situations("compete", 3) for _ in range(2))
    for first, second in zip(one, other, strict=True):
        assert first.hypothesis == second.hypothesis
        assert np.array_equal(first.scene.start, second.scene.start)
    family, _ = family_and_variant("compete")
    third = family.draw(np.random.default_rng(4))
    assert not np.array_equal(third.scene.start, one[0].scene.start)


def test_a_helpee_is_too_large_for_the_only_way_to_its_item() -> None:
    for situation in situations("help_blocked"):
        _, green, item, _ = rooms_of(situation)
        assert situation.hypothesis.alpha == (1, 0)
        assert situation.scene.radius[1] > SIZES[0] == situation.scene.radius[0]
        assert situation.scene.rooms.narrowest(green, item) == 2.5


def test_an_item_that_is_to_be_moved_stands_before_the_door() -> None:
    for situation in situations("help_move"):
        scene = situation.scene
        doors = scene.rooms.door_position[scene.rooms.door_width == 2.5]
        assert np.linalg.norm(doors - scene.start[BLUE_ITEM, :2], axis=1).min() < 3
        assert scene.radius[BLUE_ITEM] == SIZES[2]


def test_a_weak_agent_is_with_its_item_and_a_strong_one_elsewhere() -> None:
    for situation in situations("help_lift"):
        red, green, item, _ = rooms_of(situation)
        assert green == item != red
        assert situation.hypothesis.strength_green == 150 < situation.hypothesis.strength_red


@pytest.mark.parametrize("cell", ["collab", "compete", "hinder:LMO", "independent:LMO+LMO"])
def test_items_do_not_start_where_they_are_wanted(cell: str) -> None:
    for situation in situations(cell):
        rooms = rooms_of(situation)
        for agent, goal in enumerate(situation.hypothesis.effective_goals):
            literal = goal_literal(goal, agent)
            if literal.predicate is Predicate.ON and literal.positive:
                assert rooms[literal.subject] != literal.target


def test_large_bodies_start_only_where_their_ways_are_free() -> None:
    for situation in situations("collab", 80):
        red, green, item, _ = rooms_of(situation)
        radius, rooms = situation.scene.radius, situation.scene.rooms
        for agent, room in ((0, red), (1, green)):
            if radius[agent] > SIZES[0]:
                assert rooms.narrowest(room, item) > 2.5


def test_unknown_families_and_variants_are_refused_with_what_there_is() -> None:
    with pytest.raises(UnknownNameError, match="hinder:LMA"):
        family_and_variant("hinder")
    with pytest.raises(UnknownNameError, match="independent:LMO"):
        family_and_variant("independent:LMO")
    with pytest.raises(UnknownNameError, match="collab"):
        family_and_variant("collab:LMO")


def test_a_family_of_ones_own(monkeypatch: pytest.MonkeyPatch) -> None:
    available_families()
    monkeypatch.setattr(families.FAMILIES, "entries", dict(families.FAMILIES.entries))

    @register_family("side_by_side", scenario="collaborative", layouts=[0])
    def side_by_side(draw: Draw) -> Situation:
        """Both go to the same place."""
        goal = "Get red agent to blue lm"
        return draw.situation((goal, goal), (0, 0), (2, 2, 1, 3), (0.8,) * 4, (300.0, 300.0))  # type: ignore[arg-type]

    family, variant = family_and_variant("side_by_side")
    assert variant is None
    assert family.summary == "Both go to the same place."
    assert family.draw(np.random.default_rng(0)).hypothesis.scenario == "collaborative"


def test_a_family_that_breaks_its_promise_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    available_families()
    monkeypatch.setattr(families.FAMILIES, "entries", dict(families.FAMILIES.entries))

    @register_family("wrong", scenario="opposing", layouts=[0])
    def wrong(draw: Draw) -> Situation:
        goals = "Get red agent to blue lm", "Get green agent to red lm"
        return draw.situation(goals, (0, 0), (2, 2, 1, 3), (0.8,) * 4, (300.0, 300.0))  # type: ignore[arg-type]

    @register_family("never", scenario="opposing", layouts=[0])
    def never(draw: Draw) -> Situation:
        raise CannotDraw

    with pytest.raises(InvalidSettingError, match="independent, not opposing"):
        family_and_variant("wrong")[0].draw(np.random.default_rng(0))
    with pytest.raises(InvalidSettingError, match="no situation"):
        family_and_variant("never")[0].draw(np.random.default_rng(0))
    with pytest.raises(UnknownNameError, match="layout"):
        register_family("other", scenario="opposing", layouts=[3])
    with pytest.raises(UnknownNameError, match="scenario"):
        register_family("other", scenario="friendly")
