"""R-hat and effective sample size of chains (Vehtari et al. 2021, Bayesian Analysis 16:667).

The same numbers as ArviZ gives, without the seconds that importing it takes. They are of numbers,
or of indicators of a category; of goal codes neither means anything.

The usual effective sample size adds up the autocorrelations within chains. Halves of fewer than
five draws have none to add up, and the result would be the same for all draws, even of chains that
never moved. For such short chains, if there are several, it is taken from the spread between the
chains instead: the variance of all draws over the squared standard error of their mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
import pandas as pd
import scipy.special

from phase_ppl.world.arrays import FloatArray

MIN_DRAWS: Final = 4
"""Draws per chain below which neither R-hat nor an effective sample size is estimated."""

MIN_DRAWS_WITHIN: Final = 10
"""Draws per chain from which on effective sample sizes are taken from autocorrelations."""

MIN_CHAINS_BETWEEN: Final = 4
"""Chains below which no effective sample size is taken from the spread between them."""

_TAIL: Final = 0.05


def r_hat(values: FloatArray) -> float:
    """Return the rank-normalised split R-hat of (chain, draw) numbers: 1 where chains have mixed.

    The larger one of bulk and tail. NaN where it does not exist: fewer than four draws, a value
    that is not finite, or all values the same.
    """
    if not _varies(values):
        return math.nan
    halves = _halves(values)
    folded = np.abs(halves - np.median(halves))
    return max(_ratio(_normal_ranks(halves)), _ratio(_normal_ranks(folded)))


def split_r_hat(values: FloatArray) -> float:
    """Return the split R-hat of (chain, draw) numbers as they are, as for indicators; or NaN."""
    return _ratio(_halves(values)) if _varies(values) else math.nan


def ess_bulk(values: FloatArray) -> float:
    """Return the effective number of draws for the centre of (chain, draw) numbers; or NaN."""
    return _effective(values, _normal_ranks) if _varies(values) else math.nan


def ess_tail(values: FloatArray) -> float:
    """Return the effective number of draws for the 5 % and 95 % quantiles, the lower; or NaN."""
    if not _varies(values):
        return math.nan
    low, high = np.quantile(values, (_TAIL, 1 - _TAIL))
    return min(
        _effective(values, lambda chains: (chains <= low).astype(float)),
        _effective(values, lambda chains: (chains <= high).astype(float)),
    )


def ess_mean(values: FloatArray) -> float:
    """Return the effective number of draws for the mean of (chain, draw) numbers; or NaN."""
    return _effective(values) if _varies(values) else math.nan


def mcse_mean(values: FloatArray) -> float:
    """Return the Monte-Carlo standard error of the mean of (chain, draw) numbers; or NaN."""
    return float(values.std(ddof=1)) / math.sqrt(ess_mean(values)) if _varies(values) else math.nan


def _varies(values: FloatArray) -> bool:
    if values.shape[1] < MIN_DRAWS or not np.isfinite(values).all():
        return False
    return bool(np.ptp(values) > np.finfo(float).eps * np.abs(values).max())


def _halves(values: FloatArray) -> FloatArray:
    """Return (2 chains, draw // 2) the first and second half of every chain."""
    half = values.shape[1] // 2
    return np.concatenate([values[:, :half], values[:, -half:]]).astype(float)


def _normal_ranks(values: FloatArray) -> FloatArray:
    """Return the values' ranks, of equals the mean, as quantiles of the normal distribution."""
    ranks = pd.Series(values.ravel()).rank().to_numpy()
    shares = (ranks - 3 / 8) / (values.size + 1 / 4)
    quantiles: FloatArray = scipy.special.ndtri(shares)
    return quantiles.reshape(values.shape)


def _ratio(chains: FloatArray) -> float:
    """Return R-hat; infinite where all spread is between chains, NaN where there is none."""
    n = chains.shape[1]
    between = chains.mean(axis=1).var(ddof=1)
    if np.ptp(chains, axis=1).any():  # of equal numbers the variance may be rounded to above 0
        within = chains.var(axis=1, ddof=1).mean()
        return float(np.sqrt(between / within + (n - 1) / n))
    return math.inf if between > 0 else math.nan


def _effective(
    values: FloatArray, view: Callable[[FloatArray], FloatArray] = lambda chains: chains
) -> float:
    """Return the effective sample size of what ``view`` makes of the chains."""
    long = values.shape[1] >= MIN_DRAWS_WITHIN
    chains = view(_halves(values) if long else values)
    if np.ptp(chains) < np.finfo(float).resolution:
        return float(chains.size)
    most = chains.size * math.log10(chains.size)  # of chains that alternate
    if long:
        return chains.size / max(_autocorrelation_time(chains), chains.size / most)
    if len(chains) < MIN_CHAINS_BETWEEN:
        return math.nan
    squared_error = chains.mean(axis=1).var(ddof=1) / len(chains)
    variance = chains.var(ddof=1)
    return float(variance / max(squared_error, variance / most))


def _autocorrelation_time(chains: FloatArray) -> float:
    """Return the sum of the autocorrelations, by Geyer's initial monotone sequence."""
    n = chains.shape[1]
    covariance = _autocovariance(chains).mean(axis=0)
    within = covariance[0] * n / (n - 1)
    total = covariance[0] + chains.mean(axis=1).var(ddof=1)
    rho = 1 - (within - covariance) / total
    rho[0] = 1.0
    kept = np.zeros(n)
    kept[:2] = rho[:2]
    even, odd, t = 1.0, rho[1], 1
    while t < n - 3 and even + odd > 0:
        even, odd = rho[t + 1], rho[t + 2]
        if even + odd >= 0:
            kept[t + 1], kept[t + 2] = even, odd
        t += 2
    last = t - 2
    if even > 0:
        kept[last + 1] = even
    for t in range(1, last - 1, 2):  # sums of pairs must not grow
        before = kept[t - 1] + kept[t]
        if kept[t + 1] + kept[t + 2] > before:
            kept[t + 1] = kept[t + 2] = before / 2
    return float(-1 + 2 * kept[: last + 1].sum() + kept[last + 1 : last + 2].sum())


def _autocovariance(chains: FloatArray) -> FloatArray:
    """Return (chain, lag) autocovariances, divided by the number of draws at every lag."""
    n = chains.shape[1]
    deviation = chains - chains.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(deviation, 2 * n, axis=1)
    return np.fft.irfft(spectrum * spectrum.conj(), 2 * n, axis=1)[:, :n] / n
