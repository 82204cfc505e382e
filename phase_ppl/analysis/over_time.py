"""What a posterior would have been after ever more of the video: in hindsight."""

from __future__ import annotations

from typing import Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.quantities import ScenarioFunction, quantities, relation_codes
from phase_ppl.analysis.tree import array
from phase_ppl.analysis.weights import evaluations, normalised
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError

FloatArray = NDArray[np.float64]

FOLLOWED: Final = ("goal_red", "goal_green", "relation", "scenario")
"""Quantities that are followed over time."""

HINDSIGHT: Final = (
    "Hindsight, not what an observer believed at the time: the hypotheses were proposed from the "
    "whole video, and are weighted by how well they explain it up to each frame."
)
"""Goes with every result."""


def over_time(tree: xr.DataTree, scenario: ScenarioFunction | None = None) -> xr.Dataset:
    """Return the marginals of the visited hypotheses, weighted on ever more of the video.

    This is hindsight: see :data:`HINDSIGHT`. At frame t every pair of effective goals that was
    simulated weighs its prior times the mean likelihood of its simulations, as under weights
    ``"visited"``, but of frames 0 to t only. A simulation that was stopped early counts up to
    where it was stopped, and as likelihood 0 from there on. At the last frame the result is
    therefore that of weights ``"visited"``. Nothing is simulated.

    Args:
        tree: of draws.
        scenario: as in :class:`~phase_ppl.analysis.posterior.Posterior`.

    Returns:
        ``goal_red``, ``goal_green``, ``relation``, ``scenario``: probabilities (time, label),
        with the labels of ``goal_red`` in ``goal_red_is`` and so on;
        ``aborted_mass_bound`` (time): the largest share of the mass that simulations stopped
        before can hide, as :func:`phase_ppl.analysis.weights.aborted_mass_bound`. ``time`` in
        seconds. The attribute ``hindsight`` says what it is.

    Raises:
        InvalidEventError: the tree does not hold the likelihood of each frame.
        InvalidSettingError: no simulation was completed.
    """
    simulations = tree["simulations"].dataset
    if "step_log_likelihood" not in simulations:
        raise InvalidEventError(
            "this posterior does not hold the likelihood of each frame of its simulations "
            "(simulations/step_log_likelihood), as files of earlier versions; infer it again"
        )
    table = evaluations(tree)
    if not table["completed"].any():
        raise InvalidSettingError("there is nothing to weight: no simulation was completed")
    rows = table["simulation"].to_numpy()
    by_frame = simulations["step_log_likelihood"].values[rows]
    known = np.logical_and.accumulate(~np.isnan(by_frame), axis=1)
    so_far = np.cumsum(np.where(known, by_frame, 0.0), axis=1)
    # frames that were not simulated are in the table's likelihood at their best
    rest = simulations["log_likelihood"].values[rows] - so_far[:, -1]
    unknown = (~known).cumsum(axis=1)
    best = rest[:, None] * unknown / np.maximum(unknown[:, -1:], 1)
    share = table["log_share"].to_numpy()[:, None]
    weights = _normalised(np.where(known, share + so_far, -np.inf))
    bounds = _normalised(share + so_far + best)
    codes = {name: simulations[name].values[rows] for name in FOLLOWED[:2]}
    codes |= relation_codes(codes["goal_red"], codes["goal_green"], scenario)
    time = array(tree, "observed_data", "time")
    coords = {"time": ("time", time, {"units": "s"})}
    known_quantities = quantities()
    result = xr.Dataset(coords=coords, attrs={"hindsight": HINDSIGHT})
    for name in FOLLOWED:
        labels = list(known_quantities[name].categories())
        indicators = codes[name][:, None] == np.arange(len(labels))
        result[name] = (("time", f"{name}_is"), weights.T @ indicators)
        result = result.assign_coords({f"{name}_is": labels})
    result["aborted_mass_bound"] = ("time", np.where(known, 0.0, bounds).sum(axis=0))
    return result


def _normalised(log_mass: FloatArray) -> FloatArray:
    """Return (row, time) weights whose sum is 1 at every time."""
    return np.stack([normalised(column) for column in log_mass.T], axis=1)
