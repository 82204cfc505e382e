"""Events, predictions and judgments as arrays over events, from which all metrics follow."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from phase_ppl.analysis.quantities import relations_of, titles
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction, pairs_of, questions_of
from phase_ppl.evaluation.ratings import Judgments
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS, Roles
from phase_ppl.world.scene import PHASE, World

TOP: Final = 3


def kinds_of(world: World) -> Mapping[str, tuple[str, ...]]:
    """Return what is measured together -> its questions."""
    return {"goal": tuple(f"goal_{key}" for key in world.keys), "relation": tuple(pairs_of(world))}


def parts_of(world: World, kind: str) -> list[tuple[str, str]]:
    """Return where the metrics have parts of the answers of a kind.

    In PHASE those about a scenario; elsewhere goals of an agent, relations of a pair.
    """
    if world == PHASE:
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


@dataclasses.dataclass(frozen=True, eq=False)
class Facts:
    """What is known about the events themselves."""

    ids: tuple[str, ...]  # of the events
    # kind -> (event, question) index of the true answer, -1 where unknown
    truth: Mapping[str, IntArray]
    scenario: IntArray  # (event,) index of the true scenario, -1 where unknown
    judgments: Sequence[Judgments | None]  # of each event
    # kind -> (event, question, answer) share of people, NaN where nobody answered
    people: Mapping[str, FloatArray]
    world: World  # of all events

    @property
    def by_participant(self) -> bool:
        """Whether it is known, for all events that people judged, who gave which answer."""
        judged = [one for one in self.judgments if one is not None]
        return bool(judged) and all(one.responses for one in judged)

    def parts(self, kind: str) -> dict[tuple[str, ...], BoolArray]:
        """Return where the metrics have a part of the answers -> which of (event, question) it is.

        The whole comes first, at (), then :func:`parts_of` the world.
        """
        paths = parts_of(self.world, kind)
        place = self.scenario[:, None] if self.world == PHASE else np.arange(len(paths))[None]
        return {(): np.ones((1, 1), bool), **{path: place == i for i, path in enumerate(paths)}}


@dataclasses.dataclass(frozen=True, eq=False)
class Said:
    """What a model says about the events."""

    # kind -> (event, question) 1 where the answer is true, 0 where not, NaN unknown
    right: Mapping[str, FloatArray]
    # (event, agent) likewise whether the true goal is among the three most probable answers and has
    # a probability above 0
    in_top: FloatArray
    # kind -> (event, question, answer), NaN where none are given
    probabilities: Mapping[str, FloatArray]
    # kind -> (event, question) probability of the answer given, which need not be the most probable
    sure: Mapping[str, FloatArray]
    scenario: IntArray  # (event,) index of the scenario of both goals answered, -1 where unknown
    # kind -> (event, question) 1 where a posterior is sure that its answer leads, 0 where not, else
    # NaN; and (event, 1) likewise whether all of the event is decided
    leads: Mapping[str, FloatArray]
    decided: FloatArray

    def where_known(self, other: Said) -> Said:
        """Return it without what is unknown of ``other``."""

        def common(mine: FloatArray, theirs: FloatArray) -> FloatArray:
            return np.where(np.isnan(theirs), np.nan, mine)

        return dataclasses.replace(
            self,
            right={kind: common(mine, other.right[kind]) for kind, mine in self.right.items()},
            in_top=common(self.in_top, other.in_top),
            probabilities={
                kind: common(mine, other.probabilities[kind])
                for kind, mine in self.probabilities.items()
            },
        )

    def content(self) -> bytes:
        """Return its entries but for scenarios, as a key."""
        arrays = [*self.right.values(), self.in_top, *self.probabilities.values()]
        return b"".join(array.tobytes() for array in arrays)


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


def facts(events: Sequence[Event]) -> Facts:
    """Collect what is known about the events."""
    judgments = [Judgments.of(event) for event in events]
    world = world_of(events)
    return Facts(
        ids=tuple(event.id for event in events),
        truth=_places([true_answers(event) for event in events], world),
        scenario=_scenarios(map(true_scenario, events)),
        judgments=judgments,
        people=_distributions(
            [{q: one.distribution(q) for q in one.counts} if one else None for one in judgments],
            world,
        ),
        world=world,
    )


def said(known: Facts, predictions: Mapping[str, Prediction]) -> Said:
    """Collect what the predictions say about the events, each of which has one."""
    made = [predictions[name] for name in known.ids]
    answered = _places([one.answers for one in made], known.world)
    probabilities = _distributions([one.probabilities for one in made], known.world)
    return Said(
        right={
            kind: np.where((true < 0) | (answered[kind] < 0), np.nan, true == answered[kind])
            for kind, true in known.truth.items()
        },
        in_top=_in_top(probabilities["goal"], known.truth["goal"]),
        probabilities=probabilities,
        sure={kind: at_truth(probabilities[kind], given) for kind, given in answered.items()},
        scenario=_scenarios(one.scenario for one in made),
        leads={  # None is NaN
            kind: np.array(
                [[one.sure.get(q) for q in questions] for one in made], np.float64
            ).reshape(len(made), len(questions))
            for kind, questions in kinds_of(known.world).items()
        },
        decided=np.array([one.decided for one in made], np.float64)[:, None],
    )


def true_answers(event: Event) -> dict[str, str]:
    """Return question -> true answer; empty where the event has no truth."""
    truth = event.truth
    if truth is None:
        return {}
    if not isinstance(truth, Roles):
        return {question: str(getattr(truth, question)) for question in QUESTIONS}
    goals = zip(kinds_of(truth.world)["goal"], truth.goals.values(), strict=True)
    pairs = pairs_of(truth.world).items()
    return dict(goals) | {q: truth.relation_between(*pair) for q, pair in pairs}


def true_scenario(event: Event) -> str | None:
    """Return the true scenario; None where it is unknown, as in other worlds than PHASE."""
    known = event.truth is not None and not isinstance(event.truth, Roles)
    return event.truth.scenario if known else None


def at_truth(values: FloatArray, truth: IntArray) -> FloatArray:
    """Return (event, question) the values (event, question, answer) of true answers, else NaN."""
    of_truth = np.take_along_axis(values, np.maximum(truth, 0)[..., None], axis=-1)[..., 0]
    return np.where(truth < 0, np.nan, of_truth)


def _scenarios(names: Iterable[str | None]) -> IntArray:
    """Return (event,) the indices of scenarios, -1 where there is none."""
    return np.array([-1 if name is None else SCENARIOS.index(name) for name in names], np.int64)


def _in_top(probabilities: FloatArray, truth: IntArray) -> FloatArray:
    """Return ``in_top`` of :class:`Said`."""
    of_truth = at_truth(probabilities, truth)
    # of equals, the first in label order is the more probable
    before = np.arange(probabilities.shape[-1]) < truth[..., None]
    more = probabilities > of_truth[..., None]
    equal = probabilities == of_truth[..., None]
    # of the answers that a sampler never met, the first in label order are no better than others
    found = ((more | (equal & before)).sum(axis=-1) < TOP) & (of_truth > 0)
    return np.where(np.isnan(of_truth), np.nan, found)


def _places(given: Sequence[Mapping[str, str]], world: World) -> dict[str, IntArray]:
    """Return kind -> (event, question) index of the answer, -1 where there is none."""
    found = {}
    for kind, questions in kinds_of(world).items():
        rows = [
            [questions_of(world)[q].index(one[q]) if q in one else -1 for q in questions]
            for one in given
        ]
        found[kind] = np.array(rows, np.int64).reshape(len(given), len(questions))
    return found


def _distributions(
    given: Sequence[Mapping[str, FloatArray | None] | Mapping[str, FloatArray] | None], world: World
) -> dict[str, FloatArray]:
    """Return kind -> (event, question, answer) from question -> distribution per event."""
    arrays = {}
    for kind, questions in kinds_of(world).items():
        n_answers = len(questions_of(world)[questions[0]]) if questions else len(RELATIONS)
        values = np.full((len(given), len(questions), n_answers), np.nan)
        for event, of_event in enumerate(given):
            for place, question in enumerate(questions):
                if of_event is not None and question in of_event:
                    values[event, place] = of_event[question]
        arrays[kind] = values
    return arrays
