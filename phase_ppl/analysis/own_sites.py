"""Sites of a prior of one's own in the closed loop: tables of hypotheses with their values.

What is read step by step says how probable a video is under every hypothesis, whatever else the
prior samples: p(site | video) is proportional to sum_h p(site, h) p(video | h). Sites with few
values are summed over. Others are drawn: hypotheses from their posterior, beside each the sites
from the prior given what comes before them, weighted by what comes after (importance sampling).
These answers have a Monte-Carlo error beside that of the searches.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phase_ppl.analysis.estimate import Jackknife, leaving_out, worth
from phase_ppl.analysis.hypotheses import Hypotheses
from phase_ppl.analysis.quantities import Quantity, Vocabulary
from phase_ppl.analysis.stepwise_table import STATED, STRENGTHS, PairTable
from phase_ppl.analysis.weights import Rows, log_sum_exp
from phase_ppl.world.arrays import FloatArray, IntArray, alike
from phase_ppl.world.space import HypothesisSpace

_GROUPS: Final = 20
_DRAWS: Final = 1000  # of every group, whose differences are the Monte-Carlo error
_SEED: Final = 0
_LEAST: Final = 1e-10  # rows with less of the mass are left out of sums


@dataclasses.dataclass(frozen=True, eq=False)
class Jackknives:
    """Jackknives over several sources of error, which add up."""

    parts: tuple[Jackknife, ...]

    @property
    def weights(self) -> FloatArray:
        """(set, row) the weights of all parts."""
        return np.concatenate([part.weights for part in self.parts])

    def error(self, results: ArrayLike, value: ArrayLike) -> FloatArray:
        """Return the standard error of a statistic, as :meth:`Jackknife.error`."""
        ends = np.cumsum([len(part.weights) for part in self.parts])[:-1]
        of_parts = np.split(np.asarray(results, np.float64), ends)
        errors = [part.error(r, value) for part, r in zip(self.parts, of_parts, strict=True)]
        return np.asarray(np.sqrt(np.sum(np.square(errors), axis=0)))

    def only(self, rows: NDArray[np.bool_]) -> Jackknives | None:
        """Return it for the ``rows`` alone; None where a set leaves nothing of them."""
        parts = [part.only(rows) for part in self.parts]
        return None if None in parts else Jackknives(tuple(p for p in parts if p is not None))


class WithSites(Hypotheses):
    """A table of hypotheses and values of the prior's further sites: all (``summed``), or draws."""

    def __init__(
        self,
        space: HypothesisSpace,
        quantities: Mapping[str, Quantity],
        rows: Rows,
        summed: bool,
        errors: Jackknife | Jackknives | None,
    ) -> None:
        super().__init__(space, quantities, rows)
        self.summed = summed
        self._space = space
        self._errors = errors

    def _jackknife(self, share: float) -> Any:
        return self._errors

    @functools.cached_property
    def _effective_size(self) -> float:
        """The number of equal draws that those here are worth; NaN where there are all values."""
        return math.nan if self.summed else worth(self._rows.weights)

    def _has_error(self, *columns: NDArray[Any]) -> bool:
        """Return whether no column depends on strengths, as of what is read step by step.

        Of draws, those columns that depend on further sites too have their Monte-Carlo error.
        """
        same, but_for_strengths = self._first_alike
        return not any(
            (column == column[same]).all() and (column != column[but_for_strengths]).any()
            for column in columns
        )

    @functools.cached_property
    def _first_alike(self) -> tuple[IntArray, IntArray]:
        """(row,) the first row that has the same, and that has all but strengths in common.

        The values of further sites count where there are all of them.
        """
        derived = {*Vocabulary(self._space).quantities, *self._own}
        sites = [name for name in self._quantities if name not in derived]
        names = (*self._space.kept_columns, *(sites if self.summed else ()))
        strengths = self.strengths_of.values()
        return self._first(names), self._first([name for name in names if name not in strengths])

    def _first(self, names: Sequence[str]) -> IntArray:
        kind, first = alike([self._rows.values[name] for name in names])
        return first[kind]

    def __repr__(self) -> str:
        how = "all values" if self.summed else f"{len(self.table.weights)} draws"
        return f"<{type(self).__name__}: {', '.join(self.quantities)}; {how}>"


def with_sites(
    prior: Callable[..., object], table: PairTable, frame: int, words: Vocabulary
) -> WithSites:
    """Return the table of hypotheses with the further sites of the prior, given frames so far."""
    from phase_ppl.models import effective

    values = effective.enumerable(prior)
    if values is not None:
        return _summed(prior, values, table, frame, words)
    sites = effective.further_sites(prior)
    log_mass, *without = table.all_log_masses(frame)
    cumulative = np.exp(log_mass - log_sum_exp(log_mass)).cumsum()
    rng = np.random.default_rng(_SEED)
    steps = (np.arange(_DRAWS) + rng.random((_GROUPS, 1))) / _DRAWS  # systematic, by group
    flat = np.searchsorted(cumulative, steps.ravel() * cumulative[-1], side="right")
    flat = np.minimum(flat, len(cumulative) - 1)
    places = np.unravel_index(flat, table.log_prior.shape)
    columns = table.columns(*np.divmod(flat, len(table.combinations)))
    of_program = {name.removeprefix("stated_"): columns[name] for name in (*STATED, *STRENGTHS)}
    drawn, log_weight = effective.drawn_beside(
        prior, of_program, table.log_prior, places, np.array(table.levels), _SEED
    )
    weights = np.exp(log_weight - log_sum_exp(log_weight))
    weights /= weights.sum()
    quantities = dict(words.quantities)
    for name, site in sites.items():
        quantities[name], columns[name] = _column(name, drawn[name], site.discrete)
    groups = np.repeat(np.arange(_GROUPS), _DRAWS)
    by_chance = leaving_out(weights, groups)
    by_searches = _reweighted(weights, log_mass, without, flat)
    parts = [part for part in (by_chance, by_searches) if part is not None]
    rows = Rows(words.completed(columns), weights, {"draw": np.arange(len(weights))})
    errors = Jackknives(tuple(parts)) if len(parts) == 2 else None
    return WithSites(words.space, quantities, rows, False, errors)


def _summed(
    prior: Callable[..., object],
    values: Sequence[tuple[str, tuple[float, ...]]],
    table: PairTable,
    frame: int,
    words: Vocabulary,
) -> WithSites:
    from phase_ppl.models.effective import log_masses

    likelihood = table.log_likelihood(frame).reshape(-1, 1)
    log_prior = log_masses(prior, np.array(table.levels), tuple(values))
    log_mass = log_prior.reshape(len(likelihood), -1) + likelihood
    shares = np.exp(log_mass - log_sum_exp(log_mass.ravel()))
    flat, value = np.nonzero(shares > _LEAST)
    weights = shares[flat, value]
    weights /= weights.sum()
    columns = table.columns(*np.divmod(flat, len(table.combinations)))
    quantities = dict(words.quantities)
    codes = np.unravel_index(value, [len(options) for _, options in values])
    for (name, options), chosen in zip(values, codes, strict=True):
        quantities[name] = Quantity(name, tuple(map("{:g}".format, options)), tuple(options))
        columns[name] = chosen
    of_hypotheses, *without = table.all_log_masses(frame)
    errors = _reweighted(weights, of_hypotheses, without, flat)
    rows = Rows(words.completed(columns), weights, {"row": np.arange(len(weights))})
    return WithSites(words.space, quantities, rows, True, errors)


def _column(name: str, drawn: NDArray[Any], discrete: bool) -> tuple[Quantity, NDArray[Any]]:
    if not discrete:
        return Quantity(name), drawn.astype(np.float64)
    occurring, codes = np.unique(drawn, return_inverse=True)
    options = tuple(occurring.tolist())
    return Quantity(name, tuple(map("{:g}".format, options)), options), codes


def _reweighted(
    weights: FloatArray,
    log_mass: FloatArray,
    without: Sequence[FloatArray],
    places: NDArray[np.int64],
) -> Jackknife | None:
    """Return the weights of rows without each set of searches; None where there is one set.

    Log masses are of all hypotheses, with all sets and without each; ``places`` say which the rows
    are of.
    """
    if not without:
        return None
    changed = []
    for mass in without:
        with np.errstate(divide="ignore", invalid="ignore"):
            log_weight = np.log(weights) + mass[places] - log_mass[places]
        log_weight[np.isnan(log_weight)] = -np.inf
        changed.append(np.exp(log_weight - log_sum_exp(log_weight)))
    return Jackknife(np.array(changed), len(without) - 1.0)
