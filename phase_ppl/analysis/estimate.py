"""Results with their Monte-Carlo errors.

A statistic is computed anew without some of the chains (the jackknife); how much the results differ
tells how much it would differ between runs: error^2 = (n - d) / d * mean squared deviation from
their mean, where sets of d of n chains are left out: single chains, but for the ends of intervals,
which jump from draw to draw, random thirds. Added is what chains do not show by differing:

* Chains that still move away from where they began. Where draws count equally, the squared
  difference of the statistic between the first and the last half of the draws, as far as it is
  clearly beyond chance.
* What few draws need not have shown. Fifteen particles that agree do not make a goal impossible:
  the error of a probability is at least that of a posterior after as many independent draws as the
  run is worth (:func:`with_unseen`), at most the distinct simulations that it rests on.
* What a proposal that was fitted has never tried (``phase_ppl.analysis.tree.unseen_share``).

So an error is

* unknown (NaN) with one chain, or where without one of the sets nothing is left to condition on;
* too small where all chains began at the same wrong place and none has left it;
* too small for kernels whose chains exchange states (sa, aies), and too large for
  ``enumerate``, whose chains share out the hypotheses and do not sample them.

It is no MCSE of ArviZ's: that is of chains whose draws count alike, and knows neither weighted
simulations nor sets of searches.

How often an answer lies within 1.96 errors of the exact one was measured on worlds that can be
enumerated (``benchmarks/estimates.py``).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, shown

ROUNDING: Final = 1e-12
"""What is smaller, as a share of what was summed up, is left over from rounding."""


def share(which: NDArray[np.bool_], weights: FloatArray) -> FloatArray:
    """Return (...) the share of weights (..., row) that the rows ``which`` have."""
    return weights[..., which].sum(axis=-1) / weights.sum(axis=-1)


def cautious(share: float, n: int) -> tuple[float, float]:
    """Return a share of ``n`` and its standard error as if there had been one more of each."""
    p = (share * n + 1) / (n + 2)
    return p, math.sqrt(p * (1 - p) / (n + 2))


def mean(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return (...) the mean of values (row,) under weights (..., row) of sum 1."""
    return (weights * values).sum(axis=-1)  # BLAS would start threads for it


def median(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the lower medians of values (row,) under weights (..., row)."""
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weights[..., order], axis=-1) >= 0.5 * weights.sum(axis=-1)[..., None]
    return np.asarray(values[order][reached.argmax(axis=-1)])


def sd(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return (...) the standard deviation of values (row,) under weights (..., row) of sum 1."""
    # about any fixed centre, and one in their midst loses no digits
    centred = values - mean(values, weights.reshape(-1, len(values))[0])
    shift = mean(centred, weights)
    variance = mean(centred**2, weights) - shift**2
    rounding = (ROUNDING * np.abs(values).max()) ** 2
    return np.sqrt(np.where(variance > rounding, variance, 0.0))


def shares(codes: NDArray[np.int64], weights: FloatArray, size: int = 0) -> FloatArray:
    """Return (..., code) the sums of weights (..., row) of every code (row,), at least ``size``."""
    size = max(size, int(codes.max()) + 1)
    sums = [np.bincount(codes, some, size) for some in weights.reshape(-1, len(codes))]
    return np.array(sums, np.float64).reshape(*weights.shape[:-1], size)


def entropy(mass: FloatArray) -> FloatArray:
    """Return (...) the entropy in nats of distributions (..., code)."""
    logs = np.log(mass, where=mass > 0, out=np.zeros_like(mass))
    found = -(mass * logs).sum(axis=-1)
    return np.where(found > ROUNDING, found, 0.0)


def worth(weights: FloatArray) -> float:
    """Return how many equal draws weighted ones of sum 1 are worth, at most (Kish)."""
    return float(1 / (weights**2).sum())


def typical(codes: NDArray[np.int64], values: FloatArray, size: int) -> FloatArray:
    """Return (code,) the geometric mean of the values with each code, 0 of those without any.

    Values that are NaN do not count.
    """
    known = ~np.isnan(values)
    codes, logs = codes[known], np.log(np.maximum(values[known], np.finfo(float).tiny))
    n = np.bincount(codes, minlength=size)
    return np.where(n > 0, np.exp(np.bincount(codes, logs, size) / np.maximum(n, 1)), 0.0)


def total_variation(one: FloatArray, other: FloatArray) -> float:
    """Return half the summed absolute difference of two distributions."""
    return 0.5 * float(np.abs(one - other).sum())


FEW_DRAWS: Final = 10.0
"""Independent draws below which an answer rests on too little to be sure of anything."""

FEW_WHERE_TOLD, TOLD = 2.0, 2.0
"""Likewise, where goals fit the better the more the video suggested them: from a rank correlation
of so many standard errors on. In some videos of PHASE they do, and answers on 2
to 10 effective draws were right (``benchmarks/decided.py``)."""

LEARNT: Final = 1.5
"""By how much errors grow where what was drawn decides what is drawn next, which groups of chains
do not show (``benchmarks/estimates.py --only amis``)."""

MISLED: Final = 0.5  # standard errors below which suggestions are no better than chance
_FEWEST_DEGREES: Final = 2.0  # of freedom: with one, 6.5 spreads would be one error
_CLEARLY: Final = 2.0  # standard errors by which halves of the draws are to differ
N_SETS: Final = 30  # random sets of chains that are left out
_MOST_DECIMALS: Final = 4


class Estimate(float):
    """A number with its Monte-Carlo error, printed as 0.83 ± 0.04; in all else a plain float.

    Attributes:
        error: standard error; NaN where it is unknown, which prints as ``?``.
    """

    error: float

    def __new__(cls, value: float, error: float = math.nan) -> Estimate:
        try:
            self = super().__new__(cls, value)
            self.error = float(error)
        except (TypeError, ValueError):
            given = f"Estimate({shown(value)}, {shown(error)})"
            raise InvalidSettingError(f"{given}, expected a number and its error") from None
        return self

    def __getnewargs__(self) -> tuple[float, float]:  # type: ignore[override]
        return float(self), self.error

    def __repr__(self) -> str:
        return with_error(float(self), self.error)

    __str__ = __repr__

    def __format__(self, spec: str) -> str:
        return float(self).__format__(spec) if spec else repr(self)


class Mode(str):
    """The most probable label; a plain string.

    Attributes:
        error: how probable it is that another label leads in truth: the highest such probability
            of any other, from the Monte-Carlo error of the difference, taken as normal, and at
            least as in Jeffreys' posterior of the two after as many independent draws as they are
            worth. 0.5 for a tie; NaN where it is unknown.
    """

    error: float

    def __new__(cls, label: str, error: float = math.nan) -> Mode:
        self = super().__new__(cls, label)
        self.error = float(error)
        return self

    def __getnewargs__(self) -> tuple[str, float]:  # type: ignore[override]
        return str(self), self.error


def with_error(value: float, error: float) -> str:
    """Return ``value ± error`` with as many digits as the error leaves certain."""
    if not error > 0 or not math.isfinite(value):
        return f"{value:.3g} ± {'0' if error == 0 else '?'}"
    exponent = math.floor(math.log10(error))
    # two digits of an error that begins with 10 to 35, else one
    decimals = max(0, -exponent + (error / 10.0**exponent < 3.55))
    if decimals > _MOST_DECIMALS:
        size = math.floor(math.log10(abs(value))) if value else exponent
        digits = min(max(1, size - exponent + 1), _MOST_DECIMALS)
        return f"{value:.{digits}g} ± {error:.1g}"
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


@dataclasses.dataclass(frozen=True, eq=False)
class Jackknife:
    """Weights of rows without sets of groups of chains."""

    # (set, row), each set's sum 1. Where halves of the draws are compared, further ones follow: the
    # first and the last half, and both without each set
    weights: FloatArray
    factor: float  # (n - d) / d, where sets of d of n groups are left out
    n_sets: int | None = None  # how many of the weights are those of sets; None: all

    def error(self, results: ArrayLike, value: ArrayLike) -> FloatArray:
        """Return the standard error of a statistic, with what the halves differ beyond chance.

        Results (set, ...) are those under each of the weights, the value (...) is that of all.
        """
        found = np.asarray(results, np.float64)
        n = self.n_sets
        variance = self._variance(found[:n])
        if n is not None:
            change = found[n + 1] - found[n]
            by_chance = self._variance(found[2 * n + 2 :] - found[n + 2 : 2 * n + 2])
            variance = variance + np.maximum(0.0, change**2 - _CLEARLY**2 * by_chance)
        error: Any = np.sqrt(variance)
        return np.where(error > ROUNDING * np.abs(np.asarray(value)), error, 0.0)

    def _variance(self, found: FloatArray) -> FloatArray:
        return np.asarray(self.factor * ((found - found.mean(axis=0)) ** 2).mean(axis=0))

    def only(self, rows: NDArray[np.bool_]) -> Jackknife | None:
        """Return it for the ``rows`` alone; None where they weigh nothing without a set."""
        weights = self.weights if rows.all() else self.weights[:, rows]
        total = weights.sum(axis=1, keepdims=True)
        n = self.n_sets
        if n is not None and (total[:n] > 0).all() and not (total > 0).all():
            return Jackknife(weights[:n] / total[:n], self.factor)  # the halves cannot be compared
        return dataclasses.replace(self, weights=weights / total) if (total > 0).all() else None


@dataclasses.dataclass(frozen=True, eq=False)
class Jackknives:
    """Jackknives over several sources of error, which add up."""

    parts: tuple[Jackknife, ...]

    @property
    def weights(self) -> FloatArray:
        """(set, row) the weights of all parts."""
        return np.concatenate([part.weights for part in self.parts])

    def error(self, results: ArrayLike, value: ArrayLike) -> FloatArray:
        """Return the standard error of a statistic, as :meth:`Jackknife.error`."""
        ends = np.cumsum([len(part.weights) for part in self.parts])[:-1]
        of_parts = np.split(np.asarray(results, np.float64), ends)
        errors = [part.error(r, value) for part, r in zip(self.parts, of_parts, strict=True)]
        return np.asarray(np.sqrt(np.sum(np.square(errors), axis=0)))

    def only(self, rows: NDArray[np.bool_]) -> Jackknives | None:
        """Return it for the ``rows`` alone; None where a set leaves nothing of them."""
        parts = [part.only(rows) for part in self.parts]
        return None if None in parts else Jackknives(tuple(p for p in parts if p is not None))


def leaving_out(
    weights: FloatArray,
    groups: NDArray[np.int64],
    halves: Sequence[NDArray[np.bool_]] = (),
    share: float = 0.0,
    strata: tuple[NDArray[np.int64], FloatArray] | None = None,
) -> Jackknife | None:
    """Return the weights of rows without sets of groups of chains (:func:`sets_to_leave_out`).

    None of a single group, or where without one of the sets nothing would be left. Arguments are
    (row,) weights, the number of each row's group, and masks of the first and the last half of the
    draws if these are compared; of rows in strata whose mass does not depend on who is left out
    the stratum of each (row,) and the share of each group in it (stratum, group).
    """
    # in strata there are groups too that have no row, as none of their simulations was completed
    n_groups = int(groups.max()) + 1 if strata is None else strata[1].shape[1]
    if n_groups < 2:
        return None
    sets, factor = sets_to_leave_out(n_groups, share)
    left = np.where(sets[:, groups], 0.0, weights)
    if strata is not None:
        stratum, shares = strata
        remaining = 1.0 - sets @ shares.T
        left = left / np.maximum(remaining, ROUNDING)[:, stratum]  # 0 where nothing is left
    parts = [left]
    if len(halves) == 2:
        parts += [np.where(half, weights, 0.0)[None] for half in halves]
        parts += [np.where(half, left, 0.0) for half in halves]
    n_sets = len(sets) if len(parts) > 1 else None
    return Jackknife(np.concatenate(parts), factor, n_sets).only(np.ones(len(weights), bool))


def widened(size: float) -> float:
    """Return by what the error of a mean over ``size`` draws grows for their spread being unknown.

    So that 1.96 errors hold as much as Student's t would: 2.2 for three draws or fewer, 1.04 for
    thirty; 1 where the size is NaN.
    """
    if math.isnan(size):
        return 1.0
    from scipy.special import stdtrit  # slow to import

    return float(stdtrit(max(size - 1.0, _FEWEST_DEGREES), 0.975)) / 1.96


def with_unseen(mass: ArrayLike, error: ArrayLike, size: float, n_labels: int = 2) -> FloatArray:
    """Return errors of probabilities that are not 0 only because few draws all say the same.

    The posterior of a probability p after n draws, and one that was divided as b, has the mean
    p' = (n p + b) / (n + 1) and the variance p' (1 - p') / (n + 2); the error is at least its root
    mean squared distance from p. It vanishes as n grows. b is 1/2 (Jeffreys), and from
    :data:`FEW_DRAWS` draws on one over the number of labels (Perks): few leave anything possible,
    many have room for one label among many only. ``error`` is what the chains show of it, ``size``
    the number n of independent draws that they are worth, NaN where it is not known.
    """
    p = np.asarray(mass, np.float64)
    beforehand = 0.5 if size < FEW_DRAWS else 1 / n_labels
    expected = (size * p + beforehand) / (size + 1)
    least = np.sqrt(expected * (1 - expected) / (size + 2) + (expected - p) ** 2)
    return np.asarray(np.fmax(np.asarray(error, np.float64), least))


def sets_to_leave_out(n_groups: int, share: float = 0.0) -> tuple[NDArray[np.bool_], float]:
    """Return (set, group) which groups to leave out, and the factor of :class:`Jackknife`.

    A random set has a ``share`` of the groups; where that comes to one, sets are single groups.
    """
    size = int(n_groups * share)
    if size < 2:
        return np.eye(n_groups, dtype=bool), n_groups - 1.0
    order = np.random.default_rng(0).random((N_SETS, n_groups)).argsort(axis=1)
    return order < size, (n_groups - size) / size


def doubt(
    probabilities: FloatArray,
    without: Jackknife | Jackknives,
    results: FloatArray,
    size: float = math.nan,
    luck: ArrayLike = 0.0,
) -> float:
    """Return how probable it is that another label than the first of the highest leads in truth.

    See :class:`Mode`. Probabilities are (label,), results (set, label) those without each set;
    ``size`` is the number of independent draws that they are worth, NaN where it is not known;
    ``luck`` (label,) what one more lucky simulation of each would add to its error.
    """
    leading = int(probabilities.argmax())
    leads = np.delete(probabilities[leading] - probabilities, leading)
    errors = without.error(np.delete(results[:, [leading]] - results, leading, axis=1), leads)
    of_luck = np.broadcast_to(luck, probabilities.shape)
    errors = np.hypot(errors, np.hypot(of_luck[leading], np.delete(of_luck, leading)))
    chances = [0.0]
    for lead, error in zip(leads.tolist(), errors.tolist(), strict=True):
        tied = 0.5 if lead <= ROUNDING else 0.0
        chances.append(0.5 * math.erfc(lead / (math.sqrt(2) * error)) if error > 0 else tied)
    if not math.isnan(size):  # a few draws that agree need not be those of the leader
        from scipy.special import betainc

        others = np.delete(probabilities, leading)
        of_leader = size * probabilities[leading] + 0.5
        chances += betainc(of_leader, size * others + 0.5, 0.5).tolist()
    return max(chances)
