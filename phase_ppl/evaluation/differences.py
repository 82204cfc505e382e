"""Paired differences between models and equivalence with people, on resampled events.

Both resample events: every measure is about other events like these, not about other people or
other runs of the models.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy.special import ndtr

from phase_ppl.evaluation import arrays
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
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event

Row = dict[str, Any]
LEAST_EVENTS: Final = 10  # events without which nothing is said of equivalence
ALPHA: Final = 1 - LEVEL  # corrected p up to which a difference, or an equivalence, counts as shown

_ROUNDING: Final = 1e-12
"""Difference of shares that is rounding: what is the margin but for it is the margin."""


def differences(
    events: Sequence[Event],
    models: Mapping[str, Mapping[str, Prediction]],
    *,
    against: str | None = None,
    seed: int = 0,
    resamples: int = 10_000,
) -> list[Row]:
    """Return how much higher one model scores than another, for every pair and measure.

    With ``against`` the others are compared with that model alone. All pairs have the same
    resamples of the events.

    Returns:
        Rows of ``one``, ``other``, ``measure`` (place in the metrics, such as "human.js"),
        ``scenario`` (None: all), ``value`` (one minus other), ``ci_low``, ``ci_high`` (95 %),
        ``p`` (two-sided, :func:`~phase_ppl.evaluation.bootstrap.difference`), ``p_holm`` and
        ``n_events`` (that both predict). Holm's correction is over all pairs that are compared on
        the measure; for the scenarios over all pairs and scenarios of the measure.
    """
    if against is None:
        pairs = list(itertools.combinations(models, 2))
    else:
        pairs = [(name, against) for name in models if name != against]
    paired = Scores(events, seed=seed, resamples=resamples)
    rows: list[Row] = []
    for one, other in pairs:
        found = paired.difference(models[one], models[other])
        for path, value in _measures(found):
            scenario, n = None, found["n_events"]
            if path[0] == "by_scenario":
                _, scenario, *path = path
                n = found["by_scenario"][scenario]["n"]
            row = {"one": one, "other": other, "measure": ".".join(path), "scenario": scenario}
            rows.append({**row, **value, "n_events": n})
    return _corrected(rows, "p")


def _measures(found: Mapping[str, Any], *above: str) -> Iterator[tuple[list[str], dict[str, Any]]]:
    """Yield path and measure of all that :class:`Scores` found."""
    for name, value in found.items():
        if isinstance(value, dict) and "value" in value:
            yield [*above, name], value
        elif isinstance(value, dict):
            yield from _measures(value, *above, name)


def equivalence(
    events: Sequence[Event],
    models: Mapping[str, Mapping[str, Prediction]],
    *,
    margin: float,
    seed: int = 0,
    resamples: int = 10_000,
) -> list[Row]:
    """Return how much more often a model is right than people, and whether that is next to nothing.

    Tested is the mean, over the events that the model and people answered, of the model's being
    right (1 or 0; for goals the mean of both agents) minus the share of people who are right. Two
    one-sided tests, that it is not below ``-margin``, and not above ``margin``, by resampling. As
    events that agree show no spread, their p is at least that of normal tests with the spread of a
    model that errs where people do not, about a share ``margin`` of the events, or the events' own
    where it is larger (with a correction for continuity, 1 / 2n).

    Returns:
        Rows of ``model``, ``measure`` ("goal_accuracy", "relation_accuracy"), ``scenario`` (None:
        all), ``value``, ``ci_low``, ``ci_high`` (95 %), ``low``, ``high`` (90 %), ``p`` (two-sided,
        of no difference), ``p_equivalent`` (of the two one-sided tests), both with ``_holm``,
        corrected as in :func:`differences`; ``n_events``, and ``verdict``: "equivalent" where the
        corrected ``p_equivalent`` is at most 0.05; "higher" or "lower" where the corrected ``p``
        is; both joined where both are; else "undecided". Fewer than :data:`LEAST_EVENTS` events
        are not tested for equivalence.
    """
    rows: list[Row] = []
    for model, predictions in models.items():
        chosen = arrays.predicted(events, predictions)
        known = arrays.facts(chosen)
        said = arrays.said(known, predictions)
        weights = resampled(len(chosen), seed, resamples)
        for kind in known.people:
            more = said.right[kind] - arrays.at_truth(known.people[kind], known.truth[kind])
            for path, chosen_rows in known.parts(kind).items():
                scenario = path[-1] if path else None
                part = np.where(chosen_rows, more, np.nan)
                found = _tested(weighted_mean(weights, part), events_with(part), margin)
                if found is not None:
                    row = {"model": model, "measure": f"{kind}_accuracy", "scenario": scenario}
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
    """Return the rows with a corrected p beside each, by measure and whether of scenarios."""
    families: dict[tuple[str, bool], list[int]] = {}
    for place, row in enumerate(rows):
        if row[name] is not None:
            families.setdefault((row["measure"], row["scenario"] is None), []).append(place)
    found: dict[int, float] = {}
    for places in families.values():
        corrected = holm([rows[place][name] for place in places])
        found |= dict(zip(places, corrected, strict=True))
    return [{**row, f"{name}_holm": found.get(place)} for place, row in enumerate(rows)]


def holm(p: Sequence[float]) -> list[float]:
    """Return p-values of a family of tests, corrected by Holm's step-down procedure.

    Rejecting where the corrected value is at most alpha errs anywhere in the family with a
    probability of at most alpha (Holm 1979).
    """
    values = np.asarray(p, np.float64)
    order = np.argsort(values, kind="stable")
    steps = values[order] * np.arange(len(values), 0, -1)
    corrected = np.minimum(np.maximum.accumulate(steps), 1)
    return [float(one) for one in corrected[np.argsort(order)]]
