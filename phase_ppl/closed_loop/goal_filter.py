"""One pass through a video: at each frame, how probable it is under every pair of goals.

p(s_t+1 | s_<=t, h) = sum over actions of pi_red(a_red) pi_green(a_green) p(s_t+1 | T(s_t, a)), with
the policies pi of the joint simulator's agents at what was observed, and T one step of its physics.

A policy is known from a search only, which depends on chance, and so do the beliefs from which it
starts. Therefore each pi is a mean over several independent sets of beliefs and searches, taken
inside the logarithm: the log of one noisy policy is too low, and says too much of single frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.closed_loop.hidden_state import Tracking, most_probable_actions
from phase_ppl.closed_loop.search_sets import Conduct, Looked, SearchSets
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.names import AGENTS
from phase_ppl.world.scene import Scene

SEARCHED_BY_ALL: Final = 0.99
"""Mass of the most probable pairs of goals, for which all sets of searches are made; for the rest
there is the first set alone."""


class Reading(NamedTuple):
    """What one frame says."""

    # (goal_red, goal_green) log density of the frame given those before it and a pair of effective
    # goals, per unit^8 rad^2; -inf where a goal names its own holder
    log_likelihood: FloatArray
    # (planner_seed, goal_red, goal_green) likewise without each set of searches; empty where there
    # is only one
    without: FloatArray
    strengths: FloatArray  # (strength of red, of green) probabilities given the frames so far
    # (agent, action) probabilities of what each agent has just done, whatever its goal
    actions: FloatArray
    held: IntArray  # (agent,) item that each most probably holds now, or ``NOTHING``
    # nats by which the best pair of actions leaves the frame less probable than one that is exactly
    # where an action puts it
    unexplained: float
    log_peak: float  # log density of the latter
    searches: int  # searches that were made


class GoalFilter:
    """Takes in a video of PHASE frame by frame; what it says of a frame never changes afterwards.

    Args:
        sets: beliefs and searches; they go along with the filter, and end with it.
        conduct: how agents act on their plans.
        weight: what a frame counts as evidence, and
        log_prior: (goal_red, goal_green) log prior masses; both only say which pairs of goals are
            improbable enough for one set of searches to do. None: all alike.

    Use it as a context manager, or call ``close()``, to end its threads.
    """

    def __init__(
        self,
        sets: SearchSets,
        conduct: Conduct,
        weight: float = 1.0,
        log_prior: FloatArray | None = None,
    ) -> None:
        self._sets, self._conduct, self._weight = sets, conduct, weight
        self._log_mass = np.zeros((N_GOALS, N_GOALS)) if log_prior is None else log_prior.copy()

    def __enter__(self) -> GoalFilter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the threads."""
        self._sets.close()

    def read(self, frame: FloatArray) -> Reading:
        """Take in the next frame, (4, 3) x, y [units], angle [rad]."""
        wanted = self._probable_pairs()
        hidden = self._sets.hidden
        looked = self._sets.look([wanted.ravel()] * len(AGENTS))
        density = hidden.advance(frame, self._sets.map)
        highest = float(density.max())
        relative = np.exp(density - highest)
        likelihood, without = frame_log_likelihood(
            looked, wanted, relative, self._log_mass, self._conduct
        )
        likelihood += highest
        without += highest
        self._log_mass += self._weight * likelihood
        self._sets.done(most_probable_actions(density))
        actions = np.stack([relative.sum(axis=1), relative.sum(axis=0)])
        return Reading(
            likelihood,
            without,
            hidden.strengths().reshape([len(hidden.tracking.strengths)] * 2),
            actions / actions.sum(axis=1, keepdims=True),
            hidden.best().held.copy(),
            hidden.log_peak - highest,
            hidden.log_peak,
            sum(len(root.actions) > 1 for both in looked for one in both for root in one.roots),
        )

    def _probable_pairs(self) -> BoolArray:
        """Return which pairs of goals together have nearly all of the mass."""
        flat = self._log_mass.ravel()
        mass = np.exp(flat - flat.max())
        order = np.argsort(-mass, kind="stable")
        before = np.cumsum(mass[order]) - mass[order]
        found = np.zeros(flat.shape, bool)
        found[order[before < SEARCHED_BY_ALL * mass.sum()]] = True
        return found.reshape(self._log_mass.shape)


def frame_log_likelihood(
    looked: Sequence[Sequence[Looked]],
    wanted: BoolArray,
    relative: FloatArray,
    log_mass: FloatArray,
    conduct: Conduct,
) -> tuple[FloatArray, FloatArray]:
    """Return the log likelihoods of the next frame given those before it.

    Policies are means over the sets of searches. Where there is only the first set, its result is
    moved by as much as the others moved that of the wanted pairs: a log of fewer searches is lower
    in the mean, which would speak against whoever is improbable already.

    Args:
        looked: (set, agent) what the planners make of the moment.
        wanted: (goal_red, goal_green) pairs for which there are all sets.
        relative: (A, A) density of the frame after every pair of actions.
        log_mass: (goal_red, goal_green) before the frame.
        conduct: how agents act on their plans.

    Returns:
        (goal_red, goal_green) with all sets, and (set, goal_red, goal_green) without each.
    """
    n = len(looked)
    # (set, agent, goal_red, goal_green, action), 0 where there is no intent
    policies = np.empty((n, len(AGENTS), N_GOALS, N_GOALS, N_ACTIONS))
    for place, both in enumerate(looked):
        for agent, one in enumerate(both):
            table = np.zeros((len(one.roots) + 1, N_ACTIONS))
            for row, root in enumerate(one.roots):
                table[row] = conduct.policy(root)
            # the last row for NO_INTENT, which is -1
            policies[place, agent] = table[one.intent_of.reshape(N_GOALS, N_GOALS)]
    possible = (policies[0].sum(axis=-1) > 0).all(axis=0)
    alone = np.where(possible, _density(policies[0], relative), 0.0)
    with np.errstate(divide="ignore"):
        first = np.log(alone)
    if n == 1:
        return first, np.empty((0, N_GOALS, N_GOALS))
    results = np.tile(first, (1 + n, 1, 1))
    sure = wanted & possible & np.isfinite(log_mass)
    if sure.any():
        share = np.exp(log_mass[sure] - log_mass[sure].max())
        total = policies[:, :, sure].sum(axis=0)
        means = [total / n, *((total - own[:, sure]) / (n - 1) for own in policies)]
        for result, mean in zip(results, means, strict=True):
            result[sure] = np.log(_density(mean, relative))
            result[~sure] += share @ (result[sure] - first[sure]) / share.sum()
    return results[0], results[1:]


def _density(policies: FloatArray, relative: FloatArray) -> FloatArray:
    """Return (...) the density of a frame; policies are (agent, ..., A), ``relative`` (A, A)."""
    red, green = policies
    return np.asarray(((red @ relative) * green).sum(axis=-1))


def warm_up() -> None:
    """Compile the kernels that filtering a video needs, or load them from the cache on disk."""
    spots = [[8.0, 20.0, 0.0], [24.0, 20.0, 0.0], [24.0, 4.0, 0.0], [8.0, 4.0, 0.0]]
    scene = Scene(start=np.array(spots), radius=np.full(4, 0.8))
    planner, tracking = PlannerConfig(simulations=2), Tracking(states=1)
    with GoalFilter(SearchSets(scene, planner, tracking), Conduct(1.0, 1.0)) as goals:
        for _ in range(2):
            goals.read(scene.start)
