"""Answers about events as one tidy table: a model's, people's, and the truth.

It has a row per event, question and possible answer (label). All scores, comparisons and figures
are computed from it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
import pandas as pd

from phase_ppl.analysis.quantities import relations_of, titles
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction, pairs_of
from phase_ppl.evaluation.ratings import Judgments
from phase_ppl.world.arrays import BoolArray, FloatArray
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
            world, scenario = event.scene.world, true_scenario(event) or ""
            truth, judged = true_answers(event), Judgments.of(event)
            made = predictions.get(event.id) or Prediction(event.id, world=world)
            moments = {} if judged is None else judged.moments
            for at, given in [(None, judged), *moments.items()]:
                counts = {} if given is None else given.counts
                said = made if at is None else made.at(at)
                for kind, questions in kinds_of(world).items():
                    parts = parts_of(world, kind)
                    for question, (group, part) in zip(questions, parts, strict=False):
                        labels = made.questions[question]
                        votes = counts.get(question, np.zeros(len(labels), np.int64))
                        found: dict[str, Any] = {
                            **{"event": event.id, "kind": kind, "question": question},
                            "part": scenario if group == "by_scenario" else part,
                            **{"label": list(labels), "at": at, "votes": votes},
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
    found = [(event.id, one) for event in events if (one := Judgments.of(event)) is not None]
    until = [(event, one if at is None else one.moments.get(at)) for event, one in found]
    judged = [(event, one) for event, one in until if one is not None and one.counts]
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


def _marked(labels: Sequence[str], label: str | None) -> list[bool] | None:
    """Return at which of the labels a label is, where there is one."""
    return None if label is None else [one == label for one in labels]


PEOPLE: Final = "people"


def peoples_answers(events: Sequence[Event]) -> dict[str, Prediction]:
    """Return the shares of people's ratings, of the events that people judged."""
    judged = [(event, one) for event in events if (one := Judgments.of(event)) and one.counts]
    return {
        event.id: Prediction(
            event.id, {q: n / n.sum() for q, n in one.counts.items()}, world=event.scene.world
        )
        for event, one in judged
    }
