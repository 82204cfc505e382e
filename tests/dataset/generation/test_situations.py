"""The eight families draw what their names promise."""

from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.dataset.generation import families
from phase_ppl.dataset.generation.copies import AFTER_MOTION, SHORTEST, Recording, after_motion
from phase_ppl.dataset.generation.families import (
    available_families,
    family_and_variant,
    register_family,
)
from phase_ppl.dataset.generation.making import MAX_STUCK, measures, reason_against
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
from tests.dataset.generation.recordings import START, recording

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


# --- what a recording shows -----------------------------------------------------------------------


def verdict(made: Recording, scenario: str) -> str | None:
    return reason_against(scenario, made.hypothesis, measures(made))


def walk(entity: int, target: tuple[float, float], frames: int = 21) -> np.ndarray:
    trajectory = np.repeat(START[None], frames, axis=0)
    share = np.linspace(0, 1, frames)[:, None]
    trajectory[:, entity, :2] = (1 - share) * START[entity, :2] + share * np.array(target)
    return trajectory


def test_measures_of_a_walk() -> None:
    found = measures(recording())
    assert found["frames"] == 21
    assert found["at_start"] == [False, False]
    assert found["ever"] == found["at_end"] == [True, False]
    assert found["moved"] == pytest.approx([10, 0, 0, 0])
    assert found["closest"] == pytest.approx(np.hypot(16, 0) / 2.0)
    assert found["touched"] == [[], []]
    assert found["stuck"] == [0, 20]  # green pushes all the time and goes nowhere


def test_both_goals_must_be_true_in_the_end_where_each_minds_its_business() -> None:
    assert verdict(recording(), "independent") == "a goal is not reached"
    reached = recording(green="Get green agent to green lm")
    reached.trajectory[:, 1, 1] += np.linspace(0, 5, 21)
    assert verdict(reached, "independent") is None


def test_a_goal_that_was_true_from_the_start_shows_nothing() -> None:
    made = recording(walk(0, (8.5, 19.0)), green="Get blue item to blue lm")
    made.trajectory[:, 2, :2] = 9.0, 19.0
    assert verdict(made, "independent") == "a goal is true at the start"
    avoided = recording(green="get away from red agent", red="get to green agent")
    assert measures(avoided)["at_start"] == [False, True]
    assert verdict(avoided, "opposing") == "the agents never come near each other"


def test_opponents_must_meet() -> None:
    made = recording(walk(0, (22.0, 14.0)), red="get to green agent",
                     green="get away from red agent", layout=0)  # fmt: skip
    assert measures(made)["closest"] == pytest.approx(1.0)
    assert verdict(made, "opposing") is None


def test_rivals_must_both_touch_the_item() -> None:
    made = recording(walk(0, (14.0, 18.4)), red="Get blue item to yellow lm",
                     green="Get blue item to red lm", layout=0)  # fmt: skip
    assert measures(made)["touched"] == [["blue item"], []]
    assert verdict(made, "competing") == "not both touch the item"
    made.trajectory[10:, 1, :2] = 16.0, 20.0
    assert measures(made)["touched"] == [["blue item"], ["blue item"]]
    assert verdict(made, "competing") is None


def test_rivals_must_touch_the_item_that_they_want() -> None:
    track = walk(0, (16.4, 4.0))
    track[10:, 1, :2] = 20.0, 4.0
    made = recording(track, red="Get blue item to yellow lm", green="Get blue item to red lm",
                     layout=0)  # fmt: skip
    assert measures(made)["touched"] == [["pink item"], ["pink item"]]
    assert verdict(made, "competing") == "not both touch the item"


def test_partners_must_both_touch_the_item_that_they_want() -> None:
    both = "Get blue item to blue lm"
    track = walk(0, (14.0, 18.4))
    made = recording(np.concatenate([track, track[-1:]]), red=both, green=both, layout=0)
    assert verdict(made, "collaborative") == "not both touch the item"
    made.trajectory[10:, 1, :2] = 16.0, 20.0
    assert verdict(made, "collaborative") == "a goal is not reached"
    made.trajectory[-1, 2, :2] = 8.5, 19.5
    assert verdict(made, "collaborative") is None
    helped = recording(walk(1, (8.5, 19.0)), red="Get green agent to blue lm",
                       green="Get green agent to blue lm", layout=0)  # fmt: skip
    assert verdict(helped, "collaborative") is None


def test_an_agent_that_pushes_a_wall_for_long_is_stuck() -> None:
    frames = MAX_STUCK + 2
    made = recording(walk(0, (8.5, 19.0), frames), green="Get green agent to green lm")
    made.trajectory[:, 1, 1] += 5 * (np.arange(frames) > 0)
    assert measures(made)["stuck"] == [0, MAX_STUCK]
    assert verdict(made, "independent") is None
    made.trajectory[1, 1, 1] = START[1, 1]
    made.trajectory[2, 1, 1] = START[1, 1] + 5
    longer = recording(np.concatenate([made.trajectory, made.trajectory[-1:].repeat(2, 0)]),
                       green="Get green agent to green lm")  # fmt: skip
    assert verdict(longer, "independent") == "an agent is stuck"


def test_recordings_end_soon_after_the_last_motion() -> None:
    assert after_motion(walk(0, (8.5, 19.0), 40)) == 40
    still = np.concatenate([walk(0, (8.5, 19.0), 40), walk(0, (8.5, 19.0))[-1:].repeat(60, 0)])
    assert after_motion(still) == 40 + AFTER_MOTION
    assert after_motion(np.repeat(START[None], 101, axis=0)) == SHORTEST
