"""Kernels on a table of the closed loop: each simulation is a look-up.

Ten thousand draws take seconds, and the table's exact posterior is known. So kernels are compared
without the noise of simulations.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import random
from numpy.typing import NDArray

from phase_ppl.analysis.closed_loop_table import Table, table_of
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.tree import DRAW, SCHEMA
from phase_ppl.inference.draws import (
    PARTICLE,
    SITE,
    Columns,
    burn_in,
    grouped,
    hypothesis_columns,
    kept_iterations,
    particles_of,
    sites_of,
)
from phase_ppl.inference.registry import KernelInfo
from phase_ppl.inference.run import Data, Length, Run, clock, compiled_chains, make_kernel
from phase_ppl.inference.sampler import OF_RUNNER, Interrupted, RunOptions, started_again
from phase_ppl.models import priors
from phase_ppl.models.density import on_cpu
from phase_ppl.models.effective import (
    cells,
    log_prior_of_hypotheses,
    space_of_prior,
    strengths_apart,
)
from phase_ppl.models.likelihood import is_closed_loop
from phase_ppl.models.model import Model
from phase_ppl.models.program import Lookup
from phase_ppl.models.world_priors import log_prior_of_effective
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, SimulationError, check_memory, shown
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.identity import qualified_name, stable, versions
from phase_ppl.world.progress import Bar

if TYPE_CHECKING:
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior

ITERATIONS: Final = 1000
"""Default number of draws per chain."""

_BLOCK: Final = 64  # iterations that are compiled as one
_DRAW_BYTES, _FRAME_BYTES = 400, 28  # of memory that a draw takes, and each of its frames
_MOST_BYTES: Final = 2 * 10**9  # most memory of a run with a budget of seconds
_OF_SIMULATIONS: Final = (*OF_RUNNER, "checkpoint", "weights")


def event_of(read: ClosedLoopPosterior) -> Event:
    """Return the event that was read, up to the last frame that counts."""
    return Event(read.scene, Observation(read.observed()), id=read.event_id)


def model_of(read: ClosedLoopPosterior, model: Model | None) -> Model:
    """Return the model whose prior counts: the given one, else the one that read the video.

    Raises:
        InvalidSettingError: the prior is a user's own, which a file cannot hold; or the given model
            simulates, or reads the video in another way.
    """
    from phase_ppl.closed_loop.hidden_state import Tracking
    from phase_ppl.models.closed_loop import ClosedLoopLikelihood

    if model is None:
        prior: Any = read.prior
        if prior is None:
            recorded = read.settings["model"]["prior"]
            known = map(priors.named, priors.available())
            prior = next((one for one in known if qualified_name(one) == recorded), None)
        if prior is None:
            raise InvalidSettingError(
                f"the prior {recorded} is your own, which a file cannot hold: give the model, "
                "infer(post, model, kernel=...)"
            )
        model = Model(prior=prior)
    given, now = model.likelihood, read.settings.get("likelihood")
    as_read = False
    if is_closed_loop(given):
        counts = given.frame_weight(model.simulator is not None)
        as_read = now in (None, stable({**given.to_dict(), "weight": counts}))
    its_own = model.fingerprint()["simulator"] == read.settings["model"].get("simulator")
    parts = ("simulator", model.simulator, its_own), ("likelihood", given, as_read)
    for name, value, is_known in parts:
        if value is not None and not is_known:
            raise InvalidSettingError(
                f"{name}={shown(value)}: on a result of the closed loop a model can change the "
                "prior only, infer(post, Model(prior=...), kernel=...)"
            )
    if now is None:  # an older file does not say
        likelihood = ClosedLoopLikelihood(weight=float(read.dataset.attrs["weight"]))
    else:
        likelihood = ClosedLoopLikelihood(**{**now, "tracking": Tracking(**now["tracking"])})
    return Model(read.bound(model.prior), likelihood=likelihood)


def check_looked_up(options: RunOptions) -> None:
    """Raise InvalidSettingError if an option is for simulations; a table needs none."""
    for name in _OF_SIMULATIONS:
        if (value := getattr(options, name)) != getattr(RunOptions, name):
            raise InvalidSettingError(
                f"{name}={shown(value)} is for simulations: a kernel on a result of the closed "
                "loop looks everything up"
            )


def sample_table(read: ClosedLoopPosterior, run: Run, options: RunOptions) -> Posterior:
    """Return the posterior of a run that looks up every simulation in the closed loop's table.

    Raises:
        Interrupted: Ctrl-C; it carries the draws so far.
    """
    check_looked_up(options)
    found = ReadTable(read)
    data = run.data(0)._replace(table=found.lookup(run.recipe.n_frames))
    kernel = make_kernel(run.recipe, data)
    wanted = options.iterations
    if wanted is None and options.budget is None and not hasattr(kernel, "n_iterations"):
        wanted = ITERATIONS
    length = Length.of(kernel, run.info, run.chains, wanted, options.budget, run.n_frames)
    each = run.chains * (_DRAW_BYTES + _FRAME_BYTES * run.n_frames)
    n = _iterations(length, run.n_frames, each)
    with on_cpu():
        steps, stopped = _drawn(run, data, n, length.limit("seconds"), options, found)
    done = len(steps["sim_seed"]) - 1
    cost = {
        "simulations": length.at_most(done),
        "frames": 0,
        "failures": 0,
        "budget": options.budget and str(options.budget),
        "seconds": clock() - options.began,
        "seconds_reading": read.cost.get("seconds"),
        "searches": read.cost.get("searches"),
        "host": f"{platform.node()} ({platform.system()}, {platform.machine()})",
        "interrupted": stopped,
    }
    # planner and tracking are those of the reading; the prior may differ
    record = run.record(done)
    as_read = {k: v for k, v in read.settings.get("model", {}).items() if "prior" not in k}
    record["model"] |= as_read
    attrs = {
        "kernel": run.info.name,
        "validity": getattr(kernel, "validity", run.info.validity),
        "settings": json.dumps({**record, "read": read.settings}, default=repr),
        "cost": json.dumps(cost),
        "versions": json.dumps(versions()),
    }
    tree = _table_tree(run.event, run.model, run.info, steps, found, attrs)
    post = Posterior(tree)
    if stopped:
        raise Interrupted(post)
    return post


def _iterations(length: Length, n_frames: int, n_bytes: int) -> int:
    """Return the most iterations of a run; a budget counts look-ups.

    Each iteration takes ``n_bytes`` of memory.
    """
    most = min(length.limit("simulations"), length.limit("frames") / n_frames)
    if length.iterations is not None:
        n = length.iterations
    elif most == math.inf:  # a budget of seconds; memory is the limit
        n = max(1, _MOST_BYTES // n_bytes)
    else:
        at_start = length.at_most(0)
        n = max(1, math.ceil((most - at_start) / (length.at_most(1) - at_start)))
    check_memory(f"{length.chains} chains of {n} draws of {n_frames} frames", n * n_bytes)
    return n


def _drawn(
    run: Run, data: Data, n: int, seconds: float, options: RunOptions, found: ReadTable
) -> tuple[Columns, bool]:
    """Return particles (iteration + 1, chain, ...), and whether Ctrl-C ended the run.

    There are ``n`` iterations, or as many as ``seconds`` allow.
    """
    start, advance = compiled_chains(run.recipe, _BLOCK)
    number = int(np.random.SeedSequence(run.seed).generate_state(1)[0])
    try:
        state = start(data, random.split(random.key(number), run.chains))
    except KeyboardInterrupt:
        raise Interrupted(None) from None
    sites = {f"{SITE}{name}": np.asarray(value) for name, value in state.z.items()}
    possible = np.asarray(np.isfinite(found.errors(sites)).all(axis=-1))
    if not possible.any():
        raise SimulationError("no initial hypothesis is possible given the closed loop's table")
    state = started_again(state, possible)
    # as the first of blocks (iteration, chain, ...)
    told = [{name: one[None] for name, one in particles_of(state).items()}]
    done, stopped = 0, False
    try:
        with Bar(n, 0, options.progress, "iteration", run.info.name) as bar:
            while done < n and clock() - options.began < seconds:
                state, states = advance(data, state)
                told.append(particles_of(states))
                bar.update(min(_BLOCK, n - done))
                done += _BLOCK
    except KeyboardInterrupt:
        stopped = True
    steps = {name: np.concatenate([one[name] for one in told])[: n + 1] for name in told[0]}
    return steps, stopped


def _table_tree(
    event: Event,
    model: Model,
    kernel: KernelInfo,
    steps: Columns,
    found: ReadTable,
    attrs: Mapping[str, Any],
) -> xr.DataTree:
    """Return the tree of draws of a run whose simulations were looked up in a table.

    ``steps`` are the particles (iteration, chain, ...). The tree's simulations are the hypotheses
    that its chains visited, in order.
    """
    space, n_iterations = space_of_prior(model.prior), len(steps["sim_seed"]) - 1
    iterations = kept_iterations(n_iterations, kernel)
    drawn = {name: np.moveaxis(values[list(iterations)], 0, 1) for name, values in steps.items()}
    shape = drawn["sim_seed"].shape
    moved = np.ones(shape, np.bool_)
    sites = sites_of(drawn)
    if shape[1] > 1:
        each = [values.reshape(*shape, -1) for values in sites.values()]
        moved[:, 1:] = np.any([(v[:, 1:] != v[:, :-1]).any(axis=2) for v in each], axis=0)
    index = np.cumsum(moved.ravel()).reshape(shape) - 1
    raw = {name: values[moved] for name, values in sites.items()}
    table = hypothesis_columns(raw, space)
    names = list(table)
    goals = np.stack([table[name] for name in space.goal_sites], axis=1).astype(np.int64)
    strengths = {name: table[name] for name in space.strength_sites}
    newtons = np.stack(list(strengths.values()), axis=1)
    errors, without = found.errors_of(goals, newtons), found.log_likelihood_without(goals, newtons)
    chain, draw = np.nonzero(moved)
    n = len(chain)
    log_prior, effective = _log_priors(model, raw, goals, strengths)
    table |= {
        "seed": drawn["sim_seed"][moved].astype(np.int64),
        "chain": chain,
        "iteration": np.asarray(iterations)[draw],
        "log_prior": log_prior,
        "log_prior_effective": effective,
        "log_likelihood": -errors.sum(axis=1),
        "total_error": errors.sum(axis=1),
        "completed": np.asarray(np.isfinite(errors).all(axis=1)),
        "frames_simulated": np.zeros(n, np.int64),
        "failed": np.zeros(n, np.bool_),
    }
    stats: dict[str, Any] = {
        "log_joint": (DRAW, (table["log_prior"] + table["log_likelihood"])[index]),
        "total_error": (DRAW, table["total_error"][index]),
        "frames_simulated": (DRAW, np.zeros(shape, np.int64)),
        "sim_seed": (DRAW, table["seed"][index]),
        "step_error": ((*DRAW, "time"), errors.astype(np.float32)[index]),
    }
    stats |= {name: (DRAW, drawn[name]) for name in PARTICLE if not np.isnan(drawn[name]).all()}
    if without is not None:
        stats["log_likelihood_without"] = ((*DRAW, "planner_seed"), without.T[index])
    tree = grouped(event, model, names, table, index, stats, -errors)
    counted = 0 if kernel.weighted else burn_in(shape[1])
    tree.attrs = {"event_id": event.id, "weights": "count", "burn_in": counted, "schema": SCHEMA}
    tree.attrs |= attrs
    return tree


def _log_priors(
    model: Model, raw: Columns, goals: NDArray[np.int64], strengths: Columns
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (row,) log priors of hypotheses, and of hypotheses by effective goals."""
    log_prior = log_prior_of_hypotheses(model.prior, raw)
    if not strengths_apart(model.prior):
        return log_prior, log_prior_of_effective(model.prior, goals, strengths)
    # computed per pair of goals, since strengths are a separate factor
    pairs, of_pair = np.unique(goals, axis=0, return_inverse=True)
    typical = {name: np.full(len(pairs), values[0]) for name, values in strengths.items()}
    by_pair = log_prior_of_effective(model.prior, pairs, typical)
    of_strengths = log_prior_of_hypotheses(model.prior, strengths)
    return log_prior, by_pair[of_pair.reshape(-1)] + of_strengths - of_strengths[0]


class ReadTable:
    """The closed loop's table, in nats below the best explanation of each frame.

    It is by effective goals; for a user's own simulator also by strengths.
    """

    def __init__(self, read: ClosedLoopPosterior) -> None:
        table = table_of(read.dataset.isel(time=slice(None, read.frame + 1)))
        weight = float(table.found.attrs["weight"])
        frames = np.array([table.of_frame(t)[0] for t in range(table.n_frames)])
        likelihood = self._on_grid(frames, table)
        best = likelihood.max(axis=tuple(range(1, likelihood.ndim)))
        self._frames = weight * (best.reshape(-1, *[1] * (likelihood.ndim - 1)) - likelihood)
        self._edges = cells(np.array(table.levels))[1:-1]
        strengths = np.log(table.of_strengths(table.n_frames - 1))
        n = len(table.levels)
        self._strengths = (strengths.max() - strengths).reshape((n,) * table.space.n_agents)
        self._space = table.space
        self._change: FloatArray | None = None
        if not table.is_exact:  # a user's own density is
            without = table.summed(table.n_frames - 1)[1:]
            without = weight * (self._on_grid(without, table) - best.sum())
            with np.errstate(invalid="ignore"):  # -inf both with and without the set
                self._change = np.nan_to_num(without + self._frames.sum(axis=0), neginf=-np.inf)

    def _on_grid(self, values: FloatArray, table: Table) -> FloatArray:
        """Return log likelihoods (..., goal, ..., level, ...) by agent, of (..., goals, ...).

        -inf of what was not asked; levels where strengths were read along with goals.
        """
        values = np.where(np.isnan(values), -np.inf, values)
        if not table.users_simulator:
            return table.on_grid(values)
        levels = (len(table.levels),) * table.space.n_agents
        found = np.moveaxis(table.on_grid(np.moveaxis(values, -1, 1)), 1, -1)
        return found.reshape(*found.shape[:-1], *levels)

    def lookup(self, n_frames: int) -> Lookup:
        """Return the table for compiled code, padded to ``n_frames`` frames."""
        beyond = [(0, n_frames - len(self._frames)), *[(0, 0)] * (self._frames.ndim - 1)]
        frames = np.pad(self._frames, beyond).astype(np.float32)
        return Lookup(
            jnp.asarray(frames), jnp.asarray(self._strengths, jnp.float32), jnp.asarray(self._edges)
        )

    def errors(self, sites: Mapping[str, NDArray[Any]]) -> FloatArray:
        """Return (row, time) errors, nats, of particles given by columns."""
        space = self._space
        raw = {name: sites[f"{SITE}{name}"] for name in space.sites}
        strengths = np.stack([raw[name] for name in space.strength_sites], axis=1)
        return self.errors_of(space.effective(raw), strengths)

    def errors_of(self, goals: NDArray[Any], strengths: NDArray[Any]) -> FloatArray:
        """Return (row, time) the errors, nats, of (row, agent) goals and strengths."""
        errors = self._frames[:, *self._place(goals, strengths, self._frames.ndim - 1)].T.copy()
        errors[:, 0] += self._strengths[*np.searchsorted(self._edges, strengths).T]
        return errors

    def log_likelihood_without(
        self, goals: NDArray[Any], strengths: NDArray[Any]
    ) -> FloatArray | None:
        """Return (set, row) log likelihoods without each set of searches, less those with all.

        None where the table is exact.
        """
        if self._change is None:
            return None
        place = self._place(goals, strengths, self._change.ndim - 1)
        return np.asarray(self._change[:, *place])

    def _place(self, goals: NDArray[Any], strengths: NDArray[Any], n: int) -> Any:
        """Return the index of goals, or of goals and strengths, in a table of ``n`` dimensions."""
        return [*goals.T, *np.searchsorted(self._edges, strengths).T][:n]
