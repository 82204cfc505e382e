"""From chains and simulations to the tree of draws that every analysis reads."""

from __future__ import annotations

import dataclasses
import json
import platform
from collections.abc import Sequence
from importlib import metadata
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import phase_ppl
from phase_ppl.analysis.tree import SCHEMA
from phase_ppl.inference.kernels.base import MHState
from phase_ppl.inference.program import Program
from phase_ppl.models.bridge import Record
from phase_ppl.models.effective import log_prior_of_effective, log_prior_of_hypotheses
from phase_ppl.models.sites import SITES, STRENGTH_SITES
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS, effective_goals
from phase_ppl.world.hypothesis import ALPHAS
from phase_ppl.world.names import ENTITIES, LANDMARKS
from phase_ppl.world.observation import FRAMES_PER_SECOND

DEFAULT_WEIGHTS: Final = "visited"
_COORDS: Final = ("x", "y", "angle")
_LIBRARIES: Final = ("numpyro", "jax", "numpy", "numba", "pymunk", "xarray")


@dataclasses.dataclass(frozen=True, eq=False)
class Chains:
    """What a run has produced.

    Attributes:
        initial: state of all chains before the first iteration.
        states: state of all chains after each iteration.
    """

    initial: MHState
    states: Sequence[MHState]


def make_tree(
    event: Event,
    program: Program,
    chains: Chains,
    records: Sequence[Record],
    attributes: dict[str, Any],
) -> xr.DataTree:
    """Return the tree of draws.

    Args:
        event: only scene, observation and id are read.
        program: what was run.
        chains: states; without an iteration the initial particles stand as the only draw.
        records: every simulation, in the order of the batches.
        attributes: root attributes; dictionaries are written as JSON.
    """
    states = list(chains.states) or [chains.initial]
    n_chains = len(np.asarray(chains.initial.i))
    z = {name: _stack([s.z[name] for s in states]) for name in states[0].z}
    seeds = _stack([s.sim_seed for s in states]).astype(np.int64)
    rows = _rows_of_draws(z, seeds, records)
    simulations = _simulations(program, records, n_chains)
    sample_stats = {
        "log_joint": (_DRAW, _take(simulations["log_prior"] + simulations["log_likelihood"], rows)),
        "total_error": (_DRAW, _take(simulations["total_error"], rows)),
        "accepted": (_DRAW, _stack([s.accepted for s in states])),
        "window": (_DRAW, _stack([s.window for s in states])),
        "frames_simulated": (_DRAW, _take(simulations["frames_simulated"], rows, 0)),
        "sim_seed": (_DRAW, _take(simulations["seed"], rows, -1)),
        "step_error": ((*_DRAW, "time"), _stack([s.step_error for s in states])),
    }
    trajectories = np.array([r.result.trajectory for r in records], np.float32)
    predicted = np.full((*rows.shape, *trajectories.shape[1:]), np.nan, np.float32)
    predicted[rows >= 0] = trajectories[rows[rows >= 0]]
    time = np.arange(event.observation.n_frames) / FRAMES_PER_SECOND
    frame = {"time": time, "entity": list(ENTITIES), "coord": list(_COORDS)}
    draw = {"chain": np.arange(n_chains), "draw": np.arange(len(states))}
    scene = event.scene
    constant = xr.Dataset(
        {
            "start": (("entity", "coord"), scene.start),
            "radius": (("entity",), scene.radius),
            "walls": (("wall", "end", "axis"), scene.walls),
            "arena": (("limit",), np.array(scene.arena)),
            "landmark_centres": (("landmark", "axis"), scene.landmark_centres),
        },
        coords={"entity": list(ENTITIES), "coord": list(_COORDS), "landmark": list(LANDMARKS)},
        attrs={"turning": scene.turning, "landmark_half_width": scene.landmark_half_width},
    )
    posterior = xr.Dataset(
        {name: ((*_DRAW, *_extra(name, v)), v) for name, v in _with_effective(z).items()},
        coords=draw,
    )
    for name in ("goal_red", "goal_green", "stated_goal_red", "stated_goal_green"):
        posterior[name].attrs = {
            "flag_values": json.dumps(list(range(len(GOALS)))),
            "flag_meanings": json.dumps(GOALS),
        }
    tree = xr.DataTree.from_dict(
        {
            "posterior": posterior,
            "sample_stats": xr.Dataset(sample_stats, coords={**draw, "time": time}),
            "posterior_predictive": xr.Dataset(
                {"trajectory": ((*_DRAW, *_FRAME), predicted)}, coords={**draw, **frame}
            ),
            "observed_data": xr.Dataset(
                {"trajectory": (_FRAME, event.observation.trajectory)}, coords=frame
            ),
            "simulations": xr.Dataset(
                {name: (("simulation", *_extra(name, v, 1)), v) for name, v in simulations.items()}
            ),
            "constant_data": constant,
        }
    )
    tree.attrs.update(
        {
            "schema": SCHEMA,
            "event_id": event.id,
            "weights": DEFAULT_WEIGHTS,
            "versions": json.dumps(_versions()),
            **{k: json.dumps(v) if isinstance(v, dict) else v for k, v in attributes.items()},
        }
    )
    return tree


_DRAW = ("chain", "draw")
_FRAME = ("time", "entity", "coord")


def _stack(arrays: Sequence[Any]) -> NDArray[Any]:
    """Return draws first collected by iteration as (chain, draw, ...)."""
    return np.stack([np.asarray(a) for a in arrays], axis=1)


def _extra(name: str, values: NDArray[Any], leading: int = 2) -> tuple[str, ...]:
    return tuple(f"{name}_dim_{i}" for i in range(values.ndim - leading))


def _take(values: NDArray[Any], rows: NDArray[np.int64], missing: float = np.nan) -> NDArray[Any]:
    taken: NDArray[Any] = np.where(rows >= 0, values[rows], missing)
    return taken.astype(values.dtype) if not np.isnan(missing) else taken


def _with_effective(z: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the sites with effective goals as ``goal_*`` and the sampled ones as stated."""
    shape = z["goal_red"].shape
    pairs = [
        effective_goals(int(red), int(green), ALPHAS[int(alpha)])
        for red, green, alpha in zip(
            z["goal_red"].ravel(), z["goal_green"].ravel(), z["alpha"].ravel(), strict=True
        )
    ]
    red, green = np.array(pairs, np.int16).reshape(-1, 2).T
    return {
        "goal_red": red.reshape(shape),
        "goal_green": green.reshape(shape),
        "stated_goal_red": z["goal_red"].astype(np.int16),
        "stated_goal_green": z["goal_green"].astype(np.int16),
        "alpha": z["alpha"].astype(np.int8),
        **{name: z[name].astype(np.float64) for name in STRENGTH_SITES},
        **{name: v for name, v in z.items() if name not in SITES},
    }


def _rows_of_draws(
    z: dict[str, NDArray[Any]], seeds: NDArray[np.int64], records: Sequence[Record]
) -> NDArray[np.int64]:
    """Return (chain, draw) the record that each draw rests on, -1 for none."""
    where: dict[tuple[int, ...], int] = {}
    for index, record in enumerate(records):
        h = record.result.hypothesis
        where[h.goal_red, h.goal_green, ALPHAS.index(h.alpha), record.requested_seed] = index
    keys = zip(
        z["goal_red"].ravel().tolist(),
        z["goal_green"].ravel().tolist(),
        z["alpha"].ravel().tolist(),
        seeds.ravel().tolist(),
        strict=True,
    )
    return np.array([where.get(key, -1) for key in keys], np.int64).reshape(seeds.shape)


def _simulations(
    program: Program, records: Sequence[Record], n_chains: int
) -> dict[str, NDArray[Any]]:
    """Return one row per simulation."""
    results = [r.result for r in records]
    hypotheses = [r.hypothesis for r in results]
    stated = {
        "goal_red": np.array([h.goal_red for h in hypotheses], np.int64),
        "goal_green": np.array([h.goal_green for h in hypotheses], np.int64),
        "alpha": np.array([ALPHAS.index(h.alpha) for h in hypotheses], np.int64),
        "strength_red": np.array([h.strength_red for h in hypotheses]),
        "strength_green": np.array([h.strength_green for h in hypotheses]),
    }
    sites = _with_effective(stated)
    completed = np.array([r.completed for r in results], bool)
    failed = np.array([r.failure is not None for r in results], bool)
    errors = np.array([r.total_error for r in results])
    log_likelihood = program.likelihood.log_prob(errors, program.n_frames)
    log_likelihood[failed] = -np.inf
    log_prior = log_prior_of_hypotheses(program.prior, stated)
    goals = np.column_stack([sites["goal_red"], sites["goal_green"]]).astype(np.int64)
    log_prior_effective = log_prior_of_effective(
        program.prior, goals, {name: stated[name] for name in STRENGTH_SITES}
    )
    return {
        **sites,
        "seed": np.array([r.seed for r in results], np.int64),
        "chain": np.array([r.row % n_chains for r in records], np.int64),
        "iteration": np.array([r.batch for r in records], np.int64),
        "log_prior": log_prior,
        "log_prior_effective": log_prior_effective,
        "log_likelihood": log_likelihood,
        "total_error": errors,
        "completed": completed,
        "frames_simulated": np.array([r.frames_simulated for r in results], np.int64),
        "failed": failed,
    }


def _versions() -> dict[str, str]:
    found = {name: metadata.version(name) for name in _LIBRARIES}
    return {"phase_ppl": phase_ppl.__version__, "python": platform.python_version(), **found}
