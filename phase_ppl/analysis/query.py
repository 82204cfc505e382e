"""Questions in words: their grammar, and what their words mean.

::

    question   = asked [ "|" event ]
    asked      = "P" event                    probability
               | "P" names                    probabilities of all values, of all combinations
               | "E" name | "sd" name         mean, standard deviation of numbers
               | "median" name                of numbers
               | "hdi" [ share ] name         shortest interval with this share, 0.9 or 90%
               | "mode" name                  most probable value
               | "top" [ number ] name        the most probable values
               | "H" names                    entropy, nats
               | "I" name ";" name            mutual information, nats
    names      = name { "," name }
    event      = either { "," either }        all of them hold
    either     = both { "or" both }
    both       = single { "and" single }
    single     = "not" single | "(" event ")" | condition
    condition  = name ( "=" | "!=" ) ( value | name )
               | name ( "<" | "<=" | ">" | ">=" ) ( number | name )
               | name "in" "{" value { "," value } "}"                 any of them
               | name "in" "[" number "," number "]"                   ends included

What follows the first word may stand in round or square brackets: ``P(relation=friendly)``,
``E[strength_red | relation=friendly]``, ``top 3 goal_red``. "|" reads "given". Two quantities are
compared by what they are called, as in ``P(strength_red > strength_green)`` or ``P(target_red =
target_green)``. A comma reads "and" and binds the least: ``P(a=x or b=y, c=z)`` is of (a=x or b=y)
and c=z. Values are written as they are, ``goal_red = Get blue item to red lm``, in any case and
spacing; with quotes, single or double, where they hold one of ``, | = < > ! ( ) [ ] { }``, a quote,
or the word "and" or "or". ``alpha=(1, 0)`` needs none. A quantity's name may be quoted too.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple, NoReturn, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.quantities import Quantity
from phase_ppl.world.errors import QueryError, UnknownNameError, shown, unknown_name

T = TypeVar("T")

QUESTIONS: Final = ("P", "E", "sd", "median", "H", "I", "mode", "top", "hdi")
"""What can be asked; ``top`` and ``hdi`` may be followed by a number."""

LONGEST: Final = 10_000  # characters of a question, at most
_WORD: Final = re.compile(r"[^\W\d]\w*")
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_OPERATOR: Final = re.compile(r"!=|<=|>=|=|<|>|in(?!\w)")
_BARE: Final = re.compile(r"""[^,|()\[\]{}=<>!"']*""")
_JOINING: Final = re.compile(r"\s(?:and|or)(?![^\s(])", re.IGNORECASE)
"""What ends a value that is not quoted."""

_CLOSING: Final = {"(": ")", "[": "]", "{": "}"}
_DEEPEST: Final = 50  # brackets and "not" within each other

_COMPARED: Final[Mapping[str, Callable[[Any, Any], Any]]] = {
    **{"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge},
    **{"=": operator.eq, "!=": operator.ne},
}


class Word(NamedTuple):
    """A piece of the question, and the index of its first character."""

    text: str
    at: int


class Condition(NamedTuple):
    """What a quantity is to be.

    Labels after =, != and "in"; one number after <, two in [ ]; or the other quantity, which
    after = and != is a label until it is known what there is.
    """

    name: Word
    operator: Word
    labels: tuple[Word, ...] = ()
    numbers: tuple[float, ...] = ()
    other: Word | None = None


class Junction(NamedTuple):
    """Statements of which all hold, or any, or one that does not."""

    kind: Literal["and", "or", "not"]
    parts: tuple[Statement, ...]


Statement: TypeAlias = Condition | Junction


class Query(NamedTuple):
    """What is asked, one of :data:`QUESTIONS`: of quantities by name, or for P of an event.

    The number is that of ``top`` and ``hdi``, a share for ``hdi``; None: the default. Of an event
    and of what is given all statements hold.
    """

    question: str
    number: float | None
    names: tuple[Word, ...]
    event: tuple[Statement, ...]
    given: tuple[Statement, ...]
    given_at: int


Columns: TypeAlias = Mapping[str, NDArray[Any]]  # quantity -> (row,) codes or numbers


class Clause(NamedTuple):
    """A statement that can be looked up, and the quantity that it alone is about, if it is."""

    holds: Callable[[Columns], NDArray[np.bool_]]
    quantity: str | None = None


class Conditions(NamedTuple):
    """What a text says of hypotheses: all clauses hold."""

    text: str
    clauses: tuple[Clause, ...]

    def holds(self, columns: Columns) -> NDArray[np.bool_]:
        """Return (row,) whether they hold."""
        return np.logical_and.reduce([clause.holds(columns) for clause in self.clauses])


def understood(
    text: str, quantities: Mapping[str, Quantity]
) -> tuple[Query, Conditions | None, Conditions | None]:
    """Return what ``text`` asks, its event and what is given, None where there is none."""
    reader = _Reader(text, quantities)
    query = reader.query()
    for place, name in enumerate(query.names):
        reader.check_asked(query.question, name, query.names[:place])
    event, given = (reader.meaning(part) if part else None for part in (query.event, query.given))
    return query, event, given


def conditions(quantities: Mapping[str, Quantity], text: str) -> Conditions:
    """Return what a text such as ``"relation=friendly or strength_red > 400"`` says."""
    reader = _Reader(text, quantities)
    return reader.meaning(reader.event_alone())


class _Reader:
    """Reads a text, and says what its words mean given the quantities that there are."""

    def __init__(self, text: str, quantities: Mapping[str, Quantity]) -> None:
        if not isinstance(text, str):
            raise QueryError(f"a question is text, not {shown(text)}", "", 0)
        if len(text) > LONGEST:
            reason = f"a question of {len(text)} characters is too long: at most {LONGEST}"
            raise QueryError(reason, text, LONGEST)
        self._text = text
        self._quantities = quantities
        self._at = 0
        self._depth = 0

    # --- the grammar ---------------------------------------------------------------------------

    def query(self) -> Query:
        question = self._question()
        number = self._share_or_count(question)
        closing = next((_CLOSING[sign] for sign in _CLOSING if self._take(sign)), None)
        event: tuple[Statement, ...] = ()
        if question == "P":
            names, event = self._names_or_event()
        elif question == "H":
            names = self._listed(self._name)
        else:
            names = (self._name(),)
        if question == "I":
            self._expect(";", "';' and another quantity, as in I(goal_red; goal_green)")
            names = (*names, self._name())
        bar = self._take("|")
        given_at = self._skip()
        given = self._listed(self._either) if bar else ()
        self._end(closing, bar, lists=bool(given) or question in ("P", "H"))
        return Query(question, number, names, event, given, given_at)

    def _question(self) -> str:
        start = self._skip()
        word = self._match(_WORD)
        for question in QUESTIONS:
            if word.lower() == question.lower():
                return question
        self._at = start
        self._expected(f"one of {', '.join(QUESTIONS)}, as in P(goal_red)")

    def _share_or_count(self, question: str) -> float | None:
        start = self._skip()
        if question not in ("top", "hdi") or not _NUMBER.match(self._text, start):
            return None
        number = self._number("a number")
        if question == "top" and number.is_integer() and number >= 1:
            return int(number)
        if question == "top":
            self._expected("a whole number from 1, as in top 3 goal_red", start)
        if self._take("%"):
            number /= 100
        if not 0 < number <= 1:
            self._expected("a share in (0, 1] or percent, as in hdi 94% strength_red", start)
        return number

    def event_alone(self) -> tuple[Statement, ...]:
        found = self._listed(self._either)
        if self._skip() < len(self._text):
            self._expected("',', 'and', 'or' or the end")
        return found

    def _names_or_event(self) -> tuple[tuple[Word, ...], tuple[Statement, ...]]:
        start = self._skip()
        is_event = self._word("not") or self._take("(")
        if not is_event:
            self._name()
            is_event = _OPERATOR.match(self._text, self._skip()) is not None
        self._at = start
        if is_event:
            return (), self._listed(self._either)
        names = self._listed(self._name)
        if _OPERATOR.match(self._text, self._skip()):
            self._expected("names only or conditions only; what is given comes after '|'")
        return names, ()

    def _either(self) -> Statement:
        return self._joined("or", lambda: self._joined("and", self._single))

    def _joined(self, kind: Literal["and", "or"], one: Callable[[], Statement]) -> Statement:
        found = [one()]
        while self._word(kind):
            found.append(one())
        return found[0] if len(found) == 1 else Junction(kind, tuple(found))

    def _single(self) -> Statement:
        start = self._skip()
        negated = self._word("not")
        if not negated and not self._take("("):
            return self._condition()
        self._depth += 1
        if self._depth > _DEEPEST:
            self._expected(f"at most {_DEEPEST} brackets and 'not' within each other", start)
        if negated:
            found: Statement = Junction("not", (self._single(),))
        else:
            parts = self._listed(self._either)
            self._expect(")", "',' or ')'")
            found = parts[0] if len(parts) == 1 else Junction("and", parts)
        self._depth -= 1
        return found

    def _listed(self, one: Callable[[], T]) -> tuple[T, ...]:
        found = [one()]
        while self._take(","):
            found.append(one())
        return tuple(found)

    def _condition(self) -> Condition:
        name = self._name()
        start = self._skip()
        sign = self._match(_OPERATOR)
        how = Word(sign, start)
        if sign in ("=", "!="):
            return Condition(name, how, labels=(self._label(name.text, joined=True),))
        if sign == "in":
            if self._take("{"):
                labels = self._listed(lambda: self._label(name.text))
                self._expect("}", "',' or '}'")
                return Condition(name, how, labels=labels)
            if self._take("["):
                return Condition(name, how, numbers=self._interval())
            self._expected("{ and labels, or [ and an interval's ends, after 'in'")
        if sign:
            place = self._skip()
            if _WORD.match(self._text, place) or self._text.startswith(("'", '"'), place):
                return Condition(name, how, other=self._name())
            number = self._number("a number, or the name of a quantity")
            return Condition(name, how, numbers=(number,))
        before = self._text[: name.at].split()[-1:]
        hint = f"; one of several values: in {{a, {name.text}}}" if before == ["or"] else ""
        self._expected(f"=, !=, <, <=, >, >= or in after {shown(name.text)}{hint}")

    def _interval(self) -> tuple[float, float]:
        start = self._skip()
        low = self._number("a number, the lower end")
        self._expect(",", "',' and the upper end")
        high = self._number("a number, the upper end")
        self._expect("]", "']'")
        if not low <= high:
            self._expected("an interval whose lower end comes first", start)
        return low, high

    def _end(self, closing: str | None, given: bool, lists: bool) -> None:
        closed = closing is not None and self._take(closing)
        if (closed or closing is None) and self._skip() == len(self._text):
            return
        expected = [] if closed else ["','"] * lists + ["'|'"] * (not given)
        expected.append("the end" if closing is None or closed else f"'{closing}'")
        self._expected(" or ".join(expected))

    # --- words ---------------------------------------------------------------------------------

    def _name(self) -> Word:
        start = self._skip()
        if (quoted := self._quoted()) is not None:
            return quoted
        if word := self._match(_WORD):
            return Word(word, start)
        self._expected("the name of a quantity, such as goal_red")

    def _label(self, name: str, joined: bool = False) -> Word:
        """Read a label: quoted, a pair such as (1, 0), or words up to the next sign.

        Where it may be ``joined`` to other conditions, up to the next "and" or "or" too.
        """
        start = self._skip()
        if (quoted := self._quoted()) is not None:
            return quoted
        if self._take("("):
            self._match(_BARE)
            while self._take(","):
                self._match(_BARE)
            self._expect(")", "')'")
        else:
            self._match(_BARE)
            if joined and (end := _JOINING.search(self._text, start - 1, self._at)):
                self._at = end.start()
        text = self._text[start : self._at].strip()
        if not text:
            self._expected(f"a value of {shown(name)}", start)
        return Word(text, start)

    def _quoted(self) -> Word | None:
        start = self._at
        for quote in "\"'":
            if self._take(quote):
                end = self._text.find(quote, self._at)
                if end < 0:
                    self._expected(f"a closing {quote}", len(self._text))
                text, self._at = self._text[self._at : end], end + 1
                return Word(text, start)
        return None

    def _number(self, what: str) -> float:
        self._skip()
        text = self._match(_NUMBER)
        if not text:
            self._expected(what)
        number = float(text)
        if not math.isfinite(number):
            self._expected("a finite number", self._at - len(text))
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

    def _word(self, word: str) -> bool:
        """Take a word in any case, if it comes next."""
        start = self._skip()
        if self._match(_WORD).lower() == word:
            return True
        self._at = start
        return False

    def _take(self, sign: str) -> bool:
        self._skip()
        if not self._text.startswith(sign, self._at):
            return False
        self._at += len(sign)
        return True

    def _expect(self, sign: str, what: str) -> None:
        if not self._take(sign):
            self._expected(what)

    def _expected(self, what: str, at: int | None = None) -> NoReturn:
        self._fail(f"expected {what}", self._skip() if at is None else at)

    def _fail(self, reason: str, at: int) -> NoReturn:
        raise QueryError(reason, self._text, at)

    # --- what words mean ---------------------------------------------------------------------

    def _quantity(self, name: Word) -> Quantity:
        if name.text not in self._quantities:
            self._fail(str(unknown_name("quantity", name.text, self._quantities)), name.at)
        return self._quantities[name.text]

    def check_asked(self, question: str, name: Word, before: Sequence[Word]) -> None:
        """Raise QueryError if ``name`` cannot be asked for in this way."""
        quantity, (text, at) = self._quantity(name), name
        if quantity.labels is None and question in ("P", "H", "I", "mode", "top"):
            self._fail(
                f"{text} is a real number without categories; ask for E, sd or hdi, or for "
                f"the probability of an interval: P({text} in [low, high])",
                at,
            )
        if not quantity.numeric and question in ("E", "sd", "median", "hdi"):
            self._fail(f"{text} has categories, not numbers; ask for P, mode or top", at)
        if text in [word.text for word in before]:
            self._fail(f"{text} is named twice: expected different quantities", at)

    def meaning(self, events: Sequence[Statement]) -> Conditions:
        """Return what is said of hypotheses; QueryError if nothing can fulfil it."""
        clauses: list[Clause] = []
        said: dict[str, list[Condition]] = {}
        for event in _all_of(events):
            clauses.append(self._clause(event))
            if isinstance(event, Junction) or self._other(event) is not None:
                continue
            name = event.name.text
            said.setdefault(name, []).append(event)
            if not self._can_be(said[name]):
                reason = f"no value of {name} fulfils this and what is said before"
                self._fail(reason, event.name.at)
        return Conditions(self._text, tuple(clauses))

    def _can_be(self, said: Sequence[Condition]) -> bool:
        """Return whether any value of a quantity fulfils all conditions on it."""
        quantity = self._quantities[said[0].name.text]
        if quantity.labels is None:  # at an end, or right beside one
            ends = np.array([number for one in said for number in one.numbers])
            values = np.concatenate([np.nextafter(ends, way) for way in (-np.inf, ends, np.inf)])
        else:
            values = np.arange(len(quantity.labels))
        fulfilled = [self._simple(one)(values) for one in said]
        return bool(np.logical_and.reduce(fulfilled).any())

    def _clause(self, event: Statement) -> Clause:
        if isinstance(event, Junction):
            parts = [self._clause(part).holds for part in event.parts]
            if event.kind == "not":
                return Clause(lambda columns: ~parts[0](columns))
            join = np.logical_and if event.kind == "and" else np.logical_or
            return Clause(lambda columns: join.reduce([part(columns) for part in parts]))
        quantity = self._quantity(event.name)
        if (other := self._other(event)) is not None:
            return Clause(self._comparison(quantity, other, event))
        wanted = self._simple(event)
        return Clause(lambda columns: wanted(columns[quantity.name]), quantity.name)

    def _other(self, condition: Condition) -> Quantity | None:
        """Return the quantity that another one is compared with; None: it is with values."""
        if condition.other is not None:
            return self._quantity(condition.other)
        if condition.operator.text not in ("=", "!="):
            return None
        (label,) = condition.labels
        is_value = label.text in (self._quantity(condition.name).labels or ())
        is_value |= self._text[label.at] in "\"'"
        return None if is_value else self._quantities.get(label.text)

    def _comparison(
        self, first: Quantity, second: Quantity, condition: Condition
    ) -> Callable[[Columns], NDArray[np.bool_]]:
        (sign, at), one, other = condition.operator, first.name, second.name
        compare = _COMPARED[sign]
        if sign in ("=", "!="):
            if first.labels is None or second.labels is None:
                real = one if first.labels is None else other
                self._fail(f"{real} is a real number: expected <, <=, >, >= to compare it", at)
            codes = {label: code for code, label in enumerate(first.labels)}
            same = np.array([codes.get(label, -1) for label in second.labels])
            if (same < 0).all():
                self._fail(f"{one} and {other} have no value in common", at)
            return lambda columns: compare(columns[one], same[columns[other]])
        for quantity in (first, second):
            if not quantity.numeric:
                self._fail(f"{quantity.name} has categories, not numbers: expected = or !=", at)
        return lambda columns: compare(first.numbers(columns[one]), second.numbers(columns[other]))

    def _simple(self, condition: Condition) -> Callable[[NDArray[Any]], NDArray[np.bool_]]:
        """Return what a condition on a single quantity asks of its codes or numbers."""
        quantity, (sign, at) = self._quantity(condition.name), condition.operator
        name, ends, codes = quantity.name, condition.numbers, []
        if not ends and quantity.labels is None:
            self._fail(f"{name} is a real number: expected <, <=, >, >= or in [low, high]", at)
        if ends and not quantity.numeric:
            self._fail(f"{name} has categories, not numbers: expected =, != or in {{...}}", at)
        for label in condition.labels:
            try:
                codes.append(quantity.code(label.text))
            except UnknownNameError as error:
                self._fail(str(error), label.at)
        if not ends:
            return lambda values: np.isin(values, codes, invert=sign == "!=")
        if len(ends) == 2:
            return lambda values: quantity.satisfied(values, ends)
        return lambda values: _COMPARED[sign](quantity.numbers(values), ends[0])


def _all_of(events: Sequence[Statement]) -> Iterator[Statement]:
    """Yield what is joined by "and" one by one."""
    for event in events:
        if isinstance(event, Junction) and event.kind == "and":
            yield from _all_of(event.parts)
        else:
            yield event
