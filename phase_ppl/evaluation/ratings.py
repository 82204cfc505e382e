"""People's ratings of one event and, if known, who gave them."""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Final, TypeAlias, cast

import msgspec
import numpy as np

from phase_ppl.data.documents import converted, in_front
from phase_ppl.evaluation.prediction import (
    checked_answer,
    labels_of,
    per_agent,
    questions_of,
)
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.scene import PHASE, World

MAX_RATINGS: Final = 10**9 - 1  # most ratings on one question of one event
_WITHOUT_RATINGS: Final = ("n_raters", "majority")
"""What may be all that is known of people: the authors' pickles have the majority only."""

_SUM_TOLERANCE: Final = 1e-3  # of the shares of a graded answer

_People = Annotated[int, msgspec.Meta(ge=0, le=MAX_RATINGS)]
_Votes = dict[str, dict[str, _People] | None]
_Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
_Seconds = Annotated[float, msgspec.Meta(ge=0)]

Given: TypeAlias = str | Mapping[str, float]
"""An answer: a label, or of a graded one label -> share, sum 1."""

Rows: TypeAlias = Mapping[str, Mapping[str, Given]]
"""Participant -> question -> answer."""


class _Record(msgspec.Struct):
    """What is read of the judgments of an event file."""

    counts: _Votes | None = None
    relation_counts: dict[str, _People] | None = None
    goal_counts: _Votes | None = None
    responses: list[dict[str, str | _Seconds | dict[str, _Share] | None]] | None = None
    rehearsal: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Judgments:
    """People's judgments of one event. What nobody answered is absent.

    Attributes:
        counts: question -> (label,) number of people who gave each answer, in the order of
            :func:`phase_ppl.questions_of`. A graded answer, such as a slider for every label, is
            divided among the labels and sums to 1. Only judgments of the whole film are counted.
        responses: participant -> question -> answer about the whole film: a label or, if graded,
            label -> share. Empty if only counts are known.
        world: world of the event; it has the questions and their answers.
        moments: seconds of the film -> judgments of people who had seen the film until then, in
            order.
        rehearsal: whether the judgments are marked as those of scripted participants.
        SCRIPTED: beginning of the names of scripted participants, in all files.
    """

    SCRIPTED: ClassVar = "scripted-"

    counts: Mapping[str, IntArray | FloatArray]
    responses: Rows = dataclasses.field(default_factory=dict)
    world: World = PHASE
    moments: Mapping[float, Judgments] = dataclasses.field(default_factory=dict)
    rehearsal: bool = False

    @property
    def scripted(self) -> bool:
        """Whether participants were scripted, by the mark ``rehearsal`` or a name."""
        rows = (self.responses, *(one.responses for one in self.moments.values()))
        named = any(who.startswith(self.SCRIPTED) for of in rows for who in of)
        return self.rehearsal or named

    def distribution(self, question: str) -> FloatArray | None:
        """Return (label,) the share of each answer (paper, Appendix 5); None: nobody answered."""
        if question not in self.counts:
            return None
        ratings = self.counts[question]
        return ratings / ratings.sum()

    @classmethod
    def of(cls, event: Event) -> Judgments | None:
        """Return the judgments that an event carries; None: nobody judged it.

        Raises:
            InvalidEventError, UnknownNameError: the judgments cannot be read, as for
                :meth:`from_record`; the message names the event.
        """
        if event.judgments is None:
            return None
        with in_front(f"event {event.id}: judgments: "):
            return cls.from_record(event.judgments, event.scene.world)

    @classmethod
    def of_responses(
        cls,
        responses: Rows,
        world: World = PHASE,
        moments: Mapping[float, Rows] = MappingProxyType({}),
    ) -> Judgments:
        """Return judgments, counted from who gave which answer.

        Args:
            responses: participant -> question -> answer about the whole film: a label or label ->
                share.
            world: world of the event.
            moments: seconds of the film -> responses (as above) of people who had seen it until
                then.

        Raises:
            UnknownNameError: there is no such question or answer.
            InvalidEventError: the shares of a graded answer are no numbers from 0 to 1, or do not
                sum to 1.
        """
        given = {
            who: {question: _checked(question, one, world) for question, one in row.items()}
            for who, row in responses.items()
            if row
        }
        counts = {}
        for question, labels in questions_of(world).items():
            said = [row[question] for row in given.values() if question in row]
            if said:
                counts[question] = np.sum([votes_for(one, labels) for one in said], axis=0)
        later = {at: cls.of_responses(moments[at], world) for at in sorted(moments)}
        return cls(counts, given, world, {at: one for at, one in later.items() if one.counts})

    @classmethod
    def from_record(cls, record: Mapping[str, Any], world: World = PHASE) -> Judgments | None:
        """Read the ``judgments`` of an event file; None: nobody judged.

        Args:
            record: a mapping with at least one of the fields below, or empty. Fields with other
                names, such as ``majority``, are not read. Goals are effective goals.

                * ``counts``: question -> answer -> number of people; answers of nobody may be left
                  out.
                * ``relation_counts``: relation -> number of people. ``goal_counts``: agent -> goal
                  -> number of people. They may stand for ``counts``.
                * ``responses``: a list of mappings, with ``participant`` and question -> a label or
                  label -> share. With ``at``, seconds of the film, a response is about the film
                  until then, and ``counts`` does not include it.
                * ``rehearsal``: true if people were scripted; it does not suffice alone.
            world: world of the event.

        Raises:
            InvalidEventError: a number of people is negative or not whole; responses contradict the
                counts; or ``record`` has fields, but none that holds ratings.
            UnknownNameError: there is no such agent, goal, relation or question.
        """
        known = _Record.__struct_fields__[:4]
        if record and not any(name in record for name in (*known, *_WITHOUT_RATINGS)):
            raise InvalidEventError(
                f"has {shown(sorted(map(str, record)))}, expected one of {', '.join(known)}"
            )
        given = converted(dict(record), _Record)
        votes = {**(given.counts or {}), **per_agent("goal_counts", given.goal_counts, world)}
        votes |= {} if given.relation_counts is None else {"relation": given.relation_counts}
        counts = {}
        for question, of_question in votes.items():
            labels = labels_of(question, world)
            values = np.zeros(len(labels), np.int64)
            for answer, n in (of_question or {}).items():
                values[labels.index(checked_answer(question, answer, world))] += n
            if values.sum() > MAX_RATINGS:
                raise InvalidEventError(f"{question} has more than {MAX_RATINGS} votes")
            if values.any():
                counts[question] = values
        found = cls(counts, world=world)
        if given.responses is not None:
            rows = _by_participant(given.responses)
            of_whole = rows.pop(None, None)
            found = cls.of_responses(of_whole or {}, world, cast("Any", rows))
            if rows and of_whole is None:  # who judged the whole film is unknown
                found = dataclasses.replace(found, counts=counts)
            graded = {q for q, of_question in found.counts.items() if of_question.dtype == float}
            for question, values in counts.items():
                if question not in graded and not np.array_equal(
                    values, found.counts.get(question, ())
                ):
                    raise InvalidEventError(f"the counts of {question} contradict the responses")
        found = dataclasses.replace(found, rehearsal=given.rehearsal)
        return found if found.counts or found.moments else None

    def to_record(self) -> dict[str, Any]:
        """Return the judgments as plain data, fit for JSON; :meth:`from_record` gives them back."""
        labels = questions_of(self.world)
        whole = {q: ratings for q, ratings in self.counts.items() if ratings.dtype != float}
        given = {
            question: {a: n for a, n in zip(labels[question], ratings.tolist(), strict=True) if n}
            for question, ratings in whole.items()
        }
        rows = [
            {"participant": who, **({} if at is None else {"at": at}), **row}
            for at, one in [(None, self), *self.moments.items()]
            for who, row in one.responses.items()
        ]
        return {
            "counts": given,
            **({"responses": rows} if rows else {}),
            **({"rehearsal": True} if self.scripted else {}),
        }


REHEARSAL: Final = "judgments of scripted people: a rehearsal, which says nothing about people"


def rehearsed(events: Iterable[Event]) -> bool:
    """Whether judgments that events carry are those of scripted people."""
    return any(judged is not None and judged.scripted for judged in map(Judgments.of, events))


def moments_of(event: Event) -> tuple[float, ...]:
    """Return the seconds of the film at which people judged an event."""
    judged = Judgments.of(event)
    return () if judged is None else tuple(judged.moments)


def votes_for(answer: Given, labels: Sequence[str]) -> IntArray | FloatArray:
    """Return (label,) the rating of one answer, which sums to 1."""
    if isinstance(answer, str):
        return np.array([label == answer for label in labels], np.int64)
    return np.array([answer.get(label, 0.0) for label in labels])


def _checked(question: str, answer: Given, world: World) -> Given:
    """Return an answer as the labels spell it; of a graded one, those with a share."""
    if isinstance(answer, str):
        return checked_answer(question, answer, world)
    labels_of(question, world)
    if not isinstance(answer, Mapping):
        raise InvalidEventError(f"{question} is {shown(answer)}, expected an answer or its shares")
    shares = {checked_answer(question, label, world): p for label, p in answer.items() if p}
    for label, p in shares.items():
        if not isinstance(p, numbers.Real) or not 0 <= p <= 1:
            raise InvalidEventError(
                f"{question} has the share {shown(p)} of {label}, expected 0 to 1"
            )
    if abs(math.fsum(shares.values()) - 1) > _SUM_TOLERANCE:
        total = math.fsum(shares.values())
        raise InvalidEventError(f"{question} has shares of sum {total:.4g}, expected 1")
    return shares


def _by_participant(
    listed: Sequence[Mapping[str, Any]],
) -> dict[float | None, dict[str, dict[str, Given]]]:
    """Return seconds of the film (None: all of it) -> participant -> question -> answer."""
    rows: dict[float | None, dict[str, dict[str, Given]]] = {}
    for index, entry in enumerate(listed):
        with in_front(f"responses[{index}]"):
            who, at = entry.get("participant") or "", entry.get("at")
            if not (isinstance(who, str) and who.strip()):
                raise InvalidEventError(f" has the participant {shown(who)}")
            if not (at is None or (isinstance(at, float | int) and math.isfinite(at))):
                raise InvalidEventError(f" has the moment {shown(at)}, expected seconds")
        of_moment = rows.setdefault(None if at is None else float(at), {})
        if who in of_moment:
            raise InvalidEventError(f"responses names the participant {shown(who)} twice")
        of_moment[who] = {
            question: answer
            for question, answer in entry.items()
            if answer and question not in ("participant", "at")
        }
    return rows
