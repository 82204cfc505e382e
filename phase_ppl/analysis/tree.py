"""The tree of draws: what inference writes, what every analysis reads, and its file.

An :class:`xarray.DataTree` with ArviZ's group names. Its root attributes are strings and
numbers only, so that it survives NetCDF unchanged.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.dataset.events_json import labels_of
from phase_ppl.dataset.hdf5 import netcdf_bytes, read_netcdf
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.files import check_output, existing_file, write_bytes
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import ALPHAS
from phase_ppl.world.scene import PHASE, Scene, World

SCHEMA: Final = "phase-ppl-posterior-2"  # value of the root attribute ``schema``

SIMULATED: Final = "simulated"
"""Group of the simulation that each draw rests on, as the simulator made it. Where the likelihood
is the radial one, its attribute ``beta`` says how much noise the likelihood puts around it."""

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

_SCENE_DIMS: Final = ("entity", "coord", "landmark", "bound")
DRAW: Final = ("chain", "draw")
SIMULATION: Final = ("simulation",)
FRAME: Final = ("time", "entity", "coord")
"""Dimensions of what there is of each draw, of each simulation, and of a trajectory."""

REQUIRED: Final[Mapping[str, Mapping[str, tuple[str, ...] | None]]] = {
    "posterior": dict.fromkeys(SITES, DRAW),
    "sample_stats": {
        **dict.fromkeys(("log_joint", "total_error", "accepted", "window"), DRAW),
        **dict.fromkeys(("frames_simulated", "sim_seed"), DRAW),
        "step_error": (*DRAW, "time"),
    },
    SIMULATED: {"trajectory": (*DRAW, *FRAME)},
    "observed_data": {"trajectory": FRAME},
    "simulations": dict.fromkeys(
        (
            *SITES,
            *("seed", "chain", "iteration", "log_prior", "log_prior_effective"),
            "log_likelihood",
            *("total_error", "completed", "frames_simulated", "failed"),
        ),
        SIMULATION,
    ),
    "constant_data": dict.fromkeys(("start", "radius", "walls", "arena", "landmark_centres")),
}
"""Group -> variable -> dimensions (None: any)."""

OPTIONAL: Final[Mapping[str, Mapping[str, tuple[str, ...]]]] = {
    "sample_stats": dict.fromkeys(("log_weight", "log_evidence"), DRAW),
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
        for name, dims in {**variables, **OPTIONAL.get(group, {})}.items():
            if dims is not None and name in dataset and dataset[name].dims != dims:
                raise InvalidEventError(
                    f"{group}/{name} has dimensions {dataset[name].dims}, expected {dims}"
                )
    _check_sizes(tree)
    limits = {**dict.fromkeys(SITES[:4], N_GOALS), "alpha": len(ALPHAS)}
    for group in ("posterior", "simulations"):
        for name, limit in limits.items():
            codes = array(tree, group, name)
            if codes.size and (codes.min() < 0 or codes.max() >= limit):
                raise InvalidEventError(f"{group}/{name} has codes outside 0..{limit - 1}")


def _check_sizes(tree: xr.DataTree) -> None:
    shape = array(tree, "posterior", "goal_red").shape
    if 0 in shape:
        raise InvalidEventError(f"the tree holds no draws: (chain, draw) = {shape}")
    frames = array(tree, "observed_data", "trajectory").shape
    expected = {
        ("sample_stats", "log_joint"): shape,
        ("sample_stats", "step_error"): (*shape, frames[0]),
        (SIMULATED, "trajectory"): (*shape, *frames),
    }
    simulations = tree["simulations"].dataset
    if "step_log_likelihood" in simulations:
        size = (simulations.sizes["simulation"], frames[0])
        expected["simulations", "step_log_likelihood"] = size
    for (group, name), want in expected.items():
        have = array(tree, group, name).shape
        if have != want:
            raise InvalidEventError(f"{group}/{name} has shape {have}, expected {want}")


def array(tree: xr.DataTree, group: str, name: str) -> NDArray[Any]:
    """Return the values of a variable of the tree."""
    return tree[group].dataset[name].values


def untried(tree: xr.DataTree) -> float:
    """Return the prior mass of the pairs of effective goals without a completed simulation.

    NaN where the tree does not hold the prior of pairs.
    """
    constant = tree["constant_data"].dataset
    if "prior_of_pairs" not in constant:
        return float("nan")
    left = constant["prior_of_pairs"].values.astype(np.float64)
    done = array(tree, "simulations", "completed") & ~array(tree, "simulations", "failed")
    red, green = (array(tree, "simulations", name)[done] for name in SITES[:2])
    left[red.astype(np.int64), green.astype(np.int64)] = 0.0
    return float(left.sum())


def without_burn_in(tree: xr.DataTree, burn_in: int) -> xr.DataTree:
    """Return the tree without the first ``burn_in`` draws of every chain; simulations all stay."""
    if not burn_in:
        return tree
    result = tree.copy()
    for name, node in tree.children.items():
        if "draw" in node.dims:
            result[name] = xr.DataTree(node.to_dataset().isel(draw=slice(burn_in, None)))
    return result


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
    """
    groups = {node.path: node.to_dataset(inherit=False) for node in tree.subtree}
    check_output(path, (".nc",))
    write_bytes(path, (".nc",), netcdf_bytes(groups, {"fletcher32": True}, sealed=True))
    return Path(path)


def read_tree(path: str | os.PathLike[str]) -> xr.DataTree:
    """Read the tree of draws that :func:`write_tree` wrote, fully into memory."""
    source = existing_file(path)
    try:
        tree = xr.DataTree.from_dict(dict(read_netcdf(source)))
        check_tree(tree)
    except InvalidEventError as error:
        raise InvalidEventError(f"{source}: {error}") from None
    return tree


def scene_dataset(scene: Scene) -> xr.Dataset:
    """Return a scene as a dataset, its arrays as variables and the rest as attributes."""
    of_world: dict[str, Any] = {}
    if scene.world == PHASE:
        of_world["landmark_half_width"] = float(scene.landmark_half_width)
    else:
        half_widths = scene.half_widths.tolist()
        of_world["world"] = json.dumps([scene.world.to_dict(), half_widths])
    return xr.Dataset(
        {
            "start": (("entity", "coord"), scene.start),
            "radius": (("entity",), scene.radius),
            "walls": (("wall", "end", "xy"), scene.walls),
            "arena": (("bound",), np.array(scene.arena)),
            "landmark_centres": (("landmark", "xy"), scene.landmark_centres),
        },
        {dim: list(labels_of(scene.world)[dim]) for dim in _SCENE_DIMS},
        {
            "turning": scene.turning,
            "resets_velocity": int(scene.resets_velocity),
            **of_world,
        },
    )


def kept_scene(kept: xr.Dataset) -> Scene:
    """Return the scene that :func:`scene_dataset` wrote into a dataset."""
    x0, x1, y0, y1 = (float(v) for v in kept["arena"].values)
    if "world" in kept.attrs:
        record, half_width = json.loads(kept.attrs["world"])
        world = World.from_dict(record)
    else:
        world, half_width = PHASE, float(kept.attrs["landmark_half_width"])
    return Scene(
        start=kept["start"].values,
        radius=kept["radius"].values,
        walls=kept["walls"].values,
        landmark_centres=kept["landmark_centres"].values,
        turning=kept.attrs["turning"],
        resets_velocity=bool(kept.attrs.get("resets_velocity", 0)),
        arena=(x0, x1, y0, y1),
        landmark_half_width=half_width,
        world=world,
    )
