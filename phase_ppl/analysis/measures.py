"""How good a posterior is, in numbers: against a reference, against the truth, by its chains."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.diagnostics import ess
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.tree import array
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Truth
from phase_ppl.world.goals import goal_index
from phase_ppl.world.hypothesis import RELATIONS

COMPARED: Final = ("goal_red", "goal_green", "relation")
"""Quantities whose marginals are compared with a reference."""

CURVE_POINTS: Final = 40
"""Prefixes of a run that are looked at, at most."""

Marginals = Mapping[str, FloatArray]
"""Quantity of :data:`COMPARED` -> probabilities of its labels."""


def marginals(post: Posterior) -> dict[str, FloatArray]:
    """Return the marginals that are compared."""
    return {name: np.asarray(post.marginal(name).values, float) for name in COMPARED}


def total_variation(one: FloatArray, other: FloatArray) -> float:
    """Return half the summed absolute difference of two distributions."""
    return 0.5 * float(np.abs(one - other).sum())


def distances(found: Marginals, reference: Marginals) -> dict[str, float]:
    """Return ``tv_goals`` and ``tv_relation`` of marginals; see :func:`accuracy`."""
    apart = {name: total_variation(found[name], reference[name]) for name in COMPARED}
    return {
        "tv_goals": (apart["goal_red"] + apart["goal_green"]) / 2,
        "tv_relation": apart["relation"],
    }


def accuracy(post: Posterior, reference: Marginals, truth: Truth | None) -> dict[str, float]:
    """Return how near a posterior is to a reference and to the truth; NaN where there is none.

    Keys:

    * ``tv_goals``: total variation between the marginal of a goal and the reference's, mean of
      both agents; ``tv_relation``: of the relation.
    * ``p_pair``: probability of the true pair of effective goals; ``p_goals``: of the true goal
      of an agent, mean of both; ``p_relation``: of the true relation.
    * ``map_goals``: share of the two agents whose most probable goal is the true one;
      ``map_relation``: 1 if the most probable relation is the true one, else 0.
    """
    found = marginals(post)
    result = distances(found, reference)
    if truth is None:
        return result | {"p_pair": np.nan} | of_truth(found, truth)
    pair = post.probability(goal_red=truth.goal_red, goal_green=truth.goal_green)
    return result | {"p_pair": pair} | of_truth(found, truth)


def of_truth(found: Marginals, truth: Truth | None) -> dict[str, float]:
    """Return what marginals make of the truth, as :func:`accuracy`; NaN where there is none."""
    if truth is None:
        return dict.fromkeys(("p_goals", "p_relation", "map_goals", "map_relation"), np.nan)
    codes = {
        "goal_red": goal_index(truth.goal_red),
        "goal_green": goal_index(truth.goal_green),
        "relation": RELATIONS.index(truth.relation),
    }
    p = {name: float(found[name][code]) for name, code in codes.items()}
    best = {name: float(found[name].argmax() == code) for name, code in codes.items()}
    return {
        "p_goals": (p["goal_red"] + p["goal_green"]) / 2,
        "p_relation": p["relation"],
        "map_goals": (best["goal_red"] + best["goal_green"]) / 2,
        "map_relation": best["relation"],
    }


def efficiency(post: Posterior) -> dict[str, float]:
    """Return how the chains went and what they cost; NaN where it cannot be told.

    Keys:

    * ``acceptance``, ``moves``: share of proposals accepted, and of iterations in which the pair
      of effective goals changed.
    * ``distinct``: hypotheses among the draws.
    * ``ess_per_simulation``: effective sample size of the log joint
      (:func:`phase_ppl.analysis.diagnostics.ess`), per simulation; of weighted draws, 1 / the
      sum of their squared weights.
    * ``simulations``, their ``frames``, and ``seconds`` of wall time.
    """
    found = post.diagnostics()
    simulations = found["simulations"]["total"]
    moves = found["move_rate"]
    return {
        "acceptance": found["acceptance_rate"],
        "moves": np.nan if moves is None else moves,
        "distinct": float(found["distinct_hypotheses"]),
        "ess_per_simulation": _effective_sample_size(post, found) / simulations,
        "simulations": float(simulations),
        "frames": float(array(post.tree, "simulations", "frames_simulated").sum()),
        "seconds": float(post.cost["seconds"]),
    }


def _effective_sample_size(post: Posterior, found: Mapping[str, Any]) -> float:
    weight = post.to_dataframe()["weight"].to_numpy()
    if not np.allclose(weight, weight[0]):
        return float(found["effective_rows"])
    return ess(array(post.tree, "sample_stats", "log_joint").astype(float), "mean")


def curve(post: Posterior, reference: Marginals, truth: Truth | None) -> pd.DataFrame:
    """Return :func:`accuracy` of what a run had after ever more simulations.

    Of the first draws of all chains, with the simulations made until then; nothing is simulated.
    A run that keeps its last population only has one row.

    Returns:
        Columns ``simulations``, ``frames`` and those of :func:`accuracy`, a row per prefix, at most
        :data:`CURVE_POINTS`.
    """
    tree = post.tree
    n_draws = array(tree, "posterior", "goal_red").shape[1]
    iteration = array(tree, "simulations", "iteration")
    frames = array(tree, "simulations", "frames_simulated")
    # draws are those after the last iterations: a run can have more of these, or one fewer
    first = int(iteration.max(initial=0)) - n_draws + 1
    if n_draws == 1 or first not in (0, 1):
        lengths = np.array([n_draws])
    else:
        lengths = np.unique(np.linspace(1, n_draws, CURVE_POINTS).round().astype(int))
    rows = []
    for length in lengths.tolist():
        done, part = np.ones(len(iteration), bool), post
        if length < n_draws:
            done = iteration < first + length
            part = Posterior(_prefix(tree, length, done), post.weights)
        paid = {"simulations": float(done.sum()), "frames": float(frames[done].sum())}
        rows.append({**paid, **accuracy(part, reference, truth)})
    return pd.DataFrame(rows)


def _prefix(tree: xr.DataTree, n_draws: int, done: NDArray[np.bool_]) -> xr.DataTree:
    """Return a tree of the first draws, and of the simulations that were done by then."""
    groups = {}
    for name, group in tree.children.items():
        dataset = group.to_dataset()
        if "draw" in dataset.dims:
            dataset = dataset.isel(draw=slice(n_draws))
        if "simulation" in dataset.dims:
            dataset = dataset.isel(simulation=np.flatnonzero(done))
        groups[name] = dataset
    prefix = xr.DataTree.from_dict(groups)
    share = n_draws / tree["posterior"].sizes["draw"]
    prefix.attrs = {**tree.attrs, "burn_in": int(tree.attrs.get("burn_in", 0) * share)}
    return prefix
