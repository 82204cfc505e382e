"""The closed loop: what does it recover, how was it fitted, and what does it cost?

    python benchmarks/closed_loop.py COMMAND [--json FILE]

* ``replays``: actions, holds and strengths, beside those recovered from the real videos.
* ``fit [--half first|second|all] [--keep DIR]``: sets of searches, policy and weight, by log
  likelihood per frame under the truth, and by accuracy and log score after half of the video and
  after all of it.
* ``calibration [--events N] [--keep DIR]``: confidence beside accuracy on the model's own videos,
  and quantiles of surprise.
* ``beam [--half first|second|all]``: how often the filter nearly rules out the true strengths, by
  noise and weight of the evidence.
* ``accuracy [--jitter S] [--planner P] [--keep DIR]``: goals, relation, log score and agreement
  with people; seconds per second of video.
* ``seeds [--limit N] [--noise-seeds K]``: standard deviation over seeds of the truth's log
  likelihood, beside SIMPLE's.
* ``curve [--limit N] [--budgets 30,105] [--keep DIR]``: accuracy against CPU seconds per second of
  video, for both likelihoods.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import common
import numpy as np
from videos import own, reading

import phase_ppl as ppl
from phase_ppl.closed_loop.goal_filter import ActionPolicy
from phase_ppl.closed_loop.hidden_state import HiddenState, Tracking
from phase_ppl.models.closed_loop import ClosedLoopLikelihood
from phase_ppl.world.event import Event, Observation

KINDS = ("goal", "relation")
INVERSE_TEMPERATURE, LAPSE = (4.0, 6.0), (0.1, 0.2, 0.3)
WEIGHT = sorted({ClosedLoopLikelihood().frame_weight(), 0.3, 0.5, 1.0})
SEEDS = (1, 2, 4)
JITTERS, STRENGTH_WEIGHTS = (0.0, 0.05), (1.0, 0.3, 0.1, 0.05, 0.03)
OWN_FRAMES = 31


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


def kept_readings(
    events: list[Event], likelihood: ClosedLoopLikelihood, folder: str | None
) -> list[reading.Kept]:
    """Return what reading the events finds, all sets of searches apart; one file an event."""
    tasks = [(event, likelihood, None if folder is None else Path(folder)) for event in events]
    found = dict(
        (task[0].id, kept) for task, kept in common.parallel(_kept_reading, tasks, "videos")
    )
    return [found[event.id] for event in events]


def _kept_reading(task: tuple[Event, ClosedLoopLikelihood, Path | None]) -> reading.Kept:
    event, likelihood, folder = task
    file = None if folder is None else folder / f"{event.id}.pkl"
    if file is not None and file.exists():
        kept: reading.Kept = pickle.loads(file.read_bytes())
        return kept
    kept = reading.record(event, likelihood)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(".part")
        part.write_bytes(pickle.dumps(kept))
        part.rename(file)
    return kept


def fit(options: argparse.Namespace) -> dict[str, Any]:
    """Print scores on a grid of settings; each video is read once."""
    events = common.dev_events(options.half, options.limit)
    # a lower weight has more pairs of goals searched by all sets than those that are compared
    kept = kept_readings(events, ClosedLoopLikelihood(weight=min(WEIGHT)), options.keep)
    found: dict[str, Any] = {}
    names = ("sets", *ActionPolicy._fields, "weight", "nats")
    print("".join(f"{name:>10}" for name in names), f"  end: {reading.HEAD}; half: {reading.HEAD}")
    for seeds, inverse_temperature, lapse in itertools.product(SEEDS, INVERSE_TEMPERATURE, LAPSE):
        policy = ActionPolicy(inverse_temperature, lapse)
        tables = [one.log_likelihood(policy, 1.0, seeds).cumsum(axis=0) for one in kept]
        per_frame = sum(
            float(table[-1][one.truth]) for one, table in zip(kept, tables, strict=True)
        ) / sum(one.n_steps for one in kept)
        for weight in WEIGHT:
            end, half = (
                reading.Scores.of(
                    [
                        one.scores(table[int(share * len(table)) - 1], weight)
                        for one, table in zip(kept, tables, strict=True)
                    ]
                )
                for share in (1.0, 0.5)
            )
            settings = (seeds, *policy, weight)
            found[", ".join(f"{value:g}" for value in settings)] = {
                "nats_per_frame": per_frame,
                "end": end._asdict(),
                "half": half._asdict(),
            }
            words = "".join(f"{value:10g}" for value in settings)
            print(f"{words}{per_frame:10.3f}   {end}; {half}", flush=True)
    return found


def calibration(options: argparse.Namespace) -> dict[str, Any]:
    """Print whether confidence is accuracy where the model is true."""
    own_tracking = dataclasses.replace(ClosedLoopLikelihood().tracking, noise=0.0)
    likelihood = dataclasses.replace(ClosedLoopLikelihood(), tracking=own_tracking)
    numbers = range(options.events)
    drawn = [own.own_event(number, likelihood, OWN_FRAMES) for number in numbers]
    kept = kept_readings(drawn, likelihood, options.keep)
    found: dict[str, Any] = {}
    print(f"{'sets':>4}{'weight':>7}   {reading.HEAD}")
    for seeds, weight in itertools.product(SEEDS, WEIGHT):
        tables = [one.log_likelihood(likelihood.policy, weight, seeds).sum(axis=0) for one in kept]
        scores = reading.Scores.of(
            [one.scores(table, weight) for one, table in zip(kept, tables, strict=True)]
        )
        found[f"{seeds}, {weight:g}"] = scores._asdict()
        print(f"{seeds:4}{weight:7g}   {scores}")
    strengths = [one.strengths[-1].sum(axis=1 - agent) for one in kept for agent in (0, 1)]
    true = [level for one in kept for level in one.levels]
    found["strengths"] = _of_strengths(strengths, true)
    print("strengths:", found["strengths"])
    shares = (0.5, 0.9, 0.99, 0.999)
    unexplained = np.concatenate([one.unexplained for one in kept])
    surprise = np.concatenate([one.surprise(likelihood) - one.unexplained for one in kept])
    for name, nats in (("unexplained", unexplained), ("surprise", surprise)):
        found[name] = dict(zip(map(str, shares), np.quantile(nats, shares).tolist(), strict=True))
        print(f"{name}, nats below a perfect match, quantiles:", found[name])
    return found


def beam(options: argparse.Namespace) -> dict[str, Any]:
    """Print what the filter finds of the strengths."""
    found: dict[str, Any] = {}
    events = common.dev_events(options.half, options.limit)
    for jitter in JITTERS:
        tasks = [(event, jitter) for event in events]
        rows = [row for _, row in common.parallel(_evidence, tasks, f"jitter {jitter:g}")]
        for weight in STRENGTH_WEIGHTS:
            tables = [np.exp(weight * (log - log.max())) for log, _ in rows]
            marginals = [t.sum(axis=1 - agent) / t.sum() for t in tables for agent in (0, 1)]
            true = [level for _, levels in rows for level in levels]
            found[f"{jitter:g}, {weight:g}"] = scores = _of_strengths(marginals, true)
            words = "  ".join(f"{name} {value:.3f}" for name, value in scores.items())
            print(f"jitter {jitter:g}  weight {weight:g}  {words}", flush=True)
    print(f"log score of equal probabilities: {-np.log(4):.3f}")
    return found


def _evidence(task: tuple[Event, float]) -> tuple[Any, tuple[int, int]]:
    """Return (strength of red, of green) log evidence, and the true levels."""
    event, jitter = task
    seen = jittered(event, jitter)
    hidden = HiddenState(seen.scene, Tracking())
    for frame in seen.observation.trajectory[1:]:
        hidden.advance(frame)
    with np.errstate(divide="ignore"):
        strengths = hidden.strengths().reshape([len(Tracking().strengths)] * 2)
        return np.log(strengths) / Tracking().strength_weight, reading.levels_of(event)


def _of_strengths(marginals: list[Any], true: list[int]) -> dict[str, float]:
    of_true = np.array([table[level] for table, level in zip(marginals, true, strict=True)])
    best = [int(table.argmax()) == level for table, level in zip(marginals, true, strict=True)]
    return {
        "log_score": float(np.log(np.maximum(of_true, 1e-12)).mean()),
        "ruled_out": float((of_true < 0.001).mean()),
        "accuracy": float(np.mean(best)),
        "confidence": float(np.mean([table.max() for table in marginals])),
    }


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
        "closed_loop",
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
        for name in ("closed_loop", "closed_loop_weighted", "simple")
    }
    print(f"median over {len(rows)} videos of the standard deviation over seeds, nats:")
    for name, value in found.items():
        print(f"  {name:<20}{value:8.2f}")
    return found


def of_truth(task: tuple[Event, int]) -> dict[str, float]:
    """Return the log likelihoods of the true hypothesis with one seed."""
    event, seed = task
    hypothesis, likelihood = common.true_hypothesis(event), ClosedLoopLikelihood()
    with ppl.watch(event.scene, ppl.Model(likelihood=likelihood), seed=seed, threads=1) as watch:
        for frame in event.observation.trajectory:
            watch.take(frame)
        frames = watch.posterior().by_frame()
    assert frames is not None
    found = frames["log_likelihood"].values.sum(axis=0) / likelihood.frame_weight()
    closed_loop = float(found[hypothesis.effective_goals])
    simulated = ppl.simulate(
        event.scene, hypothesis, seed=seed, frames=event.observation.n_frames, overlapping=True
    )
    seen = event.observation.positions
    errors = np.linalg.norm(
        (simulated.observation.positions - seen).reshape(len(seen), -1),
        axis=1,
    )
    simple = ppl.RadialLikelihood().log_prob(errors).sum()
    return {
        "closed_loop": closed_loop,
        "closed_loop_weighted": likelihood.frame_weight() * closed_loop,
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
        runs[f"closed_loop, {n} a search"] = "closed_loop", {"planner": planner}
    runs["closed_loop, paper's planner"] = "closed_loop", {"planner": "paper"}
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
    fit: ("half", "keep"),
    calibration: ("events", "keep"),
    beam: ("half",),
    accuracy: ("half", "jitter", "planner", "keep", "seed"),
    seeds: ("noise-seeds",),
    curve: ("half", "budgets", "keep", "seed"),
}
KNOWN: dict[str, dict[str, Any]] = {
    "half": {"choices": common.HALVES, "default": "all"},
    "events": {"type": int, "default": 40, "help": "videos"},
    "jitter": {"type": float, "default": 0.0, "help": "units"},
    "planner": {"choices": ("fast", "paper"), "default": "fast"},
    "keep": {"metavar": "DIR", "help": "go on with what is there"},
    "seed": {"type": int, "default": 0},
    "noise-seeds": {"type": int, "default": 8, "help": "seeds per video"},
    "budgets": {"default": "30,105", "help": "simulations"},
}


def main() -> None:
    parser = common.parser(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for function, taken in OPTIONS.items():
        command = commands.add_parser(function.__name__)
        command.set_defaults(run=function)
        common.add(command, "limit", "json")
        for name in taken:
            command.add_argument(f"--{name}", **KNOWN[name])
    options = parser.parse_args()
    common.write(options.run(options), options.json)


if __name__ == "__main__":
    main()
