"""What did inference find in real videos, and why did it miss some?

    python benchmarks/accuracy.py FOLDER [FOLDER ...] [--judging-seeds K] [--keep FILE]
        [--json FILE]

``phase-ppl evaluate EVENTS --model simple --out FOLDER`` writes such a folder. Kernel, prior and
planner are chosen there. Answers are shown by weighting of the draws; all weightings except
"count" also use rejected proposals. A miss is put down to one of three:

* ``simulator``: over many seeds, the answer explains the video better than the truth does;
* ``proposal``: the truth explains it better, but was never tried;
* ``chain``: the truth was tried, and lost.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import common
import numpy as np
from videos.judging import Pair, Task, judge, model_of, true_pair

import phase_ppl as ppl
from phase_ppl.analysis.tree import array
from phase_ppl.analysis.weights import WEIGHTINGS
from phase_ppl.evaluation.folder import POSTERIOR, ResultsFolder
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import Hypothesis

CAUSES = ("simulator", "proposal", "chain")
MEASURES = ("goals", "relation", "log_score", "relation_log_score", "tried", "tried_at_first")
FLOOR = 1e-3
"""The least probability in a log score: draws leave zeros."""


def read(results: ResultsFolder, event: Event) -> dict[str, Any] | None:
    """Return what the posterior of an event says under every weighting, and what was tried.

    None where the event is not finished.
    """
    prediction = results.prediction(event.id)
    if prediction is None:
        return None
    post = ppl.load_posterior(results.folder_of(event.id) / POSTERIOR)
    assert isinstance(post, ppl.Posterior)
    tree = post.tree
    columns = [array(tree, "simulations", f"goal_{name}").tolist() for name in ("red", "green")]
    pairs = list(zip(*columns, strict=True))
    first = array(tree, "simulations", "iteration") == 0
    truth = true_pair(event)
    return {
        "answers": {weights: answer(ppl.Posterior(tree, weights), truth) for weights in WEIGHTINGS},
        "tried": truth in pairs,
        "tried_at_first": any(
            pair == truth and early for pair, early in zip(pairs, first, strict=True)
        ),
        "cost": prediction.cost,
    }


def answer(posterior: ppl.Posterior, truth: Pair) -> dict[str, Any]:
    """Return the most probable goals and relation, and what the true ones got."""
    joint = posterior.joint("goal_red", "goal_green").values
    marginals = [posterior.marginal(name).values for name in ("goal_red", "goal_green")]
    relation = posterior.marginal("relation")
    true_relation = Hypothesis(truth[0], truth[1]).relation
    return {
        "goals": [int(m.argmax()) for m in marginals],
        "pair": tuple(int(i) for i in np.unravel_index(joint.argmax(), joint.shape)),
        "relation": str(relation.idxmax().item()),
        "true_goals": [float(m[g]) for m, g in zip(marginals, truth, strict=True)],
        "true_relation": float(relation.sel(relation=true_relation)),
    }


def cause(row: dict[str, Any], log_joint: dict[Pair, float], weights: str) -> str | None:
    """Return why the most probable pair of goals is wrong; None where it is right."""
    pair = row["answers"][weights]["pair"]
    if pair == row["truth"]:
        return None
    if log_joint[row["truth"]] < log_joint[pair]:
        return "simulator"
    return "chain" if row["tried"] else "proposal"


def report(rows: list[dict[str, Any]], weights: str) -> dict[str, Any]:
    """Return the figures under a weighting, by scenario and of all."""
    measured = []
    for row in rows:
        found = row["answers"][weights]
        pairs = zip(found["goals"], row["truth"], strict=True)
        measured.append(
            {
                **row,
                "goals": np.mean([goal == true for goal, true in pairs]),
                "relation": found["relation"] == Hypothesis(*row["truth"]).relation,
                "log_score": np.mean(np.log(np.maximum(found["true_goals"], FLOOR))),
                "relation_log_score": np.log(max(found["true_relation"], FLOOR)),
                "cause": row["causes"].get(weights),
            }
        )
    return {
        scenario: {
            **{m: common.interval([row[m] for row in group]) for m in MEASURES},
            "n": len(group),
            "misses": {name: sum(row["cause"] == name for row in group) for name in CAUSES},
        }
        for scenario, group in common.by_scenario(measured)
    }


def print_figures(weights: str, figures: dict[str, Any]) -> None:
    print(f"  weights {weights}")
    for name, group in figures.items():
        measures = ("goals", "relation", "log_score", "tried_at_first", "tried")
        shown = "  ".join(f"{name} {common.shown(group[name])}" for name in measures)
        misses = "  ".join(f"{name} {count}" for name, count in group["misses"].items())
        print(f"    {name:14}{group['n']:3}  {shown}  missed: {misses}")


def main() -> None:
    parser = common.parser(__doc__, "half", "json")
    parser.add_argument("folders", nargs="+", metavar="FOLDER", type=Path)
    parser.add_argument(
        "--judging-seeds", type=int, default=8, help="seeds per hypothesis, to judge misses"
    )
    parser.add_argument(
        "--keep", metavar="FILE", type=Path, help="keeps judgments; a second run continues"
    )
    options = parser.parse_args()
    asked = {event.id for event in common.dev_events(options.half)}
    found: dict[Path, list[dict[str, Any]]] = {}
    tasks: dict[str, Task] = {}
    for folder in options.folders:
        results = ResultsFolder.open(folder)
        model = model_of(results.settings)
        if model is None:
            sys.exit(
                f"{folder} is of the model {results.settings['model']}, not SIMPLE or a lesion"
            )
        found[folder] = []
        for event in results.events:
            answers = read(results, event) if event.id in asked else None
            if answers is None:
                continue
            truth = true_pair(event)
            row: dict[str, Any] = {"id": event.id, "scenario": event.truth.scenario, "truth": truth}
            row |= answers
            wrong = {a["pair"] for a in row["answers"].values()} - {truth}
            row["judged"] = {}
            for pair in {truth, *wrong} if wrong else ():
                task = Task(event, pair, *model, options.judging_seeds)
                row["judged"][pair] = task.name
                tasks[task.name] = task
            found[folder].append(row)
        if not found[folder]:
            sys.exit(f"{folder} has answers for none of the real videos of this half")
    judged = common.resumed(
        judge,
        list(tasks.values()),
        lambda task: task.name,
        "misses",
        options.keep,
        {"seeds": options.judging_seeds},
    )
    log_joints = dict(zip(tasks, (one["log_joint"] for one in judged), strict=True))
    figures: dict[str, Any] = {}
    for folder, rows in found.items():
        for row in rows:
            log_joint = {pair: log_joints[name] for pair, name in row["judged"].items()}
            row["causes"] = {weights: cause(row, log_joint, weights) for weights in WEIGHTINGS}
        figures[str(folder)] = summary(folder, rows)
    common.write(figures, options.json)


def summary(folder: Path, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Print the figures of one evaluation and return them."""
    cost = {
        "simulations": float(np.mean([row["cost"]["simulations"] for row in rows])),
        "minutes_on_one_core": float(np.mean([row["cost"]["seconds"] for row in rows])) / 60,
    }
    words = ", ".join(f"{value:.1f} {name.replace('_', ' ')}" for name, value in cost.items())
    print(f"{folder}: {len(rows)} videos, {words} a video")
    for row in rows:
        causes = {weights: why for weights, why in row["causes"].items() if why}
        if causes:
            words = "  ".join(f"{weights}: {why}" for weights, why in causes.items())
            print(f"  missed {row['id']:24} {row['scenario']:14} {words}")
    by_weights = {weights: report(rows, weights) for weights in WEIGHTINGS}
    for weights, figures in by_weights.items():
        print_figures(weights, figures)
    return {**cost, "weights": by_weights}


if __name__ == "__main__":
    main()
