"""Does the simulator come nearest to the video under the true pair of goals?

``--truth-only`` tries no wrong pair. It asks how near simulations under the truth come, over all
noise seeds. That compares planners in minutes, with less noise than a rate.

``--simulated`` replaces the videos by simulations under the truth from the same starts. The
simulator is a perfect model of these, so their rate shows what seed noise alone leaves.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path
from typing import Any, NamedTuple

import common
import numpy as np

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.simulator.contract import simulate_one
from phase_ppl.simulator.joint import JointSimulator, simulate
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS, is_self_referring
from phase_ppl.world.hypothesis import Hypothesis

BETA = 0.05
"""Weight of the summed error in the log-likelihood (the paper's)."""

SEED_OF_SIMULATED = 1000
"""Apart from the seeds of the simulations that are compared."""


class Task(NamedTuple):
    event: Event
    planner: PlannerConfig
    seeds: int
    noise_seeds: int
    truth_only: bool


def log_mean_exp(errors: list[float]) -> float:
    values = -BETA * np.array(errors)
    return float(values.max() + np.log(np.mean(np.exp(values - values.max()))))


def wrong_pairs(truth: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the pairs of goals that are wrong in exactly one agent."""
    pairs = []
    for agent in range(2):
        for goal in range(len(GOALS)):
            if goal != truth[agent] and not is_self_referring(goal, agent):
                pairs.append((goal, truth[1]) if agent == 0 else (truth[0], goal))
    return pairs


def judge(task: Task) -> dict[str, Any]:
    """Return how the true pair of goals of one video compares with all that are half wrong.

    Simulations of wrong pairs are stopped once they are worse. If that leaves open which pair is
    better, the stopped simulation is run to its end.
    """
    event, truth = task.event, task.event.truth
    simulator, seen = JointSimulator(task.planner), event.observation.positions
    told = common.true_hypothesis(event)
    goals = told.effective_goals

    def error(pair: tuple[int, ...], seed: int, ceiling: float = math.inf) -> float:
        hypothesis = Hypothesis(pair[0], pair[1], (0, 0), *told.strengths)
        result = simulate_one(simulator, event.scene, hypothesis, seed, seen, ceiling)
        assert result.failure is None, result.failure
        within = result.completed and result.total_error <= ceiling
        return result.total_error if within else math.inf

    true_errors = [error(goals, seed) for seed in range(task.noise_seeds)]
    evidence = log_mean_exp(true_errors[: task.seeds])
    ceiling = -evidence / BETA
    better = []
    for pair in [] if task.truth_only else wrong_pairs(goals):
        errors = [error(pair, seed, ceiling) for seed in range(task.seeds)]
        if all(math.isinf(e) for e in errors):
            continue
        if log_mean_exp(errors) <= evidence:
            errors = [error(pair, s) if math.isinf(e) else e for s, e in enumerate(errors)]
        if log_mean_exp(errors) > evidence:
            better.append([GOALS[pair[0]], GOALS[pair[1]], log_mean_exp(errors)])
    return {
        "scenario": truth.scenario,
        "truth": [truth.goal_red, truth.goal_green],
        "frames": event.observation.n_frames,
        "log_likelihood": evidence,
        "errors": true_errors,
        "better": sorted(better, key=lambda row: -row[2]),
    }


def simulated(event: Event, planner: PlannerConfig) -> Event:
    """Return the event with its trajectory replaced by a simulated one of the same length."""
    other = simulate(
        event.scene,
        common.true_hypothesis(event),
        frames=event.observation.n_frames,
        seed=SEED_OF_SIMULATED,
        planner=planner,
        overlapping=True,
    )
    return dataclasses.replace(event, observation=other.observation)


def near(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how near simulations under the truth come to the videos."""
    spread = [BETA * float(np.std(result["errors"], ddof=1)) for result in results]
    return {
        "n_videos": len(results),
        "log_likelihood": common.interval([log_mean_exp(result["errors"]) for result in results]),
        "loglik_sd_median": float(np.median(spread)),
        "mean_error_per_frame": common.interval(
            [np.mean(result["errors"]) / result["frames"] for result in results]
        ),
    }


def report(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of the results of many videos."""

    def rate(group: list[dict[str, Any]], rank: int) -> dict[str, float]:
        return common.interval([len(result["better"]) < rank for result in group])

    def rates(group: list[dict[str, Any]]) -> dict[str, Any]:
        return {"true_best_rate": rate(group, 1), "true_top5_rate": rate(group, 5)}

    *groups, _ = common.by_scenario(results)
    return near(results) | {
        **rates(results),
        "by_scenario": {name: {**rates(group), "n": len(group)} for name, group in groups},
        "median_rank": float(np.median([len(result["better"]) + 1 for result in results])),
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    common.add(parser, "half", "limit")
    common.add_planner(parser)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--noise-seeds", type=int, default=16)
    parser.add_argument("--truth-only", action="store_true", help="try no wrong pairs")
    parser.add_argument("--simulated", action="store_true", help="simulated instead of real videos")
    parser.add_argument("--keep", help="keeps results per video; a second run continues")


def main(options: argparse.Namespace) -> dict[str, Any]:
    planner = common.planner_of(options)
    events = common.dev_events(options.half, options.limit)
    if options.simulated:
        events = [simulated(event, planner) for event in events]
    if options.noise_seeds < max(2, options.seeds):
        raise SystemExit(f"--noise-seeds {options.noise_seeds}: at least 2, and --seeds of them")
    given = planner, options.seeds, options.noise_seeds, options.truth_only
    tasks = [Task(event, *given) for event in events]
    settings = {
        "planner": planner.to_dict(),
        "seeds": options.seeds,
        "noise_seeds": options.noise_seeds,
        "simulated": options.simulated,
        "truth_only": options.truth_only,
    }
    JointSimulator(planner).warm_up()
    results = common.resumed(
        judge,
        tasks,
        lambda task: task.event.id,
        "videos",
        Path(options.keep) if options.keep else None,
        settings,
    )
    figures = near(results) if options.truth_only else report(results)
    for task, result in zip(tasks, results, strict=True):
        near_truth = log_mean_exp(result["errors"])
        line = f"{task.event.id:24} {result['scenario']:14} {near_truth:8.1f}"
        if not options.truth_only:
            worst = result["better"][0][:2] if result["better"] else ""
            line += f"  better: {len(result['better']):2}  {worst}"
        print(line)
    print_figures(figures)
    return figures | {
        "settings": settings,
        "videos": {task.event.id: r for task, r in zip(tasks, results, strict=True)},
    }


def print_figures(figures: dict[str, Any]) -> None:
    shown = common.shown
    if "true_best_rate" in figures:
        best, top5 = (shown(figures[f"true_{name}_rate"]) for name in ("best", "top5"))
        print(f"true best {best}  top 5 {top5}")
    for name, row in figures.get("by_scenario", {}).items():
        print(f"  {name:14} {shown(row['true_best_rate'])}  top 5 {shown(row['true_top5_rate'])}")
    print(f"log-likelihood of the truth: {shown(figures['log_likelihood'])}")
    print(f"sd of the log-likelihood over seeds, median: {figures['loglik_sd_median']:.2f}")
    print(f"mean error per frame: {shown(figures['mean_error_per_frame'])} units")
