"""Answers about events as one tidy table: a model's, people's, and the truth.

It has a row per event, question and possible answer (label). All scores, comparisons and figures
are computed from it.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
import pandas as pd

from phase_ppl.analysis.quantities import relations_of, titles
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction, pairs_of
from phase_ppl.evaluation.ratings import Judgments, rehearsed
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS, Hypothesis
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import space_of

Place: TypeAlias = tuple[str, ...]
"""Keys under which something is found in the metrics."""


# --- what is asked, and what is true --------------------------------------------------------------


def kinds_of(world: World) -> Mapping[str, tuple[str, ...]]:
    """Return what is measured together -> its questions."""
    return {"goal": tuple(f"goal_{key}" for key in world.keys), "relation": tuple(pairs_of(world))}


def parts_of(world: World, kind: str) -> list[tuple[str, str]]:
    """Return where the metrics have parts of the answers of a kind.

    In PHASE those about a scenario; elsewhere goals of an agent, relations of a pair.
    """
    if space_of(world).scenario_names:
        return [("by_scenario", name) for name in SCENARIOS]
    if kind == "goal":
        return [("by_agent", agent) for agent in world.agents]
    pair_of = {question: pair for pair, question in relations_of(world).items()}
    return [("by_pair", pair_of[question]) for question in pairs_of(world)]


def part_of(event: Event, kind: str, place: int) -> str:
    """Return the part, by its name, that the answer to a kind's question belongs to; "": none."""
    group, name = parts_of(event.scene.world, kind)[place]
    return true_scenario(event) or "" if group == "by_scenario" else name


def titles_of(world: World) -> dict[str, str]:
    """Return question -> title of what shows the answers to it."""
    goals = dict(zip(world.agents, kinds_of(world)["goal"], strict=True))
    return titles(goals, relations_of(world))


def world_of(events: Sequence[Event]) -> World:
    """Return the world that all events are of; PHASE where there are none.

    InvalidSettingError: they are of several.
    """
    worlds = list(dict.fromkeys(event.scene.world for event in events)) or [PHASE]
    if len(worlds) > 1:
        names = [one.name for one in worlds]
        differing = "" if len({*names}) == len(names) else " (alike in name only)"
        raise InvalidSettingError(
            f"the events are of the worlds {', '.join(map(repr, names))}{differing}, expected "
            "those of one world"
        )
    return worlds[0]


def true_answers(event: Event) -> dict[str, str]:
    """Return question -> true answer; empty where the event has no truth."""
    truth = event.truth
    if truth is None:
        return {}
    if not isinstance(truth, Hypothesis):
        return {question: str(getattr(truth, question)) for question in QUESTIONS}
    goals = zip(kinds_of(truth.world)["goal"], truth.goals.values(), strict=True)
    pairs = pairs_of(truth.world).items()
    return dict(goals) | {q: truth.relation_between(*pair) for q, pair in pairs}


def true_scenario(event: Event) -> str | None:
    """Return the true scenario; None where it is unknown, as in other worlds than PHASE."""
    known = event.truth is not None and not isinstance(event.truth, Hypothesis)
    return event.truth.scenario if known else None


# --- the table ------------------------------------------------------------------------------------


_NAMES: Final = ("event", "kind", "question", "part", "label")
_NUMBERS: Final = (
    *("at", "votes", "people", "truth", "answer", "probability", "error", "sure", "decided"),
)


class Answers:
    """What a model and people say of events, beside what is true.

    Attributes:
        events: which it is about, of one world, in order.
        world: of the events.
        rows: the tidy table; events, questions and labels are in order. Columns are ``event``,
            ``kind`` of question, ``question``, ``part`` of the metrics, ``label``; ``at``, seconds
            of the film (NaN: all of it); people's ``votes`` for it and their share ``people``;
            ``truth``; the model's ``answer``, its ``probability`` and ``error``; and whether the
            question is ``sure`` and the event ``decided``. All but names are numbers: truth and
            verdicts 1 or 0, NaN: unknown.
    """

    def __init__(
        self, events: Sequence[Event], rows: pd.DataFrame, world: World | None = None
    ) -> None:
        self.events, self.rows, self.world = events, rows, world or world_of(events)

    @classmethod
    def of(cls, events: Sequence[Event], predictions: Mapping[str, Prediction]) -> Answers:
        """Return what is said of events; a model's columns are NaN where it has no prediction."""
        columns: dict[str, list[Any]] = {name: [] for name in (*_NAMES, *_NUMBERS)}
        for event in events:
            truth, judged = true_answers(event), Judgments.of(event)
            made = predictions.get(event.id) or Prediction(event.id, world=event.scene.world)
            moments = {} if judged is None else judged.moments
            for at, given in [(None, judged), *moments.items()]:
                counts = {} if given is None else given.counts
                said = made if at is None else made.at(at)
                for kind, questions in kinds_of(event.scene.world).items():
                    for place, question in enumerate(questions):
                        labels = made.questions[question]
                        votes = counts.get(question, np.zeros(len(labels), np.int64))
                        found: dict[str, Any] = {
                            **{"event": event.id, "kind": kind, "question": question},
                            **{"part": part_of(event, kind, place), "label": list(labels)},
                            **{"at": at, "votes": votes},
                            "people": votes / votes.sum() if question in counts else None,
                            "truth": _marked(labels, truth.get(question)),
                            "answer": _marked(labels, said.answers.get(question)),
                            "probability": said.probabilities.get(question),
                            "error": said.errors.get(question),
                            **{"sure": said.sure.get(question), "decided": said.decided},
                        }
                        for name, value in found.items():
                            alone = value is None or isinstance(value, str | bool | float)
                            columns[name] += [value] * len(labels) if alone else list(value)
        rows = pd.DataFrame(columns, dtype=None if events else object)
        return cls(events, rows.astype(dict.fromkeys(_NUMBERS, np.float64)))

    @functools.cached_property
    def whole(self) -> pd.DataFrame:
        """The rows about the whole film."""
        return self.rows[self.rows["at"].isna()]

    @functools.cached_property
    def moments(self) -> tuple[float, ...]:
        """Seconds of the film at which people judged some event, in order."""
        return tuple(sorted(self.rows["at"].dropna().unique().tolist()))

    def about(self, ids: Collection[str]) -> Answers:
        """Return it about some of the events only."""
        kept = [event for event in self.events if event.id in ids]
        return Answers(kept, self.rows[self.rows["event"].isin([*ids])], self.world)

    def where_known(self, other: Answers) -> Answers:
        """Return it without what ``other``, about the same events, does not answer."""
        own = ["answer", "probability"]
        known = other.rows[own].notna().set_axis(self.rows.index)
        rows = self.rows.assign(**self.rows[own].where(known))
        return Answers(self.events, rows, self.world)

    def array(
        self, kind: str, column: str, of: type = np.float64, at: Sequence[float] = ()
    ) -> FloatArray:
        """Return (event, question, label) a column's values for a kind of questions.

        They are about the whole film. With moments ``at`` they are (event, moment and question,
        label), numbers about it until then; NaN: nobody judged the event then.
        """
        labels = self.world.goals if kind == "goal" else RELATIONS
        shape = len(kinds_of(self.world)[kind]), len(labels)
        rows = self.rows[self.rows["at"].isin(at)] if at else self.whole
        rows = rows[rows["kind"] == kind]
        if not at:
            return rows[column].to_numpy(of).reshape(len(self.events), *shape)
        first = rows.iloc[:: max(math.prod(shape), 1)]
        found = np.full((len(self.events), len(at), *shape), np.nan)
        events = pd.Index([event.id for event in self.events]).get_indexer(first["event"])
        found[events, pd.Index(at).get_indexer(first["at"])] = (
            rows[column].to_numpy().reshape(len(first), *shape)
        )
        return found.reshape(len(self.events), len(at) * shape[0], shape[1])

    def parts(self, kind: str) -> dict[Place, BoolArray]:
        """Return where the metrics have a part of the answers -> which of (event, question) it is.

        The whole comes first, at (), then :func:`parts_of` the world.
        """
        names = self.array(kind, "part", object)[..., 0]
        paths: list[Place] = [(), *parts_of(self.world, kind)]
        return {path: names == path[-1] if path else np.ones((1, 1), bool) for path in paths}

    def content(self) -> bytes:
        """Return what the model says, as a key."""
        return self.rows[["answer", "probability"]].to_numpy().tobytes()

    @functools.cached_property
    def scenarios(self) -> IntArray:
        """(event,) indices of the true scenarios, -1 where unknown."""
        names = map(true_scenario, self.events)
        return np.array([-1 if name is None else SCENARIOS.index(name) for name in names], np.int64)


def predicted(events: Sequence[Event], predictions: Mapping[str, Prediction]) -> list[Event]:
    """Return the events that have a prediction."""
    ids = [event.id for event in events]
    if len(set(ids)) < len(ids):
        twice = next(name for name in ids if ids.count(name) > 1)
        raise InvalidEventError(f"there are two events with the id {shown(twice)}")
    for name, prediction in predictions.items():
        if prediction.event_id != name:
            raise InvalidSettingError(
                f"the prediction for {shown(name)} is of the event {shown(prediction.event_id)}"
            )
    return [event for event in events if event.id in predictions]


def responses_of(events: Iterable[Event], at: float | None = None) -> pd.DataFrame | None:
    """Return who said what: a row of ``event``, ``who``, ``question``, ``label`` and ``value``.

    A label has the value 1, a graded answer a row for each label that has a share, with that value.
    They are about the whole film, or about it up to a moment. None if it is unknown for some judged
    event, or no event was judged.
    """
    found = [(event.id, Judgments.of(event)) for event in events]
    judged = [(event, one) for event, whole in found if (one := _until(whole, at)) is not None]
    if not judged or not all(one.responses for _, one in judged):
        return None
    rows = [
        (event, who, question, label, value)
        for event, one in judged
        for who, row in one.responses.items()
        for question, answer in row.items()
        for label, value in ({answer: 1.0} if isinstance(answer, str) else answer).items()
    ]
    return pd.DataFrame(rows, columns=["event", "who", "question", "label", "value"])


def _until(judged: Judgments | None, at: float | None) -> Judgments | None:
    """Return judgments of the whole film, or up to a moment; None where there are none."""
    found = judged if judged is None or at is None else judged.moments.get(at)
    return found if found is not None and found.counts else None


def _marked(labels: Sequence[str], label: str | None) -> list[bool] | None:
    """Return at which of the labels a label is, where there is one."""
    return None if label is None else [one == label for one in labels]


# --- whose answers they are ----------------------------------------------------------------------

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


@dataclasses.dataclass(frozen=True, eq=False)
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
) -> list[AnswerSet]:
    """Return people's answers and those of models, in order; whoever has none is left out.

    Args:
        events: that may carry people's judgments.
        models: name -> event id -> answers.
        references: those models whose answers the events carry.
    """
    labels = [label_of(name) for name in models]
    colours = itertools.cycle(c for c in PALETTE if c not in map(COLOURS.get, models))
    people = f"scripted {PEOPLE}" if rehearsed(events) else PEOPLE
    found = [AnswerSet(PEOPLE, PEOPLE, people, PEOPLE_COLOUR, peoples_answers(events))]
    for name, label in zip(models, labels, strict=True):
        kind = "reference" if name in references else "model"
        unlike = label if labels.count(label) == 1 else name
        colour = COLOURS.get(name) or next(colours)
        found.append(AnswerSet(name, kind, unlike, colour, models[name]))
    return [answers for answers in found if answers.predictions]


def peoples_answers(events: Sequence[Event]) -> dict[str, Prediction]:
    """Return the shares of people's ratings, of the events that people judged."""
    found = {}
    for event in events:
        judgments = Judgments.of(event)
        if judgments is not None and judgments.counts:
            shares = {q: ratings / ratings.sum() for q, ratings in judgments.counts.items()}
            found[event.id] = Prediction(event.id, shares, world=event.scene.world)
    return found


def reference_label(name: str, models: Collection[str]) -> str:
    """Return how a model whose answers the events carry is called beside other models."""
    return f"{name} (stored)" if name in models or name == PEOPLE else name


def label_of(name: str) -> str:
    """Return how figures call a source."""
    return LABELS.get(name, name.replace("_", " "))
