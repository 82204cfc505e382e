"""Which hypotheses there are under a prior, and their masses, before anything is seen.

A *row* is a hypothesis without its strengths: a *way* (who helps or hinders whom) and a goal of
each agent. A *combination* has a strength of each agent.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.space import ALPHA_SITE, HypothesisSpace

MOST_HYPOTHESES: Final = 500_000  # hypotheses that are summed over; of more, so many are drawn
MOST_FOLLOWED: Final = 50_000
"""Combinations of goals of which it is followed, frame by frame, how probable they are by now."""

MOST_READ: Final = 100_000
"""Hypotheses, goals with strengths, that a user's simulator is asked about at most."""

APART: Final = {
    "log_prior_goals": ("agent", "goal"),
    "log_prior_alpha": ("way",),
    "log_prior_strengths": ("agent", "level"),
}
"""Variables of a prior whose sites are independent of each other; others have ``log_prior``."""

_FROM_PRIOR: Final = 0.1  # share of goals that are drawn from the prior


class GoalRows(NamedTuple):
    """Hypotheses about who wants what."""

    way: IntArray  # (row,) index into the ways of the world's ``HypothesisSpace``
    goals: IntArray  # (row, agent) effective goals
    stated: IntArray  # (row, agent) stated goals; of who has none, the effective one
    log_prior: FloatArray  # (row,) log prior mass
    log_drawn: FloatArray  # (row,) log of how often it is expected among those drawn; else 0


class PriorMasses:
    """Which hypotheses there are under a prior, and their masses.

    Args:
        space: of the world.
        kept: what a file has of the prior (``models.closed_loop.closed_loop_prior``): a table of
            all hypotheses, in which sites may depend on each other; or the masses of goals, ways
            and strengths that are independent of each other. Then the own goal of an
            agent that helps or hinders is not part of a hypothesis.
        combinations: (combination, agent) strengths that are followed, newtons.
    """

    def __init__(
        self, space: HypothesisSpace, kept: Mapping[str, Any], combinations: FloatArray
    ) -> None:
        self.space, self.combinations = space, combinations
        self.log_prior: FloatArray | None = kept.get("log_prior")
        # (way, its owners, the goals that each can have by the prior)
        self._possible: list[tuple[int, list[int], list[IntArray]]] = []
        if self.log_prior is not None:
            self.n_hypotheses = math.prod(self.log_prior.shape[: space.n_agents + 1])
            return
        self.log_goals, self.log_alpha, self._log_strengths = (kept[name] for name in APART)
        for way, towards in enumerate(space.ways):
            owners = [agent for agent, one in enumerate(towards) if one is None]
            if np.isfinite(self.log_alpha[way]):
                own = [np.flatnonzero(np.isfinite(self.log_goals[owner])) for owner in owners]
                self._possible.append((way, owners, own))
        sizes = (math.prod(map(len, choices)) for _, _, choices in self._possible)
        self.n_hypotheses = sum(sizes)

    @property
    def are_many(self) -> bool:
        """Whether there are so many hypotheses that some are drawn instead."""
        return self.n_hypotheses > MOST_HYPOTHESES

    def enumerated(self) -> GoalRows:
        """Return all hypotheses, without strengths."""
        if self.log_prior is None:
            picked = [
                np.stack(np.meshgrid(*choices, indexing="ij"), -1).reshape(-1, len(choices))
                for _, _, choices in self._possible
            ]
            return self._put_together(picked, [np.zeros(len(one)) for one in picked])
        sites = (*self.space.goal_sites, ALPHA_SITE)
        every = np.indices(self.log_prior.shape[: len(sites)], np.int64).reshape(len(sites), -1)
        *stated, way = every
        goals = self.space.effective(dict(zip(sites, every, strict=True)))
        log_prior = np.logaddexp.reduce(self.log_prior.reshape(len(way), -1), axis=1)
        possible = (goals >= 0).all(axis=1)
        if np.isfinite(log_prior[~possible]).any():  # somebody could not act
            log_prior = log_prior - np.logaddexp.reduce(log_prior[possible])
        log_prior = np.where(possible, log_prior, -np.inf)
        acted_on = np.maximum(goals, 0).astype(np.int64)
        return GoalRows(way, acted_on, np.stack(stated, axis=1), log_prior, np.zeros(len(way)))

    def drawn(self, likely: FloatArray) -> GoalRows:
        """Return hypotheses drawn with (agent, goal) shares of goals, and from the prior."""
        rng = np.random.default_rng(0)
        every, logs = [], []
        for way, owners, _ in self._possible:
            # more where more goals are to be chosen
            n = MOST_HYPOTHESES // (2 * len(self._possible)) + (way == 0) * (MOST_HYPOTHESES // 2)
            picked, log_drawn = np.empty((n, len(owners)), np.int64), np.full(n, np.log(n))
            for column, owner in enumerate(owners):
                own = np.exp(self.log_goals[owner])
                share = _FROM_PRIOR * own + (1 - _FROM_PRIOR) * likely[owner] * (own > 0)
                share /= share.sum()
                picked[:, column] = rng.choice(len(share), n, p=share)
                log_drawn += np.log(share[picked[:, column]])
            every.append(picked)
            logs.append(log_drawn)
        return self._put_together(every, logs)

    def _put_together(self, picked: list[IntArray], log_drawn: list[FloatArray]) -> GoalRows:
        """Return the hypotheses in which the owners of each way have some goals."""
        space, goals, log_prior, ways = self.space, [], [], []
        for (way, owners, _), own in zip(self._possible, picked, strict=True):
            every = np.empty((len(own), space.n_agents), np.int64)
            every[:, owners] = own
            for agent, owner in enumerate(space.owner[way]):
                every[:, agent] = space.becomes[way, agent][every[:, owner]]
            goals.append(every)
            log_prior.append(self.log_alpha[way] + self.log_goals[owners, own].sum(axis=1))
            ways.append(np.full(len(own), way))
        share = space.possible_share(self.log_goals, self.log_alpha)
        found = np.concatenate(goals)
        possible = (found >= 0).all(axis=1)
        which, log_mass, log_draw = map(np.concatenate, (ways, log_prior, log_drawn))
        found, log_mass = found[possible], log_mass[possible] - np.log(share)
        return GoalRows(which[possible], found, found, log_mass, log_draw[possible])

    @functools.cached_property
    def of_strengths(self) -> FloatArray:
        """(row, combination) probabilities of strengths given a hypothesis; one row: any.

        Where only some combinations are followed their margins are the prior's, so far as can be.
        """
        if self.log_prior is not None:
            masses = np.exp(self.log_prior).reshape(self.n_hypotheses, -1)
            total = masses.sum(axis=1, keepdims=True)
            return np.where(total > 0, masses / np.where(total > 0, total, 1), 1 / masses.shape[1])
        levels, agents = np.unique(self.combinations), range(self.space.n_agents)
        place = np.searchsorted(levels, self.combinations)
        prior = np.exp(self._log_strengths)
        mass = np.prod([prior[agent, place[:, agent]] for agent in agents], axis=0)
        for _ in range(50):  # iterative proportional fitting
            for agent in agents:
                now = np.bincount(place[:, agent], mass, len(levels))
                with np.errstate(divide="ignore", invalid="ignore"):
                    mass = mass * np.nan_to_num(prior[agent] / now)[place[:, agent]]
        if not (total := mass.sum()) > 0:
            raise InvalidSettingError(
                "the prior is sure of strengths that are not followed together: of three agents "
                "and more only some combinations are"
            )
        return np.asarray(mass / total)[None]

    def followed(self) -> tuple[IntArray, FloatArray] | None:
        """Return the different effective goals (goals, agent) and their log masses.

        None where there are more than :data:`MOST_FOLLOWED` hypotheses.
        """
        if self.n_hypotheses > MOST_FOLLOWED:
            return None
        rows = self.enumerated()
        goals, place = different_goals(rows.goals, self.space.n_goals)
        return goals, summed_by(place, rows.log_prior, len(goals))

    def to_read(self) -> ToRead:
        """Return what a simulator of one's own is to be asked about.

        Raises:
            InvalidSettingError: it is more than :data:`MOST_READ`.
        """
        if self.log_prior is None:
            _check_number(self.n_hypotheses, int((self.of_strengths > 0).sum()))
        rows = self.enumerated()
        possible = np.isfinite(rows.log_prior)[:, None] & (self.of_strengths > 0)
        goals, place = different_goals(rows.goals, self.space.n_goals)
        chosen = np.zeros((len(goals), len(self.combinations)), bool)
        np.logical_or.at(chosen, place, possible)
        some = chosen.any(axis=1)
        _check_number(int(some.sum()), int(chosen.any(axis=0).sum()))
        return ToRead(self.space, goals[some], self.combinations, chosen[some])


class ToRead(NamedTuple):
    """The hypotheses to ask a user's own simulator about: those with prior mass."""

    space: HypothesisSpace
    goals: IntArray  # (goals, agent) effective goals, ascending
    combinations: FloatArray  # (combination, agent) newtons
    chosen: BoolArray  # (goals, combination) which have prior mass

    def hypotheses(self) -> list[Any]:
        """Return them as simulators take them, goals by goals."""
        space, found = self.space, []
        for goals, combination in np.argwhere(self.chosen).tolist():
            sites = dict(zip(space.goal_sites, self.goals[goals].tolist(), strict=True))
            newtons = self.combinations[combination].tolist()
            sites |= dict(zip(space.strength_sites, newtons, strict=True))
            found.append(space.hypothesis({**sites, ALPHA_SITE: 0}))
        return found


def _check_number(n_goals: int, n_strengths: int) -> None:
    if n_goals * n_strengths > MOST_READ:
        raise InvalidSettingError(
            f"the prior has mass on {n_goals:.3g} combinations of goals times {n_strengths} of "
            f"strengths. Your simulator is asked about each at every frame, so at most "
            f"{MOST_READ} are allowed: give a prior with fewer goals, or fewer strengths, "
            "tracking=phase_ppl.Tracking(strengths=(300, 600))"
        )


def goal_codes(goals: IntArray, n_goals: int) -> IntArray:
    """Return (row,) a number for each combination of goals (row, agent)."""
    return np.ravel_multi_index(tuple(goals.T), (n_goals,) * goals.shape[1])


def different_goals(goals: IntArray, n_goals: int) -> tuple[IntArray, IntArray]:
    """Return the different ones of goals (row, agent), ascending, and which of them each is."""
    _, first, place = np.unique(goal_codes(goals, n_goals), return_index=True, return_inverse=True)
    return goals[first], place.reshape(-1)


def summed_by(place: IntArray, log_mass: FloatArray, n: int) -> FloatArray:
    """Return (goals,) log sums of the masses (row,), given which goals each row has."""
    found = np.full(n, -np.inf)
    np.logaddexp.at(found, place, log_mass)
    return found
