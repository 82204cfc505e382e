"""The hypothesis h = <g_i, g_j, alpha_ij, alpha_ji, f_i, f_j> of the paper (Eq. 1)."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.errors import (
    InvalidSettingError,
    UnknownNameError,
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
"""Possible alphas in PHASE: (what red does to green, what green does to red).

1: helps; -1: hinders; 0: neither. The site ``alpha`` of a prior is an index into this tuple."""


@functools.cache
def effective_table() -> NDArray[np.int32]:
    """Return (goal_red, goal_green, alpha, agent) the effective goals of stated ones."""
    table = np.empty((N_GOALS, N_GOALS, len(ALPHAS), 2), np.int32)
    for red, green, alpha in np.ndindex(table.shape[:-1]):
        table[red, green, alpha] = effective_goals(red, green, ALPHAS[alpha])
    table.setflags(write=False)
    return table


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


STANCES: Final = {"help": 1, "hinder": -1}
"""What an agent may do with another's goal, and the sign of alpha."""

_WORD_OF_SIGN: Final = {sign: word for word, sign in STANCES.items()}

SOCIAL: Final = 1 - 1 / 3
"""Probability that some agent helps or hinders another (paper, Appendix 4B)."""

Towards = tuple[tuple[int, int] | None, ...]
"""(agent,) another agent, and 1 where it is helped, -1 where it is hindered; None: neither."""


@functools.cache
def all_ways(n_agents: int) -> tuple[Towards, ...]:
    """Return all ways in which agents can stand to each other, as :attr:`Hypothesis.towards`.

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


def _argument_names(world: World) -> tuple[str, ...]:
    """Return the arguments of ``Hypothesis``; none in a world where only ``Hypothesis.of`` does."""
    names = ("goal_red", "goal_green", "alpha", "strength_red", "strength_green")
    return names if world == PHASE else ()


def towards_whom(
    relation: Mapping[tuple[str, str], str], world: World
) -> list[tuple[int, int] | None]:
    """Return by agent whom it helps (1) or hinders (-1); None: nobody.

    Raises:
        UnknownNameError: there is no such agent or word.
        InvalidSettingError: it is not (who, whom) -> "help" or "hinder", or an agent has more than
            one relation, or one to itself.
    """
    pair = world.agents[:2] if len(world.agents) > 1 else ("who", "whom")
    form = f"{{{pair!r}: 'help'}} or 'hinder'; {{}}: nobody helps or hinders"
    instance_of("relation", relation, Mapping, form)
    towards: list[tuple[int, int] | None] = [None] * len(world.agents)
    for pair, word in relation.items():
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise InvalidSettingError(f"relation of {shown(pair)}, expected {form}")
        who, whom = (world.agent(name) for name in pair)
        if who == whom:
            raise InvalidSettingError(f"the {pair[0]} cannot {word} itself")
        check_name("relation", word, STANCES)
        if towards[who] is not None:
            raise InvalidSettingError(f"the {pair[0]} can help or hinder one other only")
        towards[who] = whom, STANCES[word]
    return towards


@dataclasses.dataclass(frozen=True, repr=False, init=False)
class Hypothesis(Printed):
    """Who wants what, whom each helps or hinders, and how strong all are.

    An agent pursues its own goal, or it helps or hinders one other agent with that agent's own
    goal. ``Hypothesis(...)`` makes a hypothesis about PHASE. :meth:`of` makes one about any world.

    Args:
        goal_red: stated goal of the red agent, a string of ``GOALS`` or an index into it.
        goal_green: stated goal of the green agent, a string of ``GOALS`` or an index into it.
        alpha: one of ``ALPHAS``: (what red does to green, what green does to red), 1 for helping,
            -1 for hindering, 0 for neither. Default: (0, 0).
        strength_red: maximum force of the red agent, newtons. Default: 450.
        strength_green: maximum force of the green agent, newtons. Default: 450.

    Attributes:
        world: the world of agents and goals.
        stated: (agent,) own goal of each agent, an index into ``world.goals``. The own goal of an
            agent that helps or hinders has no effect, and may be None. ``goal_<agent>``, such as
            ``goal_red``, is the own goal of one agent; ``world.keys`` has the agents' short names.
            Where ``stated`` has None, ``goal_<agent>`` is the goal with which the agent would help
            the other one, even if it hinders.
        towards: (agent,) whom each agent helps or hinders: a pair of that agent's index and 1 for
            helping, -1 for hindering; or None.
        strengths: (agent,) maximum force of each agent, newtons. ``strength_<agent>``, such as
            ``strength_red``, is that of one agent.

    Raises:
        UnknownNameError: a goal is unknown.
        InvalidSettingError: alpha or a strength is not allowed, or an agent's goal names itself.
    """

    world: World
    stated: tuple[int | None, ...]
    towards: Towards
    strengths: tuple[float, ...]

    def __init__(
        self,
        goal_red: str | int,
        goal_green: str | int,
        alpha: Sequence[int] = (0, 0),
        strength_red: float = STRENGTH,
        strength_green: float = STRENGTH,
    ) -> None:
        stated = goal_index(goal_red), goal_index(goal_green)
        for holder, (name, goal) in enumerate(zip(("goal_red", "goal_green"), stated, strict=True)):
            if is_self_referring(goal, holder):
                raise InvalidSettingError(
                    f"{name}={GOALS[goal]!r} names its own holder, the {AGENTS[holder]}"
                )
        if (signs := next((one for one in ALPHAS if np.array_equal(alpha, one)), None)) is None:
            raise InvalidSettingError(f"alpha={shown(alpha)} is none of {list(ALPHAS)}")
        forces = {"strength_red": strength_red, "strength_green": strength_green}
        vars(self).update(
            world=PHASE,
            stated=stated,
            towards=tuple((1 - one, sign) if sign else None for one, sign in enumerate(signs)),
            strengths=tuple(checked_strength(name, force) for name, force in forces.items()),
        )

    @classmethod
    def coded(
        cls,
        world: World,
        stated: tuple[int | None, ...],
        towards: Towards,
        strengths: tuple[float, ...],
    ) -> Hypothesis:
        """Return the hypothesis that has the arguments as its attributes. They are not checked."""
        made = cls.__new__(cls)
        vars(made).update(world=world, stated=stated, towards=towards, strengths=strengths)
        return made

    @classmethod
    def of(
        cls,
        world: World,
        goals: Mapping[str, str | int],
        relation: Mapping[tuple[str, str], str] | None = None,
        strength: Mapping[str, float] | float = STRENGTH,
    ) -> Hypothesis:
        """Return a hypothesis about any world, given by names.

        Args:
            world: the world of agents and goals.
            goals: name of an agent -> its own goal, for every agent that neither helps nor hinders.
            relation: (name of an agent, name of the agent that it helps or hinders) -> "help" or
                "hinder". By default nobody helps or hinders.
            strength: maximum force, newtons: name of an agent -> force, or one force for all
                agents. Agents that are not named have 450.

        Raises:
            UnknownNameError: there is no such agent, goal or relation.
            InvalidSettingError: an agent has no goal, or more than one relation; it helps or
                hinders itself, or an agent without a goal of its own; what it would then want is no
                goal of the world; or a strength is not allowed.
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
        towards = towards_whom({} if relation is None else relation, world)
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
        return cls.coded(world, tuple(stated), tuple(towards), strengths)

    @property
    def effective_goals(self) -> tuple[int, ...]:
        """Effective goal of each agent, (agent,), an index into ``world.goals``.

        It is what the agent acts for: its own goal, or what helping or hindering makes it want.
        """
        stated = [0 if goal is None else goal for goal in self.stated]
        ways = enumerate(self.towards)
        return tuple(effective_goal(stated, agent, way, self.world) for agent, way in ways)

    @property
    def is_possible(self) -> bool:
        """Whether the effective goals of all agents are goals of the world."""
        try:
            return bool(self.effective_goals)
        except UnknownNameError:
            return False

    def effective(self) -> Hypothesis:
        """Return the hypothesis in which effective goals are stated, and nobody helps or hinders.

        World and strengths stay. The agents of both hypotheses act alike.
        """
        nobody = (None,) * len(self.towards)
        return self.coded(self.world, self.effective_goals, nobody, self.strengths)

    @property
    def goals(self) -> dict[str, str]:
        """Name of each agent -> its effective goal, a string."""
        found = (self.world.goals[goal] for goal in self.effective_goals)
        return dict(zip(self.world.agents, found, strict=True))

    @property
    def stances(self) -> dict[tuple[str, str], str]:
        """(name of an agent, name of the agent that it helps or hinders) -> "help" or "hinder".

        Agents that neither help nor hinder are left out.
        """
        agents = self.world.agents
        return {
            (agents[who], agents[towards[0]]): _WORD_OF_SIGN[towards[1]]
            for who, towards in enumerate(self.towards)
            if towards is not None
        }

    def relation_between(self, one: str, other: str) -> str:
        """Return the relation of two agents: "friendly", "neutral" or "adversarial".

        It follows from their effective goals. ``one`` and ``other`` are the agents' names
        (UnknownNameError: there is no such agent).
        """
        return RELATION_OF_SCENARIO[self.scenario_between(one, other)]

    def scenario_between(self, one: str, other: str) -> str:
        """Return the scenario of two agents, given by name; it follows from their effective goals.

        It is "collaborative", "independent", "competing" or "opposing" (UnknownNameError: there is
        no such agent).
        """
        pair = self.world.agent(one), self.world.agent(other)
        goal, other_goal = (self.effective_goals[agent] for agent in pair)
        return scenario(goal, other_goal, self.world, pair)

    @property
    def alpha(self) -> tuple[int, int]:
        """In a world of two agents: (what the first does to the second, and the second to it).

        1: helps; -1: hinders; 0: neither. AttributeError: the world does not have two agents.
        """
        to_other, to_one = (0 if one is None else one[1] for one in self._of_two(self.towards))
        return to_other, to_one

    @property
    def relation(self) -> str:
        """Relation of the agents in a world of two agents, as in :meth:`relation_between`."""
        return self.relation_between(*self._of_two(self.world.agents))

    @property
    def scenario(self) -> str:
        """Scenario of the agents in a world of two agents, as in :meth:`scenario_between`."""
        return self.scenario_between(*self._of_two(self.world.agents))

    def _of_two(self, each: Sequence[Any]) -> Sequence[Any]:
        if len(each) != 2:
            raise AttributeError  # what it says is in __getattr__, which is asked then
        return each

    def __getattr__(self, name: str) -> Any:
        if "world" not in vars(self):  # while it is unpickled
            raise AttributeError(name)
        if name in ("alpha", "relation", "scenario"):
            raise AttributeError(
                f"{name} needs a world of exactly two agents; {self.world.name!r} has "
                f"{len(self.world.agents)}: use relation_between, scenario_between or stances"
            )
        what, _, key = name.partition("_")
        if what not in ("goal", "strength"):
            raise AttributeError(f"a hypothesis has no {name}")
        if key not in self.world.keys:
            raise AttributeError(f"a hypothesis about {self.world.name!r} has no {name}")
        agent = self.world.keys.index(key)
        if what == "strength":
            return self.strengths[agent]
        own, towards = self.stated[agent], self.towards[agent]
        if own is None and towards is not None:
            return shared_goal(self.stated[towards[0]] or 0, towards[0], agent, self.world)
        return own

    @property
    def _arguments(self) -> dict[str, Any] | None:
        """What makes the same hypothesis of PHASE; None in a world where only :meth:`of` does."""
        if not (names := _argument_names(self.world)):
            return None
        goals = [self.world.goals[getattr(self, name)] for name in names[:2]]
        return dict(zip(names, [*goals, list(self.alpha), *self.strengths], strict=True))

    def to_dict(self) -> dict[str, Any]:
        """Return the hypothesis as plain data, which :meth:`from_dict` reads.

        In PHASE the keys are the arguments of ``Hypothesis``, with goals as strings. In other
        worlds they are ``goals``, by agent, ``relation``, a list of [who, whom, word], and
        ``strengths``, by agent.
        """
        if (made := self._arguments) is not None:
            return made
        agents, goals = self.world.agents, self.world.goals
        stated = zip(agents, self.stated, strict=True)
        return {
            "goals": {name: goals[goal] for name, goal in stated if goal is not None},
            "relation": [[*pair, word] for pair, word in self.stances.items()],
            "strengths": dict(zip(agents, self.strengths, strict=True)),
        }

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], world: World = PHASE) -> Hypothesis:
        """Return the hypothesis about ``world`` that :meth:`to_dict` wrote as ``record``.

        Raises:
            UnknownNameError: there is no such field, agent, goal or relation.
            InvalidSettingError: a goal is missing, or the hypothesis is impossible (:meth:`of`).
        """
        names = _argument_names(world)
        for name in record:
            check_name("field of a hypothesis", name, names or ("goals", "relation", "strengths"))
        if names:
            if missing := [name for name in names[:2] if name not in record]:
                raise InvalidSettingError(f"a hypothesis needs {', '.join(missing)}")
            return cls(**record)
        if not isinstance(record.get("goals"), Mapping):
            raise InvalidSettingError("a hypothesis needs goals, by the names of agents")
        told = record.get("relation", [])
        if not isinstance(told, list) or not all(isinstance(r, list) and len(r) == 3 for r in told):
            raise InvalidSettingError(
                f"relation {shown(told)}, expected one list per pair: "
                '[agent, agent, "help" or "hinder"]'
            )
        pairs = {(who, whom): word for who, whom, word in told}
        return cls.of(world, record["goals"], pairs, record.get("strengths", STRENGTH))

    def __repr__(self) -> str:
        if (made := self._arguments) is None:
            return f"Hypothesis({self})"
        values = ", ".join(f"{name}={value!r}" for name, value in made.items())
        return f"Hypothesis({values})"

    def __str__(self) -> str:
        names = self.world.agents if self._arguments is None else self.world.keys
        said = [
            f"{name}: {goal} ({force:.0f} N)"
            for name, goal, force in zip(names, self.goals.values(), self.strengths, strict=True)
        ]
        if self._arguments is not None:
            said.append(self.relation)
        else:
            said += [f"the {who} {word}s the {whom}" for (who, whom), word in self.stances.items()]
        return ", ".join(said)
