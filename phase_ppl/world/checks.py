"""Checks of settings that several parts share."""

from __future__ import annotations

import contextlib
import math
import numbers

from phase_ppl.world.errors import InvalidSettingError, shown


def number_or_nan(value: object) -> float:
    """Return ``value`` as a float; NaN for what is no number, or too large for one."""
    if isinstance(value, numbers.Real) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):  # of a whole number of hundreds of digits
            return float(value)
    return math.nan


def whole_number(name: str, value: object, minimum: int = 1) -> int:
    """Return ``value`` as an int if it is a whole number, NumPy's too, of at least ``minimum``.

    Raises:
        InvalidSettingError: it is not.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < minimum:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a whole number >= {minimum}")
    return int(value)


def positive_number(name: str, value: object) -> float:
    """Return ``value`` as a float.

    Raises:
        InvalidSettingError: it is no positive finite number; the message begins with ``name``.
    """
    number = number_or_nan(value)
    if not 0 < number < math.inf:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a positive number")
    return number


def nonnegative_number(name: str, value: object) -> float:
    """Return ``value`` as a float.

    Raises:
        InvalidSettingError: it is no finite number from 0; the message begins with ``name``.
    """
    number = number_or_nan(value)
    if not 0 <= number < math.inf:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a number >= 0")
    return number
