"""Facts about walls, doors and bodies that push each other."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from phase_ppl.physics.actions import N_ACTIONS, Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.geometry import agent_outline, rotation

WAIT, UP = Action.NO_FORCE, Action.UP
DOOR = [[[16, 12], [16, 19.5]]]
"""A wall of length 7.5 leaves a door of width 2.5 in the middle of which y = 20.75."""

FULL_ROOMS = [
    [[16, 12], [16, 22]],
    [[16, 12], [8.5, 12]],
    [[16, 12], [16, 4.5]],
    [[16, 12], [21, 12]],
]


def drive_through_door(engine: Any, steps: int = 40) -> float:
    """Keep the red agent going right, straight ahead; return the largest x it reaches."""
    x = -math.inf
    for _ in range(steps):
        engine.step((UP, WAIT))
        x = max(x, engine.state.pose[0, 0])
    return x


@pytest.mark.parametrize(
    ("size", "passes"), [(0.8, True), (1.01, False), (1.2, False), (1.6, False)]
)
@pytest.mark.parametrize("strength", [300.0, 600.0])
def test_only_the_smallest_agent_drives_straight_through_the_narrow_door(
    world: Any, make_scene: Any, size: float, passes: bool, strength: float
) -> None:
    y = min(20.75, 21.97 - 1.5 * size)
    for x in (9.0, 10.5, 12.0):
        scene = make_scene({0: (x, y, -math.pi / 2), 1: (8, 14)}, {0: size}, DOOR)
        farthest = drive_through_door(world(scene, (strength, 150.0)))
        # one that is stuck has its front in the door and its base before it
        assert farthest > 19.0 if passes else farthest < 17.0


@pytest.mark.parametrize("entity", [0, 2])
@pytest.mark.parametrize("size", [0.8, 1.01, 1.2, 1.6])
def test_sideways_and_round_all_but_the_largest_pass_the_narrow_door(
    world: Any, make_scene: Any, moving: Any, entity: int, size: float
) -> None:
    y = 20.75 if size < 1.25 else 20.3
    out_of_the_way = {1: (8, 14)} if entity == 0 else {0: (8, 14)}
    scene = make_scene({entity: (11, y, 0.0), **out_of_the_way}, {entity: size}, DOOR)
    engine = world(scene, (600.0, 150.0), initial=moving(scene, entity, (30.0, 0.0)))
    x = max(engine.step((WAIT, WAIT))[entity, 0] for _ in range(30))
    assert (x > 16.5) == (size < 1.6)


def test_contacts_neither_bounce_nor_rub(world: Any, make_scene: Any, moving: Any) -> None:
    scene = make_scene({2: (10, 21.0)})
    engine = world(scene, (150.0, 150.0), initial=moving(scene, 2, (15.0, 20.0)))
    free_scene = make_scene({2: (10, 12)})
    free = world(free_scene, (150.0, 150.0), initial=moving(free_scene, 2, (15.0, 0.0)))
    for _ in range(2):
        engine.step((WAIT, WAIT))
        free.step((WAIT, WAIT))
    state = engine.state
    assert state.velocity[2, 1] == pytest.approx(0.0, abs=1e-6)
    # along the wall only the floor brakes, a little less while part of its force goes sideways
    assert state.velocity[2, 0] == pytest.approx(free.state.velocity[2, 0], abs=1.0)
    assert state.spin[2] == pytest.approx(0.0, abs=1e-12)


def test_agent_pushes_an_item_ahead(world: Any, make_scene: Any) -> None:
    engine = world(make_scene({0: (16, 5), 2: (16, 7)}), (450.0, 150.0))
    for _ in range(6):
        engine.step((UP, WAIT))
    state = engine.state
    gap = state.pose[2, 1] - state.pose[0, 1] - 1.6
    assert state.pose[2, 1] > 9.0
    assert abs(gap) < 0.05
    # 450 N less the friction of both drive both masses
    assert state.velocity[2, 1] == pytest.approx(state.velocity[0, 1], rel=0.02)


def test_agents_stand_against_each_other_with_equal_force(world: Any, make_scene: Any) -> None:
    scene = make_scene({0: (16, 10), 1: (16, 11.62, math.pi)})
    engine = world(scene, (450.0, 450.0))
    for _ in range(10):
        engine.step((UP, UP))
    assert engine.state.pose[:2] == pytest.approx(scene.start[:2], abs=0.05)


def test_item_that_starts_on_an_agent_leaves_it_to_the_right(world: Any, make_scene: Any) -> None:
    for angle in (0.0, 0.7, -2.5):
        scene = make_scene({1: (16, 12, angle), 3: (16, 12)})
        engine = world(scene, (150.0, 150.0))
        for _ in range(3):
            engine.step((WAIT, WAIT))
        offset = (engine.state.pose[3, :2] - engine.state.pose[1, :2]) @ rotation(angle)
        assert offset[0] > 1.0


@pytest.mark.parametrize("pair", [(0, 1), (0, 2), (1, 3), (2, 3)])
@pytest.mark.parametrize("turned", [0.0, 0.4, math.pi])
def test_bodies_that_start_on_the_same_spot_are_pushed_apart(
    world: Any, make_scene: Any, pair: tuple[int, int], turned: float
) -> None:
    a, b = pair
    engine = world(make_scene({a: (16, 12), b: (16, 12, turned)}), (150.0, 150.0))
    for _ in range(4):
        engine.step((WAIT, WAIT))
    state = engine.state
    assert np.isfinite(state.pose).all()
    assert np.linalg.norm(state.pose[a, :2] - state.pose[b, :2]) > 1.3


@pytest.mark.parametrize(
    ("engine", "inner_steps", "runs"),
    [("pymunk", 4, 6), ("pymunk", 1, 6), ("compiled", 4, 150), ("compiled", 1, 150)],
)
def test_nothing_leaves_the_arena_in_random_runs(
    engine: str, inner_steps: int, runs: int, compiled_world: Any, make_scene: Any
) -> None:
    rng = np.random.default_rng(3)
    world = {"pymunk": PymunkWorld, "compiled": compiled_world}[engine]
    for _ in range(runs):
        poses = np.column_stack([rng.uniform((8, 4), (24, 20), (4, 2)), rng.uniform(-4, 4, 4)])
        sizes = dict(enumerate(rng.choice([0.8, 1.01, 1.2, 1.6], 4)))
        scene = make_scene(dict(enumerate(poses.tolist())), sizes, FULL_ROOMS)
        running = world(scene, (600.0, 600.0), inner_steps)
        # actions that last build up the highest speeds
        actions = np.repeat(rng.integers(0, N_ACTIONS, (12, 2)), 5, axis=0)
        for red, green in actions:
            running.step((red, green))
            pose = running.state.pose
            assert (pose[:, :2] > (6.0, 2.0)).all()
            assert (pose[:, :2] < (26.0, 22.0)).all()
            # a corner can get into the border as far as a fast body moves in an inner step
            for agent in range(2):
                outline = agent_outline(pose[agent], scene.radius[agent])
                assert (outline > (4.5, 0.5)).all()
                assert (outline < (27.5, 23.5)).all()


def test_compiled_model_survives_impossible_states(compiled_world: Any, make_scene: Any) -> None:
    rng = np.random.default_rng(4)
    scene = make_scene({}, {0: 1.6, 2: 1.6}, FULL_ROOMS)
    for _ in range(200):
        running = compiled_world(scene, (600.0, 600.0))
        running.bodies[:, :2] = rng.uniform((0, -4), (32, 28), (4, 2))
        if rng.random() < 0.3:
            running.bodies[:, :2] = running.bodies[0, :2]
        running.bodies[:, 3:6] = rng.normal(0, 100, (4, 3))
        running.held[:] = rng.integers(-1, 2, 2) * 2 + (rng.random(2) < 0.5)
        running.held[running.held < 2] = -1
        running.weld[:] = rng.normal(0, 2, (2, 3))
        for red, green in rng.integers(-1, N_ACTIONS, (20, 2)):
            running.step((red, green))
        assert np.isfinite(running.bodies).all()
