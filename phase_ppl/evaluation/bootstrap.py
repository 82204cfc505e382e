"""Confidence intervals: binomial for shares, by resampling events for everything else.

Resampling shows too little spread for few events, or if nearly all answers are right. If all are
right it shows none. So shares of right answers (:func:`proportion`) have Clopper and Pearson's
interval, whose coverage is at least nominal. It is for the effective number of independent answers
(Korn and Graubard 1998, Survey Methodology 24).

Differences of shares are resampled with one more event for either side (after Bonett and Price
2012, Journal of Educational and Behavioral Statistics 37). Everything else has expanded percentiles
(Hesterberg 2015, The American Statistician 69): they make the interval of a mean of normal numbers
Student's.

A resample of n events is a vector of n weights: how often each event was drawn. Every measure is a
function of weighted sums over events. So one matrix of weights gives its value and all resampled
values at once; the first row is the data themselves.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import whole_number

Measure = dict[str, float | None]  # ``value``, ``ci_low``, ``ci_high``
LEAST_EVENTS: Final = 10  # fewest events for a test of equivalence
LEVEL: Final = 0.95  # share of the resampled values between ``ci_low`` and ``ci_high``

_CONSTANT: Final = 1e-12
"""Variance up to which a vector of probabilities is constant, up to rounding."""


def resampled(n: int, seed: int = 0, resamples: int = 1000) -> FloatArray:
    """Return weights (1 + resamples, n) of ``n`` events: all 1, then those of the resamples.

    The same arguments give the same resamples.
    """
    rng = np.random.default_rng(whole_number("seed", seed, 0))
    number = whole_number("resamples", resamples)
    if n == 0:
        return np.ones((1 + number, 0))
    drawn = rng.multinomial(n, np.full(n, 1 / n), size=number)
    return np.concatenate([np.ones((1, n)), drawn])


def weighted_mean(weights: FloatArray, values: ArrayLike) -> FloatArray:
    """Return the mean (row,) of ``values`` (event, ...) under each row of weights.

    NaN values are ignored; the mean of none is NaN.
    """
    given = by_event(values)
    known = ~np.isnan(given)
    total = weights @ np.where(known, given, 0).sum(axis=1)
    return divided(total, weights @ known.sum(axis=1).astype(np.float64))


class Resampled(NamedTuple):
    """A measure and its values on the resamples."""

    values: FloatArray  # (1 + resamples,) its value, then the resampled ones
    n: int  # number of events that count in it
    # (event, answer) scores from 0 to 1 whose mean it is; None: it is no share
    scores: FloatArray | None = None

    @classmethod
    def mean(cls, weights: FloatArray, values: FloatArray, of_shares: bool = False) -> Resampled:
        """Return the mean of values (event, answer), possibly shares from 0 to 1."""
        scores = values if of_shares else None
        return cls(weighted_mean(weights, values), events_with(values), scores)

    def measure(self) -> Measure | None:
        """Return value and 95 % interval: binomial for shares, else from the resamples."""
        return measure(self.values, self.n) if self.scores is None else proportion(self.scores)

    def minus(self, other: Resampled) -> Measure | None:
        """Return the :func:`difference` from another one on the same resamples."""
        return difference(self.values, other.values, self.n, self.scores is not None)


def events_with(values: FloatArray) -> int:
    """Return the number of events (first axis) with any value that is not NaN."""
    return int((~np.isnan(values)).any(axis=tuple(range(1, values.ndim))).sum())


def by_event(values: ArrayLike) -> FloatArray:
    """Return values (event, ...) reshaped to (event, component), even without events."""
    given = np.asarray(values, np.float64)
    return given.reshape(len(given), int(np.prod(given.shape[1:])))


def correlation(
    weights: FloatArray, x: ArrayLike, y: ArrayLike, groups: ArrayLike | None = None
) -> FloatArray:
    """Return Pearson's r (row,) of ``x`` and ``y``, each (event, component), flattened.

    Either may also have separate values for every row, (row, event, component). ``groups`` are
    numbers (event, component): r is then of deviations from the mean of the group, computed anew
    for every row of weights. Pairs with a NaN, or of a group below 0, are left out. r is NaN if a
    vector is constant.
    """
    left, right = np.asarray(x, np.float64), np.asarray(y, np.float64)
    known = ~np.isnan(left) & ~np.isnan(right)
    group = np.asarray(0 if groups is None else groups, np.int64)
    group = np.broadcast_to(group, known.shape)
    known &= group >= 0
    # centred, so that the differences of sums below lose little precision
    left, right = (
        np.where(known, values - (np.nanmean(values) if known.any() else 0), 0)
        for values in (left, right)
    )

    def total(values: FloatArray) -> FloatArray:
        of_events = values.sum(axis=-1)
        return weights @ of_events if of_events.ndim == 1 else (weights * of_events).sum(axis=1)

    n, both = total(known.astype(np.float64)), total(left * right)
    of_left, of_right = total(left**2), total(right**2)
    for number in np.unique(group[known]):
        chosen = known & (group == number)
        count = total(chosen.astype(np.float64))
        sum_left, sum_right = total(left * chosen), total(right * chosen)
        of_left = of_left - np.nan_to_num(divided(sum_left**2, count))
        of_right = of_right - np.nan_to_num(divided(sum_right**2, count))
        both = both - np.nan_to_num(divided(sum_left * sum_right, count))
    return r_of_sums(n, of_left, of_right, both)


def r_of_sums(
    n: FloatArray, of_left: FloatArray, of_right: FloatArray, both: FloatArray
) -> FloatArray:
    """Return r from sums of squares and of products of deviations of ``n`` pairs.

    NaN where a vector is constant.
    """
    varied = np.minimum(of_left, of_right) > _CONSTANT * n
    size = np.sqrt(np.where(varied, of_left * of_right, 1))
    return np.where(varied, np.clip(both / size, -1, 1), np.nan)


def divided(total: FloatArray, count: FloatArray) -> FloatArray:
    """Return ``total / count``, NaN where ``count`` is 0."""
    return np.where(count > 0, total / np.where(count > 0, count, 1), np.nan)


def measure(values: FloatArray, n: int) -> Measure | None:
    """Return value and 95 % interval (percentiles of the resampled values); None without a value.

    ``values`` are (1 + resamples,), the value first. NaN, as for resamples without the events that
    count, is left out of the interval. With ``n`` = 1 event the interval is (None, None).
    """
    if not np.isfinite(values[0]):
        return None
    low, high = interval(values, LEVEL, n) if n > 1 else (None, None)
    return {"value": float(values[0]), "ci_low": low, "ci_high": high}


def proportion(values: ArrayLike) -> Measure | None:
    """Return the mean of scores (event, answer) from 0 to 1 (NaN: none), with its 95 % interval.

    Answers about one event are dependent: two that always agree are worth one. For scores 0 and 1
    the design effect is estimated from the similarity of an event's answers. For shares, such as
    the share of people who are right, it is estimated from the variance of the events' means, with
    the quantile of Student's t. None without a score; the interval of one event is (None, None).
    """
    given = by_event(values)
    given = given[~np.isnan(given).all(axis=1)]
    if not len(given):
        return None
    value = float(np.nanmean(given))
    if len(given) == 1:
        return {"value": value, "ci_low": None, "ci_high": None}
    known = given[~np.isnan(given)]
    worth = _effective_answers(given) if np.isin(known, (0, 1)).all() else _effective_shares(given)
    low, high = clopper_pearson(value * worth, worth)
    return {"value": value, "ci_low": min(low, value), "ci_high": max(high, value)}


def clopper_pearson(right: float, n: float) -> tuple[float, float]:
    """Return Clopper and Pearson's 95 % interval of a probability, for ``right`` of ``n`` trials.

    Neither needs to be a whole number.
    """
    tail = (1 - LEVEL) / 2
    wrong = n - right
    low = float(special.betaincinv(right, wrong + 1, tail)) if right > _CONSTANT else 0.0
    high = float(special.betaincinv(right + 1, wrong, 1 - tail)) if wrong > _CONSTANT else 1.0
    return low, high


def _effective_answers(given: FloatArray) -> float:
    """Return the effective number of independent answers of scores (event, answer), 0 or 1."""
    n = (~np.isnan(given)).sum(axis=1)
    mean = float(np.nanmean(given))
    spread = mean * (1 - mean)
    more = int((n - 1).sum())
    if not more:
        return float(n.sum())
    # share of the variance within events; 0 if all answers are alike
    own = np.nansum((given - np.nanmean(given, axis=1, keepdims=True)) ** 2) / more
    alike = float(np.clip(1 - own / spread, 0, 1)) if spread > _CONSTANT else 1.0
    each = (n**2).sum() / n.sum()
    return float(n.sum() / (1 + (each - 1) * alike))


def _effective_shares(given: FloatArray) -> float:
    """Return the effective number of independent answers of shares (event, answer)."""
    means = np.nanmean(given, axis=1)
    n, mean = len(means), float(means.mean())
    z = float(special.ndtri((1 + LEVEL) / 2))
    # shrunk from 0 and 1, where a mean tells nothing about the spread
    inner = (mean * n + z**2 / 2) / (n + z**2)
    spread = means.var() + (mean - inner) ** 2
    # equal means still have some spread
    spread = max(spread, inner * (1 - inner) / n**2)
    worth = n * inner * (1 - inner) / spread
    return float(max(worth * (z / special.stdtrit(n - 1, (1 + LEVEL) / 2)) ** 2, 1.0))


def interval(
    values: FloatArray, level: float = LEVEL, n: int | None = None
) -> tuple[float | None, float | None]:
    """Return the percentile interval of ``values[1:]``; (None, None) if none is finite.

    It is expanded as for resamples of ``n`` events; None: not expanded.
    """
    finite = values[1:][np.isfinite(values[1:])]
    if not finite.size:
        return None, None
    tail = (1 - level) / 2
    if n is not None:
        tail = float(special.ndtr(special.stdtrit(n - 1, tail) * np.sqrt(n / (n - 1))))
    low, high = np.quantile(finite, [tail, 1 - tail])
    return float(low), float(high)


def difference(
    one: FloatArray, other: FloatArray, n: int, of_shares: bool = False
) -> Measure | None:
    """Return ``one - other`` with its interval and a two-sided p, over the same resamples.

    Differences ``of_shares``, of means from 0 to 1, are resampled with two more events
    (:func:`with_two`).

    p is twice the smaller of two shares of resamples (including the data): difference not above 0,
    and not below 0. It is expanded like the interval: below 0.05 if the interval is on one side of
    0. It is at least 2 ** (1 - n), the chance that n signs all agree, since resamples of a few
    events that agree all agree. With one event p and the interval are None.
    """
    values = one - other
    # differences that are only rounding are 0
    values = np.where(np.abs(values) < _CONSTANT, 0, values)
    found = measure(values, n)
    if found is None:
        return None
    if of_shares and n > 1:
        values = with_two(values, n)
        found["ci_low"], found["ci_high"] = interval(values)
    drawn = values[1:][np.isfinite(values[1:])]
    tail = min((drawn <= _CONSTANT).sum(), (drawn >= -_CONSTANT).sum()) + 1
    p = min(1.0, float(2 * tail / (drawn.size + 1)))
    if not of_shares and n > 1:
        p = float(2 * special.stdtr(n - 1, special.ndtri(p / 2) * np.sqrt((n - 1) / n)))
    p = max(p, 2.0 ** (1 - n))
    return {**found, "p": p if n > 1 and drawn.size else None}


def with_two(values: FloatArray, n: int) -> FloatArray:
    """Return resampled differences (1 + resamples,) of shares of n events, with two events more.

    The first alone is right about one of these, the second alone about the other. So n equal
    differences still have some spread.
    """
    rng = np.random.default_rng(0)
    drawn = rng.binomial(n + 2, 1 / (n + 2), (2, len(values) - 1))  # how often a resample has them
    more = drawn[0] - drawn[1]
    # both signs, so that the reversed difference has the mirrored interval
    both = np.concatenate([values[1:] * n + more, values[1:] * n - more])
    return np.clip(np.append(values[0] * n, both) / (n + 2), -1, 1)
