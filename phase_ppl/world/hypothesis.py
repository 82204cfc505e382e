"""The hypothesis h = <g_i, g_j, alpha_ij, alpha_ji, f_i, f_j> of the paper (Eq. 1)."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.errors import (
    InvalidSettingError,
    UnknownNameError,
    check_fields,
    check_name,
    instance_of,
    shown,
)
from phase_ppl.world.goals import (
    GOALS,
    N_GOALS,
    effective_goal,
    effective_goals,
    goal_index,
    goal_literal,
    is_self_referring,
    shared_goal,
    shared_literal,
)
from phase_ppl.world.names import AGENTS, GREEN, RED
from phase_ppl.world.picture import Printed
from phase_ppl.world.scene import PHASE, World

SCENARIOS: Final = ("collaborative", "independent", "competing", "opposing")
RELATIONS: Final = ("friendly", "neutral", "adversarial")
RELATION_OF_SCENARIO: Final = {
    "collaborative": "friendly",
    "independent": "neutral",
    "competing": "adversarial",
    "opposing": "adversarial",
}


def scenario(
    goal_red: str | int,
    goal_green: str | int,
    world: World = PHASE,
    holders: tuple[int, int] = (RED, GREEN),
) -> str:
    """Return the scenario of two effective goals, in PHASE defined on all 36 x 36 pairs.

    The same is to be true, as with equal goals or both to get to each other: collaborative, but not
    where they avoid each other. One negates the other: opposing.
    The same item to two landmarks: competing. Everything else: independent. In another world the
    goals are those of its agents ``holders``.
    """
    red, green = world.goal_index(goal_red), world.goal_index(goal_green)
    one, other = holders
    literal_red, literal_green = goal_literal(red, one, world), goal_literal(green, other, world)
    # to keep away from each other is nothing that two share
    avoid = not literal_red.positive and {literal_red.subject, literal_red.target} == {one, other}
    if red == green or (literal_red.says(literal_green) and not avoid):
        return "collaborative"
    # both ways, since a goal that names its own holder is nobody's to negate
    if literal_red.says(shared_literal(literal_green, one).negated()) and literal_green.says(
        shared_literal(literal_red, other).negated()
    ):
        return "opposing"
    same_item = literal_red.subject == literal_green.subject >= len(world.agents)
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
    "neither helps nor hinders",
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


STRENGTH: Final = 450.0  # newtons of an agent of which nothing else is said

STRENGTH_LEVELS: Final = (150.0, 300.0, 450.0, 600.0)
"""Maximum forces of the original world, newtons (strength ids 0..3)."""

STRENGTH_RANGE: Final = (150.0, 600.0)  # support of a strength, newtons

MOST_STRENGTH: Final = 1e6
"""Newtons, beyond which a body of some kilograms moves further in a step than the arena is wide."""


def checked_strength(name: str, value: object) -> float:
    """Return ``value`` as a force in newtons."""
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
class Hypothesis(Printed):
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
    strength_red: float = STRENGTH
    strength_green: float = STRENGTH

    if TYPE_CHECKING:  # what fields can be made of

        def __init__(
            self,
            goal_red: str | int,
            goal_green: str | int,
            alpha: Sequence[int] = (0, 0),
            strength_red: float = STRENGTH,
            strength_green: float = STRENGTH,
        ) -> None: ...

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

    world: ClassVar[World] = PHASE

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
        check_fields(record, cls, "a hypothesis", ("goal_red", "goal_green"))
        return cls(**{**record, "alpha": tuple(record.get("alpha", (0, 0)))})

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value!r}" for name, value in self.to_dict().items())
        return f"Hypothesis({values})"

    def __str__(self) -> str:
        red, green = self.effective_goals
        return (
            f"red: {GOALS[red]} ({self.strength_red:.0f} N), "
            f"green: {GOALS[green]} ({self.strength_green:.0f} N), {self.relation}"
        )


STANCES: Final = {"help": 1, "hinder": -1}
"""What an agent may do with another's goal, and the sign of alpha."""

_WORD_OF_SIGN: Final = {sign: word for word, sign in STANCES.items()}

SOCIAL: Final = 1 - 1 / 3
"""Probability that some agent helps or hinders another (paper, Appendix 4B)."""

Towards = tuple[tuple[int, int] | None, ...]
"""(agent,) another agent, and 1 where it is helped, -1 where it is hindered; None: neither."""


@functools.cache
def all_ways(n_agents: int) -> tuple[Towards, ...]:
    """Return all ways in which agents can stand to each other, as :attr:`Roles.towards`.

    Whoever is helped or hindered pursues its own goal. The first is that nobody does either.
    """
    choices = [
        [None, *((other, sign) for other in range(n_agents) if other != agent for sign in (1, -1))]
        for agent in range(n_agents)
    ]
    return tuple(
        ways
        for ways in itertools.product(*choices)
        if all(one is None or ways[one[0]] is None for one in ways)
    )


@dataclasses.dataclass(frozen=True, repr=False)
class Roles:
    """Who wants what in any world, whom each helps or hinders, and how strong all are.

    An agent pursues its own goal, or helps or hinders one other with the other's own.

    Attributes:
        world: whose agents and goals.
        stated: (agent,) own goal of each, an index into ``world.goals``; None of one without.
        towards: (agent,) another agent, and 1 where it is helped, -1 where it is hindered; None.
        strengths: (agent,) maximum forces, newtons.
    """

    world: World
    stated: tuple[int | None, ...]
    towards: Towards
    strengths: tuple[float, ...]

    @classmethod
    def of(
        cls,
        world: World,
        goals: Mapping[str, str | int],
        relation: Mapping[tuple[str, str], str] | None = None,
        strength: Mapping[str, float] | float = STRENGTH,
    ) -> Roles:
        """Return the roles said in names.

        Args:
            world: whose agents and goals.
            goals: name of an agent -> its own goal; of all that neither help nor hinder.
            relation: (who, whom) -> "help" or "hinder".
            strength: newtons by name, or of all.

        Raises:
            UnknownNameError: there is no such agent, goal or relation.
            InvalidSettingError: an agent has no goal, more than one relation, or one to itself or
                to an agent without a goal of its own, or can do nothing for or against that goal
                that is a goal of the world; or a strength is no positive force.
        """
        agents = world.agents
        instance_of("goals", goals, Mapping, "a mapping of agents to goals")
        stated: list[int | None] = [None] * len(agents)
        for name, goal in goals.items():
            agent, index = world.agent(name), world.goal_index(goal)
            if is_self_referring(index, agent, world):
                raise InvalidSettingError(
                    f"the goal {world.goals[index]!r} of the {name} names the {name} itself"
                )
            stated[agent] = index
        towards: list[tuple[int, int] | None] = [None] * len(agents)
        told = {} if relation is None else relation
        instance_of("relation", told, Mapping, "a mapping of (who, whom) to 'help' or 'hinder'")
        for pair, word in told.items():
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise InvalidSettingError(f"relation of {shown(pair)}, expected (who, whom)")
            who, whom = (world.agent(name) for name in pair)
            if who == whom:
                raise InvalidSettingError(f"the {pair[0]} cannot {word} itself")
            check_name("relation", word, STANCES)
            if towards[who] is not None:
                raise InvalidSettingError(f"the {pair[0]} can help or hinder one other only")
            towards[who] = whom, STANCES[word]
        for agent, name in enumerate(agents):
            other = towards[agent]
            if other is None and stated[agent] is None:
                raise InvalidSettingError(f"the {name} has no goal, and helps or hinders nobody")
            if other is None:
                continue
            owner, own = agents[other[0]], stated[other[0]]
            if own is None or towards[other[0]] is not None:
                raise InvalidSettingError(
                    f"the {name} cannot help or hinder the {owner}, who pursues no goal of its own"
                )
            try:
                effective_goal([own] * len(agents), agent, other, world)
            except UnknownNameError:
                raise InvalidSettingError(
                    f"the {name} cannot {_WORD_OF_SIGN[other[1]]} the {owner} with "
                    f"{world.goals[own]!r}: what it would then want is no goal of {world.name!r}"
                ) from None
        forces = (
            dict(strength) if isinstance(strength, Mapping) else dict.fromkeys(agents, strength)
        )
        for name in forces:
            world.agent(name)
        strengths = tuple(
            checked_strength(f"strength of the {name}", forces.get(name, STRENGTH))
            for name in agents
        )
        return cls(world, tuple(stated), tuple(towards), strengths)

    @property
    def effective_goals(self) -> tuple[int, ...]:
        """(agent,) what each acts on, an index into ``world.goals``."""
        stated = [0 if goal is None else goal for goal in self.stated]
        ways = enumerate(self.towards)
        return tuple(effective_goal(stated, agent, way, self.world) for agent, way in ways)

    @property
    def is_possible(self) -> bool:
        """Whether what each would act on is a goal of the world."""
        try:
            return bool(self.effective_goals)
        except UnknownNameError:
            return False

    def of_its_world(self) -> Hypothesis | Roles:
        """Return it in the form that its world has: in PHASE a hypothesis.

        In that whoever helps or hinders would want for itself what it would want as a helper.
        """
        if self.world != PHASE:
            return self
        red, green = (
            own if one is None else shared_goal(self.stated[one[0]] or 0, one[0])
            for own, one in zip(self.stated, self.towards, strict=True)
        )
        to_green, to_red = (0 if one is None else one[1] for one in self.towards)
        return Hypothesis(red or 0, green or 0, (to_green, to_red), *self.strengths)

    def effective(self) -> Roles:
        """Return the same with effective goals as stated ones, and nobody who helps or hinders."""
        nobody = (None,) * len(self.towards)
        return dataclasses.replace(self, stated=self.effective_goals, towards=nobody)

    @property
    def goals(self) -> dict[str, str]:
        """Name of an agent -> its effective goal."""
        found = (self.world.goals[goal] for goal in self.effective_goals)
        return dict(zip(self.world.agents, found, strict=True))

    @property
    def relation(self) -> dict[tuple[str, str], str]:
        """(who, whom) -> "help" or "hinder", of those who do."""
        agents = self.world.agents
        return {
            (agents[who], agents[towards[0]]): _WORD_OF_SIGN[towards[1]]
            for who, towards in enumerate(self.towards)
            if towards is not None
        }

    def relation_between(self, one: str, other: str) -> str:
        """Return "friendly", "neutral" or "adversarial", of the effective goals of two agents."""
        return RELATION_OF_SCENARIO[self.scenario_between(one, other)]

    def scenario_between(self, one: str, other: str) -> str:
        """Return "collaborative", "independent", "competing" or "opposing", likewise."""
        pair = self.world.agent(one), self.world.agent(other)
        goal, other_goal = (self.effective_goals[agent] for agent in pair)
        return scenario(goal, other_goal, self.world, pair)

    def to_dict(self) -> dict[str, Any]:
        """Return the plain form, which :meth:`from_dict` reads."""
        agents = self.world.agents
        own = zip(agents, self.stated, strict=True)
        return {
            "goals": {name: self.world.goals[goal] for name, goal in own if goal is not None},
            "relation": [[*pair, word] for pair, word in self.relation.items()],
            "strengths": dict(zip(agents, self.strengths, strict=True)),
        }

    @classmethod
    def from_dict(cls, world: World, record: Mapping[str, Any]) -> Roles:
        """Return the roles written by :meth:`to_dict`. Errors as of :meth:`of`."""
        if not isinstance(record.get("goals"), Mapping):
            raise InvalidSettingError("roles need goals, by the names of agents")
        told = record.get("relation", [])
        if not isinstance(told, list) or not all(isinstance(r, list) and len(r) == 3 for r in told):
            raise InvalidSettingError(
                f"relation {shown(told)}, expected a list of [who, whom, word]"
            )
        pairs = {(who, whom): word for who, whom, word in told}
        return cls.of(world, record["goals"], pairs, record.get("strengths", STRENGTH))

    def __getattr__(self, name: str) -> Any:
        if name in ("goal_red", "goal_green", "scenario", "strength_red", "strength_green"):
            raise AttributeError(
                f"{name} is of events of the world PHASE only; this one is of {self.world.name}"
            )
        raise AttributeError(name)

    def __repr__(self) -> str:
        return f"Roles({self})"

    def __str__(self) -> str:
        said = [
            f"{name}: {goal} ({force:.0f} N)"
            for (name, goal), force in zip(self.goals.items(), self.strengths, strict=True)
        ]
        said += [f"the {who} {word}s the {whom}" for (who, whom), word in self.relation.items()]
        return ", ".join(said)
