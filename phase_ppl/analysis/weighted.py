"""Rows of hypotheses with weights: names, conditions, and weights without some of the chains."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.estimate import Estimate, Jackknife, sets_to_leave_out
from phase_ppl.analysis.quantities import Quantity
from phase_ppl.analysis.weights import Rows
from phase_ppl.world.errors import InvalidSettingError, unknown_name

FloatArray = NDArray[np.float64]

_LISTED: Final = 5
"""Labels that a message names at most, the most probable first."""


class WeightedRows:
    """Rows of hypotheses with weights, and what every question about them needs.

    Args:
        quantities: by name.
        rows: the table; its values are codes or numbers of every quantity.
        n_groups: number of groups of chains.
        without: (set, group) which groups are left out -> (set, row) the weights without them,
            each set's sum 1; NaN where nothing is left.
    """

    def __init__(
        self,
        quantities: Mapping[str, Quantity],
        rows: Rows,
        n_groups: int,
        without: Callable[[NDArray[np.bool_]], FloatArray],
    ) -> None:
        self._quantities = dict(quantities)
        self._rows = rows
        self._n_groups = n_groups
        self._without = without
        self._jackknives: dict[float, Jackknife] = {}
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
        if self._n_groups < 2:
            return None
        if share not in self._jackknives:
            sets, factor = sets_to_leave_out(self._n_groups, share)
            self._jackknives[share] = Jackknife(self._without(sets), factor)
        return self._jackknives[share]

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
        return Estimate(number, float(without.error(statistic(values, without.weights), number)))
