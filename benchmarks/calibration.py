"""Simulation-based calibration (Talts et al. 2018): are posteriors as sure as they should be?

    python benchmarks/calibration.py [--kernel NAME] [--events N] [--json FILE] [--figure FILE]

A hypothesis is drawn from the prior and simulated. An observation is drawn around that trajectory
from the likelihood's noise. The truth then has a rank among the particles of a run. Over many
events, ranks are evenly spread if the kernel draws from the posterior.

Ranked are both strengths and the marginal probability of both agents' effective goals; ties are
broken by chance. Kernels with weighted draws are refused. The simulator is the tests' fast one,
whose agents walk to their goals.
"""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import common
import jax
import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chisquare

import phase_ppl as ppl
from phase_ppl.inference.registry import kernel_info
from phase_ppl.models.density import draw
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis
from tests.inference.toy import walkers, walking_event

FRAMES = 12
BETA = 1.0
"""1 / units: informative noise, some 8 units per frame over all entities."""

ARENA = (-84.0, 116.0, -88.0, 112.0)

PARTICLES = 15
"""Ranks go from 0 to this."""

NAMES = ("strength_red", "strength_green", "goal_red", "goal_green")
BINS = 8


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--kernel", default="local_mh", choices=ranked_kernels())
    parser.add_argument("--rule", help="rule of local_mh: exact or paper")
    parser.add_argument("--events", type=int, default=200)
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--figure", metavar="FILE")
    options = parser.parse_args()
    rule = {} if options.rule is None else {"rule": options.rule}
    tasks = [(seed, options.kernel, options.iterations, rule) for seed in range(options.events)]
    by_seed = {task[0]: ranks for task, ranks in common.parallel(ranked, tasks, "events")}
    ranks = np.array([by_seed[seed] for seed in sorted(by_seed)])
    report: dict[str, Any] = {
        "kernel": options.kernel,
        **rule,
        "events": options.events,
        "iterations": options.iterations,
        "ranks": {name: ranks[:, i].tolist() for i, name in enumerate(NAMES)},
        "p_even": {name: p_even(ranks[:, i]) for i, name in enumerate(NAMES)},
        "mean_rank": {name: float(ranks[:, i].mean() / PARTICLES) for i, name in enumerate(NAMES)},
    }
    print(f"{'':16}{'mean rank (0.5 if even)':>25}{'p of an even spread':>22}")
    for name in NAMES:
        print(f"{name:16}{report['mean_rank'][name]:25.3f}{report['p_even'][name]:22.3f}")
    common.write(report, options.json)
    if options.figure:
        draw_figure(ranks, options.figure)


def ranked_kernels() -> list[str]:
    """Return the kernels whose draws all count alike."""
    found = {name: kernel_info(name) for name in ppl.available_kernels()}
    return [name for name, info in found.items() if info.keeps == "all" and not info.weighted]


def ranked(task: tuple[int, str, int, dict[str, Any]]) -> list[int]:
    """Return the ranks of the truth among the last particles, for one event."""
    seed, kernel, iterations, options = task
    rng = np.random.default_rng([seed, 5])
    model = ppl.Model(simulator=walkers, likelihood=RadialLikelihood(BETA))
    truth, event = drawn_event(model, seed)
    post = ppl.infer(
        event,
        model,
        kernel=kernel,
        chains=PARTICLES,
        iterations=iterations,
        seed=seed,
        workers=1,
        progress=False,
        **options,
    )
    draws = post.tree["posterior"].dataset
    ranks = [
        rank(draws[name].values[:, -1], strength, rng)
        for name, strength in zip(NAMES[:2], truth.strengths, strict=True)
    ]
    for name, goal in zip(NAMES[2:], truth.effective_goals, strict=True):
        codes = draws[name].values
        # the probability is of draws before the ranked ones
        earlier = codes[:, codes.shape[1] // 4 : -(codes.shape[1] // 4)]
        probability = np.bincount(earlier.ravel(), minlength=36) / earlier.size
        ranks.append(rank(probability[codes[:, -1]], probability[goal], rng))
    return ranks


def drawn_event(model: ppl.Model, seed: int) -> tuple[Hypothesis, Event]:
    """Return a hypothesis from the prior and an event in which it is true."""
    key = jax.random.key(seed)
    sites = {name: np.asarray(v) for name, v in draw(model.prior, key).items()}
    truth = Hypothesis(
        int(sites["goal_red"]),
        int(sites["goal_green"]),
        ALPHAS[int(sites["alpha"])],
        float(sites["strength_red"]),
        float(sites["strength_green"]),
    )
    # noise knows no border: the arena is large enough for it
    scene = dataclasses.replace(walking_event().scene, arena=ARENA)
    rng = np.random.default_rng([seed, 7])
    frames = np.array(list(itertools.islice(walkers(scene, truth, rng), FRAMES)))
    frames[..., :2] = RadialLikelihood(BETA).replicate(frames[..., :2], rng)
    return truth, Event(scene, Observation(frames), id=f"drawn-{seed}")


def rank(values: NDArray[Any], truth: float, rng: np.random.Generator) -> int:
    """Return how many values lie below the truth; of those equal to it, some by chance."""
    equal = int((values == truth).sum())
    return int((values < truth).sum()) + int(rng.integers(equal + 1))


def p_even(ranks: NDArray[Any]) -> float:
    """Return the p-value of a chi-squared test of evenly spread ranks."""
    counts = np.bincount(ranks * BINS // (PARTICLES + 1), minlength=BINS)
    return float(chisquare(counts).pvalue)


def draw_figure(ranks: NDArray[Any], file: str) -> None:
    """Draw the histograms with the band that 99 % of even ones stay in, bar by bar."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 2.6), layout="constrained")
    low, high = binom.ppf([0.005, 0.995], len(ranks), 1 / BINS)
    axes = figure.subplots(1, len(NAMES), sharey=True)
    for i, (name, ax) in enumerate(zip(NAMES, axes, strict=True)):
        counts = np.bincount(ranks[:, i] * BINS // (PARTICLES + 1), minlength=BINS)
        ax.axhspan(low, high, color="0.88")
        ax.bar((np.arange(BINS) + 0.5) / BINS, counts, 0.9 / BINS, color="#4878a8")
        what = name.replace("_", " of ") if i < 2 else f"probability of {name.replace('_', ' of ')}"
        ax.set(title=what, xlabel="rank of the truth", xlim=(0, 1))
        ax.title.set_size(9)
    axes[0].set_ylabel("events")
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
