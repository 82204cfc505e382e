"""One pass through a video: at each frame, how probable it is under every pair of goals.

p(s_t+1 | s_<=t, h) = sum over actions of pi_red(a_red) pi_green(a_green) p(s_t+1 | T(s_t, a)), with
the policies pi of the joint simulator's agents at what was observed, and T one step of its physics.

A policy is known from a search only, which depends on chance, and so do the beliefs from which it
starts. Therefore each pi is a mean over several independent sets of beliefs and searches, taken
inside the logarithm: the log of one noisy policy is too low, and says too much of single frames.

Agents that do otherwise than planned do so for many frames on end, which are no independent
evidence against their goals. Therefore each agent either pursues its goal or does anything
whatever, changes between the two now and then, and which it is, is summed out frame by frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.mind import Mind
from phase_ppl.agents.policies import Outlook, Policies
from phase_ppl.closed_loop.hidden_state import HiddenState, Tracking, most_probable_actions
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.names import AGENTS
from phase_ppl.world.scene import Scene

SEARCHED_BY_ALL: Final = 0.99
"""Mass of the most probable pairs of goals, for which all sets of searches are made; for the rest
there is the first set alone."""


class Reading(NamedTuple):
    """What one frame says.

    Attributes:
        log_likelihood: (goal_red, goal_green) log density of the frame given those before it and
            a pair of effective goals, per unit^8 rad^2; -inf where a goal names its own holder.
        without: (planner_seed, goal_red, goal_green) likewise without each set of searches; empty
            where there is only one.
        strengths: (strength of red, of green) probabilities given the frames so far.
        actions: (agent, action) probabilities of what each agent has just done, whatever its goal.
        held: (agent,) item that each most probably holds now, or ``NOTHING``.
        unexplained: nats by which the best pair of actions leaves the frame less probable than
            one that is exactly where an action puts it.
        log_peak: log density of the latter.
        searches: searches that were made.
    """

    log_likelihood: FloatArray
    without: FloatArray
    strengths: FloatArray
    actions: FloatArray
    held: NDArray[np.int64]
    unexplained: float
    log_peak: float
    searches: int


class Conduct(NamedTuple):
    """How agents act on their plans.

    Attributes:
        sharpness: exponent of a search's root visits.
        lapse: probability that an agent that pursues its goal does anything whatever, by frame.
        leave: probability, by frame, that it ceases to pursue its goal;
        resume: that it then takes it up again. In between it does anything whatever.
    """

    sharpness: float
    lapse: float
    leave: float
    resume: float

    @property
    def start(self) -> FloatArray:
        """Probabilities (pursues its goal, does not) at first, which are those of any frame."""
        return np.array([self.resume, self.leave]) / (self.leave + self.resume)

    @property
    def change(self) -> FloatArray:
        """Probabilities (before, now) of pursuing one's goal, or not."""
        return np.array([[1 - self.leave, self.leave], [self.resume, 1 - self.resume]])

    def policy(self, outlook: Outlook) -> FloatArray:
        """Return (action,) probabilities of an agent that pursues its goal.

        pi = (1 - lapse) visits^sharpness / Z + lapse / |A|

        Args:
            outlook: what the planner makes of an intent.
        """
        found = np.full(N_ACTIONS, self.lapse / N_ACTIONS)
        share = (outlook.visits / outlook.visits.max()) ** self.sharpness
        found[outlook.actions] += (1.0 - self.lapse) * share / share.sum()
        return found


class Looked(NamedTuple):
    """One agent's policies at one moment, by one set of beliefs and searches.

    Attributes:
        outlooks: of every intent.
        of_pair: (goal_red, goal_green) -> index of the intent, or ``NO_INTENT``.
    """

    outlooks: list[Outlook]
    of_pair: NDArray[np.int64]


class Reader:
    """Reads a video frame by frame; what it says of a frame never changes afterwards.

    Args:
        scene: where everything starts, at rest.
        planner: settings of the agents' planner.
        tracking: settings of the filter of hidden states.
        conduct: how agents act on their plans.
        seed: of beliefs and searches.
        threads: at most so many searches at a time; the result does not depend on it.
        planner_seeds: independent sets of beliefs and searches. Each plans with strengths of its
            own, which together stand for what is believed of them.
        weight: what a frame counts as evidence, and
        log_prior: (goal_red, goal_green) log prior masses; both only say which pairs of goals are
            improbable enough for one set of searches to do. None: all alike.

    Use it as a context manager, or call ``close()``, to end its threads.
    """

    def __init__(
        self,
        scene: Scene,
        planner: PlannerConfig,
        tracking: Tracking,
        conduct: Conduct,
        seed: int = 0,
        threads: int = 1,
        planner_seeds: int = 1,
        weight: float = 1.0,
        log_prior: FloatArray | None = None,
    ) -> None:
        self._scene, self._planner = scene, planner
        self._weight = weight
        self._goals = GoalFilter(conduct, planner_seeds)
        self._hidden = HiddenState(scene, tracking)
        self._minds: dict[tuple[float, float], Mind] = {}
        self._policies = [
            [
                Policies(agent, self._mind(expected.strengths), planner, _seed(seed, place))
                for agent in range(len(AGENTS))
            ]
            for place, expected in enumerate(self._hidden.spread(planner_seeds))
        ]
        self._log_mass = np.zeros((N_GOALS, N_GOALS)) if log_prior is None else log_prior.copy()
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def __enter__(self) -> Reader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def read(self, frame: FloatArray) -> Reading:
        """Take in the next frame, (4, 3) x, y [units], angle [rad]."""
        wanted = self._probable_pairs()
        looked = self._look(wanted)
        density = self._hidden.advance(frame)
        highest = float(density.max())
        relative = np.exp(density - highest)
        likelihood, without = self._goals.take(looked, wanted, relative, self._log_mass)
        likelihood += highest
        without += highest
        self._log_mass += self._weight * likelihood
        for agent, action in enumerate(most_probable_actions(density)):
            for pair in self._policies:
                pair[agent].done(action)
        actions = np.stack([relative.sum(axis=1), relative.sum(axis=0)])
        return Reading(
            likelihood,
            without,
            self._hidden.strengths(),
            actions / actions.sum(axis=1, keepdims=True),
            self._hidden.best().held.copy(),
            self._hidden.log_peak - highest,
            self._hidden.log_peak,
            sum(
                len(outlook.actions) > 1
                for pair in looked
                for one in pair
                for outlook in one.outlooks
            ),
        )

    def _probable_pairs(self) -> NDArray[np.bool_]:
        """Return which pairs of goals together have nearly all of the mass."""
        flat = self._log_mass.ravel()
        mass = np.exp(flat - flat.max())
        order = np.argsort(-mass, kind="stable")
        before = np.cumsum(mass[order]) - mass[order]
        found = np.zeros(flat.shape, bool)
        found[order[before < SEARCHED_BY_ALL * mass.sum()]] = True
        return found.reshape(self._log_mass.shape)

    def _look(self, wanted: NDArray[np.bool_]) -> list[list[Looked]]:
        """Return (set, agent) what the planners make of what was seen so far."""
        tasks = []
        for place, (pair, expected) in enumerate(
            zip(self._policies, self._hidden.spread(len(self._policies)), strict=True)
        ):
            mind = self._mind(expected.strengths)
            for policies in pair:
                policies.mind = mind
                policies.observe(
                    expected.bodies, expected.held, expected.weld, wanted if place else None
                )
                tasks += [(policies, intent) for intent in policies.intents]
        share = map if self._pool is None else self._pool.map
        found = iter(list(share(lambda task: task[0].outlook(task[1]), tasks)))
        return [
            [Looked([next(found) for _ in one.intents], one.of_pair.copy()) for one in pair]
            for pair in self._policies
        ]

    def _mind(self, strengths: tuple[float, float]) -> Mind:
        if strengths not in self._minds:
            self._minds[strengths] = Mind.of(self._scene, strengths, self._planner)
        return self._minds[strengths]


class GoalFilter:
    """How probable frames are under every pair of goals, one frame after the other.

    Args:
        conduct: how agents act on their plans.
        n_sets: sets of beliefs and searches.
    """

    def __init__(self, conduct: Conduct, n_sets: int) -> None:
        self._conduct = conduct
        # (all sets and without each, does red pursue its goal, does green, goal_red, goal_green)
        n = 1 + n_sets if n_sets > 1 else 1
        start = np.multiply.outer(conduct.start, conduct.start)
        self._modes = np.tile(start[..., None, None], (n, 1, 1, N_GOALS, N_GOALS))

    def take(
        self,
        looked: Sequence[Sequence[Looked]],
        wanted: NDArray[np.bool_],
        relative: FloatArray,
        log_mass: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the log likelihoods of the next frame given those before it.

        Policies are means over the sets of searches. Where there is only the first set, its
        result is moved by as much as the others moved that of the wanted pairs: a log of fewer
        searches is lower in the mean, which would speak against whoever is improbable already.

        Args:
            looked: (set, agent) what the planners make of the moment.
            wanted: (goal_red, goal_green) pairs for which there are all sets.
            relative: (A, A) density of the frame after every pair of actions.
            log_mass: (goal_red, goal_green) before the frame.

        Returns:
            (goal_red, goal_green) with all sets, and (set, goal_red, goal_green) without each.
        """
        n = len(looked)
        policies = self._policies(looked)
        possible = (policies[0].sum(axis=-1) > 0).all(axis=0)
        sure = wanted & possible & np.isfinite(log_mass)
        change = self._conduct.change
        modes = np.einsum("ik,jl,nijxy->nklxy", change, change, self._modes)
        alone = _by_modes(policies[0], relative)
        share = np.exp(log_mass[sure] - log_mass[sure].max(initial=-np.inf))
        total = policies[:, :, sure].sum(axis=0)
        results = []
        for place in range(len(modes)):
            found = alone.copy()
            if n > 1 and sure.any():
                mean = total / n if place == 0 else (total - policies[place - 1][:, sure]) / (n - 1)
                found[:, :, sure] = _by_modes(mean, relative)
            joint = modes[place] * found
            likelihood = joint.sum(axis=(0, 1))
            with np.errstate(divide="ignore"):
                result = np.log(np.where(possible, likelihood, 0.0))
            if n > 1 and sure.any():
                first = np.log((modes[place] * alone).sum(axis=(0, 1))[sure])
                result[~sure] += share @ (result[sure] - first) / share.sum()
            results.append(result)
            # a pair that is none, of which a goal names its own holder, stays as it is
            np.divide(joint, likelihood, out=self._modes[place], where=likelihood > 0)
        return results[0], np.array(results[1:]).reshape(-1, N_GOALS, N_GOALS)

    def _policies(self, looked: Sequence[Sequence[Looked]]) -> FloatArray:
        """Return (set, agent, goal_red, goal_green, action), 0 where there is no intent."""
        found = np.empty((len(looked), len(AGENTS), N_GOALS, N_GOALS, N_ACTIONS))
        for place, pair in enumerate(looked):
            for agent, one in enumerate(pair):
                table = np.zeros((len(one.outlooks) + 1, N_ACTIONS))
                for row, outlook in enumerate(one.outlooks):
                    table[row] = self._conduct.policy(outlook)
                found[place, agent] = table[one.of_pair]  # the last row for NO_INTENT, which is -1
        return found


def _by_modes(policies: FloatArray, relative: FloatArray) -> FloatArray:
    """Return the density of a frame by whether red, and green, pursue their goals.

    Args:
        policies: (agent, ..., action); relative: (A, A).

    Returns:
        (2, 2, ...), first that they do.
    """
    red, green = policies
    anything = np.full(N_ACTIONS, 1.0 / N_ACTIONS)
    after_red = red @ relative
    neither = np.full(red.shape[:-1], anything @ relative @ anything)
    return np.array(
        [
            [(after_red * green).sum(axis=-1), after_red @ anything],
            [green @ (anything @ relative), neither],
        ]
    )


def _seed(seed: int, place: int) -> int:
    """Return the seed of one of several sets of searches; the first has the seed itself."""
    if place == 0:
        return seed
    return int(np.random.SeedSequence([seed, place]).generate_state(1, np.uint64)[0])


# --- compiling all that reading a video needs, before there is one --------------------------------


def warm_up() -> None:
    """Compile the kernels, or load them from the cache on disk."""
    spots = [[8.0, 20.0, 0.0], [24.0, 20.0, 0.0], [24.0, 4.0, 0.0], [8.0, 4.0, 0.0]]
    scene = Scene(start=np.array(spots), radius=np.full(4, 0.8))
    conduct = Conduct(1.0, 1.0, 0.5, 0.5)
    with Reader(scene, PlannerConfig(simulations=2), Tracking(states=1), conduct) as reader:
        for _ in range(2):
            reader.read(scene.start)
