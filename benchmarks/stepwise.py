"""The closed-loop likelihood: what it recovers, how it was fitted, what it costs and buys.

python benchmarks/stepwise.py replays [--json FILE]
    Actions, holds and strengths against those recovered from the real videos.
python benchmarks/stepwise.py fit [--half first|second|all] [--json FILE]
    Mean log likelihood per frame under the truth, and log scores, by sharpness, lapse and weight.
python benchmarks/stepwise.py accuracy [--jitter S] [--planner P] [--keep DIR] [--json FILE]
    Goals, relation, log score and agreement with people; seconds per second of video.
python benchmarks/stepwise.py seeds [--limit N] [--noise-seeds K] [--json FILE]
    Standard deviation over seeds of the true hypothesis' log likelihood, beside SIMPLE's.
python benchmarks/stepwise.py curve [--limit N] [--budgets 30,105] [--keep DIR] [--json FILE]
    Accuracy against CPU seconds per second of video, for both likelihoods, by budget.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import common
import numpy as np
from videos import reading

import phase_ppl as ppl
from phase_ppl.models.stepwise import StepwiseLikelihood
from phase_ppl.world.event import Event
from phase_ppl.world.goals import goal_index
from phase_ppl.world.observation import Observation

KINDS = ("goal", "relation")
SHARPNESS, LAPSE, WEIGHT = (2.0, 3.0, 4.0, 6.0), (0.1, 0.2, 0.3, 0.5), (0.1, 0.15, 0.2, 0.3, 1.0)


def replays(options: argparse.Namespace) -> dict[str, Any]:
    """Compare what is read off the videos with the recovered actions."""
    events = {event.id: event for event in common.dev_events(limit=options.limit)}
    tasks = [(events[r["id"]], r) for r in common.replays() if r["id"] in events]
    rows = [row for _, row in common.parallel(reading.compare_with_replay, tasks, "videos")]
    steps = sum(row["steps"] for row in rows)
    found = {
        name: sum(row[name] for row in rows) / (2 * steps) for name in ("actions", "alike", "held")
    }
    found |= {
        "strengths": float(np.mean([row["strengths"] for row in rows])),
        "steps": steps,
        "ms_per_step": 1000 * sum(row["seconds"] for row in rows) / steps,
    }
    for name, value in found.items():
        print(f"{name:<14}{value:9.3f}")
    print("actions: the recovered one is the most probable; alike: within 0.7 nats of it, so that")
    print("the frame cannot tell them apart; held: as when the recovered actions are given.")
    return found


def fit(options: argparse.Namespace) -> dict[str, Any]:
    """Print scores on a grid of settings."""
    events = common.dev_events(options.half, options.limit)
    kept = [found for _, found in common.parallel(reading.record, events, "videos")]
    found: dict[str, Any] = {}
    print(f"{'sharpness':>9}{'lapse':>7}{'nats/frame':>12}   log score by weight {WEIGHT}")
    for sharpness, lapse in itertools.product(SHARPNESS, LAPSE):
        likelihoods = [one.log_likelihood(sharpness, lapse) for one in kept]
        per_frame = sum(
            one.of_truth(table) for one, table in zip(kept, likelihoods, strict=True)
        ) / sum(one.n_steps for one in kept)
        scores = {
            weight: float(
                np.mean(
                    [
                        one.log_score(table, weight)
                        for one, table in zip(kept, likelihoods, strict=True)
                    ]
                )
            )
            for weight in WEIGHT
        }
        found[f"{sharpness:g}, {lapse:g}"] = {"nats_per_frame": per_frame, "log_score": scores}
        words = "  ".join(f"{score:6.2f}" for score in scores.values())
        print(f"{sharpness:9g}{lapse:7g}{per_frame:12.3f}   {words}")
    return found


def jittered(event: Event, jitter: float) -> Event:
    """Return the event with noise on all observed positions, the same at every call."""
    if not jitter:
        return event
    rng = np.random.default_rng([len(event.id), *event.id.encode()])
    noisy = event.observation.trajectory.copy()
    noisy[..., :2] += rng.normal(0, jitter, noisy[..., :2].shape)
    x0, x1, y0, y1 = event.scene.arena
    noisy[..., 0], noisy[..., 1] = noisy[..., 0].clip(x0, x1), noisy[..., 1].clip(y0, y1)
    scene = dataclasses.replace(event.scene, start=noisy[0])
    return dataclasses.replace(event, scene=scene, observation=Observation(noisy))


def accuracy(options: argparse.Namespace) -> dict[str, Any]:
    """Evaluate the model on the real videos."""
    events = [
        jittered(event, options.jitter) for event in common.dev_events(options.half, options.limit)
    ]
    started = time.monotonic()
    found = ppl.evaluate(
        events,
        "stepwise",
        planner=options.planner,
        out=options.keep,
        resume=options.keep is not None,
        seed=options.seed,
    )
    print(found)
    ratios = [
        found.predictions[event.id].cost["seconds"] / (0.25 * (event.observation.n_frames - 1))
        for event in events
        if event.id in found.predictions
    ]
    cost = {
        "seconds_over_video_median": float(np.median(ratios)),
        "seconds_over_video_95": float(np.percentile(ratios, 95)),
        "searches_per_step": sum(p.cost["searches"] for p in found.predictions.values())
        / sum(event.observation.n_frames - 1 for event in events if event.id in found.predictions),
        "wall_seconds": time.monotonic() - started,
    }
    print("  ".join(f"{name} {value:.2f}" for name, value in cost.items()))
    return {"metrics": found.metrics, **cost}


def seeds(options: argparse.Namespace) -> dict[str, Any]:
    """Compare how much chance there is in both likelihoods of the truth."""
    events = common.dev_events(limit=options.limit)
    tasks = [(event, seed) for event in events for seed in range(options.noise_seeds)]
    rows: dict[str, list[dict[str, float]]] = {}
    for (event, _), row in common.parallel(of_truth, tasks, "seeds"):
        rows.setdefault(event.id, []).append(row)
    found = {
        name: float(np.median([np.std([r[name] for r in of], ddof=1) for of in rows.values()]))
        for name in ("stepwise", "stepwise_weighted", "simple")
    }
    print(f"median over {len(rows)} videos of the standard deviation over seeds, nats:")
    for name, value in found.items():
        print(f"  {name:<20}{value:8.2f}")
    return found


def of_truth(task: tuple[Event, int]) -> dict[str, float]:
    """Return the log likelihoods of the true hypothesis with one seed."""
    event, seed = task
    truth = event.truth
    assert truth is not None
    goals = goal_index(truth.goal_red), goal_index(truth.goal_green)
    likelihood = StepwiseLikelihood()
    with ppl.watch(event.scene, ppl.Model(likelihood=likelihood), seed=seed, threads=1) as watch:
        for frame in event.observation.trajectory:
            watch.take(frame)
        found = watch.posterior().dataset["log_likelihood"].values.sum(axis=0)
    stepwise = float(found[goals])
    hypothesis = ppl.Hypothesis(*goals, (0, 0), truth.strength_red, truth.strength_green)
    simulated = ppl.simulate(event.scene, hypothesis, seed=seed, frames=event.observation.n_frames)
    seen = event.observation.positions
    errors = np.linalg.norm(
        (simulated.observation.positions - seen).reshape(len(seen), -1),
        axis=1,
    )
    simple = ppl.RadialLikelihood().log_prob(errors).sum()
    return {
        "stepwise": stepwise,
        "stepwise_weighted": likelihood.weight * stepwise,
        "simple": float(simple),
    }


def curve(options: argparse.Namespace) -> dict[str, Any]:
    """Print accuracy against cost of both likelihoods with more and less to spend."""
    events = common.dev_events(options.half, options.limit)
    shown = sum(0.25 * (event.observation.n_frames - 1) for event in events)
    runs: dict[str, tuple[str, dict[str, Any]]] = {
        f"simple, {n} simulations": ("simple", {"budget": ppl.simulations(n)})
        for n in map(int, options.budgets.split(","))
    }
    for n in (25, 100, 300):
        planner = dataclasses.replace(ppl.PlannerConfig.fast(), simulations=n)
        runs[f"stepwise, {n} a search"] = "stepwise", {"planner": planner}
    runs["stepwise, paper's planner"] = "stepwise", {"planner": "paper"}
    found: dict[str, Any] = {}
    print(f"{'':<26}{'CPU s / s':>10}{'goals':>8}{'relation':>10}{'log score':>11}")
    for name, (model, settings) in runs.items():
        folder = None if options.keep is None else Path(options.keep) / name.replace(" ", "_")
        made = ppl.evaluate(
            events, model, out=folder, resume=folder is not None, seed=options.seed, **settings
        )
        cost = sum(p.cost["cpu_seconds"] for p in made.predictions.values()) / shown
        values = {key: made.metrics[key]["value"] for key in ("goal_accuracy", "relation_accuracy")}
        goals, relation = (made.metrics[f"{kind}_log_score_truth"]["value"] for kind in KINDS)
        score = (2 * goals + relation) / 3  # of both goals and the relation
        found[name] = {"cpu_seconds_per_second": cost, "log_score": score, **values}
        print(f"{name:<26}{cost:10.2f}{values['goal_accuracy']:8.2f}"
              f"{values['relation_accuracy']:10.2f}{score:11.2f}", flush=True)  # fmt: skip
    return found


OPTIONS: dict[Callable[..., dict[str, Any]], tuple[str, ...]] = {
    replays: (),
    fit: ("half",),
    accuracy: ("half", "jitter", "planner", "keep", "seed"),
    seeds: ("noise-seeds",),
    curve: ("half", "budgets", "keep", "seed"),
}
KNOWN: dict[str, dict[str, Any]] = {
    "half": {"choices": common.HALVES, "default": "all"},
    "jitter": {"type": float, "default": 0.0, "help": "units"},
    "planner": {"choices": ("fast", "paper"), "default": "fast"},
    "keep": {"metavar": "DIR", "help": "go on with what is there"},
    "seed": {"type": int, "default": 0},
    "noise-seeds": {"type": int, "default": 8, "help": "seeds per video"},
    "budgets": {"default": "30,105", "help": "simulations"},
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for function, taken in OPTIONS.items():
        command = commands.add_parser(function.__name__)
        command.set_defaults(run=function)
        command.add_argument("--limit", type=int, help="a stratified subset of about so many")
        command.add_argument("--json", metavar="FILE", help="write the figures as JSON")
        for name in taken:
            command.add_argument(f"--{name}", **KNOWN[name])
    options = parser.parse_args()
    common.write(options.run(options), options.json)


if __name__ == "__main__":
    main()
