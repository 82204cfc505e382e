"""Belief particles agree with what has been observed."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from phase_ppl.agents.agent import Agent
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.physics.actions import Action
from phase_ppl.physics.welds import in_reach
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.goals import goal_index
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene, World
from tests.agents.scenes import FULL_WALL_UP, NARROW_WALL_DOWN, agent_in, scene, state_of

GOALS = (goal_index("Get blue item to red lm"), goal_index("Get green agent to red lm"))
CONFIG = PlannerConfig(simulations=50)
BLUE = 2
ROOMS = {"walls": [FULL_WALL_UP, NARROW_WALL_DOWN]}
HIDDEN = scene((8.0, 20.0, 0.6), (24.0, 4.0, 0.0), blue=(24.0, 20.0), pink=(18.0, 4.0), **ROOMS)


def perceive(agent: Agent, where: Scene, times: int = 1) -> None:
    for _ in range(times):
        agent.observe(*state_of(where))


def perceiving(where: Scene = HIDDEN, seed: int = 0, times: int = 1) -> Agent:
    agent = agent_in(where, GOALS, CONFIG, seed)
    perceive(agent, where, times)
    return agent


def places(agent: Agent, item: int = BLUE) -> FloatArray:
    return np.unique(agent.beliefs.bodies[:, item, :2].round(6), axis=0)


def test_observed_entities_are_true_in_every_particle() -> None:
    near = scene(red=(8.0, 8.0, 0.0), blue=(8.0, 14.0), green=(24.0, 4.0, 0.0))
    beliefs, (truth, _, _) = perceiving(near).beliefs, state_of(near)
    assert beliefs.observed.tolist()[:3] == [True, False, True]
    for entity in (0, BLUE):
        assert (beliefs.bodies[:, entity] == truth[entity]).all()


@pytest.mark.parametrize("seed", range(4))
def test_no_unseen_entity_is_believed_to_be_in_plain_view_or_outside(seed: int) -> None:
    beliefs = perceiving(seed=seed, times=3).beliefs
    visible = beliefs.visible.reshape(20, 20)
    x, y = beliefs.bodies[..., 0], beliefs.bodies[..., 1]
    assert ((x > 6) & (x < 26) & (y > 2) & (y < 22)).all()
    # resampling is bounded, so a rare particle may stay inconsistent
    assert visible[(22 - y[:, 2:]).astype(int), (x[:, 2:] - 6).astype(int)].sum() <= 2


def test_cells_once_seen_stay_excluded_when_the_agent_looks_away() -> None:
    def looking(angle: float) -> Scene:
        low = {"green": (7.5, 3.5, 0.0), "blue": (9.0, 3.2), "pink": (12.0, 3.0)}
        return scene(red=(16.0, 12.0, angle), **low)

    agent = perceiving(looking(0.0))
    for angle in (0.0, -math.pi / 2, math.pi / 2):
        perceive(agent, looking(angle), times=3)
    # up, right and left have been looked at: everything unseen lies below
    assert np.mean(agent.beliefs.bodies[:, BLUE, 1] < 12.0) > 0.95


def test_nothing_is_believed_beside_a_floor_plan_that_does_not_fill_the_arena() -> None:
    flat = World(
        ["cook"], ["pan"], {"stove": (5, 5)}, (0, 30, 0, 26),
        walls=[((20.5, 12.5), (30, 12.5)), ((20.5, 12.5), (20.5, 26)), ((0, 12.5), (12, 12.5))],
    )  # fmt: skip
    where = flat.scene(start={"cook": (26, 3), "pan": (18, 22)})
    agent = agent_in(where, (flat.goal_index("pan to stove"),), CONFIG)
    perceive(agent, where, times=3)
    x, y = agent.beliefs.bodies[:, 1, 0], agent.beliefs.bodies[:, 1, 1]
    assert not ((x > 20.5) & (y > 12.5)).any()
    assert len(places(agent, 1)) > 20


def test_when_everything_has_been_seen_particles_are_still_consistent() -> None:
    agent = agent_in(HIDDEN, GOALS, CONFIG)
    agent.beliefs.ever_seen[:] = True
    perceive(agent, HIDDEN)
    assert np.isfinite(agent.beliefs.bodies).all()
    assert len(places(agent)) > 5


def test_beliefs_depend_on_the_unseen_truth_in_no_way() -> None:
    moved = scene((8.0, 20.0, 0.6), (18.0, 10.0, 1.0), (24.0, 14.0), (24.0, 10.0), **ROOMS)
    hidden, other = perceiving().beliefs, perceiving(moved).beliefs
    assert hidden.observed.tolist() == other.observed.tolist() == [True, False, False, False]
    np.testing.assert_array_equal(hidden.bodies, other.bodies)


def test_a_hand_that_closed_on_nothing_refutes_what_was_believed_in_its_reach() -> None:
    agent = perceiving()
    agent.beliefs.ever_seen[:] = False  # so that places behind the agent's back stay possible
    behind = agent.beliefs.bodies[0, 0, :2] - 1.75 * np.array([-math.sin(0.6), math.cos(0.6)])

    def reach() -> list[bool]:
        return [in_reach(b, 0, BLUE, agent.model.params) for b in agent.beliefs.bodies]

    for action, stays in ((Action.STOP, True), (Action.ATTACH, False)):
        agent.beliefs.bodies[:, BLUE] = 0.0
        agent.beliefs.bodies[:, BLUE, :2] = behind
        assert all(reach())
        agent.acted(action)
        perceive(agent, HIDDEN)
        assert all(reach()) if stays else not any(reach())


def test_nobody_tries_again_and_again_to_grab_what_is_not_there() -> None:
    searching = scene((18.0, 16.0, 1.4), (24.0, 10.0, 4.0), (8.0, 4.0), (8.0, 14.0), **ROOMS)
    hypothesis = Hypothesis("Get pink item to red lm", "Get pink item to red lm").effective()
    tries = []
    for seed in range(12):
        run = JointSimulator(CONFIG).steps(searching, hypothesis, np.random.default_rng(seed))
        first_steps = itertools.islice(run, 1, 15)
        tries.append(sum(red.action == Action.ATTACH for _, (red, _) in first_steps))
    # a few believe at first that it lies behind them, where they cannot see
    assert 1 <= sum(n > 0 for n in tries) <= 4
    assert max(tries) <= 3
