"""Questions in words: their grammar and meaning. Quantities of a user's own.

::

    question   = single [ "/" single ]        one number over another, with the error of both
    single     = asked [ "|" event ]
    asked      = "P" event                    probability
               | "odds" event                 P(event) / P(not event)
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
    both       = one { "and" one }
    one        = "not" one | "(" event ")" | condition
    condition  = name ( "=" | "!=" ) ( value | name )
               | name ( "<" | "<=" | ">" | ">=" ) ( number | name )
               | name "in" "{" value { "," value } "}"                 any of them
               | name "in" "[" number "," number "]"                   ends included

Text after the first word may stand in round or square brackets: ``P(relation=friendly)``,
``E[strength_red | relation=friendly]``, ``top 3 goal_red``. "|" reads "given". A ratio is of two
numbers: ``P(relation=friendly) / P(relation=adversarial)``, or of E, sd or median; conditions on
its left side need their brackets. Two quantities are compared by name: ``P(strength_red >
strength_green)`` or ``P(target_red = target_green)``. A comma reads "and" and binds the least:
``P(a=x or b=y, c=z)`` is the probability of (a=x or b=y) and c=z.

Values are written without quotes, ``goal_red = Get blue item to red lm``, in any case and spacing.
They need quotes, single or double, if they hold one of ``, | = < > ! ( ) [ ] { }``, a quote, or the
word "and" or "or". ``alpha=(1, 0)`` needs none. A quantity's name may be quoted too.
"""

from __future__ import annotations

import itertools
import keyword
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, NamedTuple, NoReturn, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.quantities import Quantity
from phase_ppl.world.arrays import equal_rows
from phase_ppl.world.errors import (
    InvalidSettingError,
    QueryError,
    UnknownNameError,
    shown,
    unknown_name,
)

QUESTIONS: Final = ("P", "E", "sd", "median", "odds", "H", "I", "mode", "top", "hdi")
"""What can be asked; ``top`` and ``hdi`` may be followed by a number."""

_DIVIDED: Final = ("P", "E", "sd", "median")  # what a ratio can be of

LONGEST: Final = 10_000  # characters of a question, at most
_WORD: Final = re.compile(r"[^\W\d]\w*")
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_OPERATOR: Final = re.compile(r"!=|<=|>=|=|<|>|in(?!\w)")
_BARE: Final = re.compile(r"""[^,|()\[\]{}=<>!"']*""")
_JOINING: Final = re.compile(r"\s(?:and|or)(?![^\s(])", re.IGNORECASE)
"""Characters and words that end an unquoted value."""

_GIVEN: Final = "what is given comes after '|': write '|' in place of 'given'"
_CLOSING: Final = {"(": ")", "[": "]", "{": "}"}
_DEEPEST: Final = 50  # brackets and "not" within each other

_COMPARED: Final[Mapping[str, Callable[[Any, Any], Any]]] = {
    **{"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge},
    **{"=": operator.eq, "!=": operator.ne},
}

T = TypeVar("T")
Columns: TypeAlias = Mapping[str, NDArray[Any]]  # quantity -> (row,) codes or numbers
Test: TypeAlias = Callable[[Any], NDArray[np.bool_]]


class Word(NamedTuple):
    """A piece of the question, and the index of its first character."""

    text: str
    at: int


class Query(NamedTuple):
    """A question, one of :data:`QUESTIONS`, about named quantities or, for P and odds, an event.

    The number is that of ``top`` or ``hdi`` (a share for ``hdi``); None: the default.
    """

    question: str
    number: float | None
    names: tuple[Word, ...]
    at: int
    given_at: int
    event: Conditions | None
    given: Conditions | None


class Clause(NamedTuple):
    """A condition on columns and, if it is about one quantity alone, that quantity."""

    holds: Callable[[Columns], NDArray[np.bool_]]
    quantity: str | None = None
    test: Test | None = None  # of codes or numbers of that quantity
    ends: tuple[float, ...] = ()  # numbers in it
    at: int = 0


class Conditions(NamedTuple):
    """Conditions on hypotheses: all clauses hold."""

    text: str
    clauses: tuple[Clause, ...]

    def holds(self, columns: Columns) -> NDArray[np.bool_]:
        """Return (row,) whether they hold."""
        return np.logical_and.reduce([clause.holds(columns) for clause in self.clauses])


def understood(text: str, quantities: Mapping[str, Quantity]) -> list[Query]:
    """Return the question in ``text``, or the two of a ratio."""
    return _Reader(text, quantities).queries()


def conditions(quantities: Mapping[str, Quantity], text: str) -> Conditions:
    """Return the conditions of a text such as ``"relation=friendly or strength_red > 400"``."""
    reader = _Reader(text, quantities)
    found = reader.events()
    if reader.skip() < len(text):
        reader.expected("',', 'and', 'or' or the end")
    return reader.possible(found)


class _Reader:
    """Parser of questions about given quantities."""

    def __init__(self, text: str, quantities: Mapping[str, Quantity]) -> None:
        if not isinstance(text, str):
            raise QueryError(f"a question is text, not {shown(text)}", "", 0)
        if len(text) > LONGEST:
            reason = f"a question of {len(text)} characters is too long: at most {LONGEST}"
            raise QueryError(reason, text, LONGEST)
        self._text, self._quantities, self._at, self._depth = text, quantities, 0, 0

    # --- a question ----------------------------------------------------------------------------

    def queries(self) -> list[Query]:
        found = [self._query()]
        if self._take("/"):
            found.append(self._query())
            for one in found:
                if one.question not in _DIVIDED or (one.question == "P" and one.names):
                    example = "P(relation=friendly) / P(relation=adversarial)"
                    self._fail(f"expected a number on both sides of '/', as in {example}", one.at)
            if self.skip() < len(self._text):
                self.expected("the end")
        return found

    def _query(self) -> Query:
        start = self.skip()
        word = self._match(_WORD).lower()
        question = next((one for one in QUESTIONS if one.lower() == word), "")
        if not question:
            self.expected(f"one of {', '.join(QUESTIONS)}, as in P(goal_red)", start)
        number = self._share_or_count(question)
        closing = next((_CLOSING[sign] for sign in _CLOSING if self._take(sign)), None)
        of_event = question == "odds" or (question == "P" and self._is_event())
        event = self.events() if of_event else []
        names: list[Word] = []
        while not event and (not names or (question in ("P", "H") and self._take(","))):
            names.append(self._asked(question, names))
        if question == "P" and names and _OPERATOR.match(self._text, self.skip()):
            self.expected("names only or conditions only; what is given comes after '|'")
        if question == "I":
            self._expect(";", "';' and another quantity, as in I(goal_red; goal_green)")
            names.append(self._asked(question, names))
        bar = self._take("|")
        given_at = self.skip()
        given = self.events() if bar else []
        closed = closing is not None and self._take(closing)
        ends = self.skip() == len(self._text) or self._text[self._at] == "/"
        if not (closed or closing is None) or not ends:
            lists = bool(given) or question in ("P", "odds", "H")
            expected = [] if closed else ["','"] * lists + ["'|'"] * (not bar)
            expected.append("the end" if closing is None or closed else f"'{closing}'")
            self.expected(" or ".join(expected))
        conditions = (self.possible(one) if one else None for one in (event, given))
        return Query(question, number, tuple(names), start, given_at, *conditions)

    def _share_or_count(self, question: str) -> float | None:
        start = self.skip()
        if question not in ("top", "hdi") or not _NUMBER.match(self._text, start):
            return None
        number = self._number("a number")
        if question == "top" and number.is_integer() and number >= 1:
            return int(number)
        if question == "top":
            self.expected("a whole number from 1, as in top 3 goal_red", start)
        if self._take("%"):
            number /= 100
        if not 0 < number <= 1:
            self.expected("a share in (0, 1] or percent, as in hdi 95% strength_red", start)
        return number

    def _is_event(self) -> bool:
        """Whether an event follows instead of names of quantities; looks ahead."""
        start = self.skip()
        found = self._word("not") or self._take("(")
        if not found:
            self._name()
            found = _OPERATOR.match(self._text, self.skip()) is not None
        self._at = start
        return found

    def _asked(self, question: str, before: list[Word]) -> Word:
        """Read the name of a quantity that can be asked for in this way."""
        text, at = name = self._name()
        quantity = self._quantity(name)
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
        return name

    # --- events: clauses of which all hold -----------------------------------------------------

    def events(self) -> list[Clause]:
        return list(itertools.chain(*self._each(self._either, lambda: self._take(","))))

    def _either(self) -> list[Clause]:
        parts = self._each(self._both, lambda: self._word("or"))
        if len(parts) == 1:
            return parts[0]
        each = [Conditions("", tuple(part)) for part in parts]
        return [Clause(lambda columns: np.logical_or.reduce([one.holds(columns) for one in each]))]

    def _both(self) -> list[Clause]:
        return list(itertools.chain(*self._each(self._single, lambda: self._word("and"))))

    def _single(self) -> list[Clause]:
        start = self.skip()
        negated = self._word("not")
        if not negated and not self._take("("):
            return [self._condition()]
        self._depth += 1
        if self._depth > _DEEPEST:
            self.expected(f"at most {_DEEPEST} brackets and 'not' within each other", start)
        if negated:
            inner = Conditions("", tuple(self._single()))
            found = [Clause(lambda columns: ~inner.holds(columns))]
        else:
            found = self.events()
            self._expect(")", "',' or ')'")
        self._depth -= 1
        return found

    def possible(self, clauses: list[Clause]) -> Conditions:
        """Return conditions; QueryError if no value of a quantity can fulfil all of its own."""
        for n, one in enumerate(clauses):
            if one.quantity is None:
                continue
            same = [other for other in clauses[: n + 1] if other.quantity == one.quantity]
            labels = self._quantities[one.quantity].labels
            ends = np.array([end for other in same for end in other.ends])
            values = np.arange(len(labels or ()))
            if labels is None:  # at an end, or right beside one
                values = np.concatenate([np.nextafter(ends, to) for to in (-np.inf, ends, np.inf)])
            if not np.logical_and.reduce(
                [other.test(values) for other in same if other.test]
            ).any():
                reason = f"no value of {one.quantity} fulfils this and what is said before"
                self._fail(reason, one.at)
        return Conditions(self._text, tuple(clauses))

    # --- a condition ---------------------------------------------------------------------------

    def _condition(self) -> Clause:
        name = self._name()
        at = self.skip()
        sign = self._match(_OPERATOR)
        if not sign:
            before = self._text[: name.at].split()[-1:]
            hint = f"; one of several values: in {{a, {name.text}}}" if before == ["or"] else ""
            if not hint:
                labels_of = self._quantity(name).labels
                hint = f", as in {name.text} = {labels_of[0]}" if labels_of else ""
            signs = "=, !=, <, <=, >, >=, in"
            self.expected(f"a comparison of {name.text} ({signs}){hint}")
        labels: list[Word] = []
        if sign == "in" and self._take("["):
            return self._numbers(name, at, self._interval())
        if sign == "in" and self._take("{"):
            labels = self._each(lambda: self._label(name.text), lambda: self._take(","))
            self._expect("}", "',' or '}'")
        elif sign == "in":
            self.expected("{ and labels, or [ and an interval's ends, after 'in'")
        elif sign in ("=", "!="):
            labels = [self._label(name.text, joined=True)]
            quoted = self._text[labels[0].at] in "\"'"
            is_value = quoted or labels[0].text in (self._quantity(name).labels or ())
            if not is_value and labels[0].text in self._quantities:
                return self._comparison(name, Word(sign, at), labels[0])
        else:
            place = self.skip()
            if _WORD.match(self._text, place) or self._text.startswith(("'", '"'), place):
                return self._comparison(name, Word(sign, at), self._name())
            number = self._number("a number, or the name of a quantity")
            return self._numbers(name, at, (number,), sign)
        quantity = self._quantity(name)
        if quantity.labels is None:
            reason = f"{name.text} is a real number: expected <, <=, >, >= or in [low, high]"
            self._fail(reason, at)
        codes = [self._code(quantity, label) for label in labels]
        return self._clause(name, lambda values: np.isin(values, codes, invert=sign == "!="))

    def _clause(self, name: Word, test: Test, ends: tuple[float, ...] = ()) -> Clause:
        return Clause(lambda columns: test(columns[name.text]), name.text, test, ends, name.at)

    def _numbers(self, name: Word, at: int, ends: tuple[float, ...], sign: str = "") -> Clause:
        quantity = self._quantity(name)
        if not quantity.numeric:
            reason = f"{name.text} has categories, not numbers: expected =, != or in {{...}}"
            self._fail(reason, at)
        if not sign:
            return self._clause(name, lambda values: quantity.satisfied(values, ends), ends)
        compare = _COMPARED[sign]
        return self._clause(name, lambda values: compare(quantity.numbers(values), ends[0]), ends)

    def _code(self, quantity: Quantity, label: Word) -> int:
        try:
            return quantity.code(label.text)
        except UnknownNameError as error:
            if said := re.search(r"\sgiven\s", label.text, re.IGNORECASE):
                self._fail(_GIVEN, label.at + said.start() + 1)
            self._fail(str(error), label.at)

    def _comparison(self, name: Word, how: Word, other: Word) -> Clause:
        """Return the clause that compares two quantities."""
        (sign, at), one, two = how, self._quantity(name), self._quantity(other)
        compare, first, second = _COMPARED[sign], one.name, two.name
        if sign in ("=", "!="):
            if one.labels is None or two.labels is None:
                real = first if one.labels is None else second
                self._fail(f"{real} is a real number: expected <, <=, >, >= to compare it", at)
            codes = {label: code for code, label in enumerate(one.labels)}
            same = np.array([codes.get(label, -1) for label in two.labels])
            if (same < 0).all():
                self._fail(f"{first} and {second} have no value in common", at)
            return Clause(lambda columns: compare(columns[first], same[columns[second]]))
        for quantity in (one, two):
            if not quantity.numeric:
                self._fail(f"{quantity.name} has categories, not numbers: expected = or !=", at)
        return Clause(
            lambda columns: compare(one.numbers(columns[first]), two.numbers(columns[second]))
        )

    def _interval(self) -> tuple[float, float]:
        start = self.skip()
        low = self._number("a number, the lower end")
        self._expect(",", "',' and the upper end")
        high = self._number("a number, the upper end")
        self._expect("]", "']'")
        if not low <= high:
            self.expected("an interval whose lower end comes first", start)
        return low, high

    # --- words ---------------------------------------------------------------------------------

    def _quantity(self, name: Word) -> Quantity:
        if name.text not in self._quantities:
            known = ", ".join(map(_named, self._quantities.values()))
            self._fail(f"unknown quantity {shown(name.text)}; allowed: {known}", name.at)
        return self._quantities[name.text]

    def _name(self) -> Word:
        start = self.skip()
        if (quoted := self._quoted()) is not None:
            return quoted
        if word := self._match(_WORD):
            return Word(word, start)
        self.expected("the name of a quantity, such as goal_red")

    def _label(self, name: str, joined: bool = False) -> Word:
        """Read a label: quoted, a pair such as (1, 0), or words up to the next sign.

        If it may be ``joined`` to other conditions, "and" and "or" end it too.
        """
        start = self.skip()
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
            self.expected(f"a value of {shown(name)}", start)
        return Word(text, start)

    def _quoted(self) -> Word | None:
        start = self._at
        quote = self._text[start : start + 1]
        if quote not in ('"', "'"):
            return None
        end = self._text.find(quote, start + 1)
        if end < 0:
            self.expected(f"a closing {quote}", len(self._text))
        self._at = end + 1
        return Word(self._text[start + 1 : end], start)

    def _number(self, what: str) -> float:
        self.skip()
        text = self._match(_NUMBER)
        if not text:
            self.expected(what)
        number = float(text)
        if not math.isfinite(number):
            self.expected("a finite number", self._at - len(text))
        return number

    # --- characters ----------------------------------------------------------------------------

    def skip(self) -> int:
        """Skip spaces, and return the index of the next character."""
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
        start = self.skip()
        if self._match(_WORD).lower() == word:
            return True
        self._at = start
        return False

    def _take(self, sign: str) -> bool:
        there = self._text.startswith(sign, self.skip())
        self._at += len(sign) * there
        return there

    def _each(self, read: Callable[[], T], joined: Callable[[], bool]) -> list[T]:
        """Read once, and again as long as what follows is joined to it."""
        found = [read()]
        while joined():
            found.append(read())
        return found

    def _expect(self, sign: str, what: str) -> None:
        if not self._take(sign):
            self.expected(what)

    def expected(self, what: str, at: int | None = None) -> NoReturn:
        at = self.skip() if at is None else at
        said = _WORD.match(self._text, at)
        if said and said.group().lower() == "given":
            self._fail(_GIVEN, at)
        self._fail(f"expected {what}", at)

    def _fail(self, reason: str, at: int) -> NoReturn:
        raise QueryError(reason, self._text, at)


def _named(quantity: Quantity) -> str:
    """Return a quantity's name, with its values if these are two words."""
    labels = quantity.labels or ()
    two = len(labels) == 2 and quantity.values is None
    return f"{quantity.name} ({' / '.join(labels)})" if two else quantity.name


# --- a user's own quantities: by a function of a hypothesis, or by conditions ---------------------

Function = Callable[["Named"], bool | int | float | str]  # (hypothesis in plain names) -> its value
Definition = Function | str  # a function, or conditions in words, which hold or do not

RESERVED_QUANTITIES: Final = frozenset(
    ("given", "self", "weight", "chain", "draw", "simulation", "error", "bound", "probability")
)
"""Names that are taken by arguments, columns and coordinates of results."""

_SHOWN: Final = ("goal_red", "goal_green", "alpha", "strength_red", "strength_green")
"""What a message says of a hypothesis."""


class Named:
    """A hypothesis as functions of :meth:`Posterior.define` see it: ``h.goal_red`` and so on.

    Its attributes are all quantities of the posterior, those of :meth:`Posterior.define` too:
    labels as strings, strengths as floats, ``alpha`` as a pair such as (1, 0). Goals are effective
    goals.
    """

    __slots__ = ("_columns", "_quantities", "_row")

    def __init__(
        self, quantities: Mapping[str, Quantity], columns: Mapping[str, NDArray[Any]], row: int
    ) -> None:
        self._quantities = quantities
        self._columns = columns
        self._row = row

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name not in self._quantities:
            raise AttributeError(str(unknown_name("quantity", name, self._quantities)))
        return self._quantities[name].value(self._columns[name][self._row])

    def __dir__(self) -> Iterable[str]:
        return sorted(self._quantities)

    def __repr__(self) -> str:
        shown = [name for name in _SHOWN if name in self._quantities] or self._quantities
        return ", ".join(f"{name}={getattr(self, name)!r}" for name in shown)


def check_new_name(name: object, taken: Iterable[str]) -> None:
    """Refuse what cannot be the name of a new quantity."""
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InvalidSettingError(
            f"a quantity cannot be called {shown(name)}: expected a valid Python name, such as "
            "same_goal"
        )
    if name in taken:
        raise InvalidSettingError(f"there is a quantity {name!r} already: choose another name")
    if name in RESERVED_QUANTITIES:
        raise InvalidSettingError(f"{name!r} is a reserved name: choose another")


def defined(
    name: str,
    definition: Definition,
    quantities: Mapping[str, Quantity],
    columns: Mapping[str, NDArray[Any]],
) -> tuple[Quantity, NDArray[Any]]:
    """Return the quantity that a definition makes, and its column as codes or numbers.

    Conditions hold or do not. Of a function truth values, whole numbers and strings are
    categories, in order of their values; numbers that are not all whole are real.
    """
    if isinstance(definition, str):
        holds = conditions(quantities, definition).holds(columns)
        return Quantity(name, ("False", "True"), (False, True)), holds.astype(np.int64)
    if not callable(definition):
        raise InvalidSettingError(
            f"define({name!r}, {shown(definition)}): expected a function of a hypothesis, such as "
            "lambda h: h.goal_red == h.goal_green, or conditions in words, such as "
            "'goal_red = goal_green'"
        )
    number, first = equal_rows([columns[column] for column in quantities])
    views = [Named(quantities, columns, int(row)) for row in first]
    results = [_value(name, definition, view) for view in views]
    kinds = {type(result): view for result, view in zip(results, views, strict=True)}
    if set(kinds) == {int, float}:
        kinds, results = {float: kinds[float]}, [float(result) for result in results]
    if len(kinds) > 1:
        listed = " and ".join(f"{kind.__name__} (for {view!r})" for kind, view in kinds.items())
        raise InvalidSettingError(f"{name} has values of several kinds: {listed}")
    if float in kinds:
        return Quantity(name), np.array(results, np.float64)[number]
    values: list[Any] = [False, True] if bool in kinds else sorted(set(results))
    code = {value: index for index, value in enumerate(values)}
    quantity = Quantity(name, tuple(map(str, values)), tuple(values))
    return quantity, np.array([code[result] for result in results], np.int64)[number]


def _value(name: str, function: Function, view: Named) -> bool | int | float | str:
    try:
        found = function(view)
    except Exception as error:  # whatever a user's function does
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InvalidSettingError(f"{name} failed for {view!r}: {reason}") from error
    if isinstance(found, np.generic):
        found = found.item()
    for kind in (bool, int, float, str):  # a bool is an int too
        if isinstance(found, kind):
            if isinstance(found, float) and not math.isfinite(found):
                raise InvalidSettingError(f"{name} is {found} for {view!r}: expected a number")
            return kind(found)
    raise InvalidSettingError(
        f"{name} is {shown(found)} for {view!r}: expected a truth value, a number or a string"
    )
