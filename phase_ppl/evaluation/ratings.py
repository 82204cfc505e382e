"""People's ratings of one event, and who gave them where that is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.data.documents import in_front, of_kind
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
_COUNTS: Final = ("counts", "relation_counts", "goal_counts")
_WITHOUT_RATINGS: Final = ("n_raters", "majority")
"""What may be all that is known of people: the authors' pickles have the majority only."""


@dataclasses.dataclass(frozen=True, eq=False)
class Judgments:
    """People's judgments of one event. What nobody answered is absent.

    Attributes:
        counts: question -> ratings for its answers, in label order.
        n_raters: people who answered at least one question.
        responses: participant -> question -> answer; empty where only counts are known.
        world: of the event; it has the questions and their answers.
    """

    counts: Mapping[str, IntArray]
    n_raters: int
    responses: Mapping[str, Mapping[str, str]] = dataclasses.field(default_factory=dict)
    world: World = PHASE

    def distribution(self, question: str) -> FloatArray | None:
        """Return the share of each answer among those given (paper, Appendix 5); None if none."""
        if question not in self.counts:
            return None
        ratings = self.counts[question]
        return ratings / ratings.sum()

    def share(self, question: str, answer: str) -> float | None:
        """Return the share of people who gave ``answer``; None where nobody answered."""
        shares = self.distribution(question)
        return (
            None if shares is None else float(shares[labels_of(question, self.world).index(answer)])
        )

    def majority(self, question: str) -> str | None:
        """Return the most frequent answer, of equals the first in label order."""
        if question not in self.counts:
            return None
        return labels_of(question, self.world)[int(self.counts[question].argmax())]

    @classmethod
    def of(cls, event: Event) -> Judgments | None:
        """Return the judgments that an event carries; None where there are none.

        Raises:
            InvalidEventError, UnknownNameError: as of :meth:`from_record`; the message names the
                event.
        """
        if event.judgments is None:
            return None
        with in_front(f"event {event.id}: judgments: "):
            return cls.from_record(event.judgments, event.scene.world)

    @classmethod
    def of_responses(
        cls, responses: Mapping[str, Mapping[str, str]], world: World = PHASE
    ) -> Judgments:
        """Count the ratings in participant -> question -> answer; who answered nothing is no rater.

        Raises:
            UnknownNameError: there is no such question or answer.
        """
        given = {
            who: {
                question: checked_answer(question, answer, world)
                for question, answer in row.items()
            }
            for who, row in responses.items()
            if row
        }
        counts = {}
        for question, labels in questions_of(world).items():
            ratings = [labels.index(row[question]) for row in given.values() if question in row]
            if ratings:
                counts[question] = np.bincount(ratings, minlength=len(labels)).astype(np.int64)
        return cls(counts, len(given), given, world)

    @classmethod
    def from_record(cls, record: Mapping[str, Any], world: World = PHASE) -> Judgments | None:
        """Read the judgments of an event file; None where nobody judged.

        Fields: ``counts`` {question: {answer: ratings}}, for which ``relation_counts`` {relation:
        ratings} and ``goal_counts`` {agent: {goal: ratings}} may stand, ``n_raters``, and
        ``responses``, a list of objects with ``participant`` and answers to the questions. All are
        optional, answers without ratings may be left out, fields of other names (such as
        ``majority``) are not read. Goals are effective goals.

        Raises:
            InvalidEventError: ratings that are negative or no whole number, more ratings than
                raters, fewer raters than ratings can come from, responses that contradict the
                counts; or the record has fields, but none of those that hold ratings.
            UnknownNameError: no such agent, goal, relation or question.
        """
        known = (*_COUNTS, "responses")
        if record and not any(name in record for name in (*known, *_WITHOUT_RATINGS)):
            raise InvalidEventError(
                f"has {shown(sorted(map(str, record)))}, expected one of {', '.join(known)}"
            )
        counts, n_raters = _counts(record, world), record.get("n_raters")
        listed = record.get("responses")
        if listed is not None:
            found = cls.of_responses(_responses(listed), world)
            for question, ratings in counts.items():
                if not np.array_equal(ratings, found.counts.get(question, ())):
                    raise InvalidEventError(f"the counts of {question} contradict the responses")
            counts = dict(found.counts)
        totals = [int(ratings.sum()) for ratings in counts.values()]
        if n_raters is not None:
            _check_raters(n_raters, totals)
        if listed is not None:
            if n_raters not in (None, found.n_raters):
                raise InvalidEventError(
                    f"n_raters is {n_raters}, but {found.n_raters} people responded"
                )
            return found if totals else None
        if not totals:
            return None
        return cls(counts, max(totals) if n_raters is None else n_raters, world=world)

    def to_record(self) -> dict[str, Any]:
        """Return it as plain data, fit for JSON; :meth:`from_record` gives it back."""
        labels = questions_of(self.world)
        given = {
            question: {a: n for a, n in zip(labels[question], ratings.tolist(), strict=True) if n}
            for question, ratings in self.counts.items()
        }
        rows = [{"participant": who, **row} for who, row in self.responses.items()]
        return {
            "n_raters": self.n_raters,
            "counts": given,
            **({"responses": rows} if rows else {}),
        }


def _counts(record: Mapping[str, Any], world: World) -> dict[str, IntArray]:
    given = dict(of_kind("counts", record.get("counts") or {}, dict))
    given |= per_agent("goal_counts", record.get("goal_counts"), world)
    if record.get("relation_counts") is not None:
        given["relation"] = record["relation_counts"]
    counts = {}
    for question, ratings in given.items():
        if ratings is not None:
            labels = labels_of(question, world)
            values = np.zeros(len(labels), np.int64)
            for answer, n in of_kind(f"the counts of {question}", ratings, dict).items():
                place = labels.index(checked_answer(question, answer, world))
                values[place] += _people(f"{question}: {answer!r}", n)
            if values.sum() > MAX_RATINGS:
                raise InvalidEventError(f"{question} has more than {MAX_RATINGS} votes")
            if values.any():
                counts[question] = values
    return counts


def _check_raters(given: object, totals: Sequence[int]) -> None:
    number = _people("n_raters", given)
    if totals and max(totals) > number:
        raise InvalidEventError(f"n_raters is {number}, but a question has {max(totals)} votes")
    if number > sum(totals):
        raise InvalidEventError(f"n_raters is {number}, but there are {sum(totals)} votes in all")


def _responses(listed: object) -> dict[str, dict[str, str]]:
    rows: dict[str, dict[str, str]] = {}
    for index, entry in enumerate(of_kind("responses", listed, list)):
        row = dict(of_kind(f"responses[{index}]", entry, dict))
        who = row.pop("participant", None)
        if not isinstance(who, str) or not who.strip():
            raise InvalidEventError(f"responses[{index}] has the participant {shown(who)}")
        if who in rows:
            raise InvalidEventError(f"responses names the participant {shown(who)} twice")
        rows[who] = {question: answer for question, answer in row.items() if answer is not None}
    return rows


def _people(name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MAX_RATINGS:
        raise InvalidEventError(f"{name} has {shown(value)}, expected a number of people")
    return value
