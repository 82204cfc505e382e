"""The eight families draw what their names promise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cloudpickle
import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.data.generation import families
from phase_ppl.data.generation.families import (
    Drawn,
    Family,
    available_families,
    family_of,
    register_family,
)
from phase_ppl.data.generation.making import (
    AFTER_MOTION,
    REFLECTIONS,
    SHORTEST,
    Plan,
    Recording,
    after_motion,
    measures,
    reason_against,
    recoloured,
    reflected,
)
from phase_ppl.data.generation.situation import LAYOUTS, SIZES, Draw, Situation, overlaps, walls_of
from phase_ppl.world.errors import InvalidSettingError, PhasePPLError, UnknownNameError
from phase_ppl.world.geometry import heading
from phase_ppl.world.goals import GOALS, goal_literal
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import BLUE_ITEM, PredicateKind
from phase_ppl.world.rooms import Rooms
from phase_ppl.world.scene import PHASE, Scene

START = np.array([[8.0, 10.0, 0.5], [24.0, 14.0, -0.7], [14.0, 20.0, 0.0], [18.0, 4.0, 0.0]])


def recording(
    trajectory: NDArray[np.float64] | None = None,
    red: str = "Get red agent to blue lm",
    green: str = "Get green agent to red lm",
    alpha: tuple[int, int] = (0, 0),
    layout: int = 8,
) -> Recording:
    """Return a recording; by default red walks straight up to the blue landmark."""
    if trajectory is None:
        trajectory = walk(0, (8.0, 20.0))
    scene = Scene(trajectory[0], np.array([0.8, 1.2, 0.8, 1.01]), walls_of(layout), "ccw")
    hypothesis = Hypothesis(red, green, alpha, 150.0, 450.0)  # type: ignore[arg-type]
    pushes = np.ones((len(trajectory), 2), bool)
    return Recording(scene, hypothesis, layout, trajectory, pushes)


def walk(entity: int, target: tuple[float, float], frames: int = 21) -> NDArray[np.float64]:
    trajectory = np.repeat(START[None], frames, axis=0)
    trajectory[:, entity, :2] = np.linspace(START[entity, :2], target, frames)
    return trajectory


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


def situations(cell: str, n: int = 25) -> list[Drawn]:
    family = family_of(cell)
    rng = np.random.default_rng(3)
    return [family.draw(PHASE, rng) for _ in range(n)]


def hypothesis(situation: Drawn) -> Hypothesis:
    return situation.roles


def rooms_of(situation: Drawn) -> list[int]:
    rooms: Rooms = situation.scene.rooms
    return [int(room) for room in rooms.room_of(situation.scene.start[:, :2])]


@pytest.mark.parametrize("cell", CELLS)
def test_situations_show_the_scenario_of_their_family_and_nothing_overlaps(cell: str) -> None:
    family = family_of(cell)
    for situation in situations(cell):
        wanted, scene, rooms = hypothesis(situation), situation.scene, rooms_of(situation)
        assert wanted.scenario == family.scenario
        assert situation.layout in family.layouts
        assert not overlaps(scene.start, scene.radius, scene.walls)
        for agent, goal in enumerate(wanted.effective_goals):
            literal = goal_literal(goal, agent)
            if literal.predicate is PredicateKind.ON and literal.positive:
                assert rooms[literal.subject] != literal.target, "it is there already"
    # they depend on the seed alone
    one, other = (situations(cell, 2)[1] for _ in range(2))
    assert one.roles == other.roles
    assert np.array_equal(one.scene.start, other.scene.start)


def test_free_ways_and_families_are_those_of_the_original_lists() -> None:
    assert {cell.partition(":")[0] for cell in CELLS} == set(available_families()) - {"help"}
    for layout in LAYOUTS:
        draw = Draw(PHASE, np.random.default_rng(0), layout)
        free = {(a, b) for a in range(4) for b in range(a + 1, 4) if draw.is_free(a, b)}
        assert free == FREE[layout]
        assert not draw.is_free(2, 2)


def test_families_promise_more() -> None:
    for one in situations("help_blocked", 60):
        _, green, item, _ = rooms_of(one)
        assert hypothesis(one).alpha == (1, 0)
        assert one.scene.radius[1] > SIZES[0] == one.scene.radius[0]
        assert one.scene.rooms.narrowest(green, item) == 2.5, "too narrow for green"
    for one in situations("help_move", 60):
        doors = one.scene.rooms.door_position[one.scene.rooms.door_width == 2.5]
        assert np.linalg.norm(doors - one.scene.start[BLUE_ITEM, :2], axis=1).min() < 3
        assert one.scene.radius[BLUE_ITEM] == SIZES[2]
    for one in situations("help_lift", 60):
        red, green, item, _ = rooms_of(one)
        assert green == item != red
        assert one.roles.strengths[1] == 150 < one.roles.strengths[0]
    for one in situations("collab", 60):
        *agents, item, _ = rooms_of(one)
        for radius, room in zip(one.scene.radius, agents, strict=False):
            assert radius == SIZES[0] or one.scene.rooms.narrowest(room, item) > 2.5


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
                draw.refuse()
            goals = "Get red agent to blue lm", green
            return draw.situation(goals, rooms=(2, 2, 1, 3), size=0.8, strength=300)

        return family_of(name)

    return register


def test_a_family_of_ones_own_goes_to_workers_with_its_plan(own: Callable[..., Family]) -> None:
    family = own("side_by_side", "Get red agent to blue lm", scenario="collaborative")
    assert (family.variant, family.summary) == (None, "Both go to a place.")
    sent = cloudpickle.dumps(Plan(cells={"side_by_side": 1}))
    del families.FAMILIES.entries["side_by_side of PHASE"]
    family = cloudpickle.loads(sent).families["side_by_side"]
    drawn = family.draw(PHASE, np.random.default_rng(0))
    assert hypothesis(drawn).scenario == "collaborative"


def test_what_is_no_family_is_refused(own: Callable[..., Family]) -> None:
    for name, green, said in (
        ("wrong", "Get green agent to red lm", "not opposing"),
        ("never", "", "no situation"),
    ):
        with pytest.raises(InvalidSettingError, match=said):
            own(name, green, scenario="opposing").draw(PHASE, np.random.default_rng(0))
    options: list[tuple[dict[str, Any], str]] = [
        ({"scenario": "opposing", "layouts": [3]}, "layout"),
        ({"scenario": "friendly"}, "scenario"),
        ({"scenario": "independent", "agents": "x"}, "agents='x'"),
    ]
    for given, said in options:
        with pytest.raises(PhasePPLError, match=said):
            register_family("other", **given)
    for cell, there in (("hinder", "hinder:LMA"), ("collab:LMO", "collab")):
        with pytest.raises(UnknownNameError, match=there):
            family_of(cell)


def verdict(made: Recording, scenario: str) -> str | None:
    return reason_against(scenario, made.hypothesis, measures(made))


def test_measures_of_a_walk_and_of_opponents_who_must_meet() -> None:
    found = measures(recording())
    assert found["at_start"] == [False, False]
    assert found["at_end"] == [True, False]
    assert found["closest"] == {"red & green": pytest.approx(np.hypot(16, 0) / 2.0)}
    assert found["touched"] == [[], []]
    assert found["stuck"] == [0, 20]  # green pushes all the time and goes nowhere
    chase = {"red": "get to green agent", "green": "get away from red agent"}
    apart = recording(**chase)
    assert measures(apart)["at_start"] == [False, True]
    assert verdict(apart, "opposing") == "the agents never come near each other"
    made = recording(walk(0, (22.0, 14.0)), **chase, layout=0)
    assert measures(made)["closest"]["red & green"] == pytest.approx(1.0)
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


def test_recordings_end_soon_after_the_last_motion() -> None:
    assert after_motion(walk(0, (8.5, 19.0), 40)) == 40
    still = np.concatenate([walk(0, (8.5, 19.0), 40), walk(0, (8.5, 19.0))[-1:].repeat(60, 0)])
    assert after_motion(still) == 40 + AFTER_MOTION
    assert after_motion(np.repeat(START[None], 101, axis=0)) == SHORTEST


def goals(made: Recording) -> tuple[str, str]:
    red, green = made.hypothesis.effective_goals
    return GOALS[red], GOALS[green]


def assert_same(one: Recording, other: Recording) -> None:
    assert one.hypothesis == other.hypothesis
    assert one.scene.turning == other.scene.turning
    for name in ("trajectory", "pushes"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-12)
    for name in ("start", "radius", "walls"):
        np.testing.assert_allclose(getattr(one.scene, name), getattr(other.scene, name), atol=1e-12)


@pytest.mark.parametrize("name", REFLECTIONS)
def test_what_can_be_seen_is_the_same_in_a_mirror(name: str) -> None:
    made = recording(red="Get blue item to yellow lm", green="get away from red agent")
    assert_same(reflected(reflected(made, name), name), made)
    made = recording()
    mirrored, matrix = reflected(made, name), REFLECTIONS[name].matrix
    assert mirrored.scene.turning == "cw"  # turns go the other way
    for angle, other in zip(made.scene.start[:2, 2], mirrored.scene.start[:2, 2], strict=True):
        np.testing.assert_allclose(heading(other), matrix @ heading(angle), atol=1e-12)
    before, after = measures(made), measures(mirrored)
    assert before["at_end"] == [True, False]
    assert after.pop("closest") == pytest.approx(before.pop("closest"))
    assert after == before


def test_colours_change_with_all_that_is_said_about_them() -> None:
    made = recording(red="Get blue item to yellow lm", green="Get red agent to red lm")
    made.pushes[4] = [True, False]
    other = recoloured(made, agents=True, items=True)
    assert goals(other) == ("Get green agent to red lm", "Get pink item to yellow lm")
    assert other.hypothesis.strengths == (450.0, 150.0)
    assert other.scene.radius.tolist() == [1.2, 0.8, 1.01, 0.8]
    assert other.pushes[4].tolist() == [False, True]
    np.testing.assert_array_equal(other.trajectory[:, 1], made.trajectory[:, 0])
    assert_same(recoloured(other, agents=True, items=True), made)
    # and with who helps whom and who chases whom
    made = recording(red="get to green agent", green="get to red agent", alpha=(0, -1))
    assert goals(made) == ("get to green agent", "get away from red agent")
    other = recoloured(made, agents=True, items=False)
    assert goals(other) == ("get away from green agent", "get to red agent")
    assert other.hypothesis.alpha == (-1, 0)
    assert other.hypothesis.scenario == made.hypothesis.scenario == "opposing"
