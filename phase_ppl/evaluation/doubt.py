"""Agreement of a model with people, and whether it is unsure where they are.

The latter is about the relation in worlds of two agents, over the events that people judged and
for which the model has probabilities. A *measure* is as in :mod:`phase_ppl.evaluation.metrics`.
``doubt`` of metrics.json is None without such an event, else:

==========================  ======================================================================
``relation_r``,             r of model and people, as under ``human``, with intervals over events.
``relation_r_given_truth``  If it is known who answered what, also over people (two-way bootstrap,
                            Owen 2007, Annals of Applied Statistics 1). Resampling people adds
                            their noise a second time. Intervals are corrected for its effect on
                            the mean, and are up to twice too wide
``log_score_gap``           people's own log score minus the model's [nats]. People's is in-sample:
                            a model that knew people's probabilities would be some 1 / n behind n
                            raters
``brier``                   mean over events, and over the people of each, of the squared distance
                            of the model's probabilities from their answer, 0 to 2; a graded
                            answer is divided among the labels, each with its own distance
``ece``                     expected calibration error: mean distance of the model's probabilities
                            from the share of people, over ten bins of probability
``calibration``             for each non-empty bin: ``probability``, ``share``, ``n``
``ceiling``                 ``split_half_r`` of random halves of the raters,
                            ``split_half_r_given_truth``; both for all raters by Spearman and
                            Brown's formula (``spearman_brown``, ``..._given_truth``); and one
                            rater's answer predicted by the others' shares: ``one_out_r``,
                            ``one_out_r_given_truth``, ``one_out_log_score``
==========================  ======================================================================

``moments`` is about people who judged at moments of a film. The model's probabilities are those
given the film until that moment. Events are resampled with all of their moments. It is None where
nobody judged at a moment, else it has the measures of ``human`` but r given the truth, over all
events and moments; ``ece`` and ``calibration`` as above, by kind; and:

=====================  ===========================================================================
``split_half_r``       as under ``human``; each person is in one half at all moments
``hindsight``          whether the model's probabilities are in hindsight: each frame is weighed
                       among hypotheses that were proposed for the whole film
``by_moment``          for each moment ``at`` [s], ``n_events``, ``n`` answers and all of the above
                       but ``hindsight``
=====================  ===========================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from phase_ppl.evaluation.bootstrap import (
    Measure,
    Resampled,
    by_event,
    correlation,
    divided,
    events_with,
    measure,
    r_of_sums,
    resampled,
)
from phase_ppl.evaluation.prediction import pairs_of
from phase_ppl.evaluation.table import Answers, kinds_of, responses_of
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.hypothesis import RELATIONS

BINS: Final = 10
_STREAM: Final = 0xD0B7


def doubt(answers: Answers, seed: int = 0, resamples: int = 1000) -> dict[str, Any] | None:
    """Return ``doubt`` of the metrics, see the module; None unless there is one pair of agents."""
    if len(pairs_of(answers.world)) != 1:
        return None
    columns = ("probability", "people", "truth", "votes")
    p, people, true, votes = (answers.array("relation", name)[:, 0] for name in columns)
    there = ~np.isnan(p[:, 0]) & ~np.isnan(people[:, 0])
    if not there.any():
        return None
    p, people, counts = p[there], people[there], votes[there]
    truth = label_places(true)[there]
    names = [event.id for event, is_there in zip(answers.events, there, strict=True) if is_there]
    rng = np.random.default_rng([seed, _STREAM])
    given = responses_of(answers.events)
    rows = None if given is None else rows_of(given, names, [*kinds_of(answers.world)["relation"]])
    drawn = None if rows is None else people_drawn(rows, counts, rng, resamples)
    weights = resampled(len(p), seed, resamples)
    gap = negative_entropy(people) - log_score(p, people)
    brier = (p**2).sum(axis=1) - 2 * (p * people).sum(axis=1) + 1
    bins = calibration(p, people)

    def r(groups: IntArray | None) -> Measure | None:
        n = len(p) if groups is None else int((groups[:, 0] >= 0).sum())
        if drawn is None:  # each event's ratings are resampled with it
            return measure(correlation(weights, p, people, groups), n)
        value = correlation(weights[:1], p, people, groups)
        among_raters = correlation(np.ones_like(weights[1:]), p, drawn, groups)
        moved = correlation(weights[1:], p, drawn, groups) + value - _mean(among_raters)
        return measure(np.concatenate([value, np.clip(moved, -1, 1)]), n)

    return {
        "relation_r": r(None),
        "relation_r_given_truth": r(same_truth(truth)),
        "log_score_gap": Resampled.mean(weights, gap).measure(),
        "brier": Resampled.mean(weights, brier).measure(),
        "ece": ece(bins),
        "calibration": bins,
        "ceiling": ceiling(counts, truth, rng, resamples, rows),
    }


def label_places(marked: FloatArray) -> IntArray:
    """Return (...) the index of the label marked by 1 in (..., label); -1: none is."""
    return np.where(np.isnan(marked).any(axis=-1), -1, np.nan_to_num(marked).argmax(axis=-1))


def same_truth(truth: IntArray, n_answers: int = len(RELATIONS)) -> IntArray:
    """Return (..., answer) numbers of groups with the same true answer (...); -1: it is unknown.

    Deviations of probabilities, and of people's shares, from the means of these groups remain when
    being right does not help.
    """
    groups = truth[..., None] * n_answers + np.arange(n_answers)
    return np.where(truth[..., None] < 0, -1, groups)


class Rows(NamedTuple):
    """Who gave which answer to some questions of some events."""

    # (event, question) -> people, by number, and their answers (person, label), each of sum 1
    given: Mapping[tuple[int, int], tuple[IntArray, FloatArray]]
    n_people: int


def rows_of(given: pd.DataFrame, events: Sequence[str], questions: Sequence[str],
            labels: Sequence[str] = RELATIONS) -> Rows:  # fmt: skip
    """Return the responses (:func:`responses_of`) to questions that have these labels."""
    chosen = given[given["question"].isin(questions) & given["event"].isin(events)]
    who, everybody = pd.factorize(chosen["who"])
    places = pd.DataFrame({
        "event": pd.Index(events).get_indexer(chosen["event"]),
        "question": pd.Index(questions).get_indexer(chosen["question"]),
        "who": who,
        "label": pd.Index(labels).get_indexer(chosen["label"]),
        "value": chosen["value"].to_numpy(float),
    })  # fmt: skip
    found = {}
    for key, rows in places.groupby(["event", "question"]):
        people, place = np.unique(rows["who"], return_inverse=True)
        table = np.zeros((len(people), len(labels)))
        table[place, rows["label"]] = rows["value"]
        found[key] = people, table
    return Rows(found, len(everybody))


def people_drawn(rows: Rows, counts: FloatArray, rng: np.random.Generator, n: int) -> FloatArray:
    """Return (resample, event, answer) shares of the responses of resampled people.

    Each person is resampled with all responses. An event that loses all of its raters keeps its
    shares.
    """
    times = rng.multinomial(rows.n_people, np.full(rows.n_people, 1 / rows.n_people), size=n)
    found = np.zeros((n, *counts.shape))
    for (event, _), (who, table) in rows.given.items():
        found[:, event] = times[:, who] @ table
    found = np.where(found.sum(axis=-1, keepdims=True) > 0, found, counts)
    return np.asarray(found / found.sum(axis=-1, keepdims=True))


def half_of(
    ratings: FloatArray, table: FloatArray | None, rng: np.random.Generator, splits: int
) -> FloatArray:
    """Return (split, label) the ratings (label,) of a random half of the people.

    Whole ratings suffice. Graded answers need those of each person (person, label); without them
    it is NaN.
    """
    if (ratings == np.round(ratings)).all() and (table is None or np.isin(table, (0, 1)).all()):
        found = np.zeros((splits, len(ratings)))
        voted = np.flatnonzero(ratings)
        found[:, voted] = rng.multivariate_hypergeometric(
            ratings[voted].astype(np.int64), int(ratings.sum()) // 2, size=splits,
            method="marginals",
        )  # fmt: skip
        return found
    if table is None:
        return np.full((splits, len(ratings)), np.nan)
    first = np.tile(np.arange(len(table)) < len(table) // 2, (splits, 1))
    return np.asarray(rng.permuted(first, axis=1) @ table, np.float64)


def calibration(p: FloatArray, people: FloatArray) -> list[dict[str, Any]]:
    """Return the mean probability and the share of people in bins of probability."""
    pairs = pd.DataFrame({"probability": p.ravel(), "share": people.ravel()})
    groups = pairs.groupby(np.minimum((p.ravel() * BINS).astype(np.int64), BINS - 1))
    means = groups.agg(lambda values: values.to_numpy().mean())
    return means.assign(n=groups.size()).to_dict("records")


def ece(bins: Sequence[Mapping[str, Any]]) -> float | None:
    """Return the expected calibration error over the bins of :func:`calibration`; None: no bin."""
    off = sum(one["n"] * abs(one["probability"] - one["share"]) for one in bins)
    return float(off / sum(one["n"] for one in bins)) if bins else None


def ceiling(
    counts: FloatArray,
    truth: IntArray,
    rng: np.random.Generator,
    splits: int,
    rows: Rows | None = None,
) -> dict[str, float | None]:
    """Return how well raters predict each other (``ceiling`` of the module)."""
    chosen = np.flatnonzero(np.round(counts.sum(axis=1)) > 1)
    several, of_several = counts[chosen], truth[chosen]
    if not len(several):
        return {}
    tables = [None if rows is None else rows.given[event, 0][1] for event in chosen.tolist()]
    half = np.stack(
        [half_of(*of_event, rng, splits) for of_event in zip(several, tables, strict=True)], axis=1
    )
    one, other = (part / part.sum(axis=-1, keepdims=True) for part in (half, several - half))
    # every answer, and how often it was given
    each = [
        (np.eye(several.shape[1]), ratings) if table is None else (table, np.ones(len(table)))
        for ratings, table in zip(several, tables, strict=True)
    ]
    left_out = np.repeat(np.arange(len(several)), [len(times) for _, times in each])
    answer, times = (np.concatenate(part) for part in zip(*each, strict=True))
    rest = np.maximum(several[left_out] - answer, 0)
    rest = rest / np.maximum(rest.sum(axis=1, keepdims=True), 1)
    groups = same_truth(of_several, len(RELATIONS))
    found: dict[str, float] = {}
    for suffix, of_events in (("", None), ("_given_truth", groups)):
        of_rows = None if of_events is None else of_events[left_out]
        halves = _mean(correlation(np.ones(half.shape[:2]), one, other, of_events))
        found[f"split_half_r{suffix}"] = halves
        found[f"spearman_brown{suffix}"] = 2 * halves / (1 + halves) if halves > -1 else np.nan
        found[f"one_out_r{suffix}"] = float(correlation(times[None], rest, answer, of_rows)[0])
    found["one_out_log_score"] = float(np.average(log_score(rest, answer), weights=times))
    return {name: None if np.isnan(value) else value for name, value in found.items()}


def _mean(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan


# --- agreement of probabilities with people's answers, and of people with each other --------------

# Arrays are (event, question, answer), NaN where nothing is known. People's arrays are the shares
# of their answers (paper, Appendix 5).

LAPSE: Final = 0.01
"""Lapse of the log score: the share of answers taken to be uniformly random.

Without it one vote for an answer of probability 0 would make the score minus infinity; samplers
often give probability 0.
"""

SPLITS: Final = 1000
"""Random halves of the raters over which the split-half correlation is averaged."""


def log_probabilities(probabilities: FloatArray) -> FloatArray:
    """Return log((1 - lapse) p + lapse / K), in nats, over the K answers of the last axis."""
    logs = np.log((1 - LAPSE) * probabilities + LAPSE / probabilities.shape[-1])
    return np.asarray(logs, np.float64)


def log_score(probabilities: FloatArray, people: FloatArray) -> FloatArray:
    """Return (event, question) the mean log probability given to people's answers, in nats."""
    return np.asarray((people * log_probabilities(probabilities)).sum(axis=-1), np.float64)


def negative_entropy(people: FloatArray) -> FloatArray:
    """Return (event, question) sum of p log p, in nats: no model has a higher log score."""
    return np.asarray(_x_log_x(people).sum(axis=-1), np.float64)


def jensen_shannon(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return (event, question) the Jensen-Shannon divergence in bits, from 0 to 1."""
    middle = _x_log_x((one + other) / 2)
    nats = (_x_log_x(one) + _x_log_x(other)).sum(axis=-1) / 2 - middle.sum(axis=-1)
    return np.asarray(np.clip(nats / np.log(2), 0, 1), np.float64)


def _x_log_x(p: FloatArray) -> FloatArray:
    return np.asarray(p * np.log(np.where(p == 0, 1, p)), np.float64)


def split_half(
    votes: FloatArray,
    weights: FloatArray,
    rows: Rows | None = None,
    seed: int = 0,
    splits: int = SPLITS,
) -> tuple[FloatArray, int]:
    """Return the mean over random splits of the correlation between two halves of the raters.

    There is no Spearman-Brown correction: it is the r of halves. With an odd number one half has
    one rater more. An event counts in a split if both halves rated a question.

    Args:
        votes: (event, question, label) how many people gave an answer.
        weights: (row, event) of the events.
        rows: who gave which answer. Participants are then split once for all events, as in the
            paper. Without it the ratings of each question of each event are split separately;
            counts allow no more.

    Returns:
        (row,) values, NaN if they cannot be computed, and the number of events that count.
    """
    rng = np.random.default_rng([seed, 1])
    if rows is not None:
        first = np.arange(rows.n_people) < rows.n_people // 2
        in_one = rng.permuted(np.tile(first, (splits, 1)), axis=1)
    sums = np.zeros((6, splits, len(votes)))
    for event, question in np.argwhere(votes.sum(axis=-1) > 0):
        ratings = votes[event, question]
        if rows is not None:
            who, table = rows.given[event, question]
            one = in_one[:, who] @ table
        else:
            one = half_of(ratings, None, rng, splits)
        other = ratings - one
        # of graded answers, half of nobody is 0 up to rounding
        both = (one.sum(axis=1) > 0.5) & (other.sum(axis=1) > 0.5)
        sums[:, both, event] += _sums(one[both], other[both])
    n, x, y, xx, yy, xy = (weights @ part.T for part in sums)
    r = r_of_sums(
        n,
        xx - np.nan_to_num(divided(x**2, n)),
        yy - np.nan_to_num(divided(y**2, n)),
        xy - np.nan_to_num(divided(x * y, n)),
    )
    known = ~np.isnan(r)
    mean = divided(np.where(known, r, 0).sum(axis=1), known.sum(axis=1).astype(np.float64))
    return mean, int(sums[0].any(axis=0).sum())


def split_half_of(
    answers: Answers, kind: str, weights: FloatArray, seed: int, at: Sequence[float] = ()
) -> Measure | None:
    """Return :func:`split_half` of people's answers to a kind of questions.

    They are about the whole film; or about it until the moments ``at``, with each person in one
    half at all of them.
    """
    votes, rows = np.nan_to_num(answers.array(kind, "votes", at=at)), None
    if not votes.any():
        return None
    films = at or (None,)
    said = {film: one for film in films if (one := responses_of(answers.events, film)) is not None}
    if said:
        given = pd.concat([
            one.assign(question=[f"{question} {film}" for question in one["question"]])
            for film, one in said.items()
        ])  # fmt: skip
        labels = answers.world.goals if kind == "goal" else RELATIONS
        events = [event.id for event in answers.events]
        names = [
            f"{question} {film}" for film in films for question in kinds_of(answers.world)[kind]
        ]
        rows = rows_of(given, events, names, labels)
    return measure(*split_half(votes, weights, rows, seed))


def _sums(one: IntArray, other: IntArray) -> FloatArray:
    """Return (6, split): n, sums, squares and products of the shares, about their mean 1 / K."""
    x, y = (half / half.sum(axis=1, keepdims=True) - 1 / half.shape[1] for half in (one, other))
    n = np.full(len(x), float(x.shape[1]))
    parts = [part.sum(axis=1) for part in (x, y, x**2, y**2, x * y)]
    return np.stack([n, *parts])


# --- of the whole film, and at moments of it -----------------------------------------------------

PREFIX: Final[Mapping[str, str]] = {"goal": "goal_", "relation": ""}
"""Kind -> prefix of the names of measures of agreement with people."""


def agreement(
    answers: Answers, weights: FloatArray, at: Sequence[float] = ()
) -> dict[str, Resampled]:
    """Return measures of agreement with people, about the whole film or until moments ``at``."""
    found: dict[str, Resampled] = {}
    for kind, prefix in PREFIX.items():
        p, people = (answers.array(kind, name, at=at) for name in ("probability", "people"))
        r = correlation(weights, by_event(p), by_event(people))
        found[f"{kind}_r"] = Resampled(r, events_with(p * people))
        for name, values in {
            "log_score": log_score(p, people),
            "js": jensen_shannon(p, people),
            "log_score_people": negative_entropy(np.where(np.isnan(p), np.nan, people)),
        }.items():
            found[f"{prefix}{name}"] = Resampled.mean(weights, values)
    return found


def moments(answers: Answers, seed: int = 0) -> dict[str, Any] | None:
    """Return ``moments`` of the metrics, see the module."""
    if not answers.moments:
        return None
    by_moment = []
    for at in answers.moments:
        rows = answers.rows[answers.rows["at"] == at]
        of = answers.about(set(rows["event"]))
        counts = {"at": at, "n_events": len(of.events), "n": round(float(rows["votes"].sum()))}
        by_moment.append({**counts, **_until(of, [at], seed)})
    return {**_until(answers, answers.moments, seed), "by_moment": by_moment}


def _until(answers: Answers, at: Sequence[float], seed: int) -> dict[str, Any]:
    weights = resampled(len(answers.events), seed)
    measures = agreement(answers, weights, at)
    found: dict[str, Any] = {name: one.measure() for name, one in measures.items()}
    bins = {}
    for kind, prefix in PREFIX.items():
        found[f"{prefix}split_half_r"] = split_half_of(answers, kind, weights, seed, at)
        p, people = (answers.array(kind, name, at=at) for name in ("probability", "people"))
        known = ~np.isnan(p * people)
        bins[kind] = calibration(p[known], people[known])
        found[f"{prefix}ece"] = ece(bins[kind])
    return {**found, "calibration": bins}
