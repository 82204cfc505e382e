"""The authors' rules for own goals and for helping, one by one, on symbolic states.

Agents know effective goals only: a helper's is the helpee's own goal, so that a helper acts like
one of two collaborators. Where that makes it differ from the authors' helper, the test says so.
"""

from __future__ import annotations

import pytest

from phase_ppl.world.names import STOP, Literal, Predicate
from tests.agents.scenes import FULL_WALL_UP, HALF_WALL_LEFT
from tests.agents.test_subgoals import (
    BLUE,
    BOTTOM_LEFT,
    BOTTOM_RIGHT,
    GREEN,
    IN_VIEW,
    NARROW_DOWN,
    NOWHERE,
    OUT_OF_VIEW,
    PINK,
    RED,
    TOP_LEFT,
    TOP_RIGHT,
    attach,
    close,
    on,
    planner,
    state,
    touch,
)

LEFT, DOWN = 1, 2
SMALL, WIDE = 0.8, 1.6
ONE_ROOM = (0, 0, 0, 0)


class TestOwnGoals:
    def test_let_go_at_the_landmark(self) -> None:
        plan = planner("Get red agent to blue lm", "Get green agent to blue lm")
        arrived = state(own_done=True, held=(PINK, NOWHERE))
        assert plan.subgoal(arrived, IN_VIEW) == attach(RED, PINK, positive=False)

    def test_let_go_first_without_inner_walls(self) -> None:
        plan = planner("Get red agent to red lm", "Get green agent to blue lm", walls=[])
        holding = state(ONE_ROOM, held=(BLUE, NOWHERE))
        assert plan.subgoal(holding, IN_VIEW) == attach(RED, BLUE, positive=False)

    def test_let_go_of_the_item_that_is_not_wanted(self) -> None:
        plan = planner("Get blue item to red lm", "Get green agent to blue lm")
        holding = state(held=(PINK, NOWHERE))
        assert plan.subgoal(holding, IN_VIEW) == attach(RED, PINK, positive=False)

    def test_place_an_item_that_is_in_the_goal_room_before_its_holder(self) -> None:
        plan = planner("Get blue item to red lm", "Get green agent to blue lm")
        rooms = (BOTTOM_LEFT, TOP_RIGHT, BOTTOM_RIGHT, TOP_LEFT)
        assert plan.subgoal(state(rooms, held=(BLUE, NOWHERE)), IN_VIEW) == on(BLUE, BOTTOM_RIGHT)

    def test_keep_away_from_a_landmark(self) -> None:
        plan = planner("Get red agent away from red lm", "Get green agent to blue lm")
        assert plan.subgoal(state(), OUT_OF_VIEW) == on(RED, BOTTOM_RIGHT, positive=False)

    def test_touch_an_item_in_view_through_an_open_door(self) -> None:
        plan = planner("Get blue item to red lm", "Get green agent to blue lm")
        rooms = (BOTTOM_LEFT, TOP_RIGHT, TOP_LEFT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), OUT_OF_VIEW) == close(RED, TOP_LEFT)
        assert plan.subgoal(state(rooms), IN_VIEW) == touch(RED, BLUE)

    def test_flee_straight_whatever_the_rooms(self) -> None:
        plan = planner("get away from green agent", "get to red agent")
        assert plan.subgoal(state(), OUT_OF_VIEW) == touch(RED, GREEN, positive=False)


class TestHelpingWithAnItem:
    GOAL = "Get blue item to red lm"

    def test_at_the_goal_a_helper_without_the_item_stops(self) -> None:
        plan = planner(self.GOAL, self.GOAL)
        assert plan.subgoal(state(own_done=True), IN_VIEW) == STOP

    @pytest.mark.parametrize("item", [BLUE, PINK])
    def test_at_the_goal_a_helper_lets_go(self, item: int) -> None:
        plan = planner(self.GOAL, self.GOAL)
        arrived = state(own_done=True, held=(item, NOWHERE))
        assert plan.subgoal(arrived, IN_VIEW) == attach(RED, item, positive=False)

    def test_a_helper_that_reaches_item_and_goal_acts_as_if_it_were_its_own(self) -> None:
        helping = planner(self.GOAL, self.GOAL)
        alone = planner(self.GOAL, "Get green agent to green lm")
        reach = (True, False, False, False)
        for facts in (
            state(),
            state((BOTTOM_LEFT, BOTTOM_RIGHT, TOP_RIGHT, TOP_LEFT)),
            state(in_reach=reach),
            state(held=(BLUE, NOWHERE)),
        ):
            assert helping.subgoal(facts, IN_VIEW) == alone.subgoal(facts, IN_VIEW)

    def test_both_hold_and_the_helper_does_not_fit_so_it_lets_go(self) -> None:
        plan = planner(self.GOAL, self.GOAL, walls=NARROW_DOWN, radius=[WIDE, SMALL, SMALL, SMALL])
        both = state((BOTTOM_LEFT,) * 3 + (TOP_LEFT,), held=(BLUE, BLUE))
        assert plan.subgoal(both, IN_VIEW) == attach(RED, BLUE, positive=False)

    def test_both_hold_and_the_helpee_does_not_fit_so_the_helper_goes_on(self) -> None:
        plan = planner(self.GOAL, self.GOAL, walls=NARROW_DOWN, radius=[SMALL, WIDE, SMALL, SMALL])
        both = state((BOTTOM_LEFT,) * 3 + (TOP_LEFT,), held=(BLUE, BLUE))
        assert plan.subgoal(both, IN_VIEW) == close(BLUE, BOTTOM_RIGHT)

    def test_a_helper_that_could_bring_it_itself_joins_the_helpee_that_holds_it(self) -> None:
        plan = planner(self.GOAL, self.GOAL)
        held = state(held=(NOWHERE, BLUE), rooms=(TOP_LEFT,) * 4)
        assert plan.subgoal(held, IN_VIEW) == touch(RED, BLUE)

    def test_a_helper_that_cannot_bring_it_leaves_it_to_the_helpee_that_holds_it(self) -> None:
        sizes = [WIDE, SMALL, SMALL, SMALL]
        plan = planner(self.GOAL, self.GOAL, walls=NARROW_DOWN, radius=sizes)
        rooms = (BOTTOM_LEFT, BOTTOM_LEFT, BOTTOM_LEFT, TOP_LEFT)
        assert plan.subgoal(state(rooms, held=(NOWHERE, BLUE)), IN_VIEW) == STOP

    def test_carry_the_item_on_for_a_helpee_that_does_not_fit(self) -> None:
        sizes = [SMALL, WIDE, SMALL, SMALL]
        plan = planner(self.GOAL, self.GOAL, walls=NARROW_DOWN, radius=sizes)
        rooms = (BOTTOM_LEFT, BOTTOM_RIGHT, BOTTOM_LEFT, TOP_LEFT)
        assert plan.subgoal(state(rooms), IN_VIEW) == touch(RED, BLUE)
        reach = state(rooms, in_reach=(True, False, False, False))
        assert plan.subgoal(reach, IN_VIEW) == attach(RED, BLUE)
        assert plan.subgoal(state(rooms, held=(BLUE, NOWHERE)), IN_VIEW) == close(
            BLUE, BOTTOM_RIGHT
        )

    def test_bring_the_item_through_the_door_to_a_helpee_that_reaches_the_goal_only(self) -> None:
        # neither fits through the lower door; the item does
        plan = planner(self.GOAL, self.GOAL, walls=NARROW_DOWN, radius=[WIDE, WIDE, SMALL, SMALL])
        rooms = (BOTTOM_LEFT, BOTTOM_RIGHT, BOTTOM_LEFT, TOP_LEFT)
        assert plan.subgoal(state(rooms), IN_VIEW) == touch(RED, BLUE)
        assert plan.subgoal(state(rooms, held=(BLUE, NOWHERE)), IN_VIEW) == close(
            BLUE, BOTTOM_RIGHT
        )
        both = state(rooms, held=(BLUE, BLUE))
        assert plan.subgoal(both, IN_VIEW) == attach(RED, BLUE, positive=False)

    def test_the_helpee_takes_over_what_has_been_brought(self) -> None:
        plan = planner(
            self.GOAL, self.GOAL, agent=GREEN, walls=NARROW_DOWN, radius=[WIDE, WIDE, SMALL, SMALL]
        )
        rooms = (BOTTOM_LEFT, BOTTOM_RIGHT, BOTTOM_LEFT, TOP_LEFT)
        reach = state(rooms, held=(BLUE, NOWHERE), in_reach=(True, False, True, False))
        assert plan.subgoal(reach, IN_VIEW) == attach(GREEN, BLUE)
        # once both hold it, it goes on pulling while the helper lets go
        both = state(rooms, held=(BLUE, BLUE))
        assert plan.subgoal(both, IN_VIEW) == close(BLUE, BOTTOM_RIGHT)

    def test_one_that_can_neither_get_at_the_item_nor_is_needed_waits(self) -> None:
        sizes = [SMALL, WIDE, SMALL, SMALL]
        plan = planner(self.GOAL, self.GOAL, agent=GREEN, walls=NARROW_DOWN, radius=sizes)
        rooms = (BOTTOM_LEFT, BOTTOM_RIGHT, BOTTOM_LEFT, TOP_LEFT)
        assert plan.subgoal(state(rooms, held=(BLUE, NOWHERE)), IN_VIEW) == STOP

    def test_a_holder_beyond_the_door_need_not_pass_it(self) -> None:
        # red already stands where the item is to go
        plan = planner(self.GOAL, self.GOAL, walls=NARROW_DOWN, radius=[WIDE, SMALL, SMALL, SMALL])
        rooms = (BOTTOM_RIGHT, BOTTOM_LEFT, BOTTOM_LEFT, TOP_LEFT)
        reach = state(rooms, in_reach=(True, False, True, False))
        assert plan.subgoal(reach, IN_VIEW) == attach(RED, BLUE)
        assert plan.subgoal(state(rooms, held=(BLUE, NOWHERE)), IN_VIEW) == close(
            BLUE, BOTTOM_RIGHT
        )

    def test_a_helpee_that_does_not_fit_lets_the_helper_have_the_item(self) -> None:
        sizes = [SMALL, WIDE, SMALL, SMALL]
        plan = planner(self.GOAL, self.GOAL, agent=GREEN, walls=NARROW_DOWN, radius=sizes)
        both = state((BOTTOM_LEFT,) * 3 + (TOP_LEFT,), held=(BLUE, BLUE))
        assert plan.subgoal(both, IN_VIEW) == attach(GREEN, BLUE, positive=False)

    def test_put_the_item_that_the_helpee_reaches_but_cannot_bring_to_the_goal(self) -> None:
        # the helpee, too wide for the lower door, is with the item; the helper carries it on
        sizes = [SMALL, WIDE, SMALL, SMALL]
        plan = planner(self.GOAL, self.GOAL, walls=NARROW_DOWN, radius=sizes)
        rooms = (BOTTOM_LEFT, BOTTOM_LEFT, BOTTOM_LEFT, TOP_LEFT)
        reach = state(rooms, in_reach=(True, False, True, False))
        assert plan.subgoal(reach, IN_VIEW) == attach(RED, BLUE)
        there = state((BOTTOM_RIGHT, BOTTOM_LEFT, BOTTOM_RIGHT, TOP_LEFT), held=(BLUE, NOWHERE))
        assert plan.subgoal(there, IN_VIEW) == on(BLUE, BOTTOM_RIGHT)

    @pytest.mark.parametrize("agent", [RED, GREEN])
    def test_two_that_are_too_weak_alone_both_take_hold(self, agent: int) -> None:
        plan = planner(self.GOAL, self.GOAL, agent=agent, strengths=(200.0, 200.0))
        reach = state((TOP_LEFT,) * 4, in_reach=(True, False, True, False))
        assert plan.subgoal(reach, IN_VIEW) == attach(agent, BLUE)
        both = state((TOP_LEFT,) * 4, held=(BLUE, BLUE))
        assert plan.subgoal(both, IN_VIEW) == close(BLUE, BOTTOM_LEFT)


class TestHelpingAnAgentToItsLandmark:
    GOAL = "Get green agent to red lm"
    SIZES = (1.2, SMALL, WIDE, SMALL)
    BLOCKED = (BOTTOM_RIGHT, BOTTOM_LEFT, BOTTOM_RIGHT, TOP_LEFT)

    def helper(self, **where: object) -> object:
        where.setdefault("walls", NARROW_DOWN)
        where.setdefault("radius", list(self.SIZES))
        return planner(self.GOAL, self.GOAL, strengths=(600.0, 300.0), **where)  # type: ignore[arg-type]

    def test_without_inner_walls_there_is_nothing_to_do(self) -> None:
        assert self.helper(walls=[]).subgoal(state(ONE_ROOM), IN_VIEW) == STOP  # type: ignore[attr-defined]

    def test_without_inner_walls_let_go_first(self) -> None:
        holding = state(ONE_ROOM, held=(PINK, NOWHERE))
        found = self.helper(walls=[]).subgoal(holding, IN_VIEW)  # type: ignore[attr-defined]
        assert found == attach(RED, PINK, positive=False)

    def test_an_item_in_a_door_of_the_way_is_carried_to_the_corner_of_its_room(self) -> None:
        plan = self.helper()
        blocked = state(self.BLOCKED, door_filled_by=(DOWN, NOWHERE))
        reach = blocked._replace(in_reach=(True, False, False, False))
        holding = blocked._replace(held=(BLUE, NOWHERE))
        assert plan.subgoal(blocked, IN_VIEW) == touch(RED, BLUE)  # type: ignore[attr-defined]
        assert plan.subgoal(reach, IN_VIEW) == attach(RED, BLUE)  # type: ignore[attr-defined]
        assert plan.subgoal(holding, IN_VIEW) == on(BLUE, BOTTOM_RIGHT)  # type: ignore[attr-defined]

    def test_the_second_item_in_the_door_is_cleared_as_well(self) -> None:
        # the authors' helper looks at item 0 only, the one that their scenes put there
        plan = self.helper(radius=[1.2, SMALL, SMALL, WIDE])
        rooms = (BOTTOM_RIGHT, BOTTOM_LEFT, TOP_LEFT, BOTTOM_RIGHT)
        blocked = state(rooms, door_filled_by=(NOWHERE, DOWN))
        assert plan.subgoal(blocked, IN_VIEW) == touch(RED, PINK)  # type: ignore[attr-defined]

    def test_an_item_in_a_door_off_the_way_is_left_alone(self) -> None:
        plan = self.helper(walls=[FULL_WALL_UP, HALF_WALL_LEFT, NARROW_DOWN[-1]])
        rooms = (BOTTOM_RIGHT, TOP_RIGHT, BOTTOM_RIGHT, TOP_LEFT)
        off_the_way = state(rooms, door_filled_by=(DOWN, NOWHERE))
        assert plan.subgoal(off_the_way, IN_VIEW) == STOP  # type: ignore[attr-defined]

    def test_a_helper_that_cannot_get_at_the_item_in_the_door_stops(self) -> None:
        walls = [*NARROW_DOWN[:-1], [[16.0, 12.0], [16.0, 2.0]]]
        plan = self.helper(walls=walls, radius=[1.2, SMALL, WIDE, SMALL])
        rooms = (TOP_RIGHT, BOTTOM_LEFT, TOP_LEFT, TOP_RIGHT)
        stuck = state(rooms, door_filled_by=(LEFT, NOWHERE))
        assert plan.subgoal(stuck, IN_VIEW) == STOP  # type: ignore[attr-defined]

    def test_with_a_free_way_stop_or_let_go_first(self) -> None:
        plan = self.helper()
        assert plan.subgoal(state(self.BLOCKED), IN_VIEW) == STOP  # type: ignore[attr-defined]
        holding = state(self.BLOCKED, held=(BLUE, NOWHERE))
        found = plan.subgoal(holding, IN_VIEW)  # type: ignore[attr-defined]
        assert found == attach(RED, BLUE, positive=False)

    def test_at_the_goal_stop(self) -> None:
        arrived = state(
            self.BLOCKED, own_done=True, other_done=True, door_filled_by=(DOWN, NOWHERE)
        )
        assert self.helper().subgoal(arrived, IN_VIEW) == STOP  # type: ignore[attr-defined]


def test_helping_one_that_wants_to_get_to_the_helper_is_to_meet_it() -> None:
    plan = planner("get to green agent", "get to red agent")
    met = state((TOP_LEFT, BOTTOM_LEFT, TOP_RIGHT, TOP_RIGHT))
    assert plan.subgoal(met, OUT_OF_VIEW) == Literal(Predicate.CLOSE, RED, BOTTOM_LEFT)
    assert plan.subgoal(met, IN_VIEW) == touch(RED, GREEN)
