"""Frames are explained by all sets of searches together."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.agents.agent import RootStatistics
from phase_ppl.closed_loop.frame_likelihood import log_likelihoods, shift_of
from phase_ppl.closed_loop.goal_filter import ActionPolicy, Plans, policies_of
from phase_ppl.physics.actions import N_ACTIONS, Action

POLICY = ActionPolicy(inverse_temperature=2.0, lapse=0.3)
STANDPOINTS = 5
OTHER = 3
"""The one standpoint of both agents from which they do something else than from the others."""


def root(rng: np.random.Generator) -> RootStatistics:
    visits = rng.integers(1, 9, 4)
    actions = rng.choice(N_ACTIONS, 4, replace=False)
    return RootStatistics(actions, visits, np.zeros(4), Action(int(actions[visits.argmax()])))


def drawn(n: int) -> tuple[list[list[Plans]], NDArray[np.float64]]:
    """Return plans of so many sets, and densities after every pair of actions."""
    rng = np.random.default_rng(n)
    intents = np.zeros(STANDPOINTS, np.int64)
    intents[OTHER] = 1
    sets = [[Plans([root(rng), root(rng)], intents) for _ in range(2)] for _ in range(n)]
    return sets, rng.random((N_ACTIONS, N_ACTIONS))


def read(
    sets: list[list[Plans]], density: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return log likelihoods of both agents with the same standpoint: of the first set, of all."""
    n = len(sets)
    policies, policy_of = policies_of(sets, POLICY)
    return log_likelihoods(np.log(density), policies, policy_of, 1 + n if n > 1 else 1)


def by_hand(
    sets: list[list[Plans]], density: NDArray[np.float64], some: list[int], intent: int = 1
) -> float:
    red, green = (
        np.mean([POLICY.of(sets[i][agent].roots[intent]) for i in some], axis=0)
        for agent in range(2)
    )
    return float(np.log((np.multiply.outer(red, green) * density).sum()))


def test_an_agent_does_what_was_tried_most_or_anything_whatever() -> None:
    found = RootStatistics(np.array([2, 5]), np.array([3, 1]), np.zeros(2), Action(2))
    anything, powers = 0.3 / N_ACTIONS, {2: 9 / 10, 5: 1 / 10}  # of 3 and 1 visits, squared
    expected = [anything + 0.7 * powers.get(action, 0.0) for action in range(N_ACTIONS)]
    assert POLICY.of(found) == pytest.approx(expected)


def test_the_likelihood_is_a_mean_over_all_sets_of_searches() -> None:
    sets, density = drawn(3)
    first, every = read(sets, density)
    assert np.isfinite(every).all()
    assert first[OTHER] == pytest.approx(by_hand(sets, density, [0]))
    for found, some in zip(every, ([0, 1, 2], [1, 2], [0, 2], [0, 1]), strict=True):
        assert found[OTHER] == pytest.approx(by_hand(sets, density, some))
        assert found[0] == pytest.approx(by_hand(sets, density, some, 0))
    one, density = drawn(1)
    first, every = read(one, density)
    assert len(every) == 1  # nothing is to be left out
    np.testing.assert_array_equal(first, every[0])


def test_goals_with_one_set_of_searches_are_moved_with_the_others() -> None:
    sets, density = drawn(2)
    only = np.full(STANDPOINTS, -1)
    only[OTHER] = 0
    sets[1] = [Plans([one.roots[1]], only) for one in sets[1]]
    first, every = read(sets, density)
    searched = np.arange(STANDPOINTS) == OTHER
    assert (np.isnan(every[0]) == ~searched).all()
    shift = shift_of(first, every, np.zeros(STANDPOINTS))
    assert shift[0] == pytest.approx(every[0, OTHER] - first[OTHER]) != 0
    nobody = np.where(searched, -np.inf, 0.0)  # has any mass of whom all sets have searched for
    assert (shift_of(first, every, nobody) == 0).all()
