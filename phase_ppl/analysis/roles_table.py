"""From what was read of a video of any world to a table of hypotheses, at every frame.

A hypothesis is a way to help or hinder (:func:`phase_ppl.world.hypothesis.company`) and a goal of
each agent that does neither. All are summed over where there are :data:`MOST_HYPOTHESES` at most;
of more, as many are drawn, each agent's goal in proportion to about what it has of the mass, and
weighted by what they were drawn with: then sums are Monte-Carlo means.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.agents.standpoints import standpoints
from phase_ppl.analysis.stepwise_table import check_sizes, check_variables
from phase_ppl.analysis.tree import kept_scene
from phase_ppl.analysis.weights import Rows, log_sum_exp
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.hypothesis import company
from phase_ppl.world.space import space_of

SCHEMA: Final = "phase_ppl/stepwise-roles/1"

MOST_HYPOTHESES: Final = 500_000
"""Hypotheses that are summed over; of more, so many are drawn."""

_MOST_ROWS: Final = 400_000  # of a table, each a hypothesis with a combination of strengths
_LEAST: Final = 1e-9  # hypotheses with less of the mass are left out of tables
_FROM_PRIOR: Final = 0.1  # share of goals that are drawn from the prior
_GOLDEN: Final = 0.6180339887498949  # its multiples lie evenly between 0 and 1, modulo 1

DIMENSIONS: Final = {
    "density": ("time", "joint_action"),
    "policies": ("time", "agent", "policy", "planner_seed", "action"),
    "policy_of": ("time", "agent", "standpoint"),
    "marginals": ("time", "agent", "goal"),
    "strengths": ("time", "combination"),
    "combinations": ("combination", "agent"),
    "log_prior_goals": ("agent", "goal"),
    "log_prior_company": ("way",),
    "log_prior_strengths": ("agent", "level"),
    "actions": ("time", "agent", "action"),
    "held": ("time", "agent"),
    "unexplained": ("time",),
    "log_peak": ("time",),
    "trajectory": ("time", "entity", "coord"),
}
"""Variable -> dimensions; what they are is in :mod:`phase_ppl.closed_loop.world_filter`."""

REQUIRED_ATTRS: Final = ("event_id", "settings", "cost", "weight", "schema", "world")


def check(found: xr.Dataset) -> None:
    """Raise InvalidEventError, naming what is missing or wrong, if ``found`` is no such table."""
    check_variables(found, SCHEMA, DIMENSIONS, REQUIRED_ATTRS)
    world = kept_scene(found).world
    n = len(world.agents)
    sizes = {"agent": n, "goal": len(world.goals), "action": N_ACTIONS, "way": len(company(n))}
    check_sizes(found, {**sizes, "joint_action": N_ACTIONS**n})
    numbers = found["policy_of"].values
    if (numbers < 0).any() or (numbers >= found.sizes["policy"]).any():
        raise InvalidEventError("policy_of names a policy that there is not")
    for name in ("density", "strengths", "log_prior_company", "trajectory"):
        values = found[name].values
        if np.isnan(values).any() or (values == np.inf).any():
            raise InvalidEventError(f"{name} has values that cannot be")


class RoleRows(NamedTuple):
    """Hypotheses about who wants what."""

    way: IntArray  # (row,) index into ``company``
    goals: IntArray  # (row, agent) effective goals
    log_prior: FloatArray  # (row,) log prior mass
    log_drawn: FloatArray  # (row,) log of how often it is expected among those drawn; else 0
    standpoints: list[IntArray]  # of each agent (row,)


class RolesTable:
    """Hypotheses about a video, and their log masses at any frame."""

    def __init__(self, found: xr.Dataset) -> None:
        self.world = kept_scene(found).world
        self._found = found
        self._weight = float(found.attrs["weight"])
        self._log_goals = found["log_prior_goals"].values
        self._log_company = found["log_prior_company"].values
        self._levels = np.unique(found["combinations"].values)
        self._space = space_of(self.world)
        # (way, its owners, the goals that each can have by the prior)
        self._ways: list[tuple[int, list[int], list[IntArray]]] = []
        for way, towards in enumerate(company(len(self.world.agents))):
            owners = [agent for agent, one in enumerate(towards) if one is None]
            if np.isfinite(self._log_company[way]):
                own = [np.flatnonzero(np.isfinite(self._log_goals[owner])) for owner in owners]
                self._ways.append((way, owners, own))
        self.n_hypotheses = sum(math.prod(map(len, choices)) for _, _, choices in self._ways)
        self.sampled = self.n_hypotheses > MOST_HYPOTHESES
        self._at = -1  # the frame up to which ``_so_far`` counts
        self._so_far = np.zeros((0, 0))

    @property
    def n_frames(self) -> int:
        """Frames that were read."""
        return int(self._found.sizes["time"])

    @property
    def n_seeds(self) -> int:
        """Sets of searches."""
        return int(self._found.sizes["planner_seed"])

    @property
    def n_tables(self) -> int:
        """Masses there are of each hypothesis: with all sets of searches, and without each."""
        return 1 + (self.n_seeds if self.n_seeds > 1 else 0)

    @functools.cached_property
    def hypotheses(self) -> RoleRows:
        """The hypotheses that are summed over."""
        return self._drawn() if self.sampled else self._enumerated()

    def most_probable(self, frame: int) -> int:
        """Return the place of the hypothesis with the highest mass, given frames up to one."""
        return int((self.log_masses(frame)[0] + self.hypotheses.log_drawn).argmax())

    def n_effective(self, frame: int) -> float:
        """Return of how many independent draws the masses at a frame are worth."""
        weights = self.weights(frame)[0]
        return float(1 / (weights**2).sum())

    def weights(self, frame: int) -> FloatArray:
        """Return (1 + planner_seed, row) :meth:`log_masses` as probabilities."""
        masses = self.log_masses(frame)
        return np.exp(masses - np.array([log_sum_exp(one) for one in masses])[:, None])

    def log_masses(self, frame: int, weight: float | None = None) -> FloatArray:
        """Return (1 + planner_seed, row) log masses given the frames up to ``frame``.

        The first row is with all sets of searches, the others are without each; where there is one
        set, there is the first only. A frame counts ``weight``, by default the likelihood's.
        """
        weight = self._weight if weight is None else weight
        rows = self.hypotheses
        if self._at > frame or self._at < 0:
            self._at = 0
            self._so_far = np.zeros((self.n_tables, len(rows.way)))
        for t in range(self._at + 1, frame + 1):
            self._so_far += self._frame(t)
        self._at = frame
        return np.asarray(rows.log_prior - rows.log_drawn + weight * self._so_far)

    def _frame(self, t: int) -> FloatArray:
        """Return (1 + planner_seed, row) log likelihoods of one frame."""
        n, n_sets = len(self.world.agents), self.n_seeds
        density = self._found["density"].values[t]
        relative = np.exp(density - density.max()).reshape((N_ACTIONS,) * n)
        policies = self._found["policies"].values[t].astype(np.float64)
        numbers = self._found["policy_of"].values[t]
        sizes = [int(numbers[agent].max()) + 1 for agent in range(n)]
        place = np.zeros(len(self.hypotheses.way), np.int64)
        for agent in range(n):
            place = place * sizes[agent] + numbers[agent][self.hypotheses.standpoints[agent]]
        found = np.empty((self.n_tables, len(place)))
        for row, left_out in zip(found, [None, *range(n_sets)], strict=False):
            sets = [one for one in range(n_sets) if one != left_out]
            table = relative
            for agent in range(n):  # the first axis goes, and what it becomes is put last
                mean = policies[agent, : sizes[agent], sets].mean(axis=0)
                table = np.tensordot(table, mean, axes=(0, 1))
            with np.errstate(divide="ignore"):
                row[:] = np.log(table.ravel())[place] + density.max()
        return found

    def _enumerated(self) -> RoleRows:
        picked = [
            np.stack(np.meshgrid(*choices, indexing="ij"), -1).reshape(-1, len(choices))
            for _, _, choices in self._ways
        ]
        return self._put_together(picked, [np.zeros(len(one)) for one in picked])

    def _drawn(self) -> RoleRows:
        """Return hypotheses drawn by how probable each agent's goals are at about any frame."""
        marginals = self._found["marginals"].values
        masses = np.exp(marginals - marginals.max(axis=2, keepdims=True))
        likely = (masses / masses.sum(axis=2, keepdims=True)).mean(axis=0)
        rng = np.random.default_rng(0)
        every, logs = [], []
        for way, owners, _ in self._ways:
            # more where more goals are to be chosen
            n = MOST_HYPOTHESES // (2 * len(self._ways)) + (way == 0) * (MOST_HYPOTHESES // 2)
            picked, log_drawn = np.empty((n, len(owners)), np.int64), np.full(n, np.log(n))
            for column, owner in enumerate(owners):
                own = np.exp(self._log_goals[owner])
                share = _FROM_PRIOR * own + (1 - _FROM_PRIOR) * likely[owner] * (own > 0)
                share /= share.sum()
                picked[:, column] = rng.choice(len(share), n, p=share)
                log_drawn += np.log(share[picked[:, column]])
            every.append(picked)
            logs.append(log_drawn)
        return self._put_together(every, logs)

    def _put_together(self, picked: list[IntArray], log_drawn: list[FloatArray]) -> RoleRows:
        """Return the hypotheses in which the owners of each way have some goals."""
        n_agents = len(self.world.agents)
        goals, log_prior, ways = [], [], []
        for (way, owners, _), own in zip(self._ways, picked, strict=True):
            every = np.empty((len(own), n_agents), np.int64)
            every[:, owners] = own
            for agent, owner in enumerate(self._space.owner[way]):
                every[:, agent] = self._space.becomes[way, agent][every[:, owner]]
            goals.append(every)
            log_prior.append(self._log_company[way] + self._log_goals[owners, own].sum(axis=1))
            ways.append(np.full(len(own), way))
        possible_share = self._space.possible_share(self._log_goals, self._log_company)
        all_goals = np.concatenate(goals)
        possible = (all_goals >= 0).all(axis=1)
        all_goals = all_goals[possible]
        return RoleRows(
            np.concatenate(ways)[possible],
            all_goals,
            np.concatenate(log_prior)[possible] - np.log(possible_share),
            np.concatenate(log_drawn)[possible],
            [standpoints(agent, self.world).of(all_goals) for agent in range(n_agents)],
        )

    # --- tables ---------------------------------------------------------------------------------

    def rows(self, frame: int) -> tuple[Rows, FloatArray]:
        """Return the hypotheses that have any mass to speak of, and (set, row) weights without."""
        weights = self.weights(frame)
        kept = np.flatnonzero(weights[0] > _LEAST * weights[0].max())
        weights = weights[:, kept]
        of_strengths = self.strengths(frame)
        if len(kept) * len(of_strengths) <= _MOST_ROWS:
            combination = np.tile(np.arange(len(of_strengths)), len(kept))
            kept = np.repeat(kept, len(of_strengths))
            weights = (weights[:, :, None] * of_strengths).reshape(len(weights), -1)
        else:  # two combinations each, in their proportions
            at = (np.arange(len(kept)) * _GOLDEN)[:, None] + [0.0, 0.5]
            combination = np.searchsorted(np.cumsum(of_strengths), (at % 1.0).ravel())
            combination = np.minimum(combination, len(of_strengths) - 1)
            kept, weights = np.repeat(kept, 2), np.repeat(weights, 2, axis=1)
        weights /= weights.sum(axis=1, keepdims=True)
        values = self.columns(kept)
        newtons = self._found["combinations"].values[combination]
        for agent, key in enumerate(self.world.keys):
            values[f"strength_{key}"] = newtons[:, agent]
        index = {"hypothesis": np.arange(len(kept))}
        return Rows(values, weights[0], index), weights[1:]

    def strengths(self, frame: int) -> FloatArray:
        """Return (combination,) probabilities of the strengths that were followed."""
        prior = self.log_prior_of_combinations
        found = prior + np.log(np.maximum(self._found["strengths"].values[frame], 1e-300))
        return np.exp(found - log_sum_exp(found))

    def log_evidence(self, frame: int) -> float:
        """Return log p of the frames up to ``frame``, in nats, each counted in full."""
        strengths = self._found["strengths"].values[frame]
        prior = np.exp(self.log_prior_of_combinations)
        of_strengths = np.log(prior @ strengths * len(strengths))
        return float(log_sum_exp(self.log_masses(frame, 1.0)[0]) + of_strengths)

    @functools.cached_property
    def log_prior_of_combinations(self) -> FloatArray:
        """Return (combination,) log masses whose margins are the prior's, so far as they can be."""
        combinations = self._found["combinations"].values
        place = np.searchsorted(self._levels, combinations)
        prior = np.exp(self._found["log_prior_strengths"].values)
        mass = np.prod([prior[agent, place[:, agent]] for agent in range(place.shape[1])], axis=0)
        for _ in range(50):  # iterative proportional fitting
            for agent in range(place.shape[1]):
                now = np.bincount(place[:, agent], mass, len(self._levels))
                with np.errstate(divide="ignore", invalid="ignore"):
                    mass = mass * np.nan_to_num(prior[agent] / now)[place[:, agent]]
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(mass / mass.sum()))

    def codes(self, goals: IntArray) -> dict[str, IntArray]:
        """Return the codes of goals and relations of (row, agent) effective goals."""
        own = {name: goals[:, agent] for agent, name in enumerate(self._space.goal_sites)}
        return {**own, **self._space.relation_codes(goals)}

    def columns(self, rows: IntArray | None = None) -> dict[str, NDArray[Any]]:
        """Return the codes of goals, relations and alphas of some hypotheses, or of all."""
        way, goals = self.hypotheses.way, self.hypotheses.goals
        if rows is not None:
            way, goals = way[rows], goals[rows]
        return {**self.codes(goals), **self._space.alpha_codes(way)}

    @functools.cached_property
    def log_predictive(self) -> FloatArray:
        """Return (time,) log density of each frame given those before it; 0 for the first."""
        found = np.zeros(self.n_frames)
        for t in range(1, self.n_frames):
            before = self.log_masses(t - 1)[0]
            found[t] = log_sum_exp(before - log_sum_exp(before) + self._frame(t)[0])
        return found
