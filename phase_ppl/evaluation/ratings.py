"""People's ratings of one event and, if known, who gave them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final

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

_People = Annotated[int, msgspec.Meta(ge=0, le=MAX_RATINGS)]
_Votes = dict[str, dict[str, _People] | None]


class _Record(msgspec.Struct):
    """What is read of the judgments of an event file."""

    counts: _Votes | None = None
    relation_counts: dict[str, _People] | None = None
    goal_counts: _Votes | None = None
    responses: list[dict[str, str | None]] | None = None
    n_raters: _People | None = None


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
        found = cls(counts, 0, world=world)
        if given.responses is not None:
            found = cls.of_responses(_by_participant(given.responses), world)
            for question, values in counts.items():
                if not np.array_equal(values, found.counts.get(question, ())):
                    raise InvalidEventError(f"the counts of {question} contradict the responses")
        totals, n_raters = [int(values.sum()) for values in found.counts.values()], given.n_raters
        most = max(totals, default=0)
        if n_raters is not None and not most <= n_raters <= sum(totals):
            raise InvalidEventError(
                f"n_raters is {n_raters}, but there are {most} votes on a question, {sum(totals)} "
                "in all"
            )
        if found.responses and n_raters not in (None, found.n_raters):
            raise InvalidEventError(
                f"n_raters is {n_raters}, but {found.n_raters} people responded"
            )
        if not found.responses:
            found = dataclasses.replace(found, n_raters=most if n_raters is None else n_raters)
        return found if totals else None

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


def _by_participant(listed: Sequence[Mapping[str, str | None]]) -> dict[str, dict[str, str]]:
    rows: dict[str, dict[str, str]] = {}
    for index, entry in enumerate(listed):
        who = entry.get("participant") or ""
        if not who.strip():
            raise InvalidEventError(f"responses[{index}] has the participant {shown(who)}")
        if who in rows:
            raise InvalidEventError(f"responses names the participant {shown(who)} twice")
        rows[who] = {q: answer for q, answer in entry.items() if answer and q != "participant"}
    return rows
