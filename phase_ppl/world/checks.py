"""Checks of settings that several parts share."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import numbers
import os
from collections.abc import Collection, Sequence
from typing import Any, Final

from phase_ppl.world.errors import InvalidSettingError, check_name, shown

MOST: Final = 2**63 - 1  # of a whole number, what arrays can hold
MOST_WORKERS: Final = 1024


def number_or_nan(value: object) -> float:
    """Return ``value`` as a float; NaN for what is no number, or too large for one."""
    if isinstance(value, numbers.Real) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):  # of a whole number of hundreds of digits
            return float(value)
    return math.nan


def whole_number(name: str, value: object, minimum: int = 1, maximum: int = MOST) -> int:
    """Return ``value`` as an int if it is a whole number, NumPy's too, within its limits."""
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    number = int(value) if whole else minimum - 1  # type: ignore[call-overload]
    if number < minimum:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a whole number >= {minimum}")
    if number > maximum:
        raise InvalidSettingError(f"{name}={shown(value)}, expected at most {maximum}")
    return number


def number_of_workers(value: object, name: str = "workers") -> int:
    """Return how many processes or threads there are to be; None: one per usable core."""
    import loky

    return loky.cpu_count() if value is None else whole_number(name, value, 1, MOST_WORKERS)


def check_memory(what: str, n_bytes: float) -> None:
    """Raise InvalidSettingError if ``what`` is asked for takes more memory than there is."""
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if n_bytes > there:
        raise InvalidSettingError(
            f"{what} would take {n_bytes / 1e9:,.0f} GB of memory; this machine has "
            f"{there / 1e9:,.0f}"
        )


def instance_of(name: str, value: object, kind: type | tuple[type, ...], expected: str) -> None:
    """Raise InvalidSettingError unless ``value`` is of a kind, or of one of some."""
    if not isinstance(value, kind):
        raise InvalidSettingError(f"{name}={shown(value)}, expected {expected}")


def check_fields(
    record: Collection[str], kind: type[Any], what: str, needed: Sequence[str] = ()
) -> None:
    """Raise a PhasePPLError where a plain form has a field that ``kind`` has not, or lacks one."""
    for name in record:
        check_name(f"field of {what}", name, [field.name for field in dataclasses.fields(kind)])
    for name in needed:
        if name not in record:
            raise InvalidSettingError(f"{what} needs {name}")


def positive_number(name: str, value: object) -> float:
    """Return ``value`` as a float."""
    number = number_or_nan(value)
    if not 0 < number < math.inf:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a positive number")
    return number


def nonnegative_number(name: str, value: object) -> float:
    """Return ``value`` as a float."""
    number = number_or_nan(value)
    if not 0 <= number < math.inf:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a number >= 0")
    return number
