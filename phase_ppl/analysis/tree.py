"""The tree of draws: what inference writes, what every analysis reads, and its file.

An :class:`xarray.DataTree` with ArviZ's group names. Its root attributes are strings and
numbers only, so that it survives NetCDF unchanged.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.dataset.hdf5 import netcdf_bytes, read_netcdf
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.files import check_output, existing_file, write_bytes
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import ALPHAS

SCHEMA: Final = "phase-ppl-posterior-1"
"""Value of the root attribute ``schema``."""

SITES: Final = (
    "goal_red",
    "goal_green",
    "stated_goal_red",
    "stated_goal_green",
    "alpha",
    "strength_red",
    "strength_green",
)
"""Variables of a hypothesis: effective goals, stated goals, alpha, strengths."""

HYPOTHESIS: Final = SITES[2:]
"""The sites that the prior is a density of; the effective goals follow from them."""

_DRAW = ("chain", "draw")
_SIMULATION = ("simulation",)
_FRAME = ("time", "entity", "coord")

REQUIRED: Final[Mapping[str, Mapping[str, tuple[str, ...] | None]]] = {
    "posterior": dict.fromkeys(SITES, _DRAW),
    "sample_stats": {
        **dict.fromkeys(("log_joint", "total_error", "accepted", "window"), _DRAW),
        **dict.fromkeys(("frames_simulated", "sim_seed"), _DRAW),
        "step_error": (*_DRAW, "time"),
    },
    "posterior_predictive": {"trajectory": (*_DRAW, *_FRAME)},
    "observed_data": {"trajectory": _FRAME},
    "simulations": dict.fromkeys(
        (
            *SITES,
            *("seed", "chain", "iteration", "log_prior", "log_prior_effective"),
            "log_likelihood",
            *("total_error", "completed", "frames_simulated", "failed"),
        ),
        _SIMULATION,
    ),
    "constant_data": dict.fromkeys(("start", "radius", "walls", "arena", "landmark_centres")),
}
"""Group -> variable -> dimensions (None: any)."""

OPTIONAL: Final[Mapping[str, Mapping[str, tuple[str, ...]]]] = {
    "sample_stats": dict.fromkeys(("log_weight", "log_evidence"), _DRAW),
    "simulations": {"step_log_likelihood": ("simulation", "time")},
}
"""Group -> further variable -> dimensions: not all files and kernels have them."""

REQUIRED_ATTRS: Final = ("event_id", "settings", "cost", "kernel", "validity", "weights", "schema")


def check_tree(tree: xr.DataTree) -> None:
    """Raise InvalidEventError, naming what is missing or wrong, if ``tree`` breaks the schema."""
    schema = tree.attrs.get("schema")
    if schema != SCHEMA:
        raise InvalidEventError(
            f"this is no tree of draws: its schema is {schema!r}, not {SCHEMA!r}"
        )
    missing = [name for name in REQUIRED_ATTRS if name not in tree.attrs]
    if missing:
        raise InvalidEventError(f"the tree of draws lacks the root attributes {missing}")
    for group, variables in REQUIRED.items():
        if group not in tree.children:
            raise InvalidEventError(f"the tree of draws lacks the group {group!r}")
        dataset = tree[group].dataset
        missing = [name for name in variables if name not in dataset.variables]
        if missing:
            raise InvalidEventError(f"group {group!r} of the tree of draws lacks {missing}")
        for name, dims in variables.items():
            if dims is not None and dataset[name].dims != dims:
                raise InvalidEventError(
                    f"{group}/{name} has dimensions {dataset[name].dims}, expected {dims}"
                )
    for group, optional in OPTIONAL.items():
        dataset = tree[group].dataset
        for name, dims in optional.items():
            if name in dataset and dataset[name].dims != dims:
                raise InvalidEventError(
                    f"{group}/{name} has dimensions {dataset[name].dims}, expected {dims}"
                )
    _check_sizes(tree)
    _check_codes(tree)


def _check_sizes(tree: xr.DataTree) -> None:
    shape = array(tree, "posterior", "goal_red").shape
    if 0 in shape:
        raise InvalidEventError(f"the tree holds no draws: (chain, draw) = {shape}")
    frames = array(tree, "observed_data", "trajectory").shape
    expected = {
        ("sample_stats", "log_joint"): shape,
        ("sample_stats", "step_error"): (*shape, frames[0]),
        ("posterior_predictive", "trajectory"): (*shape, *frames),
    }
    simulations = tree["simulations"].dataset
    if "step_log_likelihood" in simulations:
        size = (simulations.sizes["simulation"], frames[0])
        expected["simulations", "step_log_likelihood"] = size
    for (group, name), want in expected.items():
        have = array(tree, group, name).shape
        if have != want:
            raise InvalidEventError(f"{group}/{name} has shape {have}, expected {want}")


def _check_codes(tree: xr.DataTree) -> None:
    limits = {**dict.fromkeys(SITES[:4], N_GOALS), "alpha": len(ALPHAS)}
    for group in ("posterior", "simulations"):
        for name, limit in limits.items():
            codes = array(tree, group, name)
            if codes.size and (codes.min() < 0 or codes.max() >= limit):
                raise InvalidEventError(f"{group}/{name} has codes outside 0..{limit - 1}")


def array(tree: xr.DataTree, group: str, name: str) -> NDArray[Any]:
    """Return the values of a variable of the tree."""
    return tree[group].dataset[name].values


def log_weight_of_draws(tree: xr.DataTree) -> NDArray[np.float64]:
    """Return (chain, draw) the log weights of the draws; 0 where the tree has none."""
    stats = tree["sample_stats"].dataset
    if "log_weight" not in stats:
        return np.zeros(array(tree, "posterior", "goal_red").shape)
    return stats["log_weight"].values.astype(float)


def simulation_of_draw(tree: xr.DataTree) -> NDArray[np.int64]:
    """Return the (chain, draw) index of the simulation that each draw rests on.

    A draw and its simulation share hypothesis and seed; -1 where no completed simulation does.
    """
    draws = {name: array(tree, "posterior", name) for name in HYPOTHESIS}
    draws["seed"] = array(tree, "sample_stats", "sim_seed")
    simulations = tree["simulations"].dataset
    columns = [simulations[name].values for name in (*HYPOTHESIS, "seed")]
    usable = simulations["completed"].values & ~simulations["failed"].values
    index = {
        key: row
        for row, key in reversed(list(enumerate(zip(*map(_plain, columns), strict=True))))
        if usable[row]
    }
    keys = zip(*(_plain(values.reshape(-1)) for values in draws.values()), strict=True)
    found = np.array([index.get(key, -1) for key in keys], np.int64)
    return found.reshape(draws["seed"].shape)


def _plain(values: NDArray[np.generic]) -> list[object]:
    """Return plain numbers; reals rounded to single precision, which is what samplers work in."""
    if values.dtype.kind == "f":
        values = values.astype(np.float32)
    return list(values.tolist())


def write_tree(tree: xr.DataTree, path: str | os.PathLike[str]) -> Path:
    """Write ``tree`` to ``path`` as NetCDF, whole or not at all, and return the path.

    Every array carries a checksum, so that a damaged file is noticed when it is read.

    Raises:
        OutputError: the file cannot be written there, or its name does not end in .nc.
    """
    groups = {node.path: node.to_dataset(inherit=False) for node in tree.subtree}
    check_output(path, (".nc",))
    write_bytes(path, (".nc",), netcdf_bytes(groups, {"fletcher32": True}, sealed=True))
    return Path(path)


def read_tree(path: str | os.PathLike[str]) -> xr.DataTree:
    """Read the tree of draws that :func:`write_tree` wrote, fully into memory.

    Raises:
        InvalidEventError: there is no such file, or it is damaged or of another kind.
    """
    source = existing_file(path)
    try:
        tree = xr.DataTree.from_dict(dict(read_netcdf(source)))
        check_tree(tree)
    except InvalidEventError as error:
        raise InvalidEventError(f"{source}: {error}") from None
    return tree
