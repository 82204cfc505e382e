"""Differences between models, and equivalence with people, on resampled events.

Both generalise to other events like these, not to other people or other runs of the models.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.special import ndtr

from phase_ppl.evaluation.bootstrap import (
    LEVEL,
    difference,
    interval,
    resampled,
    weighted_mean,
    with_two,
)
from phase_ppl.evaluation.metrics import Scores, events_with
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.table import Answers, kinds_of, predicted
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import SCENARIOS

Row = dict[str, Any]
LEAST_EVENTS: Final = 10  # fewest events for a test of equivalence
ALPHA: Final = 1 - LEVEL  # significance level of the corrected p of differences and equivalences

_ROUNDING: Final = 1e-12
"""Rounding error of shares' differences: a value this close to the margin counts as the margin."""


def differences_of(
    events: Sequence[Event],
    models: Mapping[str, Mapping[str, Prediction]],
    *,
    against: str | None = None,
    seed: int,
    resamples: int,
) -> list[Row]:
    """Return paired differences between models' scores, for every pair and measure.

    With ``against`` the others are compared with that model alone. All pairs have the same
    resamples of the events.

    Returns:
        Rows of ``one``, ``other``, ``measure`` (place in the metrics, such as "human.js"),
        ``scenario`` (None: all), ``value`` (one minus other), ``ci_low``, ``ci_high`` (95 %),
        ``p`` (two-sided, :func:`~phase_ppl.evaluation.bootstrap.difference`), ``p_holm`` and
        ``n_events`` (that both predict). Holm's correction is over all pairs compared on the
        measure; by scenario it is over all pairs and scenarios of the measure.
    """
    if against is None:
        pairs = list(itertools.combinations(models, 2))
    else:
        pairs = [(name, against) for name in models if name != against]
    paired = Scores(events, seed=seed, resamples=resamples)
    rows: list[Row] = []
    for one, other in pairs:
        answers, found = paired.differences(models[one], models[other])
        scenarios = answers.scenarios
        for path, value in found.items():
            scenario, n = None, len(scenarios)
            if path[0] == "by_scenario":
                scenario, path = path[1], path[2:]
                n = int((scenarios == SCENARIOS.index(scenario)).sum())
            if value is not None:
                row = {"one": one, "other": other, "measure": ".".join(path), "scenario": scenario}
                rows.append({**row, **value, "n_events": n})
    return _corrected(rows, "p")


def equivalence_of(
    events: Sequence[Event],
    models: Mapping[str, Mapping[str, Prediction]],
    *,
    margin: float,
    seed: int,
    resamples: int,
) -> list[Row]:
    """Return models' accuracy minus people's, with a test of equivalence.

    The difference is a mean over the events that both answered: the model's score (1 or 0; for
    goals the mean of both agents) minus the share of people who are right. Two one-sided tests by
    resampling show that it is not below ``-margin`` and not above ``margin``.

    Events that agree show no spread. So p is at least that of normal tests, corrected for
    continuity (1 / 2n). Their spread is the larger of two: the events' own, and a model's that errs
    where people do not, in about a share ``margin`` of the events.

    Returns:
        Rows of ``model``, ``measure`` ("goal_accuracy", "relation_accuracy"), ``scenario`` (None:
        all), ``value``, ``ci_low``, ``ci_high`` (95 %), ``low``, ``high`` (90 %), ``p`` (two-sided,
        of no difference), ``p_equivalent`` (of the two one-sided tests), both with ``_holm``,
        as in :func:`differences_of`; ``n_events``, and ``verdict``: "equivalent" if the corrected
        ``p_equivalent`` is at most 0.05; "higher" or "lower" if the corrected ``p`` is; both
        joined if both are; else "undecided". Fewer than :data:`LEAST_EVENTS` events are not tested
        for equivalence.
    """
    rows: list[Row] = []
    for model, predictions in models.items():
        answers = Answers.of(predicted(events, predictions), predictions)
        weights = resampled(len(answers.events), seed, resamples)
        for kind in kinds_of(answers.world):
            true, given, people = (answers.array(kind, c) for c in ("truth", "answer", "people"))
            more = (true * given).sum(axis=-1) - (people * true).sum(axis=-1)
            for path, chosen in answers.parts(kind).items():
                part = np.where(chosen, more, np.nan)
                found = _tested(weighted_mean(weights, part), events_with(part), margin)
                if found is not None:
                    part_name = path[-1] if path else None
                    row = {"model": model, "measure": f"{kind}_accuracy", "scenario": part_name}
                    rows.append({**row, **found})
    for name in ("p", "p_equivalent"):
        rows = _corrected(rows, name)
    return [{**row, "verdict": _verdict(row)} for row in rows]


def _tested(values: FloatArray, n: int, margin: float) -> Row | None:
    found: Row | None = difference(values, np.zeros_like(values), n, of_shares=True)
    if found is None:
        return None
    drawn = values[1:][np.isfinite(values[1:])]
    low = high = p = None
    if n > 1 and drawn.size:
        low, high = interval(with_two(values, n), 1 - 2 * ALPHA)
    if n >= LEAST_EVENTS and drawn.size:
        inside = margin - _ROUNDING
        beyond = max((drawn <= -inside).sum(), (drawn >= inside).sum())
        spread = max(float(drawn.var()), margin * (1 - margin) / n)
        within = (margin - abs(found["value"]) - 0.5 / n) / math.sqrt(spread)
        p = max(float((beyond + 1) / (drawn.size + 1)), float(ndtr(-within)))
    return {**found, "low": low, "high": high, "p_equivalent": p, "n_events": n}


def _verdict(row: Row) -> str:
    words = []
    if row["p_equivalent_holm"] is not None and row["p_equivalent_holm"] <= ALPHA:
        words.append("equivalent")
    if row["p_holm"] is not None and row["p_holm"] <= ALPHA:
        words.append("higher" if row["value"] > 0 else "lower")
    return ", ".join(words) or "undecided"


def _corrected(rows: Sequence[Row], name: str) -> list[Row]:
    """Return the rows with corrected p-values; families are by measure, and overall or scenario."""
    found: dict[int, float] = {}
    known = [place for place, row in enumerate(rows) if row[name] is not None]
    of_all = [rows[place]["scenario"] is None for place in known]
    table = pd.DataFrame({"place": known, "of_all": of_all})
    table["measure"] = [rows[place]["measure"] for place in known]
    for _, family in table.groupby(["measure", "of_all"]):
        corrected = holm([rows[place][name] for place in family["place"]])
        found |= dict(zip(family["place"], corrected, strict=True))
    return [{**row, f"{name}_holm": found.get(place)} for place, row in enumerate(rows)]


def holm(p: Sequence[float]) -> list[float]:
    """Return p-values of a family of tests, corrected by Holm's step-down procedure (Holm 1979).

    Rejecting corrected values up to alpha keeps the probability of any false rejection in the
    family at most alpha.
    """
    values = np.asarray(p, np.float64)
    order = np.argsort(values, kind="stable")
    steps = values[order] * np.arange(len(values), 0, -1)
    corrected = np.minimum(np.maximum.accumulate(steps), 1)
    return [float(one) for one in corrected[np.argsort(order)]]
