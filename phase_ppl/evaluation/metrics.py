"""The paper's metrics of predictions (Appendix 5), and what says more than being right.

A *figure* is ``{"value", "ci_low", "ci_high"}`` with a 95 % interval, or None where it cannot be
computed. Accuracies, overall and by scenario, have Clopper and Pearson's interval for as many
independent answers as they are worth (:func:`~phase_ppl.evaluation.bootstrap.proportion`); all
other intervals are percentiles over resampled events. Accuracy of goals is over both agents'
goals. Answers are ranked by probability, ties in label order; ``ties`` counts the events with one,
per question.

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

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

from phase_ppl.evaluation import agreement, tables
from phase_ppl.evaluation.agreement import (
    PREFIX,
    Curve,
    Path,
    confusion,
    count_scenarios,
    events_with,
    model_curves,
    people_curves,
    put,
)
from phase_ppl.evaluation.bootstrap import Figure, difference, figure, resampled
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction
from phase_ppl.evaluation.references import reference_predictions
from phase_ppl.evaluation.tables import KINDS, Facts, Said
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event

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
_HUMAN_ORDER: Final = (
    "relation_r",
    "relation_r_given_truth",
    "goal_r",
    "log_score",
    "log_score_people",
    "goal_log_score",
    "goal_log_score_people",
    "js",
    "goal_js",
    "split_half_r",
    "goal_split_half_r",
    "split_half_by",
)


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
    return _metrics(_given(chosen, seed, resamples), chosen, predictions, len(events))


def reference_models(
    events: Sequence[Event], *, seed: int = 0, resamples: int = 1000
) -> dict[str, dict[str, Any]]:
    """Return name -> metrics of the models whose predictions the events carry.

    Arguments and errors as for :func:`evaluate_predictions` and
    :func:`~phase_ppl.evaluation.references.reference_predictions`.
    """
    return metrics_of_each(events, reference_predictions(events), seed=seed, resamples=resamples)


def metrics_of_each(
    events: Sequence[Event],
    models: Mapping[str, Mapping[str, Prediction]],
    *,
    seed: int = 0,
    resamples: int = 1000,
) -> dict[str, dict[str, Any]]:
    """Return name -> metrics of several models, from name -> event id -> prediction.

    Arguments and errors as for :func:`evaluate_predictions`. What people say among themselves is
    computed once for all models that predict the same events.
    """
    given: dict[tuple[str, ...], _Given] = {}
    found = {}
    for name, predictions in models.items():
        chosen = tables.predicted(events, predictions)
        ids = tuple(event.id for event in chosen)
        if ids not in given:
            given[ids] = _given(chosen, seed, resamples)
        found[name] = _metrics(given[ids], chosen, predictions, len(events))
    return found


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
    return Paired(events, seed=seed, resamples=resamples).difference(one, other)


class Paired:
    """Differences between several models on the same resamples of events.

    What is asked of a model for one pair is kept for the next.

    Args:
        events: with their truth and judgments, where they have them.
        seed, resamples: of the events.
    """

    def __init__(self, events: Sequence[Event], *, seed: int = 0, resamples: int = 1000) -> None:
        self._events, self._seed, self._resamples = events, seed, resamples
        self._facts: dict[tuple[str, ...], tuple[Facts, FloatArray]] = {}
        self._curves: dict[tuple[int, tuple[str, ...], bytes], dict[Path, Curve]] = {}
        self._models: list[Mapping[str, Prediction]] = []  # kept, so that each has its own id

    def difference(
        self, one: Mapping[str, Prediction], other: Mapping[str, Prediction]
    ) -> dict[str, Any]:
        """Return what :func:`paired_difference` does."""
        chosen = tables.predicted(tables.predicted(self._events, one), other)
        ids = tuple(event.id for event in chosen)
        if ids not in self._facts:
            weights = resampled(len(chosen), self._seed, self._resamples)
            self._facts[ids] = tables.facts(chosen), weights
        first, second = tables.said(chosen, one), tables.said(chosen, other)
        of_one = self._of(one, ids, first.where_known(second))
        of_other = self._of(other, ids, second.where_known(first))
        result: dict[str, Any] = {"n_events": len(chosen)}
        put(
            result,
            {
                path: difference(curve.values, of_other[path].values, curve.n)
                for path, curve in of_one.items()
            },
        )
        count_scenarios(result, self._facts[ids][0].scenario)
        return _ordered(result)

    def _of(
        self, model: Mapping[str, Prediction], ids: tuple[str, ...], said: Said
    ) -> dict[Path, Curve]:
        key = id(model), ids, said.unknown()
        if key not in self._curves:
            self._models.append(model)
            self._curves[key] = model_curves(self._facts[ids][0], said, self._facts[ids][1])
        return self._curves[key]


@dataclasses.dataclass(frozen=True, eq=False)
class _Given:
    """What is the same for all models that predict the same events.

    Attributes:
        known: about the events.
        weights: of their resamples.
        halves: the figures of people's agreement with each other.
    """

    known: Facts
    weights: FloatArray
    halves: Mapping[Path, Figure | str | None]


def _given(chosen: Sequence[Event], seed: int, resamples: int) -> _Given:
    known, weights = tables.facts(chosen), resampled(len(chosen), seed, resamples)
    halves: dict[Path, Figure | str | None] = {}
    for kind, prefix in PREFIX.items():
        halves["human", f"{prefix}split_half_r"] = figure(
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
    halves["human", "split_half_by"] = by if judged else None
    return _Given(known, weights, halves)


def _metrics(
    given: _Given,
    chosen: Sequence[Event],
    predictions: Mapping[str, Prediction],
    n_events: int,
) -> dict[str, Any]:
    known, weights = given.known, given.weights
    model = tables.said(chosen, predictions)
    result: dict[str, Any] = {
        "n_events": len(chosen),
        "n": {
            "events": n_events,
            "truth": int((known.scenario >= 0).sum()),
            **{f"{kind}_judgments": events_with(known.people[kind].sum(axis=-1)) for kind in KINDS},
        },
    }
    curves = model_curves(known, model, weights) | people_curves(known, model, weights)
    put(result, {path: curve.figure() for path, curve in curves.items()})
    put(result, given.halves)
    count_scenarios(result, known.scenario)
    result["confusion"] = confusion(zip(known.scenario, model.scenario, strict=True))
    result["ties"] = {}
    for question in QUESTIONS:
        ties = [predictions[event.id].ties(question) for event in chosen]
        result["ties"][question] = sum(n > 1 for n in ties) if any(ties) else None
    return _ordered(result)


def _ordered(result: Mapping[str, Any]) -> dict[str, Any]:
    human = {name: result["human"][name] for name in _HUMAN_ORDER if name in result["human"]}
    return {name: {**result, "human": human}[name] for name in _ORDER if name in result}
