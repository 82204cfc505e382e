"""The compiled search against the same search in plain Python over the pymunk world."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.agents.agent import Agent
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import N_ACTIONS, NO_ACTION
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.event import State
from phase_ppl.world.goals import goal_index
from phase_ppl.world.names import Literal
from phase_ppl.world.scene import Scene
from tests.agents.oracle import OracleAgent
from tests.agents.scenes import FULL_WALL_UP, HALF_WALL_LEFT, HALF_WALL_RIGHT, scene

STRENGTHS = (450.0, 450.0)
CONFIG = PlannerConfig(simulations=40, swivel=False, full_observation=True)
GOALS = (goal_index("Get blue item to red lm"), goal_index("Get green agent to blue lm"))
WALLS = [FULL_WALL_UP, HALF_WALL_LEFT, HALF_WALL_RIGHT]

SCENES = {
    "ahead": scene(red=(10.0, 8.0, -1.5708), blue=(16.0, 8.0)),
    "behind": scene(red=(10.0, 8.0, 1.5708), blue=(16.0, 8.0), walls=WALLS),
    "beside": scene(red=(16.0, 8.0, 0.0), blue=(17.5, 8.0), walls=WALLS),
}


def make(where: Scene, oracle: bool, seed: int) -> tuple[Agent, PymunkWorld]:
    given = 0, GOALS, WorldModel.of(where, STRENGTHS, CONFIG), CONFIG, np.random.default_rng(seed)
    agent = OracleAgent(*given, STRENGTHS) if oracle else Agent(*given)
    return agent, PymunkWorld(where, STRENGTHS, initial=State.at_start(where))


def follow(where: Scene, oracle: bool, steps: int) -> tuple[list[Literal], int]:
    """Return the subgoals of red, in order of first appearance, and after how many searches."""
    agent, world = make(where, oracle, seed=1)
    subgoals: list[Literal] = []
    searches = 0
    for _ in range(steps):
        decision = agent.decide(*compiled.from_state(world.state, where.radius))
        searches += len(decision.root.actions) > 1
        if decision.intent.subgoal not in subgoals:
            subgoals.append(decision.intent.subgoal)
        world.step((int(decision.action), NO_ACTION))
    return subgoals, searches


@pytest.mark.parametrize(
    "name",
    ["behind", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ahead", "beside"))],
)
def test_both_searches_take_up_the_same_subgoals_in_the_same_order(name: str) -> None:
    (fast, n_fast), (slow, n_slow) = (follow(SCENES[name], oracle, 14) for oracle in (False, True))
    assert fast == slow
    # they came to the others by their actions
    assert len(fast) >= 3
    assert min(n_fast, n_slow) >= 4


def histogram(where: Scene, oracle: bool, seeds: range) -> NDArray[np.float64]:
    counts = np.zeros(N_ACTIONS)
    for seed in seeds:
        agent, world = make(where, oracle, seed)
        decision = agent.decide(*compiled.from_state(world.state, where.radius))
        counts[decision.action] += 1
    return counts / counts.sum()


def distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.abs(a - b).sum() / 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ahead", "behind"])
def test_actions_of_both_searches_differ_no_more_than_those_of_two_sets_of_seeds(name: str) -> None:
    where = SCENES[name]
    slow = histogram(where, True, range(40))
    fast, again = histogram(where, False, range(40)), histogram(where, False, range(40, 80))
    # of 40 draws each, spread over two or three actions, as many as a quarter may differ
    assert distance(slow, fast) <= max(0.25, distance(fast, again))
