"""The tree of draws: written by inference, read by every analysis, and kept in a file.

An :class:`xarray.DataTree` with ArviZ's group names. Its root attributes are strings and
numbers only, so that it survives NetCDF unchanged.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.identity import qualified_name, source_hash
from phase_ppl.world.scene import PHASE, Scene, World, world_in_files
from phase_ppl.world.space import HypothesisSpace, space_of

SCHEMA: Final = "phase-ppl-posterior-2"  # value of the root attribute ``schema``

SIMULATED: Final = "simulated"
"""Group of each draw's simulation, without noise. For the radial likelihood its attribute ``beta``
gives the likelihood's noise."""

FIRST_FAILURE: Final = "first_failure"
"""Attribute of the group of simulations, in words, if one failed. Older files lack it."""

DRAW: Final = ("chain", "draw")
SIMULATION: Final = ("simulation",)
FRAME: Final = ("time", "entity", "coord")
"""Dimensions of variables per draw, per simulation, and of a trajectory."""

REQUIRED: Final[Mapping[str, Mapping[tuple[str, ...], str]]] = {
    "posterior": {},
    "sample_stats": {
        DRAW: "log_joint total_error accepted window sim_seed",
        (*DRAW, "time"): "step_error",
    },
    SIMULATED: {},
    "observed_data": {FRAME: "trajectory"},
    "simulations": {
        SIMULATION: "seed chain iteration log_prior log_prior_effective log_likelihood total_error "
        "completed frames_simulated failed"
    },
    "constant_data": {(): "start radius walls arena landmark_centres"},
}
"""Group -> dimensions (none: any) -> required variables. Draws and simulations also have the
columns of a hypothesis: ``HypothesisSpace.columns`` of the world."""

OPTIONAL: Final[Mapping[str, Mapping[tuple[str, ...], str]]] = {
    "sample_stats": {
        DRAW: "log_weight log_evidence frames_simulated",
        (*DRAW, "planner_seed"): "log_likelihood_without",
    },
    SIMULATED: {(*DRAW, *FRAME): "trajectory"},
    "simulations": {(*SIMULATION, "time"): "step_log_likelihood"},
}
"""Group -> dimensions -> optional variables, which some files and kernels lack. Runs on a closed
loop's table have no trajectories. They have log likelihoods without each of its sets of searches,
minus those with all sets."""

REQUIRED_ATTRS: Final = ("event_id", "settings", "cost", "kernel", "validity", "weights", "schema")


def check_tree(tree: xr.DataTree) -> None:
    """Raise InvalidEventError, naming what is missing or wrong, if ``tree`` breaks the schema."""
    schema = tree.attrs.get("schema")
    if schema != SCHEMA:
        raise InvalidEventError(
            f"this is no tree of draws: its schema is {schema!r}, expected {SCHEMA!r}; if it is of "
            "the closed loop, phase_ppl.load_posterior reads it"
        )
    if missing := [name for name in REQUIRED_ATTRS if name not in tree.attrs]:
        raise InvalidEventError(f"the tree of draws lacks the root attributes {missing}")
    for group in REQUIRED:
        if group not in tree.children:
            raise InvalidEventError(f"the tree of draws lacks the group {group!r}")
    space, sizes = space_of_tree(tree), dict[str, int]()
    limits = {**dict.fromkeys(space.stated_sites, space.n_goals), **space.limits}
    for group, given in REQUIRED.items():
        dataset = tree[group].dataset
        of_hypothesis = {"posterior": DRAW, "simulations": SIMULATION}.get(group)
        columns = dict.fromkeys(space.columns, of_hypothesis) if of_hypothesis else {}
        required, optional = (
            {name: dims for dims, names in one.items() for name in names.split()}
            for one in (given, OPTIONAL.get(group, {}))
        )
        if missing := [n for n in (*columns, *required) if n not in dataset.variables]:
            raise InvalidEventError(f"group {group!r} of the tree of draws lacks {missing}")
        for name, dims in {**columns, **required, **optional}.items():
            if not dims or name not in dataset:
                continue
            found = dataset[name]
            if found.dims != dims:
                raise InvalidEventError(
                    f"{group}/{name} has dimensions {found.dims}, expected {dims}"
                )
            want = tuple(sizes.setdefault(str(dim), n) for dim, n in found.sizes.items())
            if found.shape != want:
                raise InvalidEventError(f"{group}/{name} has shape {found.shape}, expected {want}")
            limit = limits.get(name) if name in columns else None
            if limit and found.size and (found.min() < 0 or found.max() >= limit):
                raise InvalidEventError(f"{group}/{name} has codes outside 0..{limit - 1}")
    if not (sizes["chain"] and sizes["draw"]):
        shape = sizes["chain"], sizes["draw"]
        raise InvalidEventError(f"the tree holds no draws: (chain, draw) = {shape}")


def array(tree: xr.DataTree, group: str, name: str) -> NDArray[Any]:
    """Return the values of a variable of the tree."""
    return tree[group].dataset[name].values


def completed(tree: xr.DataTree) -> NDArray[np.bool_]:
    """Return (simulation,) whether each was simulated to the end."""
    return array(tree, "simulations", "completed") & ~array(tree, "simulations", "failed")


def shape_of_draws(tree: xr.DataTree) -> tuple[int, ...]:
    """Return how many chains there are, and draws of each."""
    return array(tree, "posterior", space_of_tree(tree).goal_sites[0]).shape


def users_sites(tree: xr.DataTree) -> list[str]:
    """Return a user's own sites that are single numbers."""
    draws, columns = tree["posterior"].dataset, space_of_tree(tree).columns
    return [str(n) for n, one in draws.data_vars.items() if n not in columns and one.ndim == 2]


def effective_goals(tree: xr.DataTree, group: str) -> NDArray[np.int64]:
    """Return (..., agent) the effective goals of the draws or the simulations."""
    names = space_of_tree(tree).goal_sites
    return np.stack([array(tree, group, name).astype(np.int64) for name in names], axis=-1)


def prior_of_goals(tree: xr.DataTree, goals: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Return (row,) the prior mass of effective goals (row, agent); None where it is not kept."""
    constant, space = tree["constant_data"].dataset, space_of_tree(tree)
    if "prior_of_pairs" in constant:
        return np.asarray(constant["prior_of_pairs"].values[tuple(goals.T)], np.float64)
    if "log_prior_alpha" not in constant:
        return None
    own, alpha = (constant[f"log_prior_{name}"].values for name in ("goals", "alpha"))
    return np.exp(np.logaddexp.reduce(space.log_prior_of_effective(own, alpha, goals), axis=0))


_MOST: Final = 100.0  # nats that make anything certain


def untried(tree: xr.DataTree) -> float:
    """Return the prior mass of effective goals (of all agents) without a completed simulation.

    NaN: the tree does not hold their prior.
    """
    tried = np.unique(effective_goals(tree, "simulations")[completed(tree)], axis=0)
    found = prior_of_goals(tree, tried)
    if found is None:
        return float("nan")
    # rounded sums of all may be a little above 1
    return max(0.0, 1.0 - float(found.sum()) / possible_mass(tree))


def suggestion_agreement(tree: xr.DataTree) -> float:
    """Return how clearly goals that bottom-up proposals suggest fit the video better.

    It is a rank correlation, divided by its standard error under chance: of log proposal minus log
    prior density with the log likelihood, over the first simulation of each combination of goals.
    NaN: proposals have no density, or goals are few.
    """
    simulations = tree["simulations"].dataset
    if "log_proposal" not in simulations:
        return np.nan
    suggested = (simulations["log_proposal"] - simulations["log_prior"]).values
    done = completed(tree) & np.isfinite(suggested)
    goals = effective_goals(tree, "simulations")[done]
    _, first = np.unique(goals, axis=0, return_index=True)
    if len(first) < _FEWEST_RANKS:
        return np.nan
    fit = simulations["log_likelihood"].values[done][first]
    ranks = pd.DataFrame({"suggested": suggested[done][first], "fit": fit}).rank()
    return float(ranks["suggested"].corr(ranks["fit"]) * np.sqrt(len(first) - 1))


_FEWEST_RANKS: Final = 10


def unseen_share(tree: xr.DataTree) -> float:
    """Return the estimated posterior probability of goals that were never simulated.

    Their likelihood is assumed to equal that of goals first simulated in the later half of first
    simulations. 0: the tree has no evidence to compare with.
    """
    stats, simulations = tree["sample_stats"].dataset, tree["simulations"].dataset
    mass = untried(tree)
    if "log_evidence" not in stats or not mass > 0:
        return 0.0
    evidence = float(stats["log_evidence"].values[0, -1])
    done = completed(tree)
    order = np.argsort(simulations["iteration"].values[done], kind="stable")
    goals = effective_goals(tree, "simulations")[done][order]
    _, first = np.unique(goals, axis=0, return_index=True)
    later = np.sort(first)[len(first) // 2 :]
    prior = prior_of_goals(tree, goals[later])
    assert prior is not None, "what is untried is known"
    likelihood = simulations["log_likelihood"].values[done][order][later]
    ratio = float((prior * np.exp(np.minimum(likelihood - evidence, _MOST))).sum() / prior.sum())
    return mass * ratio / (1 + mass * ratio)


def possible_mass(tree: xr.DataTree) -> float:
    """Return the prior mass of all effective goals: 1, or less if some are impossible."""
    constant = tree["constant_data"].dataset
    if "log_prior_alpha" not in constant:
        return 1.0
    own, alpha = (constant[f"log_prior_{name}"].values for name in ("goals", "alpha"))
    return space_of_tree(tree).possible_share(own, alpha)


def log_weight_of_draws(tree: xr.DataTree) -> NDArray[np.float64]:
    """Return (chain, draw) the log weights of the draws; 0 where the tree has none."""
    stats = tree["sample_stats"].dataset
    if "log_weight" not in stats:
        return np.zeros(shape_of_draws(tree))
    return stats["log_weight"].values.astype(float)


def are_weighted(tree: xr.DataTree) -> bool:
    """Whether draws have weights, from the kernel or another prior, and so are no chains."""
    log_weight = log_weight_of_draws(tree)
    highest = log_weight.max()
    differ = np.isfinite(highest) and (log_weight < highest).any()
    return bool("log_evidence" in tree["sample_stats"].dataset or differ)


def simulation_of_draw(tree: xr.DataTree) -> NDArray[np.int64]:
    """Return (chain, draw) the index of each draw's simulation.

    A draw and its simulation share hypothesis and seed; -1: there is no completed simulation.
    """
    names = [*space_of_tree(tree).kept_columns, "seed"]
    seeds = array(tree, "sample_stats", "sim_seed")
    draws = {**{name: array(tree, "posterior", name) for name in names[:-1]}, "seed": seeds}
    simulations = tree["simulations"].dataset
    known = pd.DataFrame({name: _single(simulations[name].values) for name in names})
    known = known[completed(tree)]
    known = known.drop_duplicates().reset_index(names="simulation")
    asked = pd.DataFrame({name: _single(values.ravel()) for name, values in draws.items()})
    found = asked.merge(known, how="left", on=names)["simulation"].fillna(-1)
    return found.to_numpy(np.int64).reshape(seeds.shape)


def _single(values: NDArray[Any]) -> NDArray[Any]:
    """Return reals rounded to single precision, which is what samplers work in."""
    return values.astype(np.float32) if values.dtype.kind == "f" else values


def scene_dataset(scene: Scene) -> xr.Dataset:
    """Return a scene as a dataset, its arrays as variables and the rest as attributes."""
    attrs: dict[str, Any] = {
        "turning": scene.turning,
        "resets_velocity": int(scene.resets_velocity),
    }
    kept = world_in_files(scene.world)
    if kept is None:
        attrs["landmark_half_width"] = float(scene.landmark_half_width)
    else:
        attrs["world"] = json.dumps([kept, scene.half_widths.tolist()])
    variables = {
        "start": (("entity", "coord"), scene.start),
        "radius": (("entity",), scene.radius),
        "walls": (("wall", "end", "xy"), scene.walls),
        "arena": (("bound",), np.array(scene.arena)),
        "landmark_centres": (("landmark", "xy"), scene.landmark_centres),
    }
    coords = {
        "entity": list(scene.world.entities),
        "coord": ["x", "y", "angle"],
        "landmark": list(scene.world.landmark_names),
        "bound": ["x_min", "x_max", "y_min", "y_max"],
    }
    return xr.Dataset(variables, coords, attrs)


def kept_scene(kept: xr.Dataset) -> Scene:
    """Return the scene that :func:`scene_dataset` wrote into a dataset."""
    attrs, names = kept.attrs, ("start", "radius", "walls", "landmark_centres")
    in_phase = "world" not in attrs
    half_width = float(attrs["landmark_half_width"]) if in_phase else json.loads(attrs["world"])[1]
    return Scene(
        **{name: kept[name].values for name in names},
        turning=attrs["turning"],
        resets_velocity=bool(attrs.get("resets_velocity", 0)),
        arena=tuple(kept["arena"].values.astype(float).tolist()),
        landmark_half_width=half_width,
        world=kept_world(kept),
    )


def kept_world(kept: xr.Dataset) -> World:
    """Return the world of the scene that :func:`scene_dataset` wrote into a dataset."""
    return _world_of(kept.attrs["world"]) if "world" in kept.attrs else PHASE


@functools.lru_cache(16)
def _world_of(record: str) -> World:
    return World.from_dict(json.loads(record)[0])


def space_of_tree(tree: xr.DataTree) -> HypothesisSpace:
    """Return the hypotheses of the world of a tree of draws."""
    return space_of(kept_world(tree["constant_data"].dataset))


FEWEST: Final = 10.0
"""Least effective size of a run under another prior, unless it was small before."""

_LEFT: Final = 0.5
"""Largest share of the effective size that another prior may cost if fewer draws remain."""

_TRIED: Final = 0.25
"""Least mass of the simulated goals under the new prior, as a share of their mass under the old."""


def settings_under(settings: str, program: Any, **found: float) -> str:
    """Return a run's settings, JSON, with another prior; the replaced one is kept.

    The numbers ``found`` are added as ``reweighted``.
    """
    from phase_ppl.models.effective import as_given

    record = json.loads(settings)
    model = dict(record.get("model", {}))
    first = record.get("reweighted", {}).get("from", model.get("prior", "unknown"))
    given = as_given(program)
    now = {"prior": qualified_name(given), "prior_source": source_hash(given)}
    if now["prior_source"] is not None and now.items() <= model.items():
        return settings  # the run's own, given again
    model |= now
    return json.dumps({**record, "model": model, "reweighted": {"from": first, **found}})


def changed_text(settings: dict[str, Any]) -> str:
    """Return in words the change of prior since the run; "": no change."""
    if "reweighted" not in settings:
        return ""
    found = settings["reweighted"]
    words = f"{settings['model']['prior']}, taken instead of {found['from']} after the run"
    if "effective_size" not in found:
        return words
    worth = (
        f"{found['effective_size']:.1f} equal draws, {found['effective_size_before']:.1f} before"
    )
    return f"{words}: what was simulated is worth {worth}"


def reweighted(tree: xr.DataTree, program: Callable[..., object]) -> xr.DataTree:
    """Return a tree of draws reweighted to another prior.

    Simulations depend on effective goals and strengths only. So these are weighted by the ratio of
    their priors, and stated goals and alpha are drawn anew given them. A user's own sites are
    included in the ratio if the other prior has them too; else they are dropped.
    """
    from phase_ppl.models.density import NO_DENSITY
    from phase_ppl.models.effective import log_prior_of_hypotheses, upstream
    from phase_ppl.models.world_priors import drawn_stated, kept_prior, log_prior_of_effective

    rows = simulation_of_draw(tree)
    if (rows < 0).any():
        raise InvalidEventError("a draw rests on no completed simulation of the tree")
    simulations, draws = tree["simulations"].to_dataset(), tree["posterior"].to_dataset()
    space, goals = space_of_tree(tree), effective_goals(tree, "simulations")
    users = [str(name) for name in draws.data_vars if name not in space.columns]
    strengths = {name: simulations[name].values for name in space.strength_sites}
    effective = log_prior_of_effective(program, goals, strengths)
    effective[effective <= NO_DENSITY] = -np.inf
    if users and set(users) <= upstream(program).keys():
        names = (*space.kept_columns, *users)
        columns = {name.removeprefix("stated_"): simulations[name].values for name in names}
        log_prior = log_prior_of_hypotheses(program, columns)
        log_prior[log_prior <= NO_DENSITY] = -np.inf
        change = log_prior - simulations["log_prior"].values
    else:
        change = effective - simulations["log_prior_effective"].values
        stated, _ = drawn_stated(program, goals, np.stack(list(strengths.values()), axis=1))
        simulations, draws = simulations.drop_vars(users), draws.drop_vars(users)
        for name, codes in zip(space.kept_columns, stated.T, strict=False):
            simulations[name] = simulations[name].copy(data=codes.astype(simulations[name].dtype))
            draws[name] = draws[name].copy(data=simulations[name].values[rows])
    simulations["log_prior"] = simulations["log_prior"] + change
    simulations["log_prior_effective"] = "simulation", effective
    stats = tree["sample_stats"].to_dataset()
    stats["log_joint"] = stats["log_joint"] + change[rows]
    stats["log_weight"] = (*stats["log_joint"].dims,), log_weight_of_draws(tree) + change[rows]
    constant = tree["constant_data"].to_dataset().assign(kept_prior(program))
    changed = {"simulations": simulations, "posterior": draws, "sample_stats": stats}
    changed["constant_data"] = constant
    return tree.assign({name: xr.DataTree(group) for name, group in changed.items()})


def check_overlap(worths: tuple[float, float], tried: tuple[float, float]) -> None:
    """Raise InvalidSettingError if too little was simulated for another prior.

    Args:
        worths: effective sizes of the simulations under the other prior, and before.
        tried: shares of the other prior, and of the run's own, that were simulated.
    """
    reason = ""
    if worths[0] < FEWEST and worths[0] < _LEFT * worths[1]:
        reason = f"are worth {worths[0]:.1f} equal draws under this prior, {worths[1]:.1f} before"
    elif tried[0] < _TRIED * tried[1]:
        reason = f"hold {tried[0]:.1%} of this prior, {tried[1]:.1%} of the run's own"
    if reason:
        raise InvalidSettingError(
            f"the simulations of this run {reason}: too few to tell; infer anew with this prior"
        )
