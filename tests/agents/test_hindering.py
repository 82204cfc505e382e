"""The authors' rules for hindering, one by one, on symbolic states.

Goals about touching an item are not among the 36, and neither is hindering in them.
"""

from __future__ import annotations

from phase_ppl.agents.subgoals import SubgoalPlanner
from phase_ppl.world.names import STOP, Literal, Predicate
from phase_ppl.world.rooms import N_ROOMS
from tests.agents.scenes import FULL_WALL_UP, HALF_WALL_LEFT, NARROW_WALL_DOWN
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
NARROW_WALL_RIGHT = [[16.0, 12.0], [23.5, 12.0]]
"""The bottom right room behind two doors that only small bodies pass."""
CLOSED_TO_WIDE = [FULL_WALL_UP, HALF_WALL_LEFT, NARROW_WALL_DOWN, NARROW_WALL_RIGHT]


def door(entity: int, ray: int) -> Literal:
    return Literal(Predicate.CLOSE, entity, N_ROOMS + ray)


class TestKeepingAnAgentFromItsLandmark:
    def hinderer(self, **where: object) -> SubgoalPlanner:
        return planner(
            "Get green agent away from red lm",
            "Get green agent to red lm",
            **where,  # type: ignore[arg-type]
        )

    def test_without_inner_walls_push_it_away(self) -> None:
        plan = self.hinderer(walls=[])
        assert plan.subgoal(state(ONE_ROOM), IN_VIEW) == on(GREEN, BOTTOM_RIGHT, positive=False)

    def test_follow_it_into_the_room_of_its_landmark_and_push_it_out(self) -> None:
        plan = self.hinderer()
        rooms = (BOTTOM_LEFT, BOTTOM_RIGHT, TOP_LEFT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), OUT_OF_VIEW) == close(RED, BOTTOM_RIGHT)
        there = state((BOTTOM_RIGHT, BOTTOM_RIGHT, TOP_LEFT, TOP_RIGHT))
        assert plan.subgoal(there, OUT_OF_VIEW) == on(GREEN, BOTTOM_RIGHT, positive=False)

    def test_let_go_before_following_it(self) -> None:
        holding = state((BOTTOM_LEFT, BOTTOM_RIGHT, TOP_LEFT, TOP_RIGHT), held=(PINK, NOWHERE))
        found = self.hinderer().subgoal(holding, IN_VIEW)
        assert found == attach(RED, PINK, positive=False)

    def test_stop_where_its_way_is_too_narrow_for_it_and_let_go_first(self) -> None:
        plan = self.hinderer(walls=NARROW_DOWN, radius=[SMALL, WIDE, SMALL, SMALL])
        rooms = (TOP_LEFT, TOP_LEFT, TOP_RIGHT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), OUT_OF_VIEW) == STOP
        holding = state(rooms, held=(PINK, NOWHERE))
        assert plan.subgoal(holding, IN_VIEW) == attach(RED, PINK, positive=False)

    def test_put_an_item_that_fills_it_into_a_door_of_its_way(self) -> None:
        plan = self.hinderer(walls=NARROW_DOWN, radius=[SMALL, SMALL, WIDE, SMALL])
        rooms = (BOTTOM_LEFT, TOP_LEFT, BOTTOM_LEFT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), IN_VIEW) == touch(RED, BLUE)
        reach = state(rooms, in_reach=(True, False, False, False))
        assert plan.subgoal(reach, IN_VIEW) == attach(RED, BLUE)
        holding = state(rooms, held=(BLUE, NOWHERE))
        assert plan.subgoal(holding, IN_VIEW) == door(BLUE, DOWN)

    def test_a_door_that_an_item_fills_is_seen_to_before_anything_else(self) -> None:
        plan = self.hinderer(walls=NARROW_DOWN, radius=[SMALL, SMALL, WIDE, SMALL])
        rooms = (BOTTOM_LEFT, TOP_LEFT, BOTTOM_LEFT, TOP_RIGHT)
        filled = state(rooms, in_reach=(True, False, False, False), door_filled_by=(DOWN, NOWHERE))
        assert plan.subgoal(filled, IN_VIEW) == attach(RED, BLUE)

    def test_keep_hold_of_an_item_in_the_door_that_it_fills(self) -> None:
        plan = self.hinderer(walls=NARROW_DOWN, radius=[SMALL, SMALL, WIDE, SMALL])
        rooms = (BOTTOM_LEFT, TOP_LEFT, BOTTOM_LEFT, TOP_RIGHT)
        filled = state(rooms, held=(BLUE, NOWHERE), door_filled_by=(DOWN, NOWHERE))
        assert plan.subgoal(filled, IN_VIEW) == door(BLUE, DOWN)

    def test_an_item_in_another_room_is_too_far_to_fill_a_door_with(self) -> None:
        plan = self.hinderer(walls=NARROW_DOWN, radius=[SMALL, SMALL, WIDE, SMALL])
        rooms = (TOP_LEFT, TOP_LEFT, TOP_RIGHT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), OUT_OF_VIEW) == door(RED, LEFT)

    def test_one_too_weak_to_carry_the_item_leaves_it(self) -> None:
        sizes = [SMALL, SMALL, WIDE, SMALL]
        plan = self.hinderer(walls=NARROW_DOWN, radius=sizes, strengths=(150.0, 450.0))
        near = state((BOTTOM_LEFT, TOP_LEFT, BOTTOM_LEFT, TOP_RIGHT))
        reach = near._replace(in_reach=(True, False, False, False))
        for found in (plan.subgoal(near, IN_VIEW), plan.subgoal(reach, IN_VIEW)):
            assert found == door(RED, LEFT)

    def test_go_to_the_nearest_room_of_its_way_and_push_it_back_there(self) -> None:
        plan = self.hinderer()
        apart = state((TOP_LEFT, BOTTOM_LEFT, TOP_RIGHT, TOP_RIGHT))
        # its own room is not waited in: a room with a door on its way is the next one
        assert plan.subgoal(apart, OUT_OF_VIEW) == close(RED, BOTTOM_LEFT)
        there = state((BOTTOM_RIGHT, TOP_LEFT, TOP_RIGHT, TOP_RIGHT))
        assert plan.subgoal(there, OUT_OF_VIEW) == on(GREEN, BOTTOM_RIGHT, positive=False)

    def test_one_in_view_through_a_door_is_pushed_back_at_once(self) -> None:
        # the authors' hinderer goes to its room first; as a rule that made readings of other
        # videos worse, and those of hinderers no better
        rooms = (BOTTOM_LEFT, BOTTOM_RIGHT, TOP_LEFT, TOP_RIGHT)
        plan = self.hinderer()
        assert plan.subgoal(state(rooms), IN_VIEW) == on(GREEN, BOTTOM_RIGHT, positive=False)
        assert plan.subgoal(state(rooms), OUT_OF_VIEW) == close(RED, BOTTOM_RIGHT)

    def test_stand_in_a_door_beside_a_wall_not_in_an_open_side(self) -> None:
        # between the lower rooms there is no wall; between the left ones there is half of one
        plan = planner("Get green agent away from blue lm", "Get green agent to blue lm")
        rooms = (BOTTOM_LEFT, BOTTOM_RIGHT, TOP_RIGHT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), OUT_OF_VIEW) == door(RED, LEFT)

    def test_of_the_doors_of_its_way_stand_in_the_one_at_hand(self) -> None:
        plan = self.hinderer(walls=NARROW_DOWN)
        for room, ray in ((TOP_LEFT, LEFT), (BOTTOM_LEFT, LEFT), (BOTTOM_RIGHT, DOWN)):
            rooms = (room, TOP_LEFT, TOP_RIGHT, TOP_RIGHT)
            assert plan.subgoal(state(rooms), OUT_OF_VIEW) == door(RED, ray)

    def test_without_a_wall_on_its_way_meet_it_and_push_it_back(self) -> None:
        plan = self.hinderer(walls=[FULL_WALL_UP, HALF_WALL_LEFT])
        for room, expected in (
            (TOP_LEFT, close(RED, BOTTOM_LEFT)),
            (BOTTOM_RIGHT, on(GREEN, BOTTOM_RIGHT, positive=False)),
        ):
            rooms = (room, BOTTOM_LEFT, TOP_RIGHT, TOP_RIGHT)
            assert plan.subgoal(state(rooms), OUT_OF_VIEW) == expected

    def test_one_that_wants_something_else_is_pushed_away_from_the_landmark(self) -> None:
        plan = planner("Get green agent away from red lm", "Get blue item to blue lm")
        assert plan.subgoal(state(), OUT_OF_VIEW) == on(GREEN, BOTTOM_RIGHT, positive=False)
        holding = state(held=(PINK, NOWHERE))
        assert plan.subgoal(holding, IN_VIEW) == attach(RED, PINK, positive=False)

    def test_let_go_before_going_to_meet_it(self) -> None:
        holding = state((TOP_LEFT, TOP_LEFT, TOP_RIGHT, TOP_LEFT), held=(PINK, NOWHERE))
        found = self.hinderer().subgoal(holding, OUT_OF_VIEW)
        assert found == attach(RED, PINK, positive=False)


class TestKeepingAnItemFromItsLandmark:
    def hinderer(self, **where: object) -> SubgoalPlanner:
        return planner(
            "Get blue item away from red lm",
            "Get blue item to red lm",
            **where,  # type: ignore[arg-type]
        )

    def test_without_inner_walls_move_the_item_away(self) -> None:
        plan = self.hinderer(walls=[])
        assert plan.subgoal(state(ONE_ROOM), IN_VIEW) == on(BLUE, BOTTOM_RIGHT, positive=False)

    def test_without_inner_walls_it_is_not_let_go_of(self) -> None:
        held = state(ONE_ROOM, held=(BLUE, NOWHERE))
        found = self.hinderer(walls=[]).subgoal(held, IN_VIEW)
        assert found == on(BLUE, BOTTOM_RIGHT, positive=False)

    def test_where_the_other_wants_something_else_move_it_away(self) -> None:
        plan = planner("Get blue item away from red lm", "Get green agent to blue lm")
        away = on(BLUE, BOTTOM_RIGHT, positive=False)
        assert plan.subgoal(state(), IN_VIEW) == away
        assert plan.subgoal(state(held=(BLUE, NOWHERE)), IN_VIEW) == away

    def test_let_go_of_another_item_first(self) -> None:
        holding = state(held=(PINK, NOWHERE))
        found = self.hinderer().subgoal(holding, IN_VIEW)
        assert found == attach(RED, PINK, positive=False)

    def test_stop_if_it_cannot_reach_the_item_and_the_opponent_is_there(self) -> None:
        plan = self.hinderer(walls=NARROW_DOWN, radius=[WIDE, SMALL, SMALL, SMALL])
        rooms = (BOTTOM_LEFT, BOTTOM_RIGHT, BOTTOM_RIGHT, TOP_LEFT)
        assert plan.subgoal(state(rooms), IN_VIEW) == STOP

    def test_stop_if_it_cannot_reach_the_item_and_the_opponent_has_it(self) -> None:
        plan = self.hinderer(walls=NARROW_DOWN, radius=[WIDE, SMALL, SMALL, SMALL])
        rooms = (BOTTOM_LEFT, TOP_RIGHT, BOTTOM_RIGHT, TOP_LEFT)
        assert plan.subgoal(state(rooms, held=(NOWHERE, BLUE)), IN_VIEW) == STOP
        assert plan.subgoal(state(rooms), IN_VIEW) == close(RED, BOTTOM_RIGHT)

    def test_keep_the_opponent_out_of_the_room_of_an_item_out_of_reach(self) -> None:
        plan = self.hinderer(walls=CLOSED_TO_WIDE, radius=[WIDE, SMALL, SMALL, SMALL])
        rooms = (BOTTOM_LEFT, TOP_LEFT, BOTTOM_RIGHT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), IN_VIEW) == door(RED, DOWN)

    def test_on_the_way_to_that_door_go_to_its_room(self) -> None:
        plan = self.hinderer(walls=CLOSED_TO_WIDE, radius=[WIDE, SMALL, SMALL, SMALL])
        rooms = (TOP_LEFT, BOTTOM_LEFT, BOTTOM_RIGHT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), IN_VIEW) == close(RED, BOTTOM_LEFT)

    def test_take_hold_of_what_the_opponent_holds_and_pull_it_to_the_corner(self) -> None:
        plan = self.hinderer()
        rooms = (TOP_LEFT, BOTTOM_LEFT, BOTTOM_LEFT, TOP_RIGHT)
        held = state(rooms, held=(NOWHERE, BLUE))
        assert plan.subgoal(held, OUT_OF_VIEW) == close(RED, BOTTOM_LEFT)
        assert plan.subgoal(held, IN_VIEW) == touch(RED, BLUE)
        reach = held._replace(in_reach=(True, False, True, False))
        assert plan.subgoal(reach, IN_VIEW) == attach(RED, BLUE)
        both = state((BOTTOM_LEFT,) * 3 + (TOP_RIGHT,), held=(BLUE, BLUE))
        assert plan.subgoal(both, IN_VIEW) == on(BLUE, BOTTOM_LEFT)

    def test_in_the_room_of_the_goal_pull_it_off_the_goal(self) -> None:
        both = state((BOTTOM_RIGHT,) * 3 + (TOP_RIGHT,), held=(BLUE, BLUE))
        found = self.hinderer().subgoal(both, IN_VIEW)
        assert found == on(BLUE, BOTTOM_RIGHT, positive=False)

    def test_leave_it_to_an_opponent_that_cannot_bring_it_to_the_goal(self) -> None:
        plan = self.hinderer(walls=NARROW_DOWN, radius=[SMALL, WIDE, SMALL, SMALL])
        rooms = (BOTTOM_LEFT, BOTTOM_LEFT, BOTTOM_LEFT, TOP_LEFT)
        assert plan.subgoal(state(rooms, held=(NOWHERE, BLUE)), IN_VIEW) == STOP
        both = state(rooms, held=(BLUE, BLUE))
        assert plan.subgoal(both, IN_VIEW) == attach(RED, BLUE, positive=False)

    def test_stop_or_let_go_if_the_opponent_cannot_reach_the_item(self) -> None:
        plan = self.hinderer(walls=NARROW_DOWN, radius=[SMALL, WIDE, SMALL, SMALL])
        rooms = (TOP_LEFT, BOTTOM_RIGHT, TOP_LEFT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), IN_VIEW) == STOP
        holding = state(rooms, held=(BLUE, NOWHERE))
        assert plan.subgoal(holding, IN_VIEW) == attach(RED, BLUE, positive=False)

    def test_take_the_item_to_a_room_that_is_closed_to_the_opponent(self) -> None:
        plan = planner(
            "Get blue item away from green lm",
            "Get blue item to green lm",
            walls=[[[16.0, 12.0], [16.0, 14.5]], HALF_WALL_LEFT, *CLOSED_TO_WIDE[2:]],
            radius=[SMALL, WIDE, SMALL, SMALL],
        )
        rooms = (TOP_LEFT, TOP_RIGHT, TOP_LEFT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), IN_VIEW) == touch(RED, BLUE)
        holding = state((BOTTOM_LEFT, TOP_RIGHT, BOTTOM_LEFT, TOP_RIGHT), held=(BLUE, NOWHERE))
        assert plan.subgoal(holding, IN_VIEW) == close(BLUE, BOTTOM_RIGHT)

    def test_a_room_that_the_item_does_not_fit_into_is_no_refuge(self) -> None:
        plan = planner(
            "Get blue item away from green lm",
            "Get blue item to green lm",
            walls=[[[16.0, 12.0], [16.0, 14.5]], HALF_WALL_LEFT, *CLOSED_TO_WIDE[2:]],
            radius=[SMALL, WIDE, WIDE, SMALL],
        )
        holding = state((BOTTOM_LEFT, TOP_RIGHT, BOTTOM_LEFT, TOP_RIGHT), held=(BLUE, NOWHERE))
        assert plan.subgoal(holding, IN_VIEW) == on(BLUE, BOTTOM_LEFT)

    def test_an_item_is_never_taken_into_the_room_of_its_goal(self) -> None:
        # the rooms of the goal and below it are nearer to the item than to the opponent
        plan = planner("Get blue item away from green lm", "Get blue item to green lm")
        for room in (TOP_RIGHT, BOTTOM_RIGHT):
            holding = state((room, TOP_LEFT, room, BOTTOM_LEFT), held=(BLUE, NOWHERE))
            found = plan.subgoal(holding, IN_VIEW)
            assert found == (close if room == TOP_RIGHT else on)(BLUE, BOTTOM_RIGHT)

    def test_on_the_way_of_the_opponent_to_the_item_block_it(self) -> None:
        rooms = (BOTTOM_LEFT, TOP_LEFT, BOTTOM_RIGHT, TOP_RIGHT)
        assert self.hinderer().subgoal(state(rooms), IN_VIEW) == door(RED, LEFT)
        # beside the item it takes that away
        there = state((BOTTOM_RIGHT, TOP_LEFT, BOTTOM_RIGHT, TOP_RIGHT))
        assert self.hinderer().subgoal(there, IN_VIEW) == touch(RED, BLUE)

    def test_grab_the_item_and_take_it_to_the_farthest_room_nearer_to_it_than_to_the_opponent(
        self,
    ) -> None:
        plan = self.hinderer()
        rooms = (TOP_LEFT, BOTTOM_RIGHT, BOTTOM_LEFT, TOP_RIGHT)
        assert plan.subgoal(state(rooms), OUT_OF_VIEW) == close(RED, BOTTOM_LEFT)
        near = state((BOTTOM_LEFT, BOTTOM_RIGHT, BOTTOM_LEFT, TOP_RIGHT))
        assert plan.subgoal(near, OUT_OF_VIEW) == touch(RED, BLUE)
        reach = near._replace(in_reach=(True, False, False, False))
        assert plan.subgoal(reach, IN_VIEW) == attach(RED, BLUE)
        assert plan.subgoal(near._replace(held=(BLUE, NOWHERE)), IN_VIEW) == close(BLUE, TOP_LEFT)

    def test_grab_it_also_where_it_lies_in_the_room_to_be_held_in(self) -> None:
        rooms = (TOP_LEFT, TOP_RIGHT, TOP_LEFT, BOTTOM_RIGHT)
        assert self.hinderer().subgoal(state(rooms), OUT_OF_VIEW) == touch(RED, BLUE)

    def test_hold_the_item_in_the_corner_of_the_room_it_was_taken_to(self) -> None:
        arrived = state((TOP_LEFT, BOTTOM_RIGHT, TOP_LEFT, TOP_RIGHT), held=(BLUE, NOWHERE))
        assert self.hinderer().subgoal(arrived, IN_VIEW) == on(BLUE, TOP_LEFT)

    def test_push_the_opponent_off_where_it_is_as_near_to_every_room_as_the_item(self) -> None:
        rooms = (TOP_LEFT, BOTTOM_LEFT, BOTTOM_LEFT, TOP_RIGHT)
        found = self.hinderer().subgoal(state(rooms), IN_VIEW)
        assert found == on(GREEN, BOTTOM_LEFT, positive=False)


def test_hindering_one_that_wants_to_get_to_the_hinderer_is_to_flee() -> None:
    plan = planner("get away from green agent", "get to red agent")
    holding = state(held=(BLUE, NOWHERE))
    assert plan.subgoal(holding, IN_VIEW) == attach(RED, BLUE, positive=False)
    assert plan.subgoal(state(), IN_VIEW) == touch(RED, GREEN, positive=False)
