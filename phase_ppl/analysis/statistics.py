"""Statistics of weighted rows."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.arrays import FloatArray

ROUNDING: Final = 1e-12
"""What is smaller, as a share of what was summed up, is left over from rounding."""


def share(which: NDArray[np.bool_], weights: FloatArray) -> FloatArray:
    """Return (...) the share of weights (..., row) that the rows ``which`` have."""
    return weights[..., which].sum(axis=-1) / weights.sum(axis=-1)


def mean(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return (...) the mean of values (row,) under weights (..., row) of sum 1."""
    return (weights * values).sum(axis=-1)  # BLAS would start threads for it


def sd(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return (...) the standard deviation of values (row,) under weights (..., row) of sum 1."""
    # about any fixed centre, and one in their midst loses no digits
    centred = values - mean(values, weights.reshape(-1, len(values))[0])
    shift = mean(centred, weights)
    variance = mean(centred**2, weights) - shift**2
    rounding = (ROUNDING * np.abs(values).max()) ** 2
    return np.sqrt(np.where(variance > rounding, variance, 0.0))


def shares(codes: NDArray[np.int64], weights: FloatArray, size: int = 0) -> FloatArray:
    """Return (..., code) the sums of weights of every code.

    Args:
        codes: (row,) 0 and up.
        weights: (..., row).
        size: number of codes, at least; there are as many as occur.
    """
    size = max(size, int(codes.max()) + 1)
    sums = [np.bincount(codes, some, size) for some in weights.reshape(-1, len(codes))]
    return np.array(sums, np.float64).reshape(*weights.shape[:-1], size)


def entropy(mass: FloatArray) -> FloatArray:
    """Return (...) the entropy in nats of distributions (..., code)."""
    logs = np.log(mass, where=mass > 0, out=np.zeros_like(mass))
    found = -(mass * logs).sum(axis=-1)
    return np.where(found > ROUNDING, found, 0.0)


def shortest_interval(values: FloatArray, weights: FloatArray, prob: float) -> tuple[float, float]:
    """Return the shortest [low, high] between weighted values that holds mass ``prob``.

    Args:
        values: (row,) ascending.
        weights: (row,) of any sum.
        prob: share of the weights.
    """
    cumulative = np.cumsum(weights)
    before = cumulative - weights
    # the tolerance keeps 0.9 of ten equal draws at nine of them
    last = np.searchsorted(cumulative, before + prob * cumulative[-1] - 1e-12)
    holds = last < len(values)
    starts, ends = values[holds], values[last[holds]]
    best = int(np.argmin(ends - starts))
    return float(starts[best]), float(ends[best])
