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
=============================  ===================================================================
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from phase_ppl.evaluation.bootstrap import (
    Measure,
    Resampled,
    by_event,
    correlation,
    events_with,
    proportion,
    resampled,
)
from phase_ppl.evaluation.doubt import (
    PREFIX,
    agreement,
    doubt,
    label_places,
    log_probabilities,
    moments,
    same_truth,
    split_half_of,
)
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.ratings import Judgments, rehearsed
from phase_ppl.evaluation.table import (
    Answers,
    Place,
    parts_of,
    predicted,
    responses_of,
    true_scenario,
    world_of,
)
from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.event import Event

TOP: Final = 3


def evaluate_predictions(
    events: Sequence[Event], predictions: Mapping[str, Prediction], *, seed: int = 0
) -> dict[str, Any]:
    """Return the metrics of a model's predictions; :mod:`phase_ppl.evaluation.metrics` lists them.

    Args:
        events: the events, all of one world. Events without truth count only for agreement with
            people, events without judgments only for being right.
        predictions: event id -> prediction. Events without a prediction do not count; predictions
            of other events are not used.
        seed: seed of the 1000 resamples of the events, which give the intervals, and of the random
            halves of the raters. With one seed, all models that predict all events get the same
            resamples.

    Raises:
        InvalidEventError: two events have the same id, or judgments cannot be read.
        UnknownNameError: judgments name an unknown goal or relation.
        InvalidSettingError: a prediction names another event than its key, or ``seed`` is out of
            range.
    """
    return metrics_of(events, {"": predictions}, seed)[""]


def metrics_of(
    events: Sequence[Event], models: Mapping[str, Mapping[str, Prediction]], seed: int = 0
) -> dict[str, dict[str, Any]]:
    """Return model -> metrics, as :func:`evaluate_predictions`, from its predictions by event."""
    found: dict[str, dict[str, Any]] = {}
    halves: dict[tuple[str, ...], dict[str, Measure | None]] = {}  # of people, by the events
    for model, predictions in models.items():
        answers = Answers.of(predicted(events, predictions), predictions)
        ids = tuple(event.id for event in answers.events)
        weights = resampled(len(ids), seed)
        if ids not in halves:
            halves[ids] = {
                f"{prefix}split_half_r": split_half_of(answers, kind, weights, seed)
                for kind, prefix in PREFIX.items()
            }
        scores = {kind: scored(answers, kind) for kind in PREFIX}
        result = found[model] = {
            "n_events": len(ids),
            "n": {
                "events": len(events),
                "truth": events_with(answers.array("goal", "truth")),
                **{f"{k}_judgments": events_with(answers.array(k, "people")) for k in PREFIX},
            },
            "human": {**halves[ids]},
        }
        measures = measures_of(answers, weights)
        put(result, {path: one.measure() for path, one in measures.items()})
        count_scenarios(result, answers.events)
        result["calibration"] = {k: calibration(one) for k, one in scores.items()}
        result["verdict"] = {k: verdict(one) for k, one in scores.items()}
        result["doubt"] = doubt(answers, seed)
        result["moments"] = moments(answers, seed)
        if result["moments"] is not None:
            result["moments"]["hindsight"] = any(predictions[name].hindsight for name in ids)
    return found


# --- scores of answers ----------------------------------------------------------------------------


def scored(answers: Answers, kind: str) -> dict[str, FloatArray]:
    """Return the scores of each answer to a kind of questions, (event, question); NaN: unknown.

    ``right`` is 1 or 0. ``in_top`` is 1 if the true answer is among the three most probable ones,
    with a probability above 0, else 0. ``sure`` is the probability of the given answer, which need
    not be the most probable. ``truth`` is the log probability of the true answer. ``leads`` is 1 if
    the posterior is sure of the answer, ``decided`` if the event is decided, else 0.
    """
    p, true, given = (answers.array(kind, name) for name in ("probability", "truth", "answer"))
    leads, decided = (
        answers.array(kind, name)[..., :1].sum(axis=-1) for name in ("sure", "decided")
    )
    return {
        "right": (true * given).sum(axis=-1),
        "in_top": _in_top(p, true),
        "sure": (p * given).sum(axis=-1),
        "truth": (log_probabilities(p) * true).sum(axis=-1),
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


def measures_of(answers: Answers, weights: FloatArray) -> dict[Place, Resampled]:
    """Return all measures whose differences between models can be tested."""
    scores = {kind: scored(answers, kind) for kind in PREFIX}
    right, truth = ({kind: of[name] for kind, of in scores.items()} for name in ("right", "truth"))
    shares = by_part(answers, right, "accuracy")
    shares["goal_top3_accuracy",] = scores["goal"]["in_top"]
    found = {path: Resampled.mean(weights, of, of_shares=True) for path, of in shares.items()}
    for path, of in by_part(answers, truth, "log_score_truth").items():
        found[path] = Resampled.mean(weights, of)
    found |= {("human", name): one for name, one in agreement(answers, weights).items()}
    x, y, true = (answers.array("relation", c) for c in ("probability", "people", "truth"))
    groups = same_truth(label_places(true))
    found["human", "relation_r_given_truth"] = Resampled(
        correlation(weights, by_event(x), by_event(y), by_event(groups)),
        events_with(np.where(groups < 0, np.nan, x * y)),
    )
    return found


def by_part(
    answers: Answers, scores: Mapping[str, FloatArray], name: str
) -> dict[Place, FloatArray]:
    """Return place -> (event, question) scores of a kind, overall and of each part; else NaN.

    ``scores`` is kind -> (event, question); parts are those of :meth:`~Answers.parts`.
    """
    return {
        (*path, f"{kind}_{name}"): np.where(chosen, values, np.nan)
        for kind, values in scores.items()
        for path, chosen in answers.parts(kind).items()
    }


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


def count_scenarios(result: dict[str, Any], events: Sequence[Event]) -> None:
    """Put the number of events of each true scenario into ``by_scenario``."""
    counts = Counter(map(true_scenario, events))
    for name, part in result.get("by_scenario", {}).items():
        part["n"] = counts[name]


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


def human_accuracy(events: Sequence[Event]) -> dict[str, Any]:
    """Return the accuracy of people, from the judgments that the events carry.

    Args:
        events: the events; those with both truth and judgments count.

    Returns:
        ``n_events``: number of events that count. ``goal_accuracy`` and ``relation_accuracy``: mean
        over events of the share of people who are right, as ``value`` with a 95 % interval
        ``ci_low`` to ``ci_high``. The interval is Clopper and Pearson's for the effective number of
        independent answers (answers about one event are dependent). ``by_scenario``: true scenario
        -> both accuracies and ``n``, the number of events. In other worlds than PHASE ``by_agent``:
        agent -> goal accuracy, and ``by_pair``: "red & green" and the like -> relation accuracy.
        ``majority``: these accuracies for the answer that most people gave (of equals the first in
        label order). ``by_participant``: what :func:`participant_accuracy` returns; None if it is
        unknown who gave which answer. ``scripted``: True, if people were scripted in a rehearsal of
        a study; else the key is missing.

    Raises:
        InvalidEventError, UnknownNameError: the judgments of an event cannot be read.
    """
    chosen = [e for e in events if e.truth is not None and (j := Judgments.of(e)) and j.counts]
    answers = Answers.of(events, {}).about([event.id for event in chosen])
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
        shares = by_part(answers, right, "accuracy")
        put(place, {path: proportion(of) for path, of in shares.items()})
        count_scenarios(place, chosen)
    result["majority"] = of_majority
    known = responses_of(chosen) is not None
    result["by_participant"] = participant_accuracy(chosen) if known else None
    return result


def participant_accuracy(events: Sequence[Event]) -> dict[str, Any]:
    """Return each participant's accuracy, averaged over participants.

    This is the accuracy of people in the paper (Appendix 5).

    Args:
        events: the events; those count that have truth, and judgments with their participants.

    Returns:
        ``n_participants``; ``goal_accuracy`` and ``relation_accuracy``, with 95 % intervals over
        participants; ``by_scenario``: true scenario -> both accuracies on its events and ``n``, the
        number of participants who answered. In other worlds than PHASE ``by_agent`` and
        ``by_pair``.
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
