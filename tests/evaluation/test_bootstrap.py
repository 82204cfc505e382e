"""Intervals and tests against the binomial law, summed over all that can come out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from phase_ppl.evaluation.bootstrap import Figure, difference, resampled, weighted_mean
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
