"""Predicates of one's own: names, truth and distance, how they are planned, and what cannot be."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from phase_ppl.world.errors import PhasePPLError
from phase_ppl.world.goals import (
    goal_literal,
    is_true,
    literal_goal,
    opposed_goal,
    planned_as,
    possible_goals,
    shared_goal,
)
from phase_ppl.world.names import Literal, PredicateKind
from phase_ppl.world.predicates import Predicate
from phase_ppl.world.scene import PHASE, Scene, World
from tests.world.examples import check_refused

OWN = (
    Predicate("toys together", "ball", "doll", within=4),
    Predicate("ball in the playroom", "ball", room=(18, 14)),
    Predicate("agents near", "red agent", "green agent", within=5),
    Predicate("agents apart", "red agent", "green agent", beyond=14),
    Predicate("doll near the cot", "doll", "cot", within=3),
)
START = {"red agent": (6, 15), "green agent": (18, 6), "ball": (4, 10), "doll": (9, 5)}


def nursery(*own: Predicate, **changes: Any) -> World:
    given: dict[str, Any] = {
        "agents": ["red agent", "green agent"],
        "items": ["ball", "doll"],
        "landmarks": {"cot": (4, 4), "window": (20, 16)},
        "arena": (0, 24, 0, 20),
        "walls": [((12, 0), (12, 7)), ((12, 13), (12, 20))],
        "predicates": list(own),
    }
    return World(**{**given, **changes})


def scene_of(*own: Predicate, **changes: Any) -> Scene:
    return nursery(*own, **changes).scene(start=START, size=0.8)


def test_a_predicate_and_its_negation_come_after_the_goals_of_the_cast() -> None:
    world, without = nursery(*OWN), nursery()
    names = [name for one in OWN for name in (one.name, f"not {one.name}")]
    assert world.goals == (*without.goals, *names)
    assert world.goal_index("the toys  Together") == world.goals.index("toys together")
    assert "predicates" not in PHASE.to_dict()
    back = World.from_dict(json.loads(json.dumps(world.to_dict())))
    assert back == world == pickle.loads(pickle.dumps(world))
    assert hash(back) == hash(world) != hash(without)


def test_literals_of_ones_own_are_of_one_goal_whoever_holds_it() -> None:
    world = nursery(*OWN)
    for holder in range(2):
        for goal in range(len(world.goals)):
            if goal in possible_goals(holder, world):
                literal = goal_literal(goal, holder, world)
                assert literal_goal(literal, holder, world) == goal
    yes, no = (world.goals.index(name) for name in ("agents near", "not agents near"))
    assert shared_goal(yes, 0, world=world) == yes
    assert opposed_goal(yes, 0, world=world) == no
    assert opposed_goal(no, 1, world=world) == yes
    assert world.words(goal_literal(no, 0, world)) == "not agents near"


def test_what_an_agent_plans_is_of_the_predicates_of_all_worlds() -> None:
    scene = scene_of(*OWN)

    def plan(goal: str, holder: int) -> Literal:
        return planned_as(goal_literal(goal, holder, scene.world), holder, scene)

    room = int(scene.rooms.room_of(np.array([18, 14])))
    assert plan("toys together", 0) == Literal(PredicateKind.TOUCH, 3, 2)
    assert plan("not ball in the playroom", 1) == Literal(PredicateKind.CLOSE, 2, room, False)
    assert plan("agents near", 0) == Literal(PredicateKind.TOUCH, 0, 1)
    assert plan("agents near", 1) == Literal(PredicateKind.TOUCH, 1, 0)
    assert plan("agents apart", 0) == Literal(PredicateKind.TOUCH, 0, 1, False)
    assert plan("not agents apart", 0) == Literal(PredicateKind.TOUCH, 0, 1)
    assert plan("doll near the cot", 0) == Literal(PredicateKind.ON, 3, 0)


def test_distances_are_ways_through_doors() -> None:
    scene = scene_of(*OWN)
    poses = np.stack([scene.start] * 3)
    poses[1, 2, :2] = 9, 8  # the ball beside the doll
    poses[2, 2, :2], poses[2, 3, :2] = (13, 3), (11, 3)  # a wall between the two
    together, playroom, near, apart, _ = OWN
    ways = together.apart(poses, scene)
    assert ways == pytest.approx([scene.rooms.path_distance(p[2, :2], p[3, :2]) for p in poses])
    assert ways[2] > 10
    assert together.holds(poses, scene).tolist() == [False, True, False]
    assert together.distance(poses, scene) == pytest.approx([ways[0] - 4, 0, ways[2] - 4])
    assert playroom.holds(poses, scene).tolist() == [False, False, True]
    assert playroom.apart(poses, scene) == pytest.approx([8, np.hypot(3, 2), 0])
    assert near.holds(poses, scene).tolist() == [False] * 3
    assert apart.holds(poses, scene).tolist() == [True] * 3
    assert not playroom.is_content(np.array([[12.5, 10]] * 4), scene)  # in its door
    for goal, true in (("toys together", True), ("not toys together", False)):
        assert is_true(goal_literal(goal, 0, scene.world), poses[1], scene) is true


def _read(**fields: Any) -> World:
    return World.from_dict({**nursery().to_dict(), "predicates": [fields]})


WRONG: list[tuple[Callable[[], object], str]] = [
    (lambda: Predicate("x", "ball", "doll"), "predicate 'x' has no limit"),
    (lambda: Predicate("x", "ball", "doll", within=3, beyond=4),
     "has within and beyond, expected one of within, beyond and room"),
    (lambda: nursery(lambda state: True), "expected a list of ppl.Predicate"),
    (lambda: nursery(Predicate("x", "bell", "doll", within=3)),
     "unknown subject of predicate 'x' 'bell'; did you mean 'ball'"),
    (lambda: nursery(Predicate("x", "ball", "ball", within=3)),
     "has 'ball' as subject and target"),
    (lambda: nursery(Predicate("x", "ball", room=(30, 3))),
     "room=(30, 3) lies outside the arena"),
    (lambda: nursery(OWN[0], OWN[0]), "two goals are called 'toys together'"),
    (lambda: scene_of(OWN[1], walls=()),
     "'ball in the playroom' is about a room, and the scene has one only"),
    (lambda: scene_of(Predicate("x", "ball", "doll", within=1.7)),
     "1.7 units are too few for bodies that touch at 1.6; expected 2 or more"),
    (lambda: _read(name="x", subject="ball", holds="__import__('os').abort()"),
     "unknown field of a predicate 'holds'"),
]  # fmt: skip


def test_what_cannot_be_gets_one_clear_line() -> None:
    for make, message in WRONG:
        check_refused(make, message)


def test_random_scenes_have_sizes_that_leave_every_goal_possible() -> None:
    near = nursery(Predicate("toys together", "ball", "doll", within=3))  # larger ones touch at 3.2
    for seed in range(10):
        scene = near.random_scene(seed)
        assert scene.radius[2:].sum() <= 2.5
    with pytest.raises(PhasePPLError, match="'toys together': 3 units are too few"):
        near.random_scene(0, size=1.6)
