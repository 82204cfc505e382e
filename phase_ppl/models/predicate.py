"""Predicate inverse planning (paper, Appendix "Predicate Inverse Planning"): goals from symbols.

A video becomes a symbolic trajectory: the predicates that hold in each frame. A forward model gives
its probability for an agent with a goal. Inverting it gives P(goals | trajectory). There is no
physics.

The predicates are those of the paper's table, as SIMPLE's planner uses them. CLOSE(entity,
landmark): in that landmark's room (without inner walls, its quarter of the arena). ATTACH: inferred
from the tracks. TOUCH: near enough to stop or to grab. ON: near enough to count as arrived. In
other worlds CLOSE means being in a room, with or without a landmark.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import shortest_path

from phase_ppl.agents.symbols import (
    GRIP_COST,
    NEAR_AGENT_ON,
    NEAR_ITEM_ON,
    NEAR_TOUCH,
    PLACE_COST,
    TOUCH_COST,
)
from phase_ppl.agents.world_model import Abilities
from phase_ppl.data.motion import HELD_WITHIN, items_held
from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    check_name,
    nonnegative_number,
    number_or_nan,
    positive_number,
    shown,
    whole_number,
)
from phase_ppl.world.event import Observation
from phase_ppl.world.geometry import GRAB_POINTS, GRAB_REACH
from phase_ppl.world.goals import goal_literal, possible_goals
from phase_ppl.world.hypothesis import RELATION_TABLE, RELATIONS
from phase_ppl.world.names import NOTHING, STOP, Literal, PredicateKind
from phase_ppl.world.scene import PHASE, Scene
from phase_ppl.world.space import space_of

FACTOR: Final = 3.0
"""Factor by which the thresholds of ON, and of TOUCH for items, exceed those of SIMPLE's planner:
recorded agents stop a little short. Chosen on half of 50 real videos
(``benchmarks/predicate.py``)."""


@dataclasses.dataclass(frozen=True)
class PredicateSettings:
    """Thresholds of predicates, in units, and the rationality of agents.

    By default thresholds are those of SIMPLE's planner, up to :data:`FACTOR`.

    Raises:
        InvalidSettingError: a value outside its range.
    """

    # ON(agent, landmark): from its centre to the landmark's centre
    on_agent: float = FACTOR * NEAR_AGENT_ON
    on_item: float = FACTOR * NEAR_ITEM_ON  # ON(item, landmark): likewise
    touch_agent: float = NEAR_TOUCH  # TOUCH(agent, agent): from centre to centre
    # TOUCH(agent, item): from a grab point of the agent to the item's rim. As for the planner, they
    # touch only in the same room
    touch_item: float = FACTOR * GRAB_REACH
    # ATTACH(agent, item): largest distance of the item from its place at a grab point, for three
    # frames
    attach: float = HELD_WITHIN
    lasting: int = 3  # frames for which a predicate must hold, or not hold, to count
    rationality: float = 0.8  # inverse temperature, per unit of path length; 0 is pure chance
    operator_frames: float = 12.0  # mean frames that an operator takes, more than 1
    # cost of waiting while something is left to do, units of path length
    wait_cost: float = 2 * TOUCH_COST
    lapse: float = 0.02  # probability of a random operator, in (0, 1)

    def __post_init__(self) -> None:
        whole_number("lasting", self.lasting)
        for name in ("rationality", "wait_cost"):
            nonnegative_number(name, getattr(self, name))
        for name in ("on_agent", "on_item", "touch_agent", "touch_item", "attach"):
            positive_number(name, getattr(self, name))
        if not number_or_nan(self.operator_frames) > 1:
            raise InvalidSettingError(
                f"operator_frames={shown(self.operator_frames)}, expected a number > 1"
            )
        if not 0 < number_or_nan(self.lapse) < 1:
            raise InvalidSettingError(f"lapse={shown(self.lapse)}, expected a number in (0, 1)")


class Moment(NamedTuple):
    """The predicates that hold at one moment."""

    rooms: tuple[int, ...]  # CLOSE: the room of each entity; in PHASE each has a landmark
    held: tuple[int, ...]  # ATTACH: item that each agent holds, or ``NOTHING``
    near: tuple[tuple[bool, ...], ...]  # TOUCH: per agent, whether it touches each entity
    on: tuple[int, ...]  # ON: the landmark of its room that each entity is on, or ``NOTHING``


def symbolic_trajectory(
    scene: Scene, observation: Observation, settings: PredicateSettings | None = None
) -> list[Moment]:
    """Return the symbolic state of every frame."""
    given = settings or PredicateSettings()
    trajectory = observation.whole("predicate-based inverse planning").trajectory
    found = (
        scene.rooms.room_of(trajectory[..., :2]),
        items_held(trajectory, scene.radius, given.attach, len(scene.world.agents)),
        _near(trajectory, scene, given),
        _on(trajectory, scene, given),
    )
    frames = (_lasting(values, given.lasting).tolist() for values in found)
    return [
        Moment(tuple(rooms), tuple(held), tuple(map(tuple, near)), tuple(on))  # type: ignore[arg-type]
        for rooms, held, near, on in zip(*frames, strict=True)
    ]


def _near(trajectory: FloatArray, scene: Scene, given: PredicateSettings) -> BoolArray:
    """Return (time, agent, entity): TOUCH."""
    n, place, angle = len(scene.world.agents), trajectory[..., :2], trajectory[:, :, 2]
    agents, items = place[:, :n], place[:, n:]
    near = np.zeros((*agents.shape[:2], place.shape[1]), bool)
    apart = np.linalg.norm(agents[:, :, None] - agents[:, None], axis=-1)
    near[..., :n] = (apart < given.touch_agent) & ~np.eye(n, dtype=bool)
    x, y = np.moveaxis(GRAB_POINTS * scene.radius[:n, None, None], -1, 0)  # agent, grab point
    cos, sin = np.cos(angle[:, :n, None]), np.sin(angle[:, :n, None])
    points = agents[:, :, None] + np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    distance = np.linalg.norm(points[:, :, :, None] - items[:, None, None], axis=-1)
    near[..., n:] = (distance < scene.radius[n:] + given.touch_item).any(axis=2)
    rooms = scene.rooms.room_of(place)
    return near & (rooms[:, :n, None] == rooms[:, None])


def _on(trajectory: FloatArray, scene: Scene, given: PredicateSettings) -> NDArray[np.int64]:
    """Return (time, entity): ON, the landmark or ``NOTHING``."""
    place, centres = trajectory[..., :2], scene.landmark_centres
    apart = np.linalg.norm(place[:, :, None] - centres, axis=-1)
    limit = np.full(place.shape[1], given.on_item)
    limit[: len(scene.world.agents)] = given.on_agent
    inside = scene.rooms.room_of(place)[..., None] == scene.rooms.room_of(centres)
    apart = np.where(inside & (apart < limit[:, None]), apart, np.inf)
    return np.where(np.isfinite(apart.min(axis=-1)), apart.argmin(axis=-1), NOTHING)


def _lasting(values: NDArray[Any], frames: int) -> NDArray[Any]:
    """Return series (time, ...) in which runs below ``frames`` keep the value before them."""
    result = values.reshape(len(values), -1).copy()
    for series in result.T:
        edges = np.flatnonzero(series[1:] != series[:-1]) + 1
        for start, end in itertools.pairwise([*edges.tolist(), len(series)]):
            if end - start < frames:
                series[start:end] = series[start - 1]
    return result.reshape(values.shape)


# --- symbolic operators, and the cost to reach a goal ---------------------------------------------

# The operators are those of SIMPLE's subgoal planner (:mod:`phase_ppl.agents.symbols`), without
# limits of bodies: agents pass every door, close none, and carry any item alone. Costs are the
# planner's too: path lengths between rooms, and constants for touching, gripping and placing.

_TIE: Final = 1e-6


class Layout(NamedTuple):
    """Rooms and landmarks of a scene."""

    distance: tuple[tuple[float, ...], ...]  # (room, room) length of the shortest way
    step: list[list[float]]  # (room, room) the same between two that a door joins, else inf
    way: list[list[float]]  # (room, room) the sum of the steps from one to the other
    landmark_rooms: tuple[int, ...]  # (landmark,) the room that each is in
    landmark_in: tuple[int, ...]  # (room,) a landmark that is in each, or ``NOTHING``
    n_agents: int

    @classmethod
    def of(cls, scene: Scene) -> Layout:
        """Return the layout of a scene."""
        known = Abilities.of(scene, (math.inf,) * len(scene.world.agents))
        step = np.full((len(known.neighbours),) * 2, np.inf)
        for room, exits in enumerate(known.neighbours):
            for _, following in exits:
                step[room, following] = known.room_distance[room][following]
        ways = step.tolist(), shortest_path(step).tolist()
        landmarks = known.landmark_rooms, known.landmark_in
        return cls(known.room_distance, *ways, *landmarks, len(scene.world.agents))


def operators(state: Moment, agent: int, layout: Layout) -> Iterator[tuple[Literal, float, Moment]]:
    """Yield an agent's operators: the literal made true, its cost, and the state after it.

    A carried item moves with its holder, and so do other agents that hold it. An agent that moves
    alone, or touches something else, loses touch with what it touched.
    """
    rooms, held, near, on = state
    item = held[agent]
    movers = [agent]
    if item != NOTHING:
        movers = [item, *(one for one, thing in enumerate(held) if thing == item)]
    mover, here = movers[0], rooms[movers[0]]

    def at(*touched: int) -> tuple[tuple[bool, ...], ...]:
        return _put(near, tuple(entity in touched for entity in range(len(rooms))), agent)

    if all(math.isfinite(layout.way[rooms[one]][here]) for one in movers):
        touch = at() if item == NOTHING else near
        for following, length in enumerate(layout.step[here]):
            if math.isfinite(length):
                there = _put(rooms, following, *movers), held, touch, _put(on, NOTHING, *movers)
                yield Literal(PredicateKind.CLOSE, mover, following), length, Moment(*there)
        landmark = layout.landmark_in[here]
        if landmark not in (NOTHING, on[mover]):
            placed = state._replace(on=_put(on, landmark, mover))
            yield Literal(PredicateKind.ON, mover, landmark), PLACE_COST, placed
    if item != NOTHING:
        free = state._replace(held=_put(held, NOTHING, agent), near=at(item))
        yield Literal(PredicateKind.ATTACH, agent, item, positive=False), GRIP_COST, free
        return
    for entity, touches in enumerate(near[agent]):
        if touches and entity >= len(held):
            gripped = state._replace(held=_put(held, entity, agent))
            yield Literal(PredicateKind.ATTACH, agent, entity), GRIP_COST, gripped
        elif not touches and entity != agent and rooms[entity] == here:
            yield (
                Literal(PredicateKind.TOUCH, agent, entity),
                TOUCH_COST,
                state._replace(near=at(entity)),
            )


def _put(values: tuple, value: object, *places: int) -> tuple:  # type: ignore[type-arg]
    return tuple(value if place in places else one for place, one in enumerate(values))


class CostToGo:
    """Cost of an agent's cheapest plan to fulfil the symbolic meaning of its goal.

    =====================  =================================================================
    goal                   done when
    =====================  =================================================================
    ON(self | item, l)     it is on the landmark
    TOUCH(self, other)     it touches the other
    ON(other, l)           always: the other goes by itself
    not ON(self, l)        it is in the room farthest from the landmark
    not TOUCH(self, other) it is in the room farthest from the other's
    not ON(item, l)        it holds the item in the room farthest from the landmark
    not ON(other, l)       it touches the other: without physics agents can only hinder
                           by touching
    TOUCH(other, item)     the item is in the other's room
    TOUCH(other, third)    always: they go by themselves
    not TOUCH(self, item)  it is in the room farthest from the item's
    not TOUCH(other, item) it holds the item in the room farthest from the other's
    not TOUCH(other, ...)  of a third agent: it touches the other
    =====================  =================================================================

    The farthest room is the farthest reachable one; an unreachable room counts as farthest of all.
    If a room has several landmarks, only the goal's own counts for ON.

    Agents pass all doors. So a plan is one or two paths between rooms, with letting go, touching,
    gripping and placing.

    Args:
        layout: of the scene.
        agent: number of the planning agent.
        goal: literal of its effective goal.
    """

    def __init__(self, layout: Layout, agent: int, goal: Literal) -> None:
        self.agent, self.goal = agent, goal
        predicate, subject, target, positive = goal
        touch, n_agents = predicate is PredicateKind.TOUCH, layout.n_agents
        if predicate is PredicateKind.ON:
            room = layout.landmark_rooms[target]
            layout = layout._replace(landmark_in=_put(layout.landmark_in, target, room))
        self.layout = layout
        self._by_others = agent != subject < n_agents
        item = target if touch and self._by_others else subject
        self._item = item if item >= n_agents else NOTHING  # that the agent is to move
        if self._item != NOTHING:
            self._focus = self._item
        elif self._by_others:
            self._focus = NOTHING if positive else subject
        else:
            self._focus = target if touch and positive else NOTHING
        # that is the entity that the agent has to be at for the goal

    def __call__(self, state: Moment) -> float:
        """Return the cost, units of path length; inf: there is no plan."""
        agent, (predicate, subject, target, positive) = self.agent, self.goal
        way, start, touch = self.layout.way, state.rooms[agent], predicate is PredicateKind.TOUCH
        held, touched = state.held[agent], state.near[agent]
        free = 0.0 if held == NOTHING else GRIP_COST  # to have nothing in hand
        if touch:  # the room that the goal is about
            room = state.rooms[subject if self._by_others else target]
        else:
            room = self.layout.landmark_rooms[target]
        if self._item == NOTHING:
            if self._focus != NOTHING:
                if touched[self._focus]:
                    return 0.0
                return GRIP_COST if self._focus == held else free + self._to_focus(state)
            if positive and self._by_others:
                return 0.0
            if not positive:
                return self._to_farthest(room, start, free)
            return 0.0 if state.on[agent] == target else free + way[start][room] + PLACE_COST
        # an item is moved by its holder
        lies = state.rooms[self._item]
        if held == self._item:
            grip = 0.0
        elif held == NOTHING and touched[self._item]:
            grip = GRIP_COST
        else:
            grip = free + self._to_focus(state) + GRIP_COST
        apart = 0.0 if math.isfinite(way[start][lies]) else math.inf  # a wall between them
        if not positive:
            return grip + self._to_farthest(room, lies, apart)
        if (lies == room) if touch else (state.on[self._item] == target):
            return 0.0
        return grip + apart + way[lies][room] + (0.0 if touch else PLACE_COST)

    def _to_focus(self, state: Moment) -> float:
        return self.layout.way[state.rooms[self.agent]][state.rooms[self._focus]] + TOUCH_COST

    def _to_farthest(self, room: int, start: int, before: float) -> float:
        """Return the cost of going from ``start`` to the reachable room farthest from ``room``.

        A room without a path to ``room`` counts as farthest. An agent that is there already does
        not pay the cost ``before``.
        """
        distance = self.layout.distance
        there = [r for r in range(len(distance)) if math.isfinite(distance[start][r])]
        most = max(distance[room][r] for r in there)
        left = min(self.layout.way[start][r] for r in there if distance[room][r] >= most - _TIE)
        return before + left if left > 0 else 0.0


# --- the forward model: probability of a symbolic trajectory given a goal -------------------------

# In each frame an agent completes an operator with probability h = 1 / ``operator_frames``, else
# nothing happens. The choice of operator is boundedly rational. With cost to go C after it,
#
# P(o | state, g) = (1 - lapse) exp(-rationality Q(o)) / Z + lapse / n, Q(o) = cost(o) + C(o, g),
#
# over the n operators of the planner in that state, including waiting. Waiting costs ``wait_cost``
# while something is left to do, otherwise nothing. It cannot be told from completing nothing. A
# change that no operator of the agent explains has only the lapse. Facts that no agent causes (a
# pushed item, a holder's place) are given.


def own_changes(before: Moment, after: Moment, agent: int) -> Iterator[tuple[Moment, Literal]]:
    """Yield an agent's operators between two frames, each after the state in which it acted.

    The order is letting go, going to a room, touching, gripping, arriving. Gripping implies
    touching. An agent that holds an item goes and arrives with it, and so do two that hold the same
    item. A predicate that ceases to hold, other than by letting go, is no operator of its own: it
    comes with going on.
    """
    had, has = before.held[agent], after.held[agent]
    state = before
    if had not in (NOTHING, has):
        yield state, Literal(PredicateKind.ATTACH, agent, had, positive=False)
        state = _touching(state, agent, had)._replace(held=_put(state.held, NOTHING, agent))
    mover = agent if state.held[agent] == NOTHING else state.held[agent]
    if after.rooms[mover] != before.rooms[mover]:
        yield state, Literal(PredicateKind.CLOSE, mover, after.rooms[mover])
        state = state._replace(on=_put(state.on, NOTHING, mover))
        still = [was and yes for was, yes in zip(state.near[agent], after.near[agent], strict=True)]
        state = state._replace(near=_put(state.near, tuple(still), agent))
    state = state._replace(rooms=after.rooms)
    if state.held[agent] == NOTHING:
        for entity in range(len(state.rooms)):
            touches = after.near[agent][entity] or entity == has
            if touches and not state.near[agent][entity]:
                yield state, Literal(PredicateKind.TOUCH, agent, entity)
                state = _touching(state, agent, entity)
    if has not in (NOTHING, had):
        yield state, Literal(PredicateKind.ATTACH, agent, has)
        state = state._replace(held=after.held)
    mover = agent if has == NOTHING else has
    if after.on[mover] not in (NOTHING, state.on[mover]):
        yield state, Literal(PredicateKind.ON, mover, after.on[mover])


def _touching(state: Moment, agent: int, entity: int) -> Moment:
    return state._replace(near=_put(state.near, _put(state.near[agent], True, entity), agent))


class ForwardModel:
    """Probabilities of symbolic trajectories in one scene; only its layout matters."""

    def __init__(self, scene: Scene, settings: PredicateSettings | None = None) -> None:
        self.settings = settings or PredicateSettings()
        for one in scene.world.predicates:
            raise InvalidSettingError(
                f"predicate inverse planning knows no user-defined predicates, such as {one.name!r}"
            )
        layout, self._world = Layout.of(scene), scene.world
        self._cost_to_go = {
            (agent, goal): CostToGo(layout, agent, goal_literal(goal, agent, self._world))
            for agent in range(len(self._world.agents))
            for goal in possible_goals(agent, self._world)
        }
        # goals differ mostly in landmarks: they share operators
        self._operators = functools.cache(
            lambda state, agent, landmarks: list(
                operators(state, agent, layout._replace(landmark_in=landmarks))
            )
        )
        self.policy = functools.cache(self._policy)

    def _policy(self, state: Moment, agent: int, goal: int) -> dict[Literal, float]:
        """Return P(operator | state, goal) by the literal that the operator makes true, sum 1.

        ``STOP`` is waiting; ``goal`` is the index of the effective goal.
        """
        given, left_after = self.settings, self._cost_to_go[agent, goal]
        left, landmarks = left_after(state), left_after.layout.landmark_in
        costs = {STOP: left + (given.wait_cost if left > 0 else 0.0)}
        for literal, cost, after in self._operators(state, agent, landmarks):
            costs[literal] = cost + left_after(after)
        # without a plan to the goal all operators are equally good
        least = min(costs.values())
        weights = {  # costs may be infinite
            literal: 1.0
            if given.rationality == 0 or cost == least
            else math.exp(-given.rationality * (cost - least))
            for literal, cost in costs.items()
        }
        total, even = sum(weights.values()), given.lapse / len(weights)
        return {
            literal: (1 - given.lapse) * weight / total + even
            for literal, weight in weights.items()
        }

    def log_likelihood(self, trajectory: Sequence[Moment]) -> FloatArray:
        """Return (agent, goal) log P(trajectory | goal), 0 for goals that name their holder.

        Given the past of both, each agent's operators depend on its own goal only. So the log
        probability given a pair of goals is the sum of the two.
        """
        found = np.zeros((len(self._world.agents), len(self._world.goals)))
        for agent, goal in self._cost_to_go:
            found[agent, goal] = sum(
                self._log_step(before, after, agent, goal)
                for before, after in itertools.pairwise(trajectory)
            )
        return found

    def _log_step(self, before: Moment, after: Moment, agent: int, goal: int) -> float:
        completes = 1 / self.settings.operator_frames
        did = [] if before == after else list(own_changes(before, after, agent))
        if not did:
            return math.log(1 - completes + completes * self.policy(before, agent, goal)[STOP])
        total = 0.0
        for state, literal in did:
            policy = self.policy(state, agent, goal)
            unexplained = self.settings.lapse / len(policy)
            total += math.log(completes * policy.get(literal, unexplained))
        return total


# --- the inversion of the forward model -----------------------------------------------------------

# P(g_red, g_green | tau) ~ P(tau | g_red) P(tau | g_green) P(g_red, g_green) (paper, Appendix
# "Predicate Inverse Planning"), over all pairs of effective goals. The paper says "a prior over
# goals, often uniform". Under SIMPLE's prior each agent's effective goal is uniform over its 34
# possible goals, but the two are correlated: 2 of 3 times one agent helps or hinders the other.
# That is the default, so the two models differ in physics only. The alternative,
# :data:`INDEPENDENT`, is uniform over pairs.

INDEPENDENT: Final = "independent"
"""Name of the uniform prior over pairs of effective goals."""

AS_THE_PAPER: Final[Mapping[str, Any]] = {
    "prior": INDEPENDENT,
    **{"on_agent": NEAR_AGENT_ON, "on_item": NEAR_ITEM_ON, "touch_item": GRAB_REACH},
}
"""The paper's P(g), and SIMPLE's planner's thresholds of predicates."""


def posterior(log_likelihood: FloatArray, log_prior: FloatArray) -> dict[str, FloatArray]:
    """Return the probabilities of goals and relation, by question.

    ``log_likelihood`` is (agent, goal) log P(trajectory | goal); ``log_prior`` is over pairs.
    """
    log_joint = log_likelihood[0][:, None] + log_likelihood[1] + log_prior
    joint = np.exp(log_joint - log_joint.max())
    joint /= joint.sum()
    relation = np.array([joint[index == RELATION_TABLE].sum() for index in range(len(RELATIONS))])
    return {"goal_red": joint.sum(axis=1), "goal_green": joint.sum(axis=0), "relation": relation}


@functools.cache
def log_prior_of_pairs(name: str) -> FloatArray:
    """Return the normalised log prior (goal of red, goal of green) of pairs of effective goals.

    ``name`` is :data:`INDEPENDENT`, or a prior of SIMPLE (:mod:`phase_ppl.models.priors`).
    """
    if name == INDEPENDENT:
        red, green = ~space_of(PHASE).impossible
        prior = np.where(red[:, None] & green, 1.0, 0.0)
    else:
        from phase_ppl.models import priors
        from phase_ppl.models.effective import prior_of_pairs

        check_name("prior", name, [INDEPENDENT, *priors.available()])
        prior = prior_of_pairs(priors.named(name))
    with np.errstate(divide="ignore"):
        log_prior = np.log(prior / prior.sum())
    log_prior.flags.writeable = False
    return log_prior
