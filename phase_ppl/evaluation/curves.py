"""Every metric of a model as a curve: its value, and its values on the resamples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.evaluation import agreement
from phase_ppl.evaluation.bootstrap import Figure, correlation, figure, proportion, weighted_mean
from phase_ppl.evaluation.tables import Facts, Said
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.relations import RELATIONS, SCENARIOS

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
