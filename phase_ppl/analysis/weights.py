"""Three ways to turn a tree of draws into a table of hypotheses with weights.

Every query is a sum over such a table. Which weighting is valid when:

``"count"``
    Every draw weighs exp(its log weight). Draws of a Markov chain weigh the same: a chain visits
    a hypothesis in proportion to its probability. Kernels such as importance sampling give each
    draw a weight of its own. Valid for every kernel whose stationary law is the posterior, and
    for those that approach it as particles grow; the only weighting that is.
``"visited"``
    Every pair of effective goals that was simulated weighs its prior times the mean likelihood
    of its simulations, whether a chain stayed there or not: strengths and seeds, which were
    proposed near their estimates, are averaged out. It uses rejected proposals too and does not
    depend on the acceptance rule, which helps when chains are as short as the paper's L = 6. It
    is an approximation: pairs that were never proposed weigh nothing. The prior is that of the
    effective pair: the own goal that a helper or hinderer does not pursue is summed out.
    Simulations that were stopped early are bounded, not dropped: see :func:`aborted_mass_bound`.
``"likelihood"``
    Every draw weighs its own likelihood. This is how the authors' published probabilities
    behave, and for reproducing them only: on the draws of an exact kernel the likelihood
    counts twice, which makes every probability too extreme.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.tree import (
    HYPOTHESIS,
    SITES,
    array,
    log_weight_of_draws,
    simulation_of_draw,
)
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError

FloatArray = NDArray[np.float64]

_PAIR: Final = ("goal_red", "goal_green")

MOST_GROUPS: Final = 32
"""Groups of chains that are left out, at most: more would hardly make errors surer."""


@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """A table of hypotheses.

    Attributes:
        values: site -> (row,) codes or numbers.
        weights: (row,) non-negative, sum 1.
        index: what identifies a row in the tree: column -> (row,) integers.
    """

    values: Mapping[str, NDArray[Any]]
    weights: FloatArray
    index: Mapping[str, NDArray[np.int64]]


def log_sum_exp(values: FloatArray) -> float:
    """Return log(sum(exp(values))) without overflow; -inf for no values or all -inf."""
    highest = np.max(values, initial=-np.inf)
    if not np.isfinite(highest):
        return float(highest)
    return float(highest + np.log(np.exp(values - highest).sum()))


def normalised(log_weights: FloatArray) -> FloatArray:
    """Return weights of sum 1 that are proportional to exp(log_weights).

    Raises:
        InvalidSettingError: all weights are zero, or one is not a number.
    """
    total = log_sum_exp(log_weights)
    if not np.isfinite(total):
        raise InvalidSettingError(
            f"the hypotheses cannot be weighted: their log weights sum to {total}"
        )
    weights = np.exp(log_weights - total)
    return weights / weights.sum()


def chain_groups(tree: xr.DataTree) -> NDArray[np.int64]:
    """Return (chain,) the group that each chain belongs to when groups are left out in turn.

    Groups are single chains, or where there are more than :data:`MOST_GROUPS` as many groups of
    neighbouring chains, whose sizes differ by 1 at most.
    """
    n_chains = array(tree, "posterior", "goal_red").shape[0]
    return np.arange(n_chains) * min(n_chains, MOST_GROUPS) // n_chains


def without_groups(tree: xr.DataTree, name: str, rows: Rows, sets: NDArray[np.bool_]) -> FloatArray:
    """Return the weights that the rows would have if sets of chains had not been run.

    Args:
        tree: a tree of draws.
        name: of the weighting.
        rows: the table that it makes of ``tree``.
        sets: (set, group) which groups of :func:`chain_groups` are left out.

    Returns:
        (set, row), each set's sum 1; NaN where nothing would be left.
    """
    group_of_chain = chain_groups(tree)
    if name == "visited":
        weights = _visited_without(tree, rows, group_of_chain, sets)
    else:
        weights = np.where(sets[:, group_of_chain[rows.index["chain"]]], 0.0, rows.weights)
    total = weights.sum(axis=1, keepdims=True)
    return weights / np.where(total > 0, total, np.nan)


def count(tree: xr.DataTree) -> Rows:
    """Return all draws, weighted as the kernel says: equally, but for weighted draws.

    Raises:
        InvalidSettingError: all weights are zero.
    """
    values, index = _draws(tree)
    return Rows(values, normalised(log_weight_of_draws(tree).reshape(-1)), index)


def likelihood(tree: xr.DataTree) -> Rows:
    """Return all draws, each weighted by its own likelihood.

    Raises:
        InvalidEventError: a draw rests on no simulation of the tree.
    """
    values, index = _draws(tree)
    simulation = simulation_of_draw(tree).reshape(-1)
    if (simulation < 0).any():
        lost = int(np.argmax(simulation < 0))
        raise InvalidEventError(
            f"draw {index['draw'][lost]} of chain {index['chain'][lost]} rests on no completed "
            "simulation of the tree, so its likelihood is unknown"
        )
    log_likelihood = array(tree, "simulations", "log_likelihood").astype(float)
    return Rows(values, normalised(log_likelihood[simulation]), index)


def visited(tree: xr.DataTree) -> Rows:
    """Return every completed simulation, by P(h) L over the simulations of its pair of goals.

    The likelihood of a pair of effective goals is the mean over its simulations, in which a run
    that was stopped early counts as 0: an under-estimate by no more than
    :func:`aborted_mass_bound`.

    Raises:
        InvalidSettingError: no simulation was completed.
    """
    table = evaluations(tree)
    weighed = table[table["completed"]]
    if weighed.empty:
        raise InvalidSettingError("weights 'visited' need at least one completed simulation")
    simulation = weighed["simulation"].to_numpy()
    simulations = tree["simulations"].dataset
    values = {name: simulations[name].values[simulation] for name in _sites(tree)}
    weights = normalised(weighed["log_mass"].to_numpy())
    return Rows(values, weights, {"simulation": simulation})


def aborted_mass_bound(tree: xr.DataTree) -> float:
    """Return the largest share of the visited mass that early-stopped simulations can hide.

    Finishing them would change no probability under weights ``"visited"`` by more than this
    (total variation); 1 where nothing was completed.
    """
    table = evaluations(tree)
    completed = table["completed"].to_numpy()
    log_mass = table["log_mass"].to_numpy()
    if completed.all():
        return 0.0
    hidden = log_sum_exp(log_mass[~completed])
    everything = log_sum_exp(log_mass)
    return float(np.exp(hidden - everything)) if np.isfinite(everything) else 1.0


def _runs(tree: xr.DataTree) -> pd.DataFrame:
    """Return one row per simulation that did not fail.

    Columns: simulation (row in the tree), chain, completed, log_prior = log P(h), the prior of
    effective goals and strengths, log_joint = log P(h) + log likelihood (a bound where not
    completed), key (number of the hypothesis and seed, from 0) and pair (number of the pair of
    effective goals).
    """
    simulations = tree["simulations"].dataset
    names = [name for name in _sites(tree) if name in HYPOTHESIS or name not in SITES]
    columns = (*names, "seed", "chain", "log_prior_effective", "log_likelihood", "completed")
    table = pd.DataFrame({name: simulations[name].values for name in (*_PAIR, *columns)})
    table.insert(0, "simulation", np.arange(len(table)))
    table = table[~simulations["failed"].values]
    by = {"sort": False, "dropna": False}
    log_prior = table["log_prior_effective"].astype(float)
    return pd.DataFrame(
        {
            "simulation": table["simulation"],
            "chain": table["chain"],
            "completed": table["completed"].astype(bool),
            "log_prior": log_prior,
            "log_joint": log_prior + table["log_likelihood"].astype(float),
            "key": table.groupby([*names, "seed"], **by).ngroup(),
            "pair": table.groupby(list(_PAIR), **by).ngroup(),
        }
    )


def evaluations(tree: xr.DataTree) -> pd.DataFrame:
    """Return one row per distinct (hypothesis, seed) that did not fail.

    Columns: simulation (first row in the tree), completed, log_share = log P(h) - log(number of
    simulations of the goal pair), with P(h) the prior of effective goals and strengths, and
    log_mass = log_share + log likelihood (a bound where not completed).
    """
    # a completed run of a hypothesis and seed says more than a stopped one of the same
    table = _runs(tree).sort_values("completed", ascending=False, kind="stable")
    table = table.drop_duplicates("key").sort_values("simulation")
    log_n_of_pair = np.log(table.groupby("pair")["key"].transform("size"))
    return pd.DataFrame(
        {
            "simulation": table["simulation"],
            "completed": table["completed"],
            "log_share": table["log_prior"] - log_n_of_pair,
            "log_mass": table["log_joint"] - log_n_of_pair,
        }
    )


def _visited_without(
    tree: xr.DataTree, rows: Rows, group_of_chain: NDArray[np.int64], sets: NDArray[np.bool_]
) -> FloatArray:
    """Return (set, row) the weights of :func:`visited` without sets of groups, up to a factor."""
    runs = _runs(tree)
    group, n_groups = group_of_chain[runs["chain"].to_numpy()], sets.shape[1]
    key, n_keys = runs["key"].to_numpy(), int(runs["key"].max()) + 1

    def left(which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (set, key): whether a group outside the set has such a run."""
        cell = group[which] * n_keys + key[which]
        number = np.bincount(cell, minlength=n_groups * n_keys).reshape(n_groups, n_keys)
        return (~sets).astype(float) @ (number > 0) > 0

    pair_of_key = np.zeros(n_keys, np.int64)
    pair_of_key[key] = runs["pair"].to_numpy()
    known, completed = left(np.ones(len(runs), bool)), left(runs["completed"].to_numpy())
    n_of_pair = np.stack([np.bincount(pair_of_key, some) for some in known])

    table = runs.set_index("simulation").loc[rows.index["simulation"]]
    row_key = table["key"].to_numpy()
    n_of_row = np.maximum(n_of_pair[:, pair_of_key[row_key]], 1)
    log_mass = table["log_joint"].to_numpy() - np.log(n_of_row)
    log_mass[~completed[:, row_key]] = -np.inf
    highest = log_mass.max(axis=1, keepdims=True)
    return np.exp(log_mass - np.where(np.isfinite(highest), highest, 0))


def _sites(tree: xr.DataTree) -> list[str]:
    """Return the sites that both draws and simulations give: ours, then a user's own."""
    posterior, simulations = tree["posterior"].dataset, tree["simulations"].dataset
    own = [
        str(name)
        for name, variable in posterior.data_vars.items()
        if name not in SITES and variable.ndim == 2 and name in simulations
    ]
    return [*SITES, *own]


def _draws(tree: xr.DataTree) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[np.int64]]]:
    posterior = tree["posterior"].dataset
    values = {name: posterior[name].values.reshape(-1) for name in _sites(tree)}
    n_chains, n_draws = posterior["goal_red"].shape
    chain, draw = np.divmod(np.arange(n_chains * n_draws), n_draws)
    return values, {"chain": chain, "draw": draw}


WEIGHTINGS: Final[Mapping[str, Callable[[xr.DataTree], Rows]]] = {
    "count": count,
    "visited": visited,
    "likelihood": likelihood,
}
"""Name of a weighting -> the function that makes the table."""
