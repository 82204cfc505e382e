"""The simulator without physics, and noise on the dynamics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.simulator.contract import simulate_trajectory
from phase_ppl.simulator.joint import DynamicsNoise, JointSimulator
from phase_ppl.simulator.no_physics import PathSimulator
from phase_ppl.world.geometry import is_on
from tests.agents.scenes import FULL_WALL_UP, HALF_WALL_LEFT, scene

FEW = ppl.PlannerConfig(particles=10)
FLEE = ppl.Hypothesis("get to green agent", "get away from red agent")


def path(where: ppl.Scene, red: str, green: str, n: int, **more: Any) -> np.ndarray:
    simulator = PathSimulator(FEW, **more)
    return simulate_trajectory(simulator, where, ppl.Hypothesis(red, green), 0, n)


def lands(track: np.ndarray, landmark: int, where: ppl.Scene) -> bool:
    return is_on(track[-1, :2], where.landmark_centres[landmark], where.landmark_half_width)


def test_agents_go_to_their_landmarks_through_each_other_at_a_constant_speed() -> None:
    where = scene(red=(8.5, 12.0, 0.0), green=(23.5, 12.0, 0.0), blue=(16.0, 11.9), pink=(16, 4))
    found = path(where, "Get red agent to green lm", "Get green agent to blue lm", 40, speed=6.0)
    for agent, landmark in ((0, 1), (1, 0)):
        assert lands(found[:, agent], landmark, where)
        steps = np.linalg.norm(np.diff(found[:15, agent, :2], axis=0), axis=1)
        # a frame is the mean over its step: 0.1 to 0.5 after 1 to 5 substeps of the first
        assert steps == pytest.approx([0.3, *[0.5] * 13])
    assert np.array_equal(found[-1, 2:], where.start[2:])


def test_the_way_leads_through_the_door() -> None:
    where = scene(walls=[FULL_WALL_UP, HALF_WALL_LEFT])
    found = path(where, "Get red agent to yellow lm", "Get green agent to green lm", 40)
    assert lands(found[:, 0], 3, where)
    at_wall = np.abs(found[:, 0, 1] - 12.0).argmin()
    assert found[at_wall, 0, 0] < 11  # the wall takes x from 11 to 16


def test_two_carry_an_item_whatever_its_size() -> None:
    where = scene(blue=(16.0, 18.0), pink=(16.0, 3.0), radius=[0.8, 0.8, 1.6, 0.8])
    weak = ppl.Hypothesis("Get blue item to red lm", "Get blue item to red lm", (0, 0), 600, 600)
    found = simulate_trajectory(PathSimulator(FEW), where, weak, 0, 70)
    assert lands(found[:, 2], 2, where)


def test_one_that_flees_is_not_caught_by_one_that_is_as_fast() -> None:
    where = scene(red=(9.0, 13.0, 0.0), green=(16.5, 11.0, 0.0))
    config = ppl.PlannerConfig(particles=10, full_observation=True)
    found = simulate_trajectory(PathSimulator(config), where, FLEE, 0, 9)
    gap = np.linalg.norm(found[:, 0, :2] - found[:, 1, :2], axis=1)
    assert gap[-1] > gap[0] - 1.0
    resting = ppl.Hypothesis("get to green agent", "Get green agent to green lm")
    caught = simulate_trajectory(PathSimulator(config), where, resting, 0, 40)
    assert np.linalg.norm(caught[-1, 0, :2] - caught[-1, 1, :2]) < 2.0


def test_agents_that_plan_on_the_true_state_go_straight_to_a_hidden_item() -> None:
    where = scene(red=(14.0, 18.0, 0.0), blue=(8.0, 8.0), walls=[FULL_WALL_UP, HALF_WALL_LEFT])
    config = ppl.PlannerConfig(particles=10, true_state=True)
    goals = ppl.Hypothesis("Get blue item to yellow lm", "Get green agent to green lm")
    ends = [
        simulate_trajectory(PathSimulator(config), where, goals, seed, 20)[-1] for seed in (0, 1)
    ]
    assert np.array_equal(*ends)  # nothing is left to chance
    assert np.linalg.norm(ends[0][0, :2] - ends[0][2, :2]) < 2.5


def test_a_deflected_body_goes_on_from_where_it_is_in_another_direction() -> None:
    where = scene(red=(16.0, 12.0, 0.0))
    world = PymunkWorld(where, (450.0, 450.0))
    for _ in range(3):
        world.step((Action.UP, Action.NO_FORCE))
    before = world.state
    world.deflect(np.full(4, 2.0), np.full(4, np.pi / 2))
    after = world.state
    assert after.pose == pytest.approx(before.pose)
    vx, vy = before.velocity[0]
    assert after.velocity[0] == pytest.approx([-2 * vy, 2 * vx])


def test_noise_of_zero_changes_nothing_and_more_of_it_does() -> None:
    where, quick = scene(red=(8.0, 16.0, 0.0)), ppl.PlannerConfig(simulations=30)
    exact, silent, noisy = (
        simulate_trajectory(JointSimulator(quick, noise=noise), where, FLEE, 3, 10)
        for noise in (None, DynamicsNoise(0.0, 0.0), DynamicsNoise())
    )
    assert silent == pytest.approx(exact, abs=1e-9)
    assert np.abs(noisy - exact).max() > 0.05
