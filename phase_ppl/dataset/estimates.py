"""Numbers about a set of events, with their standard errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.world.arrays import FloatArray

_RESAMPLINGS: Final = 200


class Estimates:
    """Numbers about a set, with their standard errors.

    Args:
        units: per event the unit that it belongs to; units are what is resampled.

    Attributes:
        found: name -> ``value``, ``se`` (None where there is none), ``units``.
    """

    def __init__(self, units: Sequence[str]) -> None:
        self._units = list(units)
        self.found: dict[str, dict[str, Any]] = {}

    def add(
        self,
        name: str,
        per_event: Sequence[Any],
        function: Callable[[FloatArray], Any] = np.mean,
        *,
        extreme: bool = False,
    ) -> None:
        """Add a function of all numbers, of which each event has some or none.

        Args:
            name: of the result.
            per_event: a sequence of numbers for every event.
            function: of all of them together.
            extreme: whether it is a least or greatest value, whose error no resampling tells.
        """
        grouped: dict[str, list[FloatArray]] = {}
        for unit, numbers in zip(self._units, per_event, strict=True):
            if len(numbers):
                grouped.setdefault(unit, []).append(np.asarray(numbers, np.float64))
        if not grouped:
            return
        parts = [np.concatenate(arrays) for arrays in grouped.values()]
        self.found[name] = {
            "value": float(function(np.concatenate(parts))),
            "se": None if extreme else standard_error(parts, function),
            "units": len(parts),
        }


def standard_error(
    parts: Sequence[FloatArray], function: Callable[[FloatArray], Any]
) -> float | None:
    """Return the bootstrap's standard error of a function of all parts together.

    None for a single part.
    """
    n = len(parts)
    if n < 2:
        return None
    rng = np.random.default_rng(0)
    again = [
        float(function(np.concatenate([parts[i] for i in rng.integers(n, size=n)])))
        for _ in range(_RESAMPLINGS)
    ]
    return float(np.std(again, ddof=1))


def percentile_99(values: FloatArray) -> float:
    """Return the number that one in a hundred exceeds."""
    return float(np.percentile(values, 99))
