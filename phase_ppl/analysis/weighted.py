"""Rows of hypotheses with weights: names, conditions, and how far answers differ by chance."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis import statistics
from phase_ppl.analysis.estimate import Estimate, Jackknife, leaving_out, with_unseen
from phase_ppl.analysis.quantities import Quantity
from phase_ppl.analysis.weights import Rows
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, unknown_name

_LISTED: Final = 5
"""Labels that a message names at most, the most probable first."""


class WeightedRows:
    """Rows of hypotheses with weights, and what every question about them needs.

    Args:
        quantities: by name.
        rows: the table; its values are codes or numbers of every quantity.
        groups: (row,) of which group of chains each row is, 0 and up; None: nothing was drawn in
            chains.
        halves: masks (row,) of the first and the last half of the draws, if these are to agree.
    """

    def __init__(
        self,
        quantities: Mapping[str, Quantity],
        rows: Rows,
        groups: NDArray[np.int64] | None = None,
        halves: Sequence[NDArray[np.bool_]] = (),
    ) -> None:
        self._quantities = dict(quantities)
        self._rows = rows
        self._groups = groups
        self._halves = tuple(halves)
        self._jackknives: dict[float, Jackknife | None] = {}
        self._own: set[str] = set()  # quantities that the user defined

    def _quantity(self, name: str) -> Quantity:
        if name not in self._quantities:
            raise unknown_name("quantity", name, self._quantities)
        return self._quantities[name]

    def _distinct(self, names: tuple[str, ...]) -> tuple[str, ...]:
        if not names:
            raise InvalidSettingError("name a quantity, as in joint('goal_red', 'goal_green')")
        for place, name in enumerate(names):
            if name in names[:place]:
                raise InvalidSettingError(f"{name!r} is named twice: expected different quantities")
        return names

    def _numbers(self, name: str) -> FloatArray:
        return self._quantity(name).numbers(self._rows.values[name])

    def _satisfied(self, conditions: Mapping[str, Any]) -> NDArray[np.bool_]:
        result = np.ones(len(self._rows.weights), bool)
        for name, wanted in conditions.items():
            result &= self._quantity(name).satisfied(self._rows.values[name], wanted)
        return result

    def why_impossible(self, given: Mapping[str, Any]) -> str:
        """Return why nothing can be conditioned on ``given``, and what could be instead.

        Args:
            given: quantity -> value, together of probability 0.
        """
        why = "it has probability 0 in this posterior"
        for name, wanted in given.items():
            quantity, values = self._quantity(name), self._rows.values[name]
            if self._rows.weights[quantity.satisfied(values, wanted)].sum() > 0:
                continue
            has_mass = values[self._rows.weights > 0]
            if quantity.labels is None:
                return f"{why}, where {name} is between {has_mass.min():g} and {has_mass.max():g}"
            mass = np.bincount(values, self._rows.weights, len(quantity.labels))
            likely = np.argsort(-mass, kind="stable")[: np.count_nonzero(mass)]
            listed = ", ".join(repr(quantity.labels[code]) for code in likely[:_LISTED])
            more = len(likely) - _LISTED
            return f"{why}, where {name} is {listed}" + (f" and {more} more" if more > 0 else "")
        return f"{why}, though each of these alone has more"

    def _jackknife(self, share: float) -> Jackknife | None:
        """Return one that leaves out random sets with a share of the chains, or single ones."""
        if share not in self._jackknives:
            self._jackknives[share] = (
                None
                if self._groups is None
                else leaving_out(self._rows.weights, self._groups, self._halves, share)
            )
        return self._jackknives[share]

    @functools.cached_property
    def _effective_size(self) -> float:
        """The number of independent draws that would be as sure of both goals; NaN if unknown.

        The least over the goals of sum p (1 - p) / sum of squared errors; as many as there are
        chains, where all of these say the same. No more than the weights are worth (Kish), unless
        there are more chains: that leaving out any of these changes nothing proves no more.
        """
        without = self._jackknife(0.0)
        if without is None or self._groups is None:
            return math.nan
        sizes = []
        for name in ("goal_red", "goal_green"):
            codes = self._rows.values[name]
            mass = statistics.shares(codes, self._rows.weights)
            error = without.error(statistics.shares(codes, without.weights), mass)
            spread, variance = float((error**2).sum()), float((mass * (1 - mass)).sum())
            if spread > 0 and variance > statistics.ROUNDING:
                sizes.append(variance / spread)
        chains = float(len(np.unique(self._rows.index["chain"])))
        worth = float(1 / (self._rows.weights**2).sum())
        return min(min(sizes, default=chains), max(chains, worth))

    def _error_of_share(
        self, mass: FloatArray | float, error: FloatArray, given: float = 1.0
    ) -> FloatArray:
        """Return errors of probabilities that allow for what so few draws need not have shown.

        Args:
            mass: the probabilities.
            error: by which they differ between chains.
            given: probability of what they are conditioned on.
        """
        return with_unseen(mass, error, self._effective_size * given)

    def _weighed(
        self, given: Mapping[str, Any] | None, share: float = 0.0
    ) -> tuple[NDArray[np.bool_], FloatArray, Jackknife | None]:
        """Return which rows fulfil ``given``, and of these the weights, sum 1.

        Third, those without sets with a ``share`` of the chains; None where unknown.
        """
        rows = self._satisfied(given or {})
        weights = self._rows.weights[rows]
        total = weights.sum()
        if not total > 0:
            raise InvalidSettingError(
                f"cannot condition on {dict(given or {})}: {self.why_impossible(given or {})}"
            )
        without = self._jackknife(share)
        return rows, weights / total, None if without is None else without.only(rows)

    def _number(
        self,
        statistic: Callable[[NDArray[Any], FloatArray], FloatArray],
        values: NDArray[Any],
        given: Mapping[str, Any] | None,
    ) -> Estimate:
        """Return ``statistic`` of values (row,) and weights (..., row), with its error."""
        rows, weights, without = self._weighed(given)
        values = values[rows]
        number = float(statistic(values, weights))
        if without is None:
            return Estimate(number)
        error = without.error(statistic(values, without.weights), number)
        if statistic is statistics.share:
            error = self._error_of_share(number, error, float(self._rows.weights[rows].sum()))
        elif statistic is statistics.mean:
            # a few draws that agree by chance do not make it sure
            size = self._effective_size * float(self._rows.weights[rows].sum())
            error = np.fmax(error, float(statistics.sd(values, weights)) / math.sqrt(size + 1))
        return Estimate(number, float(error))
