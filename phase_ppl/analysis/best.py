"""The best hypothesis of a run, and what it looked like when it was simulated."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.tree import SIMULATED, array, simulation_of_draw
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis


def log_joint(tree: xr.DataTree) -> NDArray[np.float64]:
    """Return (simulation,) log prior + log likelihood, -inf where not completed."""
    usable = array(tree, "simulations", "completed") & ~array(tree, "simulations", "failed")
    values = array(tree, "simulations", "log_prior_effective") + array(
        tree, "simulations", "log_likelihood"
    )
    return np.where(usable & ~np.isnan(values), values, -np.inf).astype(np.float64)


def best_simulation(tree: xr.DataTree) -> int:
    """Return the completed simulation with the highest log joint, the first of equals.

    Raises:
        InvalidSettingError: none was completed.
    """
    values = log_joint(tree)
    if not np.isfinite(values).any():
        raise InvalidSettingError("no simulation was completed, so there is no best hypothesis")
    return int(np.argmax(values))


def hypothesis_of(tree: xr.DataTree, simulation: int) -> Hypothesis:
    """Return the hypothesis, with its stated goals, that a simulation was made for."""
    row = tree["simulations"].dataset.isel(simulation=simulation)
    return Hypothesis(
        goal_red=int(row["stated_goal_red"]),
        goal_green=int(row["stated_goal_green"]),
        alpha=ALPHAS[int(row["alpha"])],
        strength_red=float(row["strength_red"]),
        strength_green=float(row["strength_green"]),
    )


def replay(tree: xr.DataTree) -> NDArray[np.float64]:
    """Return the stored trajectory (time, entity, coord) of the best hypothesis.

    That of the best simulation if a chain accepted it, otherwise that of the draw with the
    highest log joint, since only draws keep their trajectories.
    """
    is_best = simulation_of_draw(tree) == best_simulation(tree)
    draws = array(tree, "sample_stats", "log_joint")
    chosen = is_best if is_best.any() else draws == draws.max()
    chain, draw = np.argwhere(chosen)[0]
    trajectory = array(tree, SIMULATED, "trajectory")[chain, draw]
    return np.asarray(trajectory, np.float64)
