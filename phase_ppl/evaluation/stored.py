"""Whether metrics that were read from a file have the form in which they were written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from phase_ppl.evaluation.tables import KINDS
from phase_ppl.world.errors import InvalidEventError, shown

_ACCURACIES: Final = tuple(f"{kind}_accuracy" for kind in KINDS)
_FIGURES: Final = (*_ACCURACIES, "goal_top3_accuracy")
_NO_FIGURE: Final = "split_half_by"
_PARTS: Final = ("value", "ci_low", "ci_high")
_COSTS: Final = ("workers", "wall_seconds")


def check_metrics(record: Mapping[str, Any]) -> None:
    """Raise InvalidEventError unless all that is shown of metrics is there as it should be.

    Figures are null or have a value and the ends of its interval, which may be null; what is
    absent is as good as null. The message names the field.
    """
    _check_model(record, "")
    for name in _object(record, "reference_models", ""):
        where = "reference_models."
        _check_model(_object(record["reference_models"], name, where), f"{where}{name}.")
    cost = _object(record, "cost", "")
    for name in _COSTS:
        _number(cost, name, "cost.")


def _check_model(record: Mapping[str, Any], where: str) -> None:
    for name in _FIGURES:
        _figure(record, name, where)
    for scenario in _object(record, "by_scenario", where):
        inner = f"{where}by_scenario."
        found = _object(record["by_scenario"], scenario, inner)
        for name in _ACCURACIES:
            _figure(found, name, f"{inner}{scenario}.")
    human = _object(record, "human", where)
    for name in human:
        if name != _NO_FIGURE:
            _figure(human, name, f"{where}human.")


def _figure(record: Mapping[str, Any], name: str, where: str) -> None:
    figure = _object(record, name, where)
    for part in _PARTS if figure else ():
        if part not in figure:
            raise InvalidEventError(f"{where}{name} has no {part}")
        _number(figure, part, f"{where}{name}.")


def _object(record: Mapping[str, Any], name: str, where: str) -> Mapping[str, Any]:
    found = record.get(name)
    if found is None:
        return {}
    if not isinstance(found, Mapping):
        raise InvalidEventError(f"{where}{name} is {shown(found)}, expected an object or null")
    return found


def _number(record: Mapping[str, Any], name: str, where: str) -> None:
    found = record.get(name)
    if isinstance(found, bool) or not isinstance(found, int | float | None):
        raise InvalidEventError(f"{where}{name} is {shown(found)}, expected a number or null")
