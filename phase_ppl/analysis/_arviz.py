"""The one place that knows ArviZ, of which two generations are supported: 0.22+ and 1.x."""

from __future__ import annotations

import importlib.metadata
import json
import warnings
from typing import Any, Final

import numpy as np
import xarray as xr

from phase_ppl.analysis import convergence
from phase_ppl.analysis.diagnostics import MASS, categorical_draws, scalars
from phase_ppl.analysis.quantities import ScenarioFunction, quantities
from phase_ppl.analysis.tree import log_weight_of_draws
from phase_ppl.world.errors import InvalidSettingError

_PAIR: Final = ("chain", "draw")


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
    probabilities. With fewer than ten draws per chain ArviZ's effective sample sizes do not
    depend on the draws and say nothing; :meth:`~phase_ppl.analysis.posterior.Posterior.diagnostics`
    has some that do.

    Args:
        tree: of draws.
        scenario: as in :class:`~phase_ppl.analysis.posterior.Posterior`.

    Returns:
        An ``arviz.InferenceData`` where ArviZ is older than 1, otherwise an
        :class:`xarray.DataTree`, with the groups ``posterior``, ``sample_stats``,
        ``posterior_predictive``, ``observed_data`` and ``constant_data``.

    Raises:
        InvalidSettingError: the draws have unequal weights, which ArviZ cannot count.
    """
    if np.ptp(log_weight_of_draws(tree)) > 0:
        raise InvalidSettingError(
            "ArviZ counts every draw once, but the draws of this posterior have unequal weights; "
            "post.to_dataframe() gives them with their weights"
        )
    kept = ("sample_stats", "posterior_predictive", "observed_data", "constant_data")
    groups = {name: tree[name].to_dataset() for name in kept}
    groups = {"posterior": _posterior(tree, scenario), **groups}
    if int(importlib.metadata.version("arviz").split(".")[0]) >= 1:
        data = xr.DataTree.from_dict(groups)
        data.attrs = dict(tree.attrs)
        return data
    with warnings.catch_warnings():
        # announces ArviZ 1, with which this works too
        warnings.simplefilter("ignore", FutureWarning)
        import arviz

        make: Any = arviz.InferenceData
        return make(attrs=dict(tree.attrs), **groups)


def _posterior(tree: xr.DataTree, scenario: ScenarioFunction | None) -> xr.Dataset:
    draws = tree["posterior"].to_dataset()
    result = xr.Dataset(
        {name: (_PAIR, values) for name, values in scalars(tree).items()},
        {name: draws[name] for name in _PAIR},
    )
    left_out: dict[str, list[str]] = {}
    for name, codes in categorical_draws(tree, scenario).items():
        indicators = {
            label: (codes == code).astype(np.int64)
            for code, label in enumerate(quantities()[name].categories())
            if (codes == code).mean() > MASS
        }
        usable = {k: v for k, v in indicators.items() if _has_r_hat(v.astype(float))}
        left_out[name] = [label for label in indicators if label not in usable]
        if usable:
            dim = f"{name}_is"
            result[name] = ((*_PAIR, dim), np.stack(list(usable.values()), axis=-1))
            result = result.assign_coords({dim: list(usable)})
    result.attrs["left_out"] = json.dumps({k: v for k, v in left_out.items() if v})
    return result


def _has_r_hat(indicator: np.ndarray[Any, np.dtype[np.float64]]) -> bool:
    if indicator.shape[1] < convergence.MIN_DRAWS:  # ArviZ does not look for it either
        return True
    return bool(np.isfinite(convergence.split_r_hat(indicator)))
