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
import pandas as pd

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
    rows_of,
    split_half,
)
from phase_ppl.evaluation.table import Answers, kinds_of, responses_of
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.hypothesis import RELATIONS

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
        p, people, votes = (
            _array(answers, kind, name, at) for name in ("probability", "people", "votes")
        )
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
        halves = _split_half(answers, kind, np.nan_to_num(votes), weights, at, seed)
        found[f"{prefix}split_half_r"] = measure(*halves)
        known = ~np.isnan(p * people)
        bins[kind] = calibration(p[known], people[known])
        found[f"{prefix}ece"] = ece(bins[kind])
    return {**found, "calibration": bins}


def _array(answers: Answers, kind: str, column: str, at: Sequence[float]) -> FloatArray:
    """Return (event, moment and question, label) a column's values; NaN: nobody judged then."""
    n_questions = len(kinds_of(answers.world)[kind])
    n_labels = len(answers.world.goals if kind == "goal" else RELATIONS)
    rows = answers.rows[(answers.rows["kind"] == kind) & answers.rows["at"].isin(at)]
    first = rows.iloc[:: max(n_questions * n_labels, 1)]
    found = np.full((len(answers.events), len(at), n_questions, n_labels), np.nan)
    events = pd.Index([event.id for event in answers.events]).get_indexer(first["event"])
    places = pd.Index(at).get_indexer(first["at"])
    found[events, places] = rows[column].to_numpy().reshape(-1, n_questions, n_labels)
    return found.reshape(len(answers.events), len(at) * n_questions, n_labels)


def _split_half(
    answers: Answers, kind: str, votes: FloatArray, weights: FloatArray, at: Sequence[float],
    seed: int,
) -> tuple[FloatArray, int]:  # fmt: skip
    """Return :func:`split_half` over moments; votes are (event, moment and question, label)."""
    if not votes.any():
        return np.full(len(weights), np.nan), 0
    questions = kinds_of(answers.world)[kind]
    said = []
    for moment in at:
        given = responses_of(answers.events, moment)
        if given is not None:
            said.append(given.assign(question=f"{moment} " + given["question"].astype(object)))
    labels = answers.world.goals if kind == "goal" else RELATIONS
    names = [f"{moment} {question}" for moment in at for question in questions]
    rows = rows_of(pd.concat(said), [event.id for event in answers.events], names, labels)
    return split_half(votes, weights, rows, seed)


def _n_events(values: FloatArray) -> int:
    return int((~np.isnan(by_event(values))).any(axis=1).sum())
