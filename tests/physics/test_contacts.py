"""Facts about walls, doors and bodies that push each other."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from phase_ppl.physics.actions import N_ACTIONS, Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.geometry import agent_outline, rotation
from tests.physics.conftest import CompiledWorld, after, start_in

WAIT, UP = Action.NO_FORCE, Action.UP
REST = (WAIT, WAIT)
DOOR = [[[16, 12], [16, 19.5]]]
"""A wall of length 7.5 leaves a door of width 2.5 in the middle of which y = 20.75."""

FULL_ROOMS = [[[16, 12], end] for end in ([16, 22], [8.5, 12], [16, 4.5], [21, 12])]


@pytest.mark.parametrize(
    ("size", "passes"), [(0.8, True), (1.01, False), (1.2, False), (1.6, False)]
)
@pytest.mark.parametrize("strength", [300.0, 600.0])
def test_only_the_smallest_agent_drives_straight_through_the_narrow_door(
    start: Any, size: float, passes: bool, strength: float
) -> None:
    y = min(20.75, 21.97 - 1.5 * size)
    for x in (9.0, 10.5, 12.0):
        placed = {0: (x, y, -math.pi / 2), 1: (8, 14)}
        engine = start(placed, {0: size}, DOOR, strengths=(strength, 150.0))
        farthest = max(after(engine, (UP, WAIT)).pose[0, 0] for _ in range(40))
        # one that is stuck has its front in the door and its base before it
        assert farthest > 19.0 if passes else farthest < 17.0


@pytest.mark.parametrize("entity", [0, 2])
@pytest.mark.parametrize("size", [0.8, 1.01, 1.2, 1.6])
def test_sideways_and_round_all_but_the_largest_pass_the_narrow_door(
    start: Any, entity: int, size: float
) -> None:
    placed = {1 - entity // 2: (8, 14), entity: (11, 20.75 if size < 1.25 else 20.3, 0.0)}
    engine = start(placed, {entity: size}, DOOR, (600, 150), moving=(entity, (30.0, 0.0)))
    x = max(engine.step(REST)[entity, 0] for _ in range(30))
    assert (x > 16.5) == (size < 1.6)


def test_contacts_neither_bounce_nor_rub(start: Any) -> None:
    state = after(start({2: (10, 21.0)}, moving=(2, (15.0, 20.0))), REST, times=2)
    free = after(start({2: (10, 12)}, moving=(2, (15.0, 0.0))), REST, times=2)
    assert state.velocity[2, 1] == pytest.approx(0.0, abs=1e-6)
    # along the wall only the floor brakes, a little less while part of its force goes sideways
    assert state.velocity[2, 0] == pytest.approx(free.velocity[2, 0], abs=1.0)
    assert state.spin[2] == pytest.approx(0.0, abs=1e-12)


def test_agent_pushes_an_item_ahead(start: Any) -> None:
    state = after(start({0: (16, 5), 2: (16, 7)}, strengths=(450, 150)), (UP, WAIT), times=6)
    assert state.pose[2, 1] > 9.0
    assert abs(state.pose[2, 1] - state.pose[0, 1] - 1.6) < 0.05
    # 450 N less the friction of both drive both masses
    assert state.velocity[2, 1] == pytest.approx(state.velocity[0, 1], rel=0.02)


def test_agents_stand_against_each_other_with_equal_force(start: Any) -> None:
    state = after(start({0: (16, 10), 1: (16, 11.62, math.pi)}), (UP, UP), times=10)
    assert state.pose[:2] == pytest.approx(np.array([[16, 10, 0], [16, 11.62, math.pi]]), abs=0.05)


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.5])
def test_item_that_starts_on_an_agent_leaves_it_to_the_right(start: Any, angle: float) -> None:
    pose = after(start({1: (16, 12, angle), 3: (16, 12)}), REST, times=3).pose
    assert ((pose[3, :2] - pose[1, :2]) @ rotation(angle))[0] > 1.0


@pytest.mark.parametrize("pair", [(0, 1), (0, 2), (1, 3), (2, 3)])
@pytest.mark.parametrize("turned", [0.0, 0.4, math.pi])
def test_bodies_that_start_on_the_same_spot_are_pushed_apart(
    start: Any, pair: tuple[int, int], turned: float
) -> None:
    a, b = pair
    pose = after(start({a: (16, 12), b: (16, 12, turned)}), REST, times=4).pose
    assert np.isfinite(pose).all()
    assert np.linalg.norm(pose[a, :2] - pose[b, :2]) > 1.3


@pytest.mark.parametrize(
    ("world", "inner_steps", "runs"),
    [(PymunkWorld, 4, 6), (PymunkWorld, 1, 6), (CompiledWorld, 4, 50), (CompiledWorld, 1, 50)],
)
def test_nothing_leaves_the_arena_in_random_runs(world: Any, inner_steps: int, runs: int) -> None:
    rng = np.random.default_rng(3)
    for _ in range(runs):
        poses = np.column_stack([rng.uniform((8, 4), (24, 20), (4, 2)), rng.uniform(-4, 4, 4)])
        sizes = dict(enumerate(rng.choice([0.8, 1.01, 1.2, 1.6], 4)))
        placed = dict(enumerate(poses.tolist()))
        running = start_in(world, placed, sizes, FULL_ROOMS, (600, 600), inner_steps=inner_steps)
        # actions that last build up the highest speeds
        for pair in np.repeat(rng.integers(0, N_ACTIONS, (12, 2)), 5, axis=0):
            pose = after(running, pair.tolist()).pose
            assert (pose[:, :2] > (6.0, 2.0)).all()
            assert (pose[:, :2] < (26.0, 22.0)).all()
            # a corner can get into the border as far as a fast body moves in an inner step
            for agent in range(2):
                outline = agent_outline(pose[agent], sizes[agent])
                assert (outline > (4.5, 0.5)).all()
                assert (outline < (27.5, 23.5)).all()


def test_compiled_model_survives_impossible_states() -> None:
    rng = np.random.default_rng(4)
    for _ in range(80):
        running = start_in(CompiledWorld, {}, {0: 1.6, 2: 1.6}, FULL_ROOMS, (600, 600))
        running.bodies[:, :2] = rng.uniform((0, -4), (32, 28), (4, 2))
        if rng.random() < 0.3:
            running.bodies[:, :2] = running.bodies[0, :2]
        running.bodies[:, 3:6] = rng.normal(0, 100, (4, 3))
        running.held[:] = rng.integers(-1, 2, 2) * 2 + (rng.random(2) < 0.5)
        running.held[running.held < 2] = -1
        running.weld[:] = rng.normal(0, 2, (2, 3))
        after(running, *rng.integers(-1, N_ACTIONS, (20, 2)).tolist())
        assert np.isfinite(running.bodies).all()


@pytest.mark.parametrize(("size", "strength"), [(0.1, 600.0), (0.3, 300.0), (0.4, 600.0)])
def test_nobody_is_so_small_for_its_speed_that_it_passes_a_wall(
    start: Any, size: float, strength: float
) -> None:
    wall = [[[16, 12], [16, 22]], [[16, 12], [16, 2]]]
    # an item on the way, which the agent drives before it
    placed = {0: (7.0, 8.0, -np.pi / 2), 2: (11.0, 8.0)}
    running = start(placed, {0: size, 2: size}, wall, (strength, 150.0))
    furthest = 0.0
    for _ in range(12):
        x = after(running, (Action.UP, Action.NO_FORCE)).pose[[0, 2], 0]
        assert (x < 16.0).all()
        furthest = max(furthest, x[0])
    assert furthest > 14.0


def test_a_body_too_small_for_any_division_is_refused_with_the_size_that_would_do(
    start: Any,
) -> None:
    with pytest.raises(InvalidSettingError, match=r"size 0\.02 is too small .* 600 N") as raised:
        start({}, {0: 0.02}, strengths=(600.0, 600.0))
    needed = float(re.findall(r"at least ([\d.]+)", str(raised.value))[0])
    start({}, {0: needed}, strengths=(600.0, 600.0))
    with pytest.raises(InvalidSettingError, match="too small"):
        start({}, {0: 0.95 * needed}, strengths=(600.0, 600.0))
