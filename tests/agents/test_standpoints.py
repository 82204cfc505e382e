"""Standpoints stand for the goals of all."""

from __future__ import annotations

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.agents.agent import Policies
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.standpoints import standpoints
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.world.event import State
from phase_ppl.world.goals import is_self_referring, opposed_goal, shared_goal

CONFIG = PlannerConfig(simulations=4, particles=6)
TRIO = ppl.worlds.TRIO


def drawn_goals(rng: np.random.Generator, n: int) -> list[tuple[int, ...]]:
    """Return goals of three agents, of which many help, hinder or share."""
    agents = range(len(TRIO.agents))
    possible = [
        [goal for goal in range(len(TRIO.goals)) if not is_self_referring(goal, agent, TRIO)]
        for agent in agents
    ]
    found = []
    for _ in range(n):
        goals = [int(rng.choice(own)) for own in possible]
        for agent in agents:
            other = int(rng.integers(3))
            if other != agent and rng.random() < 0.5:
                act = (shared_goal, opposed_goal)[rng.integers(2)]
                goals[agent] = act(goals[other], other, agent, TRIO)
        if not any(is_self_referring(goal, agent, TRIO) for agent, goal in enumerate(goals)):
            found.append(tuple(goals))
    return found


@pytest.mark.parametrize("agent", range(3))
def test_an_agent_of_three_has_the_intent_that_it_has_with_just_these_goals(agent: int) -> None:
    scene = TRIO.random_scene(4)
    model = WorldModel.of(scene, (450.0, 300.0, 600.0), CONFIG)
    state = compiled.from_state(State.at_start(scene), scene.radius)
    every = Policies(agent, model, CONFIG, seed=1)
    every.observe(*state)
    goals = drawn_goals(np.random.default_rng(agent), 40)
    places = standpoints(agent, TRIO).of(np.array(goals))
    assert len(set(places.tolist())) > 20
    for each, place in zip(goals, places.tolist(), strict=True):
        alone = Policies(agent, model, CONFIG, seed=1, goals=[each])
        alone.observe(*state)
        assert every.intents[every.intent_of[place]] == alone.intents[0], each


def test_standpoints_are_far_fewer_than_the_goals_of_all() -> None:
    assert standpoints(0, TRIO).n < 0.03 * len(TRIO.goals) ** 3
    assert standpoints(0, ppl.worlds.SOLO).n == 22  # it has no goal to touch itself


def test_goals_that_cannot_be_have_no_standpoint() -> None:
    itself = TRIO.goal_index("get to red agent")
    assert standpoints(0, TRIO).of(np.array([itself, 0, 0])) == -1
