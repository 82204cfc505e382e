"""Frames are explained by all sets of searches together, and by agents that may stop trying."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.agents.policies import Outlook
from phase_ppl.closed_loop.reader import Conduct, GoalFilter, Looked
from phase_ppl.physics.actions import N_ACTIONS, Action
from phase_ppl.world.goals import N_GOALS

CONDUCT = Conduct(sharpness=2.0, lapse=0.3, leave=0.2, resume=0.1)
RED, GREEN = 3, 7


def outlook(rng: np.random.Generator) -> Outlook:
    visits = rng.integers(1, 9, 4)
    actions = rng.choice(N_ACTIONS, 4, replace=False)
    return Outlook(actions, visits, np.zeros(4), Action(int(actions[visits.argmax()])))


def looked(rng: np.random.Generator) -> list[Looked]:
    """Return policies of both agents that are the same for all goals but RED and GREEN."""
    found = []
    for agent in range(2):
        of_pair = np.zeros((N_GOALS, N_GOALS), np.int64)
        (of_pair if agent == 0 else of_pair.T)[(RED, GREEN)[agent]] = 1
        of_pair[0] = -1  # names its own holder
        found.append(Looked([outlook(rng), outlook(rng)], of_pair))
    return found


def by_hand(steps: list[tuple[list[list[Looked]], NDArray[np.float64]]], sets: list[int]) -> float:
    """Return the log likelihood of RED, GREEN as a sum over all paths of both agents."""
    total = 0.0
    for path in itertools.product(range(4), repeat=len(steps)):
        joint = 1.0
        for agent in range(2):
            modes = [(code >> agent) & 1 for code in path]
            # one change before the first frame, which the stationary start allows for
            joint *= CONDUCT.start[modes[0]]
            for before, now in itertools.pairwise(modes):
                joint *= CONDUCT.change[before, now]
        for code, (all_sets, relative) in zip(path, steps, strict=True):
            policies = []
            for agent in range(2):
                if (code >> agent) & 1:
                    policies.append(np.full(N_ACTIONS, 1 / N_ACTIONS))
                else:
                    each = [CONDUCT.policy(all_sets[i][agent].outlooks[1]) for i in sets]
                    policies.append(np.mean(each, axis=0))
            joint *= policies[0] @ relative @ policies[1]
        total += joint
    return float(np.log(total))


def test_the_likelihood_is_the_sum_over_all_ways_to_stray() -> None:
    rng = np.random.default_rng(0)
    steps = [
        ([looked(rng) for _ in range(3)], rng.random((N_ACTIONS, N_ACTIONS))) for _ in range(4)
    ]
    goals, summed, left_out = GoalFilter(CONDUCT, 3), 0.0, np.zeros(3)
    everything = np.ones((N_GOALS, N_GOALS), bool)
    for all_sets, relative in steps:
        found, without = goals.take(all_sets, everything, relative, np.zeros((N_GOALS, N_GOALS)))
        summed += found[RED, GREEN]
        left_out += without[:, RED, GREEN]
        assert (found[0] == -np.inf).all()
        assert np.isfinite(found[1:]).all()
    assert summed == pytest.approx(by_hand(steps, [0, 1, 2]))
    for place, rest in enumerate(([1, 2], [0, 2], [0, 1])):
        assert left_out[place] == pytest.approx(by_hand(steps, rest))


def test_one_set_of_searches_has_nothing_to_be_left_out() -> None:
    rng = np.random.default_rng(1)
    goals = GoalFilter(CONDUCT, 1)
    everything = np.ones((N_GOALS, N_GOALS), bool)
    steps = [([looked(rng)], rng.random((N_ACTIONS, N_ACTIONS)))]
    found, without = goals.take(steps[0][0], everything, steps[0][1], np.zeros((N_GOALS, N_GOALS)))
    assert found[RED, GREEN] == pytest.approx(by_hand(steps, [0]))
    assert without.shape == (0, N_GOALS, N_GOALS)


def test_goals_with_one_set_of_searches_are_moved_with_the_others() -> None:
    rng = np.random.default_rng(2)
    wanted = np.zeros((N_GOALS, N_GOALS), bool)
    wanted[RED, GREEN] = True
    all_sets, relative = [looked(rng) for _ in range(2)], rng.random((N_ACTIONS, N_ACTIONS))
    flat = np.zeros((N_GOALS, N_GOALS))
    found, _ = GoalFilter(CONDUCT, 2).take(all_sets, wanted, relative, flat)
    alone, _ = GoalFilter(CONDUCT, 1).take(all_sets[:1], wanted, relative, flat)
    moved = found[RED, GREEN] - alone[RED, GREEN]
    assert moved != 0
    np.testing.assert_allclose(found[1:] - alone[1:], moved)
