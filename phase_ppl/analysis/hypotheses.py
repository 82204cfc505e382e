"""A weighted table of hypotheses, and what one can ask it."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, Final, Self, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis import estimate
from phase_ppl.analysis.estimate import (
    FEW_DRAWS,
    Estimate,
    Jackknife,
    Jackknives,
    Mode,
    doubt,
    leaving_out,
    with_unseen,
)
from phase_ppl.analysis.quantities import Quantity, relations_of
from phase_ppl.analysis.query import (
    Clause,
    Conditions,
    Definition,
    Query,
    check_new_name,
    conditions,
    defined,
    understood,
)
from phase_ppl.analysis.weights import Rows
from phase_ppl.analysis.with_arviz import hdi, n_equal
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    QueryError,
    check_name,
    whole_number,
)
from phase_ppl.world.picture import Printed
from phase_ppl.world.space import HypothesisSpace

Statistic: TypeAlias = Callable[[NDArray[Any], FloatArray], FloatArray]
"""Of values (row,) and weights (..., row)."""

Given: TypeAlias = Mapping[str, Any] | str | Conditions | None
"""What to condition on: quantity -> value, or conditions in words; None: nothing."""

KEPT_DEFINITIONS: Final = "definitions"  # attribute of a file that holds definitions in words, JSON
HDI_PROBABILITY: Final = 0.95  # mass of the intervals that summaries report
N_TOP: Final = 3  # number of labels that ``top`` returns where nothing else is asked for

LEFT_OUT_OF_INTERVALS: Final = 1 / 3
"""Share of the chains that is left out at a time to see how ends of intervals vary."""

MOST_CELLS: Final = 10_000_000  # size of a joint table above which it is refused

SURE: Final = 1.64
"""Errors by which the probability of an answer must exceed 1/2, for it to be decided."""

_ALIKE: Final = 0.9  # share of the leader's probability from which on others are about as probable


class Hypotheses(Printed):
    """A weighted table of hypotheses, and questions that one can ask it.

    Every answer carries its Monte-Carlo error. A number is a :class:`phase_ppl.Estimate`, with
    ``.error``; an array has a coordinate ``error`` beside its values. Arithmetic computes no new
    errors: a number loses its error, and an array keeps the old one.
    :mod:`phase_ppl.analysis.estimate` says how errors are found, and when they are NaN.

    Questions are about quantities, by name, such as "goal_red"
    (:mod:`phase_ppl.analysis.quantities` lists them). Every question takes ``given``, what to
    condition on: quantity -> value. A value is a label; a list of labels, any of which will do; or,
    for numbers, an interval (low, high). ``given`` may also be conditions in words, such as
    ``"relation=friendly or strength_red > strength_green"``.

    All questions raise UnknownNameError if there is no such quantity or label; it names close
    matches. They raise InvalidSettingError if a quantity lacks the categories or numbers that the
    question needs, or if ``given`` has probability 0.

    Args:
        space: the world's hypotheses.
        quantities: name -> quantity.
        rows: the table; its values are codes or numbers of every quantity.
    """

    def __init__(
        self, space: HypothesisSpace, quantities: Mapping[str, Quantity], rows: Rows
    ) -> None:
        world = space.world
        # what summaries tell of: in words -> quantity
        self.goals_of = dict(zip(world.agents, space.goal_sites, strict=True))
        self.relations_of = relations_of(world)
        self.scenarios_of = {name: name for name in space.scenario_names}
        self.strengths_of = dict(zip(world.agents, space.strength_sites, strict=True))
        self._quantities = dict(quantities)
        self._rows = rows
        self._jackknives: dict[float, Jackknife | None] = {}
        self._defined: dict[str, Definition] = {}  # of quantities that the user defined

    @property
    def quantities(self) -> dict[str, tuple[str, ...] | None]:
        """What one can ask about: name of a quantity -> its labels; None for a real number."""
        return {name: quantity.labels for name, quantity in self._quantities.items()}

    def define(self, name: str, definition: Definition) -> Self:
        """Add a quantity of your own, to be asked about like any other; return this object.

        Conditions in words are saved along with a posterior. After loading, define functions again,
        and the quantities whose conditions name them.

        Args:
            name: name of the quantity, a valid Python name. A quantity of your own may be defined
                anew.
            definition: one of two. Conditions in words (:mod:`phase_ppl.analysis.query`) give a
                quantity that is true or false. A function of a hypothesis
                (:class:`~phase_ppl.analysis.query.Named`) is called at once, once per distinct
                hypothesis. Truth values, whole numbers and strings make categories, the first two
                also with a mean. Floats make the quantity a real number.

        Example:
            ``post.define("same_goal", "goal_red = goal_green")`` or ``post.define("same_goal",
            lambda h: h.goal_red == h.goal_green)``, then ``post.probability(same_goal=True)``

        Raises:
            QueryError: the conditions cannot be read; the message points at the place.
            InvalidSettingError: the name is taken or no valid name; or the function raises, returns
                something else, NaN, or values of several kinds. The message names the hypothesis.
        """
        check_new_name(name, self._quantities.keys() - self._defined.keys())
        others = {key: quantity for key, quantity in self._quantities.items() if key != name}
        quantity, column = defined(name, definition, others, self._rows.values)
        self._quantities = {**others, name: quantity}
        self._rows = dataclasses.replace(self._rows, values={**self._rows.values, name: column})
        self._defined[name] = definition
        return self

    @property
    def definitions(self) -> dict[str, Definition]:
        """Quantities from :meth:`define`: name -> conditions in words, or a function."""
        return dict(self._defined)

    def _defining(self, others: Mapping[str, Definition]) -> Self:
        """Define what another posterior of the same event has; return this one."""
        for name, definition in others.items():
            self.define(name, definition)
        return self

    def _definitions_to_keep(self) -> dict[str, str]:
        """Return the attribute of a file with the definitions in words that need no function."""
        known = {name: q for name, q in self._quantities.items() if name not in self._defined}
        kept: dict[str, str] = {}
        for name, definition in self._defined.items():
            if isinstance(definition, str):
                with contextlib.suppress(QueryError):
                    conditions(known, definition)
                    known[name], kept[name] = self._quantities[name], definition
        return {KEPT_DEFINITIONS: json.dumps(kept)} if kept else {}

    def _define_kept(self, attributes: Mapping[Hashable, Any]) -> None:
        """Define what a file has kept."""
        try:
            self._defining(dict(json.loads(attributes.get(KEPT_DEFINITIONS, "{}"))))
        except ValueError as error:  # of ours too
            raise InvalidEventError(f"{KEPT_DEFINITIONS}: {error}") from None

    @property
    def table(self) -> Rows:
        """The rows: codes or numbers of every quantity (row,), and weights (row,) of sum 1."""
        return self._rows

    def by_frame(self) -> xr.Dataset | None:
        """Return each frame's tempered log likelihood of every combination of goals; None: unknown.

        Their differences are the changes of log odds. They are known for the closed loop, in worlds
        of one or two agents without too many hypotheses for a table.

        Returns:
            ``log_likelihood`` (time, goal_<agent>, ...), nats, times what a frame counts; and
            ``log_prior`` (goal_<agent>, ...), nats. In PHASE these axes are goal_red, goal_green.
        """
        return None

    def marginal(self, name: str, *, given: Given = None) -> xr.DataArray:
        """Return (label,) the probability of every label of a quantity with categories, sum 1."""
        return self.joint(name, given=given)

    def joint(self, *names: str, given: Given = None) -> xr.DataArray:
        """Return the joint probability of quantities with categories, an array with a dim for each.

        Raises:
            InvalidSettingError: a name is given twice, there is no name, or the array has more than
                10 million entries.
        """
        of = self._knowing(*names, given=given)
        labels = [of._quantity(name).categories() for name in _distinct(names)]
        shape = tuple(map(len, labels))
        if math.prod(shape) > MOST_CELLS:
            raise InvalidSettingError(
                f"the joint of {', '.join(names)} has {math.prod(shape)} entries, "
                f"at most {MOST_CELLS} are possible: ask for fewer quantities"
            )
        columns = [of._rows.values[name] for name in names]
        rows, weights, without = of._weighed(given, *columns)
        codes = np.ravel_multi_index([column[rows] for column in columns], shape)
        occupied, codes = np.unique(codes, return_inverse=True)
        mass = estimate.shares(codes, weights)
        table = np.zeros(shape)
        table.flat[occupied] = mass
        error = np.full(shape, np.nan if without is None else 0.0)
        if without is not None:
            error.flat[occupied] = without.error(estimate.shares(codes, without.weights), mass)
            error = with_unseen(table, error, of._size_of(rows), table.size)
            error = np.hypot(error, of._unseen * (table - 1 / table.size))
            luck = np.zeros(shape)
            luck.flat[occupied] = of._luck_of(codes, rows, len(occupied))
            error = np.hypot(error, luck * (1 - table))
        coords: dict[str, Any] = dict(zip(names, map(list, labels), strict=True))
        return xr.DataArray(
            table, {**coords, "error": (names, error)}, dims=names, name="probability"
        )

    def probability(self, given: Given = None, **event: Any) -> Estimate:
        """Return P(event | given).

        Args:
            given: what to condition on, as the class describes; None: nothing.
            **event: quantity -> value. A value is a label; a list of labels, any of which will do;
                or, for a strength, an interval (low, high) in newtons.

        Example:
            ``post.probability(relation="friendly", given={"goal_red": "get to green agent"})``

        Raises:
            InvalidSettingError: no event is named, or an interval is invalid.
        """
        if not event:
            raise InvalidSettingError("name the event, as in probability(relation='friendly')")
        of = self._knowing(*event, given=given)
        return of._number(estimate.share, of._satisfied(event), given)

    def top(self, name: str, n: int = N_TOP, *, given: Given = None) -> list[tuple[str, Estimate]]:
        """Return the ``n`` most probable labels of a quantity, each with its probability.

        The most probable is first; ties are in label order. ``n`` is at least 1.
        """
        n = whole_number("n", n)
        found = with_errors(self.marginal(name, given=given))
        return sorted(found, key=lambda entry: -entry[1])[:n]

    def mode(self, name: str, *, given: Given = None) -> Mode:
        """Return the most probable label of a quantity; of equally probable ones, the first label.

        It is a string whose ``.error`` is the probability that another label is in truth the most
        probable one (:class:`~phase_ppl.analysis.estimate.Mode`).
        """
        of = self._knowing(name, given=given)
        labels = of._quantity(name).categories()
        rows, weights, without = of._weighed(given, of._rows.values[name])
        codes, size = of._rows.values[name][rows], len(labels)
        mass = estimate.shares(codes, weights, size)
        label = labels[int(mass.argmax())]
        if without is None:
            return Mode(label)
        without_each = estimate.shares(codes, without.weights, size)
        luck = of._luck_of(codes, rows, size) * (1 - mass)
        return Mode(label, doubt(mass, without, without_each, of._size_of(rows), luck))

    def leaders(self) -> dict[str, dict[str, Any]]:
        """Return each agent's most probable goal and each pair's most probable relation.

        Returns:
            Quantity -> ``label``, its ``probability`` and ``error``; ``next``, the second most
            probable label, and ``next_probability``; ``alike``: further labels with at least nine
            tenths of the leader's probability, and theirs; ``sure``: whether the answer is sure
            (see the glossary). A relation also has ``of_leading_goals``, the relation that follows
            from the leading goals; None: no hypothesis has these together. Goals that were never
            simulated count as impossible. ``diagnostics()`` says whether this matters, and whether
            the prior decides the answer.
        """
        found: dict[str, dict[str, Any]] = {}
        together = np.ones(len(self._rows.weights), bool)
        for name in (*self.goals_of.values(), *self.relations_of.values()):
            labels, codes = self._quantity(name).categories(), self._rows.values[name]
            (label, share), (second, second_share), *others = self.top(name, len(labels))
            found[name] = {
                "label": label,
                "probability": float(share),
                "error": share.error,
                "next": second,
                "next_probability": float(second_share),
                "alike": {one: float(p) for one, p in others if p >= _ALIKE * share},
                "sure": bool(
                    share - SURE * share.error > 0.5 and not self._effective_size < self._needed
                ),
            }
            if name in self.goals_of.values():
                together &= codes == labels.index(label)
            else:  # it follows from the goals
                known = codes[together][:1].tolist()
                found[name]["of_leading_goals"] = labels[known[0]] if known else None
        return found

    def entropy(self, *names: str, given: Given = None) -> Estimate:
        """Return the entropy of the joint distribution of quantities with categories, in nats.

        It is the entropy of the weighted table; of few draws it comes out too low.
        """
        of = self._knowing(*names, given=given)
        codes = np.zeros(len(of._rows.weights), np.int64)
        for name in _distinct(names):
            size = len(of._quantity(name).categories())
            _, codes = np.unique(codes * size + of._rows.values[name], return_inverse=True)
        return of._number(_entropy_of_codes, codes, given)

    def mutual_information(self, first: str, second: str, *, given: Given = None) -> Estimate:
        """Return the mutual information of two quantities with categories, in nats.

        It is computed from the weighted table; of few draws it comes out too high.
        """
        of = self._knowing(first, second, given=given)
        size = len(of._quantity(second).categories())
        of._quantity(first).categories()
        codes = of._rows.values[first] * size + of._rows.values[second]

        def information(codes: NDArray[np.int64], weights: FloatArray) -> FloatArray:
            one, other, both = (
                _entropy_of_codes(np.unique(part, return_inverse=True)[1], weights)
                for part in (*np.divmod(codes, size), codes)
            )
            return one + other - both

        return of._number(information, codes, given)

    def mean(self, name: str, *, given: Given = None) -> Estimate:
        """Return the mean of a quantity with numbers, such as a strength in newtons."""
        of = self._knowing(name, given=given)
        return of._number(estimate.mean, of._numbers(name), given)

    def sd(self, name: str, *, given: Given = None) -> Estimate:
        """Return the standard deviation of a quantity with numbers."""
        of = self._knowing(name, given=given)
        return of._number(estimate.sd, of._numbers(name), given)

    def median(self, name: str, *, given: Given = None) -> Estimate:
        """Return the median of a quantity with numbers; the lower one of two middle values."""
        of = self._knowing(name, given=given)
        return of._number(estimate.median, of._numbers(name), given)

    def hdi(self, name: str, prob: float = HDI_PROBABILITY, *, given: Given = None) -> xr.DataArray:
        """Return the shortest interval with probability ``prob`` of a quantity with numbers.

        ``az.hdi`` computes it, from the draws if they have equal weights, else from 4000 quantiles
        of the weighted table.

        Returns:
            (bound,) the ends "lower" and "upper", with their errors.

        Raises:
            InvalidSettingError: ``prob`` is not in (0, 1].
        """
        if not 0 < prob <= 1:
            raise InvalidSettingError(f"prob={prob} must lie in (0, 1]")
        of = self._knowing(name, given=given)
        values = of._numbers(name)
        rows, weights, without = of._weighed(given, values, share=LEFT_OUT_OF_INTERVALS)
        levels, codes = np.unique(values[rows], return_inverse=True)

        def ends(weights: FloatArray) -> FloatArray:
            return hdi(levels, estimate.shares(codes, weights), n_equal(weights), prob)

        bounds = ends(weights)
        error = np.full(2, np.nan)
        if without is not None:
            error = without.error([ends(some) for some in without.weights], bounds)
            if not math.isnan(of._effective_size):  # as of other numbers
                error = np.where(error > 0, error, np.nan)
        coords = {"bound": ["lower", "upper"], "error": ("bound", error)}
        return xr.DataArray(bounds, coords, dims="bound", name=name)

    def query(self, question: str) -> Any:
        """Return the answer to a question in words, such as ``"P(relation=friendly)"``.

        :mod:`phase_ppl.analysis.query` has the grammar. Most questions are answered by a method:

        * P(conditions): :meth:`probability`
        * P(name), P(name, name): :meth:`marginal`, :meth:`joint`
        * E, H, I: :meth:`mean`, :meth:`entropy`, :meth:`mutual_information`
        * sd, median, hdi, mode, top: the method of that name
        * odds(conditions), and a ratio of two numbers: a number with its error

        The error of odds is to first order. The error of a ratio is by the jackknife, so what both
        numbers share cancels. Parts of their errors that are not from the jackknife are added to
        first order, as if independent; without a common jackknife all of both errors are.

        Raises:
            QueryError: the question cannot be read, names something unknown, asks for what a
                quantity does not have, or conditions on an event of probability 0. The message
                points at the place.
        """
        if (of := self._knowing(given=question)) is not self:
            return of.query(question)
        queries = understood(question, self._quantities)
        for one in queries:
            given = one.given
            if given is not None and not self._satisfied(given) @ self._rows.weights > 0:
                reason = f"cannot condition on this: {self._impossible}"
                raise QueryError(reason, question, one.given_at)
        if len(queries) > 1:
            return self._ratio(queries, question)
        (query,) = queries
        given = query.given
        if query.event is not None:
            found = self._number(*self._asked(query), given)
            return found if query.question == "P" else estimate.odds(found)
        ask: Mapping[str, Callable[..., Any]] = {
            **{"P": self.joint, "H": self.entropy, "I": self.mutual_information},
            **{"E": self.mean, "sd": self.sd, "median": self.median},
            **{"mode": self.mode, "top": self.top, "hdi": self.hdi},
        }
        number = () if query.number is None else (query.number,)
        try:
            return ask[query.question](*(name.text for name in query.names), *number, given=given)
        except InvalidSettingError as error:  # too large a table
            raise QueryError(str(error), question, query.names[0].at) from None

    def _asked(self, query: Query) -> tuple[Statistic, NDArray[Any]]:
        """Return the statistic of a question with a number as answer, and its values (row,)."""
        if query.event is not None:
            return estimate.share, query.event.holds(self._rows.values)
        ask = {"E": estimate.mean, "sd": estimate.sd, "median": estimate.median}
        return ask[query.question], self._numbers(query.names[0].text)

    def _ratio(self, queries: Sequence[Query], question: str) -> Estimate:
        """Return the answer to one question over that to another."""
        numbers, replicates, own = list[Estimate](), list[FloatArray](), list[float]()
        without: Jackknife | Jackknives | None = None
        for query in queries:
            statistic, values = self._asked(query)
            numbers.append(number := self._number(statistic, values, query.given))
            rows, _, without = self._weighed(query.given, values)
            if without is not None:
                replicates.append(statistic(values[rows], without.weights))
                own.append(float(without.error(replicates[-1], number)))
        one, other = numbers
        if not other:
            raise QueryError("this is 0, and nothing can be divided by it", question, queries[1].at)
        if without is None or len({len(one) for one in replicates}) > 1 or len(own) < len(numbers):
            return estimate.ratio(one, other)
        with np.errstate(divide="ignore", invalid="ignore"):
            shared = float(without.error(replicates[0] / replicates[1], float(one / other)))
        return estimate.ratio(one, other, (own[0], own[1], shared))

    def to_dataframe(self) -> pd.DataFrame:
        """Return a row per draw, simulation or hypothesis: labels, numbers and ``weight``, sum 1.

        Columns of quantities from :meth:`define` hold what the function returned.
        """
        columns: dict[str, Any] = {**self._rows.index, **self._rows.values}
        for name, quantity in self._quantities.items():
            if quantity.labels is not None:
                values = quantity.values if name in self._defined else None
                columns[name] = np.array(values or quantity.labels)[columns[name]]
        columns = {name: columns[name] for name in (*self._rows.index, *self._quantities)}
        return pd.DataFrame({**columns, "weight": self._rows.weights})

    # --- rows, conditions, and how far answers differ between chains ---------------------------

    def _knowing(self, *names: str, given: Given = None) -> Hypotheses:
        """Return the table that knows these names, and those in ``given``, be it a question."""
        return self

    def _quantity(self, name: str) -> Quantity:
        check_name("quantity", name, self._quantities)
        return self._quantities[name]

    def _numbers(self, name: str) -> FloatArray:
        return self._quantity(name).numbers(self._rows.values[name])

    def _satisfied(self, wanted: Given) -> NDArray[np.bool_]:
        holds = self._conditions(wanted).holds(self._rows.values)
        return holds & np.ones(len(self._rows.weights), bool)  # without conditions one True

    def _conditions(self, given: Given) -> Conditions:
        """Return what is said of hypotheses, in words or by quantity."""
        if isinstance(given, Conditions):
            return given
        if isinstance(given, str):
            return conditions(self._quantities, given)
        wanted = given or {}
        clauses = (_clause(self._quantity(name), value) for name, value in wanted.items())
        return Conditions(str(wanted), tuple(clauses))

    @property
    def _impossible(self) -> str:
        """Why nothing can be conditioned on what has no mass."""
        is_sampled = not math.isnan(self._effective_size)
        return "no draw of this posterior has it" if is_sampled else "its probability here is 0"

    def _jackknife(self, share: float) -> Jackknife | Jackknives | None:
        """Return what errors come from; ``share`` is that of the chains that are left out."""
        return self._over_chains(share)

    def _over_chains(self, share: float) -> Jackknife | None:
        """Return one that leaves out random sets with a share of the chains, or single ones."""
        rows = self._rows
        if rows.groups is not None and share not in self._jackknives:
            parts = rows.weights, rows.groups, rows.halves
            self._jackknives[share] = leaving_out(*parts, share, rows.strata)
        return self._jackknives.get(share)

    @functools.cached_property
    def _needed(self) -> float:
        """How many effective draws an answer is to rest on, to be sure."""
        return FEW_DRAWS

    @functools.cached_property
    def _unseen(self) -> float:
        """The probability that what was never simulated may have, where draws cannot tell."""
        return 0.0

    @functools.cached_property
    def _luck(self) -> FloatArray | None:
        """(row,) the weight that each would have, had it been as lucky as those that decide."""
        return None

    def _luck_of(self, codes: NDArray[Any], rows: NDArray[np.bool_], size: int) -> FloatArray:
        """Return (code,) what one more lucky simulation of each would weigh among the ``rows``."""
        if self._luck is None:
            return np.zeros(size)
        luck = estimate.typical(codes, self._luck[rows], size)
        luck /= self._rows.weights[rows].sum()
        return np.asarray(luck / (1 + luck))

    @functools.cached_property
    def _effective_size(self) -> float:
        """The number of independent draws that would be as sure of both goals; NaN if unknown.

        The least over the goals of sum p (1 - p) / sum of squared errors, and at most what the
        weights are worth: that leaving out any chain changes nothing proves no more.
        """
        without = self._over_chains(0.0)
        if without is None or self._rows.groups is None:
            return math.nan
        sizes = []
        for name in self.goals_of.values():
            codes = self._rows.values[name]
            mass = estimate.shares(codes, self._rows.weights)
            error = without.error(estimate.shares(codes, without.weights), mass)
            spread, variance = float((error**2).sum()), float((mass * (1 - mass)).sum())
            if spread > 0 and variance > estimate.ROUNDING:
                sizes.append(variance / spread)
        return min([self._most_effective(), *sizes])

    def _most_effective(self) -> float:
        """Return how many independent draws the weights can be worth at most (Kish)."""
        return estimate.kish_size(self._rows.weights)

    def _size_of(self, rows: NDArray[np.bool_]) -> float:
        """Return how many independent draws those of ``rows`` would be as sure as; or NaN."""
        return self._effective_size * float(self._rows.weights[rows].sum())

    def _weighed(
        self, given: Given, *asked: NDArray[Any], share: float = 0.0
    ) -> tuple[NDArray[np.bool_], FloatArray, Jackknife | Jackknives | None]:
        """Return which rows fulfil ``given``, and of these the weights, sum 1.

        Third, those without sets with a ``share`` of the chains; None where unknown, as it may be
        for the columns that are ``asked`` about.
        """
        said = self._conditions(given)
        rows = self._satisfied(said)
        weights = self._rows.weights[rows]
        total = weights.sum()
        if not total > 0:
            raise InvalidSettingError(f"cannot condition on {said.text}: {self._impossible}")
        without = self._jackknife(share) if self._has_error(rows, *asked) else None
        return rows, weights / total, None if without is None else without.only(rows)

    def _has_error(self, *columns: NDArray[Any]) -> bool:
        """Return whether the jackknife gives the error of answers about these columns."""
        return True

    def _number(self, statistic: Statistic, values: NDArray[Any], given: Given) -> Estimate:
        """Return ``statistic`` of values (row,) and weights (..., row), with its error."""
        rows, weights, without = self._weighed(given, values)
        values = values[rows]
        number = float(statistic(values, weights))
        if without is None:
            return Estimate(number)
        error = without.error(statistic(values, without.weights), number)
        if statistic is estimate.share:
            error = with_unseen(number, error, self._size_of(rows))
            error = np.hypot(error, self._unseen * (number - 0.5))
            luck = self._luck_of(values.astype(np.int64), rows, 2)[1]
            error = np.hypot(error, luck * (1 - number))
        elif statistic is estimate.mean:
            # a few draws that agree by chance do not make it sure
            size = self._size_of(rows)
            error = np.fmax(error, float(estimate.sd(values, weights)) / math.sqrt(size + 1))
            error *= estimate.widened(size)
        of_draws = statistic is not estimate.share and not math.isnan(self._effective_size)
        # chains that all say the same do not say how far off they are
        return Estimate(number, math.nan if of_draws and not error > 0 else float(error))


def _distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    if not names:
        raise InvalidSettingError("name at least one quantity, such as 'goal_red'")
    for place, name in enumerate(names):
        if name in names[:place]:
            raise InvalidSettingError(f"{name!r} is named twice: expected different quantities")
    return names


def with_errors(found: xr.DataArray) -> list[tuple[str, Estimate]]:
    """Return labels and values with their errors, of an array with one dimension."""
    columns = (found[found.dims[0]].values, found.values, found["error"].values)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return [(label, Estimate(value, error)) for label, value, error in rows]


def _clause(quantity: Quantity, wanted: object) -> Clause:
    return Clause(lambda columns: quantity.satisfied(columns[quantity.name], wanted), quantity.name)


def _entropy_of_codes(codes: NDArray[np.int64], weights: FloatArray) -> FloatArray:
    return estimate.entropy(estimate.shares(codes, weights))
