"""Agreement of a model with people who judged at moments of a film.

The model's probabilities are those given the film until that moment. Events are resampled with all
of their moments. ``moments`` of metrics.json is None where nobody judged at a moment, else it has,
with names without "goal" about the relation:

===========================  =====================================================================
``goal_r``, ``relation_r``   Pearson's r of model and people over all events, moments and answers
``log_score``, ``js``        as under ``human``, means over events and moments; and
                             ``goal_log_score``, ``goal_js``
``log_score_people``         people's own log score, in-sample; ``goal_log_score_people``
``split_half_r``             the ceiling: r of halves of the people, mean over 1000 random splits;
                             each person is in one half at all moments; ``goal_split_half_r``
``ece``, ``goal_ece``        expected calibration error: mean distance of the model's probabilities
                             from the share of people, over ten bins of probability
``calibration``              "goal" and "relation" -> for each non-empty bin ``probability``,
                             ``share``, ``n``
``hindsight``                whether the model's probabilities are in hindsight: each frame is
                             weighed among hypotheses that were proposed for the whole film
``by_moment``                for each moment ``at`` [s], ``n_events``, ``n`` answers and all of the
                             above but ``hindsight``
===========================  =====================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.evaluation.bootstrap import (
    by_event,
    correlation,
    measure,
    resampled,
    weighted_mean,
)
from phase_ppl.evaluation.doubt import (
    calibration,
    ece,
    jensen_shannon,
    log_score,
    negative_entropy,
    split_half_of,
)
from phase_ppl.evaluation.table import Answers
from phase_ppl.world.arrays import FloatArray

PREFIX: Final[Mapping[str, str]] = {"goal": "goal_", "relation": ""}
"""Kind -> prefix of the names of measures of agreement with people."""


def moments(answers: Answers, seed: int = 0, resamples: int = 1000) -> dict[str, Any] | None:
    """Return ``moments`` of the metrics, see the module."""
    if not answers.moments:
        return None
    return {
        **_agreement(answers, answers.moments, seed, resamples),
        "by_moment": [
            {
                "at": at,
                "n_events": len(of.events),
                "n": round(float(rows["votes"].sum())),
                **_agreement(of, [at], seed, resamples),
            }
            for at in answers.moments
            for rows in [answers.rows[answers.rows["at"] == at]]
            for of in [answers.about(set(rows["event"]))]
        ],
    }


def _agreement(answers: Answers, at: Sequence[float], seed: int, resamples: int) -> dict[str, Any]:
    weights = resampled(len(answers.events), seed, resamples)
    found: dict[str, Any] = {}
    bins = {}
    for kind, prefix in PREFIX.items():
        p, people = (answers.array(kind, name, at=at) for name in ("probability", "people"))
        both = np.where(np.isnan(p), np.nan, people)
        scores = {
            f"{prefix}log_score": log_score(p, people),
            f"{prefix}js": jensen_shannon(p, people),
            f"{prefix}log_score_people": negative_entropy(both),
        }
        r = correlation(weights, by_event(p), by_event(people))
        found[f"{kind}_r"] = measure(r, _n_events(p * people))
        for name, values in scores.items():
            found[name] = measure(weighted_mean(weights, values), _n_events(values))
        halves = split_half_of(answers, kind, weights, seed, at)
        found[f"{prefix}split_half_r"] = measure(*halves)
        known = ~np.isnan(p * people)
        bins[kind] = calibration(p[known], people[known])
        found[f"{prefix}ece"] = ece(bins[kind])
    return {**found, "calibration": bins}


def _n_events(values: FloatArray) -> int:
    return int((~np.isnan(by_event(values))).any(axis=1).sum())
