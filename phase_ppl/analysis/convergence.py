"""R-hat and effective sample sizes: whether chains have mixed. The estimators are ArviZ's."""

from __future__ import annotations

import math
import warnings
from typing import Any, Final, Literal

import numpy as np
import pandas as pd

from phase_ppl.world.arrays import FloatArray

MIN_DRAWS: Final = 4
"""Draws per chain below which neither R-hat nor an effective sample size is estimated."""

MIN_DRAWS_WITHIN: Final = 10
"""Draws per chain from which on effective sample sizes are taken from autocorrelations."""

MIN_CHAINS_BETWEEN: Final = 4
"""Chains below which no effective sample size is taken from the spread between them."""

_TAIL: Final = (0.05, 0.95)


def arviz_module() -> Any:
    """Return ArviZ, which is slow to import."""
    with warnings.catch_warnings():
        # announces ArviZ 1, with which this works too
        warnings.simplefilter("ignore", FutureWarning)
        import arviz

        return arviz


def r_hat(values: FloatArray, method: Literal["rank", "split"] = "rank") -> float:
    """Return the split R-hat of (chain, draw) numbers: 1 where chains have mixed.

    Rank-normalised, the larger one of bulk and tail; or by ``"split"`` of the numbers as they
    are, as for indicators. Of a single chain the halves are the chains. Infinite where all
    spread is between halves of chains. NaN where it does not exist: fewer than four draws, a
    value that is not finite, or all values the same.
    """
    if not _varies(values):
        return math.nan
    halves = chain_halves(values)
    if not np.ptp(halves, axis=1).any():  # the variance of equal numbers may be rounded to above 0
        return math.inf if np.ptp(halves) > 0 else math.nan
    chains = values if len(values) > 1 else halves
    if chains.shape[1] < MIN_DRAWS:
        return math.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(arviz_module().rhat(chains, method=method))


def ess(values: FloatArray, method: Literal["bulk", "tail", "mean"]) -> float:
    """Return the effective number of (chain, draw) numbers; NaN as for :func:`r_hat`.

    For the centre (bulk), for the 5 % and 95 % quantiles, the lower (tail), or for the mean. Of
    chains too short for autocorrelations, where the usual estimate hardly depends on the draws,
    it follows from the spread between the chains, if there are enough.
    """
    if not _varies(values):
        return math.nan
    if values.shape[1] >= MIN_DRAWS_WITHIN:
        options = {"prob": _TAIL} if method == "tail" else {}
        return float(arviz_module().ess(values, method=method, **options))
    if method == "tail":
        low, high = (_ess_between((values <= q).astype(float)) for q in np.quantile(values, _TAIL))
        return min(low, high)
    return _ess_between(_normal_ranks(values) if method == "bulk" else values)


def mcse(values: FloatArray) -> float:
    """Return the Monte-Carlo standard error of the mean of (chain, draw) numbers; or NaN."""
    return (
        float(values.std(ddof=1)) / math.sqrt(ess(values, "mean")) if _varies(values) else math.nan
    )


def _varies(values: FloatArray) -> bool:
    if values.shape[1] < MIN_DRAWS or not np.isfinite(values).all():
        return False
    return bool(np.ptp(values) > np.finfo(float).eps * np.abs(values).max())


def chain_halves(values: FloatArray) -> FloatArray:
    """Return (2 chains, draw // 2) the first and second half of every chain."""
    half = values.shape[1] // 2
    return np.concatenate([values[:, :half], values[:, -half:]]).astype(float)


def _normal_ranks(values: FloatArray) -> FloatArray:
    """Return the values' ranks, of equals the mean, as quantiles of the normal distribution."""
    from scipy.special import ndtri

    ranks = pd.Series(values.ravel()).rank().to_numpy()
    quantiles: FloatArray = ndtri((ranks - 3 / 8) / (values.size + 1 / 4))
    return quantiles.reshape(values.shape)


def _ess_between(chains: FloatArray) -> float:
    """Return the effective sample size that the spread between the chains' means tells."""
    if np.ptp(chains) < np.finfo(float).resolution:
        return float(chains.size)
    if len(chains) < MIN_CHAINS_BETWEEN:
        return math.nan
    squared_error = chains.mean(axis=1).var(ddof=1) / len(chains)
    variance = chains.var(ddof=1)
    return float(variance / max(squared_error, variance / (chains.size * math.log10(chains.size))))
