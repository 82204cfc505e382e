"""One pass through a video: at each frame, how probable it is under every pair of goals.

p(s_t+1 | s_<=t, h) = sum over actions of pi_red(a_red) pi_green(a_green) p(s_t+1 | T(s_t, a)), with
the policies pi of the joint simulator's agents at what was observed, and T one step of its physics.

A policy is known from a search only, which depends on chance, and so do the beliefs from which it
starts. Therefore each pi is a mean over several independent sets of beliefs and searches, taken
inside the logarithm: the log of one noisy policy is too low, and says too much of single frames.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.mind import Mind
from phase_ppl.agents.policies import NO_INTENT, Outlook, Policies
from phase_ppl.closed_loop.hidden_state import HiddenState, Tracking, most_probable_actions
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.names import AGENTS
from phase_ppl.world.scene import Scene

FloatArray = NDArray[np.float64]

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


def policy(outlook: Outlook, sharpness: float, lapse: float) -> FloatArray:
    """Return (action,) probabilities pi = (1 - lapse) visits^sharpness / Z + lapse / |A|.

    Args:
        outlook: what the planner makes of an intent.
        sharpness: exponent of the root's visits.
        lapse: probability of any action whatever.
    """
    found = np.full(N_ACTIONS, lapse / N_ACTIONS)
    share = (outlook.visits / outlook.visits.max()) ** sharpness
    found[outlook.actions] += (1.0 - lapse) * share / share.sum()
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
        sharpness, lapse: of :func:`policy`.
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
        sharpness: float,
        lapse: float,
        seed: int = 0,
        threads: int = 1,
        planner_seeds: int = 1,
        weight: float = 1.0,
        log_prior: FloatArray | None = None,
    ) -> None:
        self._scene, self._planner = scene, planner
        self._sharpness, self._lapse, self._weight = sharpness, lapse, weight
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
        likelihood, without = self._of_pairs(looked, wanted, relative)
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

    def _of_pairs(
        self, looked: list[list[Looked]], wanted: NDArray[np.bool_], relative: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the log likelihoods of all pairs of goals, and those without each set.

        Args:
            looked: (set, agent).
            wanted: (goal_red, goal_green) pairs for which all sets were made.
            relative: (A, A) density after every pair of actions.
        """
        return log_likelihoods(
            looked, wanted, relative, self._log_mass, self._sharpness, self._lapse
        )

    def _mind(self, strengths: tuple[float, float]) -> Mind:
        if strengths not in self._minds:
            self._minds[strengths] = Mind.of(self._scene, strengths, self._planner)
        return self._minds[strengths]


def log_likelihoods(
    looked: list[list[Looked]],
    wanted: NDArray[np.bool_],
    relative: FloatArray,
    log_mass: FloatArray,
    sharpness: float,
    lapse: float,
) -> tuple[FloatArray, FloatArray]:
    """Return (goal_red, goal_green) log sums over actions of both policies and the density.

    Both policies are means over the sets of searches. Where there is only the first set, its
    result is moved by as much as the others moved that of the wanted pairs: a log of fewer
    searches is lower in the mean, which would speak against whoever is improbable already.

    Args:
        looked, wanted, relative: as of ``Reader._of_pairs``.
        log_mass: (goal_red, goal_green) before the frame.
        sharpness, lapse: of :func:`policy`.

    Returns:
        Those of all sets, and (set, goal_red, goal_green) those without each one.
    """
    n = len(looked)
    policies = np.empty((n, len(AGENTS), N_GOALS, N_GOALS, N_ACTIONS))
    for place, pair in enumerate(looked):
        for agent, one in enumerate(pair):
            table = np.zeros((len(one.outlooks) + 1, N_ACTIONS))  # the last is no intent's
            for row, outlook in enumerate(one.outlooks):
                table[row] = policy(outlook, sharpness, lapse)
            policies[place, agent] = table[one.of_pair]
    assert NO_INTENT == -1  # which picks the last row

    def of(both: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(((both[0] @ relative) * both[1]).sum(axis=-1)))

    first = of(policies[0])
    if n == 1:
        return first, np.empty((0, N_GOALS, N_GOALS))
    sure = wanted & np.isfinite(first) & np.isfinite(log_mass)
    if not sure.any():
        return first, np.repeat(first[None], n, axis=0)
    total = policies[:, :, sure].sum(axis=0)
    share = np.exp(log_mass[sure] - log_mass[sure].max())
    share /= share.sum()

    def combined(mean: FloatArray) -> FloatArray:
        found = of(mean)
        result = first + share @ (found - first[sure])
        result[sure] = found
        return np.asarray(result)

    without = [combined((total - one) / (n - 1)) for one in policies[:, :, sure]]
    return combined(total / n), np.stack(without)


def _seed(seed: int, place: int) -> int:
    """Return the seed of one of several sets of searches; the first has the seed itself."""
    if place == 0:
        return seed
    return int(np.random.SeedSequence([seed, place]).generate_state(1, np.uint64)[0])
