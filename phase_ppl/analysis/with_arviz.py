"""ArviZ, 0.22 or newer and 1.x: the one module that calls it.

First its estimators, under one name for all versions. Then the objects that posteriors hand to it:
``post.arviz``, equal draws of the printed posterior, and ``post.chains``, the original chains.
"""

from __future__ import annotations

import functools
import importlib.metadata
import json
import math
import warnings
from collections.abc import Hashable, Mapping
from typing import Any, Final, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.estimate import ROUNDING
from phase_ppl.analysis.quantities import Quantity
from phase_ppl.analysis.tree import DRAW
from phase_ppl.world.arrays import FloatArray

N_CHAINS: Final = 4
N_DRAWS: Final = 1000
"""Shape of resampled draws: sums over them have an error below 0.01."""

MASS: Final = 0.02  # least share of the draws, or probability, of a reported category

NO_LOO: Final = (
    "az.loo, az.waic and az.compare need independent observations, and the frames of a video are "
    "not: each depends on those before it, and the likelihood is tempered. Compare priors, "
    "simulators or kernels by log_evidence of the closed loop, or by ppl.compare over several "
    "videos"
)
"""Why there is no group ``log_likelihood``; the attribute ``loo`` of what ArviZ is given."""

_STREAM: Final = 0xA2  # keeps what is resampled apart from what else follows from a run's seed

# --- estimators -----------------------------------------------------------------------------------

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


@functools.cache
def _is_new() -> bool:
    return int(importlib.metadata.version("arviz").split(".")[0]) >= 1


def r_hat(values: FloatArray, method: Literal["rank", "split"] = "rank") -> float:
    """Return the split R-hat of (chain, draw) numbers: 1 if chains have mixed.

    ``"rank"`` is rank-normalised, the larger one of bulk and tail; ``"split"`` uses the raw
    numbers, as for indicators. The halves of a single chain are its chains. Infinite: all spread is
    between halves of chains. NaN: fewer than four draws, a value that is not finite, or constant
    values.
    """
    if not _varies(values):
        return math.nan
    halves = chain_halves(values)
    if not np.ptp(halves, axis=1).any():  # the variance of equal numbers may be rounded to above 0
        return math.inf if np.ptp(halves) > 0 else math.nan
    chains = values if len(values) > 1 else halves
    with np.errstate(divide="ignore", invalid="ignore"):
        enough = chains.shape[1] >= MIN_DRAWS
        return float(arviz_module().rhat(chains, method=method)) if enough else math.nan


def ess(values: FloatArray, method: Literal["bulk", "tail", "mean"]) -> float:
    """Return the effective sample size of (chain, draw) numbers; NaN as for :func:`r_hat`.

    It is for the centre (bulk), the lower of the 5 % and 95 % quantiles (tail), or the mean. The
    usual estimate of chains too short for autocorrelations hardly depends on the draws. With enough
    such chains the spread between them is used instead.
    """
    if not _varies(values):
        return math.nan
    if values.shape[1] >= MIN_DRAWS_WITHIN:
        options = {"prob": _TAIL} if method == "tail" else {}
        return float(arviz_module().ess(values, method=method, **options))
    from scipy.special import ndtri  # slow to import
    from scipy.stats import rankdata

    if method == "tail":
        return min(_ess_between((values <= q).astype(float)) for q in np.quantile(values, _TAIL))
    if method == "bulk":  # ranks (ties: their mean) as quantiles of the normal distribution
        ranks = rankdata(values).reshape(values.shape)
        values = ndtri((ranks - 3 / 8) / (values.size + 1 / 4))
    return _ess_between(values)


def mcse(values: FloatArray) -> float:
    """Return the Monte-Carlo standard error of the mean of (chain, draw) numbers; or NaN.

    It is for chains with equal draws. The ``.error`` of an answer differs: it is the jackknife of
    :mod:`phase_ppl.analysis.estimate`. ArviZ does not support weighted draws, simulations in strata
    or sets of searches.
    """
    if not _varies(values):
        return math.nan
    if values.shape[1] >= MIN_DRAWS_WITHIN:
        return np.asarray(arviz_module().mcse(values, method="mean"), np.float64).item()
    return float(values.std(ddof=1)) / math.sqrt(ess(values, "mean"))


def hdi(levels: FloatArray, mass: FloatArray, n: int, prob: float) -> FloatArray:
    """Return the ends of the shortest interval that holds ``prob`` of ``n`` equal draws.

    The draws are quantiles of the distribution with ascending values ``levels`` and probabilities
    ``mass``. For a distribution of n equal draws they are these draws themselves.
    """
    at = (np.arange(n) + 0.5) / n * mass.sum()
    draws = levels[np.searchsorted(np.cumsum(mass), at)]
    prob = min(prob, 1 - 0.5 / n)  # version 0.23 finds no interval that holds all
    name = "prob" if _is_new() else "hdi_prob"
    return np.asarray(arviz_module().hdi(draws, **{name: prob}), np.float64)


def n_equal(weights: FloatArray) -> int:
    """Return how many draws represent weights (row,): one per row if they are equal, else 4000."""
    counted = weights[weights > 0]
    return counted.size if are_equal(counted) else N_CHAINS * N_DRAWS


def are_equal(weights: FloatArray) -> bool:
    """Whether weights differ by rounding only."""
    return bool(np.ptp(weights) <= ROUNDING * weights.max())


def _varies(values: FloatArray) -> bool:
    enough = values.shape[1] >= MIN_DRAWS and np.isfinite(values).all()
    return bool(enough and np.ptp(values) > np.finfo(float).eps * np.abs(values).max())


def chain_halves(values: FloatArray) -> FloatArray:
    """Return (2 chains, draw // 2) the first and second half of every chain."""
    half = values.shape[1] // 2
    return np.concatenate([values[:, :half], values[:, -half:]]).astype(float)


def _ess_between(chains: FloatArray) -> float:
    """Return the effective sample size, from the spread between the chains' means."""
    if np.ptp(chains) < np.finfo(float).resolution:
        return float(chains.size)
    if len(chains) < MIN_CHAINS_BETWEEN:
        return math.nan
    squared_error = chains.mean(axis=1).var(ddof=1) / len(chains)
    variance = chains.var(ddof=1)
    return float(variance / max(squared_error, variance / (chains.size * math.log10(chains.size))))


# --- objects for ArviZ ----------------------------------------------------------------------------


def pareto_smoothed(log_ratios: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smooth the importance weights of each row of ``log_ratios`` (row, draw), as ArviZ does.

    Returns:
        The weights (row, draw), each row summing to 1; and the Pareto shape k of each row (row,).
        Above 0.7 a row's weights are unreliable.
    """
    if _is_new():
        from arviz_stats.base import array_stats

        logs, k = array_stats.psislw(log_ratios, axis=-1)
    else:
        logs, k = arviz_module().psislw(log_ratios)
    weights = np.exp(logs - np.logaddexp.reduce(logs, axis=-1, keepdims=True))
    return np.asarray(weights, np.float64), np.atleast_1d(np.asarray(k, np.float64))


def arviz_groups(
    groups: Mapping[str, xr.Dataset], attrs: Mapping[Hashable, Any] | None = None
) -> Any:
    """Return datasets as the container of the installed ArviZ.

    It is an ``arviz.InferenceData`` for ArviZ before 1, otherwise an :class:`xarray.DataTree`.

    Args:
        groups: name of a group, such as "posterior" -> its dataset, with dims (chain, draw, ...)
            where it holds draws.
        attrs: attributes of the whole container; None: no attributes.
    """
    if not _is_new():
        return arviz_module().InferenceData(attrs=dict(attrs or {}), **groups)
    data = xr.DataTree.from_dict(dict(groups))
    data.attrs = dict(attrs or {})
    return data


def resampled(weights: FloatArray, seed: int, *, exact: bool) -> NDArray[np.int64]:
    """Return equal draws (chain, draw): row numbers, drawn in proportion to weights (row,).

    Resampling is systematic: the count of a row differs from its expectation by less than one.
    Rows are in random order, with copies of a row next to each other. So ArviZ's effective size of
    the draws is close to Kish's size of the weights. An ``exact`` table has each hypothesis once
    and nothing was drawn: its draws are in random order.
    """
    n, rng = N_CHAINS * N_DRAWS, np.random.default_rng([seed, _STREAM])
    order = rng.permutation(len(weights))
    cumulative = np.cumsum(weights[order])
    at = (np.arange(n) + rng.random()) / n * cumulative[-1]
    rows = order[np.searchsorted(cumulative, at)]
    return (rng.permutation(rows) if exact else rows).reshape(N_CHAINS, N_DRAWS)


def draws_of(
    numbers: Mapping[str, NDArray[Any]],
    codes: Mapping[str, tuple[Quantity, NDArray[Any], FloatArray]],
    *,
    moving: bool = False,
) -> xr.Dataset:
    """Return the group ``posterior``: numbers, and indicators of categories.

    Means and R-hat of goal codes are meaningless. So each category with more than 2 % probability
    becomes an indicator (0 or 1), whose mean is a probability.

    Args:
        numbers: name -> (chain, draw).
        codes: name -> its quantity, codes (chain, draw), and the probabilities of its labels.
        moving: leave out indicators that are constant within every half of a chain, since they have
            no R-hat, and name them in the attribute ``left_out`` (JSON).
    """
    chains, draws = next(iter(numbers.values())).shape
    result = xr.Dataset(
        {name: (DRAW, values) for name, values in numbers.items()},
        {"chain": range(chains), "draw": range(draws)},
    )
    left_out: dict[str, list[str]] = {}
    for name, (quantity, drawn, probability) in codes.items():
        likely = np.flatnonzero(probability > MASS)
        labels = np.array(quantity.categories())[likely]
        indicators = (drawn[..., None] == likely).astype(np.int64)
        kept = np.ones(len(likely), bool)
        if moving and draws >= MIN_DRAWS:  # of fewer draws ArviZ does not look for it either
            kept = np.ptp(chain_halves(indicators), axis=1).any(axis=0)
            left_out |= {} if kept.all() else {name: labels[~kept].tolist()}
        if kept.any():
            dim = f"{name}_is"
            result[name] = (*DRAW, dim), indicators[..., kept]
            result = result.assign_coords({dim: labels[kept].tolist()})
    return result.assign_attrs({"left_out": json.dumps(left_out)} if moving else {})
