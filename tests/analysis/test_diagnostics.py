"""Diagnostics against hand-worked chains, and the verdict in words."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from phase_ppl.analysis import Posterior
from phase_ppl.world.hypothesis import Hypothesis

from .factory import BLUE_TO_RED, PINK_TO_BLUE, Simulation, hypothesis, make_tree, random_tree


def initial(h: Hypothesis, seed: int, **options: float) -> Simulation:
    return Simulation(h, seed, iteration=0, **options)  # type: ignore[arg-type]


def proposed(h: Hypothesis, seed: int, **options: object) -> Simulation:
    return Simulation(h, seed, iteration=1, **options)  # type: ignore[arg-type]


A, B = hypothesis(BLUE_TO_RED), hypothesis(PINK_TO_BLUE)


def test_two_chains_worked_out_by_hand() -> None:
    simulations = [
        initial(A, 0),
        proposed(A, 1),
        proposed(B, 2),
        initial(A, 3),
        proposed(B, 4, completed=False, frames=2),
        proposed(B, 5, completed=False, failed=True, frames=1),
    ]
    found = Posterior(make_tree(simulations, [[1, 2], [3, 3]], n_frames=5)).diagnostics()
    assert (found["particles"], found["iterations"]) == (2, 2)
    assert found["acceptance_by_iteration"] == [0.5, 0.5]
    assert found["acceptance_rate"] == 0.5
    assert found["move_rate"] == 0.5
    assert found["distinct_hypotheses"] == 2
    assert found["distinct_goal_pairs"] == 2
    assert found["simulations"] == {"total": 6, "completed": 4, "aborted": 1, "failed": 1}
    assert found["frames_saved"] == 3
    assert found["frames_saved_share"] == pytest.approx(3 / 25)
    # red's marginals: chain 0 half A half B, chain 1 all A
    assert found["between_chain_tv"]["goal_red"] == {"mean": 0.5, "max": 0.5}
    assert found["between_chain_tv"]["goal_green"] == {"mean": 0.0, "max": 0.0}
    assert found["monte_carlo_error"]["goal_red"] == pytest.approx(0.25)
    assert found["effective_rows"] == pytest.approx(4)
    # green's goal is the same in all; chain 0 is tied, its first label is A's
    assert found["agreement"] == {"goal_red": 1.0, "goal_green": 1.0}
    assert "1 of 6 simulations failed" in found["verdict"]


def test_best_error_per_frame_is_that_of_the_best_draw() -> None:
    observed = np.tile([10.0, 10.0, 0.0], (4, 4, 1))
    predicted = np.stack([observed + np.array(shift) for shift in ((3, 4, 9), (0, 1, 9))])
    tree = make_tree(
        [initial(A, 0), proposed(B, 1)], [[0, 1]], observed=observed, predicted=predicted
    )
    # one unit per entity, four entities
    assert Posterior(tree).diagnostics()["best_error_per_frame"] == pytest.approx(2)


def test_effective_rows_fall_with_uneven_weights() -> None:
    simulations = [proposed(A, 0, log_likelihood=0.0), proposed(B, 1, log_likelihood=-50.0)]
    post = Posterior(make_tree(simulations, [[0, 1]]), "likelihood")
    assert post.diagnostics()["effective_rows"] == pytest.approx(1)


def test_weighted_draws_are_judged_by_their_weights() -> None:
    simulations = [proposed(A, 0), proposed(B, 1)]
    tree = make_tree(simulations, [[0], [1], [1], [0]])
    log_weight = np.log([[3.0], [1.0], [1.0], [1.0]])
    tree["sample_stats"]["log_weight"] = xr.DataArray(log_weight, dims=("chain", "draw"))
    found = Posterior(tree, "count").diagnostics()
    assert found["weighted_draws_ess"] == pytest.approx(36 / 12 / 4)
    # a ratio estimate: sqrt(4/3 * sum of (share * (indicator - 2/3))^2)
    deviations = np.array([3 / 6 * 1 / 3, 1 / 6 * 2 / 3, 1 / 6 * 2 / 3, 1 / 6 * 1 / 3])
    expected = np.sqrt(4 / 3 * (deviations**2).sum())
    assert found["monte_carlo_error"]["goal_red"] == pytest.approx(expected)
    assert "4 weighted draws are worth 3.0 equal ones" in found["verdict"]
    assert "accepted" not in found["verdict"]


def verdict(
    draws: list[list[int]], simulations: list[Simulation], weights: str = "count", **options: str
) -> str:
    tree = make_tree(simulations, draws, **options)  # type: ignore[arg-type]
    return str(Posterior(tree, weights).diagnostics()["verdict"])


def test_verdict_says_on_whose_goal_the_particles_agree() -> None:
    simulations = [proposed(hypothesis(goal, PINK_TO_BLUE), goal) for goal in range(4)]
    simulations += [proposed(hypothesis(BLUE_TO_RED, goal), goal) for goal in range(4)]
    one_each = [[0], [1], [2], [3]]
    assert "agree on the green agent's goal but not on the red agent's" in verdict(
        one_each, simulations
    )
    assert "agree on the red agent's goal but not on the green agent's" in verdict(
        [[4], [5], [6], [7]], simulations
    )
    assert "agree on neither" in verdict([[0], [1], [6], [7]], simulations)
    assert "agree on both" in verdict([[0], [0]], simulations)


def test_verdict_calls_chains_that_never_moved_a_guess() -> None:
    assert "No proposal was accepted" in verdict([[0, 0], [0, 0]], [initial(A, 0)])


def test_verdict_warns_of_few_acceptances() -> None:
    simulations = [initial(A, 0), proposed(A, 1)]
    assert "Only 2% of the proposals" in verdict([[0] * 24 + [1], [0] * 25], simulations)


def test_verdict_of_a_single_particle_asks_for_more() -> None:
    post = Posterior(make_tree([proposed(A, 0)], [[0]]))
    found = post.diagnostics()
    assert found["between_chain_tv"] == {"goal_red": None, "goal_green": None}
    assert found["move_rate"] is None
    assert "use more" in found["verdict"]


def test_verdict_discloses_approximate_kernels_and_weights() -> None:
    simulations = [proposed(A, 0), proposed(B, 1, completed=False)]
    assert "approximate" in verdict([[0]], simulations, validity="approximate")
    assert "approximate" not in verdict([[0]], simulations, validity="exact")
    assert "at most 50.0% of their mass" in verdict([[0]], simulations, "visited")
    assert "too extreme" in verdict([[0]], simulations, "likelihood")


@pytest.mark.parametrize("weights", ["count", "visited", "likelihood"])
def test_rates_are_shares(weights: str) -> None:
    found = Posterior(random_tree(9, n_chains=5), weights).diagnostics()
    for name in ("acceptance_rate", "move_rate", "frames_saved_share", "aborted_mass_bound"):
        assert 0 <= found[name] <= 1
    assert len(found["acceptance_by_iteration"]) == found["iterations"]
