"""The paper's metrics of predictions (Appendix 5), and scores beyond accuracy.

A *measure* is ``{"value", "ci_low", "ci_high"}`` with a 95 % interval, or None if it cannot be
computed. Accuracies, overall and by scenario, have Clopper and Pearson's interval for the effective
number of independent answers (:func:`~phase_ppl.evaluation.bootstrap.proportion`). All other
intervals are percentiles over resampled events. Accuracy of goals is over both agents' goals.
Answers are ranked by probability, ties in label order.

``evaluate_predictions`` gives:

=============================  ===================================================================
``n_events``                   events with a prediction; all below is about them
``n``                          numbers of events: ``events`` given; and predicted ones with
                               ``truth``, ``goal_judgments``, ``relation_judgments``
``goal_accuracy``              share of goals answered rightly
``goal_top3_accuracy``         share of goals that are among the three most probable answers, and
                               have a probability above 0
``relation_accuracy``          share of relations answered rightly
``goal_log_score_truth``       mean log probability of the true answer [nats], with a lapse as
``relation_log_score_truth``   below
``by_scenario``                in PHASE: true scenario -> ``goal_accuracy``, ``relation_accuracy``,
                               both log scores of the truth, ``n``
``by_agent``                   in other worlds: agent -> ``goal_accuracy``,
                               ``goal_log_score_truth``
``by_pair``                    in other worlds: "red & green" -> ``relation_accuracy``,
                               ``relation_log_score_truth``
``calibration``                "goal" and "relation" -> "0", "0.5", "0.8" and "0.95" -> ``n``,
                               answers of at least that probability; ``probability``, their mean;
                               ``accuracy``, the share that is true
``verdict``                    "goal" and "relation" -> "decided", "undecided" and "sure" -> ``n``
                               and ``accuracy`` of posteriors' answers: about decided events,
                               about others, and sure answers; see
                               :class:`~phase_ppl.evaluation.prediction.Prediction`
``human``                      see below
``doubt``                      whether the model is unsure where people are:
                               :mod:`phase_ppl.evaluation.doubt`; None unless the world has exactly
                               one pair of agents
``moments``                    agreement with people who judged at moments of the film:
                               the same module; None where nobody did
=============================  ===================================================================

``human`` is about people's answers: each event has a distribution per question. Names without
"goal" are about the relation:

=============================  ===================================================================
``relation_r``, ``goal_r``     Pearson's r of model and people over all events and answers, and
                               over agents (goals) or pairs of agents (relations). PHASE has one
                               pair: vectors have lengths 3 n and 72 n.
``relation_r_given_truth``     The same after subtracting each answer's mean over events of the
                               same true relation. Being right does not help then: it measures
                               whether the model is unsure where people are.
``log_score``,                 Mean over events of sum_k h_k log m_k [nats], with h people's share
``goal_log_score``             of answer k, m = (1 - lapse) p + lapse / K, lapse = 0.01.
``log_score_people``,          The same for people themselves, sum_k h_k log h_k. It is in-sample:
``goal_log_score_people``      no model reaches more, and one that knows people's probabilities
                               reaches less.
``js``, ``goal_js``            Mean over events of the Jensen-Shannon divergence [bits], 0 to 1.
``split_half_r``,              r of the answers of two halves of the raters, mean over 1000 random
``goal_split_half_r``          splits, without Spearman-Brown correction.
``split_half_by``              "participants": participants are split once for all events, as in
                               the paper. "votes": it is unknown who gave which answer, so each
                               event's ratings are split separately.
=============================  ===================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

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
    PREFIX,
    doubt,
    jensen_shannon,
    label_places,
    log_probabilities,
    log_score,
    moments,
    negative_entropy,
    same_truth,
    split_half_of,
)
from phase_ppl.evaluation.prediction import Prediction, reference_predictions
from phase_ppl.evaluation.ratings import Judgments, rehearsed
from phase_ppl.evaluation.table import (
    Answers,
    Place,
    parts_of,
    predicted,
    responses_of,
    world_of,
)
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import SCENARIOS

TOP: Final = 3


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


class Scores:
    """Metrics of several models and their differences, on the same resamples of events.

    Models' answers and scores are cached for further pairs.
    """

    def __init__(self, events: Sequence[Event], *, seed: int = 0, resamples: int = 1000) -> None:
        self._events, self._seed, self._resamples = events, seed, resamples
        self._said: dict[int, tuple[Mapping[str, Prediction], Answers]] = {}
        self._among_people: dict[tuple[str, ...], dict[Place, Any]] = {}
        self._measures: dict[tuple[tuple[str, ...], bytes], dict[Place, Resampled]] = {}

    def metrics(self, predictions: Mapping[str, Prediction]) -> dict[str, Any]:
        """Return the metrics, as :func:`evaluate_predictions`."""
        answers = self._answers(predictions)
        ids = tuple(event.id for event in answers.events)
        weights = resampled(len(ids), self._seed, self._resamples)
        scores = {kind: scored(answers, kind) for kind in PREFIX}
        result: dict[str, Any] = {
            "n_events": len(ids),
            "n": {
                "events": len(self._events),
                "truth": events_with(answers.array("goal", "truth")),
                **{f"{k}_judgments": events_with(answers.array(k, "people")) for k in PREFIX},
            },
        }
        measures = measures_of(answers, scores, weights)
        for kind, prefix in PREFIX.items():
            theirs = np.where(np.isnan(scores[kind]["js"]), np.nan, scores[kind]["people"])
            measures["human", f"{prefix}log_score_people"] = mean_measure(weights, theirs)
        put(result, {path: one.measure() for path, one in measures.items()})
        if ids not in self._among_people:
            self._among_people[ids] = _among_people(answers, weights, self._seed)
        put(result, self._among_people[ids])
        count_scenarios(result, answers.scenarios)
        result["calibration"] = {k: calibration(one) for k, one in scores.items()}
        result["verdict"] = {k: verdict(one) for k, one in scores.items()}
        result["doubt"] = doubt(answers, self._seed, self._resamples)
        result["moments"] = moments(answers, self._seed, self._resamples)
        if result["moments"] is not None:
            said = {predictions[name].hindsight for name in ids} - {""}
            result["moments"]["hindsight"] = bool(said)
        return result

    def differences(
        self, one: Mapping[str, Prediction], other: Mapping[str, Prediction]
    ) -> tuple[Answers, dict[Place, Measure | None]]:
        """Return the answers of ``one`` about the events that both predict, and all differences.

        Only questions that both answer count, event by event. A difference is one minus other, with
        a two-sided bootstrap p. Lower is better for ``js``, higher for everything else.
        """
        first, second = self._answers(one).about(other), self._answers(other).about(one)
        of_one, of_other = self._of(first.where_known(second)), self._of(second.where_known(first))
        places: dict[Place, int] = {}  # parts of the metrics stay together
        for path in of_one:
            places |= {path[:n]: places.get(path[:n], len(places)) for n in (1, 2)}
        found = {}
        for path in sorted(of_one, key=lambda path: (places[path[:1]], places[path[:2]])):
            mine, theirs = of_one[path], of_other[path]
            of_shares = mine.scores is not None
            found[path] = difference(mine.values, theirs.values, mine.n, of_shares)
        return first, found

    def _answers(self, predictions: Mapping[str, Prediction]) -> Answers:
        if id(predictions) not in self._said:
            answers = Answers.of(predicted(self._events, predictions), predictions)
            self._said[id(predictions)] = predictions, answers
        return self._said[id(predictions)][1]

    def _of(self, answers: Answers) -> dict[Place, Resampled]:
        key = tuple(event.id for event in answers.events), answers.content()
        if key not in self._measures:
            weights = resampled(len(answers.events), self._seed, self._resamples)
            scores = {kind: scored(answers, kind) for kind in PREFIX}
            self._measures[key] = measures_of(answers, scores, weights)
        return self._measures[key]


def _among_people(answers: Answers, weights: FloatArray, seed: int) -> dict[Place, Any]:
    """Return the measures of people's agreement with each other."""
    found: dict[Place, Any] = {
        ("human", f"{prefix}split_half_r"): measure(*split_half_of(answers, kind, weights, seed))
        for kind, prefix in PREFIX.items()
    }
    judged = answers.whole["people"].notna().any()
    by = "votes" if responses_of(answers.events) is None else "participants"
    found["human", "split_half_by"] = by if judged else None
    return found


# --- scores of answers ----------------------------------------------------------------------------


def scored(answers: Answers, kind: str) -> dict[str, FloatArray]:
    """Return the scores of each answer to a kind of questions, (event, question); NaN: unknown.

    ``right`` is 1 or 0. ``in_top`` is 1 if the true answer is among the three most probable ones,
    with a probability above 0, else 0. ``sure`` is the probability of the given answer, which need
    not be the most probable. ``truth`` is the log probability of the true answer. ``log_score`` and
    ``js`` are of model and people, ``people`` is people's own log score. ``leads`` is 1 if the
    posterior is sure of the answer, ``decided`` if the event is decided, else 0.
    """
    p, people, true, given = (
        answers.array(kind, name) for name in ("probability", "people", "truth", "answer")
    )
    leads, decided = (
        answers.array(kind, name)[..., :1].sum(axis=-1) for name in ("sure", "decided")
    )
    return {
        "right": (true * given).sum(axis=-1),
        "in_top": _in_top(p, true),
        "sure": (p * given).sum(axis=-1),
        "truth": (log_probabilities(p) * true).sum(axis=-1),
        "log_score": log_score(p, people),
        "js": jensen_shannon(p, people),
        "people": negative_entropy(people),
        "leads": leads,
        "decided": decided,
    }


def _in_top(p: FloatArray, true: FloatArray) -> FloatArray:
    """Return ``in_top`` of :func:`scored`, from probabilities and truth (..., label)."""
    of_truth = (p * true).sum(axis=-1)
    # ties in label order
    before = np.cumsum(true, axis=-1) == 0
    more = p > of_truth[..., None]
    equal = p == of_truth[..., None]
    # answers that a sampler never drew do not count as top answers
    found = ((more | (equal & before)).sum(axis=-1) < TOP) & (of_truth > 0)
    return np.where(np.isnan(of_truth), np.nan, found)


# --- every measure of a model: its value, and its values on the resamples -------------------------


class Resampled(NamedTuple):
    """A measure and its values on the resamples."""

    values: FloatArray  # (1 + resamples,) its value, then the resampled ones
    n: int  # number of events that count in it
    # (event, answer) scores from 0 to 1 whose mean it is; None: it is no share
    scores: FloatArray | None = None

    def measure(self) -> Measure | None:
        """Return value and 95 % interval: binomial for shares, else from the resamples."""
        return measure(self.values, self.n) if self.scores is None else proportion(self.scores)


def measures_of(
    answers: Answers, scores: Mapping[str, Mapping[str, FloatArray]], weights: FloatArray
) -> dict[Place, Resampled]:
    """Return all measures about the model; ``scores`` is kind -> :func:`scored`."""
    right = {kind: of_kind["right"] for kind, of_kind in scores.items()}
    measures = accuracy_measures(answers, right, weights)
    in_top = scores["goal"]["in_top"]
    measures["goal_top3_accuracy",] = mean_measure(weights, in_top, of_shares=True)
    for kind, prefix in PREFIX.items():
        of_kind = scores[kind]
        for path, chosen in answers.parts(kind).items():
            part = np.where(chosen, of_kind["truth"], np.nan)
            measures[*path, f"{kind}_log_score_truth"] = mean_measure(weights, part)
        measures["human", f"{kind}_r"] = _r(answers, kind, weights)
        for name in ("log_score", "js"):
            measures["human", f"{prefix}{name}"] = mean_measure(weights, of_kind[name])
    given_truth = _r(answers, "relation", weights, given_truth=True)
    measures["human", "relation_r_given_truth"] = given_truth
    return measures


def _r(answers: Answers, kind: str, weights: FloatArray, *, given_truth: bool = False) -> Resampled:
    """Return r of model and people."""
    x, y = answers.array(kind, "probability"), answers.array(kind, "people")
    if not given_truth:
        return Resampled(correlation(weights, by_event(x), by_event(y)), events_with(x * y))
    groups = same_truth(label_places(answers.array(kind, "truth")))
    values = correlation(weights, by_event(x), by_event(y), by_event(groups))
    return Resampled(values, events_with(np.where(groups < 0, np.nan, x * y)))


def mean_measure(weights: FloatArray, values: FloatArray, of_shares: bool = False) -> Resampled:
    """Return the mean of values (event, answer), possibly shares from 0 to 1."""
    scores = values if of_shares else None
    return Resampled(weighted_mean(weights, values), events_with(values), scores)


def accuracy_measures(
    answers: Answers, right: Mapping[str, FloatArray], weights: FloatArray
) -> dict[Place, Resampled]:
    """Return the accuracies, overall and of each part (:meth:`~Answers.parts`).

    ``right`` is kind -> (event, question) score of the answer, 0 to 1; NaN: unknown.
    """
    return {
        (*path, f"{kind}_accuracy"): mean_measure(
            weights, np.where(chosen, values, np.nan), of_shares=True
        )
        for kind, values in right.items()
        for path, chosen in answers.parts(kind).items()
    }


def events_with(values: FloatArray) -> int:
    """Return the number of events (first axis) with any value that is not NaN."""
    return int((~np.isnan(values)).any(axis=tuple(range(1, values.ndim))).sum())


SURE: Final = (0.0, 0.5, 0.8, 0.95)
"""Thresholds of probability for ``calibration``."""


def calibration(scores: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Return the accuracy of answers above thresholds of probability (``calibration``, above)."""
    right, sure, found = scores["right"], scores["sure"], {}
    for least in SURE:
        chosen = (sure >= least) & ~np.isnan(right)
        if chosen.any():
            told = {"probability": float(sure[chosen].mean()), **_right_among(right, chosen)}
            found[f"{least:g}"] = told
    return found


def verdict(scores: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Return the accuracy of posteriors' answers by their own verdict (``verdict``, above)."""
    decided = scores["decided"]
    parts = {"decided": decided == 1, "undecided": decided == 0, "sure": scores["leads"] == 1}
    told = {name: _right_among(scores["right"], chosen) for name, chosen in parts.items()}
    return {name: one for name, one in told.items() if one["n"]}


def _right_among(right: FloatArray, chosen: BoolArray) -> dict[str, Any]:
    """Return how many chosen answers have known truth, and the share that is right."""
    known = np.where(chosen, right, np.nan)
    return {"n": int(np.isfinite(known).sum()), "accuracy": proportion(known)}


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
    """Return the entry at a path, given as parts or joined by dots; None: there is none."""
    found: Any = metrics
    for name in path.split(".") if isinstance(path, str) else path:
        found = found.get(name) if isinstance(found, Mapping) else None
    return found


# --- people's accuracy ----------------------------------------------------------------------------


def human_accuracy(
    events: Sequence[Event], *, seed: int = 0, resamples: int = 1000
) -> dict[str, Any]:
    """Return the accuracy of people, from the judgments that the events carry.

    Args:
        events: those with both truth and judgments count.
        seed: of the resamples. If all events count, a model's metrics with the same seed have the
            same resamples.
        resamples: of the events.

    Returns:
        ``n_events``; ``goal_accuracy``, ``relation_accuracy`` and ``by_scenario`` as for models
        (:mod:`phase_ppl.evaluation.metrics`). An event's score is the share of people who are
        right; intervals are over events. Other worlds have ``by_agent`` and ``by_pair``.
        ``majority`` is the same for the most frequent answers, ties in label order. ``scripted``,
        true, is there if the answers are those of scripted people, in a rehearsal of a study.
        ``by_participant``: see :func:`participant_accuracy`; None if it is unknown who gave which
        answer.

    Raises:
        InvalidEventError, UnknownNameError: the judgments of an event cannot be read.
        InvalidSettingError: ``seed`` or ``resamples`` is out of range.
    """
    chosen = [e for e in events if e.truth is not None and (j := Judgments.of(e)) and j.counts]
    answers = Answers.of(events, {}).about([event.id for event in chosen])
    weights = resampled(len(chosen), seed, resamples)
    share: dict[str, FloatArray] = {}
    majority: dict[str, FloatArray] = {}
    for kind in PREFIX:
        people, true = answers.array(kind, "people"), answers.array(kind, "truth")
        share[kind] = (people * true).sum(axis=-1)
        # argmax would take NaN for the largest; questions without answers are dropped here
        most = np.nan_to_num(people).argmax(axis=-1)
        leads = most == label_places(true)
        majority[kind] = np.where(np.isnan(share[kind]), np.nan, leads)
    result: dict[str, Any] = {"n_events": len(chosen)}
    if rehearsed(chosen):
        result["scripted"] = True
    of_majority: dict[str, Any] = {}
    for place, right in ((result, share), (of_majority, majority)):
        measures = accuracy_measures(answers, right, weights)
        put(place, {path: one.measure() for path, one in measures.items()})
        count_scenarios(place, answers.scenarios)
    result["majority"] = of_majority
    known = responses_of(chosen) is not None
    result["by_participant"] = participant_accuracy(chosen) if known else None
    return result


def participant_accuracy(events: Sequence[Event]) -> dict[str, Any]:
    """Return each participant's accuracy, averaged over participants.

    This is the accuracy of people in the paper (Appendix 5).

    Args:
        events: those count that have truth, and judgments with their participants.

    Returns:
        ``n_participants``; ``goal_accuracy`` and ``relation_accuracy``; ``by_scenario``, true
        scenario -> both accuracies on its events and ``n``, the participants who answered. In other
        worlds than PHASE ``by_agent`` and ``by_pair``.
    """
    judged = [(event, Judgments.of(event)) for event in events if event.truth is not None]
    known = [event for event, one in judged if one is not None and one.responses]
    world, rows = world_of(events), Answers.of(known, {}).whole
    given = responses_of(known)
    columns = ["event", "who", "question", "label", "value"]
    given = pd.DataFrame(columns=columns) if given is None else given
    table = given.merge(rows[rows["truth"] == 1], on=["event", "question"])
    right = table["value"].where(table["label_x"] == table["label_y"], 0.0).astype(float)
    keys = ["event", "who", "kind", "question", "part"]
    table = table.assign(right=right).groupby(keys, sort=False)["right"].sum().reset_index()
    people = table["who"].unique()
    found: dict[Place, Any] = {("n_participants",): len(people)}
    parts = dict.fromkeys(path for kind in PREFIX for path in parts_of(world, kind))
    paths: list[Place] = [(), *parts]
    for path in paths:
        of_part = table[table["part"] == path[-1]] if path else table
        if path:
            found[*path, "n"] = of_part["who"].nunique()
        for kind in PREFIX:
            if not path or path in parts_of(world, kind):
                of_kind = of_part[of_part["kind"] == kind]
                each = of_kind.groupby("who")["right"].mean().reindex(people)
                found[*path, f"{kind}_accuracy"] = proportion(each.to_numpy(float)[:, None])
    result: dict[str, Any] = {}
    put(result, found)
    return result
