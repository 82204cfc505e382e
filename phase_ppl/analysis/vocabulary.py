"""What one can ask a sampled posterior for, in any world, and how it follows from a hypothesis."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.hypotheses import GOALS_OF, STRENGTHS_OF
from phase_ppl.analysis.quantities import (
    Quantity,
    ScenarioFunction,
    derived_codes,
    quantities,
    quantities_of,
    relation_codes,
    relations_of,
)
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.space import HypothesisSpace

Codes = dict[str, NDArray[np.int64]]


class Vocabulary(NamedTuple):
    """The quantities of a world's posteriors; :func:`vocabulary` makes it."""

    space: HypothesisSpace
    quantities: dict[str, Quantity]  # all, by name
    # what summaries tell of: in words -> quantity
    goals: Mapping[str, str]
    relations: Mapping[str, str]
    scenarios: Mapping[str, str]
    strengths: Mapping[str, str]
    scenario: ScenarioFunction | None  # in place of the paper's

    @property
    def followed(self) -> tuple[str, ...]:
        """Quantities with categories that summaries tell of."""
        return (*self.goals.values(), *self.relations.values(), *self.scenarios.values())

    def relation_codes(self, columns: Mapping[str, NDArray[Any]]) -> Codes:
        """Return relations, and in PHASE the scenario, of effective goals, columns (row,)."""
        goals = [np.asarray(columns[name]) for name in self.space.goal_sites]
        if self.space.is_phase:
            return relation_codes(goals[0], goals[1], self.scenario)
        return self.space.relation_codes(np.stack(goals, axis=-1))

    def completed(self, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return columns of a file, (row,), with all that follows from them.

        Beside PHASE without stated goals, which of those who help or hinder mean nothing.
        """
        if self.space.is_phase:
            derived = derived_codes(columns["goal_red"], columns["goal_green"], self.scenario)
            return {**columns, **derived}
        own = {k: v for k, v in columns.items() if k not in self.space.columns}
        sites = (*self.space.goal_sites, *self.space.strength_sites)
        kept = {name: columns[name] for name in sites if name in columns}
        alphas = self.space.alpha_codes(columns[self.space.company_site])
        return {**kept, **self.relation_codes(columns), **alphas, **own}


def vocabulary(space: HypothesisSpace, scenario: ScenarioFunction | None = None) -> Vocabulary:
    """Return the quantities of posteriors over the hypotheses of a world.

    Args:
        space: of the world.
        scenario: replaces the paper's of two effective goals, in PHASE.

    Raises:
        InvalidSettingError: a scenario for another world.
    """
    if scenario is not None and not space.is_phase:
        raise InvalidSettingError(
            f"scenario replaces that of the world PHASE; {space.world.name!r} has relations only"
        )
    found = _vocabulary(space)
    return found._replace(quantities=dict(found.quantities), scenario=scenario)


@functools.lru_cache(16)
def _vocabulary(space: HypothesisSpace) -> Vocabulary:
    if space.is_phase:
        alone = {"relation": "relation"}, {"scenario": "scenario"}
        return Vocabulary(space, quantities(), GOALS_OF, *alone, STRENGTHS_OF, None)
    agents = space.world.agents
    return Vocabulary(
        space,
        quantities_of(space.world),
        dict(zip(agents, space.goal_sites, strict=True)),
        relations_of(space.world),
        {},
        dict(zip(agents, space.strength_sites, strict=True)),
        None,
    )
