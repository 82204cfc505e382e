"""The posterior over time: by hand, against the posterior, and what later frames can change."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from phase_ppl.analysis import plots
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.weights import truncated
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError

from .factory import (
    BLUE_TO_RED,
    PINK_TO_BLUE,
    TO_GREEN,
    TO_RED,
    Simulation,
    hypothesis,
    make_tree,
    random_tree,
    with_densities,
    with_prior,
    with_variables,
)

FOLLOWED = ("goal_red", "goal_green", "relation", "scenario")


def tree_by_frame(seed: int = 0) -> xr.DataTree:
    """Return a random tree with a likelihood for each frame, which add up."""
    tree = random_tree(seed)
    rng = np.random.default_rng(seed)
    table = tree["simulations"].dataset.to_dataframe()
    by_frame = np.full((len(table), tree["observed_data"].sizes["time"]), np.nan)
    pairs = zip(table["log_likelihood"], table["frames_simulated"], strict=True)
    for row, (total, frames) in enumerate(pairs):
        by_frame[row, :frames] = total * rng.dirichlet(np.ones(frames))
    return with_variables(
        tree, "simulations", step_log_likelihood=(("simulation", "time"), by_frame)
    )


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
        Simulation(other, 2, np.log(0.4), -2.0, completed=False, frames=2),
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


@pytest.mark.parametrize(("densities", "prior"), [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("seed", range(2))
def test_at_the_last_frame_it_is_the_posterior(seed: int, densities: bool, prior: bool) -> None:
    tree, rng = tree_by_frame(seed), np.random.default_rng(seed)
    if densities:
        simulations = tree["simulations"].to_dataset()
        n = simulations.sizes["simulation"]
        first = simulations["iteration"].values == 0
        at_end = rng.normal(-1, 1, n) - simulations["log_likelihood"].values
        tree = with_densities(tree, rng.normal(-10, 1, n), np.where(first, np.inf, at_end))
    if prior:
        tree = with_prior(tree, rng.random((36, 36)))
    weights = "stratified" if prior else "count"  # by densities of proposals, where it can be
    found, post = Posterior(tree).over_time(), Posterior(tree, weights)
    assert found.attrs["weights"] == weights
    for name in FOLLOWED:
        np.testing.assert_allclose(found[name].isel(time=-1), post.marginal(name), atol=1e-12)
        np.testing.assert_allclose(found[name].sum(f"{name}_is"), 1)


def test_later_frames_change_nothing_before_them() -> None:
    tree = with_densities(tree_by_frame(), -10.0)
    tree = with_prior(tree, np.random.default_rng(0).random((36, 36)))
    before = Posterior(tree).over_time()
    later = tree["simulations"]["step_log_likelihood"].copy()
    later[:, 5:] += np.random.default_rng(1).normal(size=later[:, 5:].shape)
    tree["simulations"]["step_log_likelihood"] = later
    after = Posterior(tree).over_time()
    for name in FOLLOWED:
        np.testing.assert_array_equal(before[name][:5], after[name][:5])
        assert not np.allclose(before[name][5:], after[name][5:])


def test_a_failed_simulation_counts_for_nothing() -> None:
    simulations = [
        Simulation(hypothesis(BLUE_TO_RED), 0),
        Simulation(hypothesis(PINK_TO_BLUE), 1, 0.0, -np.inf, False, True, 2),
    ]
    by_frame = np.zeros((2, 5))
    by_frame[1, 2:] = np.nan
    found = Posterior(make_tree(simulations, [[0]], by_frame=by_frame)).over_time()
    np.testing.assert_array_equal(found["goal_red"].sel(goal_red_is=BLUE_TO_RED), 1)


def test_a_users_scenario_is_followed() -> None:
    found = Posterior(tree_by_frame(), scenario=lambda red, green: "opposing").over_time()
    np.testing.assert_allclose(found["relation"].sel(relation_is="adversarial"), 1)


def test_it_says_that_it_is_hindsight_and_survives_the_file(tmp_path: Path) -> None:
    post = Posterior(tree_by_frame())
    found = post.over_time()
    assert "proposed from the whole video" in found.attrs["hindsight"]
    assert found["time"].attrs["units"] == "s"
    np.testing.assert_array_equal(found["time"], post.tree["observed_data"]["time"])
    xr.testing.assert_equal(Posterior.load(post.save(tmp_path / "a b.nc")).over_time(), found)


def test_likelihoods_of_another_shape_or_none_are_named() -> None:
    with pytest.raises(InvalidEventError, match="step_log_likelihood"):
        Posterior(random_tree()).over_time()
    tree = tree_by_frame()
    renamed = tree["simulations"]["step_log_likelihood"].rename(time="frame")
    tree["simulations"]["step_log_likelihood"] = renamed
    with pytest.raises(InvalidEventError, match="simulations/step_log_likelihood has dimensions"):
        Posterior(tree)


def test_the_figure_draws_what_is_probable_and_names_it(tmp_path: Path) -> None:
    post = Posterior(tree_by_frame())
    figure = plots.over_time(post, tmp_path / "over time.png")
    assert (tmp_path / "over time.png").read_bytes().startswith(b"\x89PNG")
    assert "Hindsight" in figure.texts[1].get_text()
    goals, _, relations = ({text.get_text() for text in axes.texts} for axes in figure.axes)
    assert relations == {"friendly", "neutral", "adversarial"}
    peak = post.over_time()["goal_red"].max("time").to_series()
    assert goals - {"all other goals"} == set(peak.nlargest(5)[lambda p: p >= 0.1].index)
