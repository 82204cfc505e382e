"""POMCP finds sensible actions, and its savings are what they claim to be."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from phase_ppl.agents import pomcp
from phase_ppl.agents.agent import Intent, RootStatistics
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.physics.actions import Action
from phase_ppl.world.errors import UnknownNameError
from phase_ppl.world.goals import goal_index
from phase_ppl.world.names import STOP, Literal, PredicateKind
from phase_ppl.world.scene import Scene
from tests.agents.scenes import (
    FULL_WALL_UP,
    HALF_WALL_LEFT,
    HALF_WALL_RIGHT,
    NARROW_WALL_DOWN,
    agent_in,
    model_of,
    scene,
    state_of,
)

CONFIG = PlannerConfig(simulations=400, full_observation=True)
GOALS = (goal_index("Get red agent to red lm"), goal_index("Get green agent to green lm"))
ABOVE = scene(red=(23.5, 14.0, math.pi))  # the red agent heads for the red landmark
TO_LANDMARK, TOUCH = Literal(PredicateKind.ON, 0, 2), Literal(PredicateKind.TOUCH, 0, 2)


def search(
    where: Scene, subgoal: Literal, config: PlannerConfig = CONFIG, seed: int = 0
) -> RootStatistics:
    agent = agent_in(where, GOALS, config, seed)
    agent.observe(*state_of(where))
    (found,) = agent.root_statistics([Intent(subgoal, tuple(range(50)), contested=False)])
    return found


@pytest.mark.parametrize(
    ("where", "subgoal", "best"),
    [
        (ABOVE, TO_LANDMARK, Action.UP),
        (scene(red=(23.5, 9.5, -math.pi / 2), green=(8, 20, 0), blue=(10, 20)), TO_LANDMARK,
         Action.TURN_RIGHT),
        (scene(red=(12.0, 9.0, 0.0), blue=(12.0, 11.0)), Literal(PredicateKind.ATTACH, 0, 2),
         Action.ATTACH),
    ],
    ids=["drives straight ahead", "turns to what is behind it", "grabs what is in reach"],
)  # fmt: skip
def test_an_agent_does_what_leads_to_its_goal(where: Scene, subgoal: Literal, best: Action) -> None:
    assert search(where, subgoal).best is best


def test_an_action_is_worth_the_mean_of_its_discounted_rewards() -> None:
    walls = [FULL_WALL_UP, HALF_WALL_LEFT, NARROW_WALL_DOWN, HALF_WALL_RIGHT]
    opposite = Literal(PredicateKind.CLOSE, 0, 2)  # to be in a room as far as can be: -1 a step
    ten = dataclasses.replace(CONFIG, simulations=10, early_stop=False)
    found = search(scene(walls=walls), opposite, ten)
    np.testing.assert_array_equal(found.visits, [2] * 5)  # a step in the tree, then two
    lasting = [-(1 - 0.95 ** (steps + 10)) / 0.05 for steps in (1, 2)]
    assert found.values == pytest.approx([np.mean(lasting)] * 5)


@pytest.mark.parametrize("paired", [False, True])
def test_early_stop_saves_simulations_and_never_changes_the_action(paired: bool) -> None:
    saved = 0
    whole, early = (
        dataclasses.replace(CONFIG, early_stop=stop, paired=paired) for stop in (False, True)
    )
    for seed in range(6):
        where = scene(red=(12.0, 9.0, float(seed)), blue=(14.0, 6.0))
        for subgoal in (TOUCH, Literal(PredicateKind.ON, 2, 2)):
            one, other = (search(where, subgoal, config, seed) for config in (whole, early))
            assert one.best == other.best
            assert other.visits.sum() <= one.visits.sum() == CONFIG.simulations
            saved += int(one.visits.sum() - other.visits.sum())
    assert saved > 0


def test_paired_actions_of_the_same_effect_are_worth_exactly_the_same() -> None:
    def gaps_of(paired: bool) -> list[float]:
        """Differences in value of stopping and doing nothing, the same for an agent at rest."""
        config = dataclasses.replace(CONFIG, simulations=100, paired=paired, early_stop=False)
        gaps = []
        for seed in range(8):
            found = search(ABOVE, TO_LANDMARK, config, seed)
            pair = [found.actions.tolist().index(a) for a in (Action.STOP, Action.NO_FORCE)]
            if len(set(found.visits[pair])) == 1:
                gaps.append(abs(float(np.diff(found.values[pair])[0])))
        return gaps

    assert max(gaps_of(paired=True)) < 1e-12
    assert min(gaps_of(paired=False), default=1.0) > 1e-6


@pytest.mark.parametrize(
    ("subgoal", "action"),
    [(STOP, Action.STOP), (Literal(PredicateKind.ATTACH, 0, 2, positive=False), Action.DETACH)],
)
def test_stop_and_letting_go_need_no_search(subgoal: Literal, action: Action) -> None:
    found = search(scene(), subgoal)
    assert found.best is action
    assert (found.actions.tolist(), found.visits.tolist()) == ([action], [1])


@pytest.mark.parametrize(
    ("subgoal", "held", "contested", "number"),
    [
        (TOUCH, -1, False, 5),
        (Literal(PredicateKind.CLOSE, 0, 1), -1, False, 5),
        (Literal(PredicateKind.ON, 0, 1), -1, False, 5),
        (Literal(PredicateKind.ON, 2, 1), -1, False, 13),
        (Literal(PredicateKind.ATTACH, 0, 2), -1, False, 13),
        (Literal(PredicateKind.ON, 1, 1, positive=False), -1, False, 12),
        (Literal(PredicateKind.CLOSE, 2, 1), 2, False, 12),
        # one that is kept from its landmark also moves sideways
        (Literal(PredicateKind.ON, 0, 1), -1, True, 12),
        (Literal(PredicateKind.CLOSE, 0, 1), -1, True, 5),
    ],
)
def test_navigation_uses_five_actions_and_carrying_more(
    subgoal: Literal, held: int, contested: bool, number: int
) -> None:
    assert len(pomcp.actions_for(subgoal, 0, held, contested)) == number


def test_reward_falls_with_path_distance_and_sideways_steps_cost() -> None:
    model, (bodies, held, _) = model_of(ABOVE), state_of(ABOVE)
    ahead, sideways = (
        pomcp.reward(
            *(bodies, held, pomcp.subgoal_code(TO_LANDMARK), int(action)),
            *(model.params, model.layout),
        )
        for action in (Action.UP, Action.LEFT)
    )
    assert ahead == pytest.approx(-9.5 / math.hypot(20, 20), abs=1e-6)
    assert ahead - sideways == pytest.approx(0.02)


def test_settings_are_read_as_they_were_written() -> None:
    config = PlannerConfig(simulations=7, paired=True)
    assert PlannerConfig.from_dict(config.to_dict()) == config
    with pytest.raises(UnknownNameError, match="did you mean 'paired'"):
        PlannerConfig.from_dict({**config.to_dict(), "pairs": True})
    with pytest.raises(UnknownNameError, match="'fast'"):
        PlannerConfig.named("quick")
