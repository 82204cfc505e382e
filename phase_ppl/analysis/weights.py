"""Weightings: ways to turn a tree of draws into a table of hypotheses with weights.

Every query is a sum over such a table. Each weighting is valid under conditions:

``"count"``
    Every draw after the burn-in weighs exp(its log weight). Draws of a Markov chain weigh the same:
    once a chain has forgotten its start, it visits hypotheses in proportion to their probability.
    Kernels such as importance sampling give each draw a weight of its own. Valid for every kernel
    whose stationary law is the posterior, or approaches it with more particles.
``"stratified"``
    Every completed simulation of known proposal density counts, accepted or not. A pair of
    effective goals weighs P(pair) times the mean likelihood of its simulations. In this mean a
    simulation counts by P(h) / Q(h), with Q the density of its proposal given the history of the
    run. This is post-stratification: the prior gives a stratum's mass, not its number of draws.

    Pairs proposed fewer than twenty times form one stratum, which stands for everything tried less
    or never. A pair may be chosen for simulation in any way. So rivals, which earlier results
    called for, are strata of their own.

    The weights P / Q within a stratum, and then all weights, are truncated twice, at the square
    root of their number times their mean (Ionides 2008, JCGS 17:295). So no simulation decides
    alone; the change vanishes as their number grows. A simulation that could have been stopped
    early weighs more, by the reciprocal of the probability that it was not. This compensates for
    simulations that were stopped.

    Consistent under any acceptance rule, for kernels with proposal densities, given the history,
    that cover the prior: ``local_mh``, ``prior_mh``, the local moves of ``mixture`` (Rudolf &
    Sprungk 2020, Electronic Journal of Statistics 14:857).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis import tree as trees
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError

FEWEST_OF_PAIR: Final = 20
"""Fewest proposals of a pair of goals for a stratum of its own. In a stratum of few simulations
P / Q has hardly any effect, and strengths keep the proposal's distribution
(``benchmarks/estimates.py``)."""

MOST_GROUPS: Final = 32
"""Most groups of chains for the jackknife: more would hardly make errors more precise."""


@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """A table of hypotheses."""

    values: Mapping[str, NDArray[Any]]  # site -> (row,) codes or numbers
    weights: FloatArray  # (row,) non-negative, sum 1
    # place of a row in the tree: column -> (row,) integers
    index: Mapping[str, NDArray[np.int64]]
    # strata of known mass: (row,) stratum of each row, and (stratum, group) the share of each group
    # of chains in it
    strata: tuple[NDArray[np.int64], FloatArray] | None = None
    # (row,) group of chains of each row, 0 and up; None: there are no chains
    groups: NDArray[np.int64] | None = None
    # masks (row,) of the first and the last half of the draws, if these should agree
    halves: tuple[NDArray[np.bool_], ...] = ()


def log_sum_exp(values: FloatArray) -> float:
    """Return log(sum(exp(values))) without overflow; -inf for no values or all -inf."""
    highest = np.max(values, initial=-np.inf)
    if not np.isfinite(highest):
        return float(highest)
    return float(highest + np.log(np.exp(values - highest).sum()))


def normalised(log_weights: FloatArray) -> FloatArray:
    """Return weights of sum 1 that are proportional to exp(log_weights)."""
    total = log_sum_exp(log_weights)
    if not np.isfinite(total):
        raise InvalidSettingError(
            f"the hypotheses cannot be weighted: their log weights sum to {total}"
        )
    weights = np.exp(log_weights - total)
    return weights / weights.sum()


def chain_groups(tree: xr.DataTree) -> NDArray[np.int64]:
    """Return (chain,) the group of each chain, for leaving out groups in turn.

    Groups are single chains. With more than :data:`MOST_GROUPS` chains they are that many groups of
    neighbouring chains, whose sizes differ by at most 1.
    """
    n_chains = trees.shape_of_draws(tree)[0]
    return np.arange(n_chains) * min(n_chains, MOST_GROUPS) // n_chains


def halves(tree: xr.DataTree, name: str, rows: Rows) -> tuple[NDArray[np.bool_], ...]:
    """Return masks of the rows of the first and of the last half of the draws, to compare these.

    If a chain still moves away from its start, its halves differ by more than chance. Empty if
    draws have weights, or for a single draw.
    """
    if name != "count" or np.ptp(trees.log_weight_of_draws(tree)) > 0:
        return ()
    draw = rows.index["draw"]
    first, last = int(draw.min()), int(draw.max())
    size = (last - first + 1) // 2
    return (draw < first + size, draw > last - size) if size else ()


def count(tree: xr.DataTree) -> Rows:
    """Return all draws with the kernel's weights: equal, unless its draws are weighted."""
    values, index = _draws(tree)
    return Rows(values, normalised(trees.log_weight_of_draws(tree).reshape(-1)), index)


def stratified(tree: xr.DataTree) -> Rows:
    """Return every completed simulation, weighted by its stratum's prior and mean likelihood."""
    if not has_proposals(tree):
        raise InvalidSettingError(
            "weights 'stratified' need the density of each proposal, which kernel "
            f"{tree.attrs['kernel']!r} does not give: use weights='count'"
        )
    if not _has_prior(tree):
        raise InvalidSettingError("weights 'stratified' need the prior of pairs of goals")
    strata, simulations = _strata(tree), tree["simulations"].dataset
    with np.errstate(invalid="ignore"):  # failed simulations
        log_weight = strata.log_mass + simulations["log_likelihood"].values
        log_weight = log_weight + _log_reciprocal_proposal(tree)
    row = np.flatnonzero(trees.completed(tree) & np.isfinite(log_weight))
    if not row.size:
        raise InvalidSettingError("weights 'stratified' need at least one completed simulation")
    weights = truncated(normalised(log_weight[row]), _n_requests(simulations)[row])
    chain, groups = simulations["chain"].values.astype(np.int64), chain_groups(tree)
    by_group = np.zeros((int(strata.of.max()) + 1, int(groups.max()) + 1))
    known = strata.of >= 0
    np.add.at(by_group, (strata.of[known], groups[chain][known]), strata.share[known])
    values = {name: simulations[name].values[row] for name in _sites(tree)}
    index = {"simulation": row, "chain": chain[row]}
    return Rows(values, weights, index, (strata.of[row], by_group))


def _has_prior(tree: xr.DataTree) -> bool:
    """Whether a tree holds the prior of pairs of goals."""
    return trees.prior_of_goals(tree, trees.effective_goals(tree, "simulations")[:0]) is not None


class _Strata(NamedTuple):
    """The strata of simulations."""

    of: NDArray[np.int64]  # (simulation,) number of the stratum; -1: Q is not known
    # (simulation,) P(h) / Q(h), truncated, with sum 1 over all simulations of the stratum, stopped
    # and failed ones included
    share: FloatArray
    log_mass: FloatArray  # (simulation,) log of Q(h), the stratum's prior and the share


def _strata(tree: xr.DataTree) -> _Strata:
    """Return the strata: pairs asked for ``FEWEST_OF_PAIR`` times or as rivals, and all others."""
    simulations = tree["simulations"].dataset
    # repeated requests count each time
    log_proposal = -_with_again(simulations, -simulations["log_proposal"].values.astype(float))
    n_requests = _n_requests(simulations)
    with np.errstate(invalid="ignore"):
        log_ratio = simulations["log_prior"].values - log_proposal
    known = np.flatnonzero(np.isfinite(log_ratio))
    goals = trees.effective_goals(tree, "simulations")[known]
    pairs, pair = np.unique(goals, axis=0, return_inverse=True)
    pair = pair.reshape(-1)
    prior = trees.prior_of_goals(tree, pairs)
    assert prior is not None, "it was asked for"
    alone = np.bincount(pair, n_requests[known], len(pairs)) >= FEWEST_OF_PAIR
    # rivals were chosen by the results of others
    are_rivals = simulations["iteration"].values >= tree.attrs.get("rivals_from", np.inf)
    alone[pair[are_rivals[known]]] = True
    of = np.full(len(log_ratio), -1)
    of[known] = np.where(alone[pair], pair, len(pairs))
    mass = np.append(prior, max(0.0, trees.possible_mass(tree) - float(prior[alone].sum())))
    share = np.zeros(len(log_ratio))
    for number in np.unique(of[known]):
        rows = np.flatnonzero(of == number)
        share[rows] = truncated(normalised(log_ratio[rows]), n_requests[rows])
    with np.errstate(divide="ignore"):
        return _Strata(of, share, log_proposal + np.log(mass[of]) + np.log(share))


def has_proposals(tree: xr.DataTree) -> bool:
    """Whether the proposals of a run have densities by which it can be weighed."""
    simulations = tree["simulations"].dataset
    if "log_proposal" not in simulations:
        return False
    later, known = simulations["iteration"].values > 0, _n_requests(simulations) > 0
    return bool(known[later].any() if later.any() else known.any())


def _n_requests(simulations: xr.Dataset) -> NDArray[np.int64]:
    """Return (simulation,) how many requests of known proposal density each answered."""
    # files did not always say how many there were
    again = simulations.get("n_again", simulations["log_again"] > -np.inf).values
    return (~np.isnan(simulations["log_proposal"].values)).astype(np.int64) + again


def _with_again(simulations: xr.Dataset, log_first: FloatArray) -> FloatArray:
    """Return (simulation,) log 1 / Q summed over requests, given the first's; NaN: not known."""
    again = simulations["log_again"].values
    first = np.where(np.isnan(log_first) & (again > -np.inf), -np.inf, log_first)
    with np.errstate(invalid="ignore"):  # of what is not known
        return np.asarray(np.logaddexp(first, again), np.float64)


def _log_reciprocal_proposal(
    tree: xr.DataTree, log_likelihood: FloatArray | None = None
) -> FloatArray:
    """Return (simulation,) log 1 / (Q(h) P(it was not stopped)); NaN where Q is not known.

    ``log_likelihood`` is an upper bound, as far as needed; by default that of whole simulations.
    """
    simulations = tree["simulations"].dataset
    if log_likelihood is None:
        log_likelihood = simulations["log_likelihood"].values.astype(float)
    bound = simulations["log_bound"].values
    with np.errstate(invalid="ignore"):  # of what failed
        allowed = np.minimum(0.0, bound + log_likelihood)
    log_completion = np.where(np.isfinite(bound), allowed, 0.0)
    return _with_again(simulations, -simulations["log_proposal"].values - log_completion)


def truncated(weights: FloatArray, n_requests: NDArray[np.int64] | None = None) -> FloatArray:
    """Return n weights of sum 1, truncated at sqrt(n) times their mean, and then once more.

    A weight that stands for several of n requests together is truncated as that many weights.
    """
    each = np.ones(weights.size) if n_requests is None else np.maximum(n_requests, 1)
    # if weights differ by many nats, one truncation leaves little beside the largest
    for _ in range(2):
        weights = np.minimum(weights, each * weights.sum() / math.sqrt(each.sum()))
    return weights / weights.sum()


def so_far(tree: xr.DataTree) -> tuple[str, NDArray[np.int64], FloatArray]:
    """Return weights by frame: name of the weighting, simulations, and weights (simulation, time).

    At frame t every simulation that got so far has its ``"stratified"`` weight, with the likelihood
    of frames 0 to t only. If proposals have no density, or the file no prior of pairs, every draw
    weighs L(0 to t) / L(all).
    """
    simulations = tree["simulations"].dataset
    if "step_log_likelihood" not in simulations:
        raise InvalidEventError(
            "this posterior does not hold the likelihood of each frame of its simulations "
            "(simulations/step_log_likelihood); infer it again"
        )
    if not trees.completed(tree).any():
        raise InvalidSettingError("there is nothing to weight: no simulation was completed")
    by_frame = simulations["step_log_likelihood"].values
    known = np.logical_and.accumulate(~np.isnan(by_frame), axis=1)
    likelihood = np.cumsum(np.where(known, by_frame, 0.0), axis=1)
    if not (has_proposals(tree) and _has_prior(tree)):
        row = trees.simulation_of_draw(tree).ravel()
        log_weight, row = trees.log_weight_of_draws(tree).ravel()[row >= 0], row[row >= 0]
        log_weights = log_weight[:, None] + likelihood[row] - likelihood[row, -1:]
        return "count", row, np.stack([normalised(one) for one in log_weights.T], axis=1)
    log_mass, n_requests = _strata(tree).log_mass, _n_requests(simulations)
    # where a simulation may be stopped, frames that were not simulated count as without error
    unknown = (~known).sum(axis=1)
    total = simulations["log_likelihood"].values
    stopped = (unknown > 0) & np.isfinite(total)
    perfect = ((total - likelihood[:, -1])[stopped] / unknown[stopped]).max(initial=-np.inf)
    perfect = perfect if np.isfinite(perfect) else np.inf
    # the last frame of a stopped simulation is the first that the probability does not cover
    cut = np.isfinite(simulations["log_bound"].values) & ~simulations["completed"].values
    n_known = np.where(cut, simulations["frames_simulated"].values - 1, known.shape[1])
    weights, used = np.zeros(known.shape), np.zeros(len(known), bool)
    for t, left in enumerate(reversed(range(known.shape[1]))):
        at_best = likelihood[:, t] + (left * perfect if left else 0.0)
        log_weight = log_mass + likelihood[:, t] + _log_reciprocal_proposal(tree, at_best)
        usable = known[:, t] & (t < n_known) & ~simulations["failed"].values
        usable &= np.isfinite(log_weight)
        weights[usable, t] = truncated(normalised(log_weight[usable]), n_requests[usable])
        used |= usable
    return "stratified", np.flatnonzero(used), weights[used]


def _sites(tree: xr.DataTree) -> list[str]:
    """Return the sites that both draws and simulations give: ours, then a user's own."""
    users = [name for name in trees.users_sites(tree) if name in tree["simulations"].dataset]
    return [*trees.space_of_tree(tree).columns, *users]


def _draws(tree: xr.DataTree) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[np.int64]]]:
    posterior = tree["posterior"].dataset
    values = {name: posterior[name].values.reshape(-1) for name in _sites(tree)}
    n_chains, n_draws = trees.shape_of_draws(tree)
    chain, draw = np.divmod(np.arange(n_chains * n_draws), n_draws)
    return values, {"chain": chain, "draw": draw}


WEIGHTINGS: Final[Mapping[str, Callable[[xr.DataTree], Rows]]] = {
    "count": count,
    "stratified": stratified,
}
"""Name of a weighting -> the function that makes the table.

They raise InvalidSettingError if nothing has weight, or the density of the kernel's proposals is
unknown."""
