"""What the closed loop read, as a table of hypotheses about a video, at every frame.

A hypothesis is a way in which agents stand to each other, a goal of each, and strengths. Its mass
is that of the prior (:class:`Prior`) times what frames say of it. Frames say something of the goals
of all agents together and of strengths: the agents' policies, and with them how probable a frame
is (:mod:`phase_ppl.closed_loop.goal_filter`); or, where a simulator of one's own was asked, a log
density for each combination of goals and strengths that has prior mass.

All hypotheses are summed over where there are :data:`MOST_HYPOTHESES` at most; of more, as many are
drawn, each agent's goal in proportion to about what it has of the mass, and weighted by what they
were drawn with: then sums are Monte-Carlo means.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.agents.standpoints import standpoints
from phase_ppl.analysis.estimate import Estimate, over_sets
from phase_ppl.analysis.stepwise_file import APART, as_written_now
from phase_ppl.analysis.tree import kept_world
from phase_ppl.analysis.weights import Rows, log_sum_exp
from phase_ppl.closed_loop.frame_likelihood import log_likelihoods
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.space import HypothesisSpace, space_of

MOST_HYPOTHESES: Final = 500_000  # hypotheses that are summed over; of more, so many are drawn
MOST_FOLLOWED: Final = 50_000
"""Combinations of goals of which it is followed, frame by frame, how probable they are by now."""

MOST_READ: Final = 100_000
"""Hypotheses, goals with strengths, that a simulator of one's own is asked about at most."""

MOST_ROWS: Final = 400_000
"""Hypotheses with combinations of strengths up to which all are in one table, where strengths are
independent of goals; of more, strengths are drawn."""

_LEAST: Final = 1e-12  # hypotheses with a smaller share of the mass of the best are left out
_FROM_PRIOR: Final = 0.1  # share of goals that are drawn from the prior
GOLDEN: Final = 0.6180339887498949  # its multiples lie evenly between 0 and 1, modulo 1

# --- the prior ------------------------------------------------------------------------------------


class GoalRows(NamedTuple):
    """Hypotheses about who wants what."""

    way: IntArray  # (row,) index into the ways of the world's ``HypothesisSpace``
    goals: IntArray  # (row, agent) effective goals
    stated: IntArray  # (row, agent) stated goals; of who has none, the effective one
    log_prior: FloatArray  # (row,) log prior mass
    log_drawn: FloatArray  # (row,) log of how often it is expected among those drawn; else 0


class Prior:
    """Which hypotheses there are under a prior, and their masses.

    Args:
        space: of the world.
        kept: what a file has of the prior (:func:`phase_ppl.models.stepwise.stepwise_prior`): a
            table of all hypotheses, in which sites may depend on each other; or the masses of
            goals, ways and strengths that are independent of each other. Then the own goal of an
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
        self.log_goals, self.log_company, self._log_strengths = (kept[name] for name in APART)
        for way, towards in enumerate(space.ways):
            owners = [agent for agent, one in enumerate(towards) if one is None]
            if np.isfinite(self.log_company[way]):
                own = [np.flatnonzero(np.isfinite(self.log_goals[owner])) for owner in owners]
                self._possible.append((way, owners, own))
        sizes = (math.prod(map(len, choices)) for _, _, choices in self._possible)
        self.n_hypotheses = sum(sizes)

    def enumerated(self) -> GoalRows:
        """Return all hypotheses, without strengths."""
        if self.log_prior is None:
            picked = [
                np.stack(np.meshgrid(*choices, indexing="ij"), -1).reshape(-1, len(choices))
                for _, _, choices in self._possible
            ]
            return self._put_together(picked, [np.zeros(len(one)) for one in picked])
        sites = (*self.space.goal_sites, self.space.company_site)
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
            log_prior.append(self.log_company[way] + self.log_goals[owners, own].sum(axis=1))
            ways.append(np.full(len(own), way))
        share = space.possible_share(self.log_goals, self.log_company)
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
        """Return the different effective goals (point, agent) and their log masses.

        None where there are more than :data:`MOST_FOLLOWED` hypotheses.
        """
        if self.n_hypotheses > MOST_FOLLOWED:
            return None
        rows = self.enumerated()
        points, place = _different(rows.goals, self.space.n_goals)
        return points, _summed_by(place, rows.log_prior, len(points))

    def to_read(self) -> Read:
        """Return what a simulator of one's own is to be asked about.

        Raises:
            InvalidSettingError: it is more than :data:`MOST_READ`.
        """
        if self.log_prior is None:
            _check_number(self.n_hypotheses, int((self.of_strengths > 0).sum()))
        rows = self.enumerated()
        possible = np.isfinite(rows.log_prior)[:, None] & (self.of_strengths > 0)
        points, place = _different(rows.goals, self.space.n_goals)
        chosen = np.zeros((len(points), len(self.combinations)), bool)
        np.logical_or.at(chosen, place, possible)
        some = chosen.any(axis=1)
        _check_number(int(some.sum()), int(chosen.any(axis=0).sum()))
        return Read(self.space, points[some], self.combinations, chosen[some])


class Read(NamedTuple):
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
            found.append(space.hypothesis({**sites, space.company_site: 0}))
        return found


def _check_number(n_goals: int, n_strengths: int) -> None:
    if n_goals * n_strengths > MOST_READ:
        raise InvalidSettingError(
            f"the prior has mass on {n_goals:.3g} combinations of goals times {n_strengths} of "
            f"strengths. Your simulator is asked about each at every frame, so at most "
            f"{MOST_READ} are allowed: give a prior with fewer goals, or fewer strengths, "
            "tracking=phase_ppl.Tracking(strengths=(300, 600))"
        )


def _codes(goals: IntArray, n_goals: int) -> IntArray:
    return np.ravel_multi_index(tuple(goals.T), (n_goals,) * goals.shape[1])


def _different(goals: IntArray, n_goals: int) -> tuple[IntArray, IntArray]:
    """Return the different ones of goals (row, agent), ascending, and which of them each is."""
    _, first, place = np.unique(_codes(goals, n_goals), return_index=True, return_inverse=True)
    return goals[first], place.reshape(-1)


def _summed_by(place: IntArray, log_mass: FloatArray, n: int) -> FloatArray:
    found = np.full(n, -np.inf)
    np.logaddexp.at(found, place, log_mass)
    return found


# --- the table ------------------------------------------------------------------------------------


class Table:
    """Hypotheses about a video, and their log masses at any frame; :func:`table_of` makes it.

    Attributes:
        found: variables of :mod:`phase_ppl.analysis.stepwise_file`, as this version writes them.
        space: the hypotheses of the world.
        prior: which of them there are.
        sampled: whether hypotheses were drawn.
        own: whether a simulator of one's own was read, strengths along with goals.
        samples: of it, for each hypothesis and frame; 0 where it has a density; else None.
        is_exact: whether there is no chance in it, so that errors are 0.
        points: (point, agent) the combinations of effective goals of which frames say something.
    """

    def __init__(self, found: xr.Dataset) -> None:
        self.found, self.space = found, space_of(kept_world(found))
        self._weight, self.n_frames = float(found.attrs["weight"]), int(found.sizes["time"])
        self.own = "samples" in found.attrs
        self.samples = int(found.attrs["samples"]) if self.own else None
        self.is_exact = self.samples == 0
        kept = {name: found[name].values for name in ("log_prior", *APART) if name in found}
        self.prior = Prior(self.space, kept, found["combinations"].values)
        self.sampled = self.prior.n_hypotheses > MOST_HYPOTHESES
        self._sums = -1, np.empty(0)  # the last frame that is summed up, and the sums

    def extended(self, found: xr.Dataset) -> Self:
        """Return the table of the same video with further frames, which goes on from this one.

        So that a stream costs as much at a late frame as at an early one, where all hypotheses are
        summed.
        """
        after = type(self)(found)
        if not self.sampled:  # others are drawn by what all frames say
            names = ("prior", "hypotheses", "_log_prior", "_places", "_numbers", "_sums")
            vars(after).update({name: vars(self)[name] for name in names if name in vars(self)})
        return after

    def check_was_read(self) -> None:
        """Raise InvalidSettingError unless the simulator was asked about all that has mass."""
        prior = np.isfinite(self._log_prior)
        known = (self.points[self._place] == self.hypotheses.goals).all(axis=1)
        read = ~np.isnan(self.found["log_likelihood"].values[0][self._place])
        if missing := int((prior & ~(known[:, None] & read)).sum()):
            raise InvalidSettingError(
                f"the prior has mass on {missing} hypotheses that the simulator was not asked "
                "about, as the first prior had none there: infer the event again with this one"
            )

    @functools.cached_property
    def hypotheses(self) -> GoalRows:
        """The hypotheses that are summed over, without strengths."""
        if not self.sampled:
            return self.prior.enumerated()
        marginals = self.found["marginals"].values  # by how probable goals are at about any frame
        masses = np.exp(marginals - marginals.max(axis=2, keepdims=True))
        return self.prior.drawn((masses / masses.sum(axis=2, keepdims=True)).mean(axis=0))

    @functools.cached_property
    def _places(self) -> tuple[IntArray, IntArray]:
        goals, n = self.hypotheses.goals, self.space.n_goals
        if self.sampled:
            return goals, np.arange(len(goals))
        if "goals" not in self.found:
            return _different(goals, n)
        points = self.found["goals"].values
        place = np.searchsorted(_codes(points, n), _codes(goals, n))
        return points, np.minimum(place, len(points) - 1)  # of goals without mass any will do

    @property
    def points(self) -> IntArray:
        return self._places[0]

    @property
    def _place(self) -> IntArray:
        """(row,) the point of each hypothesis."""
        return self._places[1]

    @functools.cached_property
    def _numbers(self) -> list[IntArray]:
        """(agent) (point,) the standpoint of each agent."""
        world = self.space.world
        return [standpoints(agent, world).of(self.points) for agent in range(self.space.n_agents)]

    @property
    def combinations(self) -> FloatArray:
        """(combination, agent) strengths, newtons."""
        return self.prior.combinations

    @property
    def levels(self) -> tuple[float, ...]:
        """Strengths, newtons, ascending."""
        return tuple(np.unique(self.combinations).tolist())

    @property
    def n_sets(self) -> int:
        """Sets of searches, or parts of samples."""
        if "policies" in self.found:
            return int(self.found.sizes["planner_seed"])
        return max(1, len(self.found["log_likelihood_without"]))

    @property
    def n_tables(self) -> int:
        """Masses there are of each hypothesis: with all sets of searches, and without each."""
        return 1 + (self.n_sets if self.n_sets > 1 else 0)

    # --- what frames say ------------------------------------------------------------------------

    def of_frame(self, t: int, n_tables: int = 1) -> FloatArray:
        """Return (table, point) log likelihoods of one frame, of so many tables; of the first, 0.

        With strengths read along, (table, point, combination), NaN where nothing was asked.
        """
        found = self.found
        if "log_likelihood" in found:
            without = found["log_likelihood_without"].values[: n_tables - 1, t]
            return np.array([found["log_likelihood"].values[t], *without], np.float64)
        if t == 0:
            return np.zeros((n_tables, len(self.points)))
        policy_of, policies = found["policy_of"].values[t], found["policies"].values[t]
        numbers = [of[place] for of, place in zip(policy_of, self._numbers, strict=True)]
        of_agents = [
            one[: of.max() + 1].astype(np.float64)
            for one, of in zip(policies, policy_of, strict=True)
        ]
        density = found["density"].values[t].reshape((N_ACTIONS,) * self.space.n_agents)
        first, every = log_likelihoods(density, of_agents, numbers, n_tables)
        moved = first + found["shift"].values[t, :n_tables, None]
        return np.where(np.isnan(every), moved, every)

    def summed(self, frame: int) -> FloatArray:
        """Return (table, point) log likelihoods of the frames up to ``frame``, as of one."""
        at, sums = self._sums
        if not 0 <= at <= frame:
            at, sums = 0, self.of_frame(0, self.n_tables)
        for t in range(at + 1, frame + 1):
            sums = sums + self.of_frame(t, self.n_tables)  # others may have the old ones
        self._sums = frame, sums
        return sums

    def of_strengths(self, frame: int) -> FloatArray:
        """Return (combination,) what the frames so far say of strengths, whatever the goals.

        That is their probabilities now over those before any frame, which were equal.
        """
        if self.own:
            return np.ones(len(self.combinations))
        found = self.found["strengths"].values[frame]
        return np.maximum(found, 1e-300) * found.size

    def log_likelihood(self, frame: int) -> FloatArray:
        """Return (row, combination) log likelihoods of the frames up to ``frame``, as they count.

        -inf where nothing was asked.
        """
        found = self._weight * self.summed(frame)[0][self._place]
        if self.own:
            return np.where(np.isfinite(self._log_prior), found, -np.inf)
        return np.asarray(found[:, None] + np.log(self.of_strengths(frame)))

    def by_points(self) -> FloatArray:
        """Return (time, point) log densities of frames given those before them.

        Strengths that were read along are averaged over, as they are believed to be by then.
        """
        if not self.own:
            return np.array([self.of_frame(t)[0] for t in range(self.n_frames)])
        n = len(self.points)
        masses = np.array(
            [_summed_by(self._place, self.log_masses(t)[0], n) for t in range(self.n_frames)]
        )
        with np.errstate(invalid="ignore"):  # of what was impossible before
            found = np.diff(masses, axis=0, prepend=masses[:1]) / self._weight
        return np.where(np.isnan(found), -np.inf, found)

    def by_goals(self, of_points: FloatArray) -> FloatArray:
        """Return (..., goal of the first agent, of the second, ...) of (..., point); else -inf."""
        found = np.full(
            (*of_points.shape[:-1], *[self.space.n_goals] * self.space.n_agents), -np.inf
        )
        found[..., *self.points.T] = of_points
        return found

    def prior_of_goals(self) -> FloatArray:
        """Return (goal of the first agent, of the second, ...) log prior masses."""
        return self.by_goals(_summed_by(self._place, self.hypotheses.log_prior, len(self.points)))

    # --- masses of goals ------------------------------------------------------------------------

    @functools.cached_property
    def _log_prior(self) -> FloatArray:
        """(row, combination) log prior masses."""
        with np.errstate(divide="ignore"):
            return self.hypotheses.log_prior[:, None] + np.log(self.prior.of_strengths)

    def _masses(self, frame: int, weight: float) -> FloatArray:
        """Return (table, row, combination) log masses, of strengths that were read along."""
        found = np.full((self.n_tables, *self._log_prior.shape), -np.inf)
        some = np.flatnonzero(np.isfinite(self._log_prior).any(axis=1))
        prior, so_far = self._log_prior[some], weight * self.summed(frame)[:, self._place[some]]
        found[:, some] = np.where(prior > -np.inf, prior + so_far, -np.inf)
        return found

    def log_masses(self, frame: int, weight: float | None = None) -> FloatArray:
        """Return (table, row) log masses given the frames up to ``frame``.

        The first table is with all sets of searches, the others are without each; where there is
        one set, there is the first only. A frame counts ``weight``, by default the likelihood's.
        """
        weight = self._weight if weight is None else weight
        if self.own:
            return np.asarray(np.logaddexp.reduce(self._masses(frame, weight), axis=2))
        rows, of_strengths = self.hypotheses, self.prior.of_strengths @ self.of_strengths(frame)
        so_far = weight * self.summed(frame)[:, self._place]
        return np.asarray(rows.log_prior - rows.log_drawn + np.log(of_strengths) + so_far)

    def log_masses_within(self, first: int, last: int) -> FloatArray:
        """Return (row,) log masses given the frames after ``first`` up to ``last`` alone.

        With all sets of searches; of strengths these frames say nothing here.
        """
        rows = self.hypotheses
        with np.errstate(invalid="ignore"):  # what has become impossible before stays so
            seen = -self.summed(first)[0] + self.summed(last)[0]
        seen = np.where(np.isnan(seen), -np.inf, seen)[self._place]
        return np.asarray(rows.log_prior - rows.log_drawn + self._weight * seen)

    def weights(self, frame: int) -> FloatArray:
        """Return (table, row) :meth:`log_masses` as probabilities."""
        return _shares(self.log_masses(frame))

    def log_evidence(self, frame: int) -> Estimate:
        """Return log p of the frames up to ``frame``, in nats, each counted in full.

        Its error is by the jackknife over sets of searches; NaN: there is a single set.
        """
        value, *without = [log_sum_exp(masses) for masses in self.log_masses(frame, 1.0)]
        if self.is_exact:
            return Estimate(value, 0.0)
        sets = over_sets(np.reshape(without, (-1, 1)))
        return Estimate(value, math.nan if sets is None else float(sets.error(without, value)))

    @functools.cached_property
    def log_predictive(self) -> FloatArray:
        """Return (time,) log density of each frame given those before it; 0 for the first."""
        found = np.zeros(self.n_frames)
        for t in range(1, self.n_frames):
            before = self.log_masses(t - 1)[0]
            of_frame = self.of_frame(t)[0][self._place]
            found[t] = log_sum_exp(before - log_sum_exp(before) + of_frame)
        return found

    # --- tables ---------------------------------------------------------------------------------

    def strengths(self, frame: int) -> FloatArray:
        """Return (row, combination) probabilities of strengths given a hypothesis; one row: any."""
        if not self.own:
            found = self.prior.of_strengths * self.of_strengths(frame)
            return np.asarray(found / found.sum(axis=1, keepdims=True))
        masses = self._masses(frame, self._weight)[0]
        possible = masses.max(axis=1, keepdims=True) > -np.inf
        masses = np.where(possible, masses, 0.0)
        return np.where(possible, _shares(masses), self.prior.of_strengths)

    def all_log_masses(self, frame: int) -> FloatArray:
        """Return (table, row of :meth:`all_columns`) log masses."""
        if self.own:
            return self._masses(frame, self._weight).reshape(self.n_tables, -1)
        masses = self.log_masses(frame)
        if not self._with_strengths(len(self.hypotheses.way)):
            return masses
        with np.errstate(divide="ignore"):
            strengths = np.log(self.strengths(frame))
        return np.asarray((masses[:, :, None] + strengths).reshape(len(masses), -1))

    def _with_strengths(self, n: int) -> bool:
        """Whether so many hypotheses with all strengths are in one table."""
        depend = self.own or self.prior.log_prior is not None
        return depend or n * len(self.combinations) <= MOST_ROWS

    def all_columns(self) -> dict[str, NDArray[Any]]:
        """Return the codes of all hypotheses, with all strengths unless these are too many."""
        n_rows, n = len(self.hypotheses.way), len(self.combinations)
        if not self._with_strengths(n_rows):
            return self.columns()
        return self.columns(*np.divmod(np.arange(n_rows * n), n))

    def columns(
        self, rows: IntArray | None = None, combination: IntArray | None = None
    ) -> dict[str, NDArray[Any]]:
        """Return the codes of some hypotheses, or of all, with or without strengths."""
        space, found = self.space, self.hypotheses
        way, goals, stated = (
            part if rows is None else part[rows] for part in (found.way, found.goals, found.stated)
        )
        values: dict[str, NDArray[Any]] = {
            **dict(zip(space.stated_sites, stated.T, strict=True)),
            space.company_site: way,
            **dict(zip(space.goal_sites, goals.T, strict=True)),
        }
        if combination is not None:
            newtons = self.combinations[combination].T
            values |= dict(zip(space.strength_sites, newtons, strict=True))
        return values

    def rows(self, frame: int) -> tuple[Rows, FloatArray]:
        """Return hypotheses with any mass to speak of, and (set, row) weights without each set."""
        weights, n = self.weights(frame), len(self.combinations)
        kept = np.flatnonzero(weights[0] > _LEAST * weights[0].max())
        if self._with_strengths(len(kept)):
            if self.own:  # each part of the samples has strengths of its own
                weights = _shares(
                    self._masses(frame, self._weight)[:, kept].reshape(len(weights), -1)
                )
            else:
                strengths = self.strengths(frame)
                strengths = strengths[kept] if len(strengths) > 1 else strengths
                weights = (weights[:, kept, None] * strengths).reshape(len(weights), -1)
            some = np.flatnonzero(weights[0] > _LEAST * weights[0].max())
            row, combination = np.divmod(some, n)
            kept, weights = kept[row], weights[:, some]
        else:  # two combinations each, in their proportions: a low-discrepancy draw
            at = (np.arange(len(kept)) * GOLDEN)[:, None] + [0.0, 0.5]
            combination = np.searchsorted(np.cumsum(self.strengths(frame)[0]), (at % 1.0).ravel())
            combination = np.minimum(combination, n - 1)
            kept, weights = np.repeat(kept, 2), np.repeat(weights[:, kept], 2, axis=1)
        weights = weights / weights.sum(axis=1, keepdims=True)
        index = {"hypothesis": np.arange(len(kept))}
        return Rows(self.columns(kept, combination), weights[0], index), weights[1:]

    def most_probable(self, frame: int) -> dict[str, Any]:
        """Return the codes of the most probable hypothesis, whatever it was drawn with."""
        strengths = self.strengths(frame)
        masses = self.log_masses(frame)[0] + self.hypotheses.log_drawn
        row = (masses + np.log(strengths.max(axis=1))).argmax()
        combination = strengths[row if len(strengths) > 1 else 0].argmax()
        columns = self.columns(np.array([row]), np.array([combination]))
        return {name: column[0].item() for name, column in columns.items()}


def table_of(found: xr.Dataset) -> Table:
    """Return the hypotheses about a video that the closed loop read.

    Args:
        found: as of :mod:`phase_ppl.analysis.stepwise_file`, of this version or an older one.

    Raises:
        InvalidEventError: ``found`` lacks something; the message names it.
        InvalidSettingError: the prior has mass on hypotheses that the simulator was not asked
            about.
    """
    table = Table(as_written_now(found))
    if table.own:
        table.check_was_read()
    return table


def _shares(log_masses: FloatArray) -> FloatArray:
    """Return (..., row) log masses as probabilities."""
    shares = np.exp(log_masses - log_masses.max(axis=-1, keepdims=True))
    return np.asarray(shares / shares.sum(axis=-1, keepdims=True))
