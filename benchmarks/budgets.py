"""What does each kernel spend of an equal budget? How good is the reference of a comparison?

    python benchmarks/budgets.py [--only KERNEL ...] [--unit simulations|frames] [--budget N]
        [--chains M] [--json FILE]
    python benchmarks/budgets.py --reference [--trials N] [--json FILE]

The world is the tests' toy: eighteen hypotheses, and a simulator that takes microseconds. Few of
an agent's 36 goals have prior mass. So a kernel that tries all goals in a step simulates far fewer
than it might have to.

The reference enumerates all pairs of goals with a few simulations each. Their log likelihoods vary
from seed to seed by a given number of nats (5.8 under the paper's planner). Its true error is the
total variation from the exact marginals; its stated error is the total variation between its
halves. It ranks two kernels, one twice as far from the exact posterior as the other: by mean
distance alone, and as ``compare`` ranks them.
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np
import pandas as pd

import phase_ppl as ppl
from phase_ppl.analysis.comparison import RUN_COLUMNS, Comparison, distances
from phase_ppl.inference.reference import error_of, of_goals, of_masses
from phase_ppl.models.sites import SELF_REFERRING
from phase_ppl.world.goals import N_GOALS
from tests.inference.toy import few_goals, walkers, walking_event

FRAMES = 14
NOISE = (0.3, 1.0, 2.0, 4.0, 5.8)
PER_PAIR = (4, 16)
REPEATS, DRAWS = 8, 500


def main() -> None:
    names = ppl.available_kernels()
    parser = common.parser(__doc__, "json")
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="KERNEL")
    parser.add_argument("--unit", choices=("simulations", "frames"), default="simulations")
    parser.add_argument("--budget", type=int, metavar="N", help="default 1500, or 15000 frames")
    parser.add_argument("--chains", type=int, default=16, metavar="M")
    parser.add_argument("--reference", action="store_true", help="judge the reference instead")
    parser.add_argument("--trials", type=int, default=100, metavar="N", help="default 100")
    options = parser.parse_args()
    if options.reference:
        common.write({"reference": judge_references(options.trials)}, options.json)
        return
    n = options.budget or {"simulations": 1500, "frames": 15_000}[options.unit]
    report: dict[str, Any] = {"unit": options.unit, "budget": n, "kernels": {}}
    print(f"{n} {options.unit} each, {options.chains} chains, events of {FRAMES} frames")
    print(f"{'kernel':20}{'iterations':>12}{'simulations':>13}{'frames':>10}{'frames each':>13}")
    for name in options.only:
        result = spent(name, getattr(ppl, options.unit)(n), options.chains)
        report["kernels"][name] = result
        if "refused" in result:
            print(f"{name:20}  {result['refused']}", flush=True)
            continue
        each = result["frames"] / result["simulations"]
        print(
            f"{name:20}{result['iterations']:12}{result['simulations']:13}{result['frames']:10}"
            f"{each:13.1f}",
            flush=True,
        )
    common.write(report, options.json)


def spent(name: str, budget: Any, chains: int) -> dict[str, Any]:
    """Return iterations, simulations and frames of a run of a kernel under a budget."""
    try:
        post = ppl.infer(
            walking_event(FRAMES),
            ppl.Model(prior=few_goals, simulator=walkers),
            kernel=name,
            chains=chains,
            budget=budget,
            workers=1,
            progress=False,
        )
    except ppl.PhasePPLError as error:
        return {"refused": str(error)}
    assert isinstance(post, ppl.Posterior), "a kernel is named"
    cost = {name: post.cost[name] for name in ("simulations", "frames")}
    return {"iterations": post.settings["iterations"], **cost}


def judge_references(trials: int) -> list[dict[str, Any]]:
    """Print and return how far references are off, by noise and simulations per pair."""
    heads = ("true error", "stated", "true < stated", "means: wrong", "ranked", "ranked wrong")
    print(f"{'sd [nats]':>10}{'per pair':>10}" + "".join(f"{head:>15}" for head in heads))
    rows = []
    for sd in NOISE:
        for per_pair in PER_PAIR:
            rng = np.random.default_rng(0)
            found = [one_reference(rng, sd, per_pair) for _ in range(trials)]
            true, stated, wrong, ranked, ranked_wrong = np.array(found, float).T
            row = {
                "true": true.mean(),
                "stated": stated.mean(),
                "held": (true < stated).mean(),
                "wrong_by_means": wrong.mean(),
                "ranked": ranked.mean(),
                "ranked_wrong": ranked_wrong.mean(),
            }
            print(f"{sd:10}{per_pair:10}" + "".join(f"{v:15.2f}" for v in row.values()), flush=True)
            rows.append({"sd": sd, "per_pair": per_pair, **{k: float(v) for k, v in row.items()}})
    return rows


def one_reference(
    rng: np.random.Generator, sd: float, per_pair: int
) -> tuple[float, float, bool, bool, bool]:
    """Return one reference's true and stated error, and three facts about two kernels: means in the
    wrong order, ranked at all, ranked wrongly."""
    pairs = np.argwhere(~SELF_REFERRING[0][:, None] & ~SELF_REFERRING[1][None, :])
    exact, other = (table(pairs, log_masses(rng, pairs)) for _ in range(2))
    level = np.log(exact[tuple(pairs.T)])
    simulated = level[:, None] + rng.normal(0, sd, (len(pairs), per_pair))
    found = of_masses(pairs, simulated)
    error = error_of([(of_goals(one), of_goals(half)) for one, half in found.halves])
    assert error is not None
    reference = of_goals(found.probability)
    true = distances(reference, of_goals(exact))["tv_goals"]
    rows = []
    for name, share in (("near", 0.2), ("far", 0.4)):
        for repeat in range(REPEATS):
            mixed = (1 - share) * exact + share * other
            drawn = rng.multinomial(DRAWS, mixed.ravel()).reshape(mixed.shape) / DRAWS
            run = dict.fromkeys(RUN_COLUMNS, 0.0) | distances(of_goals(drawn), reference)
            rows.append({**run, "kernel": name, "repeat": repeat})
    settings = {"kernels": {"near": {}, "far": {}}, "reference": {"error": error}}
    ranks = Comparison(pd.DataFrame(rows), pd.DataFrame(), settings).ranks("tv_goals")
    near, far = ranks.loc["near"], ranks.loc["far"]
    ranked_wrong = bool(far["worst"] < near["best"])
    ranked = ranked_wrong or bool(near["worst"] < far["best"])
    return true, error["tv_goals"], bool(near["mean"] > far["mean"]), ranked, ranked_wrong


def log_masses(rng: np.random.Generator, pairs: Any) -> Any:
    """Return log masses of pairs of goals, mostly a sum over agents, of which a few stand out."""
    level = rng.normal(0, 4, (2, N_GOALS))
    return level[0, pairs[:, 0]] + level[1, pairs[:, 1]] + rng.normal(0, 1, len(pairs))


def table(pairs: Any, log_mass: Any) -> Any:
    """Return (goal_red, goal_green) probabilities of pairs."""
    probability = np.zeros((N_GOALS, N_GOALS))
    probability[tuple(pairs.T)] = np.exp(log_mass - log_mass.max())
    return probability / probability.sum()


if __name__ == "__main__":
    main()
