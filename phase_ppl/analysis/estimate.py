"""Results with their Monte-Carlo errors.

The error is a jackknife: a statistic is computed anew without sets of d of n chains. Then
error^2 = (n - d) / d * mean squared deviation of these results from their mean. Sets are single
chains. For the ends of intervals, which jump from draw to draw, they are random thirds. Three
errors that chains do not show by differing are added:

* Chains that still move away from their start. If draws count equally, the squared difference of
  the statistic between the first and the last half of the draws, as far as it is clearly beyond
  chance.
* Labels that few draws missed. Fifteen particles that agree do not make a goal impossible. The
  error of a probability is at least that of a posterior after as many independent draws as the run
  is worth (:func:`with_unseen`), at most its number of distinct simulations.
* Goals that a fitted proposal never tried (``phase_ppl.analysis.tree.unseen_share``).

So an error is

* unknown (NaN) with one chain, or if nothing is left to condition on without one of the sets;
* too small if all chains began at the same wrong place and none has left it;
* too small in the closed loop for goals that were improbable, if a condition or another prior makes
  them probable: the first set of searches alone has looked at them;
* too small for kernels whose chains exchange states (sa, aies), and too large for
  ``enumerate``, whose chains share out the hypotheses and do not sample them.

It differs from ArviZ's MCSE, which is for chains with equal draws and covers neither weighted
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
"""Sums smaller than this share of their terms are rounding errors."""


def share(which: NDArray[np.bool_], weights: FloatArray) -> FloatArray:
    """Return (...) the share of weights (..., row) that the rows ``which`` have."""
    return weights[..., which].sum(axis=-1) / weights.sum(axis=-1)


def cautious(share: float, n: int) -> tuple[float, float]:
    """Return a share of ``n`` and its standard error, after adding one of either kind."""
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
    # any fixed centre is right; one amid the values loses no digits
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


def kish_size(weights: FloatArray) -> float:
    """Return Kish's effective sample size of weights of sum 1."""
    return float(1 / (weights**2).sum())


def typical(codes: NDArray[np.int64], values: FloatArray, size: int) -> FloatArray:
    """Return (code,) the geometric mean of the values with each code; 0: no values.

    NaN values do not count.
    """
    known = ~np.isnan(values)
    codes, logs = codes[known], np.log(np.maximum(values[known], np.finfo(float).tiny))
    n = np.bincount(codes, minlength=size)
    return np.where(n > 0, np.exp(np.bincount(codes, logs, size) / np.maximum(n, 1)), 0.0)


def total_variation(one: FloatArray, other: FloatArray) -> float:
    """Return half the summed absolute difference of two distributions."""
    return 0.5 * float(np.abs(one - other).sum())


FEW_DRAWS: Final = 10.0
"""Fewest independent draws with which an answer can be sure."""

FEW_WHERE_TOLD, TOLD = 2.0, 2.0
"""Fewest independent draws if suggested goals fit better, and the least rank correlation, in
standard errors, that shows it. So it is in some videos of PHASE: answers on 2 to 10 effective draws
were right (``benchmarks/decided.py``)."""

LEARNT: Final = 1.5
"""Factor on errors of adaptive proposals: earlier draws decide later ones, which groups of chains
do not show (``benchmarks/estimates.py --only amis``)."""

MISLED: Final = 0.5  # standard errors below which suggestions are no better than chance
_FEWEST_DEGREES: Final = 2.0  # of freedom: with one, 6.5 spreads would be one error
_CLEARLY: Final = 2.0  # standard errors by which halves of the draws must differ to count
N_SETS: Final = 30  # random sets of chains that are left out
_MOST_DECIMALS: Final = 4


class Estimate(float):
    """A float with its Monte-Carlo error, printed as 0.83 ± 0.04.

    Arithmetic with it gives plain floats, without an error.

    Attributes:
        error: standard error; NaN: unknown, printed as 0.83 ± unknown.
        why: why the value or the error is unknown, printed after the number; "": no reason is
            given.
    """

    error: float
    why: str

    def __new__(cls, value: float, error: float = math.nan, why: str = "") -> Estimate:
        try:
            self = super().__new__(cls, value)
            self.error, self.why = float(error), why
        except (TypeError, ValueError):
            given = f"Estimate({shown(value)}, {shown(error)})"
            raise InvalidSettingError(f"{given}, expected a number and its error") from None
        return self

    def __getnewargs__(self) -> tuple[float, float, str]:  # type: ignore[override]
        return float(self), self.error, self.why

    def __repr__(self) -> str:
        return with_error(float(self), self.error) + (self.why and f" ({self.why})")

    __str__ = __repr__

    def __format__(self, spec: str) -> str:
        return float(self).__format__(spec) if spec else repr(self)


def odds(p: Estimate) -> Estimate:
    """Return p / (1 - p), its error to first order; inf, with an unknown error, if p is 1."""
    left = 1.0 - p
    return Estimate(p / left, p.error / left**2) if left > 0 else Estimate(math.inf)


def ratio(
    one: Estimate, other: Estimate, jackknifed: tuple[float, float, float] | None = None
) -> Estimate:
    """Return ``one / other`` with its error.

    Args:
        one, other: numbers, the second not 0.
        jackknifed: errors by the jackknife alone, of both and of the ratio, in which what both
            share cancels. What errors have beyond these is added to first order, as if it were
            independent: so the error is rather too large. None: all is to first order.
    """
    value, errors = float(one / other), np.array([one.error, one / other * other.error]) / other
    if jackknifed is None:
        return Estimate(value, float(np.hypot(*errors)))
    of_one, of_other, of_ratio = jackknifed
    of_sets = np.array([of_one, value * of_other]) / other
    beyond = np.maximum(errors**2 - of_sets**2, 0.0).sum()
    return Estimate(value, float(np.sqrt(of_ratio**2 + beyond)))


class Mode(str):
    """The most probable label; a plain string.

    Attributes:
        error: probability that another label is in truth the most probable one, the highest over
            all others. It comes from the Monte-Carlo error of the difference between their
            probabilities, taken as normal. It is at least the one under Jeffreys' posterior of
            these two labels, after as many independent draws as the run is worth. 0.5 for a tie;
            NaN: unknown.
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
        return f"{value:.3g} ± {'0' if error == 0 else 'unknown'}"
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
    """Weights of rows, with sets of groups of chains left out."""

    # (set, row), each set's sum 1. If halves of the draws are compared, more weights follow: of the
    # first and the last half, and of both without each set
    weights: FloatArray
    factor: float  # (n - d) / d, where sets of d of n groups are left out
    n_sets: int | None = None  # how many of the weights are those of sets; None: all

    def error(self, results: ArrayLike, value: ArrayLike) -> FloatArray:
        """Return the standard error of a statistic, with the halves' difference beyond chance.

        ``results`` (set, ...) are the statistic under each of the weights, ``value`` (...) under
        all rows.
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
        """Return the jackknife of ``rows`` alone; None: without some set they have no weight."""
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
        """Return the jackknives of ``rows`` alone; None: without some set they have no weight."""
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

    None with a single group, or if nothing would be left without one of the sets. Arguments are
    (row,) weights, the number of each row's group, and masks of the first and the last half of the
    draws if these are compared. ``strata`` have a mass that does not depend on who is left out:
    the stratum of each row (row,), and the share of each group in a stratum (stratum, group).
    """
    # strata may have groups without rows: none of their simulations was completed
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
    """Return the factor on the error of a mean over ``size`` draws whose variance is estimated.

    With it 1.96 errors cover as much as Student's t: 2.2 for three draws or fewer, 1.04 for thirty;
    1 if the size is NaN.
    """
    if math.isnan(size):
        return 1.0
    from scipy.special import stdtrit  # slow to import

    return float(stdtrit(max(size - 1.0, _FEWEST_DEGREES), 0.975)) / 1.96


def over_sets(without: ArrayLike) -> Jackknife | None:
    """Return the jackknife over sets of searches, given (set, row) weights without each.

    Sets are few, so errors are :func:`widened`: with two by less than Student's t, of which 1.96
    errors would be 12.7 spreads. None: a single set.
    """
    weights = np.asarray(without, np.float64)
    n = len(weights)
    return Jackknife(weights, (n - 1) * widened(n) ** 2) if n > 1 else None


def with_unseen(mass: ArrayLike, error: ArrayLike, size: float, n_labels: int = 2) -> FloatArray:
    """Return errors of probabilities that stay above 0 when a few draws all agree.

    The posterior of a probability p after n draws, plus one prior draw divided as b, has the mean
    p' = (n p + b) / (n + 1) and the variance p' (1 - p') / (n + 2). The error is at least its root
    mean squared distance from p, which vanishes as n grows. b is 1/2 (Jeffreys); from
    :data:`FEW_DRAWS` draws on it is one over the number of labels (Perks). Few draws leave anything
    possible; many leave room for one label among many only. ``error`` is the chains' own,
    ``size`` their effective number n of independent draws, NaN: unknown.
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
    """Return the probability that another label than the leader leads in truth; see :class:`Mode`.

    The leader is the first of the most probable labels. ``probabilities`` are (label,), ``results``
    (set, label) without each set. ``size`` is the effective number of independent draws, NaN:
    unknown. ``luck`` (label,) is what one more lucky simulation of each would add to its error.
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
    if not math.isnan(size):  # the true leader may be absent from a few draws
        from scipy.special import betainc

        others = np.delete(probabilities, leading)
        of_leader = size * probabilities[leading] + 0.5
        chances += betainc(of_leader, size * others + 0.5, 0.5).tolist()
    return max(chances)
