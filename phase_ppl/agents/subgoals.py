"""The high-level planner: one subgoal per belief particle, by A* over symbolic states.

Source: paper, Algorithm 1 (HP) and Appendix "Hierarchical Planner". The planning agent first
looks for a plan of its own; where its body cannot do it, for a plan of both agents; where there
is none, it goes as near as it can. An agent that hinders looks for the cheapest state from which
the opponent's plan is broken, and from there acts on the negated goal itself.
"""

from __future__ import annotations

import functools

from phase_ppl.agents.hindering import Hindering
from phase_ppl.agents.operators import Abilities, Node, Step
from phase_ppl.agents.symbols import SymbolicState
from phase_ppl.world.literals import STOP, Literal, Predicate
from phase_ppl.world.names import NOTHING


class SubgoalPlanner(Hindering):
    """Chooses subgoals of one agent, remembering each symbolic state it has planned for.

    Args:
        agent: who plans, 0 red or 1 green.
        own: literal of its effective goal.
        other: literal of the other agent's effective goal.
        abilities: what the bodies can do.
    """

    def __init__(self, agent: int, own: Literal, other: Literal, abilities: Abilities) -> None:
        super().__init__(agent, own, other, abilities)
        self._memory: dict[tuple[SymbolicState, tuple[bool, ...]], Literal] = {}

    def subgoal(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """Return the subgoal for one symbolic state.

        Args:
            state: facts of a belief particle.
            observed: (4,) entities the agent observes now; it heads straight for those in view.
        """
        key = (state, observed)
        found = self._memory.get(key)
        if found is None:
            found = self._memory[key] = self._choose(state, observed)
        return found

    def _choose(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        subject = self.own.subject
        if self.own.positive:
            if subject >= 2:
                return self._deliver(state, observed)
            if subject == self.agent:
                return self._go(state, observed)
            return self._help_to_move(state, observed)
        if not self.abilities.is_open and self.stance.contested:
            if subject >= 2:
                return self._guard_item(state, observed)
            if subject == self.opponent and self.own.predicate is Predicate.ON:
                return self._keep_away(state, observed)
        # nobody to hinder, or no doors to do it by: the goal itself
        return self._free_hands(state, keep=subject) or self.own

    # --- own goals and helping -------------------------------------------------------------

    def _go(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """ON(self, landmark) or TOUCH(self, other)."""
        if self.own.predicate is Predicate.ON and state.own_done:
            return self._free_hands(state) or STOP
        letting_go = self._free_hands(state)
        if letting_go is not None:
            return letting_go
        if self.own.predicate is Predicate.TOUCH:
            goal_room = state.rooms[self.own.target]
            in_view = observed[self.own.target]
        else:
            goal_room, in_view = self._landmark_room(self.own.target), False
        return self._approach(state, goal_room, in_view, self.own)

    def _approach(
        self, state: SymbolicState, room: int, in_view: bool, arrived: Literal
    ) -> Literal:
        """Go to a room, and there act on ``arrived``."""
        if state.rooms[self.agent] == room or in_view:
            return arrived
        steps = self._plan(
            state, (self.agent,), frozenset(), lambda node: node.rooms[self.agent] == room
        )
        return steps[0].literal if steps else self._press_on(state, room)

    def _deliver(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """ON(item, landmark)."""
        item, room = self.own.subject, self._landmark_room(self.own.target)
        holding = state.held[self.agent] == item
        if state.own_done:
            return self._free_hands(state) or STOP
        letting_go = self._free_hands(state, keep=item)
        if letting_go is not None:
            return letting_go
        if self.abilities.is_open and holding:
            return self.own

        def delivered(node: Node) -> bool:
            return node.rooms[item] == room and node.placed[item]

        steps = self._plan(state, (self.agent,), frozenset({item}), delivered)
        alone = steps is not None
        if steps is None and self.stance.cooperative:
            steps = self._plan(state, (self.agent, self.opponent), frozenset({item}), delivered)
        own_step = self._first_own_step(steps)
        if own_step is not None and self._can_start(steps, own_step, state):
            return self._start(own_step.literal, alone, item, state, observed)
        if (
            self.stance.cooperative
            and own_step is None
            and self._must_wait(state, item, room, bool(steps))
        ):
            return STOP
        if holding:
            # too weak or too wide: keep pulling towards the goal
            way = self.abilities.route((), state.rooms[item], room)
            if way is None or len(way) < 2:
                return self.own
            return Literal(Predicate.CLOSE, item, way[1])
        if state.rooms[self.agent] == state.rooms[item] or observed[item]:
            if state.in_reach[2 * self.agent + item - 2]:
                return Literal(Predicate.ATTACH, self.agent, item)
            return Literal(Predicate.TOUCH, self.agent, item)
        return self._press_on(state, state.rooms[item])

    def _must_wait(self, state: SymbolicState, item: int, room: int, has_plan: bool) -> bool:
        """Whether doors leave this agent nothing to do for an item of both but to wait.

        They keep it from the item or from bringing it to ``room``, and the other can do without
        it; or they keep it from both.
        """
        route = self.abilities.route
        reaches = route((self.agent,), state.rooms[self.agent], state.rooms[item]) is not None
        if has_plan:
            return not reaches or route((self.agent, item), state.rooms[item], room) is None
        return not reaches and route((self.agent,), state.rooms[self.agent], room) is None

    def _start(
        self,
        literal: Literal,
        alone: bool,
        item: int,
        state: SymbolicState,
        observed: tuple[bool, ...],
    ) -> Literal:
        """Return how to begin a step towards bringing an item somewhere."""
        if literal.predicate is Predicate.ATTACH and literal.positive and not alone:
            # what is to be handed over may be pushed as well; the search decides
            way = self._way_to_hand_over(state, item)
            if way is not None:
                return Literal(Predicate.CLOSE, item, way)
        return self._in_sight(literal, item, observed)

    def _way_to_hand_over(self, state: SymbolicState, item: int) -> int | None:
        """Return the next room on the item's way to the other agent, if there is one."""
        way = self.abilities.route((item,), state.rooms[item], state.rooms[self.opponent])
        return way[1] if way is not None and len(way) > 1 else None

    def _help_to_move(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """ON(other, landmark): clear a door that an item closes on the other's way."""
        if self.abilities.is_open or state.other_done or state.own_done:
            return self._free_hands(state) or STOP
        goal_room = self._landmark_room(self.own.target)
        way = self.abilities.route((), state.rooms[self.opponent], goal_room)
        on_way = self._doors(way)
        held = state.held[self.agent]
        closing = [2 + i for i in range(2) if state.door_filled_by[i] in on_way]
        item = held if held != NOTHING else (closing[0] if closing else NOTHING)
        if item == NOTHING or (held != NOTHING and item not in closing):
            return self._free_hands(state) or STOP

        def cleared(node: Node) -> bool:
            return node.clear[item - 2] not in on_way

        steps = self._plan(state, (self.agent,), frozenset({item}), cleared)
        if not steps:
            return STOP
        step = steps[0].literal
        if step.predicate is Predicate.CLOSE and step.subject == item:
            return Literal(Predicate.ON, item, state.rooms[item])
        return self._in_sight(step, item, observed)

    def _first_own_step(self, steps: list[Step] | None) -> Step | None:
        return next((s for s in steps or () if self.agent in s.agents), None)

    def _can_start(self, steps: list[Step] | None, step: Step, state: SymbolicState) -> bool:
        """Whether the first own step of a joint plan needs nothing of the other agent first."""
        if not steps or steps[0] is step:
            return True
        item = step.literal.target if step.literal.predicate is Predicate.TOUCH else NOTHING
        before = steps[: steps.index(step)]
        walks = step.literal.predicate is Predicate.CLOSE and step.literal.subject == self.agent
        touches_here = item != NOTHING and state.rooms[item] == state.rooms[self.agent]
        return walks or (
            touches_here and all(s.literal.predicate is not Predicate.CLOSE for s in before)
        )


@functools.lru_cache(maxsize=4096)
def subgoal_planner(
    agent: int, own: Literal, other: Literal, abilities: Abilities
) -> SubgoalPlanner:
    """Return the planner for these arguments; simulations that agree on them share its memory."""
    return SubgoalPlanner(agent, own, other, abilities)
