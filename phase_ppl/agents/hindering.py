"""Hindering: the cheapest state from which the opponent's plan is broken, and how to get there."""

from __future__ import annotations

from phase_ppl.agents.planning import Planning
from phase_ppl.agents.symbols import SymbolicState
from phase_ppl.world.literals import STOP, Literal, Predicate
from phase_ppl.world.rooms import N_ROOMS


class Hindering(Planning):
    """Subgoals of an agent whose goal is the negation of the other's."""

    def _keep_away(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """Not ON(other, landmark): fill a door on its way, or meet it there and push it back."""
        goal_room = self._landmark_room(self.own.target)
        rival_room = state.rooms[self.opponent]
        way = self.abilities.route((self.opponent,), rival_room, goal_room)
        if way is None:
            return self._free_hands(state) or STOP
        doors = self._doors(way)
        for i in range(2):
            item = 2 + i
            useful = [d for d in doors if self.abilities.fills[i][d]]
            near = state.rooms[self.agent] == state.rooms[item]
            if not useful or not near or not self.abilities.carries_alone[self.agent]:
                continue
            reachable = [d for d in useful if d in self._doors_of(state.rooms[item])]
            if reachable:
                if state.held[self.agent] == item:
                    return Literal(Predicate.CLOSE, item, N_ROOMS + reachable[0])
                return self._take(state, item)
        letting_go = self._free_hands(state)
        if letting_go is not None:
            return letting_go
        here = self._doors_of(state.rooms[self.agent])
        narrowed = [door for door in doors if self.abilities.walled[door] and door in here]
        if narrowed:
            return Literal(Predicate.CLOSE, self.agent, N_ROOMS + narrowed[0])
        meeting = set(way[1:]) if len(way) > 1 else set(way)
        if state.rooms[self.agent] in meeting or observed[self.opponent]:
            return self.own
        steps = self._plan(
            state, (self.agent,), frozenset(), lambda node: node.rooms[self.agent] in meeting
        )
        return steps[0].literal if steps else self._press_on(state, goal_room)

    def _guard_item(self, state: SymbolicState, observed: tuple[bool, ...]) -> Literal:
        """Not ON(item, landmark): take it away, hold it back, or stand in the way."""
        item = self.own.subject
        me, rival = state.rooms[self.agent], state.rooms[self.opponent]
        item_room, goal_room = state.rooms[item], self._landmark_room(self.own.target)
        ability = self.abilities
        letting_go = self._free_hands(state, keep=item)
        if letting_go is not None:
            return letting_go
        rival_way = ability.route((self.opponent,), rival, item_room)
        rival_holds = state.held[self.opponent] == item
        if ability.route((self.agent,), me, item_room) is None:
            if rival_holds or rival == item_room or rival_way is None:
                return STOP
            return self._stand_in_door(state, rival_way)
        holding = state.held[self.agent] == item
        if rival_holds:
            if ability.route((self.opponent, item), item_room, goal_room) is None:
                return self._free_hands(state) or STOP
            return (
                self._hold_back(item, item_room) if holding else self._take(state, item, observed)
            )
        if rival_way is None:
            return self._free_hands(state) or STOP
        refuge = self._closed_room(item, item_room, rival)
        if refuge is None:
            if not holding and me in rival_way[1:-1]:
                return self._stand_in_door(state, rival_way)
            refuge = self._far_room(item, item_room, rival)
        if refuge is None:
            return Literal(Predicate.ON, self.opponent, rival, positive=False)
        if not holding:
            return self._take(state, item, observed)
        way = ability.route((self.agent, item), item_room, refuge)
        if way is None or len(way) < 2:
            return self._hold_back(item, item_room)
        return Literal(Predicate.CLOSE, item, way[1])

    def _hold_back(self, item: int, room: int) -> Literal:
        """Pull an item into the corner of its room; where that is the goal, off the goal."""
        if room == self._landmark_room(self.own.target):
            return self.own
        return Literal(Predicate.ON, item, room)

    def _rooms_to_take_to(self, item: int, item_room: int) -> list[int]:
        """Return the rooms, but for that of the goal, to which this agent can take an item."""
        goal_room = self._landmark_room(self.own.target)
        return [
            room
            for room in range(N_ROOMS)
            if room != goal_room
            and self.abilities.route((self.agent, item), item_room, room) is not None
        ]

    def _closed_room(self, item: int, item_room: int, rival: int) -> int | None:
        """Return a room to take an item to that is closed to the rival, if there is one."""
        for room in self._rooms_to_take_to(item, item_room):
            if self.abilities.route((self.opponent,), rival, room) is None:
                return room
        return None

    def _far_room(self, item: int, item_room: int, rival: int) -> int | None:
        """Return the room farthest from the rival among those nearer to the item than to it."""
        distance = self.abilities.room_distance
        nearer = [
            room
            for room in self._rooms_to_take_to(item, item_room)
            if distance[item_room][room] < distance[rival][room]
        ]
        return max(nearer, key=lambda room: distance[rival][room], default=None)

    def _stand_in_door(self, state: SymbolicState, rival_way: tuple[int, ...]) -> Literal:
        """Go to the nearest door on the rival's way that this agent can get to."""
        here = self._doors_of(state.rooms[self.agent])
        for door in reversed(self._doors(rival_way)):
            if door in here and self.abilities.walled[door]:
                return Literal(Predicate.CLOSE, self.agent, N_ROOMS + door)
        target = rival_way[-2] if len(rival_way) > 1 else rival_way[-1]
        return self._press_on(state, target)
