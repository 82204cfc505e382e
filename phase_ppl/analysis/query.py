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

import math
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

import numpy as np

from phase_ppl.analysis.hypotheses import HDI_PROBABILITY, N_TOP, Hypotheses
from phase_ppl.analysis.quantities import Quantity
from phase_ppl.analysis.query_parser import Condition, Query, Word, parse
from phase_ppl.world.errors import (
    InvalidSettingError,
    QueryError,
    UnknownNameError,
    unknown_name,
)


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
