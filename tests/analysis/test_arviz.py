"""Posteriors and chains in ArviZ, whichever of its generations is installed."""

from __future__ import annotations

import contextlib
import functools
import json
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.with_arviz import ess, resampled
from phase_ppl.world.errors import InvalidSettingError
from tests.inference import runs

from .factory import BLUE_TO_RED, PINK_TO_BLUE, posterior_of, random_tree, with_log_weight
from .readings import reading

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


@functools.cache
def run_of(kernel: str, iterations: int) -> Posterior:
    given = {**runs.OPTIONS, "model": runs.MODEL, "kernel": kernel, "iterations": iterations}
    return ppl.infer(runs.EVENT, **given)


def means_of(data: Any) -> dict[str, float]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of what is certain, or of few draws
        return arviz.summary(data, round_to="none")["mean"].astype(float).to_dict()


def agrees(post: Any) -> None:
    data, means = post.arviz, means_of(post.arviz)
    counted = data.attrs["draws"].startswith("all of the chains")
    error = 0.0 if counted else 4 / np.sqrt(4000)  # of resampled draws, in their sd
    for name in (*post.goals_of.values(), *post.relations_of.values(), *post.scenarios_of.values()):
        for label, probability in post.top(name, 36):
            if probability > 0.02:
                allowed = error * np.sqrt(probability * (1 - probability)) + 1e-9
                assert means.pop(f"{name}[{label}]") == pytest.approx(probability, abs=allowed)
    assert not [name for name in means if name.startswith(("goal", "relation", "scenario"))]
    for name in post.strengths_of.values():
        allowed = error * post.sd(name)
        assert means.pop(name) == pytest.approx(post.mean(name), rel=1e-6, abs=allowed)
        draws = np.asarray(data["posterior"][name]).ravel()
        low, high = arviz.hdi(draws, **{"prob" if NEW else "hdi_prob": 0.8})
        if counted:
            assert (low, high) == tuple(post.hdi(name, 0.8).values)
        else:
            assert post.probability(**{name: (low, high)}) >= 0.8 - 0.4 * error
            narrow, wide = (np.ptp(post.hdi(name, prob).values) for prob in (0.77, 0.83))
            assert narrow <= high - low <= wide


# of each kind of draws: weighted, proposed, from the prior
@pytest.mark.parametrize("kernel", ["amis", "local_mh", "prior_mh"])
@pytest.mark.parametrize("iterations", [6, 20])
def test_arviz_says_what_is_printed_whatever_the_kernel(kernel: str, iterations: int) -> None:
    post = run_of(kernel, iterations)
    agrees(post)
    if post.weights == "stratified":  # by all simulations, as no chain is
        assert post.chains.attrs["weights"] == "count"
    with contextlib.suppress(InvalidSettingError):  # where proposals have no density
        agrees(Posterior(post.tree, "stratified"))


def test_what_is_read_step_by_step_has_draws_and_no_chains() -> None:
    post = ClosedLoopPosterior(reading()).define("weak", "strength_red < strength_green")
    for frame in (0, 1, 3):
        agrees(post.at(frame))
    data = post.arviz
    assert data.attrs["weights"] == "all hypotheses"
    weak = means_of(data)["weak[True]"]
    assert weak == pytest.approx(post.probability(weak=True), abs=0.03)
    # nothing but the drawing of these 4000 is random, and they follow each other in no order
    sizes = arviz.ess(data, method="mean")
    assert float(sizes["strength_red"]) == pytest.approx(4000, rel=0.15)
    with pytest.raises(InvalidSettingError, match=r"no chains.*post\.arviz"):
        _ = post.chains


def test_arviz_finds_draws_of_weighted_rows_worth_as_many_as_their_weights() -> None:
    rng = np.random.default_rng(0)
    sizes = []
    for _ in range(20):
        weights = rng.dirichlet(np.full(400, 0.3))
        rows = resampled(weights, 1, exact=False)
        assert rows.shape == (4, 1000)
        off = np.bincount(rows.ravel(), minlength=400) - 4000 * weights
        assert np.abs(off).max() < 1
        sizes.append(ess(rng.normal(size=400)[rows], "mean") * (weights**2).sum())
    assert np.median(sizes) == pytest.approx(1, abs=0.3)
    np.testing.assert_array_equal(rows, resampled(weights, 1, exact=False))
    assert not np.array_equal(rows, resampled(weights, 2, exact=False))


def test_a_file_has_the_same_draws(tmp_path: Path) -> None:
    own = {"same_target": "target_red = target_green"}
    posts = [Posterior(run_of("local_mh", 6).tree, w) for w in ("stratified", "count")]
    for post in (*posts, run_of("amis", 6), ClosedLoopPosterior(reading()).at(2)):
        for name, words in own.items():
            post.define(name, words)
        again = ppl.load_posterior(post.save(tmp_path / "post.nc"))
        before, after = post.arviz, again.arviz
        assert groups(before) == groups(after)
        for group in groups(before):
            one, other = (d[group].to_dataset() if NEW else d[group] for d in (before, after))
            xr.testing.assert_identical(one, other)
        for words in ("weights", "draws", "effective_size_kish"):
            assert before.attrs[words] == after.attrs[words]


def test_there_are_no_log_likelihoods_and_the_data_say_why(post: Posterior) -> None:
    for data in (post.arviz, post.chains, ClosedLoopPosterior(reading()).arviz):
        assert "log_likelihood" not in groups(pickle.loads(pickle.dumps(data)))
        assert "frames of a video" in data.attrs["loo"]


def test_chains_are_summed_up_with_the_effective_sizes_of_the_diagnostics(post: Posterior) -> None:
    data = post.chains
    assert isinstance(data, xr.DataTree if NEW else arviz.InferenceData)
    assert groups(data) >= {"posterior", "sample_stats", "observed_data"}
    assert data.attrs["event_id"] == "made-up"
    found = arviz.summary(data)
    assert list(found.index[:4]) == ["log_joint", "total_error", "strength_red", "strength_green"]
    assert not any(row.startswith(("alpha", "stated_goal")) for row in found.index)
    for kind in ("bulk", "tail"):
        theirs = arviz.ess(data, method=kind, **({"prob": (0.05, 0.95)} if kind == "tail" else {}))
        theirs = theirs if isinstance(theirs, xr.Dataset) else theirs.dataset
        for name, ours in post.diagnostics()["scalars"].items():
            assert float(theirs[name]) == pytest.approx(ours[f"ess_{kind}"])


def test_of_chains_categories_without_an_r_hat_are_left_out_and_named() -> None:
    # green's goal never changes; red's does in the first half of a chain
    tree = posterior_of((BLUE_TO_RED, 3), [[0, 1, 1, 1], [0, 0, 0, 1]]).tree
    tree["sample_stats"]["total_error"] += np.arange(8.0).reshape(2, 4)
    post = Posterior(tree)
    posterior = post.chains["posterior"]
    attrs = dict(posterior.attrs)
    assert set(posterior["goal_red_is"].values) == {BLUE_TO_RED, ppl.GOALS[3]}
    np.testing.assert_array_equal(
        posterior["goal_red"].sel(goal_red_is=BLUE_TO_RED), [[1, 0, 0, 0], [1, 1, 1, 0]]
    )
    assert json.loads(attrs["left_out"])["goal_green"] == [PINK_TO_BLUE]
    assert "goal_green" not in posterior
    # the posterior has them, as they are its answer
    assert means_of(post.arviz)[f"goal_green[{PINK_TO_BLUE}]"] == 1


def test_burn_in_is_in_neither() -> None:
    post = Posterior(random_tree(1, n_draws=20), "count", burn_in=5)
    for data in (post.arviz, post.chains):
        assert data["posterior"]["strength_red"].shape == (4, 15)
        assert "burn-in of 5" in data.attrs["draws"]


def test_short_chains_have_a_summary_and_draws_of_unequal_weight_are_no_chains() -> None:
    for shape in ((1, 5), (2, 3)):
        found = arviz.summary(Posterior(random_tree(5, *shape)).chains)
        assert {"log_joint", "strength_green"} <= set(found.index)
    tree = random_tree()
    log_weight = np.zeros(tree["posterior"]["goal_red"].shape)
    log_weight[0, 0] = 1
    post = Posterior(with_log_weight(tree, log_weight))
    agrees(post)
    with pytest.raises(InvalidSettingError, match=r"no chains: post\.arviz"):
        _ = post.chains
