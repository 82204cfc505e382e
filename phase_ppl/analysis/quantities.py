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

In other worlds than PHASE, with the agents' ``world.keys``: ``goal_<agent>``, the effective goal;
``relation_<one>_<other>`` of two agents, in order; ``alpha_<who>_<whom>``; ``strength_<agent>``,
newtons.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any, Final, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.tree import array
from phase_ppl.world.errors import InvalidSettingError, unknown_name
from phase_ppl.world.goals import GOALS, N_GOALS, goal_literal
from phase_ppl.world.hypothesis import (
    ALPHAS,
    RELATION_OF_SCENARIO,
    RELATIONS,
    SCENARIO_TABLE,
    SCENARIOS,
)
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS, PredicateKind
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import ALPHA_SITE, HypothesisSpace, space_of

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
            several = isinstance(wanted, list | set | frozenset) or (
                isinstance(wanted, tuple) and all(isinstance(w, str | tuple) for w in wanted)
            )
            options = cast("list[Any]", wanted) if several else [wanted]
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


def relations_of(world: World) -> dict[str, str]:
    """Return the quantities of relations, by title: two agents' keys, if their names have these."""
    keys, names = world.keys, space_of(world).relation_names
    return {
        name if name == "relation" else f"{keys[one]} & {keys[other]}": name
        for name, (one, other) in names.items()
    }


def titles(goals: Mapping[str, str], relations: Mapping[str, str]) -> dict[str, str]:
    """Return quantity -> title of what shows it, from agent and label of a relation -> quantity."""
    found = {name: f"Goal of the {agent}" for agent, name in goals.items()}
    for label, name in relations.items():
        found[name] = "Relation" if label == name else f"Relation of {label}"
    return found


def users_quantity(
    tree: xr.DataTree, name: str, values: NDArray[Any]
) -> tuple[Quantity, NDArray[Any]]:
    """Return a user's own site as a quantity, and its column as codes or numbers.

    What is not real is a category: its labels are all values that occur.
    """
    variable = tree["posterior"].dataset[name]
    if variable.dtype.kind == "f":
        return Quantity(name), values
    occurring = np.unique(np.append(variable.values, array(tree, "simulations", name)))
    options = tuple(occurring.tolist())
    return Quantity(name, tuple(map(str, options)), options), np.searchsorted(occurring, values)


def _part_codes(goal: int, holder: int) -> tuple[int, ...]:
    """Return the codes of the parts of a goal that the agent ``holder`` has."""
    literal = goal_literal(goal, holder)
    sign = 0 if literal.positive else 1
    if literal.predicate is PredicateKind.TOUCH:
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


_RELATION_OF: Final = np.array([RELATIONS.index(RELATION_OF_SCENARIO[name]) for name in SCENARIOS])


class Vocabulary:
    """What one can ask posteriors of a world for, and how it follows from a hypothesis.

    In PHASE a pair of goals has a scenario, and each goal has parts.

    Attributes:
        space: of the world.
        quantities: all of them, by name.
    """

    def __init__(self, space: HypothesisSpace) -> None:
        self.space, self._in_phase = space, bool(space.scenario_names)
        found = [
            *(Quantity(name, space.world.goals) for name in space.goal_sites),
            *(Quantity(name, RELATIONS) for name in space.relation_names),
            *(Quantity(name, SIGNS, (-1, 0, 1)) for name in space.alpha_names),
        ]
        if self._in_phase:
            found += [Quantity("scenario", SCENARIOS), Quantity("alpha", ALPHA_LABELS, ALPHAS)]
        found += map(Quantity, space.strength_sites)
        if self._in_phase:
            found += [Quantity(name, GOALS) for name in space.stated_sites]
            each = itertools.product(space.world.keys, GOAL_PARTS.items())
            found += [Quantity(f"{part}_{key}", labels) for key, (part, labels) in each]
        self.quantities = {quantity.name: quantity for quantity in found}

    def relation_codes(self, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[np.int64]]:
        """Return relations, and in PHASE the scenario, of effective goals, columns (row,)."""
        goals = [np.asarray(columns[name]) for name in self.space.goal_sites]
        if not self._in_phase:
            return self.space.relation_codes(np.stack(goals, axis=-1))
        codes = SCENARIO_TABLE[goals[0], goals[1]].astype(np.int64)
        return {"relation": _RELATION_OF[codes], "scenario": codes}

    def completed(self, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return columns of a file, (row,), with all that follows from them.

        Beside PHASE without stated goals, which of those who help or hinder mean nothing.
        """
        if self._in_phase:
            parts = part_codes(*(columns[name] for name in self.space.goal_sites))
            return {**columns, **self.relation_codes(columns), **parts}
        users = {k: v for k, v in columns.items() if k not in self.space.columns}
        sites = (*self.space.goal_sites, *self.space.strength_sites)
        kept = {name: columns[name] for name in sites if name in columns}
        alphas = self.space.alpha_codes(columns[ALPHA_SITE])
        return {**kept, **self.relation_codes(columns), **alphas, **users}
