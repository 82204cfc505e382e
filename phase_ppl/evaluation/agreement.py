"""How well probabilities agree with people's answers, and people with each other.

Arrays are (event, question, answer), NaN where nothing is known; people's are the shares of their
answers (paper, Appendix 5).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.evaluation import agreement
from phase_ppl.evaluation.bootstrap import (
    Figure,
    correlation,
    divided,
    figure,
    proportion,
    r_of_sums,
    weighted_mean,
)
from phase_ppl.evaluation.prediction import QUESTIONS
from phase_ppl.evaluation.tables import Facts, Said
from phase_ppl.evaluation.votes import Judgments
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS

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
    *,
    by_participant: bool,
    seed: int = 0,
    splits: int = SPLITS,
) -> tuple[FloatArray, int]:
    """Return the mean over random splits of the correlation between two halves of the raters.

    There is no Spearman-Brown correction: it is the r of halves. With an odd number one half has
    one rater more. An event counts in a split if both halves have votes on a question.

    Args:
        judged: the judgments of each event.
        questions: whose answers make the vectors that are correlated.
        weights: (row, event), see :func:`~phase_ppl.evaluation.bootstrap.resampled`.
        by_participant: split the participants of all events together, as the paper does;
            otherwise the votes of each question of each event on their own, which is all that
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
    halves = _Participants(judged, rng, splits) if by_participant else _Votes(rng, splits)
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


class _Votes:
    """Halves of votes, drawn without replacement."""

    def __init__(self, rng: np.random.Generator, splits: int) -> None:
        self._rng, self._splits = rng, splits

    def __call__(
        self, judgments: Judgments, question: str
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the votes (split, answer) of two halves."""
        votes = judgments.counts[question]
        given = np.flatnonzero(votes)
        one = np.zeros((self._splits, len(votes)), np.int64)
        one[:, given] = self._rng.multivariate_hypergeometric(
            votes[given], int(votes.sum()) // 2, size=self._splits, method="marginals"
        )
        return one, votes - one


class _Participants:
    """Votes of halves of the participants."""

    def __init__(
        self, judged: Sequence[Judgments | None], rng: np.random.Generator, splits: int
    ) -> None:
        names = {who: None for one in judged if one is not None for who in one.responses}
        self._place = {who: place for place, who in enumerate(names)}
        first = np.arange(len(names)) < len(names) // 2
        self._in_one = rng.permuted(np.tile(first, (splits, 1)), axis=1)

    def __call__(
        self, judgments: Judgments, question: str
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the votes (split, answer) of two halves."""
        labels = QUESTIONS[question]
        rows = [(who, row[question]) for who, row in judgments.responses.items() if question in row]
        answers = np.zeros((len(rows), len(labels)), np.int64)
        answers[np.arange(len(rows)), [labels.index(answer) for _, answer in rows]] = 1
        one = self._in_one[:, [self._place[who] for who, _ in rows]] @ answers
        return one, judgments.counts[question] - one


def _sums(one: NDArray[np.int64], other: NDArray[np.int64]) -> FloatArray:
    """Return (6, split): n, sums, squares and products of the shares, about their mean 1 / K."""
    x, y = (votes / votes.sum(axis=1, keepdims=True) - 1 / votes.shape[1] for votes in (one, other))
    n = np.full(len(x), float(x.shape[1]))
    parts = [part.sum(axis=1) for part in (x, y, x**2, y**2, x * y)]
    return np.stack([n, *parts])


# --- every metric of a model as a curve: its value, and its values on the resamples ---------------

Path = tuple[str, ...]
"""Keys under which a figure is found in the metrics."""


class Curve(NamedTuple):
    """A figure and its values on the resamples.

    Attributes:
        values: (1 + resamples,) its value, then the resampled ones.
        n: number of events that count in it.
        scores: (event, answer) what it is the share of, from 0 to 1; None for what is no share.
    """

    values: FloatArray
    n: int
    scores: FloatArray | None = None

    def figure(self) -> Figure | None:
        """Return value and 95 % interval: of shares the binomial one, else from the resamples."""
        return figure(self.values, self.n) if self.scores is None else proportion(self.scores)


PREFIX: Final[Mapping[str, str]] = {"goal": "goal_", "relation": ""}
"""Kind -> what the names of figures under ``human`` begin with."""


def model_curves(known: Facts, model: Said, weights: FloatArray) -> dict[Path, Curve]:
    """Return all figures that are about the model."""
    curves = accuracy_curves(model.right, known.scenario, weights)

    def mean(values: FloatArray) -> Curve:
        return Curve(weighted_mean(weights, values), events_with(values))

    curves["goal_top3_accuracy",] = share_curve(weights, model.in_top)
    for kind, prefix in PREFIX.items():
        probabilities, people, truth = (
            model.probabilities[kind],
            known.people[kind],
            known.truth[kind],
        )
        logs = agreement.log_probabilities(probabilities)
        of_truth = np.take_along_axis(logs, np.maximum(truth, 0)[..., None], axis=-1)[..., 0]
        curves[f"{kind}_log_score_truth",] = mean(np.where(truth < 0, np.nan, of_truth))
        curves["human", f"{kind}_r"] = _r(weights, probabilities, people)
        curves["human", f"{prefix}log_score"] = mean(agreement.log_score(probabilities, people))
        curves["human", f"{prefix}js"] = mean(agreement.jensen_shannon(probabilities, people))
    true, n = known.truth["relation"], len(RELATIONS)
    groups = np.where(true < 0, -1, true * n + np.arange(n))
    curves["human", "relation_r_given_truth"] = _r(
        weights, model.probabilities["relation"], known.people["relation"], groups
    )
    return curves


def _r(weights: FloatArray, x: FloatArray, y: FloatArray, groups: IntArray | None = None) -> Curve:
    flat = (x.shape[0], int(np.prod(x.shape[1:])))
    left, right = x.reshape(flat), y.reshape(flat)
    return Curve(correlation(weights, left, right, groups), events_with(left * right))


def share_curve(weights: FloatArray, scores: FloatArray) -> Curve:
    """Return the mean of (event, answer) scores from 0 to 1."""
    return Curve(weighted_mean(weights, scores), events_with(scores), scores)


def people_curves(known: Facts, model: Said, weights: FloatArray) -> dict[Path, Curve]:
    """Return people's own log scores, on the events on which the model has one."""
    curves: dict[Path, Curve] = {}
    for kind, prefix in PREFIX.items():
        people = np.where(np.isnan(model.probabilities[kind]), np.nan, known.people[kind])
        bound = agreement.negative_entropy(people)
        path = ("human", f"{prefix}log_score_people")
        curves[path] = Curve(weighted_mean(weights, bound), events_with(bound))
    return curves


def accuracy_curves(
    right: Mapping[str, FloatArray], scenario: IntArray, weights: FloatArray
) -> dict[Path, Curve]:
    """Return the accuracies, overall and by true scenario.

    Args:
        right: kind -> (event, question) how far the answer is right, 0 to 1, NaN unknown.
        scenario: (event,) index of the true scenario.
        weights: see :func:`~phase_ppl.evaluation.bootstrap.resampled`.
    """
    curves: dict[Path, Curve] = {}
    for kind, values in right.items():
        curves[f"{kind}_accuracy",] = share_curve(weights, values)
        for place, name in enumerate(SCENARIOS):
            part = np.where((scenario == place)[:, None], values, np.nan)
            path = ("by_scenario", name, f"{kind}_accuracy")
            curves[path] = share_curve(weights, part)
    return curves


def events_with(values: FloatArray) -> int:
    """Return the number of events (first axis) with any value that is not NaN."""
    return int((~np.isnan(values)).any(axis=tuple(range(1, values.ndim))).sum())


def confusion(pairs: Iterable[tuple[int, int]]) -> dict[str, dict[str, int]] | None:
    """Return true scenario -> other scenario -> number of pairs (true, other) of indices.

    Pairs with an unknown scenario (-1) do not count; None where all are unknown.
    """
    counts = np.zeros((len(SCENARIOS), len(SCENARIOS)), np.int64)
    for true, other in pairs:
        if true >= 0 and other >= 0:
            counts[true, other] += 1
    if not counts.any():
        return None
    return {
        name: dict(zip(SCENARIOS, row, strict=True))
        for name, row in zip(SCENARIOS, counts.tolist(), strict=True)
    }


def count_scenarios(result: dict[str, Any], scenario: IntArray) -> None:
    """Put the number of events of each true scenario into ``by_scenario``."""
    for place, name in enumerate(SCENARIOS):
        result["by_scenario"][name]["n"] = int((scenario == place).sum())


def put(result: dict[str, Any], entries: Mapping[Path, Any]) -> None:
    """Put each entry where its path says."""
    for path, value in entries.items():
        place = result
        for name in path[:-1]:
            place = place.setdefault(name, {})
        place[path[-1]] = value


def at(metrics: Mapping[str, Any], path: Path) -> Any:
    """Return what is where a path says; None where there is nothing."""
    found: Any = metrics
    for name in path:
        found = found.get(name) if isinstance(found, Mapping) else None
    return found
