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
``doubt``                      whether the model doubts where people do:
                               :mod:`phase_ppl.evaluation.doubt`
``ties``                       question -> events in which several answers are the most probable;
                               None where there are no probabilities
=============================  ===================================================================

Of events of another world than PHASE there are no ``by_scenario``, ``confusion``, ``human`` and
``doubt``, but:

=============================  ===================================================================
``by_agent``                   agent -> ``goal_accuracy``, ``goal_log_score_truth``
``by_pair``                    "red & green" -> ``relation_accuracy``,
                               ``relation_log_score_truth``
``calibration``                "goal" and "relation" -> "0", "0.5", "0.8" and "0.95" -> of the
                               answers of at least that probability ``n``, ``probability``, its
                               mean, and ``accuracy``, the share that is true
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
                               "votes": it is not known who gave which answer, so that the ratings
                               of each event are split on their own
=============================  ===================================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.evaluation import tables
from phase_ppl.evaluation.bootstrap import (
    Figure,
    correlation,
    difference,
    figure,
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
    split_half,
)
from phase_ppl.evaluation.prediction import (
    GOAL_QUESTIONS,
    Prediction,
    pairs_of,
    questions_of,
    reference_predictions,
)
from phase_ppl.evaluation.ratings import Judgments, event_judgments
from phase_ppl.evaluation.tables import KINDS, Facts, Said, true_answer
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS, scenario
from phase_ppl.world.scene import PHASE, World

Path = tuple[str, ...]  # keys under which a figure is found in the metrics

PREFIX: Final[Mapping[str, str]] = {"goal": "goal_", "relation": ""}
"""Kind -> what the names of figures under ``human`` begin with."""

_ORDER: Final = (
    *("n_events", "n", "goal_accuracy", "goal_top3_accuracy", "relation_accuracy"),
    *("goal_log_score_truth", "relation_log_score_truth", "by_scenario", "confusion", "human"),
    *("by_agent", "by_pair", "calibration", "doubt", "ties"),
)
_HUMAN_ORDER: Final = (
    *("relation_r", "relation_r_given_truth", "goal_r", "log_score", "log_score_people"),
    *("goal_log_score", "goal_log_score_people", "js", "goal_js", "split_half_r"),
    *("goal_split_half_r", "split_half_by"),
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
    return metrics_of_each(events, {"": predictions}, seed=seed, resamples=resamples)[""]


def reference_models(
    events: Sequence[Event], *, seed: int = 0, resamples: int = 1000
) -> dict[str, dict[str, Any]]:
    """Return name -> metrics of the models whose predictions the events carry.

    Arguments and errors as for :func:`evaluate_predictions` and
    :func:`~phase_ppl.evaluation.prediction.reference_predictions`.
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
    given: dict[tuple[str, ...], tuple[Facts, FloatArray, dict[Path, Any]]] = {}
    found = {}
    for name, predictions in models.items():
        chosen = tables.predicted(events, predictions)
        ids = tuple(event.id for event in chosen)
        if ids not in given:
            known, weights = tables.facts(chosen), resampled(len(chosen), seed, resamples)
            given[ids] = known, weights, _among_people(known, weights, seed)
        known, weights, among_people = given[ids]
        model = tables.said(chosen, predictions)
        judged = {f"{k}_judgments": events_with(p.sum(axis=-1)) for k, p in known.people.items()}
        result: dict[str, Any] = {
            "n_events": len(chosen),
            "n": {"events": len(events), "truth": int((known.scenario >= 0).sum()), **judged},
        }
        curves = model_curves(known, model, weights) | people_curves(known, model, weights)
        put(result, {path: curve.figure() for path, curve in curves.items()})
        if known.world == PHASE:
            put(result, among_people)
            count_scenarios(result, known.scenario)
            result["confusion"] = confusion(zip(known.scenario, model.scenario, strict=True))
            result["doubt"] = doubt(known, model, ids, seed, resamples)
        else:
            result["n"]["truth"] = events_with(np.where(known.truth["goal"] < 0, np.nan, 0.0))
            result["calibration"] = calibration(model)
        result["ties"] = count_ties([predictions[event.id] for event in chosen], known.world)
        found[name] = _ordered(result)
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
        if self._facts[ids][0].world == PHASE:
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


def _among_people(known: Facts, weights: FloatArray, seed: int) -> dict[Path, Any]:
    """Return the figures of people's agreement with each other."""
    found: dict[Path, Any] = {}
    for kind, prefix in PREFIX.items():
        found["human", f"{prefix}split_half_r"] = figure(
            *split_half(
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


def _ordered(result: Mapping[str, Any]) -> dict[str, Any]:
    given = dict(result)
    if "human" in given:
        of_people = given["human"]
        given["human"] = {name: of_people[name] for name in _HUMAN_ORDER if name in of_people}
    return {name: given[name] for name in _ORDER if name in given}


# --- every metric of a model as a curve: its value, and its values on the resamples ---------------


class Curve(NamedTuple):
    """A figure and its values on the resamples."""

    values: FloatArray  # (1 + resamples,) its value, then the resampled ones
    n: int  # number of events that count in it
    # (event, answer) what it is the share of, from 0 to 1; None for what is no share
    scores: FloatArray | None = None

    def figure(self) -> Figure | None:
        """Return value and 95 % interval: of shares the binomial one, else from the resamples."""
        return figure(self.values, self.n) if self.scores is None else proportion(self.scores)


def model_curves(known: Facts, model: Said, weights: FloatArray) -> dict[Path, Curve]:
    """Return all figures that are about the model."""
    elsewhere = known.world != PHASE
    curves = accuracy_curves(model.right, known.scenario, weights, by_scenario=not elsewhere)

    def mean(values: FloatArray) -> Curve:
        return Curve(weighted_mean(weights, values), events_with(values))

    curves["goal_top3_accuracy",] = share_curve(weights, model.in_top)
    for kind, prefix in PREFIX.items():
        probabilities, people, truth = (
            model.probabilities[kind],
            known.people[kind],
            known.truth[kind],
        )
        logs = log_probabilities(probabilities)
        of_truth = np.take_along_axis(logs, np.maximum(truth, 0)[..., None], axis=-1)[..., 0]
        of_truth = np.where(truth < 0, np.nan, of_truth)
        curves[f"{kind}_log_score_truth",] = mean(of_truth)
        if elsewhere:
            for place, part in enumerate(_parts(kind, known.world)):
                right = model.right[kind][:, [place]]
                curves[*part, f"{kind}_accuracy"] = share_curve(weights, right)
                curves[*part, f"{kind}_log_score_truth"] = mean(of_truth[:, [place]])
            continue
        curves["human", f"{kind}_r"] = _r(weights, probabilities, people)
        curves["human", f"{prefix}log_score"] = mean(log_score(probabilities, people))
        curves["human", f"{prefix}js"] = mean(jensen_shannon(probabilities, people))
    if elsewhere:
        return curves
    true, n = known.truth["relation"], len(RELATIONS)
    groups = np.where(true < 0, -1, true * n + np.arange(n))
    curves["human", "relation_r_given_truth"] = _r(
        weights, model.probabilities["relation"], known.people["relation"], groups
    )
    return curves


def _parts(kind: str, world: World) -> list[Path]:
    """Return where the figures of each question of a kind are, in another world than PHASE."""
    if kind == "goal":
        return [("by_agent", agent) for agent in world.agents]
    key = dict(zip(world.agents, world.keys, strict=True))
    return [("by_pair", f"{key[one]} & {key[other]}") for one, other in pairs_of(world).values()]


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
    if known.world != PHASE:
        return curves
    for kind, prefix in PREFIX.items():
        people = np.where(np.isnan(model.probabilities[kind]), np.nan, known.people[kind])
        bound = negative_entropy(people)
        path = ("human", f"{prefix}log_score_people")
        curves[path] = Curve(weighted_mean(weights, bound), events_with(bound))
    return curves


def accuracy_curves(
    right: Mapping[str, FloatArray],
    scenario: IntArray,
    weights: FloatArray,
    *,
    by_scenario: bool = True,
) -> dict[Path, Curve]:
    """Return the accuracies, overall and by true scenario.

    From kind -> (event, question) how far the answer is right, 0 to 1, NaN unknown, and (event,)
    index of the true scenario.
    """
    curves: dict[Path, Curve] = {}
    for kind, values in right.items():
        curves[f"{kind}_accuracy",] = share_curve(weights, values)
        for place, name in enumerate(SCENARIOS if by_scenario else ()):
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


SURE: Final = (0.0, 0.5, 0.8, 0.95)
"""Probabilities of an answer from which on it is counted whether it is true."""


def calibration(model: Said) -> dict[str, dict[str, Any]]:
    """Return how often answers are true that the model is sure of (``calibration``, above)."""
    found: dict[str, dict[str, Any]] = {}
    for kind, right in model.right.items():
        sure = model.probabilities[kind].max(axis=-1, initial=-np.inf)
        found[kind] = {}
        for least in SURE:
            chosen = (sure >= least) & ~np.isnan(right)
            if chosen.any():
                accuracy = proportion(np.where(chosen, right, np.nan))
                told = {"n": int(chosen.sum()), "probability": float(sure[chosen].mean())}
                found[kind][f"{least:g}"] = {**told, "accuracy": accuracy}
    return found


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


# --- what people got right ------------------------------------------------------------------------

_RED, _GREEN = GOAL_QUESTIONS.values()
_ALL: Final = ""  # stands for all scenarios together


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
        intervals by how much events differ;
        ``majority``, the same for the most frequent answers, ties in label order; ``ties``, the
        events in which several are the most frequent, per question; ``by_participant``, see
        :func:`participant_accuracy`, and ``confusion``, true scenario -> scenario of the goals of
        a participant -> responses; both None where it is not known who gave which answer.

    Raises:
        InvalidEventError, UnknownNameError: the judgments of an event cannot be read.
        InvalidSettingError: ``seed`` or ``resamples`` is out of range.
    """
    chosen = [e for e in events if e.truth is not None and event_judgments(e) is not None]
    known = tables.facts(chosen)
    weights = resampled(len(chosen), seed, resamples)
    share: dict[str, FloatArray] = {}
    majority: dict[str, FloatArray] = {}
    for kind, people in known.people.items():
        truth = known.truth[kind]
        share[kind] = np.take_along_axis(people, truth[..., None], axis=-1)[..., 0]
        # argmax takes NaN for the largest, and what nobody answered is left out here
        most = np.nan_to_num(people).argmax(axis=-1)
        majority[kind] = np.where(np.isnan(share[kind]), np.nan, most == truth)
    result: dict[str, Any] = {"n_events": len(chosen)}
    of_majority: dict[str, Any] = {}
    for place, right in ((result, share), (of_majority, majority)):
        curves = accuracy_curves(right, known.scenario, weights)
        put(place, {path: curve.figure() for path, curve in curves.items()})
        count_scenarios(place, known.scenario)
    result["majority"] = of_majority
    result["ties"] = count_ties([one for one in known.judgments if one is not None])
    result["by_participant"] = result["confusion"] = None
    if known.by_participant:
        result["by_participant"] = participant_accuracy(chosen, seed=seed, resamples=resamples)
        result["confusion"] = confusion(
            (true, SCENARIOS.index(scenario(row[_RED], row[_GREEN])))
            for true, one in zip(known.scenario, known.judgments, strict=True)
            if one is not None
            for row in one.responses.values()
            if _RED in row and _GREEN in row
        )
    return result


def participant_accuracy(
    events: Sequence[Event], *, seed: int = 0, resamples: int = 1000
) -> dict[str, Any]:
    """Return the share that each participant got right, averaged over participants.

    This is the accuracy of people in the paper (Appendix 5).

    Args:
        events: those with truth and with judgments that say who gave which answer count.
        seed, resamples: of the participants, by whom the intervals are.

    Returns:
        ``n_participants``; ``goal_accuracy`` and ``relation_accuracy``; ``by_scenario``, true
        scenario -> both, of what participants said about its events, and ``n``, the participants
        who said anything.
    """
    tally: dict[str, dict[tuple[str, str], list[bool]]] = {}
    for event in events:
        judgments = event_judgments(event)
        if event.truth is None or judgments is None:
            continue
        for who, row in judgments.responses.items():
            mine = tally.setdefault(who, {})
            for kind, questions in KINDS.items():
                right = [row[q] == true_answer(event, q) for q in questions if q in row]
                for scope in (_ALL, event.truth.scenario) if right else ():
                    mine.setdefault((kind, scope), []).extend(right)
    weights = resampled(len(tally), seed, resamples)
    result: dict[str, Any] = {"n_participants": len(tally)}
    by_scenario: dict[str, dict[str, Any]] = {name: {} for name in SCENARIOS}
    for scope, place in {_ALL: result, **by_scenario}.items():
        for kind in KINDS:
            shares = np.array([np.mean(mine.get((kind, scope), np.nan)) for mine in tally.values()])
            n = int((~np.isnan(shares)).sum())
            place[f"{kind}_accuracy"] = figure(weighted_mean(weights, shares), n)
        if scope != _ALL:
            said = [mine for mine in tally.values() if any((kind, scope) in mine for kind in KINDS)]
            place["n"] = len(said)
    return {**result, "by_scenario": by_scenario}
