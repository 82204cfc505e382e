"""What a simulator of one's own said of a video, as a table of hypotheses at every frame.

Every frame has a log density under each combination of effective goals and strengths that has
prior mass: all are read, so that sums are exact in what was read. Without a density of its own a
simulator is read by samples, and tables without each part of them give errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
import xarray as xr

from phase_ppl.analysis.stepwise_hypotheses import (
    Dimensions,
    PhaseTable,
    Table,
    Ways,
    WorldTable,
)
from phase_ppl.analysis.tree import kept_world
from phase_ppl.analysis.weights import Rows
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import effective_pairs, effective_table
from phase_ppl.world.space import HypothesisSpace, space_of

MOST_READ: Final = 100_000
"""Hypotheses, goals with strengths, that a simulator of one's own is asked about at most."""

_LEAST: Final = 1e-12  # hypotheses with a smaller share of the mass of the best are left out


class Read(NamedTuple):
    """The hypotheses that are read."""

    goals: IntArray  # (goals, agent) effective goals, ascending
    combinations: FloatArray  # (combination, agent) newtons
    chosen: BoolArray  # (goals, combination) which have prior mass

    def hypotheses(self, space: HypothesisSpace) -> list[Any]:
        """Return them as simulators take them, goals by goals."""
        found = []
        for goals, combination in np.argwhere(self.chosen).tolist():
            sites = dict(zip(space.goal_sites, self.goals[goals].tolist(), strict=True))
            newtons = self.combinations[combination].tolist()
            sites |= dict(zip(space.strength_sites, newtons, strict=True))
            found.append(space.hypothesis({**sites, space.company_site: 0}))
        return found


def to_read(
    space: HypothesisSpace, prior: Mapping[str, FloatArray], levels: tuple[float, ...]
) -> Read:
    """Return which hypotheses have mass under a prior, as a file keeps it.

    Raises:
        InvalidSettingError: there are more than :data:`MOST_READ`.
    """
    n = space.n_agents
    grid = np.array(np.meshgrid(*[np.arange(len(levels))] * n, indexing="ij")).reshape(n, -1).T
    goals: IntArray
    if space.is_phase:
        possible = np.isfinite(prior["log_prior"]).reshape(-1, len(grid))
        goals = effective_table().reshape(-1, n).astype(np.int64)
    else:
        ways = Ways.of(space, prior["log_prior_goals"], prior["log_prior_company"])
        of_levels = np.isfinite(prior["log_prior_strengths"])[np.arange(n), grid].all(axis=1)
        check_number(ways.n_hypotheses, int(of_levels.sum()))
        goals = ways.enumerated().goals
        possible = np.broadcast_to(of_levels, (len(goals), len(grid)))
    different, place = np.unique(goals, axis=0, return_inverse=True)
    chosen = np.zeros((len(different), len(grid)), bool)
    np.logical_or.at(chosen, place.reshape(-1), possible)
    some = chosen.any(axis=1)
    check_number(int(some.sum()), int(chosen.any(axis=0).sum()))
    return Read(different[some], np.array(levels)[grid], chosen[some])


def check_number(n_goals: int, n_strengths: int) -> None:
    """Raise InvalidSettingError if these are too many to ask a simulator about."""
    if n_goals * n_strengths > MOST_READ:
        raise InvalidSettingError(
            f"the prior has mass on {n_goals:.3g} combinations of goals times {n_strengths} of "
            f"strengths, each of which a simulator of one's own is asked about at every frame, "
            f"{MOST_READ} at most: give a prior with fewer goals, or fewer strengths, "
            "tracking=phase_ppl.Tracking(strengths=(300, 600))"
        )


class OwnTable(Table):
    """Hypotheses about a video as a simulator of one's own was asked about them.

    ``log_likelihood`` has the log density of a frame given those before it, NaN where it was not
    asked for; ``unexplained`` by how many nats a frame is less probable than on the nearest of all
    samples, NaN without samples.

    Attributes:
        samples: for each hypothesis and frame; 0 where the simulator has a density.
    """

    own: ClassVar[bool] = True
    dimensions: ClassVar[Dimensions] = {
        "goals": ("read", "agent"),
        "log_likelihood": ("time", "read", "combination"),
        "log_likelihood_without": ("part", "time", "read", "combination"),
    }
    attrs = (*Table.attrs, "samples")
    most_rows: ClassVar[float] = np.inf
    least_of_best: ClassVar[float] = _LEAST
    least_of_all: ClassVar[float] = _LEAST

    def __init__(self, found: xr.Dataset) -> None:
        super().__init__(found)
        self.samples = int(found.attrs["samples"])
        self.is_exact = self.samples == 0
        rows, shape = self.hypotheses, (self.space.n_goals,) * self.space.n_agents
        asked = np.ravel_multi_index(found["goals"].values.T, shape)
        # of goals without mass any place will do
        place = np.searchsorted(asked, np.ravel_multi_index(rows.goals.T, shape))
        self._place = np.minimum(place, len(asked) - 1)
        with np.errstate(divide="ignore"):
            self._log_prior = rows.log_prior[:, None] + np.log(self.prior_of_strengths)
        known = (found["goals"].values[self._place] == rows.goals).all(axis=1)
        known = known[:, None] & ~np.isnan(found["log_likelihood"].values[0][self._place])
        if missing := int((np.isfinite(self._log_prior) & ~known).sum()):
            raise InvalidSettingError(
                f"the prior has mass on {missing} hypotheses that the simulator was not asked "
                "about, as the first prior had none there: infer the event again with this one"
            )

    @classmethod
    def check(cls, found: xr.Dataset) -> None:
        super().check(found)
        if (found["log_likelihood"].values == np.inf).any():
            raise InvalidEventError("log_likelihood has values that are no log densities")
        goals, n = found["goals"].values, space_of(kept_world(found)).n_goals
        if (goals < 0).any() or (goals >= n).any():
            raise InvalidEventError("goals has a code that is no goal")

    @property
    def n_sets(self) -> int:
        """Parts of the samples, or 1."""
        return max(1, int(self._found.sizes["part"]))

    def _of_frame(self, t: int, n_tables: int) -> FloatArray:
        """Return (table, goals, combination) log likelihoods of one frame."""
        without = self._found["log_likelihood_without"].values[: n_tables - 1, t]
        return np.array([self._found["log_likelihood"].values[t], *without], np.float64)

    def _masses(self, frame: int, weight: float | None = None) -> FloatArray:
        """Return (table, row, combination) log masses given the frames up to ``frame``."""
        weight = self._weight if weight is None else weight
        found = np.full((self.n_tables, *self._log_prior.shape), -np.inf)
        some = np.flatnonzero(np.isfinite(self._log_prior).any(axis=1))
        prior, so_far = self._log_prior[some], weight * self._summed(frame)[:, self._place[some]]
        found[:, some] = np.where(prior > -np.inf, prior + so_far, -np.inf)  # NaN was not asked
        return found

    def log_masses(self, frame: int, weight: float | None = None) -> FloatArray:
        return np.asarray(np.logaddexp.reduce(self._masses(frame, weight), axis=2))

    def strengths(self, frame: int) -> FloatArray:
        masses = self._masses(frame)[0]
        total = np.logaddexp.reduce(masses, axis=1)[:, None]
        possible = total > -np.inf
        found = np.exp(masses - np.where(possible, total, 0.0))
        return np.where(possible, found, self.prior_of_strengths)

    def all_log_masses(self, frame: int) -> FloatArray:
        return self._masses(frame).reshape(self.n_tables, -1)

    def rows(self, frame: int) -> tuple[Rows, FloatArray]:
        masses = self.all_log_masses(frame)
        weights = np.exp(masses - np.logaddexp.reduce(masses, axis=1)[:, None])
        kept = np.flatnonzero(weights[0] > _LEAST * weights[0].max())
        weights = weights[:, kept] / weights[:, kept].sum(axis=1, keepdims=True)
        columns = self.columns(*np.divmod(kept, len(self.combinations)))
        return Rows(columns, weights[0], {"hypothesis": np.arange(len(kept))}), weights[1:]

    def log_likelihood(self, frame: int) -> FloatArray:
        """Return (row, combination) log likelihoods of the frames up to ``frame``."""
        found = self._weight * self._summed(frame)[0][self._place]
        return np.where(np.isfinite(self._log_prior), found, -np.inf)


class OwnPhaseTable(OwnTable, PhaseTable):
    """Hypotheses about a video of PHASE as a simulator of one's own was asked about them."""

    schema = "phase_ppl/stepwise-own/1"
    dimensions: ClassVar[Dimensions] = {**PhaseTable.dimensions, **OwnTable.dimensions}

    def by_pairs(self) -> FloatArray:
        """Strengths are averaged over, as they are believed to be given the frames before."""
        masses = np.full((self.n_frames, N_GOALS**2), -np.inf)
        for t, of_pairs in enumerate(masses):
            np.logaddexp.at(of_pairs, effective_pairs().ravel(), self.log_masses(t)[0])
        with np.errstate(invalid="ignore"):  # of what was impossible before
            found = np.diff(masses, axis=0, prepend=masses[:1]) / self._weight
        return np.where(np.isnan(found), -np.inf, found)


class OwnWorldTable(OwnTable, WorldTable):
    """Hypotheses about a video of another world as a simulator of one's own was asked."""

    schema = "phase_ppl/stepwise-own-roles/1"
    dimensions: ClassVar[Dimensions] = {**WorldTable.dimensions, **OwnTable.dimensions}
    attrs = (*OwnTable.attrs, "world")
