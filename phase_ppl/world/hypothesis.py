"""The hypothesis h = <g_i, g_j, alpha_ij, alpha_ji, f_i, f_j> of the paper (Eq. 1)."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name
from phase_ppl.world.goals import (
    GOALS,
    N_GOALS,
    effective_goals,
    goal_index,
    goal_literal,
    is_self_referring,
    opposed_goal,
)
from phase_ppl.world.names import AGENTS, GREEN, RED, Predicate
from phase_ppl.world.picture import preformatted

SCENARIOS: Final = ("collaborative", "independent", "competing", "opposing")
RELATIONS: Final = ("friendly", "neutral", "adversarial")
RELATION_OF_SCENARIO: Final = {
    "collaborative": "friendly",
    "independent": "neutral",
    "competing": "adversarial",
    "opposing": "adversarial",
}


def scenario(goal_red: str | int, goal_green: str | int) -> str:
    """Return the scenario of two effective goals, defined on all 36 x 36 pairs.

    Equal goals, or both to get to each other: collaborative. One negates the other: opposing.
    The same item to two landmarks: competing. Everything else: independent.
    """
    red, green = goal_index(goal_red), goal_index(goal_green)
    literal_red, literal_green = goal_literal(red, RED), goal_literal(green, GREEN)
    both_approach = all(
        literal.predicate is Predicate.TOUCH and literal.positive and literal.target == other
        for literal, other in ((literal_red, GREEN), (literal_green, RED))
    )
    if red == green or both_approach:
        return "collaborative"
    # both ways, since a goal that names its own holder is nobody's to negate
    if red == opposed_goal(green, GREEN) and green == opposed_goal(red, RED):
        return "opposing"
    same_item = literal_red.subject == literal_green.subject >= len(AGENTS)
    if same_item and literal_red.positive and literal_green.positive:
        return "competing"
    return "independent"


def relation(goal_red: str | int, goal_green: str | int) -> str:
    """Return "friendly", "neutral" or "adversarial" for two effective goals."""
    return RELATION_OF_SCENARIO[scenario(goal_red, goal_green)]


SCENARIO_TABLE: Final = np.array(
    [[SCENARIOS.index(scenario(r, g)) for g in range(N_GOALS)] for r in range(N_GOALS)], np.int8
)
"""(goal_red, goal_green) -> index into :data:`SCENARIOS`."""

RELATION_TABLE: Final = np.array(
    [[RELATIONS.index(RELATION_OF_SCENARIO[SCENARIOS[s]]) for s in row] for row in SCENARIO_TABLE],
    np.int8,
)
"""(goal_red, goal_green) -> index into :data:`RELATIONS`."""

ALPHAS: Final = ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1))
"""Values of site ``alpha``: signs of (alpha red -> green, alpha green -> red)."""


ALPHA_WORDS: Final = (
    "neither helps or hinders",
    "red helps green",
    "green helps red",
    "red hinders green",
    "green hinders red",
)
"""The same in words."""


@functools.cache
def effective_table() -> NDArray[np.int32]:
    """Return (goal_red, goal_green, alpha, agent) the effective goals of stated ones."""
    table = np.empty((N_GOALS, N_GOALS, len(ALPHAS), 2), np.int32)
    for red, green, alpha in np.ndindex(table.shape[:-1]):
        table[red, green, alpha] = effective_goals(red, green, ALPHAS[alpha])
    table.setflags(write=False)
    return table


@functools.cache
def effective_pairs() -> NDArray[np.int64]:
    """Return (goal_red, goal_green, alpha) the pair of effective goals, 36 red's + green's."""
    pairs = effective_table() @ np.array([N_GOALS, 1])
    pairs.setflags(write=False)
    return pairs


STRENGTH_LEVELS: Final = (150.0, 300.0, 450.0, 600.0)
"""Maximum forces of the original world, newtons (strength ids 0..3)."""

STRENGTH_RANGE: Final = (150.0, 600.0)
"""Support of a strength, newtons."""

MOST_STRENGTH: Final = 1e6
"""Newtons, beyond which a body of some kilograms moves further in a step than the arena is wide."""


def checked_strength(name: str, value: object) -> float:
    """Return ``value`` as a force in newtons.

    Raises:
        InvalidSettingError: no positive finite number; the message begins with ``name``.
    """
    try:
        force = math.nan if isinstance(value, (str, bool)) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        force = math.nan
    if not 0 < force <= MOST_STRENGTH:
        raise InvalidSettingError(
            f"{name}={shown(value)} is no positive force in newtons, of {MOST_STRENGTH:g} at most"
        )
    return force


@dataclasses.dataclass(frozen=True, repr=False)
class Hypothesis:
    """What the two agents want, how they stand to each other, and how strong they are.

    Attributes:
        goal_red: stated goal of the red agent, index into ``GOALS`` (a goal string is accepted).
        goal_green: stated goal of the green agent, likewise.
        alpha: signs of (alpha red -> green, alpha green -> red), one of ``ALPHAS``.
        strength_red: maximum force of the red agent, newtons.
        strength_green: maximum force of the green agent, newtons.

    Raises:
        UnknownNameError: a goal is unknown.
        InvalidSettingError: alpha or a strength is not allowed, or an agent is to get to itself.
    """

    goal_red: int
    goal_green: int
    alpha: tuple[int, int] = (0, 0)
    strength_red: float = 450.0
    strength_green: float = 450.0

    def __post_init__(self) -> None:
        for holder, name in ((RED, "goal_red"), (GREEN, "goal_green")):
            index = goal_index(getattr(self, name))
            if is_self_referring(index, holder):
                raise InvalidSettingError(
                    f"{name}={GOALS[index]!r} names its own holder, the {AGENTS[holder]}"
                )
            object.__setattr__(self, name, index)
        alpha = next((a for a in ALPHAS if np.array_equal(self.alpha, a)), None)
        if alpha is None:
            raise InvalidSettingError(f"alpha={shown(self.alpha)} is none of {list(ALPHAS)}")
        object.__setattr__(self, "alpha", alpha)
        for name in ("strength_red", "strength_green"):
            object.__setattr__(self, name, checked_strength(name, getattr(self, name)))

    @property
    def effective_goals(self) -> tuple[int, int]:
        """Effective goals of (red, green), indices into ``GOALS``."""
        return effective_goals(self.goal_red, self.goal_green, self.alpha)

    def effective(self) -> Hypothesis:
        """Return the same hypothesis with effective goals as stated ones and alpha = (0, 0)."""
        red, green = self.effective_goals
        return dataclasses.replace(self, goal_red=red, goal_green=green, alpha=(0, 0))

    @property
    def strengths(self) -> tuple[float, float]:
        return self.strength_red, self.strength_green

    @property
    def relation(self) -> str:
        return relation(*self.effective_goals)

    @property
    def scenario(self) -> str:
        return scenario(*self.effective_goals)

    def to_dict(self) -> dict[str, Any]:
        """Return the plain form: goal strings, alpha, strengths in newtons."""
        return {
            "goal_red": GOALS[self.goal_red],
            "goal_green": GOALS[self.goal_green],
            "alpha": list(self.alpha),
            "strength_red": self.strength_red,
            "strength_green": self.strength_green,
        }

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Hypothesis:
        """Return the hypothesis written by :meth:`to_dict`.

        Raises:
            UnknownNameError: a field that a hypothesis does not have.
            InvalidSettingError: a goal is missing.
        """
        names = [field.name for field in dataclasses.fields(cls)]
        for name in record:
            if name not in names:
                raise unknown_name("field of a hypothesis", name, names)
        for name in ("goal_red", "goal_green"):
            if name not in record:
                raise InvalidSettingError(f"a hypothesis needs {name}")
        return cls(**{**record, "alpha": tuple(record.get("alpha", (0, 0)))})

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value!r}" for name, value in self.to_dict().items())
        return f"Hypothesis({values})"

    def _repr_html_(self) -> str:
        return preformatted(self)

    def __str__(self) -> str:
        red, green = self.effective_goals
        return (
            f"red: {GOALS[red]} ({self.strength_red:.0f} N), "
            f"green: {GOALS[green]} ({self.strength_green:.0f} N), {self.relation}"
        )
