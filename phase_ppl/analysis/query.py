"""Questions in words: their grammar, and what their words mean.

::

    question   = asked [ "|" conditions ]
    asked      = "P" conditions               probability
               | "P" names                    probabilities of all values, of all combinations
               | "E" name | "sd" name         mean, standard deviation of numbers
               | "median" name                of numbers
               | "hdi" [ share ] name         shortest interval with this share, 0.9 or 90%
               | "mode" name                  most probable value
               | "top" [ number ] name        the most probable values
               | "H" names                    entropy, nats
               | "I" name ";" name            mutual information, nats
    names      = name { "," name }
    conditions = condition { "," condition }  all of them hold
    condition  = name "=" value
               | name "!=" value
               | name "in" "{" value { "," value } "}"                 any of them
               | name "in" "[" number "," number "]"                   ends included
               | name ( "<" | "<=" | ">" | ">=" ) number

What follows the first word may stand in round or square brackets: ``P(relation=friendly)``,
``E[strength_red | relation=friendly]``, ``top 3 goal_red``. "|" reads "given". Values are written
as they are, ``goal_red = Get blue item to red lm``, in any case and spacing; with quotes, single
or double, where they hold one of ``, | = < > ! ( ) [ ] { }`` or a quote. ``alpha=(1, 0)`` needs
none. A quantity's name may be quoted too.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple, NoReturn, TypeVar

import numpy as np

from phase_ppl.analysis.quantities import Quantity
from phase_ppl.world.errors import QueryError, UnknownNameError, shown, unknown_name

T = TypeVar("T")

QUESTIONS: Final = ("P", "E", "sd", "median", "H", "I", "mode", "top", "hdi")
"""What can be asked; ``top`` and ``hdi`` may be followed by a number."""

LONGEST: Final = 10_000  # characters of a question, at most
_QUANTITY: Final = "the name of a quantity, such as goal_red"
_WORD: Final = re.compile(r"[^\W\d]\w*")
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_OPERATOR: Final = re.compile(r"!=|<=|>=|=|<|>|in(?!\w)")
_BARE: Final = re.compile(r"""[^,|()\[\]{}=<>!"']*""")
_CLOSING: Final = {"(": ")", "[": "]", "{": "}"}


class Word(NamedTuple):
    """A piece of the question, and the index of its first character."""

    text: str
    at: int


class Condition(NamedTuple):
    """What a quantity is to be: labels after =, != and "in {"; one number after <, two in [ ]."""

    name: Word
    operator: Word
    labels: tuple[Word, ...] = ()
    numbers: tuple[float, ...] = ()


class Query(NamedTuple):
    """What is asked, one of :data:`QUESTIONS`: of quantities by name, or for P of an event.

    The number is that of ``top`` and ``hdi``, a share for ``hdi``; None: the default.
    """

    question: str
    number: float | None
    names: tuple[Word, ...]
    event: tuple[Condition, ...]
    given: tuple[Condition, ...]
    given_at: int


def understood(
    text: str, quantities: Mapping[str, Quantity]
) -> tuple[Query, dict[str, Any], dict[str, Any]]:
    """Return what ``text`` asks, its event and what is given, these as quantity -> value."""
    query = _parsed(text)
    meaning = _Meaning(quantities, text)
    for place, name in enumerate(query.names):
        meaning.check_asked(query.question, name, query.names[:place])
    return query, meaning.conditions(query.event), meaning.conditions(query.given)


def conditions(quantities: Mapping[str, Quantity], text: str) -> Mapping[str, Any]:
    """Return conditions in words, such as ``"relation=friendly"``, as quantity -> value."""
    question = f"P({text})"
    query = _parsed(question)
    if not query.event or query.given:
        raise QueryError("expected conditions, such as relation=friendly", question, 2)
    return _Meaning(quantities, question).conditions(query.event)


def _parsed(text: str) -> Query:
    if not isinstance(text, str):
        raise QueryError(f"a question is text, not {shown(text)}", "", 0)
    if len(text) > LONGEST:
        raise QueryError(
            f"a question of {len(text)} characters is too long: at most {LONGEST}", text, LONGEST
        )
    return _Parser(text).query()


class _Parser:
    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0

    # --- the grammar ---------------------------------------------------------------------------

    def query(self) -> Query:
        question = self._question()
        number = self._share_or_count(question)
        closing = next((_CLOSING[sign] for sign in _CLOSING if self._take(sign)), None)
        names: tuple[Word, ...] = ()
        event: tuple[Condition, ...] = ()
        given: tuple[Condition, ...] = ()
        if question == "P":
            names, event = self._names_or_event()
        elif question == "H":
            names = self._listed(self._name)
        elif question == "I":
            first = self._name()
            self._expect(";", "';' and another quantity, as in I(goal_red; goal_green)")
            names = (first, self._name())
        else:
            names = (self._name(),)
        bar = self._take("|")
        given_at = self._skip()
        if bar:
            given = self._listed(self._condition)
        self._end(closing, bar, lists=bool(given) or question in ("P", "H"))
        return Query(question, number, names, event, given, given_at)

    def _question(self) -> str:
        start = self._skip()
        word = self._match(_WORD)
        for question in QUESTIONS:
            if word.lower() == question.lower():
                return question
        self._at = start
        self._fail(f"one of {', '.join(QUESTIONS)}, as in P(goal_red)")

    def _share_or_count(self, question: str) -> float | None:
        start = self._skip()
        if question not in ("top", "hdi") or not _NUMBER.match(self._text, start):
            return None
        number = self._number("a number")
        if question == "top":
            if not (number.is_integer() and number >= 1):
                self._fail("a whole number from 1, as in top 3 goal_red", start)
            return number
        if self._take("%"):
            number /= 100
        if not 0 < number <= 1:
            self._fail("a share in (0, 1] or percent, as in hdi 94% strength_red", start)
        return number

    def _names_or_event(self) -> tuple[tuple[Word, ...], tuple[Condition, ...]]:
        name = self._name()
        self._skip()
        if _OPERATOR.match(self._text, self._at):
            return (), self._listed(self._condition, self._condition(name))
        names = self._listed(self._name, name)
        place = self._skip()
        if _OPERATOR.match(self._text, place):
            self._fail("names only or conditions only; what is given comes after '|'", place)
        return names, ()

    def _listed(self, one: Callable[[], T], first: T | None = None) -> tuple[T, ...]:
        found = [one() if first is None else first]
        while self._take(","):
            found.append(one())
        return tuple(found)

    def _condition(self, name: Word | None = None) -> Condition:
        name = name or self._name()
        start = self._skip()
        operator = self._match(_OPERATOR)
        if operator in ("=", "!="):
            return Condition(name, Word(operator, start), labels=(self._label(name.text),))
        if operator == "in":
            if self._take("{"):
                labels = self._listed(lambda: self._label(name.text))
                self._expect("}", "',' or '}'")
                return Condition(name, Word("in {", start), labels=labels)
            if self._take("["):
                return Condition(name, Word("in [", start), numbers=self._interval())
            self._fail("{ and labels, or [ and an interval's ends, after 'in'")
        if operator:
            return Condition(name, Word(operator, start), numbers=(self._number("a number"),))
        self._fail(f"=, !=, <, <=, >, >= or in after {shown(name.text)}")

    def _interval(self) -> tuple[float, float]:
        start = self._skip()
        low = self._number("a number, the lower end")
        self._expect(",", "',' and the upper end")
        high = self._number("a number, the upper end")
        self._expect("]", "']'")
        if not low <= high:
            self._fail("an interval whose lower end comes first", start)
        return low, high

    def _end(self, closing: str | None, given: bool, lists: bool) -> None:
        done = True if closing is None else self._take(closing)
        closed = closing is not None and done
        if done and self._skip() == len(self._text):
            return
        expected = [] if closed else ["','"] * lists + ["'|'"] * (not given)
        expected.append("the end" if closing is None or closed else f"'{closing}'")
        self._fail(" or ".join(expected))

    # --- words ---------------------------------------------------------------------------------

    def _name(self) -> Word:
        start = self._skip()
        quoted = self._quoted()
        if quoted is not None:
            return quoted
        word = self._match(_WORD)
        if not word:
            self._fail(_QUANTITY)
        return Word(word, start)

    def _label(self, name: str) -> Word:
        """Read a label: quoted, a pair such as (1, 0), or words up to the next sign."""
        start = self._skip()
        quoted = self._quoted()
        if quoted is not None:
            return quoted
        if self._take("("):
            self._match(_BARE)
            while self._take(","):
                self._match(_BARE)
            self._expect(")", "')'")
        else:
            self._match(_BARE)
        text = self._text[start : self._at].strip()
        if not text:
            self._fail(f"a value of {shown(name)}", start)
        return Word(text, start)

    def _quoted(self) -> Word | None:
        start = self._at
        for quote in "\"'":
            if self._take(quote):
                end = self._text.find(quote, self._at)
                if end < 0:
                    self._fail(f"a closing {quote}", len(self._text))
                text, self._at = self._text[self._at : end], end + 1
                return Word(text, start)
        return None

    def _number(self, what: str) -> float:
        self._skip()
        text = self._match(_NUMBER)
        if not text:
            self._fail(what)
        number = float(text)
        if not math.isfinite(number):
            self._fail("a finite number", self._at - len(text))
        return number

    # --- characters ----------------------------------------------------------------------------

    def _skip(self) -> int:
        """Go past spaces, and return where the next character is."""
        while self._at < len(self._text) and self._text[self._at].isspace():
            self._at += 1
        return self._at

    def _match(self, pattern: re.Pattern[str]) -> str:
        found = pattern.match(self._text, self._at)
        if found is None:
            return ""
        self._at = found.end()
        return found.group()

    def _take(self, sign: str) -> bool:
        self._skip()
        if not self._text.startswith(sign, self._at):
            return False
        self._at += len(sign)
        return True

    def _expect(self, sign: str, what: str) -> None:
        if not self._take(sign):
            self._fail(what)

    def _fail(self, expected: str, at: int | None = None) -> NoReturn:
        place = self._skip() if at is None else at
        raise QueryError(f"expected {expected}", self._text, place)


class _Meaning:
    """What words of the question ``text`` stand for, given the quantities that there are."""

    def __init__(self, quantities: Mapping[str, Quantity], text: str) -> None:
        self._quantities = quantities
        self._text = text

    def _quantity(self, name: Word) -> Quantity:
        if name.text not in self._quantities:
            self._fail(str(unknown_name("quantity", name.text, self._quantities)), name.at)
        return self._quantities[name.text]

    def check_asked(self, question: str, name: Word, before: Sequence[Word]) -> None:
        """Raise QueryError if ``name`` cannot be asked for in this way."""
        quantity = self._quantity(name)
        if quantity.labels is None and question in ("P", "H", "I", "mode", "top"):
            self._fail(
                f"{name.text} is a real number without categories; ask for E, sd or hdi, or for "
                f"the probability of an interval: P({name.text} in [low, high])",
                name.at,
            )
        if not quantity.numeric and question in ("E", "sd", "median", "hdi"):
            self._fail(f"{name.text} has categories, not numbers; ask for P, mode or top", name.at)
        if name.text in [word.text for word in before]:
            self._fail(f"{name.text} is named twice: expected different quantities", name.at)

    def conditions(self, conditions: Sequence[Condition]) -> dict[str, Any]:
        """Return quantity -> labels or interval, what fulfils all conditions on it."""
        found: dict[str, Any] = {}
        for condition in conditions:
            name = condition.name.text
            quantity = self._quantity(condition.name)
            if quantity.labels is None:
                low, high = self._interval(condition)
                before = found.get(name, (-math.inf, math.inf))
                found[name] = (max(low, before[0]), min(high, before[1]))
                possible = found[name][0] <= found[name][1]
            else:
                labels = self._labels(quantity, condition)
                found[name] = [label for label in labels if label in found.get(name, labels)]
                possible = bool(found[name])
            if not possible:
                self._fail(
                    f"no value of {name} fulfils this and what is said before", condition.name.at
                )
        return found

    def _labels(self, quantity: Quantity, condition: Condition) -> list[str]:
        if condition.numbers:
            if not quantity.numeric:
                self._fail(
                    f"{quantity.name} has categories, not numbers: expected =, != or in {{...}}",
                    condition.operator.at,
                )
            low, high = self._interval(condition)
            numbers = quantity.numbers(np.arange(len(quantity.categories())))
            inside = (numbers >= low) & (numbers <= high)
            return [label for label, i in zip(quantity.categories(), inside, strict=True) if i]
        labels = quantity.categories()
        codes = [self._code(quantity, label) for label in condition.labels]
        if condition.operator.text == "!=":
            return [label for code, label in enumerate(labels) if code not in codes]
        return [labels[code] for code in codes]

    def _code(self, quantity: Quantity, label: Word) -> int:
        try:
            return quantity.code(label.text)
        except UnknownNameError as error:
            self._fail(str(error), label.at)

    def _interval(self, condition: Condition) -> tuple[float, float]:
        if not condition.numbers:
            self._fail(
                f"{condition.name.text} is a real number: expected <, <=, >, >= or in [low, high]",
                condition.operator.at,
            )
        ends = condition.numbers
        if len(ends) == 2:
            return ends[0], ends[1]
        number, operator = ends[0], condition.operator.text
        if operator[0] == "<":
            return -math.inf, number if operator == "<=" else math.nextafter(number, -math.inf)
        return number if operator == ">=" else math.nextafter(number, math.inf), math.inf

    def _fail(self, reason: str, at: int) -> NoReturn:
        raise QueryError(reason, self._text, at)
