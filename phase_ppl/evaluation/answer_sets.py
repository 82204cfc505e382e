"""All answers of one source about the events of an evaluation: of people, or of a model."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.ratings import Judgments
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
    # "people", "model" or "reference" (a model whose answers the events carry)
    kind: str
    label: str  # of the source, as in figures
    colour: str  # in figures
    # event id -> answers; people's probabilities are shares of their ratings
    predictions: Mapping[str, Prediction]
    # of them, where they were asked for
    metrics: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def answer_sets(
    events: Sequence[Event],
    models: Mapping[str, Mapping[str, Prediction]],
    references: Collection[str],
    metrics: Mapping[str, Mapping[str, Any]],
) -> list[AnswerSet]:
    """Return people's answers and those of models, in order; whoever has none is left out.

    Args:
        events: that may carry people's judgments.
        models: name -> event id -> answers.
        references: those models whose answers the events carry.
        metrics: of people and models by name, where they are asked for.
    """
    labels = [label_of(name) for name in models]
    colours = itertools.cycle(c for c in PALETTE if c not in map(COLOURS.get, models))
    people = peoples_answers(events)
    found = [AnswerSet(PEOPLE, PEOPLE, PEOPLE, PEOPLE_COLOUR, people, metrics.get(PEOPLE, {}))]
    for name, label in zip(models, labels, strict=True):
        kind = "reference" if name in references else "model"
        unlike = label if labels.count(label) == 1 else name
        colour = COLOURS.get(name) or next(colours)
        found.append(AnswerSet(name, kind, unlike, colour, models[name], metrics.get(name, {})))
    return [answers for answers in found if answers.predictions]


def peoples_answers(events: Sequence[Event]) -> dict[str, Prediction]:
    """Return the shares of people's ratings, of the events that people judged."""
    found = {}
    for event in events:
        judgments = Judgments.of(event)
        if judgments is not None:
            shares = {q: ratings / ratings.sum() for q, ratings in judgments.counts.items()}
            found[event.id] = Prediction(event.id, shares, world=event.scene.world)
    return found


def reference_label(name: str, models: Collection[str]) -> str:
    """Return how a model whose answers the events carry is called beside other models."""
    return f"{name} (stored)" if name in models or name == PEOPLE else name


def label_of(name: str) -> str:
    """Return how figures call a source."""
    return LABELS.get(name, name.replace("_", " "))
