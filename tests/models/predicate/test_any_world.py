"""Predicate inverse planning with other casts and floor plans than PHASE's."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.models.predicate import marginals, prior_in
from phase_ppl.models.predicate import (
    CostToGo,
    SymbolicState,
    log_prior_of_pairs,
    posterior,
    without_physics,
)
from phase_ppl.world.goals import effective_goal, goal_literal, possible_goals
from phase_ppl.world.hypothesis import RELATIONS, Roles, all_ways
from phase_ppl.world.names import NOTHING

PHASE, SOLO, TRIO = ppl.worlds.PHASE, ppl.worlds.SOLO, ppl.worlds.TRIO
THREE = ppl.World(["ann", "bob", "cy"], [], {"home": (3, 3)}, arena=(0, 12, 0, 12), name="three")


@pytest.mark.parametrize("name", ["uniform", "sparse_social", "independent"])
def test_two_agents_are_inverted_as_pairs_of_phase_are(name: str) -> None:
    likelihood = np.random.default_rng(0).normal(0, 3, (2, len(PHASE.goals)))
    pairs = posterior(likelihood, log_prior_of_pairs(name))
    found = marginals(likelihood, prior_in(PHASE, name), PHASE)
    for question, shares in pairs.items():
        np.testing.assert_allclose(found[question], shares, atol=1e-6)


def test_three_agents_are_summed_over_as_if_all_roles_were_listed() -> None:
    likelihood = np.random.default_rng(1).normal(0, 2, (3, len(THREE.goals)))
    prior = prior_in(THREE, "uniform")
    expected = {"goal_ann": np.zeros(len(THREE.goals)), "relation_ann_cy": np.zeros(3)}
    relations: dict[tuple[int, ...], int] = {}
    for number, way in enumerate(all_ways(3)):
        own = [possible_goals(a, THREE) if one is None else [0] for a, one in enumerate(way)]
        for stated in itertools.product(*own):
            goals = tuple(effective_goal(stated, a, one, THREE) for a, one in enumerate(way))
            log_p = prior.company[number] + likelihood[range(3), goals].sum()
            log_p += sum(prior.goals[a, stated[a]] for a, one in enumerate(way) if one is None)
            if (goals[0], goals[2]) not in relations:
                roles = Roles(THREE, goals, (None,) * 3, (450.0,) * 3)
                name = roles.relation_between("ann", "cy")
                relations[goals[0], goals[2]] = RELATIONS.index(name)
            expected["goal_ann"][goals[0]] += np.exp(log_p)
            expected["relation_ann_cy"][relations[goals[0], goals[2]]] += np.exp(log_p)
    found = marginals(likelihood, prior, THREE)
    for question, values in expected.items():
        np.testing.assert_allclose(found[question], values / values.sum(), atol=1e-5)
    assert all(shares.sum() == pytest.approx(1) for shares in found.values())


def cost(goal: str, agent: int, world: ppl.World, state: SymbolicState) -> float:
    literal = goal_literal(world.goal_index(goal), agent, world)
    to_go = CostToGo(without_physics(world.random_scene(0)), agent, literal)
    return to_go(to_go.node(state))


def test_of_two_landmarks_in_a_room_the_goals_is_the_one_to_be_on() -> None:
    barn = SOLO.landmark_names.index("barn")
    state = SymbolicState((1, 1, 0), (NOTHING,), ((False, True, False),), (NOTHING, barn, NOTHING))
    assert cost("ball to barn", 0, SOLO, state) == 0
    assert cost("ball to field", 0, SOLO, state) == pytest.approx(0.5 + 3)  # grip, place
    assert cost("get to ball", 0, SOLO, state) == 0
    assert cost("get away from ball", 0, SOLO, state) > 10  # to the other room
    assert cost("box to home", 0, SOLO, state) > 10 + 3 + 0.5


def test_what_is_left_to_do_of_goals_about_two_others() -> None:
    rooms, nobody = (0, 0, 1, 0, 2), (False,) * 5
    near = (nobody, nobody, nobody)
    state = SymbolicState(rooms, (NOTHING,) * 3, near, (NOTHING,) * 5)
    purple = TRIO.agent("purple agent")
    assert cost("red agent to blue ball", purple, TRIO, state) == 0  # it is in its room
    assert cost("green agent to red agent", purple, TRIO, state) == 0  # they go by themselves
    assert cost("green agent away from red agent", purple, TRIO, state) >= 12 + 3
    there = state._replace(near=(nobody, nobody, (False, True, False, False, False)))
    assert cost("green agent away from red agent", purple, TRIO, there) == 0
    assert cost("red agent to pink ball", purple, TRIO, state) > 12 + 3 + 0.5


def test_a_delivered_item_tells_the_goal() -> None:
    event = ppl.simulate(
        SOLO.random_scene(1), goals={"red agent": "ball to home"}, frames=60, seed=1, id="solo"
    )
    found = ppl.evaluate([event], "predicate", workers=1, progress=False).predictions["solo"]
    assert found.answers["goal_red"] == "Get ball to home"
