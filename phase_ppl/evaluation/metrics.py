"""The paper's metrics of predictions (Appendix 5), and what says more than being right.

A *figure* is ``{"value", "ci_low", "ci_high"}``, with 95 % intervals from resampled events, or None
where it cannot be computed. Accuracy of goals is over both agents' goals. Answers are ranked by
probability, ties in label order; ``ties`` counts the events with one, per question.

``evaluate_predictions`` gives:

=============================  ===================================================================
``n_events``                   events with a prediction; what follows is about them
``n``                          ``events`` handed in, and, of the predicted ones, ``truth``,
                               ``goal_judgments``, ``relation_judgments``: how many have them
``goal_accuracy``              share of goals whose answer is true
``goal_top3_accuracy``         share of goals that are among the three most probable answers, and
                               have a probability above 0
``relation_accuracy``          share of relations whose answer is true
``goal_log_score_truth``       mean log probability of the true answer [nats], with a lapse as
``relation_log_score_truth``   below
``by_scenario``                true scenario -> ``goal_accuracy``, ``relation_accuracy``, ``n``
``confusion``                  true scenario -> scenario of the two goals answered -> events
``human``                      see below
``ties``                       question -> events in which several answers are the most probable;
                               None where there are no probabilities
=============================  ===================================================================

``human`` is about people's answers, of which each event has a distribution per question; names
without "goal" are about the relation:

=============================  ===================================================================
``relation_r``, ``goal_r``     Pearson's r of model and people over all events, answers and (for
                               goals) agents: vectors of 3 n and 72 n
``relation_r_given_truth``     the same after subtracting, from each answer's probability, its mean
                               over the events that have the same true relation. What is left of r
                               when it does not help to be right: whether the model is unsure where
                               people are
``log_score``,                 mean over events of sum_k h_k log m_k [nats], h people's share of
``goal_log_score``             answer k, m = (1 - lapse) p + lapse / K the model's, lapse = 0.01
``log_score_people``,          the same of people themselves, sum_k h_k log h_k: no model has more
``goal_log_score_people``
``js``, ``goal_js``            mean over events of the Jensen-Shannon divergence [bits], 0 to 1
``split_half_r``,              r of the answers of two halves of the raters, mean over 1000 random
``goal_split_half_r``          splits, without Spearman-Brown correction
``split_half_by``              "participants": the halves are of all participants, as in the paper;
                               "votes": it is not known who gave which answer, so that the votes of
                               each event are split on their own
=============================  ===================================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.evaluation import agreement, tables
from phase_ppl.evaluation.bootstrap import (
    Figure,
    FloatArray,
    correlation,
    difference,
    figure,
    resampled,
    weighted_mean,
)
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction
from phase_ppl.evaluation.references import reference_predictions
from phase_ppl.evaluation.tables import KINDS, Facts, Said
from phase_ppl.world.event import Event
from phase_ppl.world.relations import RELATIONS, SCENARIOS

Path = tuple[str, ...]
Curve = tuple[FloatArray, int]
"""The values (1 + resamples,) of a figure, and the number of events that count in it."""

_PREFIX: Final = {"goal": "goal_", "relation": ""}


def evaluate_predictions(
    events: Sequence[Event],
    predictions: Mapping[str, Prediction],
    *,
    seed: int = 0,
    resamples: int = 1000,
) -> dict[str, Any]:
    """Return the metrics of a model's predictions, as the module describes them.

    Args:
        events: with their truth and judgments, where they have them.
        predictions: event id -> prediction. Events without one do not count; predictions of other
            events are not used.
        seed: of the resamples, and of the halves of the raters. The same seed resamples the same
            events for all models that predict them all.
        resamples: number of resamples of the events.

    Raises:
        InvalidEventError: two events have the same id, or judgments cannot be read.
        UnknownNameError: judgments name an unknown goal or relation.
        InvalidSettingError: a prediction is of another event than it is filed under, or
            ``seed`` or ``resamples`` is out of range.
    """
    chosen = tables.predicted(events, predictions)
    known, model = tables.facts(chosen), tables.said(chosen, predictions)
    weights = resampled(len(chosen), seed, resamples)
    result: dict[str, Any] = {
        "n_events": len(chosen),
        "n": {
            "events": len(events),
            "truth": int((known.scenario >= 0).sum()),
            **{
                f"{kind}_judgments": _events_with(known.people[kind].sum(axis=-1)) for kind in KINDS
            },
        },
    }
    _put(result, {path: figure(*curve) for path, curve in _curves(known, model, weights).items()})
    _put(result, _people(known, model, weights, seed))
    for place, name in enumerate(SCENARIOS):
        result["by_scenario"][name]["n"] = int((known.scenario == place).sum())
    result["confusion"] = confusion(zip(known.scenario, model.scenario, strict=True))
    result["ties"] = {
        question: sum(n > 1 for n in found) if any(found) else None
        for question in QUESTIONS
        for found in [[predictions[event.id].ties(question) for event in chosen]]
    }
    return {name: result[name] for name in _ORDER}


_ORDER: Final = (
    "n_events",
    "n",
    "goal_accuracy",
    "goal_top3_accuracy",
    "relation_accuracy",
    "goal_log_score_truth",
    "relation_log_score_truth",
    "by_scenario",
    "confusion",
    "human",
    "ties",
)


def reference_models(
    events: Sequence[Event], *, seed: int = 0, resamples: int = 1000
) -> dict[str, dict[str, Any]]:
    """Return name -> metrics of the models whose predictions the events carry.

    Arguments and errors as for :func:`evaluate_predictions` and
    :func:`~phase_ppl.evaluation.references.reference_predictions`.
    """
    return {
        name: evaluate_predictions(events, predictions, seed=seed, resamples=resamples)
        for name, predictions in reference_predictions(events).items()
    }


def paired_difference(
    events: Sequence[Event],
    one: Mapping[str, Prediction],
    other: Mapping[str, Prediction],
    *,
    seed: int = 0,
    resamples: int = 1000,
) -> dict[str, Any]:
    """Return how much higher ``one`` scores than ``other``, on the same resamples of events.

    Only the questions that both answer count, event by event.

    Returns:
        ``n_events``, the events that both predict, and every figure of
        :func:`evaluate_predictions` that is about the model, in the same place, as
        ``{"value", "ci_low", "ci_high", "p"}``: one minus other, and a two-sided bootstrap p.
        Of ``js`` lower is better, of everything else higher.

    Raises:
        As :func:`evaluate_predictions`.
    """
    chosen = tables.predicted(tables.predicted(events, one), other)
    known = tables.facts(chosen)
    first, second = tables.said(chosen, one), tables.said(chosen, other)
    weights = resampled(len(chosen), seed, resamples)
    of_one = _curves(known, first.where_known(second), weights)
    of_other = _curves(known, second.where_known(first), weights)
    result: dict[str, Any] = {"n_events": len(chosen)}
    _put(
        result,
        {path: difference(values, of_other[path][0], n) for path, (values, n) in of_one.items()},
    )
    for place, name in enumerate(SCENARIOS):
        result["by_scenario"][name]["n"] = int((known.scenario == place).sum())
    return result


def accuracy_curves(
    right: Mapping[str, FloatArray], scenario: Any, weights: FloatArray
) -> dict[Path, Curve]:
    """Return the accuracies, overall and by true scenario.

    Args:
        right: kind -> (event, question) how far the answer is right, 0 to 1, NaN unknown.
        scenario: (event,) index of the true scenario.
        weights: see :func:`~phase_ppl.evaluation.bootstrap.resampled`.
    """
    curves: dict[Path, Curve] = {}
    for kind, values in right.items():
        curves[f"{kind}_accuracy",] = weighted_mean(weights, values), _events_with(values)
        for place, name in enumerate(SCENARIOS):
            part = np.where((scenario == place)[:, None], values, np.nan)
            path = ("by_scenario", name, f"{kind}_accuracy")
            curves[path] = weighted_mean(weights, part), _events_with(part)
    return curves


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


def _curves(known: Facts, model: Said, weights: FloatArray) -> dict[Path, Curve]:
    """Return all figures that are about the model."""
    curves = accuracy_curves(model.right, known.scenario, weights)

    def mean(values: FloatArray) -> Curve:
        return weighted_mean(weights, values), _events_with(values)

    curves["goal_top3_accuracy",] = mean(model.in_top["goal"])
    for kind, prefix in _PREFIX.items():
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


def _r(weights: FloatArray, x: FloatArray, y: FloatArray, groups: Any = None) -> Curve:
    flat = (x.shape[0], int(np.prod(x.shape[1:])))
    left, right = x.reshape(flat), y.reshape(flat)
    return correlation(weights, left, right, groups), _events_with(left * right)


def _people(
    known: Facts, model: Said, weights: FloatArray, seed: int
) -> dict[Path, Figure | str | None]:
    """Return what is about people alone, and stands beside the model's figures."""
    found: dict[Path, Figure | str | None] = {}
    for kind, prefix in _PREFIX.items():
        people = known.people[kind]
        compared = np.where(np.isnan(model.probabilities[kind]), np.nan, people)
        bound = agreement.negative_entropy(compared)
        found["human", f"{prefix}log_score_people"] = figure(
            weighted_mean(weights, bound), _events_with(bound)
        )
        found["human", f"{prefix}split_half_r"] = figure(
            *agreement.split_half(
                known.judgments,
                KINDS[kind],
                weights,
                by_participant=known.by_participant,
                seed=seed,
            )
        )
    judged = any(one is not None for one in known.judgments)
    by = "participants" if known.by_participant else "votes"
    found["human", "split_half_by"] = by if judged else None
    return found


def _events_with(values: FloatArray) -> int:
    """Return the number of events (first axis) with any value that is not NaN."""
    return int((~np.isnan(values)).any(axis=tuple(range(1, values.ndim))).sum())


def _put(result: dict[str, Any], entries: Mapping[Path, Any]) -> None:
    for path, value in entries.items():
        place = result
        for name in path[:-1]:
            place = place.setdefault(name, {})
        place[path[-1]] = value
