"""The high-level planner: one subgoal per belief particle, by A* over symbolic states.

Source: paper, Algorithm 1 (HP) and Appendix "Hierarchical Planner". The planning agent first
looks for a plan of its own. If its body cannot do that, it looks for a plan with another agent. If
there is none, it goes as near as it can. An agent that hinders looks for the cheapest state in
which the opponent's plan is broken. From there it acts on the negated goal itself.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

from phase_ppl.agents.standpoints import Stance
from phase_ppl.agents.symbols import (
    NO_DOOR,
    Finder,
    Step,
    SymbolicState,
    Target,
    plans_of,
    start_node,
)
from phase_ppl.agents.world_model import Abilities
from phase_ppl.world.names import NOTHING, STOP, Literal, PredicateKind


class SubgoalPlanner:
    """Chooses an agent's subgoals; ``subgoal`` remembers its earlier answers.

    Args:
        agent: who plans.
        own: literal of its effective goal.
        stance: its stance towards the others' goals.
        abilities: what the bodies can do.
        settles: whether it stops once its goal is reached, for any kind of goal.
        plans: returns the plan finder for given abilities.
    """

    def __init__(
        self,
        agent: int,
        own: Literal,
        stance: Stance,
        abilities: Abilities,
        settles: bool = False,
        plans: Callable[[Abilities], Finder] = plans_of,
    ) -> None:
        self.agent, self.own = agent, own
        self.stance, self.other = stance, stance.other
        if own.predicate is PredicateKind.ON:  # if the room has several landmarks, this one counts
            landmarks = list(abilities.landmark_in)
            landmarks[abilities.landmark_rooms[own.target]] = own.target
            abilities = dataclasses.replace(abilities, landmark_in=tuple(landmarks))
        self.abilities, self._find_plan = abilities, plans(abilities)
        self._n_agents = len(abilities.passes) - len(abilities.fills)
        self._settles = settles and own.positive
        self._touches = own.predicate is PredicateKind.TOUCH
        ends = (own.subject, own.target) if self._touches else (own.subject,)
        # unseen entities may have gone since they were last seen
        self._others = tuple(end for end in ends if end < self._n_agents and end != agent)
        # if the goal is about an item, that may be held; to clear or fill a door, any item may
        brought = ends[-1] >= self._n_agents and own.subject != agent
        self._item = ends[-1] if brought else NOTHING
        self._minds_doors = bool(self._others) and not self._touches
        self.subgoal = functools.cache(self._choose)

    def _choose(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """Return the subgoal for one symbolic state.

        Args:
            state: facts of a belief particle.
            observed: (entity,) whether the agent sees it now; it heads straight for such items.
        """
        subject = self.own.subject
        if self._settles and state.own_done and all(observed[other] for other in self._others):
            return self._free_hands(state) or STOP
        letting_go = None if self._minds_doors else self._free_hands(state, keep=self._item)
        if letting_go is not None:
            return letting_go
        if self._touches and subject != self.agent:
            return self._bring_together(state, observed)
        if self.own.positive:
            if subject >= self._n_agents:
                return self._deliver(state, observed)
            if subject == self.agent:
                return self._go(state, observed)
            return self._help_to_move(state, observed)
        if not self.abilities.is_open and self.stance.contested:
            if subject >= self._n_agents:
                return self._guard_item(state, observed)
            if subject == self.other and not self._touches:
                return self._keep_away(state, observed)
        # there is nobody to hinder, or no door to do it with: act on the goal itself
        return self._free_hands(state, keep=self._item) or self.own

    # --- own goals and helping -------------------------------------------------------------

    def _go(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """ON(self, landmark) or TOUCH(self, other)."""
        if self.own.predicate is PredicateKind.ON and state.own_done:
            return STOP
        goal_room = state.rooms[self.own.target] if self._touches else self._goal_room()
        in_view = self._touches and observed[self.own.target]
        if state.rooms[self.agent] == goal_room or in_view:
            return self.own
        return self._walk(state, {goal_room}, goal_room)

    def _deliver(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """ON(item, landmark)."""
        item, room = self.own.subject, self._goal_room()
        holding = state.held[self.agent] == item
        if state.own_done:
            return self._free_hands(state) or STOP
        if self.abilities.is_open and holding:
            return self.own

        placed = self.own.predicate is not PredicateKind.CLOSE
        delivered = Target("rooms", item, frozenset({room}), placed)
        steps = self._plan(state, (self.agent,), frozenset({item}), delivered)
        alone = steps is not None
        if steps is None and self.stance.cooperative:
            steps = self._plan(state, (self.agent, self.other), frozenset({item}), delivered)
        own_step = next((s for s in steps or () if self.agent in s.agents), None)
        if own_step is not None and self._can_start(steps, own_step, state):
            return self._start(own_step.literal, alone, item, state, observed)
        waits = self.stance.cooperative and own_step is None
        if waits and self._must_wait(state, item, room, bool(steps)):
            return STOP
        if holding:
            # too weak or too wide: keep pulling towards the goal
            following = self._next_room((), state.rooms[item], room)
            return self.own if following is None else Literal(PredicateKind.CLOSE, item, following)
        if state.rooms[self.agent] == state.rooms[item] or observed[item]:
            n_items = len(state.door_filled_by)
            if state.in_reach[n_items * self.agent + item - self._n_agents]:
                return Literal(PredicateKind.ATTACH, self.agent, item)
            return Literal(PredicateKind.TOUCH, self.agent, item)
        return self._press_on(state, state.rooms[item])

    def _bring_together(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """TOUCH(other, third) or its negation: bring or take away an item; push an agent."""
        subject, target = self.own.subject, self.own.target
        if target < self._n_agents:
            return self.own
        if state.held[self.agent] != target:
            if self.own.positive and state.own_done:
                return STOP
            return self._take(state, target, observed)
        if self.own.positive and not self.abilities.is_open:
            following = self._next_room((), state.rooms[target], state.rooms[subject])
            if following is not None:
                return Literal(PredicateKind.CLOSE, target, following)
        return self.own

    def _must_wait(self, state: SymbolicState, item: int, room: int, has_plan: bool) -> bool:
        """Whether doors leave this agent nothing to do for a shared item but to wait.

        Either the other agent has a plan without it, and doors keep this agent from the item or
        from bringing it to ``room``. Or doors keep this agent from both the item and ``room``.
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
        """Return the first subgoal of a step towards bringing an item somewhere."""
        if literal.predicate is PredicateKind.ATTACH and literal.positive and not alone:
            # an item to be handed over may be pushed as well; the search decides
            following = self._next_room((item,), state.rooms[item], state.rooms[self.other])
            if following is not None:
                return Literal(PredicateKind.CLOSE, item, following)
        return self._in_sight(literal, item, observed)

    def _help_to_move(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """ON(other, landmark): clear a door that an item closes on the other's way."""
        if self.abilities.is_open or state.other_done or state.own_done:
            return self._free_hands(state) or STOP
        goal_room = self._goal_room()
        way = self.abilities.route((), state.rooms[self.other], goal_room)
        on_way = self._doors(way)
        held = state.held[self.agent]
        closing = [
            self._n_agents + i for i, door in enumerate(state.door_filled_by) if door in on_way
        ]
        item = held if held != NOTHING else (closing[0] if closing else NOTHING)
        if item == NOTHING or (held != NOTHING and item not in closing):
            return self._free_hands(state) or STOP

        elsewhere = frozenset({NO_DOOR, *range(len(self.abilities.walled))}) - set(on_way)
        cleared = Target("door_filled_by", item - self._n_agents, elsewhere)
        steps = self._plan(state, (self.agent,), frozenset({item}), cleared)
        if not steps:
            return STOP
        step = steps[0].literal
        if step.predicate is PredicateKind.CLOSE and step.subject == item:
            return self._aside(item, state.rooms[item])
        return self._in_sight(step, item, observed)

    def _can_start(self, steps: list[Step] | None, step: Step, state: SymbolicState) -> bool:
        """Whether the first own step of a joint plan does not have to wait for the other agent."""
        if not steps or steps[0] is step:
            return True
        item = step.literal.target if step.literal.predicate is PredicateKind.TOUCH else NOTHING
        before = steps[: steps.index(step)]
        walks = step.literal.predicate is PredicateKind.CLOSE and step.literal.subject == self.agent
        touches_here = item != NOTHING and state.rooms[item] == state.rooms[self.agent]
        return walks or (
            touches_here and all(s.literal.predicate is not PredicateKind.CLOSE for s in before)
        )

    # --- hindering: the negation of the other's goal ------------------------------------------

    def _keep_away(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """Not ON(other, landmark): fill a door on its way, or meet it there and push it back."""
        goal_room = self._goal_room()
        rival_room = state.rooms[self.other]
        way = self.abilities.route((self.other,), rival_room, goal_room)
        if way is None:
            return self._free_hands(state) or STOP
        doors = self._doors(way)
        strong = self.abilities.carries(self.agent, holders=1)
        for i, fills in enumerate(self.abilities.fills):
            item = self._n_agents + i
            useful = [d for d in doors if fills[d]]
            near = state.rooms[self.agent] == state.rooms[item]
            if not useful or not near or not strong:
                continue
            reachable = [d for d in useful if d in self._doors_of(state.rooms[item])]
            if reachable:
                if state.held[self.agent] == item:
                    return self._door(item, reachable[0])
                return self._take(state, item)
        letting_go = self._free_hands(state)
        if letting_go is not None:
            return letting_go
        here = self._doors_of(state.rooms[self.agent])
        narrowed = [door for door in doors if self.abilities.walled[door] and door in here]
        if narrowed:
            return self._door(self.agent, narrowed[0])
        meeting = set(way[1:]) if len(way) > 1 else set(way)
        if state.rooms[self.agent] in meeting or observed[self.other]:
            return self.own
        return self._walk(state, meeting, goal_room)

    def _guard_item(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """Not ON(item, landmark): take it away, hold it back, or stand in the way."""
        item = self.own.subject
        me, rival = state.rooms[self.agent], state.rooms[self.other]
        item_room, goal_room = state.rooms[item], self._goal_room()
        ability = self.abilities
        rival_way = ability.route((self.other,), rival, item_room)
        rival_holds = state.held[self.other] == item
        if ability.route((self.agent,), me, item_room) is None:
            if rival_holds or rival == item_room or rival_way is None:
                return STOP
            return self._stand_in_door(state, rival_way)
        holding = state.held[self.agent] == item
        if rival_holds:
            if ability.route((self.other, item), item_room, goal_room) is None:
                return self._free_hands(state) or STOP
            if holding:
                return self._hold_back(item, item_room)
            return self._take(state, item, observed)
        if rival_way is None:
            return self._free_hands(state) or STOP
        rooms, distance = self._rooms_to_take_to(item, item_room), ability.room_distance
        closed = (room for room in rooms if ability.route((self.other,), rival, room) is None)
        refuge = next(closed, None)
        if refuge is None:
            if not holding and me in rival_way[1:-1]:
                return self._stand_in_door(state, rival_way)
            nearer = [room for room in rooms if distance[item_room][room] < distance[rival][room]]
            refuge = max(nearer, key=lambda room: distance[rival][room], default=None)
        if refuge is None:
            return self._aside(self.other, rival).negated()
        if not holding:
            return self._take(state, item, observed)
        following = self._next_room((self.agent, item), item_room, refuge)
        if following is None:
            return self._hold_back(item, item_room)
        return Literal(PredicateKind.CLOSE, item, following)

    def _hold_back(self, item: int, room: int) -> Literal:
        """Pull an item into the corner of its room; in the goal's room, off the goal."""
        return self.own if room == self._goal_room() else self._aside(item, room)

    def _aside(self, entity: int, room: int) -> Literal:
        """Bring an entity to the landmark of a room, or into a corner if there is none."""
        landmark = self.abilities.landmark_in[room]
        where = (PredicateKind.CLOSE, room) if landmark == NOTHING else (PredicateKind.ON, landmark)
        return Literal(where[0], entity, where[1])

    def _door(self, entity: int, door: int) -> Literal:
        """Stand in a door; literals number the doors after the rooms."""
        return Literal(PredicateKind.CLOSE, entity, len(self.abilities.neighbours) + door)

    def _rooms_to_take_to(self, item: int, item_room: int) -> list[int]:
        """Return the rooms, except the goal's, to which this agent can take an item."""
        goal_room = self._goal_room()
        return [
            room
            for room in range(len(self.abilities.neighbours))
            if room != goal_room
            and self.abilities.route((self.agent, item), item_room, room) is not None
        ]

    def _stand_in_door(self, state: SymbolicState, rival_way: tuple[int, ...]) -> Literal:
        """Go to the nearest door on the rival's way that this agent can reach."""
        here = self._doors_of(state.rooms[self.agent])
        for door in reversed(self._doors(rival_way)):
            if door in here and self.abilities.walled[door]:
                return self._door(self.agent, door)
        target = rival_way[-2] if len(rival_way) > 1 else rival_way[-1]
        return self._press_on(state, target)

    # --- shared by all goals ------------------------------------------------------------------

    def _free_hands(self, state: SymbolicState, keep: int = NOTHING) -> Literal | None:
        """Return the subgoal to let go of an item other than ``keep``; None: no such item."""
        held = state.held[self.agent]
        if held in (NOTHING, keep):
            return None
        return Literal(PredicateKind.ATTACH, self.agent, held, positive=False)

    def _next_room(self, entities: tuple[int, ...], start: int, end: int) -> int | None:
        """Return the first room on a way whose doors all ``entities`` pass; None: no way."""
        way = self.abilities.route(entities, start, end)
        return way[1] if way is not None and len(way) > 1 else None

    def _walk(self, state: SymbolicState, rooms: set[int], to: int) -> Literal:
        """Go to one of ``rooms``; if that is impossible, as near as possible to the room ``to``."""
        there = Target("rooms", self.agent, frozenset(rooms))
        steps = self._plan(state, (self.agent,), frozenset(), there)
        return steps[0].literal if steps else self._press_on(state, to)

    def _press_on(self, state: SymbolicState, room: int) -> Literal:
        """Head for a room that the body does not fit into, as near as the walls allow."""
        following = self._next_room((), state.rooms[self.agent], room)
        return STOP if following is None else Literal(PredicateKind.CLOSE, self.agent, following)

    def _take(
        self, state: SymbolicState, item: int, observed: tuple[bool, ...] | None = None
    ) -> Literal:
        """Get hold of an item."""
        taken = Target("held", self.agent, frozenset({item}))
        steps = self._plan(state, (self.agent,), frozenset({item}), taken)
        if not steps:
            return self._press_on(state, state.rooms[item])
        return self._in_sight(steps[0].literal, item, observed)

    def _in_sight(self, literal: Literal, item: int, observed: tuple[bool, ...] | None) -> Literal:
        """Head straight for an item in view instead of for its room."""
        walking = literal.predicate is PredicateKind.CLOSE and literal.subject == self.agent
        if walking and observed is not None and observed[item]:
            return Literal(PredicateKind.TOUCH, self.agent, item)
        return literal

    def _doors_of(self, room: int) -> set[int]:
        """Return the doors of a room."""
        return {door for door, _ in self.abilities.neighbours[room]}

    def _doors(self, way: tuple[int, ...] | None) -> list[int]:
        """Return the doors that a way through rooms uses."""
        doors = []
        for start, end in zip(way or (), (way or ())[1:], strict=False):
            joining = self.abilities.neighbours[start]
            doors += [door for door, following in joining if following == end][:1]
        return doors

    def _goal_room(self) -> int:
        """Return the room of the goal; an arena without inner walls is one room."""
        if self.own.predicate is PredicateKind.CLOSE:
            return self.own.target
        return 0 if self.abilities.is_open else self.abilities.landmark_rooms[self.own.target]

    def _plan(
        self, state: SymbolicState, willing: tuple[int, ...], targets: frozenset[int], goal: Target
    ) -> list[Step] | None:
        done = [False] * len(state.rooms)
        if self.own.predicate is PredicateKind.ON:
            done[self.own.subject] = state.own_done
        start = start_node(state, tuple(done), targets)
        moves = not self._touches and self.own.positive and self.own.subject in targets
        heading = (self.own.subject, self._goal_room()) if moves else None
        return self._find_plan(start, willing, targets, goal, heading)


@functools.lru_cache(maxsize=64)
def subgoal_planners(
    agent: int, abilities: Abilities
) -> Callable[[Literal, Stance, bool], SubgoalPlanner]:
    """Return (own goal, stance, settles) -> planner; equal simulations share its memory.

    Planners of different goals share plans too, since many goals need the same ones.
    """
    plans = functools.cache(plans_of)

    @functools.cache
    def planner(own: Literal, stance: Stance, settles: bool) -> SubgoalPlanner:
        return SubgoalPlanner(agent, own, stance, abilities, settles, plans)

    return planner
