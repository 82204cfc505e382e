"""Standpoints: assignments of goals to all agents that pose the same problem to one of them.

An agent's subgoal depends on its own goal, and on whether another wants the same or the opposite.
If it helps another to get somewhere, it also depends on whether that one has arrived. So there are
few standpoints, although the number of assignments is a product over the agents.
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
from phase_ppl.world.names import NOTHING, STOP, Literal, PredicateKind
from phase_ppl.world.scene import World

_SAME, _OPPOSITE = 1, 2  # another agent wants the same, or the opposite; 0: neither
_KINDS: Final = 3


class Stance(NamedTuple):
    """The others' goals, reduced to what matters to one agent."""

    # the agent that its goal concerns: the one that it is about; else one that wants the same (or,
    # if the goal is to prevent something, the opposite); else any; ``NOTHING``: it is alone
    other: int
    cooperative: bool  # that one wants the same
    contested: bool  # somebody wants the opposite
    # the agent's goal is that the other gets somewhere; then it matters whether the other is there
    helps_along: bool


def stance_of(agent: int, goals: Sequence[Literal]) -> Stance:
    """Return an agent's stance, from the goals of all agents in order."""
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
        bool(about) and own.predicate is PredicateKind.ON and own.positive,
    )


def wants(own: Literal, agent: int, theirs: Literal, other: int) -> bool:
    """Return whether ``theirs``, another agent's goal, is the same as ``own`` of ``agent``.

    Two agents that shall touch each other each have a goal of their own.
    """
    return own == theirs or (own.says(theirs) and {own.subject, own.target} != {agent, other})


class Group(NamedTuple):
    """Standpoints of one agent with the same own goal and stance; another's goal differs."""

    own: int
    literal: Literal
    stance: Stance
    others: list[int]  # goals of the other agent
    places: list[int]  # standpoints that belong to these


class Standpoints:
    """All standpoints of one agent.

    Args:
        agent: which one.
        world: whose goals.

    Attributes:
        groups: the standpoints, grouped by own goal and stance.
        n: number of standpoints. With two agents they are the pairs of effective goals; the number
            of a pair is the first agent's goal times the number of goals, plus the second's goal.
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
        """Return (...) standpoints of (..., agent) effective goals; -1 if the goals have none."""
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
                    continue  # no agent can have that goal
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
        """Return the standpoint with another's goal; it is created if need be."""
        if goal not in one.others:
            one.others.append(goal)
            one.places.append(self.n)
            self.n += 1
        return one.places[one.others.index(goal)]


@functools.cache
def standpoints(agent: int, world: World) -> Standpoints:
    """Return the standpoints of an agent in a world."""
    return Standpoints(agent, world)


def grouped(
    agent: int, goals: Iterable[tuple[int, ...]], places: Iterable[int], world: World
) -> list[Group]:
    """Return the standpoints of an agent under given goals of all, in groups.

    Args:
        agent: which one.
        goals: effective goals of all.
        places: the standpoint of each.
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
