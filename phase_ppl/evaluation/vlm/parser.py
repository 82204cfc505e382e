"""From the text of an answer to probabilities, or one line that says why not.

Only what has one meaning is repaired, and every repair is noted; anything else is refused.
Repaired are: a code fence around the object, case and spaces in names, keys that were not asked
for, and sums that miss 1 by no more than ten numbers of two decimals can (0.05).
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from phase_ppl.dataset.documents import parse_text
from phase_ppl.evaluation.prediction import QUESTIONS, FloatArray
from phase_ppl.evaluation.vlm.prompt import N_NAMED
from phase_ppl.world.errors import AnswerError, InvalidEventError, shown, unknown_name

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
