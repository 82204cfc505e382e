"""The draws in ArviZ, whichever of its generations is installed."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from typing import Any

import matplotlib
import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.world.errors import InvalidSettingError

from .factory import (
    BLUE_TO_RED,
    PINK_TO_BLUE,
    Simulation,
    hypothesis,
    make_tree,
    posterior_of,
    random_tree,
    with_log_weight,
)

matplotlib.use("Agg")

with warnings.catch_warnings():
    warnings.simplefilter("ignore", FutureWarning)  # ArviZ announces its version 1
    import arviz

NEW = int(arviz.__version__.split(".")[0]) >= 1

# ArviZ 0.23 calls Matplotlib 3.11 in a way that is going to change
pytestmark = pytest.mark.filterwarnings("ignore:Passing a dict or None as alias_mapping")


def groups(data: Any) -> set[str]:
    return set(data.children) if NEW else set(data.groups())


@pytest.fixture(scope="module")
def post() -> Posterior:
    return Posterior(random_tree(1, n_chains=4, n_draws=40))


@pytest.fixture(autouse=True)
def _no_open_figures() -> Iterator[None]:
    yield
    import matplotlib.pyplot as plt

    plt.close("all")


def test_summary_has_scalars_and_probabilities_of_categories(post: Posterior) -> None:
    data = post.arviz
    assert isinstance(data, xr.DataTree if NEW else arviz.InferenceData)
    assert groups(data) >= {"posterior", "sample_stats", "posterior_predictive", "observed_data"}
    assert data.attrs["event_id"] == "made-up"
    found = arviz.summary(data)
    assert list(found.index[:4]) == ["log_joint", "total_error", "strength_red", "strength_green"]
    mean = found["mean"].astype(float)
    count = Posterior(post.tree, "count")
    for name in ("goal_red", "relation"):
        for label, probability in count.top(name, 36):
            if probability > 0.02:
                assert mean[f"{name}[{label}]"] == pytest.approx(probability, abs=0.051)
    assert not any(row.startswith(("alpha", "stated_goal")) for row in found.index)
    theirs = arviz.ess(data, method="bulk")  # effective sizes are ours
    theirs = theirs if isinstance(theirs, xr.Dataset) else theirs.dataset
    for name, ours in post.diagnostics()["scalars"].items():
        assert float(theirs[name]) == pytest.approx(ours["ess_bulk"])


@pytest.mark.parametrize("plot", ["plot_trace", "plot_rank", "plot_forest"])
def test_its_figures_can_be_drawn(plot: str) -> None:
    simulations = [
        Simulation(hypothesis(goal, strengths=(200.0 + i, 300.0 - 7 * i)), i, -float(i))
        for i, goal in enumerate((BLUE_TO_RED, BLUE_TO_RED, PINK_TO_BLUE))
    ]
    draws = np.random.default_rng(0).integers(3, size=(4, 40))
    assert getattr(arviz, plot)(Posterior(make_tree(simulations, draws.tolist())).arviz) is not None


def test_categories_without_an_r_hat_are_left_out_and_named() -> None:
    # green's goal never changes; red's does in the first half of a chain
    tree = posterior_of((BLUE_TO_RED, 3), [[0, 1, 1, 1], [0, 0, 0, 1]]).tree
    tree["sample_stats"]["total_error"] += np.arange(8.0).reshape(2, 4)
    posterior = Posterior(tree).arviz["posterior"]
    attrs = dict(posterior.attrs)
    assert set(posterior["goal_red_is"].values) == {BLUE_TO_RED, ppl.GOALS[3]}
    np.testing.assert_array_equal(
        posterior["goal_red"].sel(goal_red_is=BLUE_TO_RED), [[1, 0, 0, 0], [1, 1, 1, 0]]
    )
    assert json.loads(attrs["left_out"])["goal_green"] == [PINK_TO_BLUE]
    assert "goal_green" not in posterior


def test_short_runs_have_a_summary_and_draws_of_unequal_weight_have_none() -> None:
    for shape in ((1, 5), (2, 3)):
        found = arviz.summary(Posterior(random_tree(5, *shape)).arviz)
        assert {"log_joint", "strength_green"} <= set(found.index)
    tree = random_tree()
    log_weight = np.zeros(tree["posterior"]["goal_red"].shape)
    log_weight[0, 0] = 1
    with pytest.raises(InvalidSettingError, match="unequal weights"):
        _ = Posterior(with_log_weight(tree, log_weight)).arviz


# --- posterior predictive ----------------------------------------------------------------------


def distance(trajectory: xr.DataArray, other: xr.DataArray) -> xr.DataArray:
    """The distance of all entities in each frame, as the likelihood has it."""
    off = (trajectory - other).sel(coord=["x", "y"])
    return np.sqrt((off**2).sum(["entity", "coord"]))  # type: ignore[no-any-return]


def of_model(seed: int, beta: float, n_draws: int = 100) -> Posterior:
    """Equal draws of one simulation, and an observation with the likelihood's noise around it."""
    tree = make_tree([Simulation(hypothesis(), 0)], [[0] * n_draws])
    simulated = tree["simulated"]["trajectory"].values[0, 0].astype(float)
    observed = simulated.copy()
    rng = np.random.default_rng([seed, 1])
    observed[..., :2] = ppl.RadialLikelihood(beta).replicate(simulated[..., :2], rng)
    tree["observed_data"]["trajectory"].values[:] = observed
    tree["simulated"].attrs["beta"] = beta
    tree.attrs["settings"] = json.dumps({"seed": seed})
    return Posterior(tree)


@pytest.mark.parametrize("beta", [0.05, 2.0])
def test_replicates_have_the_noise_of_the_likelihood_and_angles_have_none(beta: float) -> None:
    post = of_model(0, beta)
    simulated = post.tree["simulated"]["trajectory"].to_dataset()["trajectory"]
    replicated = post.arviz["posterior_predictive"]["trajectory"]
    assert replicated.dims == simulated.dims
    angle = {"coord": "angle"}
    np.testing.assert_array_equal(replicated.sel(angle), simulated.sel(angle))
    drawn, d = distance(replicated, simulated).values, 8
    error = np.sqrt(d / drawn.size) / beta
    assert drawn.mean() == pytest.approx(d / beta, abs=4 * error)
    assert drawn.std() == pytest.approx(np.sqrt(d) / beta, rel=0.15)
    # no direction is preferred
    off = (replicated - simulated).sel(coord=["x", "y"]).mean(["chain", "draw", "time"])
    assert np.abs(off).max() < 4 * np.sqrt(9 / beta**2 / drawn.size)


def test_the_noise_follows_from_the_runs_seed_and_from_our_likelihoods_alone() -> None:
    def noisy(seed: int) -> xr.DataArray:
        tree = of_model(0, 0.05, n_draws=4).tree
        tree.attrs["settings"] = json.dumps({"seed": seed})
        return Posterior(tree).arviz["posterior_predictive"]["trajectory"]

    np.testing.assert_array_equal(noisy(1), noisy(1))
    assert not np.array_equal(noisy(1), noisy(2))
    tree = of_model(0, 0.05, n_draws=4).tree
    tree["simulated"].attrs = {}
    found = groups(Posterior(tree).arviz)
    assert "posterior_predictive" not in found
    assert "observed_data" in found


@pytest.mark.skipif(NEW, reason="another package plots in ArviZ 1")
def test_arviz_plots_posterior_predictive_checks() -> None:
    data = of_model(3, 2.0, n_draws=20).arviz
    assert arviz.plot_ppc(data, coords={"coord": ["x", "y"]}, random_seed=0) is not None
    assert arviz.plot_bpv(data, coords={"coord": ["x", "y"]}, kind="p_value") is not None
