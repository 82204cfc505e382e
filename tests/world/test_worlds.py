"""Worlds: any cast, any floor plan, any goals; what cannot be gets one clear line."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.world import worlds
from phase_ppl.world.geometry import deepest_overlap
from phase_ppl.world.goals import (
    GOALS,
    goal_literal,
    is_self_referring,
    is_true,
    literal_goal,
    opposed_goal,
    shared_goal,
)
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import ENTITIES, LANDMARKS
from phase_ppl.world.rooms import Rooms
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.worlds import SOLO, TRIO
from tests.world.examples import check_refused

HOUSE: dict[str, Any] = {
    "agents": ["red agent", "green agent"],
    "items": ["ball"],
    "landmarks": {"home": (4.0, 4.0), "field": (30.0, 12.0, 1.5)},
    "arena": (0, 36, 0, 24),
    "walls": [((12, 0), (12, 16)), ((12, 16), (20, 16))],
}


SQUARES = {"home": 2.5, "field": 1.5}


def house(**changes: Any) -> World:
    return World(**{**HOUSE, **changes})


def test_names_goals_and_colours_follow_from_the_cast() -> None:
    assert list(worlds.available()) == ["PHASE", "solo", "trio"]
    assert (PHASE.entities, PHASE.landmark_names, PHASE.goals) == (ENTITIES, LANDMARKS, GOALS)
    world = house(colours={"home": (1, 2, 3)})
    assert world.entities == ("red agent", "green agent", "ball")
    assert world.entity_colours[:2] == ((255, 0, 0), (0, 255, 0))
    assert [(mark.name, mark.half_width) for mark in world.landmarks] == [*SQUARES.items()]
    assert world.landmarks[0].colour == (1, 2, 3)
    assert len(set(world.entity_colours)) == 3
    assert list(world.goals) == [
        *(f"Get {x} {w} {y}" for x, w, y in itertools.product(
            ("ball", "green agent", "red agent"), ("to", "away from"), ("home", "field"))),
        *(f"get {w} {y}" for w in ("away from", "to")
          for y in ("ball", "green agent", "red agent")),
        *(f"Get {x} {w} ball" for x in ("green agent", "red agent") for w in ("to", "away from")),
    ]  # fmt: skip
    # which are read in natural words
    for said, goal in (
        ("ball to home", "Get ball to home"),
        ("get the ball away  from the Home", "Get ball away from home"),
        ("touch green agent", "get to green agent"),
        ("avoid the green agent", "get away from green agent"),
    ):
        assert world.goals[world.goal_index(said)] == goal


@pytest.mark.parametrize("world", [SOLO, TRIO, house(), PHASE], ids=lambda world: world.name)
def test_every_goal_of_an_agent_is_one_literal_and_back(world: World) -> None:
    for holder in range(len(world.agents)):
        own = [g for g in range(len(world.goals)) if not is_self_referring(g, holder, world)]
        literals = [goal_literal(goal, holder, world) for goal in own]
        assert len(set(literals)) == len(own)
        assert [literal_goal(literal, holder, world) for literal in literals] == own


def test_who_helps_wants_the_same_state_of_the_world_and_who_hinders_the_opposite() -> None:
    red, green, purple = range(3)
    for goal in range(len(TRIO.goals)):
        if is_self_referring(goal, red, TRIO):
            continue
        ends = goal_literal(goal, red, TRIO)
        for other in (green, purple):
            helped = goal_literal(shared_goal(goal, red, other, TRIO), other, TRIO)
            assert {*helped[1:3], helped.predicate} == {*ends[1:3], ends.predicate}
            assert helped.positive is ends.positive
            hindered = goal_literal(opposed_goal(goal, red, other, TRIO), other, TRIO)
            assert hindered == helped.negated()


def test_truth_of_a_goal_is_told_from_the_poses() -> None:
    scene = TRIO.scene(
        {"red agent": (5, 5), "green agent": (7.2, 5), "purple agent": (30, 3),
         "blue ball": (29.9, 6), "pink ball": (15, 20)}, size={"purple agent": 0.8}
    )  # fmt: skip

    def holds(goal: str, holder: int) -> bool:
        literal = goal_literal(goal, holder, TRIO)
        return is_true(literal, scene.start, scene)

    assert holds("get to green agent", 0)
    assert not holds("get to green agent", 2)
    assert holds("Get green agent to red agent", 2)
    assert holds("Get red agent to home", 2)
    assert not holds("Get blue ball to pond", 2)  # its square is smaller: 29.9 < 32 - 2
    assert holds("Get blue ball away from barn", 0)


@pytest.mark.parametrize("world", [SOLO, TRIO, PHASE], ids=lambda world: world.name)
def test_random_scenes_are_possible_and_follow_the_seed_in_any_process(world: World) -> None:
    for seed in range(5):
        scene = world.random_scene(seed)
        assert deepest_overlap(scene) == ("", 0.0)
        assert np.array_equal(scene.start, world.random_scene(seed).start)
    assert not np.array_equal(scene.start, world.random_scene(99).start)
    copy = pickle.loads(pickle.dumps(scene))
    assert copy.world == dataclasses.replace(world) == world
    assert hash(copy.world) == hash(world)
    assert dataclasses.replace(world, name="other") != world


def test_a_random_scene_has_everybody_where_it_is_said() -> None:
    rooms = TRIO.random_scene(0).rooms
    for seed in range(8):
        scene = TRIO.random_scene(
            seed,
            rooms={"red agent": "home", "blue ball": (18, 20), "green agent": 5},
            near={"pink ball": "blue ball", "purple agent": "field"},
            size={"red agent": 0.9},
        )
        start = dict(zip(TRIO.entities, scene.start[:, :2], strict=True))
        number = {name: int(rooms.room_of(place)) for name, place in start.items()}
        assert number["red agent"] == rooms.room_of(np.array([4.0, 4.0]))
        assert number["blue ball"] == number["pink ball"] == rooms.room_of(np.array([18.0, 20.0]))
        assert number["green agent"] == 5
        assert number["purple agent"] == rooms.room_of(np.array([32.0, 20.0]))
        gap = np.linalg.norm(start["blue ball"] - start["pink ball"]) - scene.radius[3:].sum()
        assert 0 <= gap <= 2
        assert scene.radius[0] == 0.9
    assert sorted(rooms.borders(room) for room in range(6))[0] == (0.0, 12.0, 0.0, 12.0)
    # nobody starts beside a floor plan that does not fill the arena, unless it is told to
    world = house(walls=[((20, 10), (36, 10)), ((20, 10), (20, 24))], landmarks={"home": (4, 4)})
    for seed in range(20):
        x, y = world.random_scene(seed).start[:, :2].T
        assert not ((x > 20) & (y > 10)).any()
    told = world.random_scene(0, rooms={"red agent": (30, 20)})
    assert told.rooms.room_of(told.start[0, :2]) == 1


def test_rooms_are_the_cells_between_walls_and_doors_the_gaps() -> None:
    rooms = TRIO.random_scene(0).rooms
    assert rooms.ids[::-1].tolist() == [[0, 1, 2], [5, 4, 3]]
    open_doors = {door.rooms: (door.x, door.y, door.width) for door in rooms.doors if door.width}
    assert open_doors == {
        (0, 1): (12.0, 18.5, 5.0),
        (1, 2): (24.0, 18.5, 5.0),
        (4, 5): (12.0, 5.5, 5.0),
        (3, 4): (24.0, 5.5, 5.0),
        (0, 5): (6.5, 12.0, 5.0),
        (2, 3): (29.5, 12.0, 5.0),
    }
    assert [door.rooms for door in rooms.doors if not door.width] == [(1, 4)]


def test_two_gaps_are_two_doors_and_paths_lead_through_doors() -> None:
    rooms = Rooms.from_walls(np.array([[[10.0, 4.0], [10.0, 6.0]]]), (0, 20, 0, 10))
    assert sorted((door.y, door.width) for door in rooms.doors) == [(2.0, 4.0), (8.0, 4.0)]
    assert rooms.route(0, 1) in ((0,), (1,))
    rooms = TRIO.random_scene(0).rooms
    upper, lower = np.array([18.0, 15.0]), np.array([18.0, 9.0])
    around = [upper, [12, 18.5], [6.5, 12], [12, 5.5], lower]
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(around))
    assert rooms.path_distance(upper, lower) == pytest.approx(length)
    assert rooms.path_distance(upper, np.array([13.0, 23.0])) == pytest.approx(math.hypot(5, 8))


walls_anywhere = st.lists(
    st.tuples(
        st.booleans(), st.integers(1, 9), st.integers(0, 9), st.integers(1, 10)
    ).map(lambda w: (w[0], w[1], min(w[2], w[3]), max(w[2], w[3] + (w[2] >= w[3])))),
    max_size=4,
)  # fmt: skip


@settings(max_examples=30)
@given(walls_anywhere, st.integers(0, 10**6))
def test_paths_cross_no_wall_either_way(plan: list[tuple[bool, int, int, int]], seed: int) -> None:
    walls = np.array(
        [[[at, low], [at, high]] if up else [[low, at], [high, at]] for up, at, low, high in plan],
        float,
    ).reshape(-1, 2, 2)
    rooms = Rooms.from_walls(walls.clip(0, 10), (0, 10, 0, 10))
    start, end = np.random.default_rng(seed).uniform(0, 10, (2, 2))
    there = rooms.path_distance(start, end)
    assert there == pytest.approx(rooms.path_distance(end, start))
    assert there >= math.dist(start, end) - 1e-9
    doors = rooms.route(int(rooms.room_of(start)), int(rooms.room_of(end)))
    if doors is None:
        return
    points = [start, *rooms.door_position[list(doors)], end]
    for one, other in itertools.pairwise(points):
        for share in np.linspace(0.01, 0.99, 25):
            x, y = one + share * (other - one)
            for (ax, ay), (bx, by) in walls:
                through = abs(x - ax) < 1e-9 if ax == bx else abs(y - ay) < 1e-9
                along = min(ay, by) < y < max(ay, by) if ax == bx else min(ax, bx) < x < max(ax, bx)
                assert not (through and along)


PLACES = {"red agent": (3, 3), "green agent": (20, 3), "ball": (20, 20)}
WRONG: list[tuple[dict[str, Any], str]] = [
    ({"agents": []}, "0 agents, expected 1 to 4"),
    ({"items": list("abcdefg")}, "7 items, expected 0 to 6"),
    ({"items": ["Red agent"]}, "are called 'red agent'"),
    ({"landmarks": {"home": (4, math.nan)}}, "landmark 'home'[1] is nan"),
    ({"landmarks": {"home": (4, 4, 2, 2)}},
     "landmark 'home' is (4, 4, 2, 2), expected (x, y) or (x, y, half the side)"),
    ({"touchable": ["ball", "ball"]}, "touchable has 'ball' twice"),
    ({"arena": (0, 100, 0, 24)}, "with sides of 4 to 60 units"),
    ({"walls": [((12, 0), (12, 30))]},
     "wall [[12.0, 0.0], [12.0, 30.0]] leaves the arena x 0..36, y 0..24"),
    ({"walls": [((12, 3), (12, 3))]}, "has no length"),
    ({"colours": {"ball": (0, 300, 0)}}, "expected at most 255"),
]  # fmt: skip
WRONG_USE: list[tuple[Callable[[], object], str]] = [
    (lambda: Hypothesis.of(house(), {"red agent": "ball to home"}, "help"),  # type: ignore[arg-type]
     "relation='help', expected {('red agent', 'green agent'): 'help'} or 'hinder'"),
    (lambda: house().goal_index("bell to home"),
     "unknown goal 'bell to home'; did you mean 'Get ball to home'"),
    (lambda: house().scene(start={**PLACES, "box": (1, 1)}), "unknown agent or item 'box'"),
    (lambda: house().scene(start={**PLACES, "ball": (37, 3)}),
     "the ball is at (37, 3) in frame 0, outside the arena"),
    (lambda: house().scene(start=PLACES, size={"ball": 9}), "sizes must lie in [0.01, 6]"),
    (lambda: house(walls=[((12, 0), (12, 24))]).scene(start={**PLACES, "green agent": (4, 20)}),
     "the ball is in a room that walls close to every agent"),
    (lambda: worlds.named("duo"), "unknown world 'duo'"),
    (lambda: World(list("abcd"), list("efghij"), {"home": (2, 2, 1)}, (0, 4, 0, 4)).random_scene(0),
     "no place was found for everybody"),
]  # fmt: skip
RANDOM: list[tuple[dict[str, Any], str]] = [
    ({"rooms": {"red agent": "hme"}}, "unknown landmark 'hme'; did you mean 'home'"),
    ({"rooms": {"red agent": 6}}, "room=6, expected at most 5"),
    ({"near": {"red agent": "pink ball", "pink ball": "red agent"}}, "are near themselves"),
    ({"size": 40.0}, "size of the red agent is 40.0, expected one in [0.01, 6]"),
]


def test_what_cannot_be_gets_one_clear_line() -> None:
    for changes, message in WRONG:
        check_refused(functools.partial(house, **changes), message)
    for use, message in WRONG_USE:
        check_refused(use, message)
    for options, message in RANDOM:
        check_refused(functools.partial(TRIO.random_scene, 0, **options), message)
