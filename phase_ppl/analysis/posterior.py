"""The posterior over goals, relation and strengths, and what one can ask it."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis._arviz import arviz_data
from phase_ppl.analysis.diagnostics import diagnostics
from phase_ppl.analysis.hypotheses import Hypotheses
from phase_ppl.analysis.over_time import over_time
from phase_ppl.analysis.quantities import (
    ScenarioFunction,
    own_quantity,
    part_codes,
    quantities,
    relation_codes,
)
from phase_ppl.analysis.summary import summary, table
from phase_ppl.analysis.tree import (
    SIMULATED,
    array,
    check_tree,
    kept_scene,
    read_tree,
    simulation_of_draw,
    untried,
    without_burn_in,
    write_tree,
)
from phase_ppl.analysis.weights import WEIGHTINGS, chain_groups, halves
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, unknown_name
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis
from phase_ppl.world.scene import Scene


def log_joint(tree: xr.DataTree) -> NDArray[np.float64]:
    """Return (simulation,) log prior + log likelihood, -inf where not completed."""
    usable = array(tree, "simulations", "completed") & ~array(tree, "simulations", "failed")
    values = array(tree, "simulations", "log_prior_effective") + array(
        tree, "simulations", "log_likelihood"
    )
    return np.where(usable & ~np.isnan(values), values, -np.inf).astype(np.float64)


def best_simulation(tree: xr.DataTree) -> int:
    """Return the completed simulation with the highest log joint, the first of equals.

    Raises:
        InvalidSettingError: none was completed.
    """
    values = log_joint(tree)
    if not np.isfinite(values).any():
        raise InvalidSettingError("no simulation was completed, so there is no best hypothesis")
    return int(np.argmax(values))


def hypothesis_of(tree: xr.DataTree, simulation: int) -> Hypothesis:
    """Return the hypothesis, with its stated goals, that a simulation was made for."""
    row = tree["simulations"].dataset.isel(simulation=simulation)
    return Hypothesis(
        goal_red=int(row["stated_goal_red"]),
        goal_green=int(row["stated_goal_green"]),
        alpha=ALPHAS[int(row["alpha"])],
        strength_red=float(row["strength_red"]),
        strength_green=float(row["strength_green"]),
    )


def replay(tree: xr.DataTree) -> NDArray[np.float64]:
    """Return the stored trajectory (time, entity, coord) of the best hypothesis.

    That of the best simulation if a chain accepted it, otherwise that of the draw with the
    highest log joint, since only draws keep their trajectories.
    """
    is_best = simulation_of_draw(tree) == best_simulation(tree)
    draws = array(tree, "sample_stats", "log_joint")
    chosen = is_best if is_best.any() else draws == draws.max()
    chain, draw = np.argwhere(chosen)[0]
    trajectory = array(tree, SIMULATED, "trajectory")[chain, draw]
    return np.asarray(trajectory, np.float64)


# --- the posterior over goals, relation and strengths, and what one can ask it --------------------


class Posterior(Hypotheses):
    """Posterior over two agents' goals, their relation and their strengths.

    What one can ask it is in :class:`phase_ppl.analysis.hypotheses.Hypotheses`: ``marginal``,
    ``joint``, ``probability``, ``top``, ``mode``, ``entropy``, ``mean``, ``sd``, ``hdi``, each
    with its Monte-Carlo error, ``query`` for the same in words, ``define`` for quantities of your
    own, ``to_dataframe``.

    ``goal_red`` and ``goal_green`` are effective goals, what an agent acts on; the goals as
    stated before alpha is counted in are ``stated_goal_red`` and ``stated_goal_green``.
    ``relation`` and ``scenario`` follow from the two effective goals.

    Args:
        tree: draws and simulations, as inference writes them (``phase_ppl.analysis.tree``).
        weights: "count", "importance", "visited" or "likelihood" (``phase_ppl.analysis.weights``
            says when each is valid); None: what the run recorded as its default.
        burn_in: draws at the beginning of each chain that do not count; None: what the run
            recorded, a quarter of a run of twenty iterations or more, else none. Weights
            "importance" and "visited" are of all simulations.
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
        burn_in: int | None = None,
        scenario: ScenarioFunction | None = None,
    ) -> None:
        check_tree(tree)
        name = str(tree.attrs["weights"]) if weights is None else weights
        if name not in WEIGHTINGS:
            raise unknown_name("weights", name, WEIGHTINGS)
        n_draws = tree["posterior"].sizes["draw"]
        self._burn_in = whole_number(
            "burn_in", tree.attrs.get("burn_in", 0) if burn_in is None else burn_in, minimum=0
        )
        if self._burn_in >= n_draws:
            raise InvalidSettingError(
                f"burn_in={self._burn_in}, but each chain has {n_draws} draws: expected fewer"
            )
        self._tree = tree
        self._kept = without_burn_in(tree, self._burn_in)
        self._weights = name
        tree = self._kept
        rows = WEIGHTINGS[name](tree)
        columns = dict(rows.values)
        goals = columns["goal_red"], columns["goal_green"]
        columns |= relation_codes(*goals, scenario) | part_codes(*goals)
        known = quantities()
        for site in [name for name in columns if name not in known]:
            known[site], columns[site] = own_quantity(tree, site, columns[site])
        groups = chain_groups(tree)[rows.index["chain"]]
        rows = dataclasses.replace(rows, values=columns)
        super().__init__(known, rows, groups, halves(tree, name, rows))
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
    def burn_in(self) -> int:
        """How many draws at the beginning of each chain do not count."""
        return self._burn_in

    @property
    def untried(self) -> float:
        """Prior mass of the pairs of effective goals that no simulation was completed of.

        To these a sampled posterior gives probability 0, whatever they would explain; NaN for
        files of earlier versions, which do not hold the prior of pairs.
        """
        return untried(self._tree)

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

    @property
    def scene(self) -> Scene:
        """Where the event takes place, and how it starts."""
        return kept_scene(self._tree["constant_data"].to_dataset())

    def observed(self) -> FloatArray:
        """Return the trajectory (time, entity, [x, y, angle]) that was explained."""
        return np.asarray(array(self._tree, "observed_data", "trajectory"), np.float64)

    def diagnostics(self) -> dict[str, Any]:
        """Return how the chains went and a verdict; see :mod:`phase_ppl.analysis.diagnostics`."""
        errors = {name: self.top(name, 1)[0][1].error for name in ("goal_red", "goal_green")}
        return diagnostics(
            self._kept, self._weights, self._rows, errors, self._effective_size, self._scenario
        )

    def over_time(self) -> xr.Dataset:
        """Return the marginals on ever more of the video, in hindsight.

        See :func:`phase_ppl.analysis.over_time.over_time`; at the last frame they are those of
        weights ``"importance"`` where the kernel allows them, whatever the weighting in use.
        """
        return over_time(self._tree, self._scenario)

    @property
    def arviz(self) -> Any:
        """The draws, each counted once, for ArviZ, as in ``az.summary(post.arviz)``.

        See :func:`phase_ppl.analysis._arviz.arviz_data` for what is in there; nothing is simulated.
        """
        return arviz_data(self._kept, self._scenario)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write draws and simulations to ``path`` as NetCDF, whole or not at all.

        The weighting and the burn-in in use become the file's defaults.

        Raises:
            OutputError: the file cannot be written there, or its name does not end in .nc.
        """
        tree = self._tree.copy()
        tree.attrs["weights"], tree.attrs["burn_in"] = self._weights, self._burn_in
        return write_tree(tree, path)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        weights: str | None = None,
        *,
        burn_in: int | None = None,
        scenario: ScenarioFunction | None = None,
    ) -> Posterior:
        """Read a posterior that :meth:`save` wrote.

        Raises:
            InvalidEventError: there is no such file, or it is damaged or of another kind.
        """
        return cls(read_tree(path), weights, burn_in=burn_in, scenario=scenario)

    def summary(self) -> dict[str, Any]:
        """Return the posterior as plain data, fit for JSON (numbers that do not exist: None)."""
        return summary(self)

    def __str__(self) -> str:
        return table(self)

    def __repr__(self) -> str:
        chains, draws = array(self._tree, "posterior", "goal_red").shape
        return f"<Posterior of {self.event_id}: {chains} x {draws} draws, weights {self.weights!r}>"
