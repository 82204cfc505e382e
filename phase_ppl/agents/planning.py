"""What all subgoal planning draws on: plans of operators, routes, doors, and simple subgoals."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from phase_ppl.agents.operators import Abilities, Node, Step, plan, start_node
from phase_ppl.agents.symbols import SymbolicState
from phase_ppl.world.literals import STOP, Literal, Predicate
from phase_ppl.world.names import NOTHING

NodeTest = Callable[[Node], bool]


class Stance(NamedTuple):
    """All that matters to an agent of what the other one wants.

    Attributes:
        cooperative: both want the same.
        contested: the other wants the opposite.
        helps_along: the agent's goal is that the other one gets somewhere, so that it matters
            whether the other is where it wants to be.
    """

    cooperative: bool
    contested: bool
    helps_along: bool


def stance(agent: int, own: Literal, other: Literal) -> Stance:
    """Return how an agent with goal ``own`` stands to the other one, with goal ``other``."""
    to_place = own.predicate is Predicate.ON and own.positive
    return Stance(other == own, other == own.negated(), to_place and own.subject == 1 - agent)


class Planning:
    """The view of one agent on plans.

    Args:
        agent: who plans, 0 red or 1 green.
        own: literal of its effective goal.
        other: literal of the other agent's effective goal.
        abilities: what the bodies can do.
    """

    def __init__(self, agent: int, own: Literal, other: Literal, abilities: Abilities) -> None:
        self.agent = agent
        self.opponent = 1 - agent
        self.own = own
        self.other = other
        self.abilities = abilities
        self.stance = stance(agent, own, other)

    # --- simple subgoals --------------------------------------------------------------------

    def _free_hands(self, state: SymbolicState, keep: int = NOTHING) -> Literal | None:
        """Return the subgoal to let go of whatever is held (other than ``keep``), if anything."""
        held = state.held[self.agent]
        if held in (NOTHING, keep):
            return None
        return Literal(Predicate.ATTACH, self.agent, held, positive=False)

    def _press_on(self, state: SymbolicState, room: int) -> Literal:
        """Head for a room that the body does not fit into: as near as the walls allow."""
        way = self.abilities.route((), state.rooms[self.agent], room)
        if way is None or len(way) < 2:
            return STOP
        return Literal(Predicate.CLOSE, self.agent, way[1])

    def _take(
        self, state: SymbolicState, item: int, observed: tuple[bool, ...] = (False,) * 4
    ) -> Literal:
        """Get hold of an item."""
        steps = self._plan(
            state, (self.agent,), frozenset({item}), lambda node: node.held[self.agent] == item
        )
        if not steps:
            return self._press_on(state, state.rooms[item])
        return self._in_sight(steps[0].literal, item, observed)

    def _in_sight(self, literal: Literal, item: int, observed: tuple[bool, ...]) -> Literal:
        """Head straight for an item in view instead of for its room."""
        walking = literal.predicate is Predicate.CLOSE and literal.subject == self.agent
        if walking and observed[item]:
            return Literal(Predicate.TOUCH, self.agent, item)
        return literal

    # --- plans and places --------------------------------------------------------------------

    def _open(self, room: int) -> tuple[tuple[int, int], ...]:
        return self.abilities.neighbours[room]

    def _doors_of(self, room: int) -> set[int]:
        """Return the rays of the doors of a room."""
        return {ray for ray, _ in self._open(room)}

    def _doors(self, way: tuple[int, ...] | None) -> list[int]:
        """Return the rays of the doors that a way through rooms uses."""
        doors = []
        for start, end in zip(way or (), (way or ())[1:], strict=False):
            doors += [ray for ray, following in self._open(start) if following == end][:1]
        return doors

    def _landmark_room(self, landmark: int) -> int:
        """Rooms carry the ids of their landmarks; an arena without inner walls is one room."""
        return 0 if self.abilities.is_open else landmark

    def _plan(
        self,
        state: SymbolicState,
        willing: tuple[int, ...],
        targets: frozenset[int],
        is_goal: NodeTest,
    ) -> list[Step] | None:
        done = [False] * 4
        if self.own.predicate is Predicate.ON:
            done[self.own.subject] = state.own_done
        start = start_node(state, tuple(done), targets)  # type: ignore[arg-type]
        distance = self.abilities.room_distance
        moving = self.own.subject if self.own.predicate is Predicate.ON else None
        goal_room = self._landmark_room(self.own.target) if moving in targets else None

        def heuristic(node: Node) -> float:
            if moving is None or goal_room is None or not self.own.positive:
                return 0.0
            return distance[node.rooms[moving]][goal_room]

        return plan(start, willing, targets, is_goal, heuristic, self.abilities)
