"""The eight families draw what their names promise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cloudpickle
import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.dataset.generation import families
from phase_ppl.dataset.generation.families import (
    MOST_CHANGES,
    Family,
    available_families,
    changed,
    family_of,
    register_family,
)
from phase_ppl.dataset.generation.making import (
    AFTER_MOTION,
    MAX_STUCK,
    REFLECTIONS,
    SHORTEST,
    Recording,
    after_motion,
    measures,
    reason_against,
    recoloured,
    reflected,
)
from phase_ppl.dataset.generation.plan import Plan
from phase_ppl.dataset.generation.situation import (
    LAYOUTS,
    LAYOUTS_OF_A_KIND,
    SIZES,
    CannotDraw,
    Draw,
    Situation,
    overlaps,
    walls_of,
)
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.geometry import heading
from phase_ppl.world.goals import GOALS, goal_literal
from phase_ppl.world.hypothesis import STRENGTH_LEVELS, Hypothesis
from phase_ppl.world.names import BLUE_ITEM, Predicate
from phase_ppl.world.rooms import Rooms
from phase_ppl.world.scene import Scene

RED_TO_BLUE = "Get red agent to blue lm"
GREEN_TO_RED = "Get green agent to red lm"

START = np.array([[8.0, 10.0, 0.5], [24.0, 14.0, -0.7], [14.0, 20.0, 0.0], [18.0, 4.0, 0.0]])


def recording(
    trajectory: NDArray[np.float64] | None = None,
    red: str = RED_TO_BLUE,
    green: str = GREEN_TO_RED,
    alpha: tuple[int, int] = (0, 0),
    layout: int = 8,
) -> Recording:
    """Return a recording; by default red walks straight up to the blue landmark."""
    if trajectory is None:
        trajectory = np.repeat(START[None], 21, axis=0)
        trajectory[:, 0, 1] += np.linspace(0, 10, 21)
    frames = len(trajectory)
    scene = Scene(trajectory[0], np.array([0.8, 1.2, 0.8, 1.01]), walls_of(layout), "ccw")
    return Recording(
        scene,
        Hypothesis(red, green, alpha, 150.0, 450.0),  # type: ignore[arg-type]
        layout,
        trajectory,
        np.ones((frames, 2), bool),
        np.zeros((frames, 2), bool),
    )


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
    family = family_of(cell)
    rng = np.random.default_rng(3)
    return [family.draw(rng) for _ in range(n)]


def rooms_of(situation: Situation) -> list[int]:
    rooms: Rooms = situation.scene.rooms
    return [int(room) for room in rooms.room_of(situation.scene.start[:, :2])]


def test_the_families_are_those_of_the_original_and_every_cell_names_one() -> None:
    assert {cell.partition(":")[0] for cell in CELLS} == set(available_families())


@pytest.mark.parametrize("cell", CELLS)
def test_situations_show_the_scenario_of_their_family_and_nothing_overlaps(cell: str) -> None:
    family = family_of(cell)
    for situation in situations(cell):
        wanted, scene, rooms = situation.hypothesis, situation.scene, rooms_of(situation)
        assert (wanted.scenario, wanted.relation) == (family.scenario, family.relation)
        assert situation.layout in family.layouts
        assert not overlaps(scene.start, scene.radius, scene.walls)
        for agent, goal in enumerate(wanted.effective_goals):
            literal = goal_literal(goal, agent)
            if literal.predicate is Predicate.ON and literal.positive:
                assert rooms[literal.subject] != literal.target, "it is there already"


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
    family = family_of("compete")
    third = family.draw(np.random.default_rng(4))
    assert not np.array_equal(third.scene.start, one[0].scene.start)


def _helpee_is_too_large_for_the_only_way_to_its_item(one: Situation) -> None:
    _, green, item, _ = rooms_of(one)
    assert one.hypothesis.alpha == (1, 0)
    assert one.scene.radius[1] > SIZES[0] == one.scene.radius[0]
    assert one.scene.rooms.narrowest(green, item) == 2.5


def _item_stands_before_the_door(one: Situation) -> None:
    doors = one.scene.rooms.door_position[one.scene.rooms.door_width == 2.5]
    assert np.linalg.norm(doors - one.scene.start[BLUE_ITEM, :2], axis=1).min() < 3
    assert one.scene.radius[BLUE_ITEM] == SIZES[2]


def _weak_agent_is_with_its_item_and_a_strong_one_elsewhere(one: Situation) -> None:
    red, green, item, _ = rooms_of(one)
    assert green == item != red
    assert one.hypothesis.strength_green == 150 < one.hypothesis.strength_red


def _large_agents_start_only_where_their_ways_are_free(one: Situation) -> None:
    *agents, item, _ = rooms_of(one)
    for radius, room in zip(one.scene.radius, agents, strict=False):
        assert radius == SIZES[0] or one.scene.rooms.narrowest(room, item) > 2.5


@pytest.mark.parametrize(
    ("cell", "check"),
    [
        ("help_blocked", _helpee_is_too_large_for_the_only_way_to_its_item),
        ("help_move", _item_stands_before_the_door),
        ("help_lift", _weak_agent_is_with_its_item_and_a_strong_one_elsewhere),
        ("collab", _large_agents_start_only_where_their_ways_are_free),
    ],
)
def test_families_promise_more(cell: str, check: Callable[[Situation], None]) -> None:
    for situation in situations(cell, 80):
        check(situation)


@pytest.mark.parametrize(
    ("cell", "there"),
    [("hinder", "hinder:LMA"), ("independent:LMO", "independent:LMO"), ("collab:LMO", "collab")],
)
def test_unknown_variants_are_refused_with_what_there_is(cell: str, there: str) -> None:
    with pytest.raises(UnknownNameError, match=there):
        family_of(cell)


def test_numbers_of_a_family_are_checked_whatever_world_it_is_of() -> None:
    with pytest.raises(InvalidSettingError, match="agents='x'"):
        register_family("few", scenario="independent", agents="x")  # type: ignore[arg-type]


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Registers a family in which both go somewhere, from the same room; it is then forgotten."""
    available_families()
    monkeypatch.setattr(families.FAMILIES, "entries", dict(families.FAMILIES.entries))

    def register(name: str, green: str, **options: Any) -> Family:
        @register_family(name, layouts=[0], **options)
        def drawn(draw: Draw) -> Situation:
            """Both go to a place."""
            if not green:
                raise CannotDraw
            goals: Any = "Get red agent to blue lm", green
            return draw.situation(goals, (0, 0), (2, 2, 1, 3), (0.8,) * 4, (300.0, 300.0))

        return family_of(name)

    return register


def test_a_family_of_ones_own(own: Callable[..., Family]) -> None:
    family = own("side_by_side", "Get red agent to blue lm", scenario="collaborative")
    assert family_of("side_by_side").variant is None
    assert family.summary == "Both go to a place."
    assert family.draw(np.random.default_rng(0)).hypothesis.scenario == "collaborative"


def test_a_family_of_ones_own_goes_to_workers_with_its_plan(own: Callable[..., Family]) -> None:
    own("side_by_side", "Get red agent to blue lm", scenario="collaborative")
    sent = cloudpickle.dumps(Plan(cells={"side_by_side": 1}))
    del families.FAMILIES.entries["side_by_side"]
    family = cloudpickle.loads(sent).families["side_by_side"]
    assert family.draw(np.random.default_rng(0)).hypothesis.scenario == "collaborative"


def test_a_family_that_breaks_its_promise_is_refused(own: Callable[..., Family]) -> None:
    for name, green, said in (
        ("wrong", "Get green agent to red lm", "independent, not opposing"),
        ("never", "", "no situation"),
    ):
        with pytest.raises(InvalidSettingError, match=said):
            own(name, green, scenario="opposing").draw(np.random.default_rng(0))
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


def test_opponents_must_meet() -> None:
    chase = {"red": "get to green agent", "green": "get away from red agent"}
    apart = recording(**chase)
    assert measures(apart)["at_start"] == [False, True]
    assert verdict(apart, "opposing") == "the agents never come near each other"
    made = recording(walk(0, (22.0, 14.0)), **chase, layout=0)
    assert measures(made)["closest"] == pytest.approx(1.0)
    assert verdict(made, "opposing") is None


def test_partners_and_rivals_must_both_touch_the_item_that_they_want() -> None:
    made = recording(walk(0, (14.0, 18.4)), red="Get blue item to yellow lm",
                     green="Get blue item to red lm", layout=0)  # fmt: skip
    assert measures(made)["touched"] == [["blue item"], []]
    made.trajectory[10:, 1, :2] = 20.0, 4.0
    assert measures(made)["touched"] == [["blue item"], ["pink item"]]
    assert verdict(made, "competing") == "not both touch the item"
    assert verdict(made, "collaborative") == "not both touch the item"
    made.trajectory[10:, 1, :2] = 16.0, 20.0
    assert verdict(made, "competing") is None
    assert verdict(made, "collaborative") == "a goal is not reached"


def test_an_agent_that_pushes_a_wall_for_long_is_stuck() -> None:
    frames, green = MAX_STUCK + 2, "Get green agent to green lm"
    made = recording(walk(0, (8.5, 19.0), frames), green=green)
    made.trajectory[:, 1, 1] += 5 * (np.arange(frames) > 0)
    assert measures(made)["stuck"] == [0, MAX_STUCK]
    assert verdict(made, "independent") is None
    made.trajectory[1, 1, 1] = START[1, 1]
    made.trajectory[2, 1, 1] = START[1, 1] + 5
    longer = np.concatenate([made.trajectory, made.trajectory[-1:].repeat(2, 0)])
    assert verdict(recording(longer, green=green), "independent") == "an agent is stuck"


def test_recordings_end_soon_after_the_last_motion() -> None:
    assert after_motion(walk(0, (8.5, 19.0), 40)) == 40
    still = np.concatenate([walk(0, (8.5, 19.0), 40), walk(0, (8.5, 19.0))[-1:].repeat(60, 0)])
    assert after_motion(still) == 40 + AFTER_MOTION
    assert after_motion(np.repeat(START[None], 101, axis=0)) == SHORTEST


# --- copies look different and mean the same ------------------------------------------------------


def goals(made: Recording) -> tuple[str, str]:
    red, green = made.hypothesis.effective_goals
    return GOALS[red], GOALS[green]


def assert_same(one: Recording, other: Recording) -> None:
    assert one.hypothesis == other.hypothesis
    assert one.scene.turning == other.scene.turning
    for name in ("trajectory", "pushes", "holds"):
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
    mirrored, matrix = reflected(made, name), REFLECTIONS[name].matrix
    for angle, other in zip(made.scene.start[:2, 2], mirrored.scene.start[:2, 2], strict=True):
        np.testing.assert_allclose(heading(other), matrix @ heading(angle), atol=1e-12)
    before, after = measures(made), measures(mirrored)
    assert before["at_end"] == [True, False]
    for key in ("closest", "moved"):
        assert after.pop(key) == pytest.approx(before.pop(key))
    assert after == before


def test_turns_go_the_other_way_in_a_mirror() -> None:
    assert reflected(recording(), "up-down").scene.turning == "cw"


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


def test_who_pushes_and_who_holds_change_with_the_colours_of_agents() -> None:
    made = recording()
    made.pushes[4] = made.holds[4] = [True, False]
    for agents, expected in ((False, [True, False]), (True, [False, True])):
        other = recoloured(made, agents=agents, items=True)
        assert other.pushes[4].tolist() == other.holds[4].tolist() == expected


# --- the same situation elsewhere -----------------------------------------------------------------

SIZE_ID = {size: number for number, size in enumerate(SIZES)}
STRENGTH_ID = {force: number for number, force in enumerate(STRENGTH_LEVELS)}


def changes(cell: str, situation: Situation) -> dict[str, Situation]:
    found = changed(family_of(cell), situation)
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
    family = family_of("chasing")
    assert changed(family, Situation(first.scene, first.hypothesis, 8)) == []
