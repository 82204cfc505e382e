"""All answers of one source about the events of an evaluation: people, its model, other models."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

from phase_ppl.evaluation.prediction import QUESTIONS, Prediction, reference_predictions
from phase_ppl.evaluation.ratings import event_judgments
from phase_ppl.world.event import Event

PEOPLE: Final = "people"
PEOPLE_COLOUR: Final = "#3c3c3c"
MODEL_COLOUR: Final = "#0072b2"

LABELS: Final[Mapping[str, str]] = {
    "simple": "SIMPLE",
    "simple_as_printed": "SIMPLE as printed",
    "simple_as_intended": "SIMPLE as intended",
    "simple_authors": "authors' SIMPLE",
    "socialgnn": "SocialGNN",
    "socialgnn_original": "SocialGNN, original",
    "socialgnn_2023": "SocialGNN 2023",
    "cue_lstm_2023": "cue LSTM 2023",
    "predicate": "predicate planning",
    "predicate_as_printed": "predicates as printed",
    "vlm": "VLM",
}
"""How known sources are called in figures; others by their names, with spaces."""

COLOURS: Final[Mapping[str, str]] = {
    "simple": MODEL_COLOUR,
    "simple_authors": "#d55e00",
    "socialgnn_2023": "#009e73",
    "cue_lstm_2023": "#9a4c8f",
    "predicate": "#8a6d00",
    "socialgnn": "#56a0d3",
    "vlm": "#b0507a",
    "last_frame": "#7f7f7f",
    "majority": "#a5ad00",
}
"""Colours of known sources, the same in all figures, to be told apart without seeing red and
green apart."""

PALETTE: Final = (
    *COLOURS.values(),
    *("#e69f00", "#a50f15", "#6fc7b2", "#5b3fa0", "#a0643c", "#2b5d34", "#ff8fab"),
)
"""From which the others get theirs."""


@dataclasses.dataclass(frozen=True)
class AnswerSet:
    """What one source answered about events."""

    name: str  # of the source, as in files
    # "people", "model" (the evaluation's own) or "reference" (a model whose answers the events
    # carry)
    kind: str
    label: str  # of the source, as in figures
    colour: str  # in figures
    # event id -> answers; people's probabilities are shares of their ratings
    predictions: Mapping[str, Prediction]
    # of them, where they were asked for
    metrics: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def has(self, question: str) -> bool:
        """Whether the question was answered about any event."""
        return any(question in given.answers for given in self.predictions.values())


def answer_sets(
    events: Sequence[Event], own: str, predictions: Mapping[str, Prediction]
) -> list[AnswerSet]:
    """Return people's answers, the model's, and those that the events carry, in order."""
    names = dict.fromkeys(name for event in events for name in event.predictions or {})
    own_colour, *colours = colours_of([own, *names])
    found = [
        people_answers(events),
        AnswerSet(own, "model", label_of(own), own_colour, predictions),
    ]
    references = reference_predictions(events)
    for name, colour in zip(names, colours, strict=True):
        label = label_of(name)
        if label == label_of(own):
            label += " (in the file)"
        found.append(AnswerSet(name, "reference", label, colour, references.get(name, {})))
    return [answers for answers in found if answers.predictions]


def people_answers(events: Sequence[Event]) -> AnswerSet:
    """Return the shares of people's ratings, of the events that people judged."""
    found = {}
    for event in events:
        judgments = event_judgments(event)
        if judgments is not None:
            shares = {question: judgments.distribution(question) for question in QUESTIONS}
            given = {question: share for question, share in shares.items() if share is not None}
            found[event.id] = Prediction(event.id, given)
    return AnswerSet(PEOPLE, "people", PEOPLE, PEOPLE_COLOUR, found)


def label_of(name: str) -> str:
    """Return how figures call a source."""
    return LABELS.get(name, name.replace("_", " "))


def colours_of(names: Sequence[str]) -> list[str]:
    """Return a colour for each name, different ones while there are enough."""
    found: dict[int, str] = {}
    for place, name in enumerate(names):
        colour = COLOURS.get(name)
        if colour is not None and colour not in found.values():
            found[place] = colour
    free = [colour for colour in PALETTE if colour not in found.values()] or list(PALETTE)
    others = [place for place in range(len(names)) if place not in found]
    found |= {place: free[i % len(free)] for i, place in enumerate(others)}
    return [found[place] for place in range(len(names))]
