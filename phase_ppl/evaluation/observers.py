"""Everybody who watched the events of an evaluation: people, its model, models in the file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

from phase_ppl.evaluation.folder import ResultsFolder
from phase_ppl.evaluation.metrics import evaluate_predictions
from phase_ppl.evaluation.people import human_accuracy
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
    "socialgnn": "SocialGNN",
    "socialgnn_2023": "SocialGNN 2023",
    "cue_lstm_2023": "cue LSTM 2023",
    "predicate": "predicate planning",
    "vlm": "VLM",
}
"""How known observers are called in figures; others by their names, with spaces."""

PEOPLE_COLOUR: Final = "#3c3c3c"
MODEL_COLOUR: Final = "#0072b2"
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
"""Colours of known observers, the same in all figures, to be told apart without seeing red and
green apart."""

PALETTE: Final = (
    *COLOURS.values(),
    *("#e69f00", "#a50f15", "#6fc7b2", "#5b3fa0", "#a0643c", "#2b5d34", "#ff8fab"),
)
"""From which the others get theirs."""


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
        metrics: see :func:`measured`.
    """

    name: str
    kind: str
    label: str
    colour: str
    predictions: Mapping[str, Prediction]
    metrics: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def answered(self, question: str) -> bool:
        """Whether the question was answered about any event."""
        return any(question in given.answers for given in self.predictions.values())


def observers(folder: ResultsFolder, events: Sequence[Event] | None = None) -> list[Observer]:
    """Return those who answered anything: people, the model, references in the file's order.

    Args:
        folder: of the evaluation.
        events: some of the folder's events; default all.

    Raises:
        InvalidEventError, UnknownNameError: a stored prediction or judgment is damaged.
    """
    chosen = folder.events if events is None else events
    own = {event.id: folder.prediction(event.id) for event in chosen}
    name = str(folder.settings.get("model", "model"))
    # the order, and so the colour, is the same whichever events are asked for
    names = dict.fromkeys(name for event in folder.events for name in event.predictions or {})
    own_colour, *colours = colours_of([name, *names])
    found = [
        Observer(PEOPLE, PEOPLE, LABELS[PEOPLE], PEOPLE_COLOUR, people(chosen)),
        Observer(
            name,
            "model",
            label_of(name),
            own_colour,
            {id: given for id, given in own.items() if given is not None},
        ),
    ]
    references = reference_predictions(chosen)
    for reference, colour in zip(names, colours, strict=True):
        label = label_of(reference)
        found.append(
            Observer(
                reference,
                "reference",
                f"{label} (in the file)" if label == found[1].label else label,
                colour,
                references.get(reference, {}),
            )
        )
    return [observer for observer in found if observer.predictions]


def measured(folder: ResultsFolder) -> list[Observer]:
    """Return :func:`observers` with their metrics.

    They are those of metrics.json. Where an evaluation is not finished, and has none, they are
    computed, and everybody's answers are about the events that are finished. Those of people are
    :func:`~phase_ppl.evaluation.people.human_accuracy`.

    Raises:
        InvalidEventError, UnknownNameError: as :func:`observers`; or metrics.json is damaged.
    """
    stored = folder.metrics() or {}
    events = folder.events
    if not stored:
        events = [event for event in events if folder.is_finished(event.id)]
    of_references = stored.get("reference_models") or {}
    found = []
    for observer in observers(folder, events):
        if observer.kind == "people":
            metrics = human_accuracy(events)
        elif observer.kind == "model":
            metrics = stored
        else:
            metrics = of_references.get(observer.name) or {}
        if not metrics:
            metrics = evaluate_predictions(events, observer.predictions)
        found.append(dataclasses.replace(observer, metrics=metrics))
    return found


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
