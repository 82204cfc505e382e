"""Predicate inverse planning: from tracks to predicates, the forward model, its inversion."""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import math
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.symbols import Facts, Node, describe, moves
from phase_ppl.agents.world_model import Abilities, WorldModel
from phase_ppl.evaluation.models.predicate import marginals, prior_in
from phase_ppl.models.predicate import (
    INDEPENDENT,
    CostToGo,
    ForwardModel,
    Layout,
    Moment,
    PredicateSettings,
    log_prior_of_pairs,
    operators,
    posterior,
    symbolic_trajectory,
)
from phase_ppl.physics import compiled
from phase_ppl.world.event import Observation, State
from phase_ppl.world.geometry import GRAB_REACH
from phase_ppl.world.goals import effective_goal, goal_index, goal_literal, possible_goals
from phase_ppl.world.hypothesis import RELATION_TABLE, RELATIONS, Hypothesis, all_ways
from phase_ppl.world.names import NOTHING, STOP, Literal, PredicateKind
from tests.agents.scenes import FULL_WALL_UP, NARROW_WALL_DOWN, scene

BLUE, GREEN, RED, YELLOW = range(4)
"""Rooms. Landmarks of neighbouring rooms are 15 apart where there are no walls."""

BLUE_ROOM_SHUT = [FULL_WALL_UP, [[16.0, 12.0], [6.0, 12.0]]]
GIVEN = PredicateSettings(rationality=0.1, operator_frames=4.0, wait_cost=6.0, lapse=0.04)
MODEL = ForwardModel(scene(), GIVEN)
H = 1 / 4


def state(
    rooms: tuple[int, ...] = (BLUE, RED, RED, RED),
    held: tuple[int, int] = (NOTHING, NOTHING),
    near: tuple[tuple[int, int], ...] = (),
    placed: tuple[int, ...] = (),
) -> Moment:
    """Return a state: red alone in the blue room, nobody at anything, unless given."""
    return Moment(
        rooms,
        held,
        tuple(tuple((agent, e) in near for e in range(4)) for agent in range(2)),
        tuple(rooms[e] if e in placed else NOTHING for e in range(4)),
    )


def go(agent: int, room: int) -> Literal:
    return Literal(PredicateKind.CLOSE, agent, room)


def cost(goal: str, agent: int, where: ppl.Scene, given: Moment) -> float:
    """Return what is left to do of an agent's goal, units of way."""
    literal = goal_literal(where.world.goal_index(goal), agent, where.world)
    return CostToGo(Layout.of(where), agent, literal)(given)


ARRIVE = Literal(PredicateKind.ON, 0, BLUE)
TO_BLUE, TO_GREEN = (goal_index(f"Get red agent to {name} lm") for name in ("blue", "green"))


def softmax(costs: dict[Literal, float]) -> dict[Literal, float]:
    total = sum(math.exp(-0.1 * cost) for cost in costs.values())
    return {o: 0.96 * math.exp(-0.1 * c) / total + 0.04 / len(costs) for o, c in costs.items()}


TOWARDS_BLUE = softmax({ARRIVE: 3.0, go(0, GREEN): 33.0, go(0, YELLOW): 33.0, STOP: 9.0})
TOWARDS_GREEN = softmax({ARRIVE: 21.0, go(0, GREEN): 18.0, go(0, YELLOW): 48.0, STOP: 24.0})
"""Cost of each operator, by hand: its own, then ways of 15 and 3 to arrive; waiting costs 6 more
than what is left."""


def test_the_policy_is_a_softmax_over_the_cost_to_go() -> None:
    assert MODEL.policy(state(), 0, TO_BLUE) == pytest.approx(TOWARDS_BLUE)
    assert MODEL.policy(state(), 0, TO_GREEN) == pytest.approx(TOWARDS_GREEN)


def test_a_trajectory_is_as_probable_as_its_operators_and_pauses() -> None:
    start, arrived = state(), state(placed=(0,))
    found = MODEL.log_likelihood([start, start, arrived])
    for goal, policy in ((TO_BLUE, TOWARDS_BLUE), (TO_GREEN, TOWARDS_GREEN)):
        by_hand = math.log(1 - H + H * policy[STOP]) + math.log(H * policy[ARRIVE])
        assert found[0, goal] == pytest.approx(by_hand)


def test_the_posterior_is_bayes_rule_over_pairs_of_goals() -> None:
    likelihood = MODEL.log_likelihood([state(), state(placed=(0,))])
    found = posterior(likelihood, log_prior_of_pairs(INDEPENDENT))
    red, green = found["goal_red"], found["goal_green"]
    odds = red[TO_BLUE] / red[TO_GREEN]
    assert odds == pytest.approx(TOWARDS_BLUE[ARRIVE] / TOWARDS_GREEN[ARRIVE])
    assert red.argmax() == TO_BLUE
    relation = np.bincount(RELATION_TABLE.ravel(), np.outer(red, green).ravel())
    assert found["relation"] == pytest.approx(relation)


def test_a_room_without_a_way_is_nobodys_to_reach_and_nothing_is_farther() -> None:
    model = ForwardModel(scene(walls=BLUE_ROOM_SHUT), PredicateSettings(rationality=0.8))
    there, away = (goal_index(f"Get red agent {way} red lm") for way in ("to", "away from"))
    for goal in (there, away):
        policy = model.policy(state(), 0, goal)
        assert sum(policy.values()) == pytest.approx(1)
        assert min(policy.values()) > 0
    assert len(set(model.policy(state(), 0, there).values())) == 1
    where = scene(walls=BLUE_ROOM_SHUT)
    for fleeing in ("Get red agent away from red lm", "get away from green agent"):
        assert cost(fleeing, 0, where, state()) == 0
        assert 15 <= cost(fleeing, 0, where, state(rooms=(RED,) * 4)) < 20, "one room on"


def anything(rng: np.random.Generator, where: ppl.Scene, layout: Layout) -> Moment:
    """Return a state drawn at random, likely or not."""
    n, n_all = len(where.world.agents), len(where.world.entities)
    rooms = tuple(rng.integers(len(layout.step), size=n_all).tolist())
    there = [[NOTHING] for _ in layout.step]
    for landmark, room in enumerate(layout.landmark_rooms):
        there[room].append(landmark)
    return Moment(
        rooms,
        tuple(rng.choice([NOTHING, *range(n, n_all)], n).tolist()),
        tuple(tuple(e != a and rng.random() < 0.2 for e in range(n_all)) for a in range(n)),
        tuple(int(rng.choice(there[room])) for room in rooms),
    )


SCENES = {
    "shut": scene(walls=BLUE_ROOM_SHUT),
    "half": scene(walls=[FULL_WALL_UP, NARROW_WALL_DOWN]),
    "solo": ppl.worlds.SOLO.random_scene(0),
    "trio": ppl.worlds.TRIO.random_scene(3),
}


@pytest.mark.parametrize("name", SCENES)
def test_operators_are_those_of_the_planner_for_bodies_that_can_do_everything(name: str) -> None:
    where, rng = SCENES[name], np.random.default_rng(0)
    layout, n = Layout.of(where), len(where.world.agents)
    doors = (True,) * len(where.rooms.door_width)
    able = dataclasses.replace(
        Abilities.of(where, (math.inf,) * n),
        passes=(doors,) * len(where.world.entities),
        fills=(tuple(not door for door in doors),) * len(where.world.items),
    )
    for _ in range(80):
        given = anything(rng, where, layout)
        touched = int(rng.integers(-1, len(given.rooms)))
        near = tuple(e == touched != 0 for e in range(len(given.rooms)))
        given = given._replace(near=(near, *given.near[1:]))
        at = (touched if touched > 0 else NOTHING,) * n
        usual = [layout.landmark_in[room] for room in given.rooms]
        placed = tuple(a == b != NOTHING for a, b in zip(given.on, usual, strict=True))
        node = Node(given.rooms, given.held, at, placed, (NOTHING,) * len(where.world.items))
        planned = moves(node, 0, (0,), frozenset(range(len(given.rooms))), able)
        expected = {one.literal: (one.cost, *one.result[:2], one.result.near[0]) for one in planned}
        found = {
            literal: (cost, *after[:2], next((e for e, yes in enumerate(after.near[0]) if yes), -1))
            for literal, cost, after in operators(given, 0, layout)
        }
        assert found == expected


def is_done(goal: Literal, agent: int, now: Moment, start: Moment, layout: Layout) -> bool:
    """Whether a goal is reached, by the table of :class:`CostToGo`."""
    subject, target, touch = goal.subject, goal.target, goal.predicate is PredicateKind.TOUCH
    moved = target if touch and subject != agent else subject
    if moved >= layout.n_agents and goal.positive:
        return now.rooms[moved] == now.rooms[subject] if touch else now.on[moved] == target
    if agent != subject and moved < layout.n_agents:
        return goal.positive or now.near[agent][subject]
    if goal.positive:
        return now.near[agent][target] if touch else now.on[agent] == target
    mover = agent if moved < layout.n_agents else moved
    from_room = layout.landmark_rooms[target] if not touch else NOTHING
    if touch:
        from_room = start.rooms[target if mover == agent else subject]
    within = [room for room, way in enumerate(layout.way[start.rooms[mover]]) if way < math.inf]
    far = max(layout.distance[from_room][room] for room in within)
    there = layout.distance[from_room][now.rooms[mover]] >= far - 1e-6
    return there and mover in (agent, now.held[agent])


def searched(goal: Literal, agent: int, start: Moment, layout: Layout) -> float:
    """Return the cost of the cheapest plan, by a search over what has to do with the goal."""
    about = {agent, goal.subject, *[goal.target] * (goal.predicate is PredicateKind.TOUCH)}
    best, frontier, number = {start: 0.0}, [(0.0, 0, start)], itertools.count(1)
    while frontier:
        cost, _, now = heapq.heappop(frontier)
        if is_done(goal, agent, now, start, layout):
            return cost
        for literal, more, after in operators(now, agent, layout):
            grips = (
                literal.predicate in (PredicateKind.TOUCH, PredicateKind.ATTACH)
                and literal.positive
            )
            serves = (literal.target if grips else literal.subject) in about
            if serves and cost + more < best.get(after, math.inf):
                best[after] = cost + more
                heapq.heappush(frontier, (cost + more, next(number), after))
    return math.inf


@pytest.mark.parametrize("name", SCENES)
def test_what_is_left_to_do_is_the_cheapest_way_to_do_it(name: str) -> None:
    where, rng = SCENES[name], np.random.default_rng(1)
    layout, world = Layout.of(where), where.world
    for goal in rng.permutation(len(world.goals))[:60].tolist():
        agent = int(rng.integers(len(world.agents)))
        if goal not in possible_goals(agent, world):
            continue
        left = CostToGo(layout, agent, literal := goal_literal(goal, agent, world))
        given = anything(rng, where, layout)
        own = (held if a == agent else NOTHING for a, held in enumerate(given.held))
        expected = searched(literal, agent, given._replace(held=tuple(own)), left.layout)
        assert left(given) == pytest.approx(expected), (world.goals[goal], agent, given)


def states(poses: Any, **changes: Any) -> Any:
    trajectory = np.asarray(poses, float)
    where = scene(red=tuple(trajectory[0, 0]), walls=changes.pop("walls", []))
    return symbolic_trajectory(where, Observation(trajectory), PredicateSettings(**changes))


def still(n: int = 8) -> np.ndarray:
    return np.repeat(scene().start[None], n, axis=0)


def test_an_item_that_stays_in_front_of_its_holder_is_attached() -> None:
    poses = still(10)
    poses[:, 0, 0] += 0.4 * np.arange(10)
    poses[:, 0, 2] = -math.pi / 2
    poses[:, 2, :2] = poses[:, 0, :2] + [1.6, 0.0]
    assert {state.held for state in states(poses)} == {(2, NOTHING)}
    poses[:, 2, 0] += 0.3
    assert {state.held for state in states(poses)} == {(NOTHING, NOTHING)}


def test_items_are_in_reach_and_rooms_are_as_for_the_planner() -> None:
    rng = np.random.default_rng(0)
    n = 40
    poses = np.repeat(scene(walls=[FULL_WALL_UP]).start[None], n, axis=0)
    poses[:, :, :2] = rng.uniform([7, 13], [11, 17], (n, 4, 2))  # all in one room
    poses[:, :2, 2] = rng.uniform(-3, 3, (n, 2))
    where = scene(walls=[FULL_WALL_UP])
    model = WorldModel.of(where, (450.0, 450.0), PlannerConfig())
    facts, costs = np.zeros((n, Facts(4, 2).size), np.int8), np.zeros((1, n))
    held = np.full((n, 2), NOTHING)
    bodies = np.array(
        [
            compiled.from_state(
                State(pose, np.zeros((4, 2)), np.zeros(4), held[0], np.zeros((2, 3))), where.radius
            )[0]
            for pose in poses
        ]
    )
    goal, done = np.array([[0, 0, 0, 1]]), np.zeros((1, n), np.bool_)
    whole = np.zeros(1, np.bool_)
    describe(bodies, held, 0, goal, whole, model.params, model.layout, facts, done, costs)
    found = symbolic_trajectory(
        where, Observation(poses), PredicateSettings(touch_item=GRAB_REACH, lasting=1)
    )
    near = [[*state.near[0][2:], *state.near[1][2:]] for state in found]
    assert np.array_equal(near, facts[:, 6:10])
    assert 10 < np.sum(near) < 150
    assert np.array_equal([state.rooms for state in found], facts[:, :4])


PHASE, SOLO, TRIO = ppl.worlds.PHASE, ppl.worlds.SOLO, ppl.worlds.TRIO
THREE = ppl.World(["ann", "bob", "cy"], [], {"home": (3, 3)}, arena=(0, 12, 0, 12), name="three")


def test_two_agents_are_inverted_as_pairs_of_phase_are() -> None:
    likelihood = np.random.default_rng(0).normal(0, 3, (2, len(PHASE.goals)))
    pairs = posterior(likelihood, log_prior_of_pairs("sparse_social"))
    found = marginals(likelihood, prior_in(PHASE, "sparse_social"), PHASE)
    for question, shares in pairs.items():
        np.testing.assert_allclose(found[question], shares, atol=1e-6)


def test_three_agents_are_summed_over_as_if_all_roles_were_listed() -> None:
    likelihood = np.random.default_rng(1).normal(0, 2, (3, len(THREE.goals)))
    prior = prior_in(THREE, "uniform")
    expected = {"goal_ann": np.zeros(len(THREE.goals)), "relation_ann_cy": np.zeros(3)}
    relations: dict[tuple[int, ...], int] = {}
    for number, way in enumerate(all_ways(3)):
        own = [possible_goals(a, THREE) if one is None else [0] for a, one in enumerate(way)]
        for stated in itertools.product(*own):
            goals = tuple(effective_goal(stated, a, one, THREE) for a, one in enumerate(way))
            log_p = prior.alpha[number] + likelihood[range(3), goals].sum()
            log_p += sum(prior.goals[a, stated[a]] for a, one in enumerate(way) if one is None)
            if (goals[0], goals[2]) not in relations:
                roles = Hypothesis.coded(THREE, goals, (None,) * 3, (450.0,) * 3)
                name = roles.relation_between("ann", "cy")
                relations[goals[0], goals[2]] = RELATIONS.index(name)
            expected["goal_ann"][goals[0]] += np.exp(log_p)
            expected["relation_ann_cy"][relations[goals[0], goals[2]]] += np.exp(log_p)
    found = marginals(likelihood, prior, THREE)
    for question, values in expected.items():
        np.testing.assert_allclose(found[question], values / values.sum(), atol=1e-5)
    assert all(shares.sum() == pytest.approx(1) for shares in found.values())


def test_a_delivered_item_tells_the_goal() -> None:
    event = ppl.simulate(
        SOLO.random_scene(1), goals={"red agent": "ball to home"}, frames=60, seed=1, id="solo"
    )
    found = ppl.evaluate([event], "predicate", workers=1, progress=False).predictions["solo"]
    assert found.answers["goal_red"] == "Get ball to home"
