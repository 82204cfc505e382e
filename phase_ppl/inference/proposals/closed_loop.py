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
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.analysis.roles_table import RolesTable
from phase_ppl.inference.stepwise import filter_event
from phase_ppl.models.model import Model
from phase_ppl.models.sites import IMPOSSIBLE
from phase_ppl.models.stepwise import StepwiseLikelihood
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.event import Event
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene
from phase_ppl.world.space import HypothesisSpace, space_of

_LEAST: Final = 1e-12  # of the mass, which what has less is proposed with
_EVENTS_KEPT: Final = 8


class _Rows(NamedTuple):
    """All hypotheses, or draws of them, and what is known of each."""

    way: IntArray  # (row,) in which way agents stand to each other
    goals: IntArray  # (row, agent) stated goals; of who has none, anything
    log_prior: FloatArray  # (row,) over the density of the draws
    log_masses: Callable[[int], FloatArray]  # frame -> (row,) given the frames up to it


def closed_loop_logits(
    scene: Scene, observation: Observation, last: IntArray, progress: bool | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return what is probable given the frames up to each of ``last``.

    Unnormalised log probabilities: (stretch, way, agent, goal) of stated goals given in which way
    agents stand to each other, and (stretch, way) beside the prior's. ``progress`` says whether to
    show a bar while the video is read.
    """
    space, rows = space_of(scene.world), _read(scene, observation, progress)
    n = len(space.ways)
    prior = _sums(rows.way, rows.log_prior, n)
    goal = np.empty((len(last), n, space.n_agents, space.n_goals))
    evidence = np.empty((len(last), n))
    for place, frame in enumerate(last):
        masses = rows.log_masses(int(frame))
        masses = np.exp(masses - masses.max())
        evidence[place] = _sums(rows.way, np.log(np.maximum(masses, _LEAST)), n) - prior
        for way in range(n):
            goal[place, way] = _goal_logits(space, way, rows, masses)
    return np.where(space.impossible, IMPOSSIBLE, goal), evidence


def _goal_logits(space: HypothesisSpace, way: int, rows: _Rows, masses: FloatArray) -> FloatArray:
    """Return (agent, goal) log masses of stated goals in one way; all alike of who has none."""
    found = np.zeros((space.n_agents, space.n_goals))
    chosen = rows.way == way
    for agent in np.unique(space.owner[way]):
        shares = np.bincount(rows.goals[chosen, agent], masses[chosen], space.n_goals)
        found[agent] = np.log(np.maximum(shares / max(shares.sum(), 1e-300), _LEAST))
    return found


def _sums(way: IntArray, logs: FloatArray, n: int) -> FloatArray:
    """Return (way,) log sums of exp(logs)."""
    highest = logs.max()
    sums = np.bincount(way, np.exp(logs - highest), n)
    return np.asarray(np.log(np.maximum(sums, 1e-300)) + highest)


@functools.lru_cache(_EVENTS_KEPT)
def _read(scene: Scene, observation: Observation, progress: bool | None) -> _Rows:
    # by object: kernels that are compared share it
    model = Model(likelihood=StepwiseLikelihood(planner_seeds=1))
    post = filter_event(Event(scene, observation), model, progress=progress)
    space: Any = space_of(scene.world)
    if not space.is_phase:
        table = RolesTable(post.dataset)
        rows = table.hypotheses
        log_prior = rows.log_prior - rows.log_drawn
        return _Rows(rows.way, rows.goals, log_prior, lambda frame: table.log_masses(frame)[0])
    grid = np.indices((len(space.ways), space.n_goals, space.n_goals)).reshape(3, -1)
    way, goals = grid[0], grid[1:].T
    possible = ~space.impossible[np.arange(2), goals].any(axis=1)
    way, goals = way[possible], goals[possible]
    sites = {space.company_site: way, **dict(zip(space.goal_sites, goals.T, strict=True))}
    red, green = space.effective(sites).T
    likelihood = np.cumsum(post.dataset["log_likelihood"].values, axis=0)
    likelihood *= post.dataset.attrs["weight"]
    return _Rows(way, goals, np.zeros(len(way)), lambda frame: likelihood[frame][red, green])
