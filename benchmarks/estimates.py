"""Do the numbers of a posterior mean what they say, on worlds whose posterior is known?

python benchmarks/estimates.py [--only KERNEL ...] [--world flat|noisy ...] [--runs N] [--json FILE]

Every pair of goals and the strengths decide how far a simulation ends from the video, and chance
does, so that the posterior can be summed exactly: in the world "flat" not at all (posterior =
prior), in "noisy" with a standard deviation over seeds of some nats. N runs of 15 particles, of 6
and of 60 iterations, are weighed in every way. Printed are, for P(relation), P(goal) and the mean
strengths: the mean distance from the exact number, how often it lies within 1.96 ``error`` of the
answer (aim: 0.95), and the log score of the goals in the posterior itself.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import common
import numpy as np
import xarray as xr

import phase_ppl as ppl
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.inference.draws import burn_in
from phase_ppl.inference.tables import bottom_up_tables
from phase_ppl.models.effective import log_prior_of_effective
from phase_ppl.models.priors import uniform
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.goals import N_GOALS, is_self_referring
from phase_ppl.world.hypothesis import RELATION_TABLE, RELATIONS, STRENGTH_RANGE, Hypothesis
from phase_ppl.world.scene import Scene
from tests.inference.toy import walking_event

CHAINS = 15
LENGTHS = (6, 60)
SEEDS = 8
"""Simulator seeds make one of so many equally likely simulations."""

BEST_STRENGTH = {"noisy": (340.0, 190.0), "misled": (420.0, 300.0), "flat": (300.0, 300.0)}
KERNELS = ("local_mh", "mixture", "prior_mh", "single_site_mh", "random_walk_mh")
WORLDS = {"flat": (0.0, 0.0, 0.0), "noisy": (30.0, 4.0, 0.01), "misled": (30.0, 4.0, 0.03)}
"""World -> typical distance of a pair of goals from the video, its spread over seeds, units, and
what a newton off the fitting strengths adds. In 14 frames at beta 0.05 a unit is 0.7 nats. In the
last one the proposals know nothing of what fits."""


@functools.cache
def offsets(world: str) -> FloatArray:
    """Return (goal_red, goal_green, seed) the distance from the video at the best strengths."""
    level, spread, _ = WORLDS[world]
    rng = np.random.default_rng(3)
    base = level * rng.gamma(4.0, 0.25, (N_GOALS, N_GOALS, 1))
    if world == "noisy":  # as in videos, what is proposed more often fits better
        seen = walking_event()
        tables = bottom_up_tables(seen.scene, seen.observation, ppl.SimpleSettings())
        for agent, axis in ((0, 1), (1, 0)):
            logits = np.asarray(tables.goal_logits)[-1, 0, agent]
            fit = np.clip(logits - logits.max(), -4.0, 0.0) / 4.0
            base *= 1.0 - 0.6 * np.expand_dims(1.0 + fit, (axis, 2))
    return base + spread * np.abs(rng.normal(size=(N_GOALS, N_GOALS, SEEDS)))


def slope(world: str) -> float:
    """Return the distance from the video per newton off the strengths that fit, units."""
    return WORLDS[world][2]


def simulator(
    video: FloatArray,
    offset: FloatArray,
    slope: float,
    best: tuple[float, float],
    scene: Scene,
    hypothesis: Hypothesis,
    rng: np.random.Generator,
) -> Iterator[FloatArray]:
    """Yield the video, moved aside."""
    red, green = hypothesis.effective_goals
    aside = offset[red, green, rng.integers(SEEDS)]
    aside += slope * np.abs(np.subtract(hypothesis.strengths, best)).sum()
    for frame in itertools.cycle(video):
        moved = frame.copy()
        moved[0, 0] += aside
        yield moved


@functools.cache
def exact(world: str) -> dict[str, FloatArray]:
    """Return the marginals of goals and relation, and the mean strengths, summed exactly."""
    pairs = np.array(
        [
            (red, green)
            for red, green in itertools.product(range(N_GOALS), repeat=2)
            if not is_self_referring(red, 0) and not is_self_referring(green, 1)
        ]
    )
    middle = {name: np.full(len(pairs), 400.0) for name in ("strength_red", "strength_green")}
    log_prior = log_prior_of_effective(uniform, pairs, middle)
    rate = 0.05 * walking_event().observation.n_frames
    log_mean = np.log(np.exp(-rate * offsets(world)[pairs[:, 0], pairs[:, 1]]).mean(axis=1))
    mass = np.exp(log_prior + log_mean - (log_prior + log_mean).max())
    mass /= mass.sum()
    grid = np.linspace(*STRENGTH_RANGE, 4001)
    means = []
    for best in BEST_STRENGTH[world]:
        density = np.exp(-rate * slope(world) * np.abs(grid - best))
        means.append(float((grid * density).sum() / density.sum()))
    relation = RELATION_TABLE[pairs[:, 0], pairs[:, 1]]
    return {
        "goal_red": np.bincount(pairs[:, 0], mass, N_GOALS),
        "goal_green": np.bincount(pairs[:, 1], mass, N_GOALS),
        "relation": np.bincount(relation, mass, len(RELATIONS)),
        "strength": np.array(means),
    }


def shortened(tree: xr.DataTree, chains: slice, draws: int) -> xr.DataTree:
    """Return what a run of only some of the chains, and of so many iterations, would have left."""
    first, last = chains.start, chains.stop
    groups = {}
    for name, node in tree.children.items():
        dataset = node.to_dataset()
        if "chain" in dataset.dims:
            dataset = dataset.isel(chain=chains, draw=slice(0, draws))
            dataset = dataset.assign_coords(chain=np.arange(dataset.sizes["chain"]))
        if name == "simulations":
            chain, iteration = dataset["chain"].values, dataset["iteration"].values
            kept = (first <= chain) & (chain < last) & (iteration <= draws)
            dataset = dataset.isel(simulation=kept)
            dataset["chain"] = dataset["chain"] - first
        groups[name] = dataset
    result = xr.DataTree.from_dict(groups)
    result.attrs = {**tree.attrs, "burn_in": burn_in(draws)}
    return result


def measured(tree: xr.DataTree, world: str, draws: int, weights: str) -> dict[str, Any]:
    """Return distance, coverage and log score of a way to weigh, over the runs of a tree."""
    known = exact(world)
    runs = tree["posterior"].sizes["chain"] // CHAINS
    off: dict[str, list[float]] = {"goal": [], "relation": [], "strength": []}
    held: dict[str, list[bool]] = {name: [] for name in off}
    scores = []
    for run in range(runs):
        part = shortened(tree, slice(run * CHAINS, (run + 1) * CHAINS), draws)
        post = Posterior(part, weights)
        score = 0.0
        for name in ("goal_red", "goal_green", "relation"):
            found, kind = post.marginal(name), name.split("_")[0]
            distance = found.values - known[name]
            off[kind].append(0.5 * float(np.abs(distance).sum()))
            # of labels of some probability: those of the rest are 0 within 0
            rows = known[name] > 0.05
            held[kind] += (np.abs(distance) <= 1.96 * found["error"].values)[rows].tolist()
            if kind == "goal":
                score += float(known[name] @ np.log(np.maximum(found.values, 1e-4))) / 2
        for agent, mean in zip(("red", "green"), known["strength"], strict=True):
            answer = post.mean(f"strength_{agent}")
            off["strength"].append(abs(float(answer) - mean))
            held["strength"].append(bool(abs(answer - mean) <= 1.96 * answer.error))
        scores.append(score)
    return {
        **{f"{kind}_off": float(np.mean(values)) for kind, values in off.items()},
        **{f"{kind}_covered": float(np.mean(values)) for kind, values in held.items()},
        "log_score": float(np.mean(scores)),
    }


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--only", nargs="+", default=KERNELS, metavar="KERNEL")
    parser.add_argument("--world", nargs="+", default=list(WORLDS), choices=list(WORLDS))
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--lengths", type=int, nargs="+", default=LENGTHS)
    parser.add_argument("--weights", nargs="+", default=["count", "stratified"])
    parser.add_argument("--keep", metavar="DIR")
    options = parser.parse_args()
    report: dict[str, Any] = {}
    head = f"{'world':7}{'kernel':16}{'L':>4} {'weights':11}"
    print(head + "   off: goal relation newtons   covered: goal relation strength   log score")
    for world, kernel in itertools.product(options.world, options.only):
        kept = Path(options.keep) / f"{world}-{kernel}.nc" if options.keep else None
        if kept is not None and kept.exists():
            tree = Posterior.load(kept, "count").tree
        else:
            event = walking_event()
            table = event.observation.trajectory, offsets(world), slope(world), BEST_STRENGTH[world]
            post = ppl.infer(
                event,
                ppl.Model(simulator=functools.partial(simulator, *table)),
                kernel=kernel,
                chains=CHAINS * options.runs,
                iterations=max(options.lengths),
                seed=0,
            )
            tree = post.tree
            if kept is not None:
                post.save(kept)
        for draws, weights in itertools.product(options.lengths, options.weights):
            row = measured(tree, world, draws, weights)
            report[f"{world} {kernel} {draws} {weights}"] = row
            print(
                f"{world:7}{kernel:16}{draws:4} {weights:11}"
                f"{row['goal_off']:12.3f}{row['relation_off']:9.3f}{row['strength_off']:8.1f}"
                f"{row['goal_covered']:17.2f}{row['relation_covered']:9.2f}"
                f"{row['strength_covered']:9.2f}{row['log_score']:12.2f}",
                flush=True,
            )
    common.write(report, options.json)


if __name__ == "__main__":
    main()
