"""Evaluations of models whose predictions the events carry, beside those that are run."""

from __future__ import annotations

from collections.abc import Sequence

from phase_ppl.evaluation.evaluation import Evaluation, cost_of
from phase_ppl.evaluation.references import reference_predictions
from phase_ppl.world.errors import unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.identity import event_digest


def carried_evaluation(events: Sequence[Event], name: str) -> Evaluation:
    """Return what the events carry of a model, as if it had been evaluated on them.

    It has no seed, nothing was timed, and it is kept nowhere. Events that carry nothing of the
    model are in ``failures``.

    Args:
        events: with their predictions (:mod:`phase_ppl.evaluation.references`).
        name: of the model, as the events call it.

    Raises:
        UnknownNameError: no event carries a prediction of that model.
        InvalidEventError: a prediction cannot be read.
    """
    carried = reference_predictions(events)
    if name not in carried:
        raise unknown_name("model among those whose predictions the events carry", name, carried)
    predictions = carried[name]
    settings = {
        "model": name,
        "carried": True,
        "seed": None,
        "events": {event.id: event_digest(event) for event in events},
    }
    failures = {
        event.id: f"the event carries no prediction of {name}"
        for event in events
        if event.id not in predictions
    }
    return Evaluation(
        list(events), predictions, failures, settings, cost_of(predictions, None, None)
    )
