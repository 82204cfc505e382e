"""Quantities of a user's own: by a function of a hypothesis, or by conditions in words."""

from __future__ import annotations

import keyword
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.quantities import Quantity
from phase_ppl.analysis.query import conditions
from phase_ppl.world.arrays import equal_rows
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown, unknown_name
from phase_ppl.world.files import existing_file

Function = Callable[["Named"], bool | int | float | str]  # (hypothesis in plain names) -> its value
Definition = Function | str  # a function, or conditions in words, which hold or do not

RESERVED_QUANTITIES: Final = frozenset(
    ("given", "self", "weight", "chain", "draw", "simulation", "error", "bound", "probability")
)
"""Names that are taken by arguments, columns and coordinates of results."""

_SHOWN: Final = ("goal_red", "goal_green", "alpha", "strength_red", "strength_green")
"""What a message says of a hypothesis."""

_LINE: Final = re.compile(r"\s*(?P<name>\w+)\s*:\s*(?P<text>.+?)\s*")


class Named:
    """A hypothesis as functions of :meth:`Posterior.define` see it: ``h.goal_red`` and so on.

    Its attributes are all quantities of the posterior, those defined before too: labels as
    strings, strengths as floats, ``alpha`` as a pair such as (1, 0). Goals are effective ones.
    """

    __slots__ = ("_columns", "_quantities", "_row")

    def __init__(
        self, quantities: Mapping[str, Quantity], columns: Mapping[str, NDArray[Any]], row: int
    ) -> None:
        self._quantities = quantities
        self._columns = columns
        self._row = row

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name not in self._quantities:
            raise AttributeError(str(unknown_name("quantity", name, self._quantities)))
        return self._quantities[name].value(self._columns[name][self._row])

    def __dir__(self) -> Iterable[str]:
        return sorted(self._quantities)

    def __repr__(self) -> str:
        shown = [name for name in _SHOWN if name in self._quantities] or self._quantities
        return ", ".join(f"{name}={getattr(self, name)!r}" for name in shown)


def check_new_name(name: object, taken: Iterable[str]) -> None:
    """Refuse what cannot be the name of a new quantity."""
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InvalidSettingError(
            f"a quantity cannot be called {shown(name)}: expected a valid Python name, such as "
            "same_goal"
        )
    if name in taken:
        raise InvalidSettingError(f"there is a quantity {name!r} already: choose another name")
    if name in RESERVED_QUANTITIES:
        raise InvalidSettingError(f"{name!r} is a reserved name: choose another")


def defined(
    name: str,
    definition: Definition,
    quantities: Mapping[str, Quantity],
    columns: Mapping[str, NDArray[Any]],
) -> tuple[Quantity, NDArray[Any]]:
    """Return the quantity that a definition makes, and its column as codes or numbers.

    Conditions hold or do not. Of a function truth values, whole numbers and strings are
    categories, in order of their values; numbers that are not all whole are real.
    """
    if isinstance(definition, str):
        holds = conditions(quantities, definition).holds(columns)
        return Quantity(name, ("False", "True"), (False, True)), holds.astype(np.int64)
    if not callable(definition):
        raise InvalidSettingError(
            f"define({name!r}, {shown(definition)}): expected a function of a hypothesis, such as "
            "lambda h: h.goal_red == h.goal_green, or conditions in words, such as "
            "'goal_red = goal_green'"
        )
    number, first = equal_rows([columns[column] for column in quantities])
    views = [Named(quantities, columns, int(row)) for row in first]
    results = [_value(name, definition, view) for view in views]
    kinds = {type(result): view for result, view in zip(results, views, strict=True)}
    if set(kinds) == {int, float}:
        kinds, results = {float: kinds[float]}, [float(result) for result in results]
    if len(kinds) > 1:
        listed = " and ".join(f"{kind.__name__} (for {view!r})" for kind, view in kinds.items())
        raise InvalidSettingError(f"{name} has values of several kinds: {listed}")
    if float in kinds:
        return Quantity(name), np.array(results, np.float64)[number]
    values: list[Any] = [False, True] if bool in kinds else sorted(set(results))
    code = {value: index for index, value in enumerate(values)}
    quantity = Quantity(name, tuple(map(str, values)), tuple(values))
    return quantity, np.array([code[result] for result in results], np.int64)[number]


def _value(name: str, function: Function, view: Named) -> bool | int | float | str:
    try:
        found = function(view)
    except Exception as error:  # whatever a user's function does
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InvalidSettingError(f"{name} failed for {view!r}: {reason}") from error
    if isinstance(found, np.generic):
        found = found.item()
    for kind in (bool, int, float, str):  # a bool is an int too
        if isinstance(found, kind):
            if isinstance(found, float) and not math.isfinite(found):
                raise InvalidSettingError(f"{name} is {found} for {view!r}: expected a number")
            return kind(found)
    raise InvalidSettingError(
        f"{name} is {shown(found)} for {view!r}: expected a truth value, a number or a string"
    )


def read_definitions(path: str | os.PathLike[str]) -> dict[str, str]:
    """Return the definitions of a text file, see ``define_from``: name -> conditions in words."""
    source = existing_file(path)
    try:
        lines = source.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise InvalidEventError(f"{source} is no text: {error}") from None
    found: dict[str, str] = {}
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            raise InvalidEventError(
                f"{source}, line {number}: {shown(line)} is no definition; expected a name, a "
                "colon and conditions, as in same_goal: goal_red = goal_green"
            )
        if match["name"] in found:
            raise InvalidEventError(f"{source}, line {number}: {match['name']} is defined twice")
        found[match["name"]] = match["text"]
    return found
