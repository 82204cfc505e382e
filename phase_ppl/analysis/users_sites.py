"""Sites of a prior of one's own in the closed loop: tables of hypotheses with their values.

The closed loop says how probable a video is under every hypothesis. Other sites of the prior do not
change this: p(site | video) is proportional to sum_h p(site, h) p(video | h). Sites with few
values are summed over. Others are drawn: hypotheses from their posterior, beside each the sites
from the prior given what comes before them, weighted by what comes after (importance sampling).
These answers have a Monte-Carlo error beside that of the searches.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.closed_loop_table import Table
from phase_ppl.analysis.estimate import Jackknife, Jackknives, kish_size, leaving_out, over_sets
from phase_ppl.analysis.hypotheses import Hypotheses
from phase_ppl.analysis.quantities import Quantity, Vocabulary
from phase_ppl.analysis.weights import Rows, log_sum_exp
from phase_ppl.world.arrays import FloatArray, IntArray, equal_rows

if TYPE_CHECKING:
    from phase_ppl.models.effective import Values

Sites = dict[str, tuple[Quantity, NDArray[Any]]]  # further ones, and their columns

_GROUPS: Final = 20
_DRAWS: Final = 1000  # of every group, whose differences are the Monte-Carlo error
_SEED: Final = 0
_LEAST: Final = 1e-10  # rows with less of the mass are left out of sums


class WithSites(Hypotheses):
    """A table of hypotheses and values of the prior's further sites: all (``summed``), or draws."""

    def __init__(
        self,
        words: Vocabulary,
        quantities: Mapping[str, Quantity],
        rows: Rows,
        summed: bool,
        errors: Jackknife | Jackknives | None,
    ) -> None:
        super().__init__(words.space, quantities, rows)
        self.summed = summed
        self._words = words
        self._errors = errors

    def _jackknife(self, share: float) -> Any:
        return self._errors

    @functools.cached_property
    def _effective_size(self) -> float:
        """The number of equal draws that those here are worth; NaN where there are all values."""
        return math.nan if self.summed else kish_size(self._rows.weights)

    def _has_error(self, *columns: NDArray[Any]) -> bool:
        """Return whether no column depends on strengths, as in the closed loop.

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
        derived = {*self._words.quantities, *self._defined}
        sites = [name for name in self._quantities if name not in derived]
        known = [name for name in self._words.space.kept_columns if name in self._rows.values]
        if len(known) < len(self._words.space.kept_columns):  # stated goals are PHASE's
            known = list(self._words.quantities)
        names = [*known, *(sites if self.summed else ())]
        strengths = self.strengths_of.values()

        def first_of(names: Sequence[str]) -> IntArray:
            kind, first = equal_rows([self._rows.values[name] for name in names])
            return first[kind]

        return first_of(names), first_of([name for name in names if name not in strengths])

    def __repr__(self) -> str:
        how = "all values" if self.summed else f"{len(self.table.weights)} draws"
        return f"<{type(self).__name__}: {', '.join(self.quantities)}; {how}>"


def with_sites(
    prior: Callable[..., object], table: Table, frame: int, words: Vocabulary
) -> WithSites:
    """Return the table of hypotheses with the further sites of the prior, given frames so far."""
    from phase_ppl.models import effective

    log_mass, *without = table.all_log_masses(frame)
    values = effective.enumerable(prior)
    if values is None:
        places, weights, sites = _drawn(prior, table, log_mass)
    else:
        places, weights, sites = _summed(prior, values, table, frame)
    weights = weights / weights.sum()
    columns = table.columns(*np.divmod(places, len(table.combinations)))
    columns |= {name: column for name, (_, column) in sites.items()}
    quantities = {**words.quantities, **{name: quantity for name, (quantity, _) in sites.items()}}
    by_searches = _reweighted(weights, log_mass, without, places)
    errors: Jackknife | Jackknives | None = by_searches
    if values is None:
        by_chance = leaving_out(weights, np.repeat(np.arange(_GROUPS), _DRAWS))
        errors = by_chance and by_searches and Jackknives((by_chance, by_searches))
    index = {"draw" if values is None else "row": np.arange(len(weights))}
    rows = Rows(words.completed(columns), weights, index)
    return WithSites(words, quantities, rows, values is not None, errors)


def _summed(
    prior: Callable[..., object], values: Values, table: Table, frame: int
) -> tuple[IntArray, FloatArray, Sites]:
    """Return hypotheses with all values of sites: (row,) which they are, masses, and the sites."""
    from phase_ppl.models.effective import log_masses

    likelihood = table.log_likelihood(frame).reshape(-1, 1)
    log_prior = log_masses(prior, table.levels, values).reshape(len(likelihood), -1)
    shares = np.exp(_log_shares(log_prior + likelihood))
    places, value = np.nonzero(shares > _LEAST)
    codes = np.unravel_index(value, [len(options) for _, options in values])
    sites = {
        name: (_discrete(name, options), chosen)
        for (name, options), chosen in zip(values, codes, strict=True)
    }
    return places, shares[places, value], sites


def _drawn(
    prior: Callable[..., object], table: Table, log_mass: FloatArray
) -> tuple[IntArray, FloatArray, Sites]:
    """Return draws of hypotheses and sites: (row,) which they are, weights, and the sites."""
    from phase_ppl.models.effective import drawn_beside, further_sites

    cumulative = np.exp(_log_shares(log_mass)).cumsum()
    rng = np.random.default_rng(_SEED)
    steps = (np.arange(_DRAWS) + rng.random((_GROUPS, 1))) / _DRAWS  # systematic, by group
    places = np.searchsorted(cumulative, steps.ravel() * cumulative[-1], side="right")
    places = np.minimum(places, len(cumulative) - 1)
    columns = table.columns(*np.divmod(places, len(table.combinations)))
    space, log_prior = table.space, table.prior.log_prior
    assert log_prior is not None
    given = {
        site: columns[kept] for site, kept in zip(space.sites, space.kept_columns, strict=True)
    }
    of_table = log_prior, np.unravel_index(places, log_prior.shape)
    drawn, log_weight = drawn_beside(prior, given, *of_table, np.array(table.levels), _SEED)
    sites: Sites = {}
    for name, site in further_sites(prior).items():
        if site.discrete:
            occurring, codes = np.unique(drawn[name], return_inverse=True)
            sites[name] = _discrete(name, occurring.tolist()), codes
        else:
            sites[name] = Quantity(name), drawn[name].astype(np.float64)
    return places, np.exp(_log_shares(log_weight)), sites


def _log_shares(log_mass: FloatArray) -> FloatArray:
    return log_mass - log_sum_exp(log_mass.ravel())


def _discrete(name: str, options: Sequence[float]) -> Quantity:
    return Quantity(name, tuple(map("{:g}".format, options)), tuple(options))


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
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = [np.log(weights) + mass[places] - log_mass[places] for mass in without]
    changed = [np.exp(_log_shares(np.where(np.isnan(one), -np.inf, one))) for one in logs]
    return over_sets(changed)
