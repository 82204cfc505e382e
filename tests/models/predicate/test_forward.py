"""The forward model and its inversion, on symbolic trajectories made by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from phase_ppl.models.predicate import (
    INDEPENDENT,
    CostToGo,
    ForwardModel,
    Rationality,
    SymbolicState,
    log_prior_of_pairs,
    own_changes,
    posterior,
    without_physics,
)
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.goals import goal_index, goal_literal
from phase_ppl.world.hypothesis import RELATION_TABLE, RELATIONS
from phase_ppl.world.names import NOTHING, STOP, Literal, Predicate
from tests.agents.scenes import FULL_WALL_UP, NARROW_WALL_DOWN, scene

BLUE, GREEN, RED, YELLOW = range(4)
"""Rooms. Landmarks of neighbouring rooms are 15 apart where there are no walls."""

GIVEN = Rationality(rationality=0.1, operator_frames=4.0, wait_cost=6.0, lapse=0.04)
H = 1 / 4


def state(
    rooms: tuple[int, ...] = (BLUE, RED, RED, RED),
    held: tuple[int, int] = (NOTHING, NOTHING),
    near: tuple[tuple[int, int], ...] = (),
    placed: tuple[int, ...] = (),
) -> SymbolicState:
    """Return a state: red alone in the blue room, nobody at anything, unless given."""
    return SymbolicState(
        rooms,
        held,
        tuple(tuple((agent, e) in near for e in range(4)) for agent in range(2)),
        tuple(rooms[e] if e in placed else NOTHING for e in range(4)),
    )


def go(agent: int, room: int) -> Literal:
    return Literal(Predicate.CLOSE, agent, room)


ARRIVE = Literal(Predicate.ON, 0, BLUE)
TO_BLUE, TO_GREEN = (goal_index(f"Get red agent to {name} lm") for name in ("blue", "green"))


def softmax(costs: dict[Literal, float]) -> dict[Literal, float]:
    total = sum(math.exp(-0.1 * cost) for cost in costs.values())
    return {o: 0.96 * math.exp(-0.1 * c) / total + 0.04 / len(costs) for o, c in costs.items()}


TOWARDS_BLUE = softmax({ARRIVE: 3.0, go(0, GREEN): 33.0, go(0, YELLOW): 33.0, STOP: 9.0})
TOWARDS_GREEN = softmax({ARRIVE: 21.0, go(0, GREEN): 18.0, go(0, YELLOW): 48.0, STOP: 24.0})
"""Cost of each operator, by hand: its own, then ways of 15 and 3 to arrive; waiting costs 6 more
than what is left."""


def test_the_policy_is_a_softmax_over_the_cost_to_go() -> None:
    model = ForwardModel(scene(), GIVEN)
    assert model.policy(state(), 0, TO_BLUE) == pytest.approx(TOWARDS_BLUE)
    assert model.policy(state(), 0, TO_GREEN) == pytest.approx(TOWARDS_GREEN)


def test_a_trajectory_is_as_probable_as_its_operators_and_pauses() -> None:
    model = ForwardModel(scene(), GIVEN)
    start, arrived = state(), state(placed=(0,))
    found = model.log_likelihood([start, start, arrived])
    for goal, policy in ((TO_BLUE, TOWARDS_BLUE), (TO_GREEN, TOWARDS_GREEN)):
        by_hand = math.log(1 - H + H * policy[STOP]) + math.log(H * policy[ARRIVE])
        assert found[0, goal] == pytest.approx(by_hand)


def test_the_posterior_is_bayes_rule_over_pairs_of_goals() -> None:
    model = ForwardModel(scene(), GIVEN)
    likelihood = model.log_likelihood([state(), state(placed=(0,))])
    found = posterior(likelihood, log_prior_of_pairs(INDEPENDENT))
    red, green = found["goal_red"], found["goal_green"]
    odds = red[TO_BLUE] / red[TO_GREEN]
    assert odds == pytest.approx(TOWARDS_BLUE[ARRIVE] / TOWARDS_GREEN[ARRIVE])
    assert red.argmax() == TO_BLUE
    relation = np.bincount(RELATION_TABLE.ravel(), np.outer(red, green).ravel())
    assert found["relation"] == pytest.approx(relation)


def test_pure_chance_says_nothing_about_goals() -> None:
    model = ForwardModel(scene(), Rationality(rationality=0.0))
    likelihood = model.log_likelihood([state(), state(placed=(0,))])
    prior = np.exp(log_prior_of_pairs("uniform"))
    found = posterior(likelihood, log_prior_of_pairs("uniform"))
    assert found["goal_red"] == pytest.approx(prior.sum(axis=1))
    relation = np.bincount(RELATION_TABLE.ravel(), prior.ravel())
    assert found["relation"] == pytest.approx(relation)


@pytest.mark.parametrize("goal", ["Get red agent to blue lm", "Get blue item to red lm"])
def test_what_is_touched_can_be_gripped_and_is_not_touched_anew(goal: str) -> None:
    model = ForwardModel(scene(), GIVEN)
    beside_both = state(rooms=(BLUE, BLUE, BLUE, BLUE), near=((0, 1), (0, 2)))
    known = model.policy(beside_both, 0, goal_index(goal))
    touching = [o.target for o in known if o.predicate is Predicate.TOUCH]
    assert touching == [3]
    assert [o for o in known if o.predicate is Predicate.ATTACH] == [
        Literal(Predicate.ATTACH, 0, 2)
    ]


def test_to_grip_is_to_touch() -> None:
    before = state(rooms=(BLUE, RED, BLUE, RED))
    done = [literal for _, literal in own_changes(before, before._replace(held=(2, NOTHING)), 0)]
    assert done == [Literal(Predicate.TOUCH, 0, 2), Literal(Predicate.ATTACH, 0, 2)]


def test_what_is_left_behind_is_touched_no_more() -> None:
    before = state(rooms=(BLUE, RED, GREEN, BLUE), near=((0, 3),))
    after = state(rooms=(GREEN, RED, GREEN, BLUE), near=((0, 2),))
    (_, going), (there, touching) = own_changes(before, after, 0)
    assert (going, touching) == (go(0, GREEN), Literal(Predicate.TOUCH, 0, 2))
    assert not any(there.near[0])


def test_what_no_operator_brings_about_has_the_lapse_only() -> None:
    model = ForwardModel(scene(), GIVEN)
    jumped = state(rooms=(RED, RED, RED, RED))  # to the room diagonally opposite, at once
    found = model.log_likelihood([state(), jumped])
    assert found[0, TO_BLUE] == pytest.approx(math.log(H * 0.04 / 4))


def test_an_agent_that_has_arrived_may_rest_for_nothing() -> None:
    model = ForwardModel(scene(), GIVEN)
    resting = model.policy(state(placed=(0,)), 0, TO_BLUE)[STOP]
    assert resting > 0.75 > model.policy(state(placed=(0,)), 0, TO_GREEN)[STOP]


@pytest.mark.parametrize(
    ("goal", "cost"),
    [
        ("Get red agent to blue lm", 3),
        ("Get red agent to red lm", 33),
        ("Get blue item to red lm", 30 + 3 + 0.5 + 3),  # there, touch, grip, place
        ("Get blue item to green lm", 30 + 3 + 0.5 + 15 + 3),
        ("get to green agent", 33),
        ("Get green agent to blue lm", 0),  # it goes by itself
        ("Get red agent away from red lm", 0),  # it is as far away as it can be
        ("Get red agent away from green lm", 15),
        ("get away from green agent", 0),
        ("Get blue item away from blue lm", 30 + 3 + 0.5),
        ("Get green agent away from red lm", 33),
    ],
)
def test_costs_to_go_of_red_alone_in_the_blue_room(goal: str, cost: float) -> None:
    to_go = CostToGo(without_physics(scene()), 0, goal_literal(goal, 0))
    assert to_go(to_go.node(state())) == pytest.approx(cost)


def test_bodies_make_no_difference() -> None:
    trajectory = [state(), state(rooms=(YELLOW, RED, RED, RED)), state(rooms=(RED,) * 4)]
    walls = [NARROW_WALL_DOWN]
    found = [
        ForwardModel(scene(walls=walls, radius=[radius] * 4)).log_likelihood(trajectory)
        for radius in (0.8, 1.6)
    ]
    assert np.array_equal(*found)


@pytest.mark.parametrize("rationality", [0.0, 0.8])
def test_a_room_without_a_way_is_nobodys_to_reach(rationality: float) -> None:
    walls = [FULL_WALL_UP, [[16.0, 12.0], [6.0, 12.0]]]  # shuts the blue room
    model = ForwardModel(scene(walls=walls), Rationality(rationality))
    there, away = (goal_index(f"Get red agent {way} red lm") for way in ("to", "away from"))
    for goal in (there, away):
        policy = model.policy(state(), 0, goal)
        assert sum(policy.values()) == pytest.approx(1)
        assert min(policy.values()) > 0
    assert len(set(model.policy(state(), 0, there).values())) == 1


@pytest.mark.parametrize("goal", ["Get red agent away from red lm", "get away from green agent"])
def test_nothing_is_farther_than_a_room_without_a_way(goal: str) -> None:
    walls = [FULL_WALL_UP, [[16.0, 12.0], [6.0, 12.0]]]  # shuts the blue room
    to_go = CostToGo(without_physics(scene(walls=walls)), 0, goal_literal(goal, 0))
    assert to_go(to_go.node(state())) == 0
    outside = state(rooms=(RED, RED, RED, RED))
    assert 15 <= to_go(to_go.node(outside)) < 20, "one room on"


def test_an_agent_that_carries_goes_and_arrives_with_its_item() -> None:
    before = state(rooms=(BLUE, RED, BLUE, RED), near=((0, 2),))
    gripped = before._replace(held=(2, NOTHING))
    carried = gripped._replace(rooms=(GREEN, RED, GREEN, RED))
    arrived = carried._replace(on=(NOTHING, NOTHING, GREEN, NOTHING))
    done = state(rooms=(GREEN, RED, GREEN, RED), near=((0, 2),), placed=(2,))
    found = [
        [literal for _, literal in own_changes(one, two, 0)]
        for one, two in ((before, gripped), (gripped, carried), (carried, arrived), (arrived, done))
    ]
    assert found == [
        [Literal(Predicate.ATTACH, 0, 2)],
        [go(2, GREEN)],
        [Literal(Predicate.ON, 2, GREEN)],
        [Literal(Predicate.ATTACH, 0, 2, positive=False)],
    ]
    assert not list(own_changes(gripped, carried, 1))


def test_a_delivered_item_tells_its_goal_and_that_both_share_it() -> None:
    rooms = (BLUE, BLUE, BLUE, RED)
    near = ((0, 2), (1, 2))
    start = state(rooms=rooms)
    at_item = state(rooms=rooms, near=near)
    gripped = at_item._replace(held=(2, 2))
    carried = gripped._replace(rooms=(GREEN, GREEN, GREEN, RED))
    arrived = carried._replace(on=(NOTHING, NOTHING, GREEN, NOTHING))
    trajectory = [start, at_item, gripped, carried, *[arrived] * 30]
    likelihood = ForwardModel(scene()).log_likelihood(trajectory)
    found = posterior(likelihood, log_prior_of_pairs("uniform"))
    goal = goal_index("Get blue item to green lm")
    assert found["goal_red"].argmax() == found["goal_green"].argmax() == goal
    assert found["relation"][RELATIONS.index("friendly")] > 0.9


# --- priors ------------------------------------------------------------------------------------


def test_simples_prior_has_uniform_goals_that_go_together() -> None:
    prior = np.exp(log_prior_of_pairs("uniform"))
    for axis in (0, 1):
        marginal = prior.sum(axis=axis)
        assert marginal[marginal > 0] == pytest.approx(1 / 34)
    friendly, by_chance = (
        np.bincount(RELATION_TABLE.ravel(), table.ravel())[RELATIONS.index("friendly")]
        for table in (prior, np.exp(log_prior_of_pairs(INDEPENDENT)))
    )
    # one time in three somebody helps, in three somebody hinders, in three neither; to help one of
    # 34, an agent that flees, is to flee from it too, which is no friendship
    assert friendly == pytest.approx((33 / 34 + by_chance) / 3)


def test_all_pairs_are_alike_under_the_independent_prior() -> None:
    prior = np.exp(log_prior_of_pairs(INDEPENDENT))
    assert prior[prior > 0] == pytest.approx(1 / 34**2)
    assert (prior > 0).sum() == 34**2


def test_an_unknown_prior_gets_close_names() -> None:
    with pytest.raises(UnknownNameError, match="'independent'"):
        log_prior_of_pairs("independnt")


@pytest.mark.parametrize(
    "wrong",
    [{"rationality": -1}, {"operator_frames": 1}, {"wait_cost": math.inf}, {"lapse": 1},
     {"lapse": 0}, {"rationality": "high"}, {"rationality": False}, {"wait_cost": math.nan},
     {"rationality": 10**400}],
)  # fmt: skip
def test_rationality_is_checked(wrong: dict[str, Any]) -> None:
    (name,) = wrong
    zero = name in ("rationality", "wait_cost")
    expected = "number >= 0$" if zero else "number"
    with pytest.raises(InvalidSettingError, match=f"{name}=.*, expected a.*{expected}"):
        Rationality(**wrong)
