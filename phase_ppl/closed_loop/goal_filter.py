"""One pass through a video: what its agents would do, and what they did.

p(s_t+1 | s_<=t, h) = sum over joint actions a of prod_i pi_i(a_i | h) p(s_t+1 | T(s_t, a)), with
the policies pi of the joint simulator's agents at what was observed, and T one step of its physics.

A policy is known from a search only, which depends on chance, and so do the beliefs from which it
starts. Therefore each pi is a mean over several independent sets of beliefs and searches, taken
inside the logarithm: the log of one noisy policy is too low, and says too much of single frames.

Each agent's policy depends on its standpoint only (:mod:`phase_ppl.agents.standpoints`), and most
standpoints lead to the same intent: so a frame is kept as the few policies of each agent, the
number of the policy of each standpoint, and the density of the frame after every joint action.
What that says of hypotheses is worked out where it is asked
(:mod:`phase_ppl.analysis.closed_loop_table`).
"""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phase_ppl.agents.agent import NO_INTENT, Policies, RootStatistics
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.standpoints import standpoints
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.closed_loop.frame_likelihood import log_likelihoods, shift_of
from phase_ppl.closed_loop.hidden_state import (
    Expected,
    HiddenState,
    Tracking,
    most_probable_actions,
)
from phase_ppl.physics.actions import N_ACTIONS, Action
from phase_ppl.simulator.joint import scene_in_reach
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.names import NOTHING
from phase_ppl.world.scene import Scene


class Plans(NamedTuple):
    """One agent's plans at one moment, by one set of beliefs and searches."""

    roots: list[RootStatistics]  # of every intent, what its search found
    # (standpoint,) index of the intent, or ``NO_INTENT``; ``agents.standpoints`` numbers them
    intent_of: IntArray


class ActionPolicy(NamedTuple):
    """How agents act on their plans: a softmax policy with lapses."""

    inverse_temperature: float  # exponent of a search's root visits, an inverse temperature
    lapse: float  # probability, by frame, that an agent does anything whatever

    def of(self, root: RootStatistics) -> FloatArray:
        """Return (action,) probabilities of an agent, from what its search found.

        pi = (1 - lapse) visits^inverse_temperature / Z + lapse / |A|
        """
        found = np.full(N_ACTIONS, self.lapse / N_ACTIONS)
        share = (root.visits / root.visits.max()) ** self.inverse_temperature
        found[root.actions] += (1.0 - self.lapse) * share / share.sum()
        return found


class SearchSets:
    """What every agent would do given the frames so far, found ``n`` times independently.

    Each set plans with strengths of its own, which together stand for what is believed of them. At
    most ``threads`` are at work at a time; the result does not depend on it.

    Attributes:
        hidden: filter of velocities, holds and strengths, whose ``advance`` takes in a frame.
    """

    def __init__(
        self,
        scene: Scene,
        planner: PlannerConfig,
        tracking: Tracking,
        seed: int = 0,
        threads: int = 1,
        n: int = 1,
    ) -> None:
        self.scene, self._planner = scene, planner
        self.hidden = HiddenState(scene, tracking, threads)
        self._models: dict[tuple[float, ...], WorldModel] = {}
        more = (np.random.SeedSequence([seed, place]) for place in range(1, n))
        seeds = [seed, *(int(one.generate_state(1, np.uint64)[0]) for one in more)]
        self._policies = [
            [
                Policies(agent, self._model(expected.strengths), planner, own_seed)
                for agent in range(len(scene.world.agents))
            ]
            for expected, own_seed in zip(self.hidden.spread(n), seeds, strict=True)
        ]
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def __len__(self) -> int:
        return len(self._policies)

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def map(self, function: Callable[..., Any], tasks: Iterable[Any]) -> Iterator[Any]:
        """Return the function's results, in order, from the threads if there are any."""
        return map(function, tasks) if self._pool is None else self._pool.map(function, tasks)

    def plans(self, wanted: Sequence[BoolArray] | None = None) -> list[list[Plans]]:
        """Return (set, agent) what the planners make of what was seen so far.

        Args:
            wanted: (agent) (standpoint,) those for which all sets search; for the rest there is
                the first set alone. None: all sets search for all.
        """

        def observe(task: tuple[Policies, Expected, BoolArray | None]) -> None:
            policies, expected, asked = task
            policies.observe(expected.bodies, expected.held, expected.weld, asked)

        def search(task: tuple[Policies, list[int]]) -> list[RootStatistics]:
            policies, group = task
            return policies.root_statistics([policies.intents[place] for place in group])

        observing = []
        for place, expected in enumerate(self.hidden.spread(len(self._policies))):
            for agent, policies in enumerate(self._policies[place]):
                policies.model = self._model(expected.strengths)
                asked = None if wanted is None or place == 0 else wanted[agent]
                observing.append((policies, expected, asked))
        list(self.map(observe, observing))
        searches = [(one, group) for one, _, _ in observing for group in one.searches()]
        found = {
            (one, place): root
            for (one, group), roots in zip(searches, self.map(search, searches), strict=True)
            for place, root in zip(group, roots, strict=True)
        }

        def of_agent(one: Policies) -> Plans:
            return Plans([found[one, k] for k in range(len(one.intents))], one.intent_of.copy())

        return [list(map(of_agent, each)) for each in self._policies]

    def acted(self, actions: Sequence[Action]) -> None:
        """Say what the agents have just done, from which their beliefs go on."""
        for each in self._policies:
            for policies, action in zip(each, actions, strict=True):
                policies.acted(action)

    def _model(self, strengths: tuple[float, ...]) -> WorldModel:
        if strengths not in self._models:
            self._models[strengths] = WorldModel.of(self.scene, strengths, self._planner)
        return self._models[strengths]


SEARCHED_BY_ALL: Final = 0.99
"""Mass of the most probable combinations of goals, for which all sets of searches are made; for the
rest there is the first set alone."""

_All = Sequence[Sequence[Plans]]  # (set, agent)


class FrameReading(NamedTuple):
    """What one frame says."""

    density: FloatArray  # (joint action,) see :class:`GoalFilter`, and so the next
    policies: FloatArray
    policy_of: IntArray
    shift: FloatArray
    marginals: FloatArray | None
    strengths: FloatArray  # (combination,) probabilities given the frames so far
    # (agent, action) probabilities of what each agent has just done, whatever its goal
    actions: FloatArray
    held: IntArray  # (agent,) item that each most probably holds now, or ``NOTHING``
    # nats by which the best joint action leaves the frame less probable than one that is exactly
    # where an action puts it
    unexplained: float
    log_peak: float  # log density of the latter
    searches: int  # searches that were made


def policies_of(plans: _All, policy: ActionPolicy) -> tuple[list[FloatArray], list[IntArray]]:
    """Return (agent) (policy, set, action) different policies, and (agent) (standpoint,) which.

    NaN where a set was not to search; all actions are alike for what nobody can want.
    """
    policies, policy_of = [], []
    for sets in zip(*plans, strict=True):
        intents = np.stack([one.intent_of for one in sets], axis=1)
        kinds, number = np.unique(intents, axis=0, return_inverse=True)
        of_sets = []
        for place, one in enumerate(sets):
            found = [policy.of(root) for root in one.roots]
            found.append(np.full(N_ACTIONS, 1 / N_ACTIONS))  # of NO_INTENT, which is -1
            own = np.array(found)[kinds[:, place]]
            own[(kinds[:, place] == NO_INTENT) & (kinds[:, 0] != NO_INTENT)] = np.nan
            of_sets.append(own)
        policies.append(np.stack(of_sets, axis=1))
        policy_of.append(number.reshape(-1))
    return policies, policy_of


class GoalFilter:
    """Takes in a video frame by frame; what it says of a frame never changes afterwards.

    A frame is kept as what every agent could have in mind and how probable each joint action makes
    the frame:

    ``density``
        (joint action,) log density of the frame after it, the first agent's action most
        significant.
    ``policies``
        (agent, policy, planner_seed, action) probabilities; NaN where an agent has fewer policies
        than another, and where a set has not searched.
    ``policy_of``
        (agent, standpoint) which of its policies.
    ``shift``
        (jackknife replicate,) what is to be added to the log likelihood by the first set of
        searches alone, where not all sets have searched. It is by how much the others have moved
        that of the rest in the mean: a log of fewer searches is lower, which would speak against
        whoever is improbable already.
    ``marginals``
        (agent, goal) log masses of each agent's goal, the others taken to act as is believed of
        them: approximate, to draw hypotheses from where they are too many. None without
        ``log_goals``, as in PHASE, whose hypotheses are all in a table.

    Args:
        sets: beliefs and searches; they go along with the filter, and end with it.
        policy: how agents act on their plans.
        weight: what a frame counts as evidence.
        followed: combinations of effective goals (row, agent), and their log prior masses. With the
            weight these say which are probable by now, for which all sets search. None: they are
            too many, and all sets search for all.
        log_goals: (agent, goal) log prior masses of single goals.

    ``combinations`` has the strengths that are followed (combination, agent), newtons.
    """

    def __init__(
        self,
        sets: SearchSets,
        policy: ActionPolicy,
        weight: float,
        followed: tuple[IntArray, FloatArray] | None,
        log_goals: FloatArray | None = None,
    ) -> None:
        self._sets, self._policy, self._weight = sets, policy, weight
        self.combinations = sets.hidden.combinations
        world = sets.scene.world
        self._standpoints = [standpoints(agent, world) for agent in range(len(world.agents))]
        self._n_replicates = 1 + (len(sets) if len(sets) > 1 else 0)
        self._is_followed = followed is not None
        self._marginals = None if log_goals is None else log_goals.copy()
        if followed is not None:
            goals, log_mass = followed
            self._log_mass = log_mass.copy()
            self._of_rows = [one.of(goals) for one in self._standpoints]
        if log_goals is not None:
            # (agent) (goal,) the first standpoint of each goal, where the others want something
            # else; -1: the agent cannot have it
            self._usual = [np.full(len(world.goals), -1) for _ in world.agents]
            for usual, of_agent in zip(self._usual, self._standpoints, strict=True):
                for one in reversed(of_agent.groups):
                    usual[one.own] = one.places[0]

    def close(self) -> None:
        self._sets.close()

    def at_start(self) -> FrameReading:
        """Return what is known before the first frame: nothing."""
        n, n_agents = self.combinations.shape
        return FrameReading(
            np.zeros(N_ACTIONS**n_agents),
            np.full((n_agents, 1, len(self._sets), N_ACTIONS), 1 / N_ACTIONS, np.float32),
            np.zeros((n_agents, max(one.n for one in self._standpoints)), np.int32),
            np.zeros(self._n_replicates),
            copy.copy(self._marginals),
            np.full(n, 1.0 / n),
            np.full((n_agents, N_ACTIONS), 1.0 / N_ACTIONS),
            np.full(n_agents, NOTHING, np.int64),
            *(0.0, 0.0, 0),
        )

    def read(self, frame: FloatArray) -> FrameReading:
        """Take in the next frame, (entity, 3) x, y [units], angle [rad], NaN where unseen."""
        hidden = self._sets.hidden
        plans = self._sets.plans(self._choose_wanted())
        policies, policy_of = policies_of(plans, self._policy)
        unseen = np.isnan(frame[: len(self._standpoints)]).any(axis=1)
        expected = self._expected(policies, policy_of) if unseen.any() else None
        log_density = hidden.advance(frame, self._sets.map, expected)
        highest = float(log_density.max())
        relative = np.exp(log_density - highest)
        shift = np.zeros(self._n_replicates)
        if self._is_followed:
            shift = self._follow(log_density, policies, policy_of)
        if self._marginals is not None:
            self._update_marginals(relative, policies, policy_of)
        acted = log_density
        for agent in np.flatnonzero(unseen):  # the frame does not tell what they did
            assert expected is not None
            others = [axis for axis in range(acted.ndim) if axis != agent]
            acted = acted + np.expand_dims(np.log(expected[agent]), others)
        self._sets.acted(most_probable_actions(acted))
        axes = range(log_density.ndim)
        actions = np.stack([relative.sum(tuple(a for a in axes if a != k)) for k in axes])
        actions /= actions.sum(axis=1, keepdims=True)
        searched = [len(root.actions) > 1 for each in plans for one in each for root in one.roots]
        return FrameReading(
            log_density.ravel(),
            stacked(policies).astype(np.float32),  # searches are coarser than single precision
            stacked(policy_of).astype(np.int32),
            shift,
            copy.copy(self._marginals),
            hidden.strengths(),
            actions,
            hidden.best().held.copy(),
            hidden.log_peak - highest,
            hidden.log_peak,
            sum(searched),
        )

    def _choose_wanted(self) -> list[BoolArray] | None:
        """Choose (agent) (standpoint,) those for which all sets search; None: all.

        They are those of the combinations of goals that together have nearly all of the mass.
        """
        if not self._is_followed or len(self._sets) == 1:
            return None
        mass = np.exp(self._log_mass - self._log_mass.max())
        order = np.argsort(-mass, kind="stable")
        before = np.cumsum(mass[order]) - mass[order]
        probable = order[before < SEARCHED_BY_ALL * mass.sum()]
        wanted = [np.zeros(one.n, bool) for one in self._standpoints]
        for found, of_rows in zip(wanted, self._of_rows, strict=True):
            found[of_rows[probable]] = True
        return wanted

    def _follow(
        self, log_density: FloatArray, policies: list[FloatArray], policy_of: list[IntArray]
    ) -> FloatArray:
        """Take in what a frame says of the goals that are followed; return the shift."""
        numbers = [of[rows] for of, rows in zip(policy_of, self._of_rows, strict=True)]
        first, every = log_likelihoods(log_density, policies, numbers, self._n_replicates)
        shift = shift_of(first, every, self._log_mass)
        so_far = np.where(np.isnan(every[0]), first + shift[0], every[0])
        self._log_mass += self._weight * so_far
        return shift

    def _expected(self, policies: list[FloatArray], policy_of: list[IntArray]) -> list[FloatArray]:
        """Return (agent) (action,) what is expected of each by what is believed of its goal."""
        found = []
        for agent, (of_agent, numbers) in enumerate(zip(policies, policy_of, strict=True)):
            if self._is_followed:
                rows, log_mass = self._of_rows[agent], self._log_mass
            else:
                assert self._marginals is not None, "one of the two tells of goals"
                rows, log_mass = self._usual[agent], self._marginals[agent]
            found.append(_mean_policy(np.nanmean(of_agent, axis=1)[numbers[rows]], log_mass))
        return found

    def _update_marginals(
        self, relative: FloatArray, policies: list[FloatArray], policy_of: list[IntArray]
    ) -> None:
        assert self._marginals is not None
        of_goals, believed = [], []
        for of_agent, numbers, usual, log_mass in zip(
            policies, policy_of, self._usual, self._marginals, strict=True
        ):
            mean = np.nanmean(of_agent, axis=1)[numbers[usual]]
            of_goals.append(mean)
            believed.append(_mean_policy(mean, log_mass))
        for agent, mean in enumerate(of_goals):
            left = relative
            for other in range(len(believed) - 1, -1, -1):
                if other != agent:
                    left = np.tensordot(left, believed[other], axes=(other, 0))
            self._marginals[agent] += self._weight * np.log(mean @ left)


def _mean_policy(policies: FloatArray, log_mass: FloatArray) -> FloatArray:
    """Return (action,) the mean of policies (row, action) by their log masses (row,)."""
    mass = np.exp(log_mass - log_mass.max())
    return np.asarray(mass @ policies / mass.sum())


class Growing:
    """Arrays along time, which are given one by one and may differ in size.

    What was given stays where it is, so that the next one costs the same however many there are.
    """

    def __init__(self) -> None:
        self._all: Any = None
        self._n = 0

    def add(self, given: ArrayLike) -> None:
        """Put an array at the end."""
        array = np.asarray(given)
        known = np.empty((0, *array.shape), array.dtype) if self._all is None else self._all
        room = len(known), *known.shape[1:]
        wanted = self._n + 1, *array.shape
        if any(one > have for one, have in zip(wanted, room, strict=True)):
            length = max(len(known), 2 * self._n + 1)
            shape = (length, *map(max, known.shape[1:], array.shape))
            fill = np.nan if array.dtype.kind == "f" else 0
            grown = np.full(shape, fill, array.dtype)
            within: tuple[Any, ...] = tuple(map(slice, known.shape[1:]))
            grown[(slice(self._n), *within)] = known[: self._n]
            known = self._all = grown
        place: tuple[Any, ...] = tuple(map(slice, array.shape))
        known[(self._n, *place)] = array
        self._n += 1

    def first(self, n: int) -> NDArray[Any]:
        """Return the first ``n``, (time, ...); the smaller ones are filled up with NaN or 0."""
        found: NDArray[Any] = self._all[:n]
        found.flags.writeable = False  # those that follow are written beside it
        return found


def stacked(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return arrays as one, along a new axis; the smaller ones are filled up with NaN or 0."""
    all_of_them = Growing()
    for array in arrays:
        all_of_them.add(array)
    return all_of_them.first(len(arrays))


def warm_up() -> None:
    """Compile the kernels that filtering a video needs, or load them from the cache on disk."""
    scene = scene_in_reach()
    planner, tracking = PlannerConfig(simulations=2), Tracking(states=1)
    sets, followed = SearchSets(scene, planner, tracking), (np.array([[0, 1]]), np.zeros(1))
    with contextlib.closing(GoalFilter(sets, ActionPolicy(1.0, 1.0), 1.0, followed)) as goals:
        for _ in range(2):
            goals.read(scene.start)
