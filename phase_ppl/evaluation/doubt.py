"""How well a model agrees with people, and whether it doubts where they do.

The latter, what a referee asks of a fit to people's answers, is about relations, of the events that
people judged and for which the model has probabilities. A *measure* is as in
:mod:`phase_ppl.evaluation.metrics`. ``doubt`` of metrics.json is None where there is no such event,
else:

==========================  ======================================================================
``relation_r``,             r of model and people, as under ``human``, with intervals over events;
``relation_r_given_truth``  where it is known who answered what also over people (two-way bootstrap,
                            Owen 2007, Annals of Applied Statistics 1). Resampling people adds
                            their noise a second time: intervals are moved back by what it does to
                            the mean, and are too wide, up to twofold
``log_score_gap``           people's own log score minus the model's [nats]. Theirs is in-sample: a
                            model that knew how people answer would be some 1 / n behind n raters
``brier``                   mean over events, and over the people of each, of the squared distance
                            of the model's probabilities from their answer, 0 to 2
``ece``                     expected calibration error: mean distance of the model's probabilities
                            from the share of people, over ten bins of probability
``calibration``             of each bin that has any: ``probability``, ``share``, ``n``
``ceiling``                 ``split_half_r`` of random halves of the raters,
                            ``split_half_r_given_truth``; both by Spearman and Brown's formula for
                            all raters (``spearman_brown``, ``..._given_truth``); and the answer
                            of one rater by the shares of the others: ``one_out_r``,
                            ``one_out_r_given_truth``, ``one_out_log_score``
``agreement``               probability that two raters of an event agree: ``people``, what is
                            ``expected`` of independent raters with the model's probabilities,
                            ``low`` and ``high`` of 95 % of such sets, and ``p``, two-sided
``misfit``                  events by their ``log_score_gap``, largest first, with ``people`` and
                            ``model``
==========================  ======================================================================
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.evaluation.arrays import Facts, Said
from phase_ppl.evaluation.bootstrap import (
    Measure,
    correlation,
    divided,
    measure,
    r_of_sums,
    resampled,
    weighted_mean,
)
from phase_ppl.evaluation.prediction import labels_of
from phase_ppl.evaluation.ratings import Judgments
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.hypothesis import RELATIONS
from phase_ppl.world.scene import PHASE

BINS: Final = 10
_STREAM: Final = 0xD0B7


def doubt(known: Facts, model: Said, seed: int = 0, resamples: int = 1000) -> dict[str, Any] | None:
    """Return what the module describes, of events as arrays; None in other worlds than PHASE."""
    if known.world != PHASE or not any(known.judgments):
        return None
    p, people = model.probabilities["relation"][:, 0], known.people["relation"][:, 0]
    there = ~np.isnan(p[:, 0]) & ~np.isnan(people[:, 0])
    if not there.any():
        return None
    p, people, truth = p[there], people[there], known.truth["relation"][there, 0]
    judged = [one for one, is_there in zip(known.judgments, there, strict=True) if is_there and one]
    counts = np.array([one.counts["relation"] for one in judged])
    names = [name for name, is_there in zip(known.ids, there, strict=True) if is_there]
    rng = np.random.default_rng([seed, _STREAM])
    drawn = people_drawn(judged, counts, rng, resamples) if known.by_participant else None
    weights = resampled(len(p), seed, resamples)
    gap = negative_entropy(people) - log_score(p, people)
    brier = (p**2).sum(axis=1) - 2 * (p * people).sum(axis=1) + 1
    bins = calibration(p, people)

    def r(groups: IntArray | None) -> Measure | None:
        n = len(p) if groups is None else int((groups[:, 0] >= 0).sum())
        if drawn is None:  # an event's ratings are its own, and resampled with it
            return measure(correlation(weights, p, people, groups), n)
        value = correlation(weights[:1], p, people, groups)
        among_raters = correlation(np.ones_like(weights[1:]), p, drawn, groups)
        moved = correlation(weights[1:], p, drawn, groups) + value - _mean(among_raters)
        return measure(np.concatenate([value, np.clip(moved, -1, 1)]), n)

    return {
        "relation_r": r(None),
        "relation_r_given_truth": r(same_truth(truth, len(RELATIONS))),
        "log_score_gap": measure(weighted_mean(weights, gap), len(p)),
        "brier": measure(weighted_mean(weights, brier), len(p)),
        "ece": float(sum(b["n"] * abs(b["probability"] - b["share"]) for b in bins) / p.size),
        "calibration": bins,
        "ceiling": ceiling(counts, truth, rng, resamples),
        "agreement": agreement(p, counts, rng, resamples),
        "misfit": [
            {
                "event": names[i],
                "log_score_gap": float(gap[i]),
                "people": people[i].tolist(),
                "model": p[i].tolist(),
            }
            for i in np.argsort(-gap, kind="stable")
        ],
    }


def same_truth(truth: IntArray, n_answers: int) -> IntArray:
    """Return (..., answer) numbers of groups of the same true answer (...), -1 where it is unknown.

    Deviations from the means of these groups are what is left of probabilities, and of the shares
    of people, when it does not help to be right.
    """
    groups = truth[..., None] * n_answers + np.arange(n_answers)
    return np.where(truth[..., None] < 0, -1, groups)


def people_drawn(
    judged: Sequence[Any], counts: IntArray, rng: np.random.Generator, n: int
) -> FloatArray:
    """Return (resample, event, answer) shares of resampled people.

    They are resampled as wholes, so that whoever is generous is so everywhere; an event that loses
    all of its raters keeps its shares.
    """
    rows = [
        (event, who, RELATIONS.index(given["relation"]))
        for event, one in enumerate(judged)
        for who, given in one.responses.items()
        if "relation" in given
    ]
    place = {who: i for i, who in enumerate(dict.fromkeys(who for _, who, _ in rows))}
    times = rng.multinomial(len(place), np.full(len(place), 1 / len(place)), size=n)
    found = np.zeros((n, *counts.shape))
    for event, who, answer in rows:
        found[:, event, answer] += times[:, place[who]]
    found = np.where(found.sum(axis=-1, keepdims=True) > 0, found, counts)
    return np.asarray(found / found.sum(axis=-1, keepdims=True))


def calibration(p: FloatArray, people: FloatArray) -> list[dict[str, Any]]:
    """Return the mean probability and the share of people in bins of probability."""
    place = np.minimum((p * BINS).astype(np.int64), BINS - 1)
    return [
        {
            "probability": float(p[place == i].mean()),
            "share": float(people[place == i].mean()),
            "n": int((place == i).sum()),
        }
        for i in np.unique(place)
    ]


def ceiling(
    counts: IntArray, truth: IntArray, rng: np.random.Generator, splits: int
) -> dict[str, float | None]:
    """Return how well raters predict each other (``ceiling`` of the module)."""
    several = counts[counts.sum(axis=1) > 1]
    of_several = truth[counts.sum(axis=1) > 1]
    if not len(several):
        return {}
    half = np.stack(
        [
            rng.multivariate_hypergeometric(row, row.sum() // 2, size=splits, method="marginals")
            for row in several
        ],
        axis=1,
    )
    one, other = (part / part.sum(axis=-1, keepdims=True) for part in (half, several - half))
    left_out = np.repeat(np.arange(len(several)), len(RELATIONS))
    answer = np.tile(np.eye(len(RELATIONS)), (len(several), 1))
    rest = np.maximum(several[left_out] - answer, 0)
    rest = rest / np.maximum(rest.sum(axis=1, keepdims=True), 1)
    times = several.ravel().astype(float)
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


def agreement(
    p: FloatArray, counts: IntArray, rng: np.random.Generator, n: int
) -> dict[str, float] | None:
    """Return whether raters agree as often as the model would have them (``agreement``)."""
    several = counts.sum(axis=1) > 1
    if not several.any():
        return None

    def agreeing(given: IntArray) -> FloatArray:
        total = given.sum(axis=-1)
        pairs = (given * (given - 1)).sum(axis=-1) / (total * (total - 1))
        return np.asarray(pairs.mean(axis=-1))

    people = float(agreeing(counts[several]))
    size = (n, int(several.sum()))
    # sums of weights may come to 1 and a last bit, which numpy refuses
    chances = p[several] / p[several].sum(axis=1, keepdims=True)
    drawn = agreeing(rng.multinomial(counts[several].sum(axis=1), chances, size=size))
    low, high = np.quantile(drawn, [0.025, 0.975])
    tail = min((drawn <= people).sum(), (drawn >= people).sum()) + 1
    return {
        "people": people,
        "expected": float((p[several] ** 2).sum(axis=1).mean()),
        "low": float(low),
        "high": float(high),
        "p": min(1.0, float(2 * tail / (n + 1))),
    }


# --- how well probabilities agree with people's answers, and people with each other ---------------
# Arrays are (event, question, answer), NaN where nothing is known; people's are the shares of their
# answers (paper, Appendix 5).

LAPSE: Final = 0.01
"""Share of answers that the log score takes to be given at random, alike for all answers.

Without it one vote for an answer of probability 0, of which samplers have many, would make a score
of minus infinity.
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
    judged: Sequence[Judgments | None],
    questions: Sequence[str],
    weights: FloatArray,
    by_participant: bool,
    seed: int = 0,
    splits: int = SPLITS,
) -> tuple[FloatArray, int]:
    """Return the mean over random splits of the correlation between two halves of the raters.

    There is no Spearman-Brown correction: it is the r of halves. With an odd number one half has
    one rater more. An event counts in a split if both halves rated a question. Either the
    participants of all events are split together, as the paper does (``by_participant``), or the
    ratings of each question of each event on their own, which is all that counts allow.

    Returns:
        (row,) values, NaN where they cannot be computed, and the number of events that count.
    """
    if not any(
        question in one.counts for one in judged if one is not None for question in questions
    ):
        return np.full(len(weights), np.nan), 0
    rng = np.random.default_rng([seed, 1])
    sums = np.zeros((6, splits, len(judged)))
    for place, one, other in _halves(judged, questions, by_participant, rng, splits):
        both = (one.sum(axis=1) > 0) & (other.sum(axis=1) > 0)
        sums[:, both, place] += _sums(one[both], other[both])
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


def _halves(
    judged: Sequence[Judgments | None],
    questions: Sequence[str],
    by_participant: bool,
    rng: np.random.Generator,
    splits: int,
) -> Iterator[tuple[int, IntArray, IntArray]]:
    """Yield the place of an event and the ratings (split, answer) of both halves of its raters.

    Participants are halved for all events at once, ratings without replacement.
    """
    names = dict.fromkeys(who for one in judged if one is not None for who in one.responses)
    places = {who: place for place, who in enumerate(names)}
    if by_participant:
        first = np.arange(len(names)) < len(names) // 2
        in_one = rng.permuted(np.tile(first, (splits, 1)), axis=1)
    for place, judgments in enumerate(judged):
        for question in questions:
            if judgments is None or question not in judgments.counts:
                continue
            ratings = judgments.counts[question]
            if by_participant:
                answers = np.zeros((len(names), len(ratings)), np.int64)
                for who, row in judgments.responses.items():
                    if question in row:
                        answer = labels_of(question, judgments.world).index(row[question])
                        answers[places[who], answer] = 1
                one = in_one @ answers
            else:
                given = np.flatnonzero(ratings)
                one = np.zeros((splits, len(ratings)), np.int64)
                one[:, given] = rng.multivariate_hypergeometric(
                    ratings[given], int(ratings.sum()) // 2, size=splits, method="marginals"
                )
            yield place, one, ratings - one


def _sums(one: IntArray, other: IntArray) -> FloatArray:
    """Return (6, split): n, sums, squares and products of the shares, about their mean 1 / K."""
    x, y = (half / half.sum(axis=1, keepdims=True) - 1 / half.shape[1] for half in (one, other))
    n = np.full(len(x), float(x.shape[1]))
    parts = [part.sum(axis=1) for part in (x, y, x**2, y**2, x * y)]
    return np.stack([n, *parts])
