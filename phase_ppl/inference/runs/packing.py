"""Turning what a run has done into arrays of numbers, and back, to the last bit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from numpy.typing import NDArray

from phase_ppl.inference.runs.archive import Arrays
from phase_ppl.inference.runs.chains import Step
from phase_ppl.models.bridge import Record, hypothesis_of_row
from phase_ppl.simulator.contract import FRAME_SHAPE, SimulationResult

# --- state -----------------------------------------------------------------------------------


def packed_leaf(leaf: Any) -> tuple[NDArray[Any], str | None]:
    """Return the numbers of a leaf of a state, and of which kind it is if it is a key."""
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return np.asarray(random.key_data(leaf)), str(random.key_impl(leaf))
    return np.asarray(leaf), None


def unpacked_leaf(values: NDArray[Any], kind: str | None) -> jax.Array:
    """Return the leaf that :func:`packed_leaf` was given."""
    if values.dtype.kind == "f" and np.isnan(values).any():
        raise ValueError("a value of its state is NaN")
    leaf = jnp.asarray(values)
    return leaf if kind is None else random.wrap_key_data(leaf, impl=kind)


# --- steps -----------------------------------------------------------------------------------


def packed_steps(prefix: str, steps: Sequence[Step]) -> Arrays:
    """Return arrays (step, ...), named ``prefix/field``."""
    if not steps:
        return {}
    arrays: Arrays = {}
    for field in Step._fields:
        values = [getattr(step, field) for step in steps]
        if field == "sites":
            for site in values[0]:
                arrays[f"{prefix}/sites/{site}"] = np.stack([sites[site] for sites in values])
        else:
            arrays[f"{prefix}/{field}"] = np.stack(values)
    return arrays


def unpacked_steps(arrays: Arrays, prefix: str, n: int) -> list[Step]:
    """Return the ``n`` steps that :func:`packed_steps` was given."""
    if not n:
        return []
    sites = _below(arrays, f"{prefix}/sites/")
    fields = {name: arrays[f"{prefix}/{name}"] for name in Step._fields if name != "sites"}
    for values in (*sites.values(), *fields.values()):
        if len(values) != n:
            raise ValueError(f"{prefix} has {len(values)} entries, expected {n}")
    return [
        Step(
            sites={name: values[i] for name, values in sites.items()},
            **{name: values[i] for name, values in fields.items()},
        )
        for i in range(n)
    ]


def _below(arrays: Arrays, prefix: str) -> Arrays:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


# --- records ---------------------------------------------------------------------------------

_RECORD: Final = (
    *("seed", "chain", "iteration", "log_prior", "log_proposal", "log_bound", "log_again"),
    *("frames", "completed"),
)


def packed_records(records: Sequence[Record]) -> Arrays:
    """Return arrays (record, ...); errors and trajectories of the simulated frames, in a row."""
    results = [record.result for record in records]
    frames = [result.frames_simulated for result in results]
    columns = {
        "seed": np.array([result.seed for result in results], np.int64),
        "chain": np.array([record.chain for record in records], np.int64),
        "iteration": np.array([record.iteration for record in records], np.int64),
        **{
            name: np.array([getattr(record, name) for record in records], np.float64)
            for name in ("log_prior", "log_proposal", "log_bound", "log_again")
        },
        "frames": np.array(frames, np.int64),
        "completed": np.array([result.completed for result in results], np.bool_),
        "error": np.concatenate([r.errors[:n] for r, n in zip(results, frames, strict=True)]),
        "trajectory": np.concatenate(
            [r.trajectory[:n] for r, n in zip(results, frames, strict=True)]
        ).astype(np.float32),
    }
    for site in records[0].sites:
        columns[f"sites/{site}"] = np.stack([record.sites[site] for record in records])
    return {f"records/{name}": values for name, values in columns.items()}


def unpacked_records(arrays: Arrays, failed: Mapping[str, str], n_frames: int) -> list[Record]:
    """Return the records that :func:`packed_records` was given.

    Args:
        arrays: that it returned.
        failed: number of the record -> what went wrong.
        n_frames: of a complete simulation.
    """
    sites = _below(arrays, "records/sites/")
    columns = {name: arrays[f"records/{name}"] for name in _RECORD}
    errors, trajectory = arrays["records/error"], arrays["records/trajectory"]
    frames = columns["frames"]
    ends = np.cumsum(frames)
    lengths = {len(values) for values in (*sites.values(), *columns.values())}
    if len(lengths) != 1 or not ends.size or ends[-1] != len(errors) or ends[-1] != len(trajectory):
        raise ValueError("the records differ in length")
    if frames.min() < 0 or frames.max() > n_frames:
        raise ValueError(f"a record has more than {n_frames} frames")
    records = []
    for row, (end, n) in enumerate(zip(ends, frames, strict=True)):
        frames_shown = np.full((n_frames, *FRAME_SHAPE), np.nan)
        frames_shown[:n] = trajectory[end - n : end]
        by_frame = np.full(n_frames, np.inf)
        by_frame[:n] = errors[end - n : end]
        result = SimulationResult(
            hypothesis_of_row(sites, row),
            int(columns["seed"][row]),
            frames_shown,
            by_frame,
            int(n),
            bool(columns["completed"][row]),
            failure=failed.get(str(row)),
        )
        records.append(
            Record(
                result,
                {name: values[row] for name, values in sites.items()},
                float(columns["log_prior"][row]),
                chain=int(columns["chain"][row]),
                iteration=int(columns["iteration"][row]),
                log_proposal=float(columns["log_proposal"][row]),
                log_bound=float(columns["log_bound"][row]),
                log_again=float(columns["log_again"][row]),
            )
        )
    return records
