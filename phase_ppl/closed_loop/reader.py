"""One pass through a video: at each frame, how probable it is under every pair of goals.

p(s_t+1 | s_<=t, h) = sum over actions of pi_red(a_red) pi_green(a_green) p(s_t+1 | T(s_t, a)), with
the policies pi of the joint simulator's agents at what was observed, and T one step of its physics.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.mind import Mind
from phase_ppl.agents.policies import NO_INTENT, Outlook, Policies
from phase_ppl.closed_loop.hidden_state import HiddenState, Tracking, most_probable_actions
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.world.names import AGENTS
from phase_ppl.world.scene import Scene

FloatArray = NDArray[np.float64]


class Reading(NamedTuple):
    """What one frame says.

    Attributes:
        log_likelihood: (goal_red, goal_green) log density of the frame given those before it and
            a pair of effective goals, per unit^8 rad^2; -inf where a goal names its own holder.
        strengths: (strength of red, of green) probabilities given the frames so far.
        actions: (agent, action) probabilities of what each agent has just done, whatever its goal.
        held: (agent,) item that each most probably holds now, or ``NOTHING``.
        searches: searches that were made.
    """

    log_likelihood: FloatArray
    strengths: FloatArray
    actions: FloatArray
    held: NDArray[np.int64]
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


class Reader:
    """Reads a video frame by frame; what it says of a frame never changes afterwards.

    Args:
        scene: where everything starts, at rest.
        planner: settings of the agents' planner.
        tracking: settings of the filter of hidden states.
        sharpness, lapse: of :func:`policy`.
        seed: of beliefs and searches.
        threads: at most so many searches at a time; the result does not depend on it.

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
    ) -> None:
        self._scene, self._planner = scene, planner
        self._sharpness, self._lapse = sharpness, lapse
        self._hidden = HiddenState(scene, tracking)
        self._strengths = self._likely_strengths()
        mind = Mind.of(scene, self._strengths, planner)
        self._policies = [Policies(agent, mind, planner, seed) for agent in range(len(AGENTS))]
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
        self._know_strengths()
        for agent in self._policies:
            agent.observe(*self._hidden.beam.best())
        outlooks = [agent.outlooks(self._pool) for agent in self._policies]
        density = self._hidden.advance(frame)
        highest = density.max()
        relative = np.exp(density - highest)
        likelihood = self._of_pairs(outlooks, relative)
        for agent, action in zip(self._policies, most_probable_actions(density), strict=True):
            agent.done(action)
        with np.errstate(divide="ignore"):
            log_likelihood = np.log(likelihood) + highest
        actions = np.stack([relative.sum(axis=1), relative.sum(axis=0)])
        return Reading(
            log_likelihood,
            self._hidden.strengths(),
            actions / actions.sum(axis=1, keepdims=True),
            self._hidden.beam.best()[1].copy(),
            sum(len(outlook.actions) > 1 for found in outlooks for outlook in found),
        )

    def _of_pairs(self, outlooks: list[list[Outlook]], relative: FloatArray) -> FloatArray:
        """Return (goal_red, goal_green) sums over actions of both policies and the density."""
        red, green = (
            np.stack([policy(outlook, self._sharpness, self._lapse) for outlook in found])
            for found in outlooks
        )
        by_intents = red @ relative @ green.T
        index = [agent.of_pair for agent in self._policies]
        possible = (index[0] != NO_INTENT) & (index[1] != NO_INTENT)
        return np.where(possible, by_intents[index[0], index[1]], 0.0)

    def _likely_strengths(self) -> tuple[float, float]:
        """Return each agent's most probable strength; the middle one where they are equal."""
        levels = np.array(self._hidden.tracking.strengths)
        joint = self._hidden.strengths()
        found = []
        for probabilities in (joint.sum(axis=1), joint.sum(axis=0)):
            best = np.flatnonzero(probabilities > probabilities.max() - 1e-9)
            found.append(float(levels[best[len(best) // 2]]))
        return found[0], found[1]

    def _know_strengths(self) -> None:
        """Let the agents plan with the strengths that are the most probable now."""
        strengths = self._likely_strengths()
        if strengths != self._strengths:
            self._strengths = strengths
            mind = Mind.of(self._scene, strengths, self._planner)
            for agent in self._policies:
                agent.mind = mind
