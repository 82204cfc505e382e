"""Belief particles agree with what has been observed."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from phase_ppl.agents.agent import Agent
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import Action
from phase_ppl.physics.welds import in_reach
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.event import State
from phase_ppl.world.goals import goal_index
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene, World
from tests.agents.scenes import FULL_WALL_UP, NARROW_WALL_DOWN, scene

GOALS = (goal_index("Get blue item to red lm"), goal_index("Get green agent to red lm"))
CONFIG = PlannerConfig(simulations=50)


def agent_in(where: Scene, seed: int = 0, config: PlannerConfig = CONFIG) -> Agent:
    model = WorldModel.of(where, (450.0, 450.0), config)
    return Agent(0, GOALS, model, config, np.random.default_rng(seed))


def perceive(agent: Agent, where: Scene, times: int = 1) -> None:
    state = compiled.from_state(State.at_start(where), where.radius)
    for _ in range(times):
        agent.observe(*state)


HIDDEN = scene(
    red=(8.0, 20.0, 0.6),
    green=(24.0, 4.0, 0.0),
    blue=(24.0, 20.0),
    pink=(18.0, 4.0),
    walls=[FULL_WALL_UP, NARROW_WALL_DOWN],
)


def test_there_are_fifty_particles_that_differ_in_what_is_unseen() -> None:
    agent = agent_in(HIDDEN, config=PlannerConfig())
    perceive(agent, HIDDEN)
    assert agent.beliefs.bodies.shape == (50, 4, 9)
    assert len(np.unique(agent.beliefs.bodies[:, 2, :2].round(6), axis=0)) > 20


def test_observed_entities_are_true_in_every_particle() -> None:
    near = scene(red=(8.0, 8.0, 0.0), blue=(8.0, 14.0), green=(24.0, 4.0, 0.0))
    agent = agent_in(near)
    perceive(agent, near)
    truth, _, _ = compiled.from_state(State.at_start(near), near.radius)
    assert agent.beliefs.observed.tolist()[:3] == [True, False, True]
    np.testing.assert_array_equal(agent.beliefs.bodies[:, 0], np.broadcast_to(truth[0], (50, 9)))
    np.testing.assert_array_equal(agent.beliefs.bodies[:, 2], np.broadcast_to(truth[2], (50, 9)))


@pytest.mark.parametrize("seed", range(4))
def test_no_unseen_entity_is_believed_to_be_in_plain_view(seed: int) -> None:
    agent = agent_in(HIDDEN, seed)
    perceive(agent, HIDDEN, times=3)
    visible = agent.beliefs.visible.reshape(20, 20)
    inside = 0
    for item in (2, 3):
        for x, y in agent.beliefs.bodies[:, item, :2]:
            inside += visible[int(22 - y), int(x - 6)]
    # resampling is bounded, so a rare particle may stay inconsistent
    assert inside <= 2


def test_particles_lie_inside_the_arena() -> None:
    agent = agent_in(HIDDEN)
    perceive(agent, HIDDEN, times=3)
    x, y = agent.beliefs.bodies[..., 0], agent.beliefs.bodies[..., 1]
    assert ((x > 6) & (x < 26) & (y > 2) & (y < 22)).all()


def test_cells_once_seen_stay_excluded_when_the_agent_looks_away() -> None:
    def looking(angle: float) -> Scene:
        low = {"green": (7.5, 3.5, 0.0), "blue": (9.0, 3.2), "pink": (12.0, 3.0)}
        return scene(red=(16.0, 12.0, angle), **low)

    agent = agent_in(looking(0.0))
    perceive(agent, looking(0.0))
    for angle in (0.0, -math.pi / 2, math.pi / 2):
        perceive(agent, looking(angle), times=3)
    # up, right and left have been looked at: everything unseen lies below
    assert np.mean(agent.beliefs.bodies[:, 2, 1] < 12.0) > 0.95


def test_nothing_is_believed_beside_a_floor_plan_that_does_not_fill_the_arena() -> None:
    flat = World(
        ["cook"], ["pan"], {"stove": (5, 5)}, (0, 30, 0, 26),
        walls=[((20.5, 12.5), (30, 12.5)), ((20.5, 12.5), (20.5, 26)), ((0, 12.5), (12, 12.5))],
    )  # fmt: skip
    where = flat.scene(start={"cook": (26, 3), "pan": (18, 22)})
    model = WorldModel.of(where, (450.0,), CONFIG)
    agent = Agent(0, (flat.goal_index("pan to stove"),), model, CONFIG, np.random.default_rng(0))
    perceive(agent, where, times=3)
    x, y = agent.beliefs.bodies[:, 1, 0], agent.beliefs.bodies[:, 1, 1]
    assert not ((x > 20.5) & (y > 12.5)).any()
    assert len(np.unique(agent.beliefs.bodies[:, 1, :2].round(6), axis=0)) > 20


def test_when_everything_has_been_seen_particles_are_still_consistent() -> None:
    agent = agent_in(HIDDEN)
    agent.beliefs.ever_seen[:] = True
    perceive(agent, HIDDEN)
    assert np.isfinite(agent.beliefs.bodies).all()
    assert len(np.unique(agent.beliefs.bodies[:, 2, :2].round(6), axis=0)) > 5


def test_beliefs_depend_on_the_unseen_truth_in_no_way() -> None:
    moved = scene(
        red=(8.0, 20.0, 0.6),
        green=(18.0, 10.0, 1.0),
        blue=(24.0, 14.0),
        pink=(24.0, 10.0),
        walls=[FULL_WALL_UP, NARROW_WALL_DOWN],
    )
    particles = []
    for where in (HIDDEN, moved):
        agent = agent_in(where)
        perceive(agent, where)
        assert agent.beliefs.observed.tolist() == [True, False, False, False]
        particles.append(agent.beliefs.bodies.copy())
    np.testing.assert_array_equal(*particles)


def test_another_seed_gives_other_particles_and_the_same_seed_the_same() -> None:
    first, again, other = (agent_in(HIDDEN, seed) for seed in (1, 1, 2))
    for agent in (first, again, other):
        perceive(agent, HIDDEN)
    np.testing.assert_array_equal(first.beliefs.bodies, again.beliefs.bodies)
    assert not np.array_equal(first.beliefs.bodies, other.beliefs.bodies)


def test_a_hand_that_closed_on_nothing_refutes_what_was_believed_in_its_reach() -> None:
    agent = agent_in(HIDDEN)
    perceive(agent, HIDDEN)
    agent.beliefs.ever_seen[:] = False  # so that places behind the agent's back stay possible
    red, blue = 0, 2
    behind = agent.beliefs.bodies[0, red, :2] - 1.75 * np.array([-math.sin(0.6), math.cos(0.6)])
    for action, stays in ((Action.STOP, True), (Action.ATTACH, False)):
        agent.beliefs.bodies[:, blue] = 0.0
        agent.beliefs.bodies[:, blue, :2] = behind
        assert all(in_reach(b, red, blue, agent.model.params) for b in agent.beliefs.bodies)
        agent.done(action)
        perceive(agent, HIDDEN)
        reach = [in_reach(b, red, blue, agent.model.params) for b in agent.beliefs.bodies]
        assert all(reach) if stays else not any(reach)


def test_nobody_tries_again_and_again_to_grab_what_is_not_there() -> None:
    searching = scene(
        red=(18.0, 16.0, 1.4),
        green=(24.0, 10.0, 4.0),
        blue=(8.0, 4.0),
        pink=(8.0, 14.0),
        walls=[FULL_WALL_UP, NARROW_WALL_DOWN],
    )
    hypothesis = Hypothesis("Get pink item to red lm", "Get pink item to red lm").effective()
    tries = []
    for seed in range(30):
        run = JointSimulator(CONFIG).steps(searching, hypothesis, np.random.default_rng(seed))
        first_steps = itertools.islice(run, 1, 15)
        tries.append(sum(red.action == Action.ATTACH for _, (red, _) in first_steps))
    # a few believe at first that it lies behind them, where they cannot see
    assert 1 <= sum(n > 0 for n in tries) <= 10
    assert max(tries) <= 3
