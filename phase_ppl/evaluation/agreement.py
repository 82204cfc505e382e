"""How well probabilities agree with people's answers, and people with each other.

Arrays are (event, question, answer), NaN where nothing is known; people's are the shares of their
answers (paper, Appendix 5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

import numpy as np

from phase_ppl.evaluation.bootstrap import divided, r_of_sums
from phase_ppl.evaluation.prediction import QUESTIONS
from phase_ppl.evaluation.ratings import Judgments
from phase_ppl.world.arrays import FloatArray, IntArray

LAPSE: Final = 0.01
"""Share of answers that the log score takes to be given at random, alike for all answers.

Without it one vote for an answer of probability 0, of which samplers have many, would make a score
of minus infinity.
"""

SPLITS: Final = 1000
"""Random halves of the raters over which the split-half correlation is averaged."""


_Halves: TypeAlias = Callable[[Judgments, str], tuple[IntArray, IntArray]]
"""Returns the ratings (split, answer) of two halves of the raters of a question."""


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
    *,
    by_participant: bool,
    seed: int = 0,
    splits: int = SPLITS,
) -> tuple[FloatArray, int]:
    """Return the mean over random splits of the correlation between two halves of the raters.

    There is no Spearman-Brown correction: it is the r of halves. With an odd number one half has
    one rater more. An event counts in a split if both halves rated a question.

    Args:
        judged: the judgments of each event.
        questions: whose answers make the vectors that are correlated.
        weights: (row, event), see :func:`~phase_ppl.evaluation.bootstrap.resampled`.
        by_participant: split the participants of all events together, as the paper does;
            otherwise the ratings of each question of each event on their own, which is all that
            counts allow.
        seed: of the splits.
        splits: number of splits.

    Returns:
        (row,) values, NaN where they cannot be computed, and the number of events that count.
    """
    if not any(
        question in one.counts for one in judged if one is not None for question in questions
    ):
        return np.full(len(weights), np.nan), 0
    rng = np.random.default_rng([seed, 1])
    halves = _of_participants(judged, rng, splits) if by_participant else _of_ratings(rng, splits)
    sums = np.zeros((6, splits, len(judged)))
    for place, judgments in enumerate(judged):
        for question in questions:
            if judgments is not None and question in judgments.counts:
                one, other = halves(judgments, question)
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


def _of_ratings(rng: np.random.Generator, splits: int) -> _Halves:
    """Halve the ratings of each question on their own, without replacement."""

    def halves(judgments: Judgments, question: str) -> tuple[IntArray, IntArray]:
        ratings = judgments.counts[question]
        given = np.flatnonzero(ratings)
        one = np.zeros((splits, len(ratings)), np.int64)
        one[:, given] = rng.multivariate_hypergeometric(
            ratings[given], int(ratings.sum()) // 2, size=splits, method="marginals"
        )
        return one, ratings - one

    return halves


def _of_participants(
    judged: Sequence[Judgments | None], rng: np.random.Generator, splits: int
) -> _Halves:
    """Halve the participants of all events together."""
    names = {who: None for one in judged if one is not None for who in one.responses}
    places = {who: place for place, who in enumerate(names)}
    first = np.arange(len(names)) < len(names) // 2
    in_one = rng.permuted(np.tile(first, (splits, 1)), axis=1)

    def halves(judgments: Judgments, question: str) -> tuple[IntArray, IntArray]:
        labels = QUESTIONS[question]
        rows = [(who, row[question]) for who, row in judgments.responses.items() if question in row]
        answers = np.zeros((len(rows), len(labels)), np.int64)
        answers[np.arange(len(rows)), [labels.index(answer) for _, answer in rows]] = 1
        one = in_one[:, [places[who] for who, _ in rows]] @ answers
        return one, judgments.counts[question] - one

    return halves


def _sums(one: IntArray, other: IntArray) -> FloatArray:
    """Return (6, split): n, sums, squares and products of the shares, about their mean 1 / K."""
    x, y = (half / half.sum(axis=1, keepdims=True) - 1 / half.shape[1] for half in (one, other))
    n = np.full(len(x), float(x.shape[1]))
    parts = [part.sum(axis=1) for part in (x, y, x**2, y**2, x * y)]
    return np.stack([n, *parts])
