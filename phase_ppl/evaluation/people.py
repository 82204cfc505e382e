"""What people got right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.evaluation import tables
from phase_ppl.evaluation.bootstrap import figure, resampled, weighted_mean
from phase_ppl.evaluation.metrics import (
    accuracy_curves,
    confusion,
    count_scenarios,
    count_ties,
    put,
)
from phase_ppl.evaluation.prediction import GOAL_QUESTIONS
from phase_ppl.evaluation.ratings import event_judgments
from phase_ppl.evaluation.tables import KINDS, true_answer
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import SCENARIOS, scenario

_RED, _GREEN = GOAL_QUESTIONS.values()
_ALL: Final = ""
"""Stands for all scenarios together."""


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
