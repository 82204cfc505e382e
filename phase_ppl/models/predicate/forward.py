"""The forward model: how probable a symbolic trajectory is if an agent has a goal.

In each frame an agent completes an operator with the probability h = 1 / ``operator_frames``, else
nothing happens. Which one it is is boundedly rational: with the cost to go C after it,

    P(o | state, g) = (1 - lapse) exp(-rationality Q(o)) / Z + lapse / n,  Q(o) = cost(o) + C(o, g),

over the n operators that the planner knows in that state, waiting among them. Waiting costs
``wait_cost`` as long as there is something left to do and nothing otherwise, and cannot be told
from completing nothing. What comes true without an operator of the agent that explains it has
only the lapse. Facts that are no agent's doing (a pushed item, where a holder is) are given.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from phase_ppl.agents.operators import TOUCH_COST, Node, Step
from phase_ppl.models.predicate.planning import cost_to_go, operators, without_physics
from phase_ppl.models.predicate.symbols import SymbolicState
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import nonnegative_number, positive_number
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.goals import N_GOALS, goal_literal, is_self_referring
from phase_ppl.world.literals import STOP, Literal, Predicate
from phase_ppl.world.names import AGENTS, ENTITIES, NOTHING
from phase_ppl.world.scene import Scene

RATIONALITY: Final = 0.8
OPERATOR_FRAMES: Final = 12.0
WAIT_COST: Final = 2 * TOUCH_COST
LAPSE: Final = 0.02


@dataclasses.dataclass(frozen=True)
class Rationality:
    """How rational agents are taken to be.

    Attributes:
        rationality: inverse temperature, per unit of way; 0 is blind chance.
        operator_frames: frames that an operator takes in the mean, more than 1.
        wait_cost: what waiting costs while something is left to do, units of way.
        lapse: probability of doing just anything, in (0, 1).

    Raises:
        InvalidSettingError: a value outside its range.
    """

    rationality: float = RATIONALITY
    operator_frames: float = OPERATOR_FRAMES
    wait_cost: float = WAIT_COST
    lapse: float = LAPSE

    def __post_init__(self) -> None:
        for name in ("operator_frames", "lapse"):
            positive_number(name, getattr(self, name))
        for name in ("rationality", "wait_cost"):
            nonnegative_number(name, getattr(self, name))
        if not self.operator_frames > 1:
            raise InvalidSettingError(
                f"operator_frames={shown(self.operator_frames)}, expected a number > 1"
            )
        if not self.lapse < 1:
            raise InvalidSettingError(f"lapse={shown(self.lapse)}, expected a number in (0, 1)")


def own_changes(
    before: SymbolicState, after: SymbolicState, agent: int
) -> Iterator[tuple[SymbolicState, Literal]]:
    """Yield what an agent did between two frames, each with the state in which it did it.

    Letting go, going to a room, touching, gripping, arriving, in this order. To grip is to touch;
    an agent that holds an item goes and arrives with it, and so do two that hold the same. That a
    predicate ceases to hold is no doing of its own, but for letting go: it comes with going on.
    """
    had, has = before.held[agent], after.held[agent]
    state = before
    if had not in (NOTHING, has):
        yield state, Literal(Predicate.ATTACH, agent, had, positive=False)
        state = _with_near(state, agent, had)._replace(held=_put(state.held, agent, NOTHING))
    mover = agent if state.held[agent] == NOTHING else state.held[agent]
    if after.rooms[mover] != before.rooms[mover]:
        yield state, Literal(Predicate.CLOSE, mover, after.rooms[mover])
        state = state._replace(placed=_put(state.placed, mover, False))
        still = [was and yes for was, yes in zip(state.near[agent], after.near[agent], strict=True)]
        state = state._replace(near=_put(state.near, agent, tuple(still)))
    state = state._replace(rooms=after.rooms)
    if state.held[agent] == NOTHING:
        for entity in range(len(ENTITIES)):
            touches = after.near[agent][entity] or entity == has
            if touches and not state.near[agent][entity]:
                yield state, Literal(Predicate.TOUCH, agent, entity)
                state = _with_near(state, agent, entity)
    if has not in (NOTHING, had):
        yield state, Literal(Predicate.ATTACH, agent, has)
        state = state._replace(held=after.held)
    mover = agent if has == NOTHING else has
    if after.placed[mover] and not state.placed[mover]:
        yield state, Literal(Predicate.ON, mover, after.rooms[mover])


class ForwardModel:
    """Probabilities of symbolic trajectories in one scene.

    Args:
        scene: its layout is all that counts.
        rationality: of both agents.
    """

    def __init__(self, scene: Scene, rationality: Rationality | None = None) -> None:
        self.rationality = Rationality() if rationality is None else rationality
        self._abilities = without_physics(scene)
        self._cost_to_go = {
            (agent, goal): cost_to_go(self._abilities, agent, goal_literal(goal, agent))
            for agent in range(len(AGENTS))
            for goal in range(N_GOALS)
            if not is_self_referring(goal, agent)
        }
        self._steps: dict[tuple[Node, int, tuple[int, ...]], list[Step]] = {}
        self._known: dict[tuple[SymbolicState, int, int], dict[Literal, float]] = {}

    def policy(self, state: SymbolicState, agent: int, goal: int) -> dict[Literal, float]:
        """Return P(operator | state, goal) by the literal that the operator makes true.

        Args:
            state: where the agent is.
            agent: 0 red, 1 green.
            goal: index of its effective goal.

        Returns:
            The sum is 1; ``STOP`` is waiting.
        """
        key = state, agent, goal
        if key not in self._known:
            self._known[key] = self._policy(*key)
        return self._known[key]

    def _policy(self, state: SymbolicState, agent: int, goal: int) -> dict[Literal, float]:
        given, left_after = self.rationality, self._cost_to_go[agent, goal]
        node = left_after.node(state)
        left = left_after(node)
        costs = {STOP: left + (given.wait_cost if left > 0 else 0.0)}
        touched = tuple(entity for entity, yes in enumerate(state.near[agent]) if yes)
        for step in self._operators(node, agent, touched):
            costs[step.literal] = step.cost + left_after(step.result)
        # where there is no way to the goal, nothing is better than anything else
        least = min(costs.values())
        weights = {
            literal: _weight(given.rationality, cost, least) for literal, cost in costs.items()
        }
        total, even = sum(weights.values()), given.lapse / len(weights)
        return {
            literal: (1 - given.lapse) * weight / total + even
            for literal, weight in weights.items()
        }

    def _operators(self, node: Node, agent: int, touched: tuple[int, ...]) -> list[Step]:
        key = node, agent, touched
        if key not in self._steps:
            self._steps[key] = operators(*key, self._abilities)
        return self._steps[key]

    def log_likelihood(self, trajectory: Sequence[SymbolicState]) -> FloatArray:
        """Return (agent, goal) log P(trajectory | goal), 0 for goals that name their holder.

        Given what is seen of both before, each agent's doings depend on its own goal only: the
        log probability given a pair of goals is the sum of the two.
        """
        found = np.zeros((len(AGENTS), N_GOALS))
        for agent, goal in self._cost_to_go:
            found[agent, goal] = sum(
                self._log_step(before, after, agent, goal)
                for before, after in itertools.pairwise(trajectory)
            )
        return found

    def _log_step(
        self, before: SymbolicState, after: SymbolicState, agent: int, goal: int
    ) -> float:
        completes = 1 / self.rationality.operator_frames
        did = [] if before == after else list(own_changes(before, after, agent))
        if not did:
            return math.log(1 - completes + completes * self.policy(before, agent, goal)[STOP])
        total = 0.0
        for state, literal in did:
            policy = self.policy(state, agent, goal)
            unexplained = self.rationality.lapse / len(policy)
            total += math.log(completes * policy.get(literal, unexplained))
        return total


def _weight(rationality: float, cost: float, least: float) -> float:
    if rationality == 0 or cost == least:
        return 1.0
    return math.exp(-rationality * (cost - least))


def _put(values: tuple, index: int, value: object) -> tuple:  # type: ignore[type-arg]
    return (*values[:index], value, *values[index + 1 :])


def _with_near(state: SymbolicState, agent: int, entity: int) -> SymbolicState:
    return state._replace(near=_put(state.near, agent, _put(state.near[agent], entity, True)))
