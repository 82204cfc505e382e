"""Everybody who watched the events of an evaluation: people, its model, models in the file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

from phase_ppl.evaluation.folder import ResultsFolder
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction
from phase_ppl.evaluation.references import reference_predictions
from phase_ppl.evaluation.votes import event_judgments
from phase_ppl.world.event import Event

PEOPLE: Final = "people"

LABELS: Final[Mapping[str, str]] = {
    PEOPLE: "people",
    "simple": "SIMPLE",
    "last_frame": "last frame",
    "simple_authors": "authors' SIMPLE",
    "socialgnn_2023": "SocialGNN",
    "cue_lstm_2023": "cue LSTM",
}
"""How known observers are called in figures; others by their names, with spaces."""

PEOPLE_COLOUR: Final = "#3c3c3c"
MODEL_COLOUR: Final = "#0072b2"
REFERENCE_COLOURS: Final = ("#d55e00", "#009e73", "#9a4c8f", "#8a6d00", "#56a0d3", "#b0507a")
"""Colours to be told apart without seeing red and green apart."""


@dataclasses.dataclass(frozen=True)
class Observer:
    """Who answered questions about events.

    Attributes:
        name: as in files.
        kind: "people", "model" (the evaluation's own) or "reference" (a model whose answers the
            events carry).
        label: as in figures.
        colour: in figures.
        predictions: event id -> answers; people's probabilities are shares of their votes.
        metrics: of the metrics, where they are known.
    """

    name: str
    kind: str
    label: str
    colour: str
    predictions: Mapping[str, Prediction]
    metrics: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def answered(self, question: str) -> list[str]:
        """Return the events about which the question was answered."""
        return [id for id, given in self.predictions.items() if question in given.answers]


def observers(folder: ResultsFolder, events: Sequence[Event] | None = None) -> list[Observer]:
    """Return those who answered anything: people, the model, references in the file's order.

    Args:
        folder: of the evaluation.
        events: some of the folder's events; default all.

    Raises:
        InvalidEventError, UnknownNameError: a stored prediction or judgment is damaged.
    """
    chosen = folder.events if events is None else events
    metrics = folder.metrics() or {}
    own = {event.id: folder.prediction(event.id) for event in chosen}
    name = str(folder.settings.get("model", "model"))
    found = [
        Observer(PEOPLE, PEOPLE, LABELS[PEOPLE], PEOPLE_COLOUR, people(chosen)),
        Observer(
            name,
            "model",
            label_of(name),
            MODEL_COLOUR,
            {id: given for id, given in own.items() if given is not None},
            metrics,
        ),
    ]
    references = reference_predictions(chosen)
    of_references = metrics.get("reference_models") or {}
    # the order, and so the colour, is the same whichever events are asked for
    names = dict.fromkeys(name for event in folder.events for name in event.predictions or {})
    for place, reference in enumerate(names):
        label = label_of(reference)
        found.append(
            Observer(
                reference,
                "reference",
                f"{label} (in the file)" if label == found[1].label else label,
                REFERENCE_COLOURS[place % len(REFERENCE_COLOURS)],
                references.get(reference, {}),
                of_references.get(reference) or {},
            )
        )
    return [observer for observer in found if observer.predictions]


def people(events: Sequence[Event]) -> dict[str, Prediction]:
    """Return event id -> the shares of people's votes, of the events that people judged."""
    found = {}
    for event in events:
        judgments = event_judgments(event)
        if judgments is not None:
            shares = {question: judgments.distribution(question) for question in QUESTIONS}
            given = {question: share for question, share in shares.items() if share is not None}
            found[event.id] = Prediction(event.id, given)
    return found


def label_of(name: str) -> str:
    """Return how figures call an observer."""
    return LABELS.get(name, name.replace("_", " "))
