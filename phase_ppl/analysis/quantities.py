"""The quantities one can ask a posterior for, by name, and their labels."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import Any, Final, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.tree import array
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, unknown_name
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import ALPHAS
from phase_ppl.world.relations import (
    RELATION_OF_SCENARIO,
    RELATIONS,
    SCENARIO_TABLE,
    SCENARIOS,
)

ScenarioFunction = Callable[[str, str], str]
"""(effective goal of red, of green) -> one of ``SCENARIOS``."""

ALPHA_LABELS: Final = tuple(str(alpha) for alpha in ALPHAS)
"""Labels of ``alpha``: signs of (alpha red -> green, alpha green -> red), as "(1, 0)"."""


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A column of the table of hypotheses.

    Attributes:
        name: how users call it.
        labels: the values it can take, in order of their codes; None for a real number.
    """

    name: str
    labels: tuple[str, ...] | None = None

    def code(self, value: object) -> int:
        """Return the code of the label ``value`` (case and spacing do not matter).

        Raises:
            UnknownNameError: there is no such label; the message names close matches.
        """
        labels = self.categories()
        wanted = _canonical(value)
        for code, label in enumerate(labels):
            if _canonical(label) == wanted:
                return code
        raise unknown_name(self.name, value, labels)

    def categories(self) -> tuple[str, ...]:
        """Return the labels.

        Raises:
            InvalidSettingError: the quantity is a real number.
        """
        if self.labels is None:
            raise InvalidSettingError(
                f"{self.name} is a real number without categories; ask for its mean or hdi, "
                f"or for the probability of an interval: probability({self.name}=(low, high))"
            )
        return self.labels

    def satisfied(self, values: NDArray[Any], wanted: object) -> NDArray[np.bool_]:
        """Return which rows fulfil ``wanted``.

        Args:
            values: (row,) codes or numbers.
            wanted: a label, or several of which any will do; (low, high) for a real number.
        """
        if self.labels is not None:
            if isinstance(wanted, tuple) and all(isinstance(w, str | tuple) for w in wanted):
                wanted = list(wanted)
            options = wanted if isinstance(wanted, list | set | frozenset) else [wanted]
            return np.isin(values, [self.code(option) for option in options])
        try:
            low, high = (float(bound) for bound in cast("tuple[float, float]", wanted))
        except (TypeError, ValueError):
            raise InvalidSettingError(
                f"{self.name}={wanted!r}: expected an interval (low, high)"
            ) from None
        if not low <= high:
            raise InvalidSettingError(f"{self.name}={wanted!r}: the interval is empty")
        return (values >= low) & (values <= high)


def _canonical(label: object) -> str:
    return "".join(str(label).split()).lower()


def quantities() -> dict[str, Quantity]:
    """Return the quantities that every posterior has, by name."""
    labels: dict[str, tuple[str, ...] | None] = {
        **dict.fromkeys(("goal_red", "goal_green"), GOALS),
        "relation": RELATIONS,
        "scenario": SCENARIOS,
        "alpha": ALPHA_LABELS,
        **dict.fromkeys(("strength_red", "strength_green"), None),
        **dict.fromkeys(("stated_goal_red", "stated_goal_green"), GOALS),
    }
    return {name: Quantity(name, values) for name, values in labels.items()}


def own_quantity(
    tree: xr.DataTree, name: str, values: NDArray[Any]
) -> tuple[Quantity, NDArray[Any]]:
    """Return a user's own site as a quantity, and its column as codes or numbers.

    What is not real is a category: its labels are the attribute ``flag_meanings`` (JSON, by
    code) where the tree has one, otherwise all values that occur.

    Args:
        tree: a tree of draws.
        name: of the site.
        values: (row,) its values in the table of hypotheses.

    Raises:
        InvalidEventError: a value that ``flag_meanings`` has no label for.
    """
    variable = tree["posterior"].dataset[name]
    if variable.dtype.kind == "f":
        return Quantity(name), values
    occurring = np.unique(np.append(variable.values, array(tree, "simulations", name)))
    if "flag_meanings" not in variable.attrs:
        labels = tuple(str(value) for value in occurring.tolist())
        return Quantity(name, labels), np.searchsorted(occurring, values)
    meanings = tuple(str(meaning) for meaning in json.loads(variable.attrs["flag_meanings"]))
    if not np.isin(occurring, np.arange(len(meanings))).all():
        raise InvalidEventError(
            f"{name} takes the values {occurring.tolist()} but has {len(meanings)} labels"
        )
    return Quantity(name, meanings), values


def relation_codes(
    goal_red: NDArray[Any], goal_green: NDArray[Any], scenario: ScenarioFunction | None = None
) -> dict[str, NDArray[np.int64]]:
    """Return the codes of ``relation`` and ``scenario`` of pairs of effective goals.

    Args:
        goal_red, goal_green: (row,) goal codes.
        scenario: replaces the paper's scenario of two goals; the relation follows from it.

    Raises:
        UnknownNameError: ``scenario`` returns something that is no scenario.
    """
    if scenario is None:
        codes = SCENARIO_TABLE[goal_red, goal_green].astype(np.int64)
    else:
        own = Quantity("scenario", SCENARIOS)
        pairs = list(zip(goal_red.tolist(), goal_green.tolist(), strict=True))
        table = {pair: own.code(scenario(GOALS[pair[0]], GOALS[pair[1]])) for pair in set(pairs)}
        codes = np.array([table[pair] for pair in pairs], np.int64)
    relation_of = np.array([RELATIONS.index(RELATION_OF_SCENARIO[name]) for name in SCENARIOS])
    return {"relation": relation_of[codes], "scenario": codes}


def shortest_interval(
    values: NDArray[np.float64], weights: NDArray[np.float64], prob: float
) -> tuple[float, float]:
    """Return the shortest [low, high] between weighted values that holds mass ``prob``."""
    order = np.argsort(values, kind="stable")
    values, cumulative = values[order], np.cumsum(weights[order])
    before = cumulative - weights[order]
    # the tolerance keeps 0.9 of ten equal draws at nine of them
    last = np.searchsorted(cumulative, before + prob * cumulative[-1] - 1e-12)
    holds = last < len(values)
    starts, ends = values[holds], values[last[holds]]
    best = int(np.argmin(ends - starts))
    return float(starts[best]), float(ends[best])
