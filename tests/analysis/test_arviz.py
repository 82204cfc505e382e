"""The draws in ArviZ, whichever of its generations is installed."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator

import matplotlib
import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl.analysis import Posterior
from phase_ppl.world.errors import InvalidSettingError

from .factory import BLUE_TO_RED, PINK_TO_BLUE, Simulation, hypothesis, make_tree, random_tree

matplotlib.use("Agg")

with warnings.catch_warnings():
    warnings.simplefilter("ignore", FutureWarning)  # ArviZ announces its version 1
    import arviz

NEW = int(arviz.__version__.split(".")[0]) >= 1

# ArviZ 0.23 calls Matplotlib 3.11 in a way that is going to change
pytestmark = pytest.mark.filterwarnings("ignore:Passing a dict or None as alias_mapping")


@pytest.fixture(scope="module")
def post() -> Posterior:
    return Posterior(random_tree(1, n_chains=4, n_draws=40))


@pytest.fixture(autouse=True)
def _no_open_figures() -> Iterator[None]:
    yield
    import matplotlib.pyplot as plt

    plt.close("all")


def test_it_is_what_the_installed_generation_works_on(post: Posterior) -> None:
    data = post.arviz
    assert isinstance(data, xr.DataTree if NEW else arviz.InferenceData)
    groups = set(data.children) if NEW else set(data.groups())
    assert groups >= {"posterior", "sample_stats", "posterior_predictive", "observed_data"}
    assert data.attrs["event_id"] == "made-up"


def test_summary_has_scalars_and_probabilities_of_categories(post: Posterior) -> None:
    found = arviz.summary(post.arviz)
    assert list(found.index[:4]) == ["log_joint", "total_error", "strength_red", "strength_green"]
    mean = found["mean"].astype(float)
    count = Posterior(post.tree, "count")
    for name in ("goal_red", "relation"):
        for label, probability in count.top(name, 36):
            if probability > 0.02:
                assert mean[f"{name}[{label}]"] == pytest.approx(probability, abs=0.051)
    assert not any(row.startswith(("alpha", "stated_goal")) for row in found.index)


def test_effective_sizes_are_ours(post: Posterior) -> None:
    theirs = arviz.ess(post.arviz, method="bulk")
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
    post = Posterior(make_tree(simulations, draws.tolist()))
    assert getattr(arviz, plot)(post.arviz) is not None


def test_categories_without_an_r_hat_are_left_out_and_named() -> None:
    # green's goal never changes; red's does in the first half of a chain
    simulations = [Simulation(hypothesis(goal), i) for i, goal in enumerate((BLUE_TO_RED, 3))]
    tree = make_tree(simulations, [[0, 1, 1, 1], [0, 0, 0, 1]])
    tree["sample_stats"]["total_error"] += np.arange(8.0).reshape(2, 4)
    posterior = Posterior(tree).arviz["posterior"]
    attrs = dict(posterior.attrs)
    assert set(posterior["goal_red_is"].values) == {BLUE_TO_RED, ppl.GOALS[3]}
    np.testing.assert_array_equal(
        posterior["goal_red"].sel(goal_red_is=BLUE_TO_RED), [[1, 0, 0, 0], [1, 1, 1, 0]]
    )
    assert json.loads(attrs["left_out"])["goal_green"] == [PINK_TO_BLUE]
    assert "goal_green" not in posterior


@pytest.mark.parametrize("shape", [(1, 5), (2, 3), (15, 6)])
def test_short_runs_have_a_summary_too(shape: tuple[int, int]) -> None:
    found = arviz.summary(Posterior(random_tree(5, *shape)).arviz)
    assert {"log_joint", "strength_green"} <= set(found.index)


def test_draws_of_unequal_weight_are_refused() -> None:
    tree = random_tree()
    log_weight = np.zeros(tree["posterior"]["goal_red"].shape)
    log_weight[0, 0] = 1
    tree["sample_stats"]["log_weight"] = xr.DataArray(log_weight, dims=("chain", "draw"))
    with pytest.raises(InvalidSettingError, match="unequal weights"):
        _ = Posterior(tree).arviz
