"""Trees of draws made by hand or at random, as inference would write them."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.tree import DRAW, FRAME, SCHEMA, scene_dataset
from phase_ppl.world.event import FRAMES_PER_SECOND
from phase_ppl.world.goals import GOALS, goal_index, is_self_referring
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis
from phase_ppl.world.names import ENTITIES
from phase_ppl.world.scene import PHASE, Scene
from phase_ppl.world.space import space_of

SPACE = space_of(PHASE)
FRAMES = "frames_simulated"

BLUE_TO_RED = "Get blue item to red lm"
PINK_TO_BLUE = "Get pink item to blue lm"
TO_RED = "get to red agent"
TO_GREEN = "get to green agent"
AWAY_FROM_RED = "get away from red agent"


@dataclasses.dataclass(frozen=True)
class Simulation:
    """One simulation that was paid for."""

    hypothesis: Hypothesis
    seed: int = 0
    log_prior: float = 0.0
    log_likelihood: float = 0.0
    completed: bool = True
    failed: bool = False
    frames: int = 5
    chain: int = 0
    iteration: int = 0


def hypothesis(
    red: str | int = BLUE_TO_RED,
    green: str | int = PINK_TO_BLUE,
    alpha: tuple[int, int] = (0, 0),
    strengths: tuple[float, float] = (300.0, 450.0),
) -> Hypothesis:
    return Hypothesis(goal_index(red), goal_index(green), alpha, *strengths)


def default_scene() -> Scene:
    start = np.array([[8, 20, 0.3], [24, 10, 1.0], [14, 16, 0], [18, 4, 0]], float)
    return Scene(start, np.array([0.8, 1.2, 1.01, 0.8]), np.array([[[16, 12], [16, 17]]], float))


def make_tree(
    simulations: Sequence[Simulation],
    draws: Sequence[Sequence[int]],
    *,
    n_frames: int = 5,
    weights: str = "count",
    validity: str = "exact",
    scene: Scene | None = None,
    observed: NDArray[np.float64] | None = None,
    predicted: NDArray[np.float64] | None = None,
    own_site: Sequence[float] | None = None,
    window: Sequence[Sequence[int]] | None = None,
    by_frame: NDArray[np.float64] | None = None,
) -> xr.DataTree:
    """Return a tree of ``draws`` (chain, draw), each of which rests on one of the simulations.

    ``predicted`` (simulation, time, entity, coord) is by default the simulation's number
    everywhere; ``own_site`` (simulation,) are values of a user's site ``mood``; ``window`` (chain,
    draw) is the first frame of the window of each proposal, by default none; ``by_frame``
    (simulation, time) are log likelihoods, by default none.
    """
    scene = scene or default_scene()
    if observed is None:
        observed = np.repeat(scene.start[None], n_frames, axis=0)
    if predicted is None:
        numbers = np.arange(len(simulations), dtype=float)[:, None, None, None]
        predicted = np.broadcast_to(numbers, (len(simulations), *observed.shape))
    frame = {"time": np.arange(len(observed)) / FRAMES_PER_SECOND, "entity": list(ENTITIES)}
    frame["coord"] = ["x", "y", "angle"]
    table = _simulation_table(simulations)
    if own_site is not None:
        table["mood"] = "simulation", np.array(own_site)
    error = np.linalg.norm((predicted - observed)[..., :2], axis=(-2, -1)).astype(np.float32)
    index = np.array(draws, np.int64)
    drawn = table.assign(
        log_joint=table["log_prior"] + table["log_likelihood"],
        total_error=("simulation", error.sum(axis=1, dtype=float)),
        step_error=(("simulation", "time"), error),
        sim_seed=table["seed"],
        trajectory=(("simulation", *FRAME), predicted.astype(np.float32)),
    ).isel(simulation=xr.DataArray(index, dims=DRAW))
    drawn = drawn.assign_coords(chain=range(index.shape[0]), draw=range(index.shape[1]))
    accepted = drawn["iteration"].values > 0
    accepted[:, 1:] = index[:, 1:] != index[:, :-1]
    stats = drawn[["log_joint", "total_error", FRAMES, "sim_seed", "step_error"]]
    posterior = drawn[[*SPACE.columns, *(["mood"] if own_site is not None else [])]]
    for name in (*SPACE.stated_sites, *SPACE.goal_sites):
        flags = {"flag_values": list(range(len(GOALS))), "flag_meanings": json.dumps(GOALS)}
        posterior[name].attrs = flags
    if by_frame is not None:
        table["step_log_likelihood"] = ("simulation", "time"), by_frame
    groups = {
        "posterior": posterior,
        "sample_stats": stats.assign(
            accepted=(DRAW, accepted),
            window=(DRAW, np.full(index.shape, -1) if window is None else np.array(window)),
            time=("time", frame["time"], {"units": "seconds"}),
        ),
        "simulated": drawn[["trajectory"]].assign(frame).assign_attrs(beta=0.05),
        "observed_data": xr.Dataset({"trajectory": (FRAME, observed)}, frame),
        "simulations": table,
        "constant_data": scene_dataset(scene),
    }
    tree = xr.DataTree.from_dict(groups)
    tree.attrs = {
        "event_id": "made-up",
        "settings": json.dumps({"seed": 0, "kernel": "local_mh", "beta": 0.05}),
        "cost": json.dumps({"simulations": len(simulations), "seconds": 12.5, "workers": 2}),
        "versions": json.dumps({"phase_ppl": "0"}),
        "kernel": "local_mh",
        "validity": validity,
        "weights": weights,
        "schema": SCHEMA,
    }
    return tree


def posterior_of(
    hypotheses: Sequence[Hypothesis | str | int],
    draws: Sequence[Sequence[int]],
    weights: str | None = None,
    **options: Any,
) -> Posterior:
    """Return a posterior of draws (chain, draw) of hypotheses, or of such with goals of red.

    Each was simulated once, all alike likely.
    """
    given = [one if isinstance(one, Hypothesis) else hypothesis(one) for one in hypotheses]
    simulations = [Simulation(one, seed, iteration=1) for seed, one in enumerate(given)]
    return Posterior(make_tree(simulations, draws, **options), weights)


def _simulation_table(simulations: Sequence[Simulation]) -> xr.Dataset:
    names = [field.name for field in dataclasses.fields(Simulation)[1:]]
    columns: dict[str, Any] = {n: np.array([getattr(one, n) for one in simulations]) for n in names}
    columns[FRAMES] = columns.pop("frames")
    hypotheses = [one.hypothesis for one in simulations]
    strengths = [(h.strength_red, h.strength_green) for h in hypotheses]
    stated = [(h.goal_red, h.goal_green) for h in hypotheses]
    effective = [h.effective_goals for h in hypotheses]
    columns |= zip(SPACE.strength_sites, np.array(strengths).T, strict=True)
    columns["alpha"] = np.array([ALPHAS.index(h.alpha) for h in hypotheses], np.int8)
    columns |= zip(SPACE.stated_sites, np.array(stated, np.int16).T, strict=True)
    columns |= zip(SPACE.goal_sites, np.array(effective, np.int16).T, strict=True)
    columns["log_prior_effective"] = columns["log_prior"]
    columns["total_error"] = -20 * columns["log_likelihood"]
    return xr.Dataset({name: ("simulation", column) for name, column in columns.items()})


def with_variables(tree: xr.DataTree, group: str, **variables: Any) -> xr.DataTree:
    """Return the tree with further variables, (dims, values), in a group."""
    changed = tree[group].to_dataset().assign(variables)
    return tree.assign({group: xr.DataTree(changed)})


def with_log_weight(tree: xr.DataTree, log_weight: Any) -> xr.DataTree:
    return with_variables(tree, "sample_stats", log_weight=(("chain", "draw"), log_weight))


def with_densities(
    tree: xr.DataTree,
    log_proposal: Any,
    log_bound: Any = np.inf,
    log_again: Any = -np.inf,
    n_again: Any = None,
) -> xr.DataTree:
    """Return the tree with the densities by which its simulations were proposed, one or of all."""
    given = {"log_proposal": log_proposal, "log_bound": log_bound, "log_again": log_again}
    given |= {} if n_again is None else {"n_again": n_again}  # as in older files
    shape = (tree["simulations"].sizes["simulation"],)
    columns = {name: np.array(np.broadcast_to(values, shape)) for name, values in given.items()}
    return with_variables(
        tree, "simulations", **{name: ("simulation", column) for name, column in columns.items()}
    )


def with_prior(tree: xr.DataTree, prior: Any) -> xr.DataTree:
    """Return the tree with prior masses of pairs: a table, or hypotheses with theirs."""
    if not isinstance(prior, np.ndarray):
        masses, prior = prior, np.zeros((len(GOALS), len(GOALS)))
        for one, mass in masses:
            prior[one.effective_goals] = mass
    return with_variables(tree, "constant_data", prior_of_pairs=(("pair_red", "pair_green"), prior))


def random_hypothesis(rng: np.random.Generator) -> Hypothesis:
    goals = [
        rng.choice([g for g in range(len(GOALS)) if not is_self_referring(g, holder)])
        for holder in range(2)
    ]
    alpha = ALPHAS[rng.integers(len(ALPHAS))]
    return Hypothesis(int(goals[0]), int(goals[1]), alpha, *rng.uniform(150, 600, 2))


def random_tree(
    seed: int = 0, n_chains: int = 4, n_draws: int = 6, n_frames: int = 8, **options: object
) -> xr.DataTree:
    """Return a tree with chains that accept about half of their random proposals."""
    rng = np.random.default_rng(seed)
    pool = [random_hypothesis(rng) for _ in range(6)]
    simulations: list[Simulation] = []
    draws = np.empty((n_chains, n_draws + 1), int)
    for chain, iteration in np.ndindex(draws.shape):
        accepted = iteration == 0 or rng.random() < 0.5
        completed = accepted or rng.random() < 0.5
        proposed = pool[rng.integers(len(pool))]
        force = {"strength_red": float(rng.uniform(150, 600))}
        proposed = Hypothesis.from_dict({**proposed.to_dict(), **force})
        simulations.append(
            Simulation(
                proposed,
                seed=int(rng.integers(2**40)),
                log_prior=-8.5 if proposed.alpha == (0, 0) else -9.2,
                log_likelihood=float(rng.uniform(-6, -1)),
                completed=completed,
                frames=n_frames if completed else int(rng.integers(1, n_frames)),
                chain=chain,
                iteration=iteration,
            )
        )
        draws[chain, iteration] = len(simulations) - 1 if accepted else draws[chain, iteration - 1]
    return make_tree(simulations, draws[:, 1:].tolist(), n_frames=n_frames, **options)  # type: ignore[arg-type]


def tree_by_frame(seed: int = 0) -> xr.DataTree:
    tree = random_tree(seed)
    rng = np.random.default_rng(seed)
    table = tree["simulations"].dataset.to_dataframe()
    by_frame = np.full((len(table), tree["observed_data"].sizes["time"]), np.nan)
    pairs = zip(table["log_likelihood"], table["frames_simulated"], strict=True)
    for row, (total, frames) in enumerate(pairs):
        by_frame[row, :frames] = total * rng.dirichlet(np.ones(frames))
    return with_variables(
        tree, "simulations", step_log_likelihood=(("simulation", "time"), by_frame)
    )
