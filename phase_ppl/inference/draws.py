"""The particles of a run, and the tree of draws made from them and the simulations."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.tree import (
    DRAW,
    FIRST_FAILURE,
    FRAME,
    SCHEMA,
    SIMULATED,
    SIMULATION,
    scene_dataset,
)
from phase_ppl.analysis.weights import has_proposals
from phase_ppl.inference.registry import KernelInfo
from phase_ppl.models.bridge import Record, request_key
from phase_ppl.models.effective import space_of_prior
from phase_ppl.models.likelihood import RadialLikelihood, is_closed_loop
from phase_ppl.models.model import Model
from phase_ppl.models.world_priors import kept_prior, log_prior_of_effective
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import FRAMES_PER_SECOND, Event
from phase_ppl.world.space import ALPHA_SITE, HypothesisSpace

Columns = dict[str, NDArray[Any]]  # name -> an array with one row per particle, or per simulation

LONG: Final = 20
"""Fewest iterations at which a chain's draws are counted, without the first quarter.

Shorter chains, such as the paper's, have hardly left their start. If the kernel's proposals have a
density, all their simulations are weighed instead (``benchmarks/estimates.py``)."""

SITE: Final = "z/"  # prefix of those columns of particles that are sites


PARTICLE: Final = {
    "accepted": (False, np.bool_),
    "window": (-1, np.int64),
    "log_weight": (0.0, np.float64),
    "log_evidence": (np.nan, np.float64),
}
"""Column of particles -> its value where a kernel's state has no such field, and its type."""

PARTICLE_COLUMNS: Final = ("sim_seed", *PARTICLE)


class Particles(NamedTuple):
    """The fields of a kernel's state that are kept; None: it has no such field."""

    z: dict[str, Any]
    sim_seed: Any
    accepted: Any = None
    window: Any = None
    log_weight: Any = None
    log_evidence: Any = None

    @classmethod
    def of(cls, state: Any) -> Particles:
        """Return the kept fields of a state."""
        found: list[Any] = [getattr(state, name, None) for name in cls._fields]
        return cls(*found)


def particles_of(state: Any) -> Columns:
    """Return the particles of a kernel's state, on the host.

    Columns are (chain, ...): the hypotheses, site by site; the seeds of their simulations; whether
    the iteration's proposal was accepted; and the first frame of its window (-1: none). Also the
    log weight of the draw up to a constant (0: the kernel gives none), and the log evidence of the
    observation (NaN: the kernel does not estimate it).
    """
    seed = np.asarray(state.sim_seed).astype(np.int64)
    columns = {f"{SITE}{name}": np.asarray(value) for name, value in state.z.items()}
    columns["sim_seed"] = seed
    for name, (default, dtype) in PARTICLE.items():
        given = getattr(state, name, None)
        values = np.full(seed.shape, default) if given is None else np.asarray(given)
        columns[name] = values.astype(dtype)
    return columns


def sites_of(particles: Columns) -> Columns:
    """Return the hypotheses of particles, site by site."""
    return {k.removeprefix(SITE): v for k, v in particles.items() if k.startswith(SITE)}


def kept_iterations(done: int, kernel: KernelInfo) -> range:
    """Return the iterations after which the particles are draws of the posterior.

    0 is the initial particles; they count if there are no others.
    """
    first = {"last": done, "all": min(done, 1), "start": 0}[kernel.keeps]
    return range(first, done + 1)


def burn_in(n_draws: int) -> int:
    """Return the default burn-in: how many first draws of a chain do not count."""
    return n_draws // 4 if n_draws >= LONG else 0


def build_tree(
    event: Event,
    model: Model,
    kernel: KernelInfo,
    particles: Sequence[Columns],
    records: Sequence[Record],
    attrs: Mapping[str, Any],
) -> xr.DataTree:
    """Return the tree of draws of a run (:mod:`phase_ppl.analysis.tree`).

    Particles are the initial ones and those after every iteration; the kernel says which are draws.
    """
    iterations = kept_iterations(len(particles) - 1, kernel)
    tree = tree_of(event, model, [particles[i] for i in iterations], records, iterations)
    n_draws = len(iterations)
    short = n_draws < LONG and not kernel.weighted and has_proposals(tree)
    tree.attrs = {
        "event_id": event.id,
        "weights": "stratified" if short else "count",
        "burn_in": 0 if kernel.weighted else burn_in(n_draws),
        "schema": SCHEMA,
        **({"adapts": 1} if kernel.adapts else {}),
        **attrs,
    }
    return tree


def tree_of(
    event: Event,
    model: Model,
    steps: Sequence[Columns],
    records: Sequence[Record],
    iterations: range | None = None,
) -> xr.DataTree:
    """Return the tree of draws of the particles ``steps``, without attributes.

    ``iterations`` are those after which the particles were taken; None: unknown.
    """
    space = space_of_prior(model.prior)
    users = [name for name in records[0].sites if name not in space.sites]
    raw = {name: np.array([r.sites[name] for r in records]) for name in (*space.sites, *users)}
    table = hypothesis_columns(raw, space)
    sites = list(table)
    errors = np.array([record.result.errors for record in records])
    simulated = np.isfinite(errors)
    # frames that were not simulated count as without error: a bound where a simulation was stopped
    by_frame = model.error_likelihood.log_prob(np.where(simulated, errors, 0.0))
    table |= _results(records, table, by_frame.sum(axis=1), model, space)
    index = _records_of_draws(steps, records)
    stats = _sample_stats(steps, iterations, records, table, index)
    explained = np.where(simulated, by_frame, np.nan).astype(np.float64)
    trajectory = _trajectories(records, index)
    tree = grouped(event, model, sites, table, index, stats, explained, trajectory)
    for result in (record.result for record in records if record.result.failure is not None):
        told = f"of [{result.hypothesis}] with seed {result.seed}: {result.failure}"
        tree["simulations"].attrs[FIRST_FAILURE] = told
        break
    return tree


def grouped(
    event: Event,
    model: Model,
    sites: Sequence[str],
    table: Columns,
    index: NDArray[np.int64],
    stats: Mapping[str, Any],
    step_log_likelihood: NDArray[np.float64],
    trajectory: NDArray[np.float32] | None = None,
) -> xr.DataTree:
    """Return the tree of draws (chain, draw) at rows ``index`` of a table of simulations.

    The columns ``sites`` of the table are hypotheses; ``stats`` are of draws.
    """
    space = space_of_prior(model.prior)
    draws = {"chain": np.arange(index.shape[0]), "draw": np.arange(index.shape[1])}
    time = ("time", np.arange(event.observation.n_frames) / FRAMES_PER_SECOND, {"units": "s"})
    frame = {"time": time, "entity": list(space.world.entities), "coord": ["x", "y", "angle"]}
    shown = {} if trajectory is None else {"trajectory": ((*DRAW, *FRAME), trajectory)}
    explained = {"long_name": "log likelihood of each frame; NaN where not simulated"}
    groups = {
        "posterior": xr.Dataset(
            {name: _variable(name, DRAW, table[name][index], space) for name in sites}, draws
        ),
        "sample_stats": xr.Dataset(stats, {**draws, "time": time}),
        SIMULATED: xr.Dataset(shown, {**draws, **frame} if shown else None, _tempering(model)),
        "observed_data": xr.Dataset({"trajectory": (FRAME, event.observation.trajectory)}, frame),
        "simulations": xr.Dataset(
            {name: _variable(name, SIMULATION, values, space) for name, values in table.items()}
            | {"step_log_likelihood": ((*SIMULATION, "time"), step_log_likelihood, explained)},
            {"time": time},
        ),
        "constant_data": scene_dataset(event.scene).assign(kept_prior(model.prior)),
    }
    return xr.DataTree.from_dict(groups)


def _tempering(model: Model) -> dict[str, float]:
    """Return the tempering of a likelihood of this package, as attributes."""
    likelihood = model.likelihood
    if is_closed_loop(likelihood):
        return {"frame_weight": likelihood.frame_weight(model.simulator is not None)}
    return {"beta": likelihood.beta} if type(likelihood) is RadialLikelihood else {}


def numbers_of(records: Sequence[Record]) -> Columns:
    """Return the numbers known of each simulation, one row each."""
    results = [record.result for record in records]
    return {
        "seed": np.array([result.seed for result in results], np.int64),
        "chain": np.array([record.chain for record in records], np.int64),
        "iteration": np.array([record.iteration for record in records], np.int64),
        **{
            name: np.array([getattr(record, name) for record in records], np.float64)
            for name in ("log_prior", "log_proposal", "log_bound", "log_again")
        },
        "n_again": np.array([record.n_again for record in records], np.int64),
        "completed": np.array([result.completed for result in results], np.bool_),
        "frames_simulated": np.array([r.frames_simulated for r in results], np.int64),
    }


def _results(
    records: Sequence[Record],
    sites: Columns,
    log_likelihood: NDArray[np.float64],
    model: Model,
    space: HypothesisSpace,
) -> Columns:
    """Return the results of each simulation, and its prior."""
    results = [record.result for record in records]
    goals = np.stack([sites[name] for name in space.goal_sites], axis=1).astype(np.int64)
    strengths = {name: sites[name] for name in space.strength_sites}
    failed = np.array([result.failure is not None for result in results])
    return {
        **numbers_of(records),
        "log_prior_effective": log_prior_of_effective(model.prior, goals, strengths),
        "log_likelihood": np.where(failed, -np.inf, log_likelihood),
        "total_error": np.where(failed, np.inf, [result.total_error for result in results]),
        "failed": failed,
    }


def hypothesis_columns(raw: Mapping[str, NDArray[Any]], space: HypothesisSpace) -> Columns:
    """Return effective and stated goals, alpha, strengths and own sites as they are stored."""
    effective = space.effective(raw).astype(np.int16)
    columns: Columns = {name: effective[:, i] for i, name in enumerate(space.goal_sites)}
    for name, stated in zip(space.goal_sites, space.stated_sites, strict=True):
        columns[stated] = raw[name].astype(np.int16)
    way = raw[ALPHA_SITE]
    columns[ALPHA_SITE] = way.astype(np.int8 if len(space.ways) < 128 else np.int16)
    columns |= {name: raw[name].astype(np.float64) for name in space.strength_sites}
    return columns | {name: values for name, values in raw.items() if name not in space.sites}


def _records_of_draws(steps: Sequence[Columns], records: Sequence[Record]) -> NDArray[np.int64]:
    """Return (chain, draw) the index of each draw's simulation."""
    rows = {
        request_key(record.sites, record.result.seed): row
        for row, record in enumerate(records)
        if record.result.completed
    }
    index = np.empty((len(steps[0]["sim_seed"]), len(steps)), np.int64)
    for draw, step in enumerate(steps):
        sites = sites_of(step)
        for chain, seed in enumerate(step["sim_seed"]):
            here = {name: values[chain] for name, values in sites.items()}
            row = rows.get(request_key(here, int(seed)))
            index[chain, draw] = _nearest(here, int(seed), records) if row is None else row
    return index


def _nearest(sites: Mapping[str, Any], seed: int, records: Sequence[Record]) -> int:
    """Return the completed simulation of that seed whose hypothesis is nearest.

    XLA may compute a number twice, for the request and for the state, and round it differently.
    """

    def apart(row: int) -> float:
        asked = records[row].sites
        return sum(float(np.abs(asked[name] - value).sum()) for name, value in sites.items())

    found = [row for row, one in enumerate(records) if one.result.seed == seed]
    done = [row for row in found if records[row].result.completed]
    if not done:
        raise InvalidSettingError(
            f"a draw (simulator's seed {seed}) rests on no completed simulation: its chain began "
            "where simulations fail, and had not moved yet; expected a longer warm-up"
        )
    return min(done, key=apart)


def _sample_stats(
    steps: Sequence[Columns],
    iterations: range | None,
    records: Sequence[Record],
    table: Columns,
    index: NDArray[np.int64],
) -> dict[str, Any]:
    errors = np.array([record.result.errors for record in records], np.float32)
    paid = {"long_name": "frames simulated for this iteration's proposal, accepted or not"}
    weight = {"long_name": "log weight of the draw, up to a constant; 0 where all are equal"}
    drawn = {name: np.stack([step[name] for step in steps], axis=1) for name in PARTICLE}
    stats = {
        "log_joint": (DRAW, (table["log_prior"] + table["log_likelihood"])[index]),
        "total_error": (DRAW, table["total_error"][index], {"units": "units of length"}),
        "accepted": (DRAW, drawn["accepted"]),
        "window": (DRAW, drawn["window"]),
        "sim_seed": (DRAW, table["seed"][index]),
        "step_error": ((*DRAW, "time"), errors[index]),
        "log_weight": (DRAW, drawn["log_weight"], weight),
    }
    if iterations is not None:
        frames = np.zeros((len(index), iterations[-1] + 1), np.int64)
        within = table["iteration"] < frames.shape[1]
        where = table["chain"][within], table["iteration"][within]
        np.add.at(frames, where, table["frames_simulated"][within])
        stats["frames_simulated"] = (DRAW, frames[:, list(iterations)], paid)
    if not np.isnan(drawn["log_evidence"]).all():
        stats["log_evidence"] = (DRAW, drawn["log_evidence"])
    return stats


def _trajectories(records: Sequence[Record], index: NDArray[np.int64]) -> NDArray[np.float32]:
    distinct, inverse = np.unique(index, return_inverse=True)
    stored = np.stack([records[row].result.trajectory for row in distinct]).astype(np.float32)
    return stored[inverse.reshape(index.shape)]


def _variable(
    name: str, dims: tuple[str, ...], values: NDArray[Any], space: HypothesisSpace
) -> tuple[Any, ...]:
    attrs: dict[str, Any] = {}
    if name in (*space.goal_sites, *space.stated_sites):
        meanings = json.dumps(space.world.goals)
        attrs = {"flag_values": np.arange(space.n_goals), "flag_meanings": meanings}
    elif name in space.strength_sites:
        attrs = {"units": "N"}
    more_dims = tuple(f"{name}_dim_{i}" for i in range(values.ndim - len(dims)))
    return (*dims, *more_dims), values, attrs
