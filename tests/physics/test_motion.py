"""Facts about free motion: driving, coasting, turning, stopping."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from phase_ppl.physics import compiled, constants
from phase_ppl.physics.actions import ACTION_NAMES, DIRECTIONS, N_ACTIONS, NO_ACTION, Action
from phase_ppl.physics.flat import ANGLE
from phase_ppl.physics.pymunk_world import PymunkWorld, mean_pose
from phase_ppl.physics.welds import turn_frame
from phase_ppl.world.event import State

SIZES = (0.8, 1.01, 1.2, 1.6)
STRENGTHS = (150.0, 300.0, 450.0, 600.0)
WAIT = Action.NO_FORCE


def test_actions_have_the_names_and_order_of_the_recorded_data() -> None:
    names = (
        "turnleft turnright up down left right upleft upright downleft downright "
        "stop noforce attach detach"
    )
    assert " ".join(ACTION_NAMES) == names
    assert N_ACTIONS == 14
    assert NO_ACTION not in list(Action)


def test_directions_are_unit_vectors_of_the_body_frame() -> None:
    assert DIRECTIONS[Action.UP].tolist() == [0.0, 1.0]
    assert DIRECTIONS[Action.LEFT].tolist() == [-1.0, 0.0]
    assert DIRECTIONS[Action.DOWN_RIGHT].tolist() == [0.707, -0.707]
    pushes = np.linalg.norm(DIRECTIONS[Action.UP : Action.STOP], axis=1)
    assert pushes == pytest.approx(1.0, abs=2e-4)
    others = [a for a in Action if not Action.UP <= a <= Action.DOWN_RIGHT]
    assert not DIRECTIONS[others].any()


@pytest.mark.parametrize("strength", STRENGTHS)
@pytest.mark.parametrize("size", SIZES)
def test_driving_straight_accelerates_by_force_less_friction(
    world: Any, make_scene: Any, size: float, strength: float
) -> None:
    scene = make_scene({0: (16, 5)}, {0: size})
    engine = world(scene, (strength, 150.0))
    engine.step((Action.UP, WAIT))
    acceleration = (strength - 100.0) / (4.0 * size**2)
    assert engine.state.velocity[0] == pytest.approx([0.0, acceleration / 12.0], abs=1e-9)
    assert engine.state.pose[0, 2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("entity", [0, 2])
def test_coasting_bodies_are_braked_by_a_hundred_newtons_whatever_their_mass(
    world: Any, make_scene: Any, moving: Any, entity: int, size: float
) -> None:
    scene = make_scene({entity: (16, 8)}, {entity: size})
    engine = world(scene, (450.0, 450.0), initial=moving(scene, entity, (0.0, 10.0)))
    engine.step((WAIT, WAIT))
    mass = (4.0 if entity == 0 else math.pi) * size**2
    assert engine.state.velocity[entity, 1] == pytest.approx(10.0 - 100.0 / mass / 12.0, abs=1e-9)
    for _ in range(30):
        engine.step((WAIT, WAIT))
    assert np.abs(engine.state.velocity[entity]).max() == 0.0


@pytest.mark.parametrize(("size", "turn"), [(0.8, 1.06), (1.01, 0.66), (1.2, 0.47), (1.6, 0.26)])
@pytest.mark.parametrize(("action", "sign"), [(Action.TURN_LEFT, 1), (Action.TURN_RIGHT, -1)])
def test_turning_agent_turns_by_the_known_angle_per_step(
    world: Any, make_scene: Any, size: float, turn: float, action: Action, sign: int
) -> None:
    engine = world(make_scene({0: (16, 12)}, {0: size}), (450.0, 450.0))
    angles = [engine.state.pose[0, 2]]
    for _ in range(4):
        engine.step((action, WAIT))
        angles.append(engine.state.pose[0, 2])
    turns = sign * np.diff(angles)
    # the first turn from rest is up to 4 % smaller: friction holds the origin, not the centre
    assert turns[1:] == pytest.approx(turn, abs=0.012)
    assert 0.95 * turn < turns[0] < turn


def test_strength_does_not_change_how_fast_an_agent_turns(world: Any, make_scene: Any) -> None:
    angles = []
    for strength in STRENGTHS:
        engine = world(make_scene({0: (16, 12)}), (strength, strength))
        engine.step((Action.TURN_LEFT, WAIT))
        angles.append(engine.state.pose[0, 2])
    assert len(set(angles)) == 1


def test_agents_lose_their_spin_after_each_step_and_items_keep_theirs(
    world: Any, make_scene: Any
) -> None:
    scene = make_scene({0: (16, 12), 2: (10, 12)})
    start = world(scene, (450.0, 450.0)).state
    start.spin[2] = 3.0
    engine = world(scene, (450.0, 450.0), initial=start)
    engine.step((Action.TURN_LEFT, WAIT))
    assert engine.state.spin.tolist() == [0.0, 0.0, 3.0, 0.0]
    assert engine.state.pose[2, 2] == pytest.approx(3.0 / 12.0)


def test_stop_ends_all_movement_at_once_and_holds(world: Any, make_scene: Any, moving: Any) -> None:
    scene = make_scene({0: (16, 12)})
    engine = world(scene, (450.0, 450.0), initial=moving(scene, 0, (20.0, 30.0)))
    for _ in range(3):
        frame = engine.step((Action.STOP, WAIT))
        assert frame[0] == pytest.approx(scene.start[0], abs=1e-9)
    assert np.abs(engine.state.velocity).max() == 0.0


@pytest.mark.parametrize("idle", [NO_ACTION, WAIT, Action.ATTACH, Action.DETACH])
def test_actions_without_force_leave_a_coasting_agent_coasting(
    world: Any, make_scene: Any, moving: Any, idle: int
) -> None:
    scene = make_scene({0: (16, 12)})
    engine = world(scene, (450.0, 450.0), initial=moving(scene, 0, (0.0, 20.0)))
    engine.step((idle, idle))
    assert engine.state.velocity[0, 1] == pytest.approx(20.0 - 100.0 / 2.56 / 12.0, abs=1e-9)


def test_force_acts_in_the_direction_the_body_faces(world: Any, make_scene: Any) -> None:
    engine = world(make_scene({0: (16, 12, -math.pi / 2)}), (450.0, 450.0))
    engine.step((Action.UP, WAIT))
    vx, vy = engine.state.velocity[0]
    assert vx > 5.0
    assert vy == pytest.approx(0.0, abs=1e-9)


def test_pushing_sideways_turns_the_body_a_little(world: Any, make_scene: Any) -> None:
    engine = world(make_scene({0: (16, 12)}), (450.0, 450.0))
    engine.step((Action.RIGHT, WAIT))
    assert 0.001 < abs(engine.state.pose[0, 2]) < 0.2
    assert engine.state.velocity[0, 0] > 5.0


def test_frame_is_the_mean_over_the_five_substeps(world: Any, make_scene: Any) -> None:
    engine = world(make_scene({0: (16, 5)}), (450.0, 450.0))
    frame = engine.step((Action.UP, WAIT))
    # 1, 3, 6, 10 and 15 times a h^2 after the substeps, as velocity changes before each move
    step = 350.0 / 2.56 / 60.0**2
    assert frame[0, 1] - 5.0 == pytest.approx(7.0 * step, abs=1e-9)
    assert engine.state.pose[0, 1] - 5.0 == pytest.approx(15.0 * step, abs=1e-9)


@pytest.mark.parametrize("inner_steps", [1, 2, 4])
def test_free_motion_does_not_depend_on_the_number_of_inner_steps(
    world: Any, make_scene: Any, inner_steps: int
) -> None:
    scene = make_scene({0: (12, 8, 0.3), 1: (20, 16, 2.0)})
    actions = [Action.UP, Action.TURN_LEFT, Action.UP_RIGHT, Action.LEFT, Action.TURN_RIGHT]
    poses = []
    for n in (1, inner_steps):
        engine = world(scene, (150.0, 150.0), n)
        poses.append([engine.step((action, action)) for action in actions])
    assert poses[0] == pytest.approx(np.array(poses[1]), abs=1e-9)


def test_bodies_have_the_masses_of_their_areas() -> None:
    assert constants.mass(0, 1.2) == pytest.approx(4 * 1.44)
    assert constants.mass(3, 1.2) == pytest.approx(math.pi * 1.44)
    assert constants.inertia(3, 2.0) == pytest.approx(0.5 * 4 * math.pi * 4)
    assert constants.inertia(1, 2.0) == pytest.approx(26 / 9 * 16)


@pytest.mark.parametrize("turn", [1e-9, 0.01, -0.2, 0.25, -0.2500001, 3.0])
def test_frames_that_are_turned_stay_those_of_the_angle(turn: float) -> None:
    scratch, bodies = compiled.make_scratch(), np.zeros((4, 9))
    for _ in range(40):  # more than in any planner step
        bodies[1, ANGLE] += turn
        turn_frame(bodies, 1, turn, scratch)
    angle = bodies[1, ANGLE]
    assert scratch.rotation[1] == pytest.approx([math.cos(angle), math.sin(angle)], abs=1e-13)


def test_advancing_is_a_step_without_its_frame(make_scene: Any) -> None:
    scene = make_scene({0: (12, 8), 2: (12, 10)})
    stepped, advanced = (PymunkWorld(scene, (450.0, 300.0)) for _ in range(2))
    actions = (Action.ATTACH, WAIT), (Action.UP, Action.TURN_LEFT), (Action.LEFT, Action.STOP)
    for pair in (*actions, (Action.DETACH, Action.UP)):
        stepped.step(pair)
        advanced.advance(pair)
        for field in dataclasses.fields(State):
            of_both = [getattr(world.state, field.name) for world in (stepped, advanced)]
            np.testing.assert_array_equal(*of_both)


def test_agents_that_are_reset_stand_still_after_each_step_and_items_go_on(
    world: Any, make_scene: Any, moving: Any
) -> None:
    scene = dataclasses.replace(make_scene({0: (16, 9, 0.4), 2: (12, 15)}), resets_velocity=True)
    engine = world(scene, (450.0, 300.0), initial=moving(scene, 2, (20.0, 0.0)))
    for action in (Action.UP_LEFT, Action.RIGHT, Action.TURN_LEFT):
        engine.step((action, Action.DOWN))
        assert not engine.state.velocity[:2].any()
        assert not engine.state.spin[:2].any()
    assert np.linalg.norm(engine.state.velocity[2]) > 1
    place = engine.state.pose[:2].copy()
    engine.step((WAIT, WAIT))
    assert engine.state.pose[:2] == pytest.approx(place, abs=1e-12)


@pytest.mark.parametrize(("size", "strength"), [(0.8, 150.0), (1.2, 600.0)])
def test_an_agent_that_is_reset_drives_from_rest_in_each_step(
    world: Any, make_scene: Any, size: float, strength: float
) -> None:
    scene = make_scene({0: (16, 9, 0.0)}, {0: size})
    engine = world(dataclasses.replace(scene, resets_velocity=True), (strength, 300.0))
    acceleration = (strength - constants.FLOOR_FRICTION) / constants.mass(0, size)
    for step in range(1, 5):
        engine.step((Action.UP, WAIT))
        way = step * (1 + 2 + 3 + 4 + 5) * acceleration * constants.SUBSTEP**2
        assert engine.state.pose[0, 1] - 9 == pytest.approx(way, abs=1e-4)


def test_the_poses_of_the_substeps_make_the_frame(make_scene: Any) -> None:
    scene = make_scene({0: (12, 8), 2: (12, 10)})
    whole, parted = (PymunkWorld(scene, (450.0, 300.0)) for _ in range(2))
    for pair in ((Action.ATTACH, WAIT), (Action.UP, Action.TURN_LEFT), (Action.LEFT, Action.STOP)):
        poses = list(parted.substeps(pair))
        assert len(poses) == constants.SUBSTEPS
        np.testing.assert_array_equal(mean_pose(poses), whole.step(pair))
