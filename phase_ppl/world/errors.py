"""The exceptions that the package raises on purpose, and the checks of settings that raise them.

Every exception derives from :class:`PhasePPLError`. Exceptions about a value also derive from
``ValueError``, so code that does not know this package still catches them. The command line prints
an exception in one line. An application can call the checks, such as :func:`whole_number`: it then
refuses settings in the same words as the package.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import math
import numbers
import os
from collections.abc import Collection, Iterable, Sequence
from typing import Any, Final

__all__ = [
    "AnswerError",
    "InvalidEventError",
    "InvalidSettingError",
    "OutputError",
    "PhasePPLError",
    "QueryError",
    "SimulationError",
    "UnknownNameError",
    "check_name",
    "instance_of",
    "nonnegative_number",
    "number_or_nan",
    "positive_number",
    "shown",
    "shown_path",
    "unknown_name",
    "whole_number",
]

_SHOWN_CHARACTERS = 80
_PATH_CHARACTERS = 400


class PhasePPLError(Exception):
    """Base of all errors of this package.

    Interruptions, such as ``ComparisonInterrupted``, are ``KeyboardInterrupt``s instead.
    """


class InvalidEventError(PhasePPLError, ValueError):
    """An event, scene, trajectory or input file cannot be used. The message names the bad value."""


class UnknownNameError(PhasePPLError, ValueError):
    """A name is none of the allowed ones. The message lists close matches, if there are any."""


class InvalidSettingError(PhasePPLError, ValueError):
    """A setting has a value that is not allowed. The message says what is expected."""


class QueryError(PhasePPLError, ValueError):
    """A question to a posterior, in words, cannot be read or answered.

    The message has the reason, the question, and a mark below the place where it goes wrong.

    Attributes:
        reason: what is wrong, in one line.
        position: index, in the question, of the character where it goes wrong.
    """

    def __init__(self, reason: str, question: str, position: int) -> None:
        start = max(0, position - _SHOWN_CHARACTERS // 2)
        end = start + _SHOWN_CHARACTERS
        # control characters would move the caret away from the place
        line = "".join(c if c.isprintable() else " " for c in question[start:end])
        before, after = "..." * (start > 0), "..." * (end < len(question))
        caret = " " * (len(before) + position - start) + "^"
        super().__init__(f"{reason}\n  {before}{line}{after}\n  {caret}")
        self.reason = reason
        self.position = position
        self._given = reason, question, position

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._given


class AnswerError(PhasePPLError, RuntimeError):
    """A model or service gave no usable answer. The message says why."""


class OutputError(PhasePPLError, OSError):
    """A result cannot be written to the requested path, or another process is writing there."""


class SimulationError(PhasePPLError, RuntimeError):
    """A simulation failed, or simulations could not be run. The message says which and why.

    Attributes:
        posterior: posterior of the run so far; None if the failure came before the run had one.
    """

    posterior: Any = None


def check_name(what: str, name: object, allowed: Collection[str]) -> None:
    """Raise UnknownNameError unless ``name`` is one of the ``allowed`` names.

    The message calls the name a ``what``, such as "goal", and lists close matches.
    """
    # other objects may compare in their own way, as arrays do
    if not isinstance(name, str) or name not in allowed:
        raise unknown_name(what, name, allowed)


def unknown_name(what: str, name: object, allowed: Iterable[str]) -> UnknownNameError:
    """Return the error for a ``name`` that is none of the ``allowed`` ones.

    Its message calls the name a ``what``. It lists up to four close matches. If none is close, it
    lists all allowed names, or one example of more than 20.
    """
    names = list(allowed)
    text = name if isinstance(name, str) else shown(name)
    wanted = text[:_SHOWN_CHARACTERS].lower()
    containing = [n for n in names if len(wanted) > 1 and wanted in n.lower()]
    by_lower = {candidate.lower(): candidate for candidate in names}
    similar = difflib.get_close_matches(wanted, list(by_lower), n=4, cutoff=0.5)
    parts = sorted(wanted.split("_"))  # of relation_red_green too
    swapped = [n for n in names if sorted(n.lower().split("_")) == parts]
    close = list(dict.fromkeys(swapped + [by_lower[s] for s in similar] + containing))[:4]
    if close:
        hint = "did you mean " + " or ".join(repr(c) for c in close) + "?"
    elif len(names) <= 20:
        hint = "allowed: " + ", ".join(repr(n) for n in names)
    else:
        hint = f"{len(names)} names are allowed, such as {names[0]!r}"
    return UnknownNameError(f"unknown {what} {shown(name)}; {hint}")


def shown(value: object) -> str:
    """Return ``value`` as an error message shows it: its ``repr`` in one line, cut if long."""
    try:
        text = " ".join(repr(value).splitlines())
    except Exception:  # of a number of thousands of digits, or an object of somebody's own
        text = f"<{type(value).__name__}>"
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 3] + "..."


def shown_path(path: str | os.PathLike[str]) -> str:
    """Return a path as an error message shows it: cut if long, unprintable characters escaped."""
    text = os.fspath(path)
    if len(text) > _PATH_CHARACTERS:
        text = f"{text[: _SHOWN_CHARACTERS - 3]}... ({len(text)} characters)"
    return text if text.isprintable() else repr(text)[1:-1]


# --- checks of settings that several parts share --------------------------------------------------

MOST: Final = 2**63 - 1  # of a whole number, what arrays can hold
MOST_WORKERS: Final = 1024


def number_or_nan(value: object) -> float:
    """Return ``value`` as a float; NaN if it is a boolean, no number, or too large for a float."""
    if isinstance(value, numbers.Real) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):  # of a whole number of hundreds of digits
            return float(value)
    return math.nan


def whole_number(name: str, value: object, minimum: int = 1, maximum: int = MOST) -> int:
    """Return ``value`` as an int. NumPy's whole numbers are accepted too.

    Raises:
        InvalidSettingError: the value is no whole number from ``minimum`` to ``maximum``. The
            message calls it ``name``.
    """
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    number = int(value) if whole else minimum - 1  # type: ignore[call-overload]
    if number < minimum:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a whole number >= {minimum}")
    if number > maximum:
        raise InvalidSettingError(f"{name}={shown(value)}, expected at most {maximum}")
    return number


def number_of_threads(value: object, name: str = "threads") -> int:
    """Return the number of threads; None: one per usable core."""
    import loky

    return loky.cpu_count() if value is None else whole_number(name, value, 1, MOST_WORKERS)


def number_of_workers(value: object) -> int:
    """Return how many processes there are to be; None: one per usable core, or as may be."""
    import multiprocessing

    number = number_of_threads(value, "workers")
    if number > 1 and multiprocessing.current_process().daemon:
        if value is None:
            return 1
        raise InvalidSettingError(
            f"workers={number}, but this process is daemonic, as those of multiprocessing.Pool "
            "are, and may start no others; workers=1 needs none"
        )
    return number


def check_memory(what: str, n_bytes: float) -> None:
    """Raise InvalidSettingError if ``what`` would take more memory than there is."""
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if n_bytes > there:
        raise InvalidSettingError(
            f"{what} would take {n_bytes / 1e9:,.0f} GB of memory; this machine has "
            f"{there / 1e9:,.0f}"
        )


def instance_of(name: str, value: object, kind: type | tuple[type, ...], expected: str) -> None:
    """Raise InvalidSettingError ("name=value, expected ...") unless ``value`` is a ``kind``."""
    if not isinstance(value, kind):
        raise InvalidSettingError(f"{name}={shown(value)}, expected {expected}")


def check_fields(
    record: Collection[str], kind: type[Any], what: str, needed: Sequence[str] = ()
) -> None:
    """Raise a PhasePPLError if a record has a field that ``kind`` lacks, or lacks a needed one."""
    for name in record:
        check_name(f"field of {what}", name, [field.name for field in dataclasses.fields(kind)])
    for name in needed:
        if name not in record:
            raise InvalidSettingError(f"{what} needs {name}")


def positive_number(name: str, value: object) -> float:
    """Return the setting ``name`` as a float (InvalidSettingError: no finite number above 0)."""
    number = number_or_nan(value)
    if not 0 < number < math.inf:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a positive number")
    return number


def nonnegative_number(name: str, value: object) -> float:
    """Return the setting ``name`` as a float (InvalidSettingError: no finite number >= 0)."""
    number = number_or_nan(value)
    if not 0 <= number < math.inf:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a number >= 0")
    return number


def __dir__() -> list[str]:
    return __all__
