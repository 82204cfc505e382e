"""One filter of beliefs and shared searches say what the goals of all would on their own."""

from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.agents.agent import NO_INTENT, Agent, Policies
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.standpoints import standpoints
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics.actions import Action
from phase_ppl.world.goals import N_GOALS, goal_index, opposed_goal, possible_goals, shared_goal
from phase_ppl.world.worlds import TRIO
from tests.agents.scenes import FULL_WALL_UP, HALF_WALL_LEFT, scene, state_of

CONFIG = PlannerConfig(simulations=30, paired=True)
FEW = PlannerConfig(simulations=4, particles=6)
WHERE = scene(red=(9.0, 18.0, 1.0), green=(20.0, 8.0, 2.0), blue=(11.0, 18.0), pink=(22.0, 8.0),
              walls=[FULL_WALL_UP, HALF_WALL_LEFT])  # fmt: skip
MODEL = WorldModel.of(WHERE, (450.0, 300.0), CONFIG)


def watched(agent: int, held: int = -1, pairs: list[tuple[int, int]] | None = None) -> Policies:
    """Return what an agent makes of the scene, perhaps with its near item in hand."""
    found = Policies(agent, MODEL, CONFIG, seed=3, goals=pairs)
    bodies, holds, weld = state_of(WHERE)
    found.observe(bodies, holds, weld)
    found.acted(Action.ATTACH)
    if held >= 0:
        holds[agent], weld[agent] = held, (1.6, 0.0, 0.0)
    found.observe(bodies, holds, weld)
    return found


@pytest.mark.parametrize(("agent", "held"), [(0, -1), (0, 2), (1, 3)])
def test_pairs_of_goals_that_share_an_intent_have_it_each_for_itself(agent: int, held: int) -> None:
    policies = watched(agent, held)
    pairs = policies.intent_of.reshape(N_GOALS, N_GOALS)
    for red, green in np.argwhere(pairs != NO_INTENT).tolist():
        if (red + green) % 7 == 0:
            alone = watched(agent, held, pairs=[(red, green)])
            assert alone.intents == [policies.intents[pairs[red, green]]], (red, green)
    # neither agent gets to or away from itself
    assert (pairs[:, goal_index("get to green agent")] == NO_INTENT).all()
    assert (pairs[goal_index("get to red agent")] == NO_INTENT).all()
    assert np.count_nonzero(pairs != NO_INTENT) == 34 * 34
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
    for red, green in [
        ("Get blue item to red lm", "Get blue item to red lm"),
        ("Get blue item to red lm", "Get blue item away from red lm"),
        ("Get green agent to yellow lm", "Get green agent to yellow lm"),
        ("get to green agent", "get away from red agent"),
    ]:
        goals = goal_index(red), goal_index(green)
        policies = Policies(0, MODEL, CONFIG, seed=3)
        agent = Agent(0, goals, MODEL, CONFIG, np.random.default_rng([3, 0]))
        for one in (policies, agent):
            one.observe(*state_of(WHERE))
        place = policies.intent_of[goals[0] * N_GOALS + goals[1]]
        assert policies.intents[place] == agent.intent


def drawn_goals(rng: np.random.Generator, n: int) -> list[tuple[int, ...]]:
    """Return goals of three agents, of which many help, hinder or share."""
    possible = [possible_goals(agent, TRIO) for agent in range(3)]
    found = []
    for _ in range(n):
        goals = [int(rng.choice(own)) for own in possible]
        for agent, other in enumerate(rng.integers(3, size=3).tolist()):
            if other != agent and rng.random() < 0.5:
                act = (shared_goal, opposed_goal)[rng.integers(2)]
                goals[agent] = act(goals[other], other, agent, TRIO)
        if all(goal in own for goal, own in zip(goals, possible, strict=True)):
            found.append(tuple(goals))
    return found


@pytest.mark.parametrize("agent", range(3))
def test_an_agent_of_three_has_the_intent_that_it_has_with_just_these_goals(agent: int) -> None:
    where = TRIO.random_scene(4)
    model = WorldModel.of(where, (450.0, 300.0, 600.0), FEW)
    every = Policies(agent, model, FEW, seed=1)
    every.observe(*state_of(where))
    goals = drawn_goals(np.random.default_rng(agent), 40)
    places = standpoints(agent, TRIO).of(np.array(goals))
    assert len(set(places.tolist())) > 20
    for each, place in zip(goals, places.tolist(), strict=True):
        alone = Policies(agent, model, FEW, seed=1, goals=[each])
        alone.observe(*state_of(where))
        assert every.intents[every.intent_of[place]] == alone.intents[0], each
