"""R-hat and effective sample size: ArviZ's numbers where those mean something, and short chains."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis import diagnostics

with warnings.catch_warnings():
    warnings.simplefilter("ignore", FutureWarning)  # ArviZ announces its version 1
    import arviz

MEASURES = {
    "r_hat": lambda data: arviz.rhat(data),
    "split_r_hat": lambda data: arviz.rhat(data, method="split"),
    "ess_bulk": lambda data: arviz.ess(data, method="bulk"),
    "ess_tail": lambda data: arviz.ess(data, method="tail", prob=(0.05, 0.95)),
    "ess_mean": lambda data: arviz.ess(data, method="mean"),
    "mcse_mean": lambda data: arviz.mcse(data, method="mean"),
}


def chains(kind: str, n_chains: int, n_draws: int) -> NDArray[np.float64]:
    rng = np.random.default_rng([n_chains, n_draws])
    values = rng.normal(size=(n_chains, n_draws))
    if kind == "slow":
        for t in range(1, n_draws):
            values[:, t] = 0.9 * values[:, t - 1] + 0.4 * values[:, t]
    elif kind == "apart":
        values += np.arange(n_chains)[:, None]
    elif kind == "indicator":
        values = (values > 0.8).astype(float)
    elif kind == "tied":
        values = values.round()
    return values


@pytest.mark.parametrize("name", MEASURES)
@pytest.mark.parametrize("kind", ["independent", "slow", "apart", "indicator", "tied"])
@pytest.mark.parametrize("shape", [(4, 500), (15, 10), (2, 101)])
def test_long_chains_have_the_numbers_of_arviz(
    name: str, kind: str, shape: tuple[int, int]
) -> None:
    values = chains(kind, *shape)
    dataset = xr.Dataset({"x": (("chain", "draw"), values)})
    theirs = float(MEASURES[name](dataset)["x"])
    assert getattr(diagnostics, name)(values) == pytest.approx(theirs, rel=1e-6)


@pytest.mark.parametrize("name", ["r_hat", "split_r_hat"])
def test_r_hat_of_short_chains_is_that_of_arviz(name: str) -> None:
    values = chains("apart", 15, 6)
    theirs = float(MEASURES[name](xr.Dataset({"x": (("chain", "draw"), values)}))["x"])
    assert getattr(diagnostics, name)(values) == pytest.approx(theirs)


def test_short_chains_that_never_move_are_worth_as_many_draws_as_there_are_chains() -> None:
    stuck = np.repeat(np.random.default_rng(0).normal(size=(15, 1)), 6, axis=1)
    # the usual estimate would be 176, more than all 90 draws
    assert diagnostics.ess_mean(stuck) == pytest.approx(15, rel=0.1)
    assert diagnostics.mcse_mean(stuck) == pytest.approx(stuck[:, 0].std(ddof=1) / np.sqrt(15))
    assert diagnostics.split_r_hat(stuck) == np.inf


def test_short_chains_worked_out_by_hand() -> None:
    values = np.array([[0, 0, 0, 1], [1, 1, 1, 1], [0, 0, 1, 1], [1, 0, 0, 0]], float)
    error = np.std([0.25, 1, 0.5, 0.25], ddof=1) / 2
    assert diagnostics.mcse_mean(values) == pytest.approx(error)
    assert diagnostics.ess_mean(values) == pytest.approx(values.var(ddof=1) / error**2)


def test_short_independent_draws_are_worth_about_all_of_them() -> None:
    rng = np.random.default_rng(1)
    sizes = [diagnostics.ess_mean(rng.normal(size=(15, 6))) for _ in range(200)]
    assert np.median(sizes) == pytest.approx(90, rel=0.15)
    assert max(sizes) <= 90 * np.log10(90) + 1e-9


@pytest.mark.parametrize("name", MEASURES)
def test_what_does_not_exist_is_not_a_number(name: str) -> None:
    measure = getattr(diagnostics, name)
    values = chains("independent", 5, 12)
    assert np.isnan(measure(values[:, :3]))
    assert np.isnan(measure(np.ones((5, 12))))
    assert np.isnan(measure(np.where(values > 1, np.inf, values)))
    assert np.isnan(measure(np.where(values > 1, np.nan, values)))


def test_few_short_chains_have_an_r_hat_but_no_effective_size() -> None:
    values = chains("independent", 3, 9)
    assert np.isfinite(diagnostics.r_hat(values))
    assert np.isnan(diagnostics.ess_bulk(values))
    assert np.isnan(diagnostics.mcse_mean(values))
    assert np.isfinite(diagnostics.ess_bulk(chains("independent", 1, 10)))
