"""Agents: their beliefs, their subgoals and their next actions.

Source: paper, Algorithm 1, the inner loop. Policy and dynamics are separate: agents can be asked
in any true state; they never move the world.

What an agent sees and believes does not depend on its goal. A search depends only on the subgoal,
the particles that agree with it, and the actions. So :class:`Policies` of many sets of goals share
one filter of beliefs, and make each search once for all goals that need it. An :class:`Agent` has
one set of goals, and acts.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents import pomcp, symbols
from phase_ppl.agents.beliefs import Beliefs, Perception
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.standpoints import Group, Stance, grouped, standpoints
from phase_ppl.agents.subgoals import subgoal_planners
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import Action
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.goals import goal_literal, planned_as
from phase_ppl.world.names import AGENTS, STOP, Literal, PredicateKind

NO_INTENT = -1  # for impossible goals, and for goals that were not asked for


class Intent(NamedTuple):
    """An agent's subgoal and all else that its next action depends on."""

    subgoal: Literal  # the subgoal
    agreeing: tuple[int, ...]  # indices of the particles that agree with it
    contested: bool  # whether another agent wants the opposite, which allows more actions


class RootStatistics(NamedTuple):
    """What a search found at the root of its tree."""

    # (A,) actions considered; a single one, visited once, if no search is needed
    actions: IntArray
    visits: IntArray  # (A,) of the actions
    values: FloatArray  # (A,) mean returns, NaN if unvisited
    best: Action  # the action to take


def best_subgoal(
    agreeing: Mapping[Literal, Sequence[int]],
    costs: FloatArray,
    done: float,
    config: PlannerConfig,
    n_agents: int = len(AGENTS),
) -> Literal:
    """Return the subgoal of highest value V (paper, Algorithm 1).

    V(h) = share of the particles with subgoal h - lambda x their mean cost.

    Args:
        agreeing: subgoal -> particles for which it was planned.
        costs: (K,) cost C of each particle, units.
        done: share of the particles in which the agent's goal is reached.
        config: settings of the planner.
        n_agents: number of agents, which are the first entities.
    """
    if len(agreeing) == 1:
        return next(iter(agreeing))
    n = config.particles
    value = {
        subgoal: len(members) / n - config.cost_weight * costs[members].mean()
        for subgoal, members in agreeing.items()
    }
    candidates = sorted(value)
    # particles in which the goal is reached cost little, but must not end a search
    ends = not config.stops_when_done or (done > 0.5 and len(agreeing.get(STOP, ())) > n / 2)
    if not ends:
        candidates = [c for c in candidates if c != STOP]
    if config.touch_override:
        # the authors' code prefers touching, items first, then other agents
        touching = [c for c in candidates if c.predicate is PredicateKind.TOUCH and c.positive]
        if touching:
            return min(touching, key=lambda c: (c.target < n_agents, c.target))
    return max(candidates, key=value.__getitem__)


class Policies(Perception):
    """One agent's beliefs, and its intents under every possible set of effective goals.

    Args:
        agent, model, config: as in :class:`Perception`.
        seed: of beliefs and searches. With a whole number, each search has its own seed from that
            number, the step and the intent: its result does not depend on other searches. With a
            generator, the searches draw from it in turn.
        goals: sets of goals of all agents that can be asked for; None: all.

    Attributes:
        intents: intents at the last observation.
        intent_of: (standpoint,) index into ``intents``, or ``NO_INTENT``. The standpoints are those
            of :func:`~phase_ppl.agents.standpoints.standpoints`, or the given ``goals``.
    """

    def __init__(
        self,
        agent: int,
        model: WorldModel,
        config: PlannerConfig,
        seed: int | np.random.Generator,
        goals: Sequence[tuple[int, ...]] | None = None,
    ) -> None:
        self._seed = None if isinstance(seed, np.random.Generator) else seed
        generator = np.random.default_rng(seed if self._seed is None else [self._seed, agent])
        super().__init__(agent, model, config, generator)
        self._search = pomcp.SearchSettings.of(config)
        world = model.scene.world
        self._counts = len(world.entities), len(world.agents)
        if goals is None:
            every = standpoints(agent, world)
            self._standpoints, n = every.groups, every.n
        else:
            n = len(goals)
            self._standpoints = grouped(agent, goals, range(n), world)
        asked = {(agent, one.own) for one in self._standpoints}
        asked |= {
            (one.stance.other, other)
            for one in self._standpoints
            for other in one.others
            if one.stance.helps_along
        }
        self._rows = {goal: row for row, goal in enumerate(sorted(asked))}
        literals = [goal_literal(goal, holder, world) for holder, goal in self._rows]
        self._plans = [
            planned_as(literal, holder, model.scene)
            for literal, (holder, _) in zip(literals, self._rows, strict=True)
        ]
        # facts leave out the goal to be in a room; the rest does not depend on the place
        known = (
            plan._replace(predicate=PredicateKind.ON, target=0)
            if plan.predicate is PredicateKind.CLOSE
            else plan
            for plan in self._plans
        )
        self._codes = np.array([pomcp.subgoal_code(plan) for plan in known])
        self._users_goals = [
            (row, world.predicates[literal.target])
            for row, literal in enumerate(literals)
            if literal.predicate is PredicateKind.USERS
        ]
        particles = config.particles
        self._row = symbols.Facts(*self._counts)
        self._facts = np.zeros((particles, self._row.size), np.int8)
        self._done = np.zeros((len(asked), particles), np.bool_)
        self._costs = np.zeros((len(asked), particles))
        # only a user-defined predicate knows how far a place in a room is from its goal
        rooms = [plan.predicate is PredicateKind.CLOSE for plan in self._plans]
        self._whole = (config.cost == "plan") & ~np.array(rooms, np.bool_)
        self._groups: dict[bytes, list[tuple[symbols.SymbolicState, list[int]]]] = {}
        self._step = 0
        self.intents: list[Intent] = []
        self.intent_of = np.full(n, NO_INTENT)

    def observe(
        self, bodies: FloatArray, held: IntArray, weld: FloatArray, wanted: BoolArray | None = None
    ) -> None:
        """Observe the true state; update beliefs and intents.

        Args:
            bodies, held, weld: as in :meth:`Perception.observe`.
            wanted: (standpoint,) whether its intent is needed; None: all are.
        """
        self._step += 1
        super().observe(bodies, held, weld)
        self._describe()
        self._planner = subgoal_planners(self.agent, self.model.abilities)
        found: dict[Intent, int] = {}
        self.intent_of[:] = NO_INTENT
        for one in self._standpoints:
            chosen = [
                (other, place)
                for other, place in zip(one.others, one.places, strict=True)
                if wanted is None or wanted[place]
            ]
            for same in self._by_done(chosen, one.stance) if one.stance.helps_along else [chosen]:
                if same:
                    intent = self._intent(one, same[0][0])
                    places = [place for _, place in same]
                    self.intent_of[places] = found.setdefault(intent, len(found))
        self.intents = list(found)

    def _describe(self) -> None:
        """Describe the particles in symbols; group those that differ only in goals reached."""
        beliefs, model = self.beliefs, self.model
        symbols.describe(
            *(beliefs.bodies, beliefs.held, self.agent, self._codes, self._whole),
            *(model.params, model.layout, self._facts, self._done, self._costs),
        )
        self._describe_users_goals()
        rows = self._facts.view(f"V{self._row.size}").ravel().tolist()
        places: dict[bytes, int] = {}
        self._kind = np.array([places.setdefault(row, len(places)) for row in rows])
        self._facts_of_kind = list(places)
        self._observed = tuple(beliefs.observed.tolist())
        self._groups = {}

    def _describe_users_goals(self) -> None:
        """Note where user-defined predicates are reached, and the path lengths into rooms."""
        if not self._users_goals:
            return
        (bodies, held), scene = (self.beliefs.bodies, self.beliefs.held), self.model.scene
        angle, cog = bodies[..., 2], self.model.params.cog
        origin = bodies[..., :2] + np.stack([np.sin(angle), -np.cos(angle)], -1) * cog[:, None]
        for row, predicate in self._users_goals:
            planned = self._plans[row]
            self._done[row] = predicate.is_content(origin, scene)
            if planned.predicate is PredicateKind.CLOSE and planned.positive:
                near = planned.subject == self.agent or held[:, self.agent] == planned.subject
                way = predicate.apart(origin, scene)
                leg = self._costs[row]
                rest = leg + way if self.config.cost == "plan" else leg
                self._costs[row] = np.where(near, way, rest)

    def _by_done(
        self, others: Iterable[tuple[int, int]], stance: Stance
    ) -> Iterable[list[tuple[int, int]]]:
        """Return the other's goals with their standpoints; goals reached alike are together."""
        classes: dict[bytes, list[tuple[int, int]]] = defaultdict(list)
        for other in others:
            done = self._done[self._rows[stance.other, other[0]]]
            classes[done.tobytes()].append(other)
        return classes.values()

    def _intent(self, one: Group, other: int) -> Intent:
        """Return the agent's intent for its own goal and the other's."""
        row, stance = self._rows[self.agent, one.own], one.stance
        done = self._done[row]
        kinds = 4 * self._kind + 2 * done
        if stance.helps_along:
            # helping along depends on whether the other has reached its goal
            kinds += self._done[self._rows[stance.other, other]]
        planner = self._planner(
            self._plans[row], stance, one.literal.predicate is PredicateKind.USERS
        )
        agreeing: dict[Literal, list[int]] = defaultdict(list)
        for state, members in self._grouped(kinds):
            agreeing[planner.subgoal(state, self._observed)] += members
        for members in agreeing.values():
            members.sort()
        share = np.count_nonzero(done) / len(done)
        best = best_subgoal(agreeing, self._costs[row], share, self.config, self._counts[1])
        return Intent(best, tuple(agreeing[best]), stance.contested)

    def _grouped(self, kinds: IntArray) -> list[tuple[symbols.SymbolicState, list[int]]]:
        """Return the symbolic states among the particles, and the particles in each.

        Args:
            kinds: (K,) 4 x index into ``_facts_of_kind`` + 2 x own goal reached + other's.
        """
        key = kinds.tobytes()
        if key not in self._groups:  # most goals are reached in the same particles: none
            members: dict[int, list[int]] = defaultdict(list)
            for particle, kind in enumerate(kinds.tolist()):
                members[kind].append(particle)
            self._groups[key] = [
                (
                    self._row.unpack(
                        self._facts_of_kind[kind >> 2], bool(kind & 2), bool(kind & 1)
                    ),
                    particles,
                )
                for kind, particles in members.items()
            ]
        return self._groups[key]

    def searches(self) -> list[list[int]]:
        """Return the indices of intents in groups that differ only in the subgoal.

        The searches of a group share their playouts; see :mod:`phase_ppl.agents.pomcp`.
        """
        groups: dict[tuple[tuple[int, ...], bytes], list[int]] = defaultdict(list)
        for place, intent in enumerate(self.intents):
            groups[intent.agreeing, self._considered(intent).tobytes()].append(place)
        return list(groups.values())

    def root_statistics(self, intents: Sequence[Intent]) -> list[RootStatistics]:
        """Return the planner's results for intents; this is the only random part of a decision.

        Args:
            intents: one, or a group of :meth:`searches`. The results are as for each alone.
        """
        actions = self._considered(intents[0])
        if len(actions) > 1:
            return self._search_actions(intents, actions)
        once = np.ones(1, np.int64)
        reflex = RootStatistics(actions, once, np.full(1, np.nan), Action(int(actions[0])))
        return [reflex for _ in intents]

    def _considered(self, intent: Intent) -> IntArray:
        """Return the actions to search among, or one action that needs no search.

        Stopping, letting go, and grabbing an item in reach need none.
        """
        subgoal, first = intent.subgoal, intent.agreeing[0]
        bodies, held = self.beliefs.bodies[first], self.beliefs.held[first]
        if subgoal == STOP:
            return np.array([Action.STOP])
        if subgoal.predicate is PredicateKind.ATTACH:
            if not subgoal.positive:
                return np.array([Action.DETACH])
            # an agent that holds something cannot grab
            if compiled.find_grab(bodies, held, self.agent, self.model.params)[0] == subgoal.target:
                return np.array([Action.ATTACH])
        return pomcp.actions_for(
            subgoal, self.agent, int(held[self.agent]), intent.contested, self._counts[1]
        )

    def _search_actions(self, intents: Sequence[Intent], actions: IntArray) -> list[RootStatistics]:
        """Search for the best of ``actions``, on the particles that agree with each subgoal."""
        beliefs, model, found = self.beliefs, self.model, []
        playouts = pomcp.make_playouts(self._search, len(intents), *self._counts)
        scratch = compiled.make_scratch(*self._counts)
        agreeing = np.array(intents[0].agreeing)
        for intent in intents:
            tree = pomcp.make_tree(self.config.simulations, *self._counts)
            best = pomcp.run(
                *(tree, playouts, beliefs.bodies, beliefs.held, beliefs.weld, agreeing),
                *(self.agent, pomcp.subgoal_code(intent.subgoal), actions, self._search),
                *(model.params, model.layout, scratch, self._rng(intent)),
            )
            children = tree.child[0, : len(actions)]
            visited = children >= 0
            visits = np.where(visited, tree.visits[children], 0).astype(np.int64)
            values = np.where(visited, tree.total[children] / np.maximum(visits, 1), np.nan)
            found.append(RootStatistics(actions, visits, values, Action(int(actions[best]))))
        return found

    def _rng(self, intent: Intent) -> NDArray[np.uint64]:
        if self._seed is None:
            return self.rng
        # subgoals share random numbers too, so that they are compared like with like
        text = repr((self._seed, self.agent, self._step, intent.agreeing))
        digest = hashlib.blake2b(text.encode(), digest_size=8).digest()
        return np.frombuffer(digest, np.uint64).copy()


class Decision(NamedTuple):
    """An agent's action, and its reasons."""

    intent: Intent  # its intent
    root: RootStatistics  # the planner's result for it
    held: int  # item that it holds when it decides, or ``NOTHING``
    beliefs: Beliefs  # its particles, valid until it decides again

    @property
    def action(self) -> Action:
        """The action to carry out."""
        return self.root.best


class Agent(Policies):
    """An agent that knows the goals of all: it has one intent, and acts on it.

    Args:
        goals: effective goals of all agents, indices into the world's.
        agent, model, config, generator: as in :class:`Perception`.
    """

    def __init__(
        self,
        agent: int,
        goals: tuple[int, ...],
        model: WorldModel,
        config: PlannerConfig,
        generator: np.random.Generator,
    ) -> None:
        super().__init__(agent, model, config, generator, [goals])

    @property
    def intent(self) -> Intent:
        """The intent at the last observation: the subgoal of highest value V."""
        return self.intents[0]

    def decide(self, bodies: FloatArray, held: IntArray, weld: FloatArray) -> Decision:
        """Observe the true state, update the beliefs, and choose subgoal and action."""
        self.observe(bodies, held, weld)
        (root,) = self.root_statistics(self.intents)
        self.acted(root.best)
        return Decision(self.intent, root, int(held[self.agent]), self.beliefs)

    def look(self, bodies: FloatArray, held: IntArray, weld: FloatArray, action: Action) -> None:
        """Observe a past state, and note the action taken then, without a decision."""
        self.observe(bodies, held, weld, np.zeros_like(self.intent_of, np.bool_))
        self.acted(action)


def all_agents(
    goals: tuple[int, ...], model: WorldModel, config: PlannerConfig, rng: np.random.Generator
) -> list[Agent]:
    """Return all agents, each with its own random numbers; arguments as for ``Agent``."""
    return [Agent(agent, goals, model, config, rng.spawn(1)[0]) for agent in range(len(goals))]
