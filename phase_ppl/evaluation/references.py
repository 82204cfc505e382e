"""Predictions of other models that the events carry, as their files have them.

``event.predictions`` maps the name of a model to one of::

    {"goals": {"red agent": "...", "green agent": "..."}, "relation": "friendly",
     "goal_probs": {"red agent": {"...": 0.9, "...": 0.1}, ...},
     "relation_probs": {"friendly": 0.6, "neutral": 0.3, "adversarial": 0.1}}

where every field may be missing or null, or to what
:meth:`~phase_ppl.evaluation.prediction.Prediction.to_dict` writes, without ``event``. Goals are
effective ones; of probabilities, answers of probability 0 may be left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from phase_ppl.dataset.documents import of_kind
from phase_ppl.evaluation.prediction import GOAL_QUESTIONS, Prediction, probabilities_of
from phase_ppl.world.errors import InvalidEventError, PhasePPLError, shown, unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.names import AGENTS

_FIELDS: Final = ("goals", "relation", "goal_probs", "relation_probs")
_OWN_FIELDS: Final = ("event", "probabilities", "answers", "cost")


def reference_predictions(events: Sequence[Event]) -> dict[str, dict[str, Prediction]]:
    """Return model -> event id -> prediction; events that carry none of a model are left out.

    Models come in the order in which the events name them first.

    Raises:
        InvalidEventError: a prediction has no such form, or probabilities that are none.
        UnknownNameError: a field, agent, goal or relation is unknown. Messages begin with the
            event and the model.
    """
    found: dict[str, dict[str, Prediction]] = {}
    for event in events:
        for model, record in (event.predictions or {}).items():
            if record is None:
                continue
            try:
                prediction = _prediction(event.id, record)
            except PhasePPLError as error:
                raise type(error)(f"event {event.id}: predictions: {model}: {error}") from None
            found.setdefault(str(model), {})[event.id] = prediction
    return found


def _prediction(event_id: str, record: object) -> Prediction:
    fields = of_kind("it", record, dict)
    given = {name: value for name, value in fields.items() if value is not None}
    own = any(name in given for name in ("probabilities", "answers"))
    allowed = _OWN_FIELDS if own else _FIELDS
    for name in given:
        if name not in allowed:
            raise unknown_name("field", name, allowed)
    if own:
        if given.get("event", event_id) != event_id:
            raise InvalidEventError(f"is of the event {shown(given['event'])}")
        return Prediction.from_dict(
            {"answers": {}, "probabilities": {}, **given, "event": event_id}
        )
    answers = _per_agent("goals", given.get("goals"))
    shares = _per_agent("goal_probs", given.get("goal_probs"))
    if "relation" in given:
        answers["relation"] = given["relation"]
    if "relation_probs" in given:
        shares["relation"] = given["relation_probs"]
    return Prediction(
        event_id,
        {question: probabilities_of(question, values) for question, values in shares.items()},
        answers,
    )


def _per_agent(field: str, record: object) -> dict[str, Any]:
    """Return question -> value from agent -> value, without those that are null."""
    values = {} if record is None else of_kind(field, record, dict)
    for agent in values:
        if agent not in AGENTS:
            raise unknown_name(f"agent in {field}", agent, AGENTS)
    return {GOAL_QUESTIONS[agent]: value for agent, value in values.items() if value is not None}
