"""Which goals of all agents come to the same for one of them.

An agent's subgoal depends on its own goal, on whether somebody wants the same or the opposite, and,
where it helps another to get somewhere, on whether that one is where it wants to be. So of the
goals of all, whose number is a product over the agents, few *standpoints* are left.
"""

from __future__ import annotations

import functools
import itertools
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.world.arrays import IntArray
from phase_ppl.world.goals import goal_literal, possible_goals
from phase_ppl.world.names import NOTHING, STOP, Literal, Predicate
from phase_ppl.world.scene import World

_SAME, _OPPOSITE = 1, 2  # what another agent wants; 0: neither
_KINDS: Final = 3


class Stance(NamedTuple):
    """All that matters to an agent of what others want."""

    # whom its goal concerns: the agent that it is about; else one that wants the same, or the
    # opposite where the goal is to prevent something; else any. ``NOTHING``: nobody
    other: int
    cooperative: bool  # that one wants the same
    contested: bool  # somebody wants the opposite
    # the agent's goal is that the other one gets somewhere, so that it matters whether the other is
    # where it wants to be
    helps_along: bool


def stance_of(agent: int, goals: Sequence[Literal]) -> Stance:
    """Return how an agent stands to the others, given the goals of all, in order."""
    own = goals[agent]
    others = [other for other in range(len(goals)) if other != agent]
    about = [own.subject] if own.subject in others else []
    alike = [other for other in others if wants(own, agent, goals[other], other)]
    against = [other for other in others if wants(own.negated(), agent, goals[other], other)]
    concerned = [*about, *(alike + against if own.positive else against + alike), *others, NOTHING]
    return Stance(
        concerned[0],
        concerned[0] in alike,
        bool(against),
        bool(about) and own.predicate is Predicate.ON and own.positive,
    )


def wants(own: Literal, agent: int, theirs: Literal, other: int) -> bool:
    """Return whether another agent wants what ``own`` of an agent says.

    Two who are to touch each other each have a goal of their own.
    """
    return own == theirs or (own.says(theirs) and {own.subject, own.target} != {agent, other})


class Group(NamedTuple):
    """Standpoints of one agent with the same goal and stance: they differ in another's goal."""

    own: int
    literal: Literal
    stance: Stance
    others: list[int]  # goals of the other agent
    places: list[int]  # the number of the standpoint with each of these


class Standpoints:
    """The standpoints of one agent, whatever goals all have.

    Args:
        agent: which one.
        world: whose goals.

    Attributes:
        groups: all of them, by what they have in common.
        n: standpoints. Of two agents they are the pairs of effective goals, the first agent's times
            the number of goals plus the second's.
    """

    def __init__(self, agent: int, world: World) -> None:
        self._agent, self._n_goals = agent, len(world.goals)
        self._others = [other for other in range(len(world.agents)) if other != agent]
        self.groups: list[Group] = []
        if len(world.agents) == 2:
            self._of_pairs(world)
        else:
            self._of_any(world)

    def of(self, goals: IntArray) -> IntArray:
        """Return (...) the standpoints of (..., agent) effective goals; -1 where it has none."""
        own = goals[..., self._agent]
        if self._table is None:
            return np.asarray(goals[..., 0] * self._n_goals + goals[..., 1])
        code = np.zeros(own.shape, np.int64)
        for kind, (place, other) in itertools.product((_SAME, _OPPOSITE), enumerate(self._others)):
            code += kind * _KINDS**place * (goals[..., other] == self._wanted[kind, place, own])
        whose = self._whose[own]
        theirs = np.take_along_axis(goals, whose[..., None], axis=-1)[..., 0]
        return np.asarray(self._table[own, code, theirs])

    def _of_pairs(self, world: World) -> None:
        self._table: IntArray | None = None
        self.n = self._n_goals**2
        pairs = list(itertools.product(*(possible_goals(holder, world) for holder in range(2))))
        places = [red * self._n_goals + green for red, green in pairs]
        self.groups = grouped(self._agent, pairs, places, world)
        self.groups.sort(key=lambda one: one.own)

    def _of_any(self, world: World) -> None:
        agent, n_goals, others = self._agent, self._n_goals, self._others
        literals = [
            {goal: goal_literal(goal, holder, world) for goal in possible_goals(holder, world)}
            for holder in range(len(world.agents))
        ]
        # (kind, other, goal) the other's goal that is the same, or the opposite; -1: none
        self._wanted = np.full((_KINDS, len(others), n_goals), -1)
        for place, other in enumerate(others):
            for own, literal in literals[agent].items():
                for goal, theirs in literals[other].items():
                    if wants(literal, agent, theirs, other):
                        self._wanted[_SAME, place, own] = goal
                    elif wants(literal.negated(), agent, theirs, other):
                        self._wanted[_OPPOSITE, place, own] = goal
        self._whose = np.full(n_goals, agent)
        self._table = np.full((n_goals, _KINDS ** len(others), n_goals), -1)
        self.n = 0
        for own, literal in literals[agent].items():
            known: dict[Stance, Group] = {}
            for kinds in itertools.product(range(_KINDS), repeat=len(others)):
                goals = [int(self._wanted[kind, place, own]) for place, kind in enumerate(kinds)]
                if any(kind and goal < 0 for kind, goal in zip(kinds, goals, strict=True)):
                    continue  # nobody can want that
                everyone: list[Literal] = [STOP] * len(literals)
                everyone[agent] = literal
                for other, goal in zip(others, goals, strict=True):
                    everyone[other] = literals[other].get(goal, STOP)
                stance = stance_of(agent, everyone)
                code = sum(kind * _KINDS**place for place, kind in enumerate(kinds))
                one = known.setdefault(stance, Group(own, literal, stance, [], []))
                if stance.helps_along:
                    self._whose[own] = stance.other
                    helped = goals[others.index(stance.other)]
                    for goal in literals[stance.other] if helped < 0 else [helped]:
                        self._table[own, code, goal] = self._place(one, goal)
                else:
                    self._table[own, code] = self._place(one, own)
            self.groups += known.values()

    def _place(self, one: Group, goal: int) -> int:
        """Return the number of the standpoint with another's goal, a new one if need be."""
        if goal not in one.others:
            one.others.append(goal)
            one.places.append(self.n)
            self.n += 1
        return one.places[one.others.index(goal)]


@functools.cache
def standpoints(agent: int, world: World) -> Standpoints:
    """Return the standpoints of an agent of a world."""
    return Standpoints(agent, world)


def grouped(
    agent: int, goals: Iterable[tuple[int, ...]], places: Iterable[int], world: World
) -> list[Group]:
    """Return the standpoints from which an agent sees the goals of all, in groups.

    Args:
        agent: which one.
        goals: effective goals of all.
        places: the number of the standpoint of each.
        world: whose goals.
    """
    groups: dict[tuple[int, Literal, Stance], tuple[list[int], list[int]]] = defaultdict(
        lambda: ([], [])
    )
    literal = functools.cache(lambda goal, holder: goal_literal(goal, holder, world))
    for each, place in zip(goals, places, strict=True):
        literals = [literal(goal, holder) for holder, goal in enumerate(each)]
        stance = stance_of(agent, literals)
        other = agent if stance.other == NOTHING else stance.other
        others, numbers = groups[each[agent], literals[agent], stance]
        others.append(each[other])
        numbers.append(place)
    return [Group(*key, *lists) for key, lists in groups.items()]
