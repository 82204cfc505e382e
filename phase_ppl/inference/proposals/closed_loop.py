"""What the closed loop makes of a video, as a proposal: as good as a bottom-up pass can be.

The video is read once (:mod:`phase_ppl.closed_loop`), with one set of searches and the paper's
uniform prior. A window proposes goals, and who helps or hinders whom, by what is probable given the
frames up to its end; the initial hypotheses come from the whole. Of the goals of several agents
together only their product is proposed, given who helps or hinders whom. Hastings' ratio corrects
for it, so the posterior is still that of simulations; but what the closed loop takes to be
improbable is seldom tried.
"""

from __future__ import annotations

import functools
from typing import Final

import numpy as np

from phase_ppl.analysis.stepwise_table import GoalRows, Table, table_of
from phase_ppl.inference.stepwise import filter_event
from phase_ppl.models.model import Model
from phase_ppl.models.sites import IMPOSSIBLE
from phase_ppl.models.stepwise import StepwiseLikelihood
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.scene import Scene
from phase_ppl.world.space import HypothesisSpace

_LEAST: Final = 1e-12  # of the mass, which what has less is proposed with
_EVENTS_KEPT: Final = 8


def closed_loop_logits(
    scene: Scene, observation: Observation, last: IntArray, progress: bool | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return what is probable given the frames up to each of ``last``.

    Unnormalised log probabilities: (stretch, way, agent, goal) of stated goals given in which way
    agents stand to each other, and (stretch, way) beside the prior's. ``progress`` says whether to
    show a bar while the video is read.
    """
    table = _read(scene, observation, progress)
    space, rows = table.space, table.hypotheses
    n = len(space.ways)
    log_prior = rows.log_prior - rows.log_drawn
    least = np.where(np.isfinite(log_prior), _LEAST, 0)
    prior = _sums(rows.way, np.exp(log_prior), n)
    goal = np.empty((len(last), n, space.n_agents, space.n_goals))
    evidence = np.empty((len(last), n))
    for place, frame in enumerate(last):
        log_masses = table.log_masses(int(frame))[0]
        masses = np.exp(log_masses - log_masses.max())
        evidence[place] = _sums(rows.way, np.maximum(masses, least), n) - prior
        for way in range(n):
            goal[place, way] = _goal_logits(space, way, rows, masses)
    return np.where(space.impossible, IMPOSSIBLE, goal), evidence


def _goal_logits(
    space: HypothesisSpace, way: int, rows: GoalRows, masses: FloatArray
) -> FloatArray:
    """Return (agent, goal) log masses of stated goals in one way; all alike of who has none."""
    found = np.zeros((space.n_agents, space.n_goals))
    chosen = rows.way == way
    for agent in np.unique(space.owner[way]):
        shares = np.bincount(rows.stated[chosen, agent], masses[chosen], space.n_goals)
        found[agent] = np.log(np.maximum(shares / max(shares.sum(), 1e-300), _LEAST))
    return found


def _sums(way: IntArray, masses: FloatArray, n: int) -> FloatArray:
    """Return (way,) logs of sums of masses."""
    return np.asarray(np.log(np.maximum(np.bincount(way, masses, n), 1e-300)))


@functools.lru_cache(_EVENTS_KEPT)
def _read(scene: Scene, observation: Observation, progress: bool | None) -> Table:
    # by object: kernels that are compared share it
    model = Model(likelihood=StepwiseLikelihood(planner_seeds=1))
    return table_of(filter_event(Event(scene, observation), model, progress=progress).dataset)
