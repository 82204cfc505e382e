"""The sampled posterior over goals, relation and strengths."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis import estimate
from phase_ppl.analysis import tree as trees
from phase_ppl.analysis.diagnostics import Diagnostics, diagnostics, simulations_of
from phase_ppl.analysis.event_posterior import EventPosterior, answer_lines
from phase_ppl.analysis.quantities import Vocabulary, users_quantity
from phase_ppl.analysis.weights import (
    WEIGHTINGS,
    chain_groups,
    halves,
    log_sum_exp,
    normalised,
    so_far,
)
from phase_ppl.analysis.with_arviz import are_equal
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, check_name, whole_number
from phase_ppl.world.files import existing_file
from phase_ppl.world.picture import wrapped

if TYPE_CHECKING:
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior

HINDSIGHT: Final = (
    "Hindsight, not what an observer believed at the time: the hypotheses were proposed from the "
    "whole video, and are weighted by how well they explain it up to each frame."
)
"""Goes with every result over time."""

_ARRIVED: Final = 0.5
"""Least effective share of the chains (Kish), weighted by their densities, at which they count as
having reached the same place."""

_MOST_UNTRIED: Final = 0.5
"""Largest prior mass of untried goals, if suggested goals fit no better than others."""


class Posterior(EventPosterior):
    """Sampled posterior over agents' goals, their relation and their strengths.

    Methods for questions are described in :class:`phase_ppl.analysis.hypotheses.Hypotheses`;
    :mod:`phase_ppl.analysis.quantities` lists the quantities. ``goal_red`` and the like are
    effective goals; ``stated_goal_red`` and the like are stated goals, without alpha. Relation and
    scenario follow from the two effective goals.

    Args:
        tree: draws and simulations, as inference writes them (``phase_ppl.analysis.tree``).
        weights: what is weighted: "count", the draws, as the kernel weights them; or "stratified",
            all simulations (see the glossary). ``phase_ppl.analysis.weights`` says when each is
            valid. None: the run's default.
        burn_in: number of first draws of each chain that do not count. None: the run's default, a
            quarter if chains have twenty or more draws, else 0. Weights "stratified" ignore it:
            they use all simulations.

    Raises:
        InvalidEventError: ``tree`` lacks something; the message names it.
        UnknownNameError: there is no such weighting.
        InvalidSettingError: ``tree`` cannot be weighted in this way, or ``burn_in`` leaves no draw.
    """

    def __init__(
        self,
        tree: xr.DataTree,
        weights: str | None = None,
        *,
        burn_in: int | None = None,
    ) -> None:
        trees.check_tree(tree)
        n_draws = tree["posterior"].sizes["draw"]
        self._weights = str(tree.attrs["weights"]) if weights is None else weights
        check_name("weights", self._weights, WEIGHTINGS)
        given = tree.attrs.get("burn_in", 0) if burn_in is None else burn_in
        self._burn_in = whole_number("burn_in", given, minimum=0)
        if self._burn_in >= n_draws:
            raise InvalidSettingError(
                f"burn_in={self._burn_in}, but each chain has {n_draws} draws: expected fewer"
            )
        self._tree = tree
        self._counted = counted = tree.isel(draw=slice(self._burn_in, None))  # simulations all stay
        rows = WEIGHTINGS[self._weights](counted)
        words = Vocabulary(trees.space_of_tree(tree))
        columns, known = words.completed(rows.values), dict(words.quantities)
        for site in [name for name in columns if name not in known]:
            known[site], columns[site] = users_quantity(counted, site, columns[site])
        groups, parts = (
            chain_groups(tree)[rows.index["chain"]],
            halves(counted, self._weights, rows),
        )
        rows = dataclasses.replace(rows, values=columns, groups=groups, halves=parts)
        super().__init__(words, tree.attrs, tree["constant_data"].to_dataset(), known, rows)
        stats = counted["sample_stats"].dataset
        self._looked_up = "log_likelihood_without" in stats
        if self._looked_up:
            change = stats["log_likelihood_without"].values.reshape(len(rows.weights), -1).T
            weights_without = rows.weights * np.exp(change - change.max(axis=1, keepdims=True))
            self._without_sets = weights_without / weights_without.sum(axis=1, keepdims=True)

    def _jackknife(self, share: float) -> estimate.Jackknife | estimate.Jackknives | None:
        """Return the jackknife that errors come from.

        Draws from a closed loop's table have its error too: its sets of searches disagree for any
        kernel. With a single set the error is unknown.
        """
        over_chains = self._over_chains(share)
        if over_chains is not None and self._attrs.get("adapts"):
            factor = estimate.LEARNT**2 * over_chains.factor
            over_chains = dataclasses.replace(over_chains, factor=factor)
        if not self._looked_up:
            return over_chains
        over_sets = estimate.over_sets(self._without_sets)
        if over_chains is None or over_sets is None:
            return None
        return estimate.Jackknives((over_chains, over_sets))

    @functools.cached_property
    def _needed(self) -> float:
        if self._looked_up:
            return super()._needed
        told = trees.suggestion_agreement(self._tree)
        if told >= estimate.TOLD:
            return estimate.FEW_WHERE_TOLD
        # suggested goals fit no better than others, and most goals were not tried
        misled = told < estimate.MISLED and self.untried > _MOST_UNTRIED
        return math.inf if misled else super()._needed

    @functools.cached_property
    def _unseen(self) -> float:
        # chains can still reach unseen goals; a fitted proposal may not
        return trees.unseen_share(self._tree) if self._attrs.get("adapts") else 0.0

    @functools.cached_property
    def _luck(self) -> FloatArray | None:
        # a noisy simulator comes near the video by luck: goals without such luck may be as probable
        # as goals with it
        if not self._attrs.get("adapts") or "draw" not in self._rows.index:
            return None
        log_weight = trees.log_weight_of_draws(self._counted).ravel()
        place = trees.simulation_of_draw(self._counted).ravel()
        log_likelihood = trees.array(self._tree, "simulations", "log_likelihood")[place]
        known = (place >= 0) & np.isfinite(log_weight + log_likelihood)
        log_weight = np.where(known, log_weight, -np.inf)
        log_likelihood = np.where(known, log_likelihood, 0.0)
        decides = normalised(log_weight)
        lucky = float(decides @ log_likelihood)
        luck = np.exp(log_weight - log_likelihood + lucky - log_sum_exp(log_weight))
        return np.where(known, luck, np.nan)

    def _most_effective(self) -> float:
        """Return the most independent draws that the draws can be worth.

        It is Kish's size of their simulations: draws that did not move, and particles of one
        ancestor, count once. If the log joint shows that chains have not reached the others, only
        the best chains count.
        """
        if "draw" not in self._rows.index:
            return super()._most_effective()
        names = [*self._words.space.kept_columns, "sim_seed"]
        stats = self._counted["sample_stats"].dataset
        columns = {
            name: trees.array(self._counted, "posterior", name).ravel() for name in names[:-1]
        }
        frame = pd.DataFrame({**columns, "sim_seed": stats["sim_seed"].values.ravel()})
        visited = frame.groupby(names, sort=False).ngroup().to_numpy()
        size = estimate.kish_size(estimate.shares(visited, self._rows.weights))
        if len(stats["draw"]) == 1 and "log_evidence" in stats:
            # a population was resampled repeatedly
            return size / 2
        if not are_equal(self._rows.weights) or trees.are_weighted(self._counted):
            return size
        level = stats["log_joint"].values.mean(axis=1)
        arrived = estimate.kish_size(normalised(np.where(np.isfinite(level), level, -np.inf)))
        return size if arrived >= _ARRIVED * len(level) else min(size, arrived)

    @classmethod
    def from_numpyro(cls, mcmc: Any, program: Any = None) -> Posterior:
        """Return the posterior of a run of NumPyro's ``MCMC`` on a :func:`phase_ppl.program`.

        Nothing is simulated again. All draws that NumPyro kept count; its warm-up does not.

        Args:
            mcmc: the ``MCMC`` after its ``run``, with all sites sampled.
            program: the program that was sampled; needed if the kernel does not hold it.

        Raises:
            InvalidSettingError: nothing was run yet, sites are missing, or ``program`` is needed.
        """
        model: Any = getattr(mcmc.sampler, "program", None) if program is None else program
        model = getattr(mcmc.sampler, "model", None) if model is None else model
        model = getattr(model, "__self__", model)  # of a method such as ``program.uniform``
        if not hasattr(model, "draws"):
            raise InvalidSettingError(
                f"the model of {type(mcmc.sampler).__name__} is no phase_ppl.program: expected "
                "Posterior.from_numpyro(mcmc, program)"
            )
        return cls(model.draws(mcmc))

    @property
    def tree(self) -> xr.DataTree:
        """The draws and simulations, as ``phase_ppl.analysis.tree`` describes them."""
        return self._tree

    @property
    def weights(self) -> str:
        """Name of the weighting in use: "count" or "stratified"."""
        return self._weights

    @property
    def burn_in(self) -> int:
        """Number of first draws of each chain that do not count."""
        return self._burn_in

    @property
    def untried(self) -> float:
        return trees.untried(self._tree)

    @property
    def log_evidence(self) -> estimate.Estimate:
        """Log p(video) under the model's likelihood, in nats.

        If the likelihood is tempered, so is this. The density is per frame in units^-d, with d = 8
        in PHASE: x and y of each body.

        The kernels ``importance``, ``amis`` and ``smc`` estimate it. ``importance`` and ``amis``
        give an error, by the jackknife over chains. The error of ``smc`` is NaN: repeat the run
        with other seeds to see it. The estimate itself is NaN in three cases: the kernel gives
        none, the prior was changed since, or the run sampled the closed loop's posterior, which
        has its own ``log_evidence``. ``why`` of the estimate says which.
        """
        stats, why = self._tree["sample_stats"].dataset, ""
        if self._looked_up:
            why = "the closed loop that was sampled has it: ask its log_evidence"
        elif trees.changed_text(self.settings):
            why = "of the prior before it was changed: infer anew"
        elif "log_evidence" not in stats:
            why = f"{self._attrs['kernel']} does not estimate it: use smc, importance or amis"
        if why:
            return estimate.Estimate(math.nan, why=why)
        value, log_weight = float(stats["log_evidence"].values[0, -1]), stats["log_weight"].values
        groups = chain_groups(self._tree)
        n = int(groups.max()) + 1
        if log_weight.shape[1] == 1 or n < 2:  # a population, or a single chain
            what = "a single population or chain does not tell the error"
            return estimate.Estimate(value, why=f"{what}: repeat with other seeds")
        mass = np.bincount(groups, normalised(log_weight.ravel()).reshape(log_weight.shape).sum(1))
        size = np.bincount(groups) / len(groups)
        with np.errstate(divide="ignore", invalid="ignore"):  # all is of one group
            error = math.sqrt((n - 1) * np.var(np.log((1 - mass) / (1 - size))))
        factor = estimate.LEARNT if self._attrs.get("adapts") else 1.0
        if math.isfinite(error):
            return estimate.Estimate(value, factor * error)
        return estimate.Estimate(value, why="a few chains have all the weight: take more")

    def under(self, prior: Callable[..., object]) -> Posterior:
        tree = trees.reweighted(self._tree, self.bound(prior))
        changed = self._under_weights(self._weights, tree)
        sizes = (
            estimate.kish_size(changed.table.weights),
            estimate.kish_size(self.table.weights),
        )
        trees.check_overlap(sizes, (1 - changed.untried, 1 - self.untried))
        tree.attrs["settings"] = trees.settings_under(
            tree.attrs["settings"], prior, effective_size=sizes[0], effective_size_before=sizes[1]
        )
        return changed

    def _under_weights(self, weights: str, tree: xr.DataTree | None = None) -> Posterior:
        other = Posterior(self._tree if tree is None else tree, weights, burn_in=self._burn_in)
        return other._defining(self._defined)

    def map(self) -> Any:
        """Return the hypothesis of the completed simulation with the highest log joint.

        The log joint is log prior + log likelihood. All simulations count, accepted or not. The
        simulator is noisy, so this is the best single simulation. The hypothesis' goals are stated
        goals; the simulator got its ``.effective_goals``, which decide ``.relation`` and
        ``.scenario``.

        Returns:
            A :class:`phase_ppl.Hypothesis`.
        """
        row = self._tree["simulations"].dataset.isel(simulation=self._best_simulation())
        space = self._words.space
        sites = zip(space.sites, space.kept_columns, strict=True)
        return space.hypothesis({site: row[name].item() for site, name in sites})

    def map_record(self) -> dict[str, Any]:
        goals = zip(self._words.space.goal_sites, self.map().effective_goals, strict=True)
        codes = self._words.relation_codes({name: np.array([goal]) for name, goal in goals})
        labels = {n: self._quantities[n].categories()[int(c[0])] for n, c in codes.items()}
        return {**super().map_record(), "log_joint": float(self._log_joint().max()), **labels}

    def _log_joint(self) -> FloatArray:
        """Return (simulation,) log prior + log likelihood, -inf where not completed."""
        simulations = self._tree["simulations"].dataset
        values = (simulations["log_prior_effective"] + simulations["log_likelihood"]).values
        usable = trees.completed(self._tree) & ~np.isnan(values)
        return np.where(usable, values, -np.inf).astype(np.float64)

    def _best_simulation(self) -> int:
        """Return the completed simulation with the highest log joint, the first of equals."""
        values = self._log_joint()
        if not np.isfinite(values).any():
            raise InvalidSettingError("no simulation was completed, so there is no best hypothesis")
        return int(np.argmax(values))

    def replay(self) -> FloatArray:
        """Return (time, entity, [x, y, angle]) the stored simulation of the best hypothesis.

        It is the simulation of :meth:`map` if a chain accepted it. Otherwise it is the simulation
        of the draw with the highest log joint, because only trajectories of draws are kept. Nothing
        is simulated again. If the run sampled the closed loop's posterior, it is the observed
        trajectory.
        """
        if "trajectory" not in self._tree[trees.SIMULATED].dataset:
            return self.observed()  # the closed loop conditions on it, frame by frame
        is_best = trees.simulation_of_draw(self._tree) == self._best_simulation()
        draws = trees.array(self._tree, "sample_stats", "log_joint")
        chain, draw = np.argwhere(is_best if is_best.any() else draws == draws.max())[0]
        trajectory = trees.array(self._tree, trees.SIMULATED, "trajectory")
        return np.asarray(trajectory[chain, draw], np.float64)

    def observed(self) -> FloatArray:
        return np.asarray(trees.array(self._tree, "observed_data", "trajectory"), np.float64)

    def diagnostics(self) -> Diagnostics:
        """Return diagnostics of the chains, with a verdict on whether to trust the posterior.

        It is a dictionary; :mod:`phase_ppl.analysis.diagnostics` lists its keys. ``print`` shows a
        table.
        """
        found = diagnostics(
            self._counted,
            self._weights,
            self._rows,
            self.leaders(),
            self._effective_size,
            self._needed,
            self._words,
        )
        return Diagnostics(self.event_id, found)

    def over_time(self) -> xr.Dataset:
        """Return the marginals given the first frames, for every frame, in hindsight.

        Hypotheses were proposed from the whole video, and are weighted by how well they explain it
        up to each frame. So this is not what an observer believed at the time. Nothing is
        simulated.

        Weights are ``"stratified"``, whatever :attr:`weights` is. If proposals have no known
        density, they are ``"count"``, whose draws show little of the belief at early frames.

        Returns:
            Probabilities (time, label) of ``goal_red``, ``goal_green``, ``relation`` and
            ``scenario``, or of the goals and relations of another world. Labels of ``goal_red`` are
            in ``goal_red_is``, and so on. ``time`` is in simulated seconds. The attribute
            ``hindsight`` is a warning in words; ``weights`` is the weighting used.
        """
        weighting, rows, weights = so_far(self._counted)
        codes = self._words.completed(self._simulated(rows))
        tables = {
            name: weights.T @ (codes[name][:, None] == np.arange(len(self.quantities[name] or ())))
            for name in (*self.goals_of.values(), *self.relations_of.values(), *self.scenarios_of)
        }
        time = trees.array(self._tree, "observed_data", "time")
        return self._along_time(time, tables, hindsight=HINDSIGHT, weights=weighting)

    def _simulated(self, rows: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """Return the columns of the hypotheses of simulations ``rows``."""
        simulations = self._tree["simulations"].dataset
        return {name: simulations[name].values[rows] for name in self._words.space.columns}

    def why(self, event: str, over: str | None = None) -> xr.Dataset:
        _, rows, weights = so_far(self._counted)
        sides = self._sides(self._simulated(rows), event, over)
        for_it, against = (weights[side].sum(axis=0) for side in sides)
        for side, mass in ((event, for_it), (over or f"not {event}", against)):
            if not (mass > 0).all():
                raise InvalidSettingError(f"{side}: no simulation shows it, so there are no odds")
        odds = np.log(for_it / against)
        return self._odds(odds, np.full(len(odds), np.nan), event, over, hindsight=HINDSIGHT)

    @property
    def arviz(self) -> Any:
        if self._weights == "stratified" or trees.are_weighted(self._counted):
            return super().arviz
        return self._as_chains("all of the chains")

    @property
    def chains(self) -> Any:
        """The original chains after the burn-in, for ArviZ: R-hat, effective sizes, traces.

        ``az.rhat(post.chains)``, ``az.ess``, ``az.plot_trace`` and ``az.plot_rank`` take them.
        Every draw counts once, under any weights. Groups and attributes are those of :attr:`arviz`,
        plus the group ``sample_stats``.

        Each label of a goal or relation has an indicator, 0 or 1. An indicator that is constant
        within every half of a chain has no R-hat and is left out; the posterior's attribute
        ``left_out`` (JSON) names it. With fewer than ten draws per chain ArviZ's effective sizes
        are fixed by its formula, whatever the draws: see :meth:`diagnostics`.

        Raises:
            InvalidSettingError: the draws have weights of their own, so they are not chains.
        """
        if trees.are_weighted(self._counted):
            raise InvalidSettingError(
                f"the draws of this posterior (kernel {self._attrs['kernel']!r}) have weights of "
                "their own and are no chains: post.arviz has equal draws resampled from them, "
                "post.to_dataframe() has all with their weights"
            )
        counted = self if self._weights == "count" else self._under_weights("count")
        return counted._as_chains("all of the chains, each counted once", moving=True)

    def _as_chains(self, how: str, *, moving: bool = False) -> Any:
        """Return the draws that are counted, chain by chain."""
        rows = np.arange(len(self._rows.weights)).reshape(trees.shape_of_draws(self._counted))
        stats = self._counted["sample_stats"].to_dataset()
        how += f", after a burn-in of {self._burn_in}" if self._burn_in else ""
        return self._for_arviz(rows, self._beside, how, moving=moving, sample_stats=stats)

    @property
    def _weighting(self) -> str:
        return self._weights

    @property
    def _beside(self) -> dict[str, NDArray[Any]]:
        if self._weights != "stratified":
            stats = self._counted["sample_stats"].dataset
            return {name: stats[name].values.ravel() for name in ("log_joint", "total_error")}
        found = self._tree["simulations"].dataset.isel(simulation=self._rows.index["simulation"])
        log_joint = found["log_prior"].values + found["log_likelihood"].values
        return {"log_joint": log_joint, "total_error": found["total_error"].values}

    def _to_keep(self) -> tuple[dict[str, xr.Dataset], dict[str, Any]]:
        tree = self._tree.copy()
        tree.attrs["weights"], tree.attrs["burn_in"] = self._weights, self._burn_in
        return {node.path: node.to_dataset(inherit=False) for node in tree.subtree}, {}

    def _head(self, found: Mapping[str, Any]) -> str:
        after = self.burn_in and self.weights == "count"
        return (
            f"{self.event_id}: {found['particles']} particles x {found['iterations']} iterations, "
            f"{found['kernel']}, weights {found['weights']}"
            + (f", after a burn-in of {self.burn_in}" if after else "")
        )

    def _body(self, found: Mapping[str, Any]) -> list[str]:
        n, off = self.observed().shape[1], found["best_error_per_frame"]
        fit = f"the best draw is off by {off:.2f} units a frame"
        fit += "" if n == 1 else f" (root of the summed squared distances of {n} bodies)"
        told = {"errors": ""}
        if (size := self._effective_size) < estimate.FEW_DRAWS:
            told["errors"] = (
                "where an answer has all the weight or none, its error is what "
                f"{size:.1f} independent draws leave open (Jeffreys)"
            )
        told |= {"prior": trees.changed_text(self.settings), "likelihood": self.tempering}
        told |= {"fit": fit, "cost": _cost(self.cost, found)}
        lines = [line for name, text in told.items() if text for line in wrapped(name, text)]
        return [*answer_lines(self, self._untried), "", *lines]

    def _untried(self, name: str) -> frozenset[str]:
        """Return the labels of a quantity that nothing was simulated for, where anything was."""
        if self._looked_up:
            return frozenset()
        tried_at_all = np.flatnonzero(~trees.array(self._tree, "simulations", "failed"))
        tried = self._words.completed(self._simulated(tried_at_all))[name]
        labels = self._quantities[name].categories()
        return frozenset(labels) - {labels[code] for code in np.unique(tried).tolist()}

    @property
    def tempering(self) -> str:
        beta = self._tree[trees.SIMULATED].attrs.get("beta")
        if beta is not None:
            noise = 2 * self.observed().shape[1] / beta
            x0, x1, y0, y1 = self.scene.arena
            far = noise > max(x1 - x0, y1 - y0)
            words = f"a frame's likelihood is exp(-{beta:g} x distance)"
            if far:
                return f"tempered: {words}, so one frame says next to nothing"
            return f"{words}, as noise of {noise:.0f} units"
        counts = self._tree[trees.SIMULATED].attrs.get("frame_weight", 1.0)
        return f"the closed loop's, tempered: a frame counts {counts:g}" if counts != 1 else ""

    def __repr__(self) -> str:
        chains, draws = trees.shape_of_draws(self._tree)
        return f"<Posterior of {self.event_id}: {chains} x {draws} draws, weights {self.weights!r}>"


def _cost(cost: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    simulations = found["simulations"]
    known = {
        "frames": ", {:d} frames",
        "budget": " (of a budget of {}),",
        "seconds": " in {:.0f} s",
        "workers": f" on {{:d}} worker{'' if cost.get('workers') == 1 else 's'}",
        "seconds_overhead": " ({:.0f} s of it outside simulations)",
    }
    told = [words.format(cost[name]) for name, words in known.items() if cost.get(name) is not None]
    stopped = "none stopped early"
    if n := simulations["aborted"]:
        saved = f"{found['frames_saved_share']:.0%} of the frames"
        stopped = f"{n} stopped early as too far off, which saved {saved}"
    again = f", {cost['retries']} run again" if cost.get("retries") else ""
    failed = cost.get("failures", simulations["failed"])
    total = f"{simulations['total']} simulations{simulations_of(found)}"
    return f"{total}{''.join(told)}; {stopped}; {failed} failed{again}"


def load_posterior(
    path: str | os.PathLike[str],
    weights: str | None = None,
    *,
    burn_in: int | None = None,
) -> Posterior | ClosedLoopPosterior:
    """Read a saved posterior, sampled or of the closed loop.

    Args:
        path: the .nc file.
        weights: weighting of a sampled posterior, as in :class:`Posterior`; by default the saved
            one.
        burn_in: burn-in of a sampled posterior, as in :class:`Posterior`; by default the saved one.

    Raises:
        InvalidEventError: there is no such file, or it is damaged or of another kind.
        InvalidSettingError: ``weights`` or ``burn_in`` is given for a posterior of the closed loop,
            which has no draws.
        UnknownNameError: there is no such weighting.
    """
    from phase_ppl.analysis.closed_loop_posterior import FRAME, ClosedLoopPosterior
    from phase_ppl.analysis.closed_loop_table import SCHEMA
    from phase_ppl.data.hdf5 import read_netcdf

    source = existing_file(path)
    try:
        groups = dict(read_netcdf(source))
        read = groups["/"]
        if not str(read.attrs.get("schema")).startswith(SCHEMA.partition("/")[0] + "/"):
            return Posterior(xr.DataTree.from_dict(groups), weights, burn_in=burn_in)
        for name, given in (("weights", weights), ("burn_in", burn_in)):
            if given is not None:
                raise InvalidSettingError(
                    f"{name}={given!r}, but a posterior of the closed loop has no draws to weight: "
                    f"leave {name} out"
                )
        return ClosedLoopPosterior(read, read.attrs.pop(FRAME, None))
    except (InvalidEventError, InvalidSettingError) as error:
        raise type(error)(f"{source}: {error}") from None
