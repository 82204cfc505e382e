"""Intervals and tests against the binomial law, summed over all that can come out."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from phase_ppl.evaluation.bootstrap import Figure, difference, figure, resampled, weighted_mean
from phase_ppl.evaluation.differences import _tested

N = 50
WEIGHTS = resampled(N, resamples=2000)


def wrong_more_often(k: int) -> np.ndarray:
    """Return resampled differences of a model that errs about k events from one that never does."""
    return weighted_mean(WEIGHTS, -(np.arange(N)[:, None] < k).astype(float))


def of_shares(k: int) -> Figure:
    values = wrong_more_often(k)
    found = difference(values, 0 * values, N, of_shares=True)
    assert found is not None
    return found


@pytest.mark.parametrize("share", [0.02, 0.06, 0.1, 0.3])
def test_intervals_of_differences_of_shares_hold_them(share: float) -> None:
    k = np.arange(N + 1)
    found = [of_shares(int(wrong)) for wrong in k]
    held = np.array([one["ci_low"] <= -share <= one["ci_high"] for one in found])  # type: ignore[operator]
    assert stats.binom.pmf(k, N, share)[held].sum() > 0.945


@pytest.mark.parametrize("n", [10, 20, 50])
@pytest.mark.parametrize("apart", [0.1, 0.3, 0.6])
def test_models_that_are_equally_good_differ_in_one_of_twenty_cases(n: int, apart: float) -> None:
    """They are apart on that share of events; p is below 0.05 where the interval leaves out 0."""
    weights, events = resampled(n, resamples=1000), np.arange(n)
    rejected = 0.0
    for one, other in itertools.product(range(n + 1), repeat=2):
        chance = stats.multinomial.pmf(
            [one, other, n - one - other], n, [apart / 2, apart / 2, 1 - apart]
        )
        if chance < 1e-4:
            continue
        values = weights @ ((events < one) * 1.0 - (events >= n - other)) / n
        found = difference(values, 0 * values, n, of_shares=True)
        assert found is not None
        low, high, p = found["ci_low"], found["ci_high"], found["p"]
        assert abs(p - 0.05) < 0.01 or (p < 0.05) == (low > 0 or high < 0)  # type: ignore[operator]
        rejected += chance * (p <= 0.05)  # type: ignore[operator]
    assert rejected <= 0.05


@pytest.mark.parametrize("n", [10, 20])
def test_means_of_few_events_lie_in_their_intervals_as_often_as_these_say(n: int) -> None:
    rng, runs = np.random.default_rng(1), 1000
    inside = apart = 0
    for seed in range(runs):
        one, other = rng.normal(size=(2, n))
        weights = resampled(n, seed, 400)
        of_one, of_other = weighted_mean(weights, one), weighted_mean(weights, other)
        found, differ = figure(of_one, n), difference(of_one, of_other, n)
        assert found is not None
        assert differ is not None
        inside += found["ci_low"] < 0 < found["ci_high"]  # type: ignore[operator]
        apart += differ["p"] <= 0.05  # type: ignore[operator]
    assert inside / runs == pytest.approx(0.95, abs=0.02)
    assert apart / runs < 0.065


def test_models_that_agree_on_few_events_are_not_known_to_agree() -> None:
    values = weighted_mean(resampled(5), np.zeros((5, 1)))
    found = difference(values, values, 5, of_shares=True)
    assert found is not None
    assert found["value"] == 0
    assert found["ci_low"] < -0.2 < 0.2 < found["ci_high"]  # type: ignore[operator]


@pytest.mark.parametrize("share", [0.1, 0.15])
def test_what_differs_by_the_margin_is_called_equivalent_in_one_of_twenty_cases(
    share: float,
) -> None:
    k = np.arange(N + 1)
    p = np.array([_tested(wrong_more_often(int(one)), N, 0.1)["p_equivalent"] for one in k])  # type: ignore[index]
    assert stats.binom.pmf(k, N, share)[p <= 0.05].sum() <= 0.05
    assert p[0] <= 0.05  # of no difference at all
