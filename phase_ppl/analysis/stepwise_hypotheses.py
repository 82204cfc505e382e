"""Which hypotheses about a video there are, and what their masses are made of.

A hypothesis is a way in which agents stand to each other, a goal of each, and strengths. In PHASE
all are there, with any prior. In other worlds goals, ways and strengths are independent of each
other a priori, and the own goal of an agent that helps or hinders is not part of a hypothesis.
What frames say of them is in :mod:`phase_ppl.analysis.stepwise_table`, or, where a simulator of
one's own was read, in :mod:`phase_ppl.analysis.stepwise_own`.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping
from typing import Any, ClassVar, Final, NamedTuple, Self, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.tree import kept_world
from phase_ppl.analysis.weights import Rows, log_sum_exp
from phase_ppl.physics.actions import ACTION_NAMES
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.goals import GOALS, N_GOALS
from phase_ppl.world.hypothesis import ALPHAS, effective_pairs, effective_table
from phase_ppl.world.scene import World
from phase_ppl.world.space import HypothesisSpace, space_of

STATED: Final[tuple[str, ...]] = ("stated_goal_red", "stated_goal_green", "alpha")
STRENGTHS: Final[tuple[str, ...]] = ("strength_red", "strength_green")

_GOLDEN: Final = 0.6180339887498949  # its multiples lie evenly between 0 and 1, modulo 1


def check_size(found: xr.Dataset, name: str, size: int) -> None:
    """Raise InvalidEventError unless a dimension has this size."""
    if found.sizes[name] != size:
        raise InvalidEventError(f"{name} has {found.sizes[name]} entries, expected {size}")


Dimensions: TypeAlias = Mapping[str, tuple[str, ...]]
"""Variable of a file -> its dimensions."""


class GoalRows(NamedTuple):
    """Hypotheses about who wants what."""

    way: IntArray  # (row,) index into the ways of the world's ``HypothesisSpace``
    goals: IntArray  # (row, agent) effective goals
    stated: IntArray  # (row, agent) stated goals; of who has none, the effective one
    log_prior: FloatArray  # (row,) log prior mass
    log_drawn: FloatArray  # (row,) log of how often it is expected among those drawn; else 0


class Table:
    """Hypotheses about a video, and their log masses at any frame; :func:`table_of` makes it.

    Attributes:
        schema: of files.
        dimensions: variable of files -> its dimensions. ``strengths`` are their probabilities,
            whatever the goals, given the frames so far and equal ones before; ``actions`` those of
            what each agent did to come to a frame; ``unexplained`` by how many nats the best joint
            action leaves the frame less probable than one that is exactly where an action puts it,
            whose log density is ``log_peak``. What frames say of goals is in
            :mod:`phase_ppl.closed_loop.goal_filter`.
        attrs: of files.
        space: the hypotheses of the world.
        combinations: (combination, agent) strengths, newtons.
        sampled: whether hypotheses were drawn.
        own: whether a simulator of one's own was read, strengths along with goals.
        is_exact: whether there is no chance in it, so that errors are 0.
    """

    schema: ClassVar[str]
    dimensions: ClassVar[Dimensions] = {
        "unexplained": ("time",),
        "trajectory": ("time", "entity", "coord"),
    }
    attrs: ClassVar[tuple[str, ...]] = ("event_id", "settings", "cost", "weight", "schema")
    most_rows: ClassVar[float]
    """Rows of one table at most, each a hypothesis with a combination of strengths."""

    least_of_best: ClassVar[float]
    least_of_all: ClassVar[float]
    """Hypotheses with less than a share of the mass of the best, and rows with less than a share of
    that of all, are left out of tables."""

    combinations: FloatArray
    sampled: bool = False
    own: ClassVar[bool] = False
    is_exact: bool = False

    def __init__(self, found: xr.Dataset) -> None:
        self.space = space_of(kept_world(found))
        self._found = found
        self._weight = float(found.attrs["weight"])
        self.n_frames = int(found.sizes["time"])
        self._sums = -1, np.empty(0)  # the last frame that is summed up, and the sums

    def extended(self, found: xr.Dataset) -> Self:
        """Return the table of the same video with further frames, which goes on from this one.

        So that a stream costs as much at a late frame as at an early one, where all hypotheses are
        summed.
        """
        after = type(self)(found)
        if not self.sampled:  # others are drawn by what all frames say
            names = ("hypotheses", "prior_of_strengths", "_sums")
            vars(after).update({name: vars(self)[name] for name in names if name in vars(self)})
        return after

    @classmethod
    def check(cls, found: xr.Dataset) -> None:
        """Raise InvalidEventError, naming what is missing or wrong, if ``found`` is none."""
        missing = [name for name in cls.attrs if name not in found.attrs]
        missing += [name for name in cls.dimensions if name not in found.variables]
        if missing:
            raise InvalidEventError(f"it lacks {', '.join(missing)}")
        for name, dims in cls.dimensions.items():
            if found[name].dims != dims:
                raise InvalidEventError(
                    f"{name} has dimensions {found[name].dims}, expected {dims}"
                )
        for name, labels in cls.labels(kept_world(found)).items():
            check_size(found, name, len(labels))

    @classmethod
    def labels(cls, world: World) -> dict[str, list[str]]:
        """Return dimension -> its labels, of those that have some."""
        return {"agent": list(world.agents), "action": list(ACTION_NAMES)}

    @functools.cached_property
    def hypotheses(self) -> GoalRows:
        """The hypotheses that are summed over, without strengths."""
        raise NotImplementedError

    @functools.cached_property
    def prior_of_strengths(self) -> FloatArray:
        """(row, combination) prior probabilities of strengths given a hypothesis; one row: any."""
        raise NotImplementedError

    def _of_frame(self, t: int, n_tables: int) -> FloatArray:
        """Return (table, ...) log likelihoods of one frame, of so many tables."""
        raise NotImplementedError

    def _summed(self, frame: int) -> FloatArray:
        """Return (table, ...) log likelihoods of the frames up to ``frame``."""
        at, sums = self._sums
        if not 0 <= at <= frame:
            at, sums = 0, np.array(self._of_frame(0, self.n_tables), np.float64)
        for t in range(at + 1, frame + 1):
            sums = sums + self._of_frame(t, self.n_tables)  # others may have the old ones
        self._sums = frame, sums
        return sums

    def _so_far(self, frame: int) -> FloatArray:
        """Return (table, row) log likelihoods of the frames up to ``frame``."""
        return self._summed(frame)

    def _frame(self, frame: int) -> FloatArray:
        """Return (row,) log likelihoods of one frame, with all sets of searches."""
        return np.asarray(self._of_frame(frame, 1)[0])

    @property
    def levels(self) -> tuple[float, ...]:
        """Strengths, newtons, ascending."""
        return tuple(np.unique(self.combinations).tolist())

    @property
    def n_sets(self) -> int:
        """Sets of searches."""
        return max(1, int(self._found.sizes["planner_seed"]))

    @property
    def n_tables(self) -> int:
        """Masses there are of each hypothesis: with all sets of searches, and without each."""
        return 1 + (self.n_sets if self.n_sets > 1 else 0)

    # --- masses of goals ------------------------------------------------------------------------

    def log_masses(self, frame: int, weight: float | None = None) -> FloatArray:
        """Return (table, row) log masses given the frames up to ``frame``.

        The first table is with all sets of searches, the others are without each; where there is
        one set, there is the first only. A frame counts ``weight``, by default the likelihood's.
        """
        weight = self._weight if weight is None else weight
        rows = self.hypotheses
        of_strengths = np.log(self.prior_of_strengths @ self._of_strengths(frame))
        return np.asarray(
            rows.log_prior - rows.log_drawn + of_strengths + weight * self._so_far(frame)
        )

    def log_masses_within(self, first: int, last: int) -> FloatArray:
        """Return (row,) log masses given the frames after ``first`` up to ``last`` alone.

        With all sets of searches; of strengths these frames say nothing here.
        """
        rows = self.hypotheses
        with np.errstate(invalid="ignore"):  # what has become impossible before stays so
            seen = -self._so_far(first)[0] + self._so_far(last)[0]
        seen = np.where(np.isnan(seen), -np.inf, seen)
        return np.asarray(rows.log_prior - rows.log_drawn + self._weight * seen)

    def weights(self, frame: int) -> FloatArray:
        """Return (table, row) :meth:`log_masses` as probabilities."""
        masses = self.log_masses(frame)
        return np.exp(masses - np.array([log_sum_exp(one) for one in masses])[:, None])

    def log_evidence(self, frame: int) -> float:
        """Return log p of the frames up to ``frame``, in nats, each counted in full."""
        return log_sum_exp(self.log_masses(frame, 1.0)[0])

    @functools.cached_property
    def log_predictive(self) -> FloatArray:
        """Return (time,) log density of each frame given those before it; 0 for the first."""
        found = np.zeros(self.n_frames)
        for t in range(1, self.n_frames):
            before = self.log_masses(t - 1)[0]
            found[t] = log_sum_exp(before - log_sum_exp(before) + self._frame(t))
        return found

    # --- strengths ------------------------------------------------------------------------------

    def _of_strengths(self, frame: int) -> FloatArray:
        """Return (combination,) what the frames so far say of strengths.

        That is their probabilities now over those before any frame, which were equal.
        """
        found = self._found["strengths"].values[frame].ravel()
        return np.maximum(found, 1e-300) * found.size

    def strengths(self, frame: int) -> FloatArray:
        """Return (row, combination) probabilities of strengths given a hypothesis; one row: any."""
        found = self.prior_of_strengths * self._of_strengths(frame)
        return np.asarray(found / found.sum(axis=1, keepdims=True))

    @property
    def _with_strengths(self) -> bool:
        """Whether all hypotheses with all strengths are few enough to be in one table."""
        return len(self.hypotheses.way) * len(self.combinations) <= self.most_rows

    def all_log_masses(self, frame: int) -> FloatArray:
        """Return (table, row of :meth:`all_columns`) log masses."""
        masses = self.log_masses(frame)
        if not self._with_strengths:
            return masses
        with np.errstate(divide="ignore"):
            strengths = np.log(self.strengths(frame))
        return np.asarray((masses[:, :, None] + strengths).reshape(len(masses), -1))

    def all_columns(self) -> dict[str, NDArray[Any]]:
        """Return the codes of all hypotheses, with all strengths unless these are too many."""
        if not self._with_strengths:
            return self.columns()
        n = len(self.combinations)
        return self.columns(*np.divmod(np.arange(len(self.hypotheses.way) * n), n))

    # --- tables ---------------------------------------------------------------------------------

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
        weights = self.weights(frame)
        kept = np.flatnonzero(weights[0] > self.least_of_best * weights[0].max())
        weights, strengths = weights[:, kept], self.strengths(frame)
        n = strengths.shape[1]
        if len(kept) * n <= self.most_rows:
            of_kept = strengths[kept] if len(strengths) > 1 else strengths
            weights = (weights[:, :, None] * of_kept).reshape(len(weights), -1)
            kept, combination = np.repeat(kept, n), np.tile(np.arange(n), len(kept))
            some = np.flatnonzero(weights[0] > self.least_of_all)
            kept, combination, weights = kept[some], combination[some], weights[:, some]
        else:  # two combinations each, in their proportions: a low-discrepancy draw
            at = (np.arange(len(kept)) * _GOLDEN)[:, None] + [0.0, 0.5]
            combination = np.searchsorted(np.cumsum(strengths[0]), (at % 1.0).ravel())
            combination = np.minimum(combination, n - 1)
            kept, weights = np.repeat(kept, 2), np.repeat(weights, 2, axis=1)
        weights /= weights.sum(axis=1, keepdims=True)
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


class PhaseTable(Table):
    """All hypotheses about a video of PHASE, with any prior."""

    dimensions: ClassVar[Dimensions] = {"log_prior": (*STATED, *STRENGTHS), **Table.dimensions}
    most_rows: ClassVar[float] = math.inf
    least_of_best: ClassVar[float] = 1e-12
    least_of_all: ClassVar[float] = 1e-12

    def __init__(self, found: xr.Dataset) -> None:
        super().__init__(found)
        levels = (found[name].values for name in STRENGTHS)
        self.combinations = np.array(list(itertools.product(*levels)))
        self.log_prior = found["log_prior"].values

    @classmethod
    def labels(cls, world: World) -> dict[str, list[str]]:
        goals = {name: list(GOALS) for name in STATED[:2]}
        return {**super().labels(world), **goals, "alpha": [str(alpha) for alpha in ALPHAS]}

    @functools.cached_property
    def hypotheses(self) -> GoalRows:
        red, green, alpha = np.indices(self.log_prior.shape[:3]).reshape(3, -1)
        with np.errstate(divide="ignore"):
            log_prior = np.log(np.exp(self.log_prior).sum(axis=(3, 4))).ravel()
        goals = effective_table().reshape(-1, 2).astype(np.int64)
        stated = np.stack([red, green], axis=1)
        return GoalRows(alpha, goals, stated, log_prior, np.zeros(len(alpha)))

    @functools.cached_property
    def prior_of_strengths(self) -> FloatArray:
        masses = np.exp(self.log_prior).reshape(len(self.hypotheses.way), -1)
        total = masses.sum(axis=1, keepdims=True)
        return np.where(total > 0, masses / np.where(total > 0, total, 1), 1 / masses.shape[1])

    def log_likelihood(self, frame: int) -> FloatArray:
        """Return (row of all, combination) log likelihoods of the frames up to ``frame``."""
        raise NotImplementedError

    def by_pairs(self) -> FloatArray:
        """Return (time, pair of effective goals) log densities of frames given those before."""
        raise NotImplementedError


class Ways(NamedTuple):
    """A prior over who wants what outside of PHASE, and what it makes possible."""

    space: HypothesisSpace
    log_goals: FloatArray  # (agent, goal) log prior masses of own goals
    log_company: FloatArray  # (way,)
    # (way, its owners, the goals that each can have by the prior)
    possible: list[tuple[int, list[int], list[IntArray]]]

    @classmethod
    def of(cls, space: HypothesisSpace, log_goals: FloatArray, log_company: FloatArray) -> Ways:
        """Return those that the masses allow for."""
        possible = []
        for way, towards in enumerate(space.ways):
            owners = [agent for agent, one in enumerate(towards) if one is None]
            if np.isfinite(log_company[way]):
                own = [np.flatnonzero(np.isfinite(log_goals[owner])) for owner in owners]
                possible.append((way, owners, own))
        return cls(space, log_goals, log_company, possible)

    @property
    def n_hypotheses(self) -> int:
        """How many hypotheses there are, without strengths."""
        return sum(math.prod(map(len, choices)) for _, _, choices in self.possible)

    def enumerated(self) -> GoalRows:
        """Return all hypotheses."""
        picked = [
            np.stack(np.meshgrid(*choices, indexing="ij"), -1).reshape(-1, len(choices))
            for _, _, choices in self.possible
        ]
        return self.put_together(picked, [np.zeros(len(one)) for one in picked])

    def put_together(self, picked: list[IntArray], log_drawn: list[FloatArray]) -> GoalRows:
        """Return the hypotheses in which the owners of each way have some goals."""
        space, goals, log_prior, ways = self.space, [], [], []
        for (way, owners, _), own in zip(self.possible, picked, strict=True):
            every = np.empty((len(own), space.n_agents), np.int64)
            every[:, owners] = own
            for agent, owner in enumerate(space.owner[way]):
                every[:, agent] = space.becomes[way, agent][every[:, owner]]
            goals.append(every)
            log_prior.append(self.log_company[way] + self.log_goals[owners, own].sum(axis=1))
            ways.append(np.full(len(own), way))
        possible_share = space.possible_share(self.log_goals, self.log_company)
        all_goals = np.concatenate(goals)
        possible = (all_goals >= 0).all(axis=1)
        all_goals = all_goals[possible]
        return GoalRows(
            np.concatenate(ways)[possible],
            all_goals,
            all_goals,
            np.concatenate(log_prior)[possible] - np.log(possible_share),
            np.concatenate(log_drawn)[possible],
        )


class WorldTable(Table):
    """Hypotheses about a video of another world."""

    dimensions: ClassVar[Dimensions] = {
        "combinations": ("combination", "agent"),
        "log_prior_goals": ("agent", "goal"),
        "log_prior_company": ("way",),
        "log_prior_strengths": ("agent", "level"),
        **Table.dimensions,
    }
    attrs = (*Table.attrs, "world")

    def __init__(self, found: xr.Dataset) -> None:
        super().__init__(found)
        self.combinations = found["combinations"].values
        masses = found["log_prior_goals"].values, found["log_prior_company"].values
        self._ways = Ways.of(self.space, *masses)
        self.n_hypotheses = self._ways.n_hypotheses

    @classmethod
    def check(cls, found: xr.Dataset) -> None:
        super().check(found)
        check_size(found, "way", len(space_of(kept_world(found)).ways))
        for name in ("log_prior_company", "trajectory"):
            values = found[name].values
            if np.isnan(values).any() or (values == np.inf).any():
                raise InvalidEventError(f"{name} has values that cannot be")

    @classmethod
    def labels(cls, world: World) -> dict[str, list[str]]:
        return {**super().labels(world), "goal": list(world.goals)}

    @functools.cached_property
    def hypotheses(self) -> GoalRows:
        return self._ways.enumerated()

    @functools.cached_property
    def prior_of_strengths(self) -> FloatArray:
        """(1, combination) masses whose margins are the prior's, so far as they can be."""
        levels, agents = self.levels, range(self.space.n_agents)
        place = np.searchsorted(levels, self.combinations)
        prior = np.exp(self._found["log_prior_strengths"].values)
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


def summed_by_pair(log_prior: FloatArray) -> FloatArray:
    """Return (goal_red, goal_green) log prior masses of pairs of effective goals."""
    found = np.full(N_GOALS**2, -np.inf)
    of_stated = np.logaddexp.reduce(log_prior.reshape(*log_prior.shape[:3], -1), axis=-1)
    np.logaddexp.at(found, effective_pairs().ravel(), of_stated.ravel())
    return found.reshape(N_GOALS, N_GOALS)
