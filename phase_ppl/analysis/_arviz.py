"""The draws in ArviZ's form, of which two generations are supported: 0.22+ and 1.x."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Hashable, Mapping
from typing import Any, Final

import numpy as np
import xarray as xr

from phase_ppl.analysis.diagnostics import MASS, categorical_draws, scalars
from phase_ppl.analysis.estimate import MIN_DRAWS, arviz_module, chain_halves
from phase_ppl.analysis.quantities import ScenarioFunction, Vocabulary
from phase_ppl.analysis.tree import DRAW, SIMULATED, log_weight_of_draws, space_of_tree
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError

_STREAM: Final = 0x9EA1  # keeps this noise apart from what else follows from the run's seed


def arviz_data(tree: xr.DataTree, scenario: ScenarioFunction | None = None) -> Any:
    """Return draws in the form ArviZ works on; nothing is simulated.

    ``az.summary(post.arviz)``, ``az.ess``, ``az.plot_trace``, ``az.plot_rank`` and
    ``az.plot_forest`` take it as it is. The group ``posterior`` has what these mean something
    for: ``log_joint``, ``total_error``, strengths and real sites of the user's own; and of goals,
    relation and scenario an indicator (0 or 1) of each category that more than 2 % of the draws
    have, so that its mean is a probability. Goal codes, whose mean or R-hat says nothing, are in
    ``post.tree``. An indicator that does not change within any half of a chain has no R-hat and
    is left out; the attribute ``left_out`` (JSON) names these.

    Every draw counts once, as under weights ``"count"``; other weightings give other
    probabilities.

    The group ``posterior_predictive`` has what could have been observed by the draws: the
    simulation that each rests on (``post.tree["simulated"]``), with the likelihood's noise on x
    and y of every frame, from a seed that follows from the run's. Angles are the simulation's, of
    which the likelihood says nothing, so that
    ``az.plot_ppc(post.arviz, coords={"coord": ["x", "y"]})`` compares like with like. The paper's
    beta of 0.05 is a tempered likelihood: its noise is 160 units long in a frame. Of a likelihood
    of one's own there is no such group.

    With fewer than ten draws per chain ArviZ's effective sample sizes do not
    depend on the draws and say nothing; :meth:`~phase_ppl.analysis.posterior.Posterior.diagnostics`
    has some that do.

    Returns:
        An ``arviz.InferenceData`` where ArviZ is older than 1, otherwise an
        :class:`xarray.DataTree`, with the groups ``posterior``, ``posterior_predictive``,
        ``sample_stats``, ``observed_data`` and ``constant_data``.
    """
    if np.ptp(log_weight_of_draws(tree)) > 0:
        raise InvalidSettingError(
            "ArviZ counts every draw once, but the draws of this posterior have unequal weights; "
            "post.to_dataframe() gives them with their weights"
        )
    groups = {"posterior": _posterior(tree, scenario)}
    replicated = _replicated(tree)
    if replicated is not None:
        groups["posterior_predictive"] = replicated
    for name in ("sample_stats", "observed_data", "constant_data"):
        groups[name] = tree[name].to_dataset()
    return arviz_groups(groups, tree.attrs)


def arviz_groups(
    groups: Mapping[str, xr.Dataset], attrs: Mapping[Hashable, Any] | None = None
) -> Any:
    """Return groups of draws in ArviZ's form."""
    if _is_new():
        data = xr.DataTree.from_dict(dict(groups))
        data.attrs = dict(attrs or {})
        return data
    return arviz_module().InferenceData(attrs=dict(attrs or {}), **groups)


def _is_new() -> bool:
    return int(importlib.metadata.version("arviz").split(".")[0]) >= 1


def pareto_smoothed(log_ratios: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return weights (row, draw) that sum to 1, and Pareto's k (row,), of log importance ratios."""
    if _is_new():
        from arviz_stats.base import array_stats

        logs, k = array_stats.psislw(log_ratios, axis=-1)
    else:
        logs, k = arviz_module().psislw(log_ratios)
    weights = np.exp(logs - np.logaddexp.reduce(logs, axis=-1, keepdims=True))
    return np.asarray(weights, np.float64), np.atleast_1d(np.asarray(k, np.float64))


def _replicated(tree: xr.DataTree) -> xr.Dataset | None:
    """Return what the draws could have looked like; None where the noise is not known."""
    simulated = tree[SIMULATED].to_dataset()
    if "beta" not in simulated.attrs:
        return None
    from phase_ppl.models.likelihood import RadialLikelihood

    seed = json.loads(tree.attrs["settings"]).get("seed", 0)
    rng = np.random.default_rng([int(seed), _STREAM])
    trajectory = simulated["trajectory"].values.astype(np.float64)
    likelihood = RadialLikelihood(float(simulated.attrs["beta"]), trajectory.shape[-2])
    trajectory[..., :2] = likelihood.replicate(trajectory[..., :2], rng)
    return simulated.assign(trajectory=(simulated["trajectory"].dims, trajectory))


def _posterior(tree: xr.DataTree, scenario: ScenarioFunction | None) -> xr.Dataset:
    draws = tree["posterior"].to_dataset()
    result = xr.Dataset(
        {name: (DRAW, values) for name, values in scalars(tree).items()},
        {name: draws[name] for name in DRAW},
    )
    left_out: dict[str, list[str]] = {}
    known = Vocabulary(space_of_tree(tree)).quantities
    for name, codes in categorical_draws(tree, scenario).items():
        indicators = {
            label: (codes == code).astype(np.int64)
            for code, label in enumerate(known[name].categories())
            if (codes == code).mean() > MASS
        }
        usable = {
            label: indicator
            for label, indicator in indicators.items()
            # of fewer draws ArviZ does not look for it either
            if len(indicator[0]) < MIN_DRAWS or np.ptp(chain_halves(indicator), axis=1).any()
        }
        left_out[name] = [label for label in indicators if label not in usable]
        if usable:
            dim = f"{name}_is"
            result[name] = ((*DRAW, dim), np.stack(list(usable.values()), axis=-1))
            result = result.assign_coords({dim: list(usable)})
    result.attrs["left_out"] = json.dumps({k: v for k, v in left_out.items() if v})
    return result
