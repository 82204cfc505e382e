"""The quantities one can ask a posterior for, by name, and their labels.

Of a hypothesis: ``goal_red``, ``goal_green`` (effective goals), ``relation``, ``scenario``,
``alpha``, ``strength_red``, ``strength_green``, ``stated_goal_red``, ``stated_goal_green``. Of
each effective goal, here that of red:

``goal_kind_red``
    "item-landmark": an item to or from a landmark (LMO in the paper's data); "self-landmark" and
    "other-landmark": the agent itself or the other agent to or from a landmark (LMA);
    "self-other": the agent itself to or from the other agent (TE).
``target_red``
    The entity that the goal is about: the one to be at a landmark or not, or the agent to get to
    or away from.
``landmark_red``
    The landmark, or "none".
``sign_red``
    "to" or "away from".
"""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Callable, Mapping
from typing import Any, Final, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.tree import array
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, unknown_name
from phase_ppl.world.goals import GOALS, N_GOALS, goal_literal
from phase_ppl.world.hypothesis import (
    ALPHAS,
    RELATION_OF_SCENARIO,
    RELATIONS,
    SCENARIO_TABLE,
    SCENARIOS,
)
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS, Predicate
from phase_ppl.world.scene import PHASE, World

ScenarioFunction = Callable[[str, str], str]
"""(effective goal of red, of green) -> one of ``SCENARIOS``."""

SIGNS: Final = ("-1", "0", "1")
"""Labels of ``alpha_<who>_<whom>`` beside PHASE: hinders, neither, helps."""

ALPHA_LABELS: Final = tuple(str(alpha) for alpha in ALPHAS)
"""Labels of ``alpha``: signs of (alpha red -> green, alpha green -> red), as "(1, 0)"."""

GOAL_PARTS: Final[Mapping[str, tuple[str, ...]]] = {
    "goal_kind": ("item-landmark", "self-landmark", "other-landmark", "self-other"),
    "target": ENTITIES,
    "landmark": (*LANDMARKS, "none"),
    "sign": ("to", "away from"),
}
"""What a goal consists of -> its labels."""


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A column of the table of hypotheses.

    Its labels are the values it can take, in order of their codes, None for a real number; its
    values are what labels stand for, such as the pair (1, 0), None: the labels themselves.
    """

    name: str
    labels: tuple[str, ...] | None = None
    values: tuple[Any, ...] | None = None

    def value(self, entry: Any) -> Any:
        """Return what the code or number ``entry`` stands for."""
        if self.labels is None:
            return float(entry)
        return (self.values or self.labels)[int(entry)]

    @property
    def numeric(self) -> bool:
        """Whether it has means and intervals: numbers and truth values do."""
        return self.labels is None or (
            self.values is not None and all(isinstance(value, int | float) for value in self.values)
        )

    def numbers(self, entries: NDArray[Any]) -> NDArray[np.float64]:
        """Return the numbers that codes or numbers stand for."""
        if not self.numeric:
            raise InvalidSettingError(
                f"{self.name} has categories, not numbers; ask for its marginal, mode or top"
            )
        if self.values is not None:
            return np.array(self.values, np.float64)[entries]
        return np.asarray(entries, np.float64)

    def code(self, value: object) -> int:
        """Return the code of the label ``value`` (case and spacing do not matter)."""
        labels = self.categories()
        if isinstance(value, str) and value in labels:  # a user's may differ in case only
            return labels.index(value)
        wanted = _canonical(value)
        for code, label in enumerate(labels):
            if _canonical(label) == wanted:
                return code
        raise unknown_name(self.name, value, labels)

    def categories(self) -> tuple[str, ...]:
        """Return the labels."""
        if self.labels is None:
            raise InvalidSettingError(
                f"{self.name} is a real number without categories; ask for its mean or hdi, "
                f"or for the probability of an interval: probability({self.name}=(low, high))"
            )
        return self.labels

    def satisfied(self, values: NDArray[Any], wanted: object) -> NDArray[np.bool_]:
        """Return which codes or numbers are ``wanted``: a label, some labels, or (low, high)."""
        if self.labels is not None and not (self.numeric and isinstance(wanted, tuple)):
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
        numbers = self.numbers(values)
        return (numbers >= low) & (numbers <= high)


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
        **{f"{part}_{agent}": GOAL_PARTS[part] for agent in PHASE.keys for part in GOAL_PARTS},
    }
    found = {name: Quantity(name, values) for name, values in labels.items()}
    found["alpha"] = dataclasses.replace(found["alpha"], values=ALPHAS)
    return found


def quantities_of(world: World) -> dict[str, Quantity]:
    """Return the quantities of a world's posteriors, by name.

    With the agents' ``world.keys``: ``goal_<agent>``, the effective goal;
    ``relation_<one>_<other>`` of two agents, in order; ``alpha_<who>_<whom>``;
    ``strength_<agent>``, newtons.
    """
    keys = world.keys
    found = {f"goal_{key}": Quantity(f"goal_{key}", world.goals) for key in keys}
    for name in relations_of(world).values():
        found[name] = Quantity(name, RELATIONS)
    for pair in itertools.permutations(keys, 2):
        name = "_".join(("alpha", *pair))
        found[name] = Quantity(name, SIGNS, (-1, 0, 1))
    return found | {f"strength_{key}": Quantity(f"strength_{key}") for key in keys}


def relations_of(world: World) -> dict[str, str]:
    """Return two agents' keys -> the quantity of their relation."""
    pairs = itertools.combinations(world.keys, 2)
    return {f"{one} & {other}": f"relation_{one}_{other}" for one, other in pairs}


def own_quantity(
    tree: xr.DataTree, name: str, values: NDArray[Any]
) -> tuple[Quantity, NDArray[Any]]:
    """Return a user's own site as a quantity, and its column as codes or numbers.

    What is not real is a category: its labels are the attribute ``flag_meanings`` (JSON, by
    code) where the tree has one, otherwise all values that occur.
    """
    variable = tree["posterior"].dataset[name]
    if variable.dtype.kind == "f":
        return Quantity(name), values
    occurring = np.unique(np.append(variable.values, array(tree, "simulations", name)))
    if "flag_meanings" not in variable.attrs:
        labels = tuple(str(value) for value in occurring.tolist())
        own = Quantity(name, labels, tuple(occurring.tolist()))
        return own, np.searchsorted(occurring, values)
    meanings = tuple(str(meaning) for meaning in json.loads(variable.attrs["flag_meanings"]))
    if not np.isin(occurring, np.arange(len(meanings))).all():
        raise InvalidEventError(
            f"{name} takes the values {occurring.tolist()} but has {len(meanings)} labels"
        )
    return Quantity(name, meanings), values


def _part_codes(goal: int, holder: int) -> tuple[int, ...]:
    """Return the codes of the parts of a goal that the agent ``holder`` has."""
    literal = goal_literal(goal, holder)
    sign = 0 if literal.positive else 1
    if literal.predicate is Predicate.TOUCH:
        return 3, literal.target, len(LANDMARKS), sign
    agent = literal.subject < len(AGENTS)
    kind = (1 if literal.subject == holder else 2) if agent else 0
    return kind, literal.subject, literal.target, sign


_PART_TABLES: Final = {
    agent: np.array([_part_codes(goal, holder) for goal in range(N_GOALS)], np.int64)
    for holder, agent in enumerate(PHASE.keys)
}
"""Agent -> (goal, part) codes."""


def part_codes(goal_red: NDArray[Any], goal_green: NDArray[Any]) -> dict[str, NDArray[np.int64]]:
    """Return the codes of ``goal_kind_red`` to ``sign_green`` of effective goals, arrays (row,)."""
    return {
        f"{part}_{agent}": _PART_TABLES[agent][goals, column]
        for agent, goals in zip(PHASE.keys, (goal_red, goal_green), strict=True)
        for column, part in enumerate(GOAL_PARTS)
    }


def relation_codes(
    goal_red: NDArray[Any], goal_green: NDArray[Any], scenario: ScenarioFunction | None = None
) -> dict[str, NDArray[np.int64]]:
    """Return the codes of ``relation`` and ``scenario`` of pairs of effective goals.

    ``scenario`` replaces the paper's scenario of two goals; the relation follows from it.
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


def derived_codes(
    goal_red: NDArray[Any], goal_green: NDArray[Any], scenario: ScenarioFunction | None = None
) -> dict[str, NDArray[np.int64]]:
    """Return the codes of all that follows from pairs of effective goals, arrays (row,)."""
    return relation_codes(goal_red, goal_green, scenario) | part_codes(goal_red, goal_green)


def by_label(
    time: NDArray[np.float64],
    codes: Mapping[str, NDArray[np.int64]],
    masses: Callable[[NDArray[np.bool_]], FloatArray],
    known: Mapping[str, Quantity],
) -> xr.Dataset:
    """Return probabilities (time, label) of each of the quantities that have codes.

    ``codes`` are (row,) of the hypotheses; ``masses`` makes of (row, label), which of them have a
    label, (time, label) what these weigh.
    """
    result = xr.Dataset(coords={"time": ("time", time, {"units": "s"})})
    for name in codes:
        labels = list(known[name].categories())
        indicators = codes[name][:, None] == np.arange(len(labels))
        result[name] = (("time", f"{name}_is"), masses(indicators))
        result = result.assign_coords({f"{name}_is": labels})
    return result
