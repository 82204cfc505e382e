"""Facts of belief particles, by hand, and the value by which subgoals are chosen."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np
import pytest

from phase_ppl.agents import pomcp, symbols
from phase_ppl.agents.agent import best_subgoal
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.symbols import SymbolicState
from phase_ppl.world.goals import goal_index, goal_literal
from phase_ppl.world.names import STOP, Literal, PredicateKind
from phase_ppl.world.scene import Scene
from tests.agents.scenes import FULL_WALL_UP, NARROW_WALL_DOWN, model_of, scene, state_of

RED, GREEN, BLUE, PINK = range(4)
DOWN = 2
ELSEWHERE = "Get green agent to green lm"


def described(
    where: Scene,
    goal: str = "Get blue item to red lm",
    other: str = ELSEWHERE,
    held: tuple[int, int] = (-1, -1),
    whole: bool = False,
) -> tuple[SymbolicState, float]:
    """Return the facts of red at the start of a scene, and its cost, of a leg or the whole plan."""
    model, (bodies, _, _) = model_of(where), state_of(where)
    row = symbols.Facts(4, 2)
    facts = np.zeros((1, row.size), np.int8)
    done, costs = np.zeros((2, 1), np.bool_), np.zeros((2, 1))
    goals = goal_literal(goal_index(goal), RED), goal_literal(goal_index(other), GREEN)
    codes = np.array([pomcp.subgoal_code(literal) for literal in goals])
    symbols.describe(
        *(bodies[None], np.array([held]), RED, codes, np.full(2, whole)),
        *(model.params, model.layout, facts, done, costs),
    )
    own_done, other_done = done[:, 0].tolist()
    return row.unpack(facts[0].tobytes(), own_done, other_done), float(costs[0, 0])


@pytest.mark.parametrize(
    ("goal", "entity", "threshold"),
    [("Get red agent to red lm", "red", 0.566), ("Get blue item to red lm", "blue", 1.414)],
)
def test_a_landmark_is_reached_within_a_distance(goal: str, entity: str, threshold: float) -> None:
    x, y = scene().landmark_centres[2]
    for off, reached in ((threshold - 0.01, True), (threshold + 0.01, False)):
        place = (x - off, y, 0.0) if entity == "red" else (x - off, y)
        where = scene(**{"blue": (8.0, 12.0), entity: place})  # type: ignore[arg-type]
        assert described(where, goal)[0].own_done is reached
        # what one wants not to be so is described alike
        assert described(where, ELSEWHERE, goal)[0].other_done is reached


def test_an_agent_is_touched_within_a_distance() -> None:
    for off, reached in ((2.82, True), (2.84, False)):
        where = scene(red=(12.0, 8.0, 0.0), green=(12.0 + off, 8.0, 0.0))
        assert described(where, "get to green agent")[0].own_done is reached


def test_an_item_fills_a_door_that_it_is_too_wide_for_and_stands_in() -> None:
    walls = [FULL_WALL_UP, NARROW_WALL_DOWN]
    x, y = scene(walls=walls).rooms.door_position[DOWN]
    for blue, off, expected in ((1.6, 2.39, DOWN), (1.6, 2.41, -1), (1.2, 0.0, -1)):
        sizes = [0.8, 0.8, blue, 0.8]
        facts, _ = described(scene(blue=(x + off, y), walls=walls, radius=sizes))
        assert facts.door_filled_by == (expected, -1)


def test_rooms_holds_and_reach() -> None:
    facts, _ = described(scene(red=(12.0, 9.0, 0.0), blue=(12.0, 11.0), walls=[FULL_WALL_UP]))
    assert facts.rooms == (3, 1, 3, 3)
    assert facts.in_reach == (True, False, False, False)
    held, _ = described(scene(walls=[FULL_WALL_UP]), held=(BLUE, PINK))
    assert held.held == (BLUE, PINK)
    assert described(scene())[0].rooms == (0, 0, 0, 0)


def test_the_cost_is_the_length_of_the_leg_that_the_agent_is_on() -> None:
    where = scene(red=(10.0, 8.0, 0.0), blue=(14.0, 5.0), green=(20.0, 18.0, 0.0))
    x, y = where.landmark_centres[2]
    assert described(where)[1] == pytest.approx(5.0)
    assert described(where, held=(BLUE, -1))[1] == pytest.approx(np.hypot(x - 14, y - 5))
    assert described(where, "Get red agent to red lm")[1] == pytest.approx(np.hypot(x - 10, y - 8))
    assert described(where, "get away from green agent")[1] == 0


def test_the_printed_cost_is_the_length_of_all_legs_to_the_goal() -> None:
    where = scene(red=(10.0, 8.0, 0.0), blue=(14.0, 5.0), green=(20.0, 18.0, 0.0))
    x, y = where.landmark_centres[2]
    rest = np.hypot(x - 14, y - 5)
    assert described(where, whole=True)[1] == pytest.approx(5 + rest)
    assert described(where, held=(BLUE, -1), whole=True)[1] == pytest.approx(rest)
    for goal in ("Get red agent to red lm", "get away from green agent"):  # of one leg, or of none
        assert described(where, goal, whole=True) == described(where, goal)
    # through the door between the item and its goal
    walled = scene(red=(10.0, 8.0, 0.0), blue=(14.0, 5.0), walls=[FULL_WALL_UP, NARROW_WALL_DOWN])
    door = walled.rooms.door_position[DOWN]
    way = np.hypot(*(door - (14, 5))) + np.hypot(*((x, y) - door))
    assert described(walled, whole=True)[1] == pytest.approx(5 + way)


class TestValue:
    """V(h) = share of the particles - lambda x their mean cost."""

    NEAR, FAR = Literal(PredicateKind.CLOSE, RED, 1), Literal(PredicateKind.CLOSE, RED, 3)
    AGREEING: ClassVar = {NEAR: [0, 1, 2, 3], FAR: [4, 5, 6, 7, 8, 9]}
    COSTS = np.array([1.0] * 4 + [20.0] * 6)
    CONFIG = PlannerConfig(particles=10)

    def best(
        self, agreeing: dict[Literal, list[int]], done: float = 0.0, **changes: object
    ) -> Literal:
        config = dataclasses.replace(self.CONFIG, **changes)  # type: ignore[arg-type]
        return best_subgoal(agreeing, self.COSTS, done, config)

    def test_the_cost_weight_decides_for_the_less_probable_but_nearer(self) -> None:
        # 0.4 - 0.05 x 1 against 0.6 - 0.05 x 20; they are equal at 0.2 / 19
        assert self.best(self.AGREEING) == self.NEAR
        assert self.best(self.AGREEING, cost_weight=0.0) == self.FAR
        assert self.best(self.AGREEING, cost_weight=0.0104) == self.FAR
        assert self.best(self.AGREEING, cost_weight=0.0106) == self.NEAR

    def test_touching_wins_over_it_where_that_is_set(self) -> None:
        touching = [Literal(PredicateKind.TOUCH, RED, target) for target in (GREEN, PINK, BLUE)]
        agreeing = {
            self.NEAR: [0, 1, 2, 3, 4, 5, 6],
            **{t: [7 + i] for i, t in enumerate(touching)},
        }
        assert self.best(agreeing) == self.NEAR
        for preferred in (BLUE, PINK, GREEN):
            found = self.best(agreeing, touch_override=True)
            assert found == Literal(PredicateKind.TOUCH, RED, preferred)
            del agreeing[found]
        assert self.best(agreeing, touch_override=True) == self.NEAR

    def test_particles_in_which_nothing_is_left_to_do_end_nothing_unless_most_agree(self) -> None:
        few, most = ({STOP: [*range(n)], self.FAR: [*range(n, 10)]} for n in (4, 6))
        assert self.best(few) == self.FAR
        assert self.best(most) == self.FAR
        assert self.best(most, done=0.6) == STOP
        assert self.best({STOP: [*range(10)]}) == STOP

    def test_as_printed_to_stop_is_a_subgoal_as_any_other(self) -> None:
        few = {STOP: [0, 1, 2, 3], self.FAR: [4, 5, 6, 7, 8, 9]}
        # 0.4 - 0.05 x 1 against 0.6 - 0.05 x 20
        assert self.best(few) == self.FAR
        assert self.best(few, stops_when_done=False) == STOP
        assert self.best(few, stops_when_done=False, cost_weight=0.0) == self.FAR


def test_held_items_are_imagined_as_the_settings_say() -> None:
    for swivel in (False, True):
        assert model_of(scene(), PlannerConfig(swivel=swivel)).params.swivel is swivel
