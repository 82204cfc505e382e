"""Frames are explained by all sets of searches together."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.agents.agent import RootStatistics
from phase_ppl.closed_loop.goal_filter import Conduct, Plans, frame_log_likelihood
from phase_ppl.physics.actions import N_ACTIONS, Action
from phase_ppl.world.goals import N_GOALS

CONDUCT = Conduct(sharpness=2.0, lapse=0.3)
RED, GREEN = 3, 7
FLAT = np.zeros((N_GOALS, N_GOALS))
EVERYTHING = np.ones((N_GOALS, N_GOALS), bool)


def root(rng: np.random.Generator) -> RootStatistics:
    visits = rng.integers(1, 9, 4)
    actions = rng.choice(N_ACTIONS, 4, replace=False)
    return RootStatistics(actions, visits, np.zeros(4), Action(int(actions[visits.argmax()])))


def plans(rng: np.random.Generator) -> list[Plans]:
    """Return plans of both agents that are the same for all goals but RED and GREEN."""
    found = []
    for agent in range(2):
        of_pair = np.zeros((N_GOALS, N_GOALS), np.int64)
        (of_pair if agent == 0 else of_pair.T)[(RED, GREEN)[agent]] = 1
        of_pair[0] = -1  # names its own holder
        found.append(Plans([root(rng), root(rng)], of_pair.ravel()))
    return found


def by_hand(all_sets: list[list[Plans]], relative: NDArray[np.float64], sets: list[int]) -> float:
    """Return the log likelihood of RED, GREEN as a sum over all pairs of actions."""
    red, green = (
        np.mean([CONDUCT.policy(all_sets[i][agent].roots[1]) for i in sets], axis=0)
        for agent in range(2)
    )
    return float(np.log((np.multiply.outer(red, green) * relative).sum()))


def drawn(n: int) -> tuple[list[list[Plans]], NDArray[np.float64]]:
    """Return plans of so many sets, and densities after every pair of actions."""
    rng = np.random.default_rng(n)
    return [plans(rng) for _ in range(n)], rng.random((N_ACTIONS, N_ACTIONS))


def test_an_agent_does_what_was_tried_most_or_anything_whatever() -> None:
    found = RootStatistics(np.array([2, 5]), np.array([3, 1]), np.zeros(2), Action(2))
    anything, powers = 0.3 / N_ACTIONS, {2: 9 / 10, 5: 1 / 10}  # of 3 and 1 visits, squared
    expected = [anything + 0.7 * powers.get(action, 0.0) for action in range(N_ACTIONS)]
    assert CONDUCT.policy(found) == pytest.approx(expected)


def test_the_likelihood_is_a_mean_over_all_sets_of_searches() -> None:
    all_sets, relative = drawn(3)
    found, without = frame_log_likelihood(all_sets, EVERYTHING, relative, FLAT, CONDUCT)
    assert (found[0] == -np.inf).all()
    assert np.isfinite(found[1:]).all()
    assert found[RED, GREEN] == pytest.approx(by_hand(all_sets, relative, [0, 1, 2]))
    for place, rest in enumerate(([1, 2], [0, 2], [0, 1])):
        assert without[place, RED, GREEN] == pytest.approx(by_hand(all_sets, relative, rest))
    one, relative = drawn(1)
    found, without = frame_log_likelihood(one, EVERYTHING, relative, FLAT, CONDUCT)
    assert found[RED, GREEN] == pytest.approx(by_hand(one, relative, [0]))
    assert without.shape == (0, N_GOALS, N_GOALS)  # nothing is to be left out


def test_goals_with_one_set_of_searches_are_moved_with_the_others() -> None:
    all_sets, relative = drawn(2)
    wanted = np.zeros((N_GOALS, N_GOALS), bool)
    wanted[RED, GREEN] = True
    found, _ = frame_log_likelihood(all_sets, wanted, relative, FLAT, CONDUCT)
    alone, _ = frame_log_likelihood(all_sets[:1], wanted, relative, FLAT, CONDUCT)
    moved = found[RED, GREEN] - alone[RED, GREEN]
    assert moved != 0
    np.testing.assert_allclose(found[1:] - alone[1:], moved)
