"""Results with their Monte-Carlo errors, which are the jackknife's over the chains.

A statistic is computed anew without some of the chains; how much the results differ tells how much
it would differ between runs: error^2 = (n - d) / d * mean squared deviation from their mean, where
sets of d of n chains are left out. These are all single chains (d = 1), but for intervals random
thirds, since ends of intervals jump from draw to draw and single chains would make too much of it.

This holds for any statistic, conditional probabilities too, and it asks only that the chains be
independent of each other, not the draws within one. So an error is

* unknown (NaN) with one chain, or where without one of the sets nothing is left to condition on;
* 0 where all chains say the same, which does not prove that more of them would;
* too small for kernels whose chains exchange states (smc, sa, aies), and too large for
  ``enumerate``, whose chains share out the hypotheses and do not sample them.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phase_ppl.analysis.statistics import ROUNDING

FloatArray = NDArray[np.float64]

N_SETS: Final = 30
"""Random sets of chains that are left out."""

_MOST_DECIMALS: Final = 4


class Estimate(float):
    """A number with its Monte-Carlo error, printed as 0.83 ± 0.04; in all else a plain float.

    Attributes:
        error: standard error; NaN where it is unknown, which prints as ``?``.
    """

    error: float

    def __new__(cls, value: float, error: float = math.nan) -> Estimate:
        self = super().__new__(cls, value)
        self.error = float(error)
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
            of any other, from the Monte-Carlo error of the difference, taken as normal. 0.5 for
            a tie; NaN where it is unknown.
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
    """Weights of rows without sets of groups of chains.

    Attributes:
        weights: (set, row), each set's sum 1.
        factor: (n - d) / d, where sets of d of n groups are left out.
    """

    weights: FloatArray
    factor: float

    def error(self, results: ArrayLike, value: ArrayLike) -> FloatArray:
        """Return the standard error of a statistic.

        Args:
            results: (set, ...) the statistic under each set's weights.
            value: (...) the statistic of all.
        """
        found = np.asarray(results, np.float64)
        error: Any = np.sqrt(self.factor * ((found - found.mean(axis=0)) ** 2).mean(axis=0))
        return np.where(error > ROUNDING * np.abs(np.asarray(value)), error, 0.0)

    def only(self, rows: NDArray[np.bool_]) -> Jackknife | None:
        """Return it for the ``rows`` alone; None where they weigh nothing without a set."""
        weights = self.weights if rows.all() else self.weights[:, rows]
        total = weights.sum(axis=1, keepdims=True)
        return dataclasses.replace(self, weights=weights / total) if (total > 0).all() else None


def sets_to_leave_out(n_groups: int, share: float = 0.0) -> tuple[NDArray[np.bool_], float]:
    """Return (set, group) which groups to leave out, and the factor of :class:`Jackknife`.

    Args:
        n_groups: at least 2.
        share: of the groups that a random set has; every single group where it comes to one.
    """
    size = int(n_groups * share)
    if size < 2:
        return np.eye(n_groups, dtype=bool), n_groups - 1.0
    order = np.random.default_rng(0).random((N_SETS, n_groups)).argsort(axis=1)
    return order < size, (n_groups - size) / size


def doubt(probabilities: FloatArray, without: Jackknife, results: FloatArray) -> float:
    """Return how probable it is that another label than the first of the highest leads in truth.

    See :class:`Mode`.

    Args:
        probabilities: (label,).
        without: sets of chains.
        results: (set, label) the probabilities under each set's weights.
    """
    leading = int(probabilities.argmax())
    lead = np.delete(probabilities[leading] - probabilities, leading)
    error = without.error(np.delete(results[:, [leading]] - results, leading, axis=1), lead)
    chances = [
        _chance_of_less_than_nothing(ahead, spread)
        for ahead, spread in zip(lead.tolist(), error.tolist(), strict=True)
    ]
    return max(chances, default=0.0)


def _chance_of_less_than_nothing(mean: float, sd: float) -> float:
    if sd > 0:
        return 0.5 * math.erfc(mean / (math.sqrt(2) * sd))
    return 0.5 if mean <= ROUNDING else 0.0
