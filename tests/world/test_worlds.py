"""Worlds: any cast, any floor plan, any goals; what cannot be gets one clear line."""

from __future__ import annotations

import dataclasses
import itertools
import math
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.world import worlds
from phase_ppl.world.errors import PhasePPLError, UnknownNameError
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
from phase_ppl.world.hypothesis import Roles
from phase_ppl.world.names import ENTITIES, LANDMARKS
from phase_ppl.world.rooms import Rooms
from phase_ppl.world.scene import PHASE, Scene, World
from phase_ppl.world.worlds import SOLO, TRIO
from tests.world.examples import check_refused

HOUSE: dict[str, Any] = {
    "agents": ["red agent", "green agent"],
    "items": ["ball"],
    "landmarks": {"home": (4.0, 4.0), "field": (30.0, 12.0, 1.5)},
    "arena": (0, 36, 0, 24),
    "walls": [((12, 0), (12, 16)), ((12, 16), (20, 16))],
}


def house(**changes: Any) -> World:
    return World(**{**HOUSE, **changes})


# --- cast, goals ---------------------------------------------------------------------------------


def test_the_papers_world_is_one_among_others() -> None:
    assert list(worlds.available()) == ["PHASE", "solo", "trio"]
    assert PHASE.entities == ENTITIES
    assert PHASE.landmark_names == LANDMARKS
    assert PHASE.goals is GOALS
    assert len(GOALS) == 36


def test_names_goals_and_colours_follow_from_the_cast() -> None:
    world = house(colours={"home": (1, 2, 3)})
    assert world.entities == ("red agent", "green agent", "ball")
    assert world.entity_colours[:2] == ((255, 0, 0), (0, 255, 0))
    assert [(one.name, one.half_width) for one in world.landmarks] == [
        ("home", 2.5),
        ("field", 1.5),
    ]
    assert world.landmarks[0].colour == (1, 2, 3)
    assert len(set(world.entity_colours)) == 3
    goals = [
        *(f"Get {x} {w} {y}" for x, w, y in itertools.product(
            ("ball", "green agent", "red agent"), ("to", "away from"), ("home", "field"))),
        *(f"get {w} {y}" for w in ("away from", "to")
          for y in ("ball", "green agent", "red agent")),
        *(f"Get {x} {w} ball" for x in ("green agent", "red agent") for w in ("to", "away from")),
    ]  # fmt: skip
    assert list(world.goals) == goals


@pytest.mark.parametrize(
    ("said", "goal"),
    [
        ("ball to home", "Get ball to home"),
        ("get the ball away  from the Home", "Get ball away from home"),
        ("touch green agent", "get to green agent"),
        ("get to ball", "get to ball"),
        ("avoid the green agent", "get away from green agent"),
    ],
)
def test_goals_are_read_in_natural_words(said: str, goal: str) -> None:
    world = house()
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


def test_a_world_is_itself_again_in_another_process() -> None:
    scene = TRIO.random_scene(3)
    copy = pickle.loads(pickle.dumps(scene))
    assert copy.world == TRIO
    assert hash(copy.world) == hash(TRIO)
    assert dataclasses.replace(TRIO, name="other") != TRIO
    assert dataclasses.replace(TRIO) == TRIO


@pytest.mark.parametrize("world", [SOLO, TRIO, PHASE], ids=lambda world: world.name)
def test_random_scenes_are_possible_and_follow_the_seed(world: World) -> None:
    for seed in range(5):
        scene = world.random_scene(seed)
        assert deepest_overlap(scene) == ("", 0.0)
        assert np.array_equal(scene.start, world.random_scene(seed).start)
    assert not np.array_equal(scene.start, world.random_scene(99).start)


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


def test_nobody_starts_beside_a_floor_plan_that_does_not_fill_the_arena() -> None:
    world = house(walls=[((20, 10), (36, 10)), ((20, 10), (20, 24))], landmarks={"home": (4, 4)})
    for seed in range(20):
        x, y = world.random_scene(seed).start[:, :2].T
        assert not ((x > 20) & (y > 10)).any()
    told = world.random_scene(0, rooms={"red agent": (30, 20)})
    assert told.rooms.room_of(told.start[0, :2]) == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rooms": {"red": "home"}}, "unknown agent or item 'red'"),
        ({"rooms": {"red agent": "hme"}}, "unknown landmark 'hme'; did you mean 'home'"),
        ({"rooms": {"red agent": 6}}, "room=6, expected at most 5"),
        ({"rooms": {"red agent": (40, 0)}}, r"room of \(40, 0\), which lies outside the arena"),
        ({"near": {"red agent": "hme"}}, "unknown agent, item or landmark 'hme'"),
        ({"near": {"red agent": "pink ball", "pink ball": "red agent"}}, "are near themselves"),
        ({"size": {"red": 1.0}}, "unknown agent or item 'red'"),
        ({"size": 40.0}, r"size of the red agent is 40.0, expected one in \[0.01, 6\]"),
    ],
)
def test_a_random_scene_that_cannot_be_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(PhasePPLError, match=message):
        TRIO.random_scene(0, **options)


# --- floor plans ---------------------------------------------------------------------------------


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


def test_two_gaps_in_one_wall_are_two_doors() -> None:
    rooms = Rooms.from_walls(np.array([[[10.0, 4.0], [10.0, 6.0]]]), (0, 20, 0, 10))
    assert sorted((door.y, door.width) for door in rooms.doors) == [(2.0, 4.0), (8.0, 4.0)]
    assert rooms.route(0, 1) in ((0,), (1,))


def test_paths_lead_through_doors() -> None:
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


@settings(deadline=None, max_examples=60)
@given(walls_anywhere, st.integers(0, 10**6))
def test_paths_are_symmetric_and_cross_no_wall(
    plan: list[tuple[bool, int, int, int]], seed: int
) -> None:
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


# --- what cannot be ------------------------------------------------------------------------------

PLACES = {"red agent": (3, 3), "green agent": (20, 3), "ball": (20, 20)}
WRONG: dict[str, tuple[Any, ...]] = {
    "no agent": (lambda: house(agents=[]), "0 agents, expected 1 to 4"),
    "five agents": (lambda: house(agents=list("abcde")), "5 agents, expected 1 to 4"),
    "seven items": (lambda: house(items=list("abcdefg")), "7 items, expected 0 to 6"),
    "no landmark": (lambda: house(landmarks={}), "0 landmarks, expected 1 to 8"),
    "a text of names": (lambda: house(agents="red agent"), "expected a list of names"),
    "two pairs of names alike": (lambda: house(agents=["a", "a b", "b a"]),
     "'a_b_a' could mean two of them in questions"),
    "two names alike": (lambda: house(items=["Red agent"]), "are called 'red agent'"),
    "an empty name": (lambda: house(items=[" "]), "items has the name ' '"),
    "a name of two": (lambda: house(items=["way to go"]), "without 'to' and 'away from'"),
    "a landmark outside": (lambda: house(landmarks={"home": (40, 4)}),
     "landmark 'home' is at (40, 4), outside the arena x 0..36, y 0..24"),
    "a landmark nowhere": (lambda: house(landmarks={"home": (4, math.nan)}),
     "landmark 'home'[1] is nan"),
    "a landmark too large": (lambda: house(landmarks={"home": (4, 4, 7)}),
     "half-width 7, expected one in (0, 6]"),
    "a landmark of four numbers": (lambda: house(landmarks={"home": (4, 4, 2, 2)}),
     "landmark 'home' is (4, 4, 2, 2), expected (x, y) or (x, y, half the side)"),
    "landmarks without names": (lambda: house(landmarks=[(4, 4)]),
     "landmarks=[(4, 4)], expected a mapping of names to (x, y)"),
    "no landmarks at all": (lambda: house(landmarks=None), "landmarks=None, expected a mapping"),
    "a half-width in words": (lambda: house(half_width="wide"), "has the half-width 'wide'"),
    "colours without names": (lambda: house(colours=[(1, 2, 3)]),
     "colours=[(1, 2, 3)], expected a mapping of names to (red, green, blue)"),
    "touching somebody twice": (lambda: house(touchable=["ball", "ball"]),
     "touchable has 'ball' twice"),
    "a relation without names": (
        lambda: Roles.of(house(), {"red agent": "ball to home"}, "help"),
        "relation='help', expected a mapping of (who, whom) to 'help' or 'hinder'",
    ),
    "an arena of no size": (lambda: house(arena=(0, 0, 0, 24)), "with sides of 4 to 60 units"),
    "a huge arena": (lambda: house(arena=(0, 100, 0, 24)), "with sides of 4 to 60 units"),
    "an arena of three": (lambda: house(arena=(0, 36, 0)), "arena has shape (3,), expected (4,)"),
    "a wall outside": (lambda: house(walls=[((12, 0), (12, 30))]),
     "wall [[12.0, 0.0], [12.0, 30.0]] leaves the arena x 0..36, y 0..24"),
    "a slanted wall": (lambda: house(walls=[((12, 0), (14, 16))]), "is slanted"),
    "a wall of no length": (lambda: house(walls=[((12, 3), (12, 3))]), "has no length"),
    "too many rooms": (
        lambda: house(walls=[((x, 0), (x, 9)) for x in range(1, 36)] + [((0, 9), (1, 9))]),
        "the walls cut the arena into 72 rooms, at most 36",
    ),
    "a colour of nobody": (lambda: house(colours={"bal": (0, 0, 0)}),
     "unknown name with a colour 'bal'; did you mean 'ball'?"),
    "no colour": (lambda: house(colours={"ball": "green"}), "expected (red, green, blue)"),
    "too bright": (lambda: house(colours={"ball": (0, 300, 0)}), "expected at most 255"),
    "touching nobody": (lambda: house(touchable=["boll"]), "unknown agent or item 'boll'"),
    "a goal about nobody": (lambda: house().goal_index("bell to home"),
     "unknown goal 'bell to home'; did you mean 'Get ball to home'"),
    "a goal that nobody can have": (lambda: SOLO.goal_index("get to red agent"), "unknown goal",
     UnknownNameError),
    "nobody's start": (lambda: house().scene(start={**PLACES, "box": (1, 1)}),
     "unknown agent or item 'box'"),
    "no start": (lambda: house().scene(start={"red agent": (3, 3), "ball": (5, 5)}),
     "start has no place for the green agent"),
    "a start outside": (lambda: house().scene(start={**PLACES, "ball": (37, 3)}),
     "the ball is at (37, 3) in frame 0, outside the arena"),
    "a start of one number": (lambda: house().scene(start={**PLACES, "ball": (3,)}),
     "start of the ball has shape (1,), expected (2,)"),
    "somebody too large": (lambda: house().scene(start=PLACES, size={"ball": 9}),
     "sizes must lie in [0.01, 6]"),
    "an item in a closed room": (
        lambda: house(walls=[((12, 0), (12, 24))]).scene(start={**PLACES, "green agent": (4, 20)}),
        "the ball is in a room that walls close to every agent",
    ),
    "a scene of nothing": (lambda: Scene(np.zeros((4, 3)), np.ones(4), world="solo"),
     "world='solo', expected a phase_ppl.World"),
    "no such world": (lambda: worlds.named("duo"), "unknown world 'duo'"),
    "no room for anybody": (
        lambda: World(list("abcd"), list("efghij"), {"home": (2, 2, 1)}, (0, 4, 0, 4)).random_scene(
            0
        ),
        "no place was found for everybody",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_gets_one_clear_line(case: str) -> None:
    check_refused(*WRONG[case])
