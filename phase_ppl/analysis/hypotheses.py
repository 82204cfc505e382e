"""A weighted table of hypotheses, and what one can ask it."""

from __future__ import annotations

import dataclasses
import keyword
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, Self

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis import estimate
from phase_ppl.analysis.estimate import Estimate, Mode, WeightedRows, doubt
from phase_ppl.analysis.quantities import Quantity
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name

Definition = Callable[["Named"], bool | int | float | str]
"""(hypothesis in plain names) -> its value."""

RESERVED: Final = frozenset(
    (
        *("given", "self", "weight", "chain", "draw", "simulation"),
        *("error", "bound", "probability"),
    )
)
"""Names that are taken by arguments, columns and coordinates of results."""

_SHOWN: Final = ("goal_red", "goal_green", "alpha", "strength_red", "strength_green")
"""What a message says of a hypothesis."""


class Named:
    """A hypothesis as functions of :meth:`Posterior.define` see it: ``h.goal_red`` and so on.

    Its attributes are all quantities of the posterior, those defined before too: labels as
    strings, strengths as floats, ``alpha`` as a pair such as (1, 0). Goals are effective ones.
    """

    __slots__ = ("_columns", "_quantities", "_row")

    def __init__(
        self,
        quantities: Mapping[str, Quantity],
        columns: Mapping[str, NDArray[Any]],
        row: int,
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
        return ", ".join(f"{name}={getattr(self, name)!r}" for name in _SHOWN)


def check_name(name: object, taken: Iterable[str]) -> None:
    """Raise InvalidSettingError if a quantity cannot be called ``name``.

    Args:
        name: asked for.
        taken: names that cannot be given anew.
    """
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InvalidSettingError(
            f"a quantity cannot be called {shown(name)}: expected a name as of a Python variable"
        )
    if name in taken:
        raise InvalidSettingError(f"there is a quantity {name!r} already: choose another name")
    if name in RESERVED:
        raise InvalidSettingError(f"{name!r} is a reserved name: choose another")


def defined(
    name: str,
    function: Definition,
    quantities: Mapping[str, Quantity],
    columns: Mapping[str, NDArray[Any]],
) -> tuple[Quantity, NDArray[Any]]:
    """Return the quantity that ``function`` defines, and its column as codes or numbers.

    The function is called once per distinct hypothesis. Truth values, whole numbers and strings
    are categories, in order of their values; numbers that are not all whole are real.

    Raises:
        InvalidSettingError: it raises, or returns NaN, an infinity, something else or values of
            several kinds; the message names the hypothesis.
    """
    if not callable(function):
        raise InvalidSettingError(
            f"define({name!r}, {shown(function)}): expected a function of a hypothesis, such as "
            "lambda h: h.goal_red == h.goal_green"
        )
    table = pd.DataFrame({column: columns[column] for column in quantities})
    number = table.groupby(list(table), sort=False, dropna=False).ngroup().to_numpy()
    _, first = np.unique(number, return_index=True)
    views = [Named(quantities, columns, int(row)) for row in first]
    results = [_value(name, function, view) for view in views]
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


def _value(name: str, function: Definition, view: Named) -> bool | int | float | str:
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


# --- A weighted table of hypotheses, and what one can ask it --------------------------------------

HDI_PROBABILITY: Final = 0.94
"""Mass of the intervals that summaries report."""

N_TOP: Final = 3
"""Number of labels that ``top`` returns where nothing else is asked for."""

LEFT_OUT_OF_INTERVALS: Final = 1 / 3
"""Share of the chains that is left out at a time to see how ends of intervals vary."""

MOST_CELLS: Final = 10_000_000
"""Size of a joint table above which it is refused."""


class Hypotheses(WeightedRows):
    """A weighted table of hypotheses, and what one can ask it.

    Every result carries its Monte-Carlo error as ``.error``: numbers are floats with an error,
    arrays have a coordinate ``error`` beside their values (``.drop_vars("error")`` leaves it
    out). Arithmetic computes no new errors: numbers lose theirs, arrays keep the old ones. How
    errors are found, and when they are NaN, is in :mod:`phase_ppl.analysis.estimate`.

    Every question takes ``given``, what to condition on: quantity -> value, where a value is a
    label, a list of labels of which any will do, or for numbers an interval (low, high).
    :mod:`phase_ppl.analysis.quantities` lists the quantities.
    """

    @property
    def quantities(self) -> dict[str, tuple[str, ...] | None]:
        """What one can ask for: quantity -> its labels, None for a real number."""
        return {name: quantity.labels for name, quantity in self._quantities.items()}

    def define(self, name: str, function: Definition) -> Self:
        """Add a quantity of your own, to be asked for like any other; return the posterior.

        Args:
            name: of the quantity. One that was defined before may be defined anew.
            function: hypothesis -> a truth value, a whole number or a string, for a quantity
                with categories (of which those of numbers have means too), or a real number. It
                is called at once, once per distinct hypothesis, which offers the quantities by
                name, as in ``h.goal_red`` (:class:`phase_ppl.analysis.hypotheses.Named`).

        A function cannot be written to a file: define it again after :meth:`Posterior.load`.

        Example:
            ``post.define("same_goal", lambda h: h.goal_red == h.goal_green)``, then
            ``post.probability(same_goal=True)``

        Raises:
            InvalidSettingError: the name is taken or no name; or the function raises, or returns
                NaN, something else or values of several kinds. The message names the hypothesis.
        """
        check_name(name, self._quantities.keys() - self._own)
        others = {key: quantity for key, quantity in self._quantities.items() if key != name}
        quantity, column = defined(name, function, others, self._rows.values)
        self._quantities = {**others, name: quantity}
        self._rows = dataclasses.replace(self._rows, values={**self._rows.values, name: column})
        self._own.add(name)
        return self

    def marginal(self, name: str, *, given: Mapping[str, Any] | None = None) -> xr.DataArray:
        """Return the probability of every value of a quantity with categories.

        Returns:
            Probabilities over the labels (goal strings and so on), sum 1, with their errors.

        Raises:
            UnknownNameError: no such quantity; the message names close matches.
            InvalidSettingError: the quantity is a real number, or ``given`` has probability 0.
        """
        return self.joint(name, given=given)

    def joint(self, *names: str, given: Mapping[str, Any] | None = None) -> xr.DataArray:
        """Return the joint probability of quantities with categories, a dim for each.

        Raises:
            UnknownNameError, InvalidSettingError: as :meth:`marginal`; or twice the same name, no
                name, or too large a table.
        """
        labels = [self._quantity(name).categories() for name in self._distinct(names)]
        shape = tuple(map(len, labels))
        if math.prod(shape) > MOST_CELLS:
            raise InvalidSettingError(
                f"the joint of {', '.join(names)} has {math.prod(shape)} entries, "
                f"at most {MOST_CELLS} are possible: ask for fewer quantities"
            )
        rows, weights, without = self._weighed(given)
        codes = np.ravel_multi_index([self._rows.values[name][rows] for name in names], shape)
        occupied, codes = np.unique(codes, return_inverse=True)
        mass = estimate.shares(codes, weights)
        table = np.zeros(shape)
        table.flat[occupied] = mass
        error = np.full(shape, np.nan if without is None else 0.0)
        if without is not None:
            error.flat[occupied] = without.error(estimate.shares(codes, without.weights), mass)
            error = self._error_of_share(table, error, float(self._rows.weights[rows].sum()))
        coords: dict[str, Any] = dict(zip(names, map(list, labels), strict=True))
        return xr.DataArray(
            table, {**coords, "error": (names, error)}, dims=names, name="probability"
        )

    def probability(self, given: Mapping[str, Any] | None = None, **event: Any) -> Estimate:
        """Return P(event | given).

        Args:
            given: quantity -> value, what to condition on.
            **event: quantity -> value. A value is a label, a list of labels of which any will
                do, or for a strength an interval (low, high) in newtons.

        Example:
            ``post.probability(relation="friendly", given={"goal_red": "get to green agent"})``

        Raises:
            UnknownNameError: an unknown quantity or value; the message names close matches.
            InvalidSettingError: no event, a bad interval, or ``given`` has probability 0.
        """
        if not event:
            raise InvalidSettingError("name the event, as in probability(relation='friendly')")
        return self._number(estimate.share, self._satisfied(event), given)

    def top(
        self, name: str, n: int = N_TOP, *, given: Mapping[str, Any] | None = None
    ) -> list[tuple[str, Estimate]]:
        """Return the ``n`` most probable labels of a quantity, ties in label order.

        Raises:
            UnknownNameError, InvalidSettingError: as :meth:`marginal`; or ``n`` below 1.
        """
        n = whole_number("n", n)
        marginal = self.marginal(name, given=given)
        order = np.argsort(-marginal.values, kind="stable")[:n]
        labels, errors = marginal[name].values, marginal["error"].values
        return [(str(labels[i]), Estimate(marginal.values[i], errors[i])) for i in order]

    def mode(self, name: str, *, given: Mapping[str, Any] | None = None) -> Mode:
        """Return the most probable label of a quantity, the first in label order of equals.

        Its ``.error`` is the probability that another label leads in truth.

        Raises:
            UnknownNameError, InvalidSettingError: as :meth:`marginal`.
        """
        labels = self._quantity(name).categories()
        rows, weights, without = self._weighed(given)
        codes, size = self._rows.values[name][rows], len(labels)
        mass = estimate.shares(codes, weights, size)
        label = labels[int(mass.argmax())]
        if without is None:
            return Mode(label)
        return Mode(label, doubt(mass, without, estimate.shares(codes, without.weights, size)))

    def entropy(self, *names: str, given: Mapping[str, Any] | None = None) -> Estimate:
        """Return the entropy, in nats, of the joint distribution of quantities with categories.

        It is that of the weights; of few draws it comes out too low.

        Raises:
            UnknownNameError, InvalidSettingError: as :meth:`marginal`; or twice the same name.
        """
        codes = np.zeros(len(self._rows.weights), np.int64)
        for name in self._distinct(names):
            size = len(self._quantity(name).categories())
            _, codes = np.unique(codes * size + self._rows.values[name], return_inverse=True)
        rows, weights, without = self._weighed(given)
        number = float(estimate.entropy(estimate.shares(codes[rows], weights)))
        if without is None:
            return Estimate(number)
        numbers = estimate.entropy(estimate.shares(codes[rows], without.weights))
        return Estimate(number, float(without.error(numbers, number)))

    def mean(self, name: str, *, given: Mapping[str, Any] | None = None) -> Estimate:
        """Return the mean of a quantity with numbers, such as a strength in newtons."""
        return self._number(estimate.mean, self._numbers(name), given)

    def sd(self, name: str, *, given: Mapping[str, Any] | None = None) -> Estimate:
        """Return the standard deviation of a quantity with numbers."""
        return self._number(estimate.sd, self._numbers(name), given)

    def hdi(
        self,
        name: str,
        prob: float = HDI_PROBABILITY,
        *,
        given: Mapping[str, Any] | None = None,
    ) -> xr.DataArray:
        """Return the shortest interval with probability ``prob`` of a quantity with numbers.

        Returns:
            dim ``bound``: lower, upper, with their errors.

        Raises:
            UnknownNameError: no such quantity.
            InvalidSettingError: the quantity has no numbers, ``prob`` is not in (0, 1], or
                ``given`` has probability 0.
        """
        if not 0 < prob <= 1:
            raise InvalidSettingError(f"prob={prob} must lie in (0, 1]")
        values = self._numbers(name)
        rows, weights, without = self._weighed(given, LEFT_OUT_OF_INTERVALS)
        levels, codes = np.unique(values[rows], return_inverse=True)
        bounds = estimate.shortest_interval(levels, estimate.shares(codes, weights), prob)
        error = np.full(2, np.nan)
        if without is not None:
            masses = estimate.shares(codes, without.weights)
            error = without.error(
                [estimate.shortest_interval(levels, mass, prob) for mass in masses], bounds
            )
        coords = {"bound": ["lower", "upper"], "error": ("bound", error)}
        return xr.DataArray(list(bounds), coords, dims="bound", name=name)

    def query(self, question: str) -> Any:
        """Return the answer to a question in words, such as ``"P(relation=friendly)"``.

        The answer is that of the method that asks the same, as :mod:`phase_ppl.analysis.query`
        says, which also has the grammar.

        Raises:
            QueryError: it cannot be read or answered; the message points at the place.
        """
        from phase_ppl.analysis.query import answer

        return answer(self, self._quantities, question)

    def to_dataframe(self) -> pd.DataFrame:
        """Return one row per draw (or visited hypothesis): labels, numbers, ``weight``.

        Columns of quantities from :meth:`define` hold what the function returned.
        """
        columns: dict[str, Any] = dict(self._rows.index)
        for name, quantity in self._quantities.items():
            entries = self._rows.values[name]
            if quantity.labels is not None:
                own = name in self._own and quantity.values is not None
                entries = np.array(quantity.values if own else quantity.labels)[entries]
            columns[name] = entries
        return pd.DataFrame({**columns, "weight": self._rows.weights})
