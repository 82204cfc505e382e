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
    Resampled,
    difference,
    events_with,
    interval,
    resampled,
    weighted_mean,
    with_two,
)
from phase_ppl.evaluation.metrics import measures_of
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.table import Answers, Place, kinds_of, predicted, true_scenario
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event

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
        ``scenario`` (None: all), ``value`` (one minus other; higher is better, of ``js`` lower),
        ``ci_low``, ``ci_high`` (95 %), ``p`` (two-sided,
        :func:`~phase_ppl.evaluation.bootstrap.difference`), ``p_holm`` and ``n_events`` (that both
        predict). Holm's correction is over all pairs compared on the measure; by scenario it is
        over all pairs and scenarios of the measure.
    """
    if against is None:
        pairs = list(itertools.combinations(models, 2))
    else:
        pairs = [(name, against) for name in models if name != against]
    said = {name: Answers.of(predicted(events, of), of) for name, of in models.items()}
    made: dict[tuple[object, ...], dict[Place, Resampled]] = {}

    def measures(answers: Answers) -> dict[Place, Resampled]:
        """Return all measures; they are the same in all pairs of models that answer the same."""
        key: tuple[object, ...] = (*(e.id for e in answers.events), answers.content())
        if key not in made:
            made[key] = measures_of(answers, resampled(len(answers.events), seed, resamples))
        return made[key]

    rows: list[Row] = []
    for one, other in pairs:
        # only questions that both answer count, event by event
        first, second = said[one].about(models[other]), said[other].about(models[one])
        theirs = measures(second.where_known(first))
        for path, mine in measures(first.where_known(second)).items():
            if (value := mine.minus(theirs[path])) is None or path[-1].endswith("_people"):
                continue
            by_scenario = path[0] == "by_scenario"
            scenario = path[1] if by_scenario else None
            row = {"one": one, "other": other, "scenario": scenario, **value}
            row["measure"] = ".".join(path[2:] if by_scenario else path)
            row["n_events"] = sum(scenario in (None, true_scenario(e)) for e in first.events)
            rows.append(row)
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
    table = pd.DataFrame(rows, columns=["measure", "scenario", name]).astype({name: float})
    families = table.groupby(["measure", table["scenario"].isna()])
    corrected = families[name].transform(holm) if rows else table[name]
    return [
        {**row, f"{name}_holm": None if math.isnan(value) else value}
        for row, value in zip(rows, corrected.tolist(), strict=True)
    ]


def holm(p: pd.Series[float]) -> pd.Series[float]:
    """Return p-values of a family of tests, corrected by Holm's step-down procedure (Holm 1979).

    Rejecting corrected values up to alpha keeps the probability of any false rejection in the
    family at most alpha. NaN is no test.
    """
    steps = p.sort_values(kind="stable") * (p.count() - np.arange(len(p)))
    return steps.cummax().clip(upper=1).reindex(p.index)
