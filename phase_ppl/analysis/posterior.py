"""The posterior over goals, relation and strengths, and what one can ask it."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis._arviz import arviz_data
from phase_ppl.analysis.best import best_simulation, hypothesis_of, log_joint, replay
from phase_ppl.analysis.diagnostics import diagnostics
from phase_ppl.analysis.over_time import over_time
from phase_ppl.analysis.quantities import (
    Quantity,
    ScenarioFunction,
    own_quantity,
    quantities,
    relation_codes,
    shortest_interval,
)
from phase_ppl.analysis.summary import summary, table
from phase_ppl.analysis.tree import array, check_tree, read_tree, write_tree
from phase_ppl.analysis.weights import WEIGHTINGS
from phase_ppl.world.errors import InvalidSettingError, unknown_name
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import Hypothesis

FloatArray = NDArray[np.float64]

HDI_PROBABILITY: Final = 0.94
"""Mass of the intervals that summaries report."""


class Posterior:
    """Posterior over two agents' goals, their relation and their strengths.

    ``goal_red`` and ``goal_green`` are effective goals, what an agent acts on; the goals as
    stated before alpha is counted in are ``stated_goal_red`` and ``stated_goal_green``.
    ``relation`` and ``scenario`` follow from the two effective goals.

    Args:
        tree: draws and simulations, as inference writes them (``phase_ppl.analysis.tree``).
        weights: "count", "visited" or "likelihood" (``phase_ppl.analysis.weights`` says when
            each is valid); None: what the run recorded as its default.
        scenario: replaces the paper's scenario of two effective goals: (goal of red, goal of
            green) -> one of "collaborative", "independent", "competing", "opposing". The
            relation follows from it.

    Raises:
        InvalidEventError: the tree lacks something; the message names it.
        UnknownNameError: there is no such weighting, or ``scenario`` returned no scenario.
        InvalidSettingError: the tree cannot be weighted in this way.
    """

    def __init__(
        self,
        tree: xr.DataTree,
        weights: str | None = None,
        *,
        scenario: ScenarioFunction | None = None,
    ) -> None:
        check_tree(tree)
        name = str(tree.attrs["weights"]) if weights is None else weights
        if name not in WEIGHTINGS:
            raise unknown_name("weights", name, WEIGHTINGS)
        self._tree = tree
        self._weights = name
        rows = WEIGHTINGS[name](tree)
        columns = dict(rows.values)
        columns |= relation_codes(columns["goal_red"], columns["goal_green"], scenario)
        self._quantities = quantities()
        for site in [name for name in columns if name not in self._quantities]:
            self._quantities[site], columns[site] = own_quantity(tree, site, columns[site])
        self._rows = dataclasses.replace(rows, values=columns)
        self._scenario = scenario

    @property
    def tree(self) -> xr.DataTree:
        """The draws and simulations."""
        return self._tree

    @property
    def weights(self) -> str:
        """Name of the weighting in use."""
        return self._weights

    @property
    def event_id(self) -> str:
        """Name of the event that was explained."""
        return str(self._tree.attrs["event_id"])

    @property
    def settings(self) -> dict[str, Any]:
        """What determined the result."""
        return dict(json.loads(self._tree.attrs["settings"]))

    @property
    def cost(self) -> dict[str, Any]:
        """What the run cost: simulations, seconds, workers."""
        return dict(json.loads(self._tree.attrs["cost"]))

    def marginal(self, name: str) -> xr.DataArray:
        """Return the probability of every value of a quantity.

        Args:
            name: goal_red, goal_green, relation, scenario, alpha, stated_goal_red,
                stated_goal_green, or a categorical site of the user's own.

        Returns:
            Probabilities over the labels (goal strings and so on), sum 1.

        Raises:
            UnknownNameError: no such quantity; the message names close matches.
            InvalidSettingError: the quantity is a real number.
        """
        quantity = self._quantity(name)
        labels = quantity.categories()
        mass = np.bincount(self._rows.values[name], self._rows.weights, minlength=len(labels))
        return xr.DataArray(mass, {name: list(labels)}, name="probability")

    def joint(self, first: str, second: str) -> xr.DataArray:
        """Return the joint probability of two categorical quantities, dims (first, second).

        Raises:
            UnknownNameError, InvalidSettingError: as :meth:`marginal`; or twice the same name.
        """
        if first == second:
            raise InvalidSettingError(f"joint needs two different quantities, not {first!r} twice")
        one, other = self._quantity(first).categories(), self._quantity(second).categories()
        mass = np.zeros((len(one), len(other)))
        np.add.at(mass, (self._rows.values[first], self._rows.values[second]), self._rows.weights)
        return xr.DataArray(mass, {first: list(one), second: list(other)}, name="probability")

    def probability(self, given: Mapping[str, Any] | None = None, **event: Any) -> float:
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
        happened = self._satisfied(event)
        condition = self._satisfied(given or {})
        weights = self._rows.weights
        mass = float(weights[condition].sum())
        if not mass > 0:
            raise InvalidSettingError(
                f"cannot condition on {dict(given or {})}: it has probability 0 in this posterior"
            )
        return float(min(weights[happened & condition].sum() / mass, 1.0))

    def top(self, name: str, n: int = 3) -> list[tuple[str, float]]:
        """Return the ``n`` most probable labels of a quantity, ties in label order.

        Raises:
            UnknownNameError, InvalidSettingError: as :meth:`marginal`; or ``n`` below 1.
        """
        if n < 1:
            raise InvalidSettingError(f"n={n} must be at least 1")
        marginal = self.marginal(name)
        order = np.argsort(-marginal.values, kind="stable")[:n]
        labels = marginal[name].values
        return [(str(labels[i]), float(marginal.values[i])) for i in order]

    def mean(self, name: str) -> float:
        """Return the mean of a real quantity, such as a strength in newtons."""
        return float(self._numbers(name) @ self._rows.weights)

    def sd(self, name: str) -> float:
        """Return the standard deviation of a real quantity."""
        squares = (self._numbers(name) - self.mean(name)) ** 2
        return float(np.sqrt(squares @ self._rows.weights))

    def hdi(self, name: str, prob: float = HDI_PROBABILITY) -> xr.DataArray:
        """Return the shortest interval with probability ``prob`` of a real quantity.

        Returns:
            dim ``bound``: lower, upper.

        Raises:
            UnknownNameError: no such quantity.
            InvalidSettingError: the quantity has categories, or ``prob`` is not in (0, 1].
        """
        if not 0 < prob <= 1:
            raise InvalidSettingError(f"prob={prob} must lie in (0, 1]")
        values = self._numbers(name)
        bounds = shortest_interval(values, self._rows.weights, prob)
        return xr.DataArray(list(bounds), {"bound": ["lower", "upper"]}, name=name)

    def map(self) -> Hypothesis:
        """Return the hypothesis of the completed simulation with the highest log joint.

        Among all simulations that were paid for, accepted or not. Its goals are the stated
        ones, as the simulator takes them; ``.effective_goals``, ``.relation`` and ``.scenario``
        give the rest. The simulator is noisy, so this is the best single simulation.
        """
        return hypothesis_of(self._tree, best_simulation(self._tree))

    def map_record(self) -> dict[str, Any]:
        """Return :meth:`map` as plain data.

        ``goal_*`` are the effective goals and ``stated_goal_*`` the stated ones, as everywhere;
        with alpha, strengths, ``log_joint``, ``relation`` and ``scenario``.
        """
        row = best_simulation(self._tree)
        best = hypothesis_of(self._tree, row)
        record = best.to_dict()
        red, green = best.effective_goals
        codes = relation_codes(np.array([red]), np.array([green]), self._scenario)
        return {
            "goal_red": GOALS[red],
            "goal_green": GOALS[green],
            "stated_goal_red": record.pop("goal_red"),
            "stated_goal_green": record.pop("goal_green"),
            **record,
            "log_joint": float(log_joint(self._tree)[row]),
            **{name: self._quantities[name].categories()[int(c[0])] for name, c in codes.items()},
        }

    def replay(self) -> FloatArray:
        """Return the stored simulation (time, entity, [x, y, angle]) of the best hypothesis.

        That of :meth:`map` if a chain accepted it. Only trajectories of draws are kept, so
        otherwise that of the draw with the highest log joint. Nothing is simulated again.
        """
        return replay(self._tree)

    def observed(self) -> FloatArray:
        """Return the trajectory (time, entity, [x, y, angle]) that was explained."""
        return np.asarray(array(self._tree, "observed_data", "trajectory"), np.float64)

    def diagnostics(self) -> dict[str, Any]:
        """Return how the chains went and a verdict; see :mod:`phase_ppl.analysis.diagnostics`."""
        return diagnostics(self._tree, self._weights, self._rows, self._scenario)

    def over_time(self) -> xr.Dataset:
        """Return the marginals on ever more of the video, in hindsight.

        See :func:`phase_ppl.analysis.over_time.over_time`; at the last frame they are those of
        weights ``"visited"``, whatever the weighting in use.
        """
        return over_time(self._tree, self._scenario)

    @property
    def arviz(self) -> Any:
        """The draws, each counted once, for ArviZ, as in ``az.summary(post.arviz)``.

        See :func:`phase_ppl.analysis._arviz.arviz_data` for what is in there; nothing is simulated.
        """
        return arviz_data(self._tree, self._scenario)

    def to_dataframe(self) -> pd.DataFrame:
        """Return one row per draw (or visited hypothesis): labels, strengths, ``weight``."""
        columns: dict[str, Any] = dict(self._rows.index)
        for name, quantity in self._quantities.items():
            values = self._rows.values[name]
            columns[name] = values if quantity.labels is None else np.array(quantity.labels)[values]
        return pd.DataFrame({**columns, "weight": self._rows.weights})

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write draws and simulations to ``path`` as NetCDF, whole or not at all.

        The weighting in use becomes the file's default.

        Raises:
            OutputError: the file cannot be written there, or its name does not end in .nc.
        """
        tree = self._tree.copy()
        tree.attrs["weights"] = self._weights
        return write_tree(tree, path)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        weights: str | None = None,
        *,
        scenario: ScenarioFunction | None = None,
    ) -> Posterior:
        """Read a posterior that :meth:`save` wrote.

        Raises:
            InvalidEventError: there is no such file, or it is damaged or of another kind.
        """
        return cls(read_tree(path), weights, scenario=scenario)

    def summary(self) -> dict[str, Any]:
        """Return the posterior as plain data, fit for JSON (numbers that do not exist: None)."""
        return summary(self)

    def __str__(self) -> str:
        return table(self)

    def __repr__(self) -> str:
        chains, draws = array(self._tree, "posterior", "goal_red").shape
        return f"<Posterior of {self.event_id}: {chains} x {draws} draws, weights {self.weights!r}>"

    def _quantity(self, name: str) -> Quantity:
        if name not in self._quantities:
            raise unknown_name("quantity", name, self._quantities)
        return self._quantities[name]

    def _satisfied(self, conditions: Mapping[str, Any]) -> NDArray[np.bool_]:
        result = np.ones(len(self._rows.weights), bool)
        for name, wanted in conditions.items():
            result &= self._quantity(name).satisfied(self._rows.values[name], wanted)
        return result

    def _numbers(self, name: str) -> FloatArray:
        if self._quantity(name).labels is not None:
            raise InvalidSettingError(
                f"{name} has categories, not numbers; ask for its marginal or top"
            )
        return np.asarray(self._rows.values[name], np.float64)
