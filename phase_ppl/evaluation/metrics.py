"""The paper's metrics of predictions (Appendix 5), and what says more than being right.

A *measure* is ``{"value", "ci_low", "ci_high"}`` with a 95 % interval, or None where it cannot be
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
``by_scenario``                in PHASE: true scenario -> ``goal_accuracy``, ``relation_accuracy``,
                               both log scores of the truth, ``n``
``by_agent``                   in other worlds: agent -> ``goal_accuracy``,
                               ``goal_log_score_truth``
``by_pair``                    in other worlds: "red & green" -> ``relation_accuracy``,
                               ``relation_log_score_truth``
``calibration``                "goal" and "relation" -> "0", "0.5", "0.8" and "0.95" -> of the
                               answers of at least that probability ``n``, ``probability``, its
                               mean, and ``accuracy``, the share that is true
``verdict``                    "goal" and "relation" -> of the answers of posteriors, ``n`` and
                               ``accuracy`` of those about events that are "decided", about
                               others ("undecided"), and of those that are "sure" themselves; see
                               :class:`~phase_ppl.evaluation.prediction.Prediction`
``confusion``                  true scenario -> scenario of the two goals answered -> events; None
                               in other worlds than PHASE
``human``                      see below
``doubt``                      whether the model doubts where people do:
                               :mod:`phase_ppl.evaluation.doubt`; None in other worlds than PHASE
``ties``                       question -> events in which several answers are the most probable;
                               None where there are no probabilities
=============================  ===================================================================

``human`` is about people's answers, of which each event has a distribution per question; names
without "goal" are about the relation:

=============================  ===================================================================
``relation_r``, ``goal_r``     Pearson's r of model and people over all events, answers and
                               agents (of goals) or pairs of agents (of relations), of which PHASE
                               has one: there vectors of 3 n and 72 n
``relation_r_given_truth``     the same after subtracting, from each answer's probability, its mean
                               over the events that have the same true relation. What is left of r
                               when it does not help to be right: whether the model is unsure where
                               people are
``log_score``,                 mean over events of sum_k h_k log m_k [nats], h people's share of
``goal_log_score``             answer k, m = (1 - lapse) p + lapse / K the model's, lapse = 0.01
``log_score_people``,          the same of people themselves, sum_k h_k log h_k, in-sample: no model
``goal_log_score_people``      has more, nor as much if it knows how likely people are to answer k
``js``, ``goal_js``            mean over events of the Jensen-Shannon divergence [bits], 0 to 1
``split_half_r``,              r of the answers of two halves of the raters, mean over 1000 random
``goal_split_half_r``          splits, without Spearman-Brown correction
``split_half_by``              "participants": the halves are of all participants, as in the paper;
                               "votes": it is not known who gave which answer, so that the ratings
                               of each event are split on their own
=============================  ===================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.evaluation import arrays
from phase_ppl.evaluation.arrays import Facts, Said, at_truth, kinds_of, true_answers
from phase_ppl.evaluation.bootstrap import (
    Measure,
    by_event,
    correlation,
    difference,
    measure,
    proportion,
    resampled,
    weighted_mean,
)
from phase_ppl.evaluation.doubt import (
    doubt,
    jensen_shannon,
    log_probabilities,
    log_score,
    negative_entropy,
    same_truth,
    split_half,
)
from phase_ppl.evaluation.prediction import (
    GOAL_QUESTIONS,
    Prediction,
    questions_of,
    reference_predictions,
)
from phase_ppl.evaluation.ratings import Judgments
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS, scenario
from phase_ppl.world.scene import PHASE, World

Place = tuple[str, ...]  # keys under which a measure is found in the metrics

PREFIX: Final[Mapping[str, str]] = {"goal": "goal_", "relation": ""}
"""Kind -> what the names of measures under ``human`` begin with."""


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
    return Scores(events, seed=seed, resamples=resamples).metrics(predictions)


def reference_models(
    events: Sequence[Event], *, seed: int = 0, resamples: int = 1000
) -> dict[str, dict[str, Any]]:
    """Return name -> metrics of the models whose predictions the events carry.

    Arguments and errors as for :func:`evaluate_predictions` and
    :func:`~phase_ppl.evaluation.prediction.reference_predictions`.
    """
    scores = Scores(events, seed=seed, resamples=resamples)
    return {name: scores.metrics(given) for name, given in reference_predictions(events).items()}


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
        ``n_events``, the events that both predict, and every measure of
        :func:`evaluate_predictions` that is about the model, in the same place, as
        ``{"value", "ci_low", "ci_high", "p"}``: one minus other, and a two-sided bootstrap p.
        Of ``js`` lower is better, of everything else higher.

    Raises:
        As :func:`evaluate_predictions`.
    """
    return Scores(events, seed=seed, resamples=resamples).difference(one, other)


class Scores:
    """Metrics of several models and their differences, on the same resamples of events.

    What does not depend on the model, and what is asked of one for a pair, is kept for the next.
    """

    def __init__(self, events: Sequence[Event], *, seed: int = 0, resamples: int = 1000) -> None:
        self._events, self._seed, self._resamples = events, seed, resamples
        self._facts: dict[tuple[str, ...], tuple[Facts, FloatArray]] = {}
        self._among_people: dict[tuple[str, ...], dict[Place, Any]] = {}
        self._measures: dict[tuple[tuple[str, ...], bytes], dict[Place, Resampled]] = {}

    def metrics(self, predictions: Mapping[str, Prediction]) -> dict[str, Any]:
        """Return what :func:`evaluate_predictions` does."""
        known, weights = self._of_events(predictions)
        model = arrays.said(known, predictions)
        true_goals = np.where(known.truth["goal"] < 0, np.nan, 0.0)
        judged = {f"{k}_judgments": events_with(p.sum(axis=-1)) for k, p in known.people.items()}
        result: dict[str, Any] = {
            "n_events": len(known.ids),
            "n": {"events": len(self._events), "truth": events_with(true_goals), **judged},
        }
        measures = model_measures(known, model, weights) | people_measures(known, model, weights)
        put(result, {path: one.measure() for path, one in measures.items()})
        if known.ids not in self._among_people:
            self._among_people[known.ids] = _among_people(known, weights, self._seed)
        put(result, self._among_people[known.ids])
        count_scenarios(result, known.scenario)
        result["calibration"] = calibration(model)
        result["verdict"] = verdict(model)
        result["confusion"] = confusion(known.scenario, model.scenario)
        result["doubt"] = doubt(known, model, self._seed, self._resamples)
        result["ties"] = count_ties([predictions[name] for name in known.ids], known.world)
        return result

    def difference(
        self, one: Mapping[str, Prediction], other: Mapping[str, Prediction]
    ) -> dict[str, Any]:
        """Return what :func:`paired_difference` does."""
        known, weights = self._of_events(one, other)
        first, second = arrays.said(known, one), arrays.said(known, other)
        of_one = self._of(known, weights, first.where_known(second))
        of_other = self._of(known, weights, second.where_known(first))
        result: dict[str, Any] = {"n_events": len(known.ids)}
        differences = {
            path: difference(one.values, of_other[path].values, one.n, one.scores is not None)
            for path, one in of_one.items()
        }
        put(result, differences)
        count_scenarios(result, known.scenario)
        return result

    def _of_events(self, *models: Mapping[str, Prediction]) -> tuple[Facts, FloatArray]:
        """Return facts and resamples of the events that all models predict."""
        chosen = list(self._events)
        for predictions in models:
            chosen = arrays.predicted(chosen, predictions)
        ids = tuple(event.id for event in chosen)
        if ids not in self._facts:
            weights = resampled(len(chosen), self._seed, self._resamples)
            self._facts[ids] = arrays.facts(chosen), weights
        return self._facts[ids]

    def _of(self, known: Facts, weights: FloatArray, said: Said) -> dict[Place, Resampled]:
        key = known.ids, said.content()
        if key not in self._measures:
            self._measures[key] = model_measures(known, said, weights)
        return self._measures[key]


def _among_people(known: Facts, weights: FloatArray, seed: int) -> dict[Place, Any]:
    """Return the measures of people's agreement with each other."""
    by_participant = known.by_participant
    found: dict[Place, Any] = {}
    for kind, prefix in PREFIX.items():
        questions = kinds_of(known.world)[kind]
        halves = split_half(known.judgments, questions, weights, by_participant, seed)
        found["human", f"{prefix}split_half_r"] = measure(*halves)
    judged = any(one is not None for one in known.judgments)
    by = "participants" if by_participant else "votes"
    found["human", "split_half_by"] = by if judged else None
    return found


# --- every measure of a model: its value, and its values on the resamples -------------------------


class Resampled(NamedTuple):
    """A measure and its values on the resamples."""

    values: FloatArray  # (1 + resamples,) its value, then the resampled ones
    n: int  # number of events that count in it
    # (event, answer) what it is the share of, from 0 to 1; None for what is no share
    scores: FloatArray | None = None

    def measure(self) -> Measure | None:
        """Return value and 95 % interval: of shares the binomial one, else from the resamples."""
        return measure(self.values, self.n) if self.scores is None else proportion(self.scores)


def model_measures(known: Facts, model: Said, weights: FloatArray) -> dict[Place, Resampled]:
    """Return all measures that are about the model."""
    measures = accuracy_measures(model.right, known, weights)
    measures["goal_top3_accuracy",] = mean_measure(weights, model.in_top, of_shares=True)
    for kind, prefix in PREFIX.items():
        probabilities, people = model.probabilities[kind], known.people[kind]
        of_truth = at_truth(log_probabilities(probabilities), known.truth[kind])
        for path, chosen in known.parts(kind).items():
            part = np.where(chosen, of_truth, np.nan)
            measures[*path, f"{kind}_log_score_truth"] = mean_measure(weights, part)
        measures["human", f"{kind}_r"] = _r(weights, probabilities, people)
        agreed, apart = log_score(probabilities, people), jensen_shannon(probabilities, people)
        measures["human", f"{prefix}log_score"] = mean_measure(weights, agreed)
        measures["human", f"{prefix}js"] = mean_measure(weights, apart)
    measures["human", "relation_r_given_truth"] = _r(
        weights,
        model.probabilities["relation"],
        known.people["relation"],
        same_truth(known.truth["relation"], len(RELATIONS)),
    )
    return measures


def _r(
    weights: FloatArray, x: FloatArray, y: FloatArray, groups: IntArray | None = None
) -> Resampled:
    of_groups = None if groups is None else by_event(groups)
    values = correlation(weights, by_event(x), by_event(y), of_groups)
    known = x * y if groups is None else np.where(groups < 0, np.nan, x * y)
    return Resampled(values, events_with(known))


def mean_measure(weights: FloatArray, values: FloatArray, of_shares: bool = False) -> Resampled:
    """Return the mean of (event, answer) values, which may be shares, from 0 to 1."""
    scores = values if of_shares else None
    return Resampled(weighted_mean(weights, values), events_with(values), scores)


def people_measures(known: Facts, model: Said, weights: FloatArray) -> dict[Place, Resampled]:
    """Return people's own log scores, on the events on which the model has one."""
    measures: dict[Place, Resampled] = {}
    for kind, prefix in PREFIX.items():
        people = np.where(np.isnan(model.probabilities[kind]), np.nan, known.people[kind])
        path = ("human", f"{prefix}log_score_people")
        measures[path] = mean_measure(weights, negative_entropy(people))
    return measures


def accuracy_measures(
    right: Mapping[str, FloatArray], known: Facts, weights: FloatArray
) -> dict[Place, Resampled]:
    """Return the accuracies, overall and of each part (:meth:`~Facts.parts`).

    From kind -> (event, question) how far the answer is right, 0 to 1, NaN unknown.
    """
    measures: dict[Place, Resampled] = {}
    for kind, values in right.items():
        for path, chosen in known.parts(kind).items():
            part = np.where(chosen, values, np.nan)
            measures[*path, f"{kind}_accuracy"] = mean_measure(weights, part, of_shares=True)
    return measures


def events_with(values: FloatArray) -> int:
    """Return the number of events (first axis) with any value that is not NaN."""
    return int((~np.isnan(values)).any(axis=tuple(range(1, values.ndim))).sum())


def confusion(true: IntArray, other: IntArray) -> dict[str, dict[str, int]] | None:
    """Return true scenario -> other scenario -> number of pairs, from indices (pair,) of both.

    Pairs with an unknown scenario (-1) do not count; None where all are unknown.
    """
    counts = np.zeros((len(SCENARIOS), len(SCENARIOS)), np.int64)
    known = (true >= 0) & (other >= 0)
    np.add.at(counts, (true[known], other[known]), 1)
    if not known.any():
        return None
    return {
        name: dict(zip(SCENARIOS, row, strict=True))
        for name, row in zip(SCENARIOS, counts.tolist(), strict=True)
    }


SURE: Final = (0.0, 0.5, 0.8, 0.95)
"""Probabilities of an answer from which on it is counted whether it is true."""


def calibration(model: Said) -> dict[str, dict[str, Any]]:
    """Return how often answers are true that the model is sure of (``calibration``, above)."""
    found: dict[str, dict[str, Any]] = {}
    for kind, right in model.right.items():
        sure = model.sure[kind]
        found[kind] = {}
        for least in SURE:
            chosen = (sure >= least) & ~np.isnan(right)
            if chosen.any():
                told = {"probability": float(sure[chosen].mean()), **_right_among(right, chosen)}
                found[kind][f"{least:g}"] = told
    return found


def verdict(model: Said) -> dict[str, dict[str, Any]]:
    """Return how often answers of posteriors are true, by what these say of them (``verdict``)."""
    found: dict[str, dict[str, Any]] = {}
    for kind, right in model.right.items():
        decided = np.broadcast_to(model.decided, right.shape)
        parts = {"decided": decided == 1, "undecided": decided == 0, "sure": model.leads[kind] == 1}
        told = {name: _right_among(right, chosen) for name, chosen in parts.items()}
        found[kind] = {name: one for name, one in told.items() if one["n"]}
    return found


def _right_among(right: FloatArray, chosen: BoolArray) -> dict[str, Any]:
    """Return how many of the chosen answers are known to be true or not, and the share of true."""
    known = np.where(chosen, right, np.nan)
    return {"n": int(np.isfinite(known).sum()), "accuracy": proportion(known)}


def count_ties(
    given: Sequence[Prediction | Judgments], world: World = PHASE
) -> dict[str, int | None]:
    """Return question -> events in which several answers lead; None where none is known."""
    found = {}
    for question in questions_of(world):
        ties = [one.ties(question) for one in given]
        found[question] = sum(n > 1 for n in ties) if any(ties) else None
    return found


def count_scenarios(result: dict[str, Any], scenario: IntArray) -> None:
    """Put the number of events of each true scenario into ``by_scenario``."""
    for name, part in result.get("by_scenario", {}).items():
        part["n"] = int((scenario == SCENARIOS.index(name)).sum())


def put(result: dict[str, Any], entries: Mapping[Place, Any]) -> None:
    """Put each entry where its path says."""
    for path, value in entries.items():
        place = result
        for name in path[:-1]:
            place = place.setdefault(name, {})
        place[path[-1]] = value


def at(metrics: Mapping[str, Any], path: str | Place) -> Any:
    """Return what is where a path, or its parts joined by dots, says; None: there is nothing."""
    found: Any = metrics
    for name in path.split(".") if isinstance(path, str) else path:
        found = found.get(name) if isinstance(found, Mapping) else None
    return found


# --- what people got right ------------------------------------------------------------------------

_RED, _GREEN = GOAL_QUESTIONS.values()


def human_accuracy(
    events: Sequence[Event], *, seed: int = 0, resamples: int = 1000
) -> dict[str, Any]:
    """Return what the people got right whose judgments the events carry.

    Args:
        events: those with both truth and judgments count.
        seed: of the resamples; the same as of a model's metrics, where all events count.
        resamples: of the events.

    Returns:
        ``n_events``; ``goal_accuracy``, ``relation_accuracy`` and ``by_scenario`` as for models
        (:mod:`phase_ppl.evaluation.metrics`), of an event the share of people who are right, with
        intervals by how much events differ; in other worlds ``by_agent`` and ``by_pair``;
        ``majority``, the same for the most frequent answers, ties in label order; ``ties``, the
        events in which several are the most frequent, per question; ``by_participant``, see
        :func:`participant_accuracy`, and ``confusion``, true scenario -> scenario of the goals of
        a participant -> responses; both None where it is not known who gave which answer.

    Raises:
        InvalidEventError, UnknownNameError: the judgments of an event cannot be read.
        InvalidSettingError: ``seed`` or ``resamples`` is out of range.
    """
    chosen = [e for e in events if e.truth is not None and Judgments.of(e) is not None]
    known = arrays.facts(chosen)
    weights = resampled(len(chosen), seed, resamples)
    share = {kind: at_truth(people, known.truth[kind]) for kind, people in known.people.items()}
    # argmax takes NaN for the largest, and what nobody answered is left out here
    most = {kind: np.nan_to_num(people).argmax(axis=-1) for kind, people in known.people.items()}
    majority = {
        kind: np.where(np.isnan(right), np.nan, most[kind] == known.truth[kind])
        for kind, right in share.items()
    }
    result: dict[str, Any] = {"n_events": len(chosen)}
    of_majority: dict[str, Any] = {}
    for place, right in ((result, share), (of_majority, majority)):
        measures = accuracy_measures(right, known, weights)
        put(place, {path: one.measure() for path, one in measures.items()})
        count_scenarios(place, known.scenario)
    result["majority"] = of_majority
    result["ties"] = count_ties([one for one in known.judgments if one is not None], known.world)
    result["by_participant"] = result["confusion"] = None
    if known.by_participant:
        result["by_participant"] = participant_accuracy(chosen)
    if known.by_participant and known.world == PHASE:
        pairs = [
            (true, SCENARIOS.index(scenario(row[_RED], row[_GREEN])))
            for true, one in zip(known.scenario, known.judgments, strict=True)
            if one is not None
            for row in one.responses.values()
            if _RED in row and _GREEN in row
        ]
        result["confusion"] = confusion(*np.array(pairs, np.int64).reshape(-1, 2).T)
    return result


def participant_accuracy(events: Sequence[Event]) -> dict[str, Any]:
    """Return the share that each participant got right, averaged over participants.

    This is the accuracy of people in the paper (Appendix 5).

    Args:
        events: those with truth and with judgments that say who gave which answer count.

    Returns:
        ``n_participants``; ``goal_accuracy`` and ``relation_accuracy``; ``by_scenario``, true
        scenario -> both, of what participants said about its events, and ``n``, the participants
        who said anything. In other worlds than PHASE ``by_agent`` and ``by_pair``.
    """
    import pandas as pd

    world = arrays.world_of(events)
    kinds = kinds_of(world)
    parts = {kind: ["\0".join(path) for path in arrays.parts_of(world, kind)] for kind in kinds}

    def part_of(event: Event, kind: str, place: int) -> str:
        return parts[kind][SCENARIOS.index(event.truth.scenario) if world == PHASE else place]

    rows = [
        (who, kind, part_of(event, kind, i), float(row[question] == true_answers(event)[question]))
        for event in events
        if event.truth is not None and (judgments := Judgments.of(event)) is not None
        for who, row in judgments.responses.items()
        for kind, questions in kinds.items()
        for i, question in enumerate(questions)
        if question in row
    ]
    table = pd.DataFrame(rows, columns=["who", "kind", "part", "right"])
    people = table["who"].unique()
    found: dict[Place, Any] = {("n_participants",): len(people)}
    for part in dict.fromkeys(["", *(part for of_kind in parts.values() for part in of_kind)]):
        of_part, path = (table[table["part"] == part], part.split("\0")) if part else (table, [])
        if part:
            found[*path, "n"] = of_part["who"].nunique()
        for kind in kinds:
            if part and part not in parts[kind]:
                continue
            each = of_part[of_part["kind"] == kind].groupby("who")["right"].mean().reindex(people)
            found[*path, f"{kind}_accuracy"] = proportion(each.to_numpy(float)[:, None])
    result: dict[str, Any] = {}
    put(result, found)
    return result
