"""Monte-Carlo errors: how they print, and that they are as large as runs differ."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.stats import beta

from phase_ppl.analysis.estimate import Estimate, Mode, doubt, leaving_out, shares, widened
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.world.goals import GOALS

from .factory import (
    BLUE_TO_RED,
    PINK_TO_BLUE,
    Simulation,
    hypothesis,
    make_tree,
    posterior_of,
    random_tree,
    with_densities,
    with_prior,
    with_variables,
)


def test_an_estimate_prints_with_the_digits_that_are_certain() -> None:
    for value, error, printed in (
        (0.8312, 0.041, "0.83 ± 0.04"),
        (0.8312, 0.0123, "0.831 ± 0.012"),
        (0.75, 0.36, "0.8 ± 0.4"),
        (442.3, 8.6, "442 ± 9"),
        (442.3, 140.0, "442 ± 140"),
        (1.0, 0.0, "1 ± 0"),
        (0.25, math.nan, "0.25 ± unknown"),
        (0.99999, 2e-7, "1 ± 2e-07"),
        (0.0000375, 4e-5, "4e-05 ± 4e-05"),
        (0.0, 4e-5, "0 ± 4e-05"),
        (0.5, 0.0999, "0.50 ± 0.10"),
    ):
        assert str(Estimate(value, error)) == f"{Estimate(value, error)}" == printed


def test_an_estimate_is_a_float_in_all_else() -> None:
    estimate = Estimate(0.25, 0.1)
    assert estimate == 0.25
    assert f"{estimate:.1%}" == "25.0%"
    assert json.dumps([estimate]) == "[0.25]"
    assert type(estimate + 1) is float
    assert np.array([estimate]).dtype == float
    for one in (estimate, Mode("friendly", 0.1)):
        copied = pickle.loads(pickle.dumps(one))
        assert (copied, copied.error) == (one, 0.1)


def test_with_single_chains_left_out_the_error_of_a_mean_is_sd_over_root_n() -> None:
    strengths = [200.0, 260.0, 320.0, 500.0]
    hypotheses = [hypothesis(strengths=(s, 300)) for s in strengths]
    post = posterior_of(hypotheses, [[i, i] for i in range(4)])
    expected = np.std(strengths, ddof=1) / 2 * widened(4)
    assert post.mean("strength_red").error == pytest.approx(expected)
    without = [np.std(np.delete(strengths, i)) for i in range(4)]
    assert post.sd("strength_red").error == pytest.approx(np.sqrt(3) * np.std(without))
    indicator = np.std([1, 1, 0, 0], ddof=1) / 2
    assert post.probability(strength_red=(0, 300)).error == pytest.approx(indicator)
    # all chains say the same, and so nothing of how far off they are
    assert math.isnan(post.mean("strength_green").error)


def test_one_chain_knows_no_error() -> None:
    post = Posterior(random_tree(1, n_chains=1))
    assert math.isnan(post.top("goal_red")[0][1].error)
    for asked in ("P(relation=neutral)", "mode goal_red", "H(goal_red)", "E[strength_red]",
                  "sd[strength_red]", "P(relation)", "hdi strength_red"):  # fmt: skip
        assert np.isnan(post.query(asked).error).all()


def test_no_error_is_known_where_a_single_chain_meets_the_condition() -> None:
    post = posterior_of((BLUE_TO_RED, PINK_TO_BLUE), [[0, 0], [0, 0], [0, 1]])
    alone = post.probability({"goal_red": PINK_TO_BLUE}, relation="friendly")
    assert math.isnan(alone.error)
    assert np.isnan(post.marginal("relation", given={"goal_red": PINK_TO_BLUE}).error).all()
    assert 0 < post.probability({"goal_red": BLUE_TO_RED}, relation="friendly").error < 0.5


def test_all_questions_about_a_label_have_the_same_error() -> None:
    post = Posterior(random_tree(3, n_chains=6))
    label, estimate = post.top("goal_red")[0]
    of_table = post.marginal("goal_red").error.sel(goal_red=label).item()
    assert estimate.error == pytest.approx(post.probability(goal_red=label).error)
    assert estimate.error == pytest.approx(of_table)
    both = {"goal_red": label, "relation": "neutral"}
    of_table = post.joint(*both).error.sel(both).item()
    assert post.probability(**both).error == pytest.approx(of_table)


def test_the_mode_doubts_itself_by_half_in_a_tie_and_little_where_all_agree() -> None:
    tied = posterior_of((2, 5), [[0], [0], [1], [1]]).mode("goal_red")
    assert (tied, tied.error) == (GOALS[2], 0.5)
    agreed = posterior_of((5, 5, 5), [[0, 0], [1, 1], [2, 2]]).mode("goal_red")
    # three independent draws that agree: Jeffreys' posterior of one half or less
    assert (agreed, agreed.error) == (GOALS[5], pytest.approx(beta(3.5, 0.5).cdf(0.5)))
    # of 8 chains 5 lead: the difference 1/4 has the error 2 sd / sqrt(8), sd^2 = 15 / 56
    leads = posterior_of((2,) * 5 + (5,) * 3, [[i, i] for i in range(8)]).mode("goal_red")
    z = 0.25 / (2 * math.sqrt(15 / 56) / math.sqrt(8))
    by_chains = 0.5 * math.erfc(z / math.sqrt(2))
    codes, weights = np.repeat([0, 1], [5, 3]), np.full(8, 1 / 8)
    without = leaving_out(weights, np.arange(8))
    assert without is not None
    found = doubt(shares(codes, weights), without, shares(codes, without.weights))
    assert found == pytest.approx(by_chains)
    # as sure as 7 independent draws would be: sum p (1 - p) / sum of squared errors
    by_draws = beta(7 * 5 / 8 + 0.5, 7 * 3 / 8 + 0.5).cdf(0.5)
    assert leads.error == pytest.approx(max(by_chains, by_draws))


STATISTICS: dict[str, Callable[[Any], Any]] = {
    "P(relation=friendly)": lambda found: found,
    f"P(strength_red in [0, 350] | goal_red={GOALS[5]})": lambda found: found,
    "top 3 goal_red": lambda found: found[0][1],
    "H(goal_red, goal_green)": lambda found: found,
    "E[strength_red]": lambda found: found,
    "sd[strength_red]": lambda found: found,
    "hdi 0.8 strength_red": lambda found: found[0],
    "hdi 80% strength_red": lambda found: found[1],
}
"""Question -> what of its answer."""


def sticky_chains(rng: np.random.Generator) -> Posterior:
    """15 chains of 6 draws that often stay where they are."""
    simulations: list[Simulation] = []
    draws = np.empty((15, 6), int)
    for chain, column in np.ndindex(draws.shape):
        if not column or rng.random() >= 0.6:
            goal = int(rng.choice([2, 5, 9], p=[0.5, 0.35, 0.15]))
            green = goal if rng.random() < 0.4 else 12
            strength = float(rng.normal(300 + 10 * goal, 60))
            simulations.append(Simulation(hypothesis(goal, green, strengths=(strength, 300))))
        draws[chain, column] = len(simulations) - 1
    return Posterior(make_tree(simulations, draws.tolist(), n_frames=2))


@pytest.fixture(scope="module")
def repetitions() -> Sequence[Posterior]:
    rng = np.random.default_rng(0)
    return [sticky_chains(rng) for _ in range(80)]


@pytest.mark.parametrize("name", STATISTICS)
def test_errors_are_as_large_as_runs_differ(repetitions: Sequence[Posterior], name: str) -> None:
    answers = [STATISTICS[name](post.query(name)) for post in repetitions]
    assert 0.75 < error_over_spread(answers) < 1.75


def error_over_spread(results: Sequence[Any]) -> float:
    """Return how large the errors of repetitions are, over the spread of their values."""
    values, errors = np.array([(float(one), float(one.error)) for one in results]).T
    return float(math.sqrt((errors**2).mean()) / values.std())


def test_few_particles_that_agree_leave_room_for_what_they_did_not_show() -> None:
    each = [[i, i] for i in range(16)]
    post = posterior_of((2,) * 15, each[:15])
    # Jeffreys: mean 0.5 / 16 after 15 draws without it, variance p (1 - p) / 17
    expected = unseen(0.5, 15)
    assert post.probability(goal_red=GOALS[5]).error == pytest.approx(expected)
    assert post.probability(goal_red=GOALS[2]).error == pytest.approx(expected)
    # any other of all goals: one draw is shared by all of them
    by_label = post.marginal("goal_red").error.sel(goal_red=GOALS[9])
    assert float(by_label) == pytest.approx(unseen(1 / len(GOALS), 15))
    # of 16 that are worth 15 half fulfil the condition
    half = posterior_of((2, 5) * 8, each)
    of_half = half.probability({"goal_red": GOALS[2]}, scenario="independent")
    assert of_half.error == pytest.approx(unseen(0.5, 7.5))


def unseen(beforehand: float, n: float) -> float:
    """Return the error of what none of ``n`` draws is, of a posterior with such a prior."""
    mean = beforehand / (n + 1)
    return math.sqrt(mean * (1 - mean) / (n + 2) + mean**2)


def test_draws_are_worth_no_more_than_the_simulations_that_they_rest_on() -> None:
    # all agree, but it is one simulation: nothing is sure
    one = posterior_of((2, 5), [[0, 0]] * 15)
    assert one.diagnostics()["effective_size"] == pytest.approx(1)
    assert one.probability(goal_red=GOALS[5]).error == pytest.approx(unseen(0.5, 1))
    assert not one.leaders()["goal_red"]["sure"]
    assert "rest on 1.0 effective simulations; an answer needs 10" in one.diagnostics()["verdict"]
    # particles that were chosen among all along are worth half
    tree = posterior_of((2,) * 15, [[i] for i in range(15)]).tree
    evidence = (("chain", "draw"), np.zeros((15, 1)))
    tree = with_variables(tree, "sample_stats", log_evidence=evidence)
    assert Posterior(tree).diagnostics()["effective_size"] == pytest.approx(7.5)


def test_chains_that_have_not_come_to_where_the_others_are_do_not_count() -> None:
    def post(*behind: float) -> Posterior:
        level = [0.0, *behind]
        simulations = [
            Simulation(hypothesis(5), 2 * chain + draw, iteration=1, log_likelihood=level[chain])
            for chain, draw in np.ndindex(len(level), 2)
        ]
        draws = [[2 * chain, 2 * chain + 1] for chain in range(len(level))]
        return Posterior(make_tree(simulations, draws), "count")

    alike, alone = post(*[0.0] * 9), post(*[-20.0] * 9)
    assert alike.diagnostics()["effective_size"] == pytest.approx(20)
    assert alone.diagnostics()["effective_size"] == pytest.approx(1)
    assert alike.leaders()["goal_red"]["sure"]
    assert not alone.leaders()["goal_red"]["sure"]


def test_draws_are_worth_what_those_of_the_less_sure_goal_are() -> None:
    reds = [[2, 5], [5, 2]] * 3 + [[2, 5], [2, 2]]  # and one goal of green in each chain
    pairs = [hypothesis(red, 9 if c < 4 else 12) for c, row in enumerate(reds) for red in row]
    post = posterior_of(pairs, np.arange(16).reshape(8, 2).tolist())
    # of green, who never moves, by the jackknife of 8 chains
    assert post.diagnostics()["effective_size"] == pytest.approx(7)


def test_chains_that_still_move_have_larger_errors() -> None:
    moved = posterior_of((2, 5), [[0, 0, 1, 1]] * 6 + [[1, 0, 1, 0]] * 2)
    mixed = posterior_of((2, 5), [[0, 1, 0, 1]] * 6 + [[1, 0, 1, 0]] * 2)
    still, steady = (post.probability(goal_red=GOALS[2]) for post in (moved, mixed))
    assert still == steady == 0.5
    assert still.error > 2 * steady.error


@pytest.mark.parametrize(
    ("noise", "most"),
    # where simulations of a pair hardly vary, errors are larger than runs differ: they are no
    # surer than by as many draws as the weights are worth
    [(0.5, 3.0), (1.4, 1.8)],
)
def test_errors_of_strata_are_as_large_as_runs_differ(noise: float, most: float) -> None:
    """Chains draw three pairs of goals from uneven proposals, with noisy likelihoods."""
    rng = np.random.default_rng(1)
    goals, proposal = [2, 5, 9], np.array([0.5, 0.3, 0.2])
    results = []
    for _ in range(40):
        simulations, log_proposal = [], []
        for chain, iteration in np.ndindex(15, 7):
            which = int(rng.choice(3, p=proposal))
            log_proposal.append(math.log(proposal[which]))
            likelihood = float(rng.normal(-goals[which] / 5, noise))
            made = {"seed": 7 * chain + iteration, "chain": chain, "iteration": iteration}
            h = hypothesis(goals[which], 12)
            simulations.append(Simulation(h, log_likelihood=likelihood, **made))
        tree = make_tree(simulations, [[7 * chain] for chain in range(15)], n_frames=2)
        tree = with_densities(tree, log_proposal)
        tree = with_prior(tree, [(hypothesis(goal, 12), 1 / 3) for goal in goals])
        results.append(Posterior(tree, "stratified").probability(goal_red=GOALS[2]))
    assert 0.75 < error_over_spread(results) < most
    exact = np.exp(-np.array(goals) / 5) / np.exp(-np.array(goals) / 5).sum()
    bias = 0.02 if noise == 0.5 else 0.4 * np.std(results)  # of truncating large weights
    assert np.mean(results) == pytest.approx(exact[0], abs=bias)


@pytest.mark.parametrize("n", [3, 5, 30])
def test_errors_of_a_mean_of_few_draws_hold_what_they_say(n: int) -> None:
    draws = np.random.default_rng(0).normal(size=(4000, n))
    error = draws.std(axis=1, ddof=1) / np.sqrt(n) * widened(n)
    assert (np.abs(draws.mean(axis=1)) <= 1.96 * error).mean() == pytest.approx(0.95, abs=0.015)
    assert widened(float("nan")) == 1.0
    assert widened(1.5) == widened(3)  # with one degree of freedom it would be 6.5
