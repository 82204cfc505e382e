"""R-hat and effective sample size: ArviZ's numbers where those mean something, and short chains."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.analysis.diagnostics import ess, mcse, r_hat


def chains(n_chains: int, n_draws: int) -> NDArray[np.float64]:
    return np.random.default_rng([n_chains, n_draws]).normal(size=(n_chains, n_draws))


def measures(values: NDArray[Any]) -> list[float]:
    return [
        *(r_hat(values), r_hat(values, "split"), mcse(values)),
        *(ess(values, "bulk"), ess(values, "tail"), ess(values, "mean")),
    ]


def test_chains_of_one_law_have_mixed_and_chains_apart_have_not() -> None:
    same = chains(4, 200)
    apart = same + 2 * np.arange(4)[:, None]
    for method in ("rank", "split"):
        assert r_hat(same, method) < 1.02  # type: ignore[arg-type]
        assert r_hat(apart, method) > 1.5  # type: ignore[arg-type]
    for method in ("bulk", "tail", "mean"):
        assert ess(same, method) == pytest.approx(800, rel=0.25)  # type: ignore[arg-type]
    assert ess(apart, "mean") < 10
    assert mcse(same) == pytest.approx(1 / np.sqrt(800), rel=0.2)


def test_split_r_hat_worked_out_by_hand() -> None:
    values = np.array([[0.0, 2, 2, 4], [0, 2, 2, 4]])
    # means of the halves 1, 3, 1, 3: between 4/3; within 2, of two draws each
    assert r_hat(values, "split") == pytest.approx(np.sqrt((4 / 3) / 2 + 1 / 2))


def test_of_a_single_chain_the_halves_are_compared() -> None:
    trend = np.arange(40.0)[None]
    assert r_hat(trend) > 1.5
    assert r_hat(chains(1, 400)) < 1.05
    assert np.isnan(r_hat(trend[:, :6]))


def test_short_chains_that_never_move_are_worth_as_many_draws_as_there_are_chains() -> None:
    stuck = np.repeat(np.random.default_rng(0).normal(size=(15, 1)), 6, axis=1)
    # the usual estimate would be 176, more than all 90 draws
    assert ess(stuck, "mean") == pytest.approx(15, rel=0.1)
    assert mcse(stuck) == pytest.approx(stuck[:, 0].std(ddof=1) / np.sqrt(15))
    assert r_hat(stuck, "split") == r_hat(stuck) == np.inf


def test_short_chains_worked_out_by_hand() -> None:
    values = np.array([[0, 0, 0, 1], [1, 1, 1, 1], [0, 0, 1, 1], [1, 0, 0, 0]], float)
    error = np.std([0.25, 1, 0.5, 0.25], ddof=1) / 2
    assert mcse(values) == pytest.approx(error)
    assert ess(values, "mean") == pytest.approx(values.var(ddof=1) / error**2)


def test_short_independent_draws_are_worth_about_all_of_them() -> None:
    rng = np.random.default_rng(1)
    sizes = [ess(rng.normal(size=(15, 6)), "mean") for _ in range(200)]
    assert np.median(sizes) == pytest.approx(90, rel=0.15)
    assert max(sizes) <= 90 * np.log10(90) + 1e-9


def test_what_does_not_exist_is_not_a_number() -> None:
    values = chains(5, 12)
    for bad in (
        *(values[:, :3], np.ones((5, 12))),
        *(np.where(values > 1, np.inf, values), np.where(values > 1, np.nan, values)),
    ):
        assert np.isnan(measures(bad)).all()


def test_few_short_chains_have_an_r_hat_but_no_effective_size() -> None:
    values = chains(3, 9)
    assert np.isfinite(r_hat(values))
    assert np.isnan(ess(values, "bulk"))
    assert np.isnan(mcse(values))
    assert np.isfinite(ess(chains(1, 10), "bulk"))
