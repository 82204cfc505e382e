"""One filter of beliefs and shared searches say what each pair of goals would on its own."""

from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.agents.agent import NO_INTENT, Agent, Policies
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import Action
from phase_ppl.world.event import State
from phase_ppl.world.goals import GOALS, N_GOALS, goal_index
from tests.agents.scenes import FULL_WALL_UP, HALF_WALL_LEFT, scene

CONFIG = PlannerConfig(simulations=30, paired=True)
WHERE = scene(red=(9.0, 18.0, 1.0), green=(20.0, 8.0, 2.0), blue=(11.0, 18.0), pink=(22.0, 8.0),
              walls=[FULL_WALL_UP, HALF_WALL_LEFT])  # fmt: skip
MODEL = WorldModel.of(WHERE, (450.0, 300.0), CONFIG)


def watched(agent: int, held: int = -1, pairs: list[tuple[int, int]] | None = None) -> Policies:
    """Return what an agent makes of the scene, perhaps with its near item in hand."""
    found = Policies(agent, MODEL, CONFIG, seed=3, goals=pairs)
    bodies, holds, weld = compiled.from_state(State.at_start(WHERE), WHERE.radius)
    found.observe(bodies, holds, weld)
    found.done(Action.ATTACH)
    if held >= 0:
        holds[agent] = held
        weld[agent] = 1.6, 0.0, 0.0
    found.observe(bodies, holds, weld)
    return found


@pytest.mark.parametrize(("agent", "held"), [(0, -1), (0, 2), (1, 3)])
def test_pairs_of_goals_that_share_an_intent_have_it_each_for_itself(agent: int, held: int) -> None:
    policies = watched(agent, held)
    possible = 0
    for red in range(N_GOALS):
        for green in range(N_GOALS):
            index = policies.intent_of[red * N_GOALS + green]
            if index == NO_INTENT:
                continue
            if (red + green) % 7 == 0:
                alone = watched(agent, held, pairs=[(red, green)])
                assert alone.intents == [policies.intents[index]], (red, green)
            possible += 1
    assert possible == 34 * 34  # neither agent gets to or away from itself
    assert 4 < len(policies.intents) < 60


def test_what_a_search_finds_does_not_depend_on_what_else_is_searched() -> None:
    policies, again = watched(0), watched(0)
    together = {
        index: found
        for group in policies.searches()
        for index, found in zip(
            group, policies.root_statistics([policies.intents[i] for i in group]), strict=True
        )
    }
    assert max(map(len, policies.searches())) > 4
    order = np.random.default_rng(0).permutation(len(again.intents))
    assert sorted(together) == sorted(order)
    for index in order:
        (alone,) = again.root_statistics([again.intents[index]])
        np.testing.assert_array_equal(alone.values, together[index].values)
        np.testing.assert_array_equal(alone.visits, together[index].visits)
        assert alone.best == together[index].best


def test_an_agent_with_one_pair_of_goals_takes_up_the_same_subgoal() -> None:
    for red, green in (
        ("Get blue item to red lm", "Get blue item to red lm"),
        ("Get blue item to red lm", "Get blue item away from red lm"),
        ("Get green agent to yellow lm", "Get green agent to yellow lm"),
        ("get to green agent", "get away from red agent"),
    ):
        goals = goal_index(red), goal_index(green)
        policies = Policies(0, MODEL, CONFIG, seed=3)
        agent = Agent(0, goals, MODEL, CONFIG, np.random.default_rng([3, 0]))
        state = compiled.from_state(State.at_start(WHERE), WHERE.radius)
        policies.observe(*state)
        agent.observe(*state)
        place = goals[0] * N_GOALS + goals[1]
        assert policies.intents[policies.intent_of[place]] == agent.intent, GOALS[goals[0]]


def test_a_goal_that_names_its_own_holder_is_none() -> None:
    policies = watched(1)
    of_pair = policies.intent_of.reshape(N_GOALS, N_GOALS)
    assert (of_pair[:, goal_index("get to green agent")] == NO_INTENT).all()
    assert (of_pair[goal_index("get to red agent")] == NO_INTENT).all()
