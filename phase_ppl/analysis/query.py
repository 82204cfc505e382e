"""Questions in words: the grammar, and which method of a posterior answers what.

::

    question   = asked [ "|" conditions ]
    asked      = "P" conditions               probability
               | "P" names                    probabilities of all values, of all combinations
               | "E" name | "sd" name         mean, standard deviation of numbers
               | "hdi" [ share ] name         shortest interval with this share, 0.9 or 90%
               | "mode" name                  most probable value
               | "top" [ number ] name        the most probable values
               | "H" names                    entropy, nats
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

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple, NoReturn

import numpy as np

from phase_ppl.analysis.hypotheses import HDI_PROBABILITY, N_TOP, Hypotheses
from phase_ppl.analysis.quantities import Quantity
from phase_ppl.world.errors import (
    InvalidSettingError,
    QueryError,
    UnknownNameError,
    shown,
    unknown_name,
)

QUESTIONS: Final = ("P", "E", "sd", "H", "mode", "top", "hdi")
"""What can be asked; ``top`` and ``hdi`` may be followed by a number."""

LONGEST: Final = 10_000
"""Characters of a question, at most."""

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


@dataclasses.dataclass(frozen=True)
class Condition:
    """What a quantity is to be.

    Attributes:
        name: of the quantity.
        operator: "=", "!=", "<", "<=", ">", ">=", or "in {" and "in [".
        labels: after "=", "!=" and "in {".
        numbers: one after "<" and its like, two after "in [".
    """

    name: Word
    operator: Word
    labels: tuple[Word, ...] = ()
    numbers: tuple[float, ...] = ()


@dataclasses.dataclass(frozen=True)
class Query:
    """What is asked.

    Attributes:
        question: one of :data:`QUESTIONS`.
        number: of ``top`` and ``hdi``, a share for ``hdi``; None: the default.
        names: quantities asked for; empty where ``event`` is.
        event: of P(event).
        given: what to condition on.
        given_at: index of the first character of ``given``.
    """

    question: str
    number: float | None
    names: tuple[Word, ...]
    event: tuple[Condition, ...]
    given: tuple[Condition, ...]
    given_at: int


def parse(text: str) -> Query:
    """Return what ``text`` asks.

    Raises:
        QueryError: it breaks the grammar; the message points at the place.
    """
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
        closing = self._bracket()
        names: tuple[Word, ...] = ()
        event: tuple[Condition, ...] = ()
        if question == "P":
            names, event = self._names_or_event()
        elif question == "H":
            names = self._names()
        else:
            names = (self._name(),)
        given: tuple[Condition, ...] = ()
        bar = self._take("|")
        given_at = self._skip()
        if bar:
            given = self._conditions(self._condition())
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

    def _bracket(self) -> str | None:
        for opening in "([":
            if self._take(opening):
                return _CLOSING[opening]
        return None

    def _names_or_event(self) -> tuple[tuple[Word, ...], tuple[Condition, ...]]:
        name = self._name()
        self._skip()
        if _OPERATOR.match(self._text, self._at):
            return (), self._conditions(self._condition(name))
        names = self._names(name)
        place = self._skip()
        if _OPERATOR.match(self._text, place):
            self._fail("names only or conditions only; what is given comes after '|'", place)
        return names, ()

    def _names(self, first: Word | None = None) -> tuple[Word, ...]:
        names = [first or self._name()]
        while self._take(","):
            names.append(self._name())
        return tuple(names)

    def _conditions(self, first: Condition) -> tuple[Condition, ...]:
        conditions = [first]
        while self._take(","):
            conditions.append(self._condition())
        return tuple(conditions)

    def _condition(self, name: Word | None = None) -> Condition:
        name = name or self._name()
        start = self._skip()
        operator = self._match(_OPERATOR)
        if operator in ("=", "!="):
            return Condition(name, Word(operator, start), labels=(self._label(name.text),))
        if operator == "in":
            if self._take("{"):
                return Condition(name, Word("in {", start), labels=self._labels(name.text))
            if self._take("["):
                return Condition(name, Word("in [", start), numbers=self._interval())
            self._fail("{ and labels, or [ and an interval's ends, after 'in'")
        if operator:
            return Condition(name, Word(operator, start), numbers=(self._number("a number"),))
        self._fail(f"=, !=, <, <=, >, >= or in after {shown(name.text)}")

    def _labels(self, name: str) -> tuple[Word, ...]:
        labels = [self._label(name)]
        while self._take(","):
            labels.append(self._label(name))
        self._expect("}", "',' or '}'")
        return tuple(labels)

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


# --- questions in words: the grammar, and which method of a posterior answers what ----------------
# ::
#
# question = asked [ "|" conditions ] asked = "P" conditions probability | "P" names probabilities
# of all values, of all combinations | "E" name | "sd" name mean, standard deviation of numbers |
# "hdi" [ share ] name shortest interval with this share, 0.9 or 90% | "mode" name most probable
# value | "top" [ number ] name the most probable values | "H" names entropy, nats names = name {
# "," name } conditions = condition { "," condition } all of them hold condition = name "=" value
# | name "!=" value | name "in" "{" value { "," value } "}" any of them | name "in" "[" number ","
# number "]" ends included | name ( "<" | "<=" | ">" | ">=" ) number
#
# What follows the first word may stand in round or square brackets: ``P(relation=friendly)``,
# ``E[strength_red | relation=friendly]``, ``top 3 goal_red``. "|" reads "given". Values are
# written as they are, ``goal_red = Get blue item to red lm``, in any case and spacing; with
# quotes, single or double, where they hold one of ``, | = < > ! ( ) [ ] { }`` or a quote.
# ``alpha=(1, 0)`` needs none. A quantity's name may be quoted too.


def answer(post: Hypotheses, quantities: Mapping[str, Quantity], text: str) -> Any:
    """Return the answer of ``post`` to the question ``text``.

    ============================ =======================================================
    P(conditions)                :meth:`Hypotheses.probability`, a number
    P(name), P(name, name)       :meth:`Hypotheses.marginal`, :meth:`Hypotheses.joint`
    E, sd, H                     :meth:`Hypotheses.mean`, :meth:`~.sd`, :meth:`~.entropy`
    mode, top, hdi               the method of this name
    ============================ =======================================================

    Args:
        post: whom to ask.
        quantities: that it has.
        text: the question.

    Raises:
        QueryError: the question breaks the grammar, names what does not exist, asks for what a
            quantity does not have, or conditions on what has probability 0.
    """
    query = parse(text)
    meaning = _Meaning(quantities, text)
    for place, name in enumerate(query.names):
        meaning.check_asked(query.question, name, query.names[:place])
    event, given = meaning.conditions(query.event), meaning.conditions(query.given)
    if given and not post.probability(**given) > 0:
        reason = f"cannot condition on this: {post.why_impossible(given)}"
        raise QueryError(reason, text, query.given_at)
    try:
        return _ask(post, query, event, given)
    except InvalidSettingError as error:  # too large a table
        raise QueryError(str(error), text, query.names[0].at) from None


def conditions(quantities: Mapping[str, Quantity], text: str) -> Mapping[str, Any]:
    """Return conditions in words, such as ``"relation=friendly"``, as quantity -> value.

    Raises:
        QueryError: they cannot be read, or name what does not exist.
    """
    question = f"P({text})"
    query = parse(question)
    if not query.event or query.given:
        reason = "expected conditions, such as relation=friendly"
        raise QueryError(reason, question, 2)
    return _Meaning(quantities, question).conditions(query.event)


def _ask(post: Hypotheses, query: Query, event: Mapping[str, Any], given: Mapping[str, Any]) -> Any:
    if event:
        return post.probability(given, **event)
    names = [name.text for name in query.names]
    if query.question == "P":
        return post.joint(*names, given=given)
    if query.question == "H":
        return post.entropy(*names, given=given)
    if query.question == "top":
        return post.top(names[0], N_TOP if query.number is None else int(query.number), given=given)
    if query.question == "hdi":
        return post.hdi(names[0], query.number or HDI_PROBABILITY, given=given)
    ask = {"E": post.mean, "sd": post.sd, "mode": post.mode}[query.question]
    return ask(names[0], given=given)


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
        if quantity.labels is None and question in ("P", "H", "mode", "top"):
            self._fail(
                f"{name.text} is a real number without categories; ask for E, sd or hdi, or for "
                f"the probability of an interval: P({name.text} in [low, high])",
                name.at,
            )
        if not quantity.numeric and question in ("E", "sd", "hdi"):
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
