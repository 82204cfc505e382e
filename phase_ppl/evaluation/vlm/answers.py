"""Answers: read strictly, and kept so that an evaluation can be repeated without asking again.

Only what has one meaning is repaired, and every repair is noted; anything else is refused. Repaired
are: a code fence around the object, case and spaces in names, keys that were not asked for, and
sums that miss 1 by no more than ten numbers of two decimals can (0.05).

Kept is one JSON file for each request and seed, ``KEY-SEED.json``, where KEY is a hash of what
determines the request::

    {
     "schema": "phase-ppl-answer-1",
     "request": {...},         client, model, address, hashes of prompt and film, settings
     "seed": 0,
     "prompt": "...",
     "film": {...},            what was drawn for it: sizes and hashes of the files
     "attempts": [             each request that was made
      {"time": "2026-01-31T12:00:00+00:00", "seconds": 21.3, "text": "...", ...},
      {"time": ..., "seconds": ..., "failure": "..."}
     ]
    }
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from phase_ppl.dataset.documents import parse_text, read_json
from phase_ppl.evaluation.prediction import QUESTIONS
from phase_ppl.evaluation.vlm.request import N_NAMED
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    AnswerError,
    InvalidEventError,
    OutputError,
    shown,
    unknown_name,
)
from phase_ppl.world.files import write_json
from phase_ppl.world.identity import differences

SCHEMA: Final = "phase-ppl-answer-1"

REMAINING: Final = ("spread", "zero")
"""What becomes of probability that an answer gives to no goal: spread evenly over the goals that it
does not name, or left out, those named being scaled to sum 1."""

_SUM_TOLERANCE: Final = 0.05
_SUM_EXACT: Final = 1e-6
_FENCE: Final = re.compile(r"```[ \t]*(?:\w+[ \t]*)?\r?\n(.*?)```", re.DOTALL)


@dataclasses.dataclass(frozen=True, eq=False)
class Parsed:
    """A readable answer.

    Attributes:
        probabilities: question -> probabilities in label order, sum 1.
        repairs: what was done to read it, a line each.
    """

    probabilities: Mapping[str, FloatArray]
    repairs: tuple[str, ...]


def parse(text: str, remaining: str = REMAINING[0]) -> Parsed:
    """Return the probabilities that an answer gives.

    Args:
        text: the answer.
        remaining: one of :data:`REMAINING`.

    Raises:
        AnswerError: it cannot be read without guessing; the message says why.
    """
    repairs: list[str] = []
    body = _without_fence(text, repairs)
    try:
        document = parse_text(body)
    except InvalidEventError as error:
        raise AnswerError(f"the answer {error}; it begins {shown(body[:60])}") from None
    answers = _asked_for(document, repairs)
    probabilities = {}
    for question, labels in QUESTIONS.items():
        shares = answers[question]
        if not isinstance(shares, Mapping):
            raise AnswerError(f"{question} is {shown(shares)}, expected names with probabilities")
        named = _named(question, shares, repairs)
        expected = N_NAMED if len(labels) > N_NAMED else len(labels)
        if len(named) != expected:
            raise AnswerError(f"{question} has {len(named)} entries, expected exactly {expected}")
        probabilities[question] = _distribution(question, named, remaining, repairs)
    return Parsed(probabilities, tuple(repairs))


def _without_fence(text: str, repairs: list[str]) -> str:
    body = text.strip()
    if not body:
        raise AnswerError("the answer is empty")
    fenced = _FENCE.findall(body)
    if not fenced:
        return body
    if len(fenced) > 1:
        raise AnswerError(f"the answer has {len(fenced)} blocks of code, expected one JSON object")
    whole = _FENCE.fullmatch(body) is not None
    repairs.append("code fence removed" if whole else "code fence and text around it removed")
    return str(fenced[0]).strip()


def _asked_for(document: Mapping[str, Any], repairs: list[str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in document.items():
        question = _same_name(key, QUESTIONS)
        if question is None:
            repairs.append(f"key {shown(key)} left out")
            continue
        _note(key, question, repairs)
        if question in found:
            raise AnswerError(f"the answer gives {question} twice")
        found[question] = value
    missing = [question for question in QUESTIONS if question not in found]
    if missing:
        given = ", ".join(shown(key) for key in document) or "nothing"
        raise AnswerError(f"the answer lacks {', '.join(missing)}; it has {given[:200]}")
    return found


def _named(question: str, shares: Mapping[str, Any], repairs: list[str]) -> dict[str, float]:
    """Return label -> probability, as given."""
    labels = QUESTIONS[question]
    what = "goal" if question.startswith("goal") else question
    found: dict[str, float] = {}
    for name, share in shares.items():
        label = _same_name(name, labels)
        if label is None:
            raise AnswerError(f"{question}: {unknown_name(what, name, labels)}")
        _note(name, label, repairs)
        if label in found:
            raise AnswerError(f"{question} gives {label!r} twice")
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0 <= share <= 1:
            raise AnswerError(
                f"{question}: {label!r} has {shown(share)}, expected a number from 0 to 1"
            )
        found[label] = float(share)
    return found


def _same_name(name: str, allowed: Iterable[str]) -> str | None:
    """Return the name that is the same but for case and spaces, if there is one."""
    wanted = " ".join(name.split()).lower()
    return next((one for one in allowed if one.lower() == wanted), None)


def _note(given: str, name: str, repairs: list[str]) -> None:
    if given != name:
        repairs.append(f"{shown(given)} read as {name!r}")


def _distribution(
    question: str, named: Mapping[str, float], remaining: str, repairs: list[str]
) -> FloatArray:
    labels = QUESTIONS[question]
    values = np.array([named.get(label, 0.0) for label in labels])
    total = float(values.sum())
    if abs(total - 1) > _SUM_TOLERANCE + _SUM_EXACT:
        raise AnswerError(f"{question} sums to {total:.4g}, expected 1")
    unnamed = np.array([label not in named for label in labels])
    if abs(total - 1) > _SUM_EXACT:
        if total < 1 and remaining == "spread" and unnamed.any():
            values[unnamed] = (1 - total) / unnamed.sum()
            repairs.append(
                f"{question} sums to {total:.4g}; the rest spread over {unnamed.sum()} goals"
            )
        else:
            repairs.append(f"{question} sums to {total:.4g}; scaled to 1")
    return np.asarray(values / values.sum())


# --- what is kept ----------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Attempt:
    """A request, made once or again by a service's library, and what came of it.

    Attributes:
        time: when it was sent, UTC, as ISO 8601.
        seconds: until it ended, the drawing of what was looked at included.
        text: of the answer, whether it can be read or not.
        failure: why there is no answer; there is either a text or a failure.
        finish, model, tokens_in, tokens_out, requests: as of
            :class:`~phase_ppl.evaluation.vlm.request.Reply`.
    """

    time: str
    seconds: float
    text: str | None = None
    failure: str | None = None
    finish: str | None = None
    model: str | None = None
    tokens_in: int | None = None
    tokens_out: int | None = None
    requests: int = 1

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, without what is not known; one request goes without saying."""
        given = dataclasses.asdict(self) | {
            "requests": self.requests if self.requests > 1 else None
        }
        return {name: value for name, value in given.items() if value is not None}

    @classmethod
    def from_dict(cls, record: Any) -> Attempt:
        """Read what :meth:`to_dict` wrote.

        Raises:
            InvalidEventError: it is something else; the message names the field.
        """
        kinds = {
            **dict.fromkeys(("time", "text", "failure", "finish", "model"), str),
            **dict.fromkeys(("tokens_in", "tokens_out", "requests"), int),
            "seconds": int | float,
        }
        given = record if isinstance(record, dict) else {}
        if not {"time", "seconds"} <= set(given) or ("text" in given) == ("failure" in given):
            raise InvalidEventError(
                f"an attempt is {shown(record)}, expected time, seconds, and text or failure"
            )
        for name, value in given.items():
            if name not in kinds or not isinstance(value, kinds[name]):
                raise InvalidEventError(f"an attempt has {name}={shown(value)}")
        return cls(**given)


class Store:
    """A folder of answers, made when the first is kept.

    Raises:
        OutputError: there is something else at ``path``.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        if self.path.exists() and not self.path.is_dir():
            raise OutputError(f"{self.path} is a file, expected a folder for answers")

    def file_of(self, request: Mapping[str, Any], seed: int) -> Path:
        """Return the file of a request, whether it is there or not."""
        text = json.dumps(request, sort_keys=True)
        return self.path / f"{hashlib.sha256(text.encode()).hexdigest()[:20]}-{seed}.json"

    def find(self, request: Mapping[str, Any], seed: int) -> dict[str, Any] | None:
        """Return the record of a request with its ``attempts``; None where there is none.

        Raises:
            InvalidEventError: the file is damaged, or of another request.
        """
        source = self.file_of(request, seed)
        if not source.exists():
            return None
        record = read_json(source)
        if record.get("schema") != SCHEMA:
            raise InvalidEventError(
                f"{source}: its schema is {shown(record.get('schema'))}, not {SCHEMA!r}"
            )
        was = record.get("request")
        found = differences(was, request) if isinstance(was, dict) else ["request is missing"]
        if found or record.get("seed") != seed:
            words = "; ".join(found) or f"seed is {seed}, was {shown(record.get('seed'))}"
            raise InvalidEventError(f"{source}: is the answer to another request: {words}")
        attempts = record.get("attempts")
        if not isinstance(attempts, list):
            raise InvalidEventError(f"{source}: attempts is {shown(attempts)}, expected a list")
        try:
            return {**record, "attempts": [Attempt.from_dict(each) for each in attempts]}
        except InvalidEventError as error:
            raise InvalidEventError(f"{source}: {error}") from None

    def knows(self, request: Mapping[str, Any]) -> bool:
        """Whether the request has been answered for any seed."""
        key = self.file_of(request, 0).name.partition("-")[0]
        return any(self.path.glob(f"{key}-*.json"))

    def keep(self, record: Mapping[str, Any]) -> None:
        """Write a record, in place of the one before.

        Raises:
            OutputError: it cannot be written.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot write into {self.path}: {error.strerror}") from None
        write_json(self.file_of(record["request"], record["seed"]), as_json(record))


def as_json(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record with its attempts as plain data, as files hold it."""
    attempts = [attempt.to_dict() for attempt in record["attempts"]]
    return {"schema": SCHEMA, **record, "attempts": attempts}
