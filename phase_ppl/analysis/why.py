"""Which frames speak for one thing over another."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.quantities import (
    ScenarioFunction,
    part_codes,
    quantities,
    relation_codes,
)
from phase_ppl.analysis.query import conditions
from phase_ppl.analysis.stepwise_table import STATED, STRENGTHS, Table, effective_pairs
from phase_ppl.analysis.weights import log_sum_exp
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.goals import N_GOALS


def why(
    found: xr.Dataset,
    table: Table,
    frame: int,
    event: str,
    over: str | None,
    scenario: ScenarioFunction | None,
) -> xr.Dataset:
    """Return the log odds of ``event`` over ``over`` by frame, and what each frame changes.

    See :meth:`phase_ppl.analysis.stepwise_posterior.StepwisePosterior.why`.

    Args:
        found, table: what was read.
        frame: the last one that is counted.
        event, over, scenario: as there.
    """
    columns = _columns(found, scenario)
    wanted = _satisfied(columns, event)
    other = ~wanted if over is None else _satisfied(columns, over)
    odds = np.empty(frame + 1)
    for t in range(frame + 1):
        log_mass = table.log_mass(t).ravel()
        with np.errstate(invalid="ignore"):
            odds[t] = log_sum_exp(log_mass[wanted]) - log_sum_exp(log_mass[other])
    if not np.isfinite(odds[0]):
        impossible = (
            event if not np.isfinite(log_sum_exp(table.log_mass(0).ravel()[wanted])) else over
        )
        raise InvalidSettingError(f"{impossible} is impossible under the prior: there are no odds")
    time = found["time"].values[: frame + 1]
    return xr.Dataset(
        {"log_odds": ("time", odds), "change": ("time", np.diff(odds, prepend=odds[0]))},
        coords={"time": ("time", time, {"units": "s"})},
        attrs={"event": event, "over": over or f"not {event}"},
    )


def _satisfied(columns: Mapping[str, NDArray[np.float64]], text: str) -> NDArray[np.bool_]:
    known = quantities()
    found = np.ones(len(next(iter(columns.values()))), bool)
    for name, wanted in conditions(known, text).items():
        found &= known[name].satisfied(columns[name], wanted)
    return found


def _columns(
    found: xr.Dataset, scenario: ScenarioFunction | None
) -> dict[str, NDArray[np.float64]]:
    """Return every quantity of all hypotheses, in the order of the raveled masses."""
    shape = found["log_prior"].shape
    codes = [column.ravel() for column in np.indices(shape)]
    columns = dict(zip(STATED, codes, strict=False))
    for name, column in zip(STRENGTHS, codes[len(STATED) :], strict=True):
        columns[name] = found[name].values[column]
    pairs = effective_pairs()[tuple(codes[: len(STATED)])]
    columns["goal_red"], columns["goal_green"] = np.unravel_index(pairs, (N_GOALS, N_GOALS))
    goals = columns["goal_red"], columns["goal_green"]
    return columns | relation_codes(*goals, scenario) | part_codes(*goals)
