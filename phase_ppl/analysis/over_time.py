"""What a posterior would have been after ever more of the video: in hindsight."""

from __future__ import annotations

from typing import Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.quantities import ScenarioFunction, Vocabulary, by_label
from phase_ppl.analysis.tree import array, space_of_tree
from phase_ppl.analysis.weights import (
    evaluations,
    has_proposals,
    log_mass,
    log_reciprocal_proposal,
    log_shares,
    normalised,
    truncated,
)
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError

HINDSIGHT: Final = (
    "Hindsight, not what an observer believed at the time: the hypotheses were proposed from the "
    "whole video, and are weighted by how well they explain it up to each frame."
)
"""Goes with every result."""


def over_time(tree: xr.DataTree, scenario: ScenarioFunction | None = None) -> xr.Dataset:
    """Return the marginals of the simulated hypotheses, weighted on ever more of the video.

    This is hindsight: see :data:`HINDSIGHT`. At frame t every simulation that came so far weighs as
    under weights ``"importance"``, but with the likelihood of frames 0 to t only; at the last frame
    the result is that of these weights. For runs that are to be weighted by ``"stratified"`` it is
    those, and for runs whose proposals have no density that is known ``"visited"``: every pair of
    effective goals weighs its prior times the mean likelihood of its simulations. Nothing is
    simulated.

    Returns:
        ``goal_red``, ``goal_green``, ``relation``, ``scenario``, or the goals and relations of
        another world: probabilities (time, label), with the labels of ``goal_red`` in
        ``goal_red_is`` and so on; ``time`` in seconds. The attribute ``hindsight`` says what it is,
        ``weights`` by which weights.
    """
    simulations = tree["simulations"].dataset
    if "step_log_likelihood" not in simulations:
        raise InvalidEventError(
            "this posterior does not hold the likelihood of each frame of its simulations "
            "(simulations/step_log_likelihood); infer it again"
        )
    if not (simulations["completed"].values & ~simulations["failed"].values).any():
        raise InvalidSettingError("there is nothing to weight: no simulation was completed")
    if not has_proposals(tree):
        name, (rows, weights) = "visited", _by_visits(tree)
    elif tree.attrs.get("only_weights") == "stratified":
        name, (rows, weights) = "stratified", _by_proposals(tree, log_shares(tree))
    else:
        name, (rows, weights) = "importance", _by_proposals(tree, log_mass(tree))
    words = Vocabulary(space_of_tree(tree), scenario)
    codes = {goal: simulations[goal].values[rows] for goal in words.space.goal_sites}
    codes |= words.relation_codes(codes)
    time = array(tree, "observed_data", "time")
    known = words.quantities
    result = by_label(time, codes, lambda indicators: weights.T @ indicators, known)
    return result.assign_attrs(hindsight=HINDSIGHT, weights=name)


def _by_proposals(tree: xr.DataTree, log_base: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the rows of simulations and their weights (row, time).

    Args:
        tree: of draws.
        log_base: (simulation,) log weight beside the likelihood and the proposal's density.
    """
    simulations = tree["simulations"].dataset
    known, so_far = _likelihood_so_far(tree)
    # a frame that was not simulated counts as one without error where a simulation may be stopped
    unknown = (~known).sum(axis=1)
    total = simulations["log_likelihood"].values
    stopped = (unknown > 0) & np.isfinite(total)
    perfect = ((total - so_far[:, -1])[stopped] / unknown[stopped]).max(initial=-np.inf)
    n_frames = known.shape[1]
    log_weight = np.full(known.shape, -np.inf)
    for t in range(n_frames):
        rest = (n_frames - 1 - t) * perfect if np.isfinite(perfect) else np.inf
        at_best = so_far[:, t] + (rest if t < n_frames - 1 else 0.0)
        found = log_base + so_far[:, t]
        found = found + log_reciprocal_proposal(tree, at_best)
        usable = known[:, t] & ~simulations["failed"].values & np.isfinite(found)
        log_weight[:, t] = np.where(usable, found, -np.inf)
    rows = np.flatnonzero(np.isfinite(log_weight).any(axis=1))
    weights = np.zeros((len(rows), n_frames))
    for t, column in enumerate(log_weight[rows].T):
        usable = np.isfinite(column)
        weights[usable, t] = truncated(normalised(column[usable]))
    return rows, weights


def _by_visits(tree: xr.DataTree) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the rows of distinct simulations and their weights (row, time)."""
    table = evaluations(tree)
    rows = table["simulation"].to_numpy()
    known, so_far = (part[rows] for part in _likelihood_so_far(tree))
    log_mass = np.where(known, table["log_share"].to_numpy()[:, None] + so_far, -np.inf)
    return rows, np.stack([normalised(column) for column in log_mass.T], axis=1)


def _likelihood_so_far(tree: xr.DataTree) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return (simulation, time) whether a frame was simulated, and the log likelihood so far."""
    by_frame = tree["simulations"].dataset["step_log_likelihood"].values
    known = np.logical_and.accumulate(~np.isnan(by_frame), axis=1)
    return known, np.cumsum(np.where(known, by_frame, 0.0), axis=1)
