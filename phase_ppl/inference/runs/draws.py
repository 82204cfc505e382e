"""Building the tree of draws from what the particles did and what was simulated."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.tree import SCHEMA, SIMULATED
from phase_ppl.analysis.weights import has_proposals
from phase_ppl.inference.registry import KernelInfo
from phase_ppl.inference.runs.chains import Step
from phase_ppl.models.bridge import Record
from phase_ppl.models.effective import log_prior_of_effective, prior_of_pairs
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES, HYPOTHESIS_SITES, STRENGTH_SITES
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS, effective_goals
from phase_ppl.world.hypothesis import ALPHAS
from phase_ppl.world.identity import versions
from phase_ppl.world.names import ENTITIES, LANDMARKS
from phase_ppl.world.observation import FRAMES_PER_SECOND

LONG: Final = 20
"""Iterations from which on the draws of a chain are counted, the first quarter left out.

Shorter chains, such as the paper's, have hardly left where they began: their simulations are
weighed by importance where the kernel's proposals have a density (``benchmarks/estimates.py``)."""

_STORED: Final = {
    **dict.fromkeys((*GOAL_SITES, *(f"stated_{name}" for name in GOAL_SITES)), np.int16),
    ALPHA_SITE: np.int8,
    **dict.fromkeys(STRENGTH_SITES, np.float64),
}
_PAIR: Final = ("chain", "draw")
_SIMULATION: Final = ("simulation",)
_FRAME: Final = ("time", "entity", "coord")

Columns = dict[str, NDArray[Any]]


@dataclasses.dataclass(frozen=True)
class Drawn:
    """The particles that are draws of the posterior.

    Attributes:
        steps: (draw,) the particles.
        iterations: (draw,) the iteration after which they stood so; 0 for the initial ones.
        weighted: whether they carry weights of their own.
    """

    steps: Sequence[Step]
    iterations: Sequence[int]
    weighted: bool = False

    @classmethod
    def kept(cls, start: Step, steps: Sequence[Step], kernel: KernelInfo) -> Drawn:
        """Return those of a run that ``kernel`` keeps: the initial ones if there are no others."""
        numbered = list(enumerate((start, *steps)))
        if kernel.keeps == "last":
            numbered = numbered[-1:]
        elif kernel.keeps == "all" and steps:
            numbered = numbered[1:]
        return cls([s for _, s in numbered], [i for i, _ in numbered], kernel.weighted)


def burn_in(n_draws: int) -> int:
    """Return how many of the first draws of a chain do not count by default."""
    return n_draws // 4 if n_draws >= LONG else 0


def build_tree(
    event: Event,
    model: Model,
    drawn: Drawn,
    records: Sequence[Record],
    attrs: Mapping[str, Any],
) -> xr.DataTree:
    """Return the tree of draws of a run (:mod:`phase_ppl.analysis.tree`).

    Args:
        event: what was explained; its scene, observation and id are stored.
        model: prior and likelihood.
        drawn: the particles that are draws.
        records: every simulation.
        attrs: further root attributes.
    """
    table = _simulation_table(records, model)
    index = _records_of_draws(drawn.steps, records)
    draw_coords = {"chain": np.arange(index.shape[0]), "draw": np.arange(index.shape[1])}
    time = ("time", np.arange(event.observation.n_frames) / FRAMES_PER_SECOND, {"units": "s"})
    frame_coords = {"time": time, "entity": list(ENTITIES), "coord": ["x", "y", "angle"]}
    sites = [name for name in table if name not in _RESULT_COLUMNS]
    groups = {
        "posterior": xr.Dataset(
            {name: _variable(name, _PAIR, table[name][index]) for name in sites}, draw_coords
        ),
        "sample_stats": xr.Dataset(
            _sample_stats(drawn, records, table, index), {**draw_coords, "time": time}
        ),
        SIMULATED: xr.Dataset(
            {"trajectory": ((*_PAIR, *_FRAME), _trajectories(records, index))},
            {**draw_coords, **frame_coords},
            {"beta": model.likelihood.beta} if type(model.likelihood) is RadialLikelihood else {},
        ),
        "observed_data": xr.Dataset(
            {"trajectory": (_FRAME, event.observation.trajectory)}, frame_coords
        ),
        "simulations": xr.Dataset(
            {
                **{name: _variable(name, _SIMULATION, values) for name, values in table.items()},
                "step_log_likelihood": (
                    (*_SIMULATION, "time"),
                    _step_log_likelihood(records, model),
                    {"long_name": "log likelihood of each frame; NaN where not simulated"},
                ),
            },
            {"time": time},
        ),
        "constant_data": _scene_dataset(event).assign(
            prior_of_pairs=(("pair_red", "pair_green"), prior_of_pairs(model.prior))
        ),
    }
    tree = xr.DataTree.from_dict(groups)
    n_draws = index.shape[1]
    short = n_draws < LONG and not drawn.weighted and has_proposals(tree)
    tree.attrs = {
        "event_id": event.id,
        "weights": "importance" if short else "count",
        "burn_in": 0 if drawn.weighted else burn_in(n_draws),
        "versions": json.dumps(versions()),
        "schema": SCHEMA,
        **attrs,
    }
    return tree


_RESULT_COLUMNS: Final = (
    *("seed", "chain", "iteration", "log_prior", "log_prior_effective", "log_likelihood"),
    *(
        "log_proposal",
        "log_bound",
        "log_again",
        "total_error",
        "completed",
        "frames_simulated",
        "failed",
    ),
)


def _simulation_table(records: Sequence[Record], model: Model) -> Columns:
    """Return one row per simulation: sites, then what came out."""
    results = [record.result for record in records]
    own = [name for name in records[0].sites if name not in HYPOTHESIS_SITES]
    sites = (*HYPOTHESIS_SITES, *own)
    raw = {name: np.array([record.sites[name] for record in records]) for name in sites}
    table = _hypothesis_columns(raw) | {name: raw[name] for name in own}
    effective = np.stack([table[name] for name in GOAL_SITES], axis=1).astype(np.int64)
    strengths = {name: table[name] for name in STRENGTH_SITES}
    errors = np.array([result.errors for result in results])
    # what was not simulated counts as without error: a bound for simulations stopped early
    simulated = np.where(np.isfinite(errors), errors, 0.0)
    log_likelihood = model.likelihood.log_prob(simulated).sum(axis=1)
    failed = np.array([result.failure is not None for result in results])
    return table | {
        "seed": np.array([result.seed for result in results], np.int64),
        "chain": np.array([record.chain for record in records], np.int64),
        "iteration": np.array([record.iteration for record in records], np.int64),
        **{
            name: np.array([getattr(record, name) for record in records], np.float64)
            for name in ("log_prior", "log_proposal", "log_bound", "log_again")
        },
        "log_prior_effective": log_prior_of_effective(model.prior, effective, strengths),
        "log_likelihood": np.where(failed, -np.inf, log_likelihood),
        "total_error": np.where(failed, np.inf, [result.total_error for result in results]),
        "completed": np.array([result.completed for result in results], np.bool_),
        "frames_simulated": np.array([r.frames_simulated for r in results], np.int64),
        "failed": failed,
    }


def _step_log_likelihood(records: Sequence[Record], model: Model) -> NDArray[np.float64]:
    """Return (simulation, time) the log likelihood of the frames that were simulated."""
    errors = np.array([record.result.errors for record in records])
    simulated = np.isfinite(errors)
    by_frame = model.likelihood.log_prob(np.where(simulated, errors, 0.0))
    return np.where(simulated, by_frame, np.nan).astype(np.float64)


def _hypothesis_columns(raw: Columns) -> Columns:
    """Return effective and stated goals, alpha and strengths as they are stored."""
    stated = np.stack([raw[name] for name in (*GOAL_SITES, ALPHA_SITE)], axis=1)
    effective = np.array([effective_goals(red, green, ALPHAS[a]) for red, green, a in stated])
    columns = {name: effective[:, i] for i, name in enumerate(GOAL_SITES)}
    columns |= {f"stated_{name}": raw[name] for name in GOAL_SITES}
    columns |= {name: raw[name] for name in (ALPHA_SITE, *STRENGTH_SITES)}
    return {name: values.astype(_STORED[name]) for name, values in columns.items()}


def _records_of_draws(steps: Sequence[Step], records: Sequence[Record]) -> NDArray[np.int64]:
    """Return (chain, draw) the simulation that each draw rests on."""
    rows = {
        _key(record.sites, record.result.seed): row
        for row, record in enumerate(records)
        if record.result.completed
    }
    index = np.empty((len(steps[0].sim_seed), len(steps)), np.int64)
    for draw, step in enumerate(steps):
        for chain, seed in enumerate(step.sim_seed):
            sites = {name: values[chain] for name, values in step.sites.items()}
            index[chain, draw] = rows[_key(sites, int(seed))]
    return index


def _key(sites: Mapping[str, NDArray[Any]], seed: int) -> tuple[Any, ...]:
    return (seed, *(sites[name].tobytes() for name in sorted(sites)))


def _sample_stats(
    drawn: Drawn, records: Sequence[Record], table: Columns, index: NDArray[np.int64]
) -> dict[str, Any]:
    steps = drawn.steps
    errors = np.array([record.result.errors for record in records], np.float32)
    frames = np.zeros((len(index), max(drawn.iterations) + 1), np.int64)
    within = table["iteration"] < frames.shape[1]
    where = table["chain"][within], table["iteration"][within]
    np.add.at(frames, where, table["frames_simulated"][within])
    paid = {"long_name": "frames simulated for this iteration's proposal, accepted or not"}
    weight = {"long_name": "log weight of the draw, up to a constant; 0 where all are equal"}
    stats = {
        "log_joint": (_PAIR, (table["log_prior"] + table["log_likelihood"])[index]),
        "total_error": (_PAIR, table["total_error"][index], {"units": "units of length"}),
        "accepted": (_PAIR, np.stack([step.accepted for step in steps], axis=1)),
        "window": (_PAIR, np.stack([step.window for step in steps], axis=1)),
        "frames_simulated": (_PAIR, frames[:, list(drawn.iterations)], paid),
        "sim_seed": (_PAIR, table["seed"][index]),
        "step_error": ((*_PAIR, "time"), errors[index]),
        "log_weight": (_PAIR, np.stack([step.log_weight for step in steps], axis=1), weight),
    }
    log_evidence = np.stack([step.log_evidence for step in steps], axis=1)
    if not np.isnan(log_evidence).all():
        stats["log_evidence"] = (_PAIR, log_evidence)
    return stats


def _trajectories(records: Sequence[Record], index: NDArray[np.int64]) -> NDArray[np.float32]:
    distinct, inverse = np.unique(index, return_inverse=True)
    stored = np.stack([records[row].result.trajectory for row in distinct]).astype(np.float32)
    return stored[inverse.reshape(index.shape)]


def _variable(name: str, dims: tuple[str, ...], values: NDArray[Any]) -> tuple[Any, ...]:
    attrs: dict[str, Any] = {}
    if name.endswith(GOAL_SITES):
        attrs = {"flag_values": np.arange(len(GOALS)), "flag_meanings": json.dumps(GOALS)}
    elif name in STRENGTH_SITES:
        attrs = {"units": "N"}
    own_dims = tuple(f"{name}_dim_{i}" for i in range(values.ndim - len(dims)))
    return (*dims, *own_dims), values, attrs


def _scene_dataset(event: Event) -> xr.Dataset:
    scene = event.scene
    return xr.Dataset(
        {
            "start": (("entity", "coord"), scene.start),
            "radius": (("entity",), scene.radius),
            "walls": (("wall", "end", "xy"), scene.walls),
            "arena": (("bound",), np.array(scene.arena)),
            "landmark_centres": (("landmark", "xy"), scene.landmark_centres),
        },
        {
            "entity": list(ENTITIES),
            "coord": ["x", "y", "angle"],
            "landmark": list(LANDMARKS),
            "bound": ["x_min", "x_max", "y_min", "y_max"],
        },
        attrs={"turning": scene.turning, "landmark_half_width": scene.landmark_half_width},
    )
