"""Every weighting against weights worked out by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.tree import array
from phase_ppl.analysis.weights import truncated
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError

from .factory import (
    BLUE_TO_RED,
    PINK_TO_BLUE,
    TO_GREEN,
    TO_RED,
    Simulation,
    hypothesis,
    make_tree,
    random_tree,
    tree_by_frame,
    with_densities,
    with_log_weight,
    with_prior,
)

A = hypothesis(BLUE_TO_RED)
B = hypothesis(PINK_TO_BLUE)
PINK_TO_RED = "Get pink item to red lm"
C = hypothesis(PINK_TO_RED)
LOG = math.log


def goal_probabilities(post: Posterior) -> dict[str, float]:
    return {goal: value for goal, value in post.top("goal_red", 36) if value > 0}


def stratified(
    simulations: list[Simulation], prior: Any, rivals_from: Any = math.inf, **given: Any
) -> Posterior:
    """Return a posterior by strata of simulations with densities of proposals, 1 by default."""
    tree = make_tree(simulations, given.pop("draws", [[0]]))
    tree.attrs["rivals_from"] = rivals_from
    tree = with_densities(tree, **{"log_proposal": 0.0, **given})
    return Posterior(with_prior(tree, prior), "stratified")


def test_draws_count_alike_unless_the_kernel_gave_them_weights() -> None:
    tree = make_tree([Simulation(A), Simulation(B)], [[0, 0, 1], [1, 1, 1]])
    shares = {BLUE_TO_RED: 2 / 6, PINK_TO_BLUE: 4 / 6}
    assert goal_probabilities(Posterior(tree, "count")) == pytest.approx(shares)
    log_weight = np.log(np.array([[2.0, 0, 1], [1, 0, 0]]) + 1e-300) - 500
    post = Posterior(with_log_weight(tree, log_weight), "count")
    assert goal_probabilities(post)[BLUE_TO_RED] == pytest.approx(0.5)
    weightless = with_log_weight(tree, np.full((2, 3), -np.inf))
    with pytest.raises(InvalidSettingError, match="cannot be weighted"):
        Posterior(weightless, "count")


def test_weights_survive_log_densities_far_below_the_smallest_float() -> None:
    simulations = [
        Simulation(A, 1, -5000.0, -90000.0),
        Simulation(B, 2, -5000.0, -90000.0 + LOG(3), iteration=1),
    ]
    tree = with_prior(with_densities(make_tree(simulations, [[0, 1]]), 0.0), [(A, 0.5)])
    of_a, of_b = truncated(np.array([0.25, 0.75]))
    found = goal_probabilities(Posterior(tree, "stratified"))
    assert found == pytest.approx({BLUE_TO_RED: of_a, PINK_TO_BLUE: of_b})


def test_weights_default_to_what_the_run_recorded_and_unknown_ones_name_the_close_one() -> None:
    simulations = [Simulation(A, 1, 0.0, LOG(0.9)), Simulation(B, 2, 0.0, LOG(0.1))]
    tree = make_tree(simulations, [[0, 1]], weights="stratified")
    tree = with_prior(with_densities(tree, 0.0), [(A, 0.5), (B, 0.5)])
    assert Posterior(tree).weights == "stratified"
    with pytest.raises(UnknownNameError, match="'stratified'"):
        Posterior(tree, "stratifed")


EVEN = [(A, 0.5), (B, 0.5)]
TENTHS = [Simulation(A, 0, 0.0, LOG(0.1)), Simulation(B, 1, 0.0, LOG(0.1), iteration=1)]


@pytest.mark.parametrize(
    ("simulations", "options"),
    [
        # by prior times likelihood over proposal; what was stopped or failed does not count
        (
            [
                Simulation(A, 0, LOG(0.2), LOG(0.5)),
                Simulation(B, 1, LOG(0.2), LOG(0.8), iteration=1),
                Simulation(C, 2, LOG(0.1), LOG(0.9), completed=False, iteration=1),
                Simulation(C, 3, LOG(0.1), LOG(0.9), failed=True, iteration=1),
            ],
            {"log_proposal": np.log([0.5, 0.4, 0.5, 0.5])},
        ),
        # B completed with probability 0.1 / 0.2, so it counts twice; A for certain, so once
        (TENTHS, {"log_bound": [-LOG(0.05), -LOG(0.2)]}),
        # what was answered again counts again, by its known requests where the first is unknown
        (TENTHS, {"log_proposal": [0.0, math.nan], "log_again": [-math.inf, LOG(2)]}),
        (TENTHS, {"log_again": [-math.inf, 0.0]}),
    ],
    ids=["by proposal", "could have been stopped", "answered later", "answered again"],
)
def test_a_stratum_makes_up_for_how_simulations_came_about(
    simulations: list[Simulation], options: dict[str, Any]
) -> None:
    # of pairs that were proposed a few times: all are one stratum
    found = goal_probabilities(stratified(simulations, EVEN, **options))
    assert found == pytest.approx({BLUE_TO_RED: 1 / 3, PINK_TO_BLUE: 2 / 3})


def test_how_often_a_pair_was_asked_for_does_not_matter() -> None:
    post = stratified(TENTHS, EVEN, 0, log_again=[-math.inf, LOG(0.1)])
    halves = {BLUE_TO_RED: 1 / 2, PINK_TO_BLUE: 1 / 2}
    assert goal_probabilities(post) == pytest.approx(halves)
    # nor is a simulation cut that answers nine of ten requests: the mean of A's L is 0.22
    simulations = [
        Simulation(one, seed, 0.0, LOG(likelihood), iteration=1)
        for seed, (one, likelihood) in enumerate(((A, 0.2), (A, 0.4), (B, 0.08)))
    ]
    again = {"log_again": [LOG(8), -math.inf, -math.inf], "n_again": [8, 0, 0]}
    found = goal_probabilities(stratified(simulations, EVEN, 0, **again))
    assert found == pytest.approx({BLUE_TO_RED: 0.22 / 0.3, PINK_TO_BLUE: 0.08 / 0.3})


def test_a_pair_weighs_its_prior_and_mean_likelihood(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phase_ppl.analysis.weights.FEWEST_OF_PAIR", 5)
    # A was drawn more often than B, and by proposals of other densities; its mean L is
    # (2/6 x 0.2 + 1/6 x 0.4) for shares P / Q of 2 : 1 : 1 : 2, as what was stopped or failed, the
    # last one twice, has none. B and C were proposed less than five times: they share what prior A
    # leaves, by P / Q
    simulations = [
        Simulation(A, 0, LOG(0.1), LOG(0.2)),
        Simulation(A, 1, LOG(0.1), LOG(0.4), iteration=1),
        Simulation(A, 2, LOG(0.1), LOG(0.9), completed=False, iteration=1),
        Simulation(B, 3, LOG(0.1), LOG(0.6), iteration=1),
        Simulation(A, 4, LOG(0.1), LOG(0.9), failed=True, iteration=1),
        Simulation(C, 6, LOG(0.1), LOG(0.8), iteration=1),
    ]
    densities = {
        "log_proposal": np.log([0.2, 0.4, 0.4, 0.1, 0.4, 0.1]),
        "log_again": np.where(np.arange(6) == 4, -LOG(0.4), -math.inf),
    }
    prior = [(A, 0.6), (B, 0.1), (C, 0.1)]
    found = goal_probabilities(stratified(simulations, prior, **densities))
    masses = {BLUE_TO_RED: 0.6 * 0.8 / 6, PINK_TO_BLUE: 0.4 / 2 * 0.6, PINK_TO_RED: 0.4 / 2 * 0.8}
    total = sum(masses.values())
    assert found == pytest.approx({goal: mass / total for goal, mass in masses.items()})


def test_rivals_are_strata_of_their_own_and_no_proposals() -> None:
    # the rival's pair weighs 0.1 x (0.4 + 0.4) / 2, however often it was simulated
    simulations = [
        Simulation(A, 0, LOG(0.2), LOG(0.5)),
        Simulation(B, 1, LOG(0.2), LOG(0.25), iteration=1),
        Simulation(C, 2, LOG(0.1), LOG(0.4), iteration=2),
        Simulation(C, 3, LOG(0.1), LOG(0.4), iteration=2),
    ]
    log_proposal = np.log([0.5, 0.25, 0.3, 0.3])
    prior = [(A, 0.6), (B, 0.3), (C, 0.1)]
    found = goal_probabilities(stratified(simulations, prior, 2, log_proposal=log_proposal))
    # of P / Q 0.4 and 0.8 for the others
    expected = {BLUE_TO_RED: 0.9 / 3 * 0.5, PINK_TO_BLUE: 1.8 / 3 * 0.25, PINK_TO_RED: 0.04}
    assert found == pytest.approx({goal: mass / 0.34 for goal, mass in expected.items()})


def test_a_stratum_keeps_its_mass_whichever_chains_are_left_out() -> None:
    # three chains found A and B equally likely, by different numbers of simulations: no doubt
    simulations = [
        Simulation(h, 20 * chain + i, LOG(0.1), LOG(0.2), chain=chain, iteration=i)
        for chain, n_of_a in enumerate((4, 8, 12))
        for i, h in enumerate([A] * n_of_a + [B] * (16 - n_of_a))
    ]
    post = stratified(simulations, EVEN, draws=[[0], [16], [32]])
    without = post._jackknife(0.0)
    assert without is not None
    for weights in without.weights:
        of_a = post.table.values["goal_red"] == A.effective_goals[0]
        assert weights[of_a].sum() == pytest.approx(0.5)


def test_a_chain_of_which_nothing_was_completed_has_a_part_in_errors() -> None:
    shares = (0.2, 0.2), (0.2, 0.1), (0.3, 0.4)
    simulations = [
        Simulation(h, 2 * chain + i, LOG(0.5), LOG(p), chain < 2, chain=chain, iteration=i)
        for chain, of_both in enumerate(shares)
        for i, (h, p) in enumerate(zip((A, B), of_both, strict=True))
    ]
    post = stratified(simulations, EVEN, 0, draws=[[0], [2], [2]])
    without = post._jackknife(0.0)
    assert without is not None
    of_a = post.table.values["goal_red"] == A.effective_goals[0]
    # with each chain left out in turn, and the last one counted as without likelihood
    found = [weights[of_a].sum() for weights in without.weights]
    assert found == pytest.approx([0.2 / 0.3, 0.2 / 0.4, 0.4 / 0.7])


def test_weights_by_proposals_need_their_densities_and_the_prior_of_pairs() -> None:
    tree = make_tree([Simulation(A), Simulation(B, 1, iteration=1)], [[0, 1]])
    for given, said in (
        (tree, "density of each proposal"),
        (with_densities(tree, [0.0, math.nan]), "use weights='count'"),
        (with_densities(tree, 0.0), "need the prior of pairs"),
    ):
        with pytest.raises(InvalidSettingError, match=said):
            Posterior(given, "stratified")
    with pytest.raises(InvalidSettingError, match="at least one completed"):
        stratified([Simulation(A, 1, completed=False)], [(A, 1.0)])


def test_a_burn_in_does_not_count() -> None:
    tree = make_tree([Simulation(A), Simulation(B, 1)], [[0, 0, 1, 1], [0, 1, 1, 1]])
    assert goal_probabilities(Posterior(tree, burn_in=2)) == pytest.approx({PINK_TO_BLUE: 1.0})
    tree.attrs["burn_in"] = 1
    post = Posterior(tree)
    assert post.burn_in == 1
    assert goal_probabilities(post)[BLUE_TO_RED] == pytest.approx(1 / 6)
    assert post.diagnostics()["iterations"] == 3
    assert post.tree["posterior"].sizes["draw"] == 4
    for burn_in, said in ((4, "burn_in=4, but each chain has 4 draws"), (-1, "burn_in")):
        with pytest.raises(InvalidSettingError, match=said):
            Posterior(tree, burn_in=burn_in)


def test_untried_is_the_prior_mass_of_pairs_without_a_completed_simulation() -> None:
    tree = make_tree([Simulation(A), Simulation(B, 1, completed=False)], [[0]])
    assert math.isnan(Posterior(tree).untried)
    post = Posterior(with_prior(tree, [(A, 0.5), (B, 0.3), (C, 0.2)]))
    assert post.untried == pytest.approx(0.5)
    found = post.diagnostics()
    assert "0.50 of the prior's mass were never simulated" in found["verdict"]
    (check,) = (one for one in found["checks"] if one["name"] == "goals simulated")
    assert (check["state"], check["limit"]) == ("unknown", "0.95 to tell")


FOLLOWED = ("goal_red", "goal_green", "relation", "scenario")


def check_by_hand(tree: xr.DataTree, expected: FloatArray) -> None:
    found = Posterior(tree, "count").over_time()
    np.testing.assert_allclose(found["goal_red"].sel(goal_red_is=BLUE_TO_RED), expected)
    np.testing.assert_allclose(found["goal_green"].sel(goal_green_is=PINK_TO_BLUE), expected)
    np.testing.assert_allclose(found["relation"].sel(relation_is="neutral"), expected)
    np.testing.assert_allclose(found["scenario"].sel(scenario_is="collaborative"), 1 - expected)


def test_prefixes_worked_out_by_hand() -> None:
    one, other = hypothesis(BLUE_TO_RED, PINK_TO_BLUE), hypothesis(TO_GREEN, TO_RED)
    by_frame = np.array([[-1, -1, -1], [0, -2, -4], [-1, -1, np.nan]], float)
    simulations = [
        Simulation(one, 0, np.log(0.6), -3.0),
        Simulation(other, 1, np.log(0.4), -6.0),
        Simulation(other, 2, np.log(0.4), -2.5, completed=False, frames=2),
    ]
    tree = make_tree(simulations, [[0, 1]], n_frames=3, by_frame=by_frame)
    # the draws are of the posterior of all frames; at frame t those that come are taken out again
    drawn_one, drawn_other = np.exp([2.0, 1.0, 0.0]), np.exp([6.0, 4.0, 0.0])
    check_by_hand(tree, drawn_one / (drawn_one + drawn_other))
    # with densities of proposals: the mean of the pair's two simulations, the second of which is
    # stopped before the last frame
    tree = with_prior(with_densities(tree, 0.0), [(one, 0.6), (other, 0.4)])
    tree.attrs["rivals_from"] = 0  # every pair is a stratum
    mass_one = 0.6 * np.exp([-1.0, -2.0, -3.0])
    parts = np.stack([0.2 * np.exp([0.0, -2.0, -6.0]), 0.2 * np.exp([-1.0, -2.0, -np.inf])])
    masses = [column[column > 0] for column in np.array([mass_one, *parts]).T]
    check_by_hand(tree, np.array([truncated(mass / mass.sum())[0] for mass in masses]))
    # where it might have been stopped before, it counts for those that were: it went on with
    # probability exp(1.2 + L at best), a frame that was not simulated yet being worth -0.5 at best.
    # The frame that took it beyond is left out, as only those before it were as probable
    tree = with_densities(tree, 0.0, [np.inf, np.inf, 1.2])
    parts[1] *= np.exp([2.0 - 1.2, -np.inf, 0.0])
    masses = [column[column > 0] for column in np.array([mass_one, *parts]).T]
    check_by_hand(tree, np.array([truncated(mass / mass.sum())[0] for mass in masses]))


def test_later_frames_change_nothing_before_them() -> None:
    tree = with_densities(tree_by_frame(), -10.0)
    tree = with_prior(tree, np.random.default_rng(0).random((36, 36)))
    before = Posterior(tree).over_time()
    array(tree, "simulations", "step_log_likelihood")[:, 5:] *= 2
    after = Posterior(tree).over_time()
    for name in FOLLOWED:
        np.testing.assert_array_equal(before[name][:5], after[name][:5])
        assert not np.allclose(before[name][5:], after[name][5:])


def test_a_failed_simulation_counts_for_nothing() -> None:
    failed = Simulation(B, 1, log_likelihood=-np.inf, completed=False, failed=True, frames=2)
    by_frame = np.zeros((2, 5))
    by_frame[1, 2:] = np.nan
    found = Posterior(make_tree([Simulation(A), failed], [[0]], by_frame=by_frame)).over_time()
    np.testing.assert_array_equal(found["goal_red"].sel(goal_red_is=BLUE_TO_RED), 1)


def test_likelihoods_of_another_shape_or_none_are_named() -> None:
    with pytest.raises(InvalidEventError, match="step_log_likelihood"):
        Posterior(random_tree()).over_time()
    tree = tree_by_frame()
    renamed = tree["simulations"]["step_log_likelihood"].rename(time="frame")
    tree["simulations"]["step_log_likelihood"] = renamed
    with pytest.raises(InvalidEventError, match="simulations/step_log_likelihood has dimensions"):
        Posterior(tree)
