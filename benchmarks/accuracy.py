"""Which goals and relation inference finds in the real videos, and why it misses some.

python benchmarks/accuracy.py --keep FOLDER [--kernel NAME] [--option KEY=VALUE ...] [--json FILE]

The posteriors are kept in the folder; a second run goes on from there. All weightings of the
draws are reported. A miss is laid at the door of

simulator  the answer explains the video better than the truth does, over many seeds
proposal   the truth explains it better, but was never tried
chain      the truth was tried, and lost

Weightings other than "count" use rejected proposals too.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, NamedTuple

import common
import numpy as np
from videos.hypotheses import log_mean_exp

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.analysis.tree import array
from phase_ppl.analysis.weights import WEIGHTINGS
from phase_ppl.models.effective import log_prior_of_effective
from phase_ppl.simulator.contract import simulate_one
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import Hypothesis

CAUSES = ("simulator", "proposal", "chain")
JUDGING_SEED = 5000
"""Apart from the seeds that a run is likely to have met."""

Pair = tuple[int, int]


class Task(NamedTuple):
    event: Event
    planner: PlannerConfig
    kernel: str
    options: dict[str, Any]
    settings: dict[str, Any]
    budget: int
    chains: int
    seed: int
    folder: str
    judging_seeds: int


def explain(task: Task) -> dict[str, Any]:
    """Infer one video, keep the posterior, and return what it says under every weighting."""
    event = task.event
    posterior = ppl.infer(
        event,
        kernel=task.kernel,
        chains=task.chains,
        budget=ppl.simulations(task.budget),
        seed=task.seed,
        planner=task.planner,
        settings=ppl.SimpleSettings(**task.settings),
        workers=1,
        progress=False,
        **task.options,
    )
    posterior.save(Path(task.folder) / f"{event.id}.nc")
    return judge(task, posterior)


def judge(task: Task, posterior: ppl.Posterior) -> dict[str, Any]:
    event, tree = task.event, posterior.tree
    truth = true_pair(event)
    pairs = list(
        zip(
            *(array(tree, "simulations", f"goal_{name}").tolist() for name in ("red", "green")),
            strict=True,
        )
    )
    first = array(tree, "simulations", "iteration") == 0
    tried = set(pairs)
    answers = {weights: answer(ppl.Posterior(tree, weights), truth) for weights in WEIGHTINGS}
    result = {
        "scenario": event.truth.scenario if event.truth else None,
        "answers": answers,
        "tried": truth in tried,
        "tried_at_first": truth
        in {pair for pair, at_first in zip(pairs, first, strict=True) if at_first},
        "pairs": len(tried),
        "cost": posterior.cost,
        "log_joint": {},
    }
    wrong = {tuple(a["pair"]) for a in answers.values()} - {truth}
    if wrong:
        result["log_joint"] = {
            str(list(pair)): log_joint(task, pair) for pair in sorted({truth, *wrong})
        }
    return result


def answer(posterior: ppl.Posterior, truth: Pair) -> dict[str, Any]:
    """Return the most probable goals and relation, and what the true ones got."""
    joint = posterior.joint("goal_red", "goal_green").values
    marginals = [posterior.marginal(name).values for name in ("goal_red", "goal_green")]
    relation = posterior.marginal("relation")
    true_relation = Hypothesis(*truth).relation
    return {
        "goals": [int(m.argmax()) for m in marginals],
        "pair": [int(i) for i in np.unravel_index(joint.argmax(), joint.shape)],
        "relation": str(relation.idxmax().item()),
        "true_goals": [float(m[g]) for m, g in zip(marginals, truth, strict=True)],
        "true_relation": float(relation.sel(relation=true_relation)),
        "marginals": [m.round(6).tolist() for m in marginals],
    }


def log_joint(task: Task, pair: Pair) -> float:
    """Return log prior + log mean likelihood of a pair of goals at the true strengths."""
    event, truth = task.event, task.event.truth
    assert truth is not None
    strengths = float(truth.strength_red or 0), float(truth.strength_green or 0)
    hypothesis = Hypothesis(*pair, (0, 0), *strengths)
    simulator = JointSimulator(task.planner)
    errors = [
        simulate_one(
            simulator, event.scene, hypothesis, seed, event.observation.positions
        ).total_error
        for seed in range(JUDGING_SEED, JUDGING_SEED + task.judging_seeds)
    ]
    log_likelihood = log_mean_exp(errors)
    given = {
        "strength_red": np.array([strengths[0]]),
        "strength_green": np.array([strengths[1]]),
    }
    return float(
        log_likelihood + log_prior_of_effective(ppl.priors.uniform, np.array([pair]), given)[0]
    )


def true_pair(event: Event) -> Pair:
    assert event.truth is not None
    return GOALS.index(event.truth.goal_red), GOALS.index(event.truth.goal_green)


def cause(result: dict[str, Any], truth: Pair, weights: str) -> str | None:
    """Return why the most probable pair of goals is wrong; None where it is right."""
    pair = result["answers"][weights]["pair"]
    if tuple(pair) == truth:
        return None
    if result["log_joint"][str(list(truth))] < result["log_joint"][str(pair)]:
        return "simulator"
    return "chain" if result["tried"] else "proposal"


def report(tasks: list[Task], results: list[dict[str, Any]], weights: str) -> dict[str, Any]:
    """Return the figures under a weighting."""
    rows = []
    for task, result in zip(tasks, results, strict=True):
        truth, found = true_pair(task.event), result["answers"][weights]
        rows.append(
            {
                "scenario": result["scenario"],
                "goals": np.mean([g == t for g, t in zip(found["goals"], truth, strict=True)]),
                "relation": found["relation"] == Hypothesis(*truth).relation,
                "log_score": np.mean(np.log(np.maximum(found["true_goals"], 1e-3))),
                "relation_log_score": np.log(max(found["true_relation"], 1e-3)),
                "tried": result["tried"],
                "tried_at_first": result["tried_at_first"],
                "cause": cause(result, truth, weights),
                "simulations": result["cost"]["simulations"],
                "minutes": result["cost"]["seconds"] / 60,
            }
        )
    measures = ("goals", "relation", "log_score", "relation_log_score", "tried", "tried_at_first")
    figures: dict[str, Any] = {"weights": weights, "n_videos": len(rows), "by_scenario": {}}
    for scenario in (*common.SCENARIOS, "all"):
        group = [row for row in rows if scenario in (row["scenario"], "all")]
        if not group:
            continue
        found: dict[str, Any] = {m: common.interval([r[m] for r in group]) for m in measures}
        found["n"] = len(group)
        found["misses"] = {name: sum(r["cause"] == name for r in group) for name in CAUSES}
        if scenario == "all":
            figures |= found
        else:
            figures["by_scenario"][scenario] = found
    figures["simulations"] = float(np.mean([row["simulations"] for row in rows]))
    figures["minutes_on_one_core"] = float(np.mean([row["minutes"] for row in rows]))
    return figures


def print_figures(figures: dict[str, Any]) -> None:
    print(f"weights {figures['weights']}: {figures['n_videos']} videos")
    for name, group in (*figures["by_scenario"].items(), ("all", figures)):
        shown = "  ".join(
            f"{m} {group[m]['value']:.2f} [{group[m]['ci_low']:.2f}, {group[m]['ci_high']:.2f}]"
            for m in ("goals", "relation", "log_score", "tried_at_first", "tried")
        )
        print(f"  {name:14} {shown}  misses {group['misses']}")
    print(
        f"  {figures['simulations']:.0f} simulations, {figures['minutes_on_one_core']:.2f} minutes "
        "a video on one core"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    common.add_planner(parser)
    parser.add_argument("--kernel", default="local_mh")
    parser.add_argument("--option", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument(
        "--simple", action="append", default=[], metavar="KEY=VALUE", help="a setting of SIMPLE"
    )
    parser.add_argument("--budget", type=int, default=105, help="simulations, initial ones too")
    parser.add_argument("--chains", type=int, default=15)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--half", choices=common.HALVES, default="all")
    parser.add_argument("--limit", type=int, help="a stratified subset of about so many videos")
    parser.add_argument("--judging-seeds", type=int, default=8, help="per hypothesis, for misses")
    parser.add_argument("--keep", required=True, metavar="FOLDER", help="posteriors and results")
    parser.add_argument("--json", metavar="FILE", help="write the figures as JSON")
    options = parser.parse_args()
    folder = Path(options.keep)
    folder.mkdir(parents=True, exist_ok=True)
    planner = common.planner_of(options)
    run = {
        "planner": planner,
        "kernel": options.kernel,
        "options": common.assignments(options.option),
        "settings": common.assignments(options.simple),
        "budget": options.budget,
        "chains": options.chains,
        "seed": options.seed,
        "folder": str(folder),
        "judging_seeds": options.judging_seeds,
    }
    tasks = [Task(event, **run) for event in common.dev_events(options.half, options.limit)]
    JointSimulator(planner).warm_up()
    results = common.resumed(
        explain,
        tasks,
        lambda task: task.event.id,
        "videos",
        folder / "results.jsonl",
        {**run, "planner": planner.to_dict()},
    )
    for task, result in zip(tasks, results, strict=True):
        truth = true_pair(task.event)
        marks = "".join(
            "+" if g == t else "-"
            for g, t in zip(result["answers"]["visited"]["goals"], truth, strict=True)
        )
        print(f"{task.event.id:24} {result['scenario']:14} goals {marks}", end="  ")
        print(f"relation {result['answers']['visited']['relation']:12}", end="")
        print(" ".join(f"{w}: {cause(result, truth, w)}" for w in WEIGHTINGS))
    figures = {weights: report(tasks, results, weights) for weights in WEIGHTINGS}
    for found in figures.values():
        print_figures(found)
    common.write(
        {"run": json.loads(json.dumps(run, default=repr)), "weights": figures}, options.json
    )


if __name__ == "__main__":
    main()
