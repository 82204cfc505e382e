"""From subgoals of single belief particles to one subgoal, and from there to an action."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents import pomcp
from phase_ppl.agents.beliefs import Beliefs
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.mind import Mind
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import Action
from phase_ppl.physics.compiled import Scratch
from phase_ppl.world.names import NOTHING, STOP, Literal, Predicate


def best_subgoal(
    agreeing: Mapping[Literal, Sequence[int]],
    costs: NDArray[np.float64],
    done: float,
    agent: int,
    config: PlannerConfig,
) -> Literal:
    """Return the subgoal of highest value V (paper, Algorithm 1).

    V(h) = share of the particles with subgoal h - lambda x their mean cost.

    Args:
        agreeing: subgoal -> particles for which it was planned.
        costs: (K,) cost C of each particle, units.
        done: share of the particles in which the agent's goal is reached.
        agent: who plans.
        config: settings of the planner.
    """
    if len(agreeing) == 1:
        return next(iter(agreeing))
    n = config.particles
    value = {
        subgoal: len(members) / n - config.cost_weight * costs[members].mean()
        for subgoal, members in agreeing.items()
    }
    candidates = sorted(value)
    # particles in which nothing is left to do are cheap; they must not end a search
    if not (done > 0.5 and len(agreeing.get(STOP, ())) > n / 2):
        candidates = [c for c in candidates if c != STOP]
    if config.touch_override:
        candidates = _touching(candidates, agent) or candidates
    return max(candidates, key=value.__getitem__)


def _touching(candidates: list[Literal], agent: int) -> list[Literal]:
    """Return the TOUCH subgoal that the authors' code prefers: items first, then the agent."""
    order = {2: 0, 3: 1, 1 - agent: 2}
    touching = [c for c in candidates if c.predicate is Predicate.TOUCH and c.positive]
    return sorted(touching, key=lambda c: order[c.target])[:1]


def reflex(
    subgoal: Literal, particle: int, agent: int, beliefs: Beliefs, mind: Mind
) -> Action | None:
    """Return the action that needs no search: stop, let go, or grab what is in reach.

    Args:
        subgoal: what the agent is about.
        particle: one of the particles that agree with it.
        agent: 0 red, 1 green.
        beliefs, mind: its own.
    """
    if subgoal == STOP:
        return Action.STOP
    if subgoal.predicate is not Predicate.ATTACH:
        return None
    if not subgoal.positive:
        return Action.DETACH
    if beliefs.held[particle, agent] != NOTHING:
        return None
    item, _ = compiled.find_grab(
        beliefs.bodies[particle], beliefs.held[particle], agent, mind.params
    )
    return Action.ATTACH if item == subgoal.target else None


def make_search(config: PlannerConfig) -> pomcp.Search:
    """Return the settings of a search as compiled code wants them."""
    return pomcp.Search(
        config.simulations,
        config.rollout_length,
        config.discount,
        config.c_init,
        config.c_base,
        config.early_stop,
        config.paired,
    )


class Root(NamedTuple):
    """What a search found.

    Attributes:
        column: of the best action.
        visits: (A,) of the actions; values: (A,) mean returns, NaN if unvisited.
    """

    column: int
    visits: NDArray[np.int64]
    values: NDArray[np.float64]


def search_actions(
    tree: pomcp.Tree,
    subgoal: Literal,
    agreeing: NDArray[np.int64],
    actions: NDArray[np.int64],
    agent: int,
    beliefs: Beliefs,
    mind: Mind,
    search: pomcp.Search,
    scratch: Scratch,
    rng: NDArray[np.uint64],
) -> Root:
    """Search for the best action over the particles that agree with a subgoal.

    Args:
        tree: empty, or the kept subtree of the previous step.
        subgoal, agreeing, actions: as of :func:`phase_ppl.agents.pomcp.run`.
        agent: 0 red, 1 green.
        beliefs, mind: its own.
        search, scratch, rng: settings, work space and random numbers.
    """
    column = pomcp.run(
        tree,
        beliefs.bodies,
        beliefs.held,
        beliefs.weld,
        agreeing,
        agent,
        pomcp.subgoal_code(subgoal),
        actions,
        search,
        mind.params,
        mind.ground,
        scratch,
        rng,
    )
    children = tree.child[0, : len(actions)]
    visited = children >= 0
    visits = np.where(visited, tree.visits[children], 0).astype(np.int64)
    with np.errstate(invalid="ignore", divide="ignore"):
        values = np.where(visited, tree.total[children] / np.maximum(visits, 1), np.nan)
    return Root(column, visits, values)
