"""Running free: real and simulated trajectories side by side, under the true hypothesis.

Figures are over the steps of each video with known actions, for real and simulated agents alike.
Beside each difference stands its spread over seeds; a smaller difference says nothing.
"""

from __future__ import annotations

import argparse
from typing import Any, NamedTuple

import common
import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.physics import compiled
from phase_ppl.simulator.contract import random_generator
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS, goal_literal
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.names import PredicateKind
from videos.decisions import Task as Recording
from videos.decisions import states
from videos.replay import scene_of

QUARTERS = 4
NEAR_GOAL = {True: 1.41, False: 0.57}
"""How near an item (an agent) comes to its landmark to have reached it, units."""


class Task(NamedTuple):
    event: Event
    video: dict[str, Any]
    planner: PlannerConfig
    seeds: int


def figures(
    event: Event, positions: FloatArray, held: NDArray[np.int64]
) -> dict[str, float | list[float]]:
    """Return what is compared, of positions (time, entity, 2) and items held (time, agent)."""
    truth, scene = event.truth, event.scene
    moves = np.linalg.norm(np.diff(positions, axis=0), axis=2)
    n = len(held)
    result: dict[str, Any] = {
        "path_agents": float(moves[:, :2].sum(0).mean()),
        "path_items": float(moves[:, 2:].sum(0).mean()),
        "still": float((moves[:, :2] < 1e-3).mean()),
        "median_step": float(np.median(moves[:, :2])),
        "holding": float((held >= 0).mean()) if n else 0.0,
        "both_holding": float(((held[:, 0] >= 0) & (held[:, 0] == held[:, 1])).mean())
        if n
        else 0.0,
        "speeds": (12 * moves[:, :2].mean(0)).tolist(),
    }
    reached = []
    for agent, goal in enumerate((truth.goal_red, truth.goal_green)):
        literal = goal_literal(GOALS.index(goal), agent)
        if not literal.positive or literal.predicate is not PredicateKind.ON:
            continue
        landmark = scene.landmark_centres[literal.target]
        distance = np.linalg.norm(positions[:, literal.subject] - landmark, axis=1)
        there = distance < NEAR_GOAL[literal.subject >= 2]
        reached.append(float(there.argmax() if there.any() else len(there)))
        nearest = np.linalg.norm(
            positions[-1, literal.subject] - np.array(scene.landmark_centres), axis=1
        ).argmin()
        result.setdefault("final_landmark", []).append(float(nearest == literal.target))
    if reached:
        result["steps_to_goal"] = float(np.mean(reached))
        result["final_landmark"] = float(np.mean(result["final_landmark"]))
    return result


def judge(task: Task) -> dict[str, Any]:
    """Return the figures of the real video and of each simulated one, and the errors over time."""
    event, hypothesis = task.event, common.true_hypothesis(task.event)
    scene = scene_of(task.video)
    params = compiled.make_params(scene, tuple(task.video["strength_newton"]), inner_steps=4)
    recording = Recording(task.video, event, task.planner, 1)
    held = np.array([state.held for state, _ in states(recording, params)])
    n = len(held)
    observed = event.observation.positions
    simulated, errors = [], []
    for seed in range(task.seeds):
        steps = JointSimulator(task.planner).steps(event.scene, hypothesis, random_generator(seed))
        frames, holds = [], []
        for frame, decisions in steps:
            frames.append(frame[:, :2])
            if decisions:
                holds.append([decision.held for decision in decisions])
            if len(frames) == len(observed):
                break
        positions = np.array(frames)
        simulated.append(figures(event, positions[: n + 1], np.array(holds[:n])))
        error = np.linalg.norm((positions - observed).reshape(len(observed), -1), axis=1)
        errors.append([float(part.mean()) for part in np.array_split(error, QUARTERS)])
    return {
        "scenario": event.truth.scenario,
        "strengths": hypothesis.strengths,
        "steps": n,
        "real": figures(event, observed[: n + 1], held),
        "simulated": simulated,
        "errors": errors,
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    common.add(parser, "half")
    common.add_planner(parser)
    parser.add_argument("--seeds", type=int, default=4)


def compared(group: list[dict[str, Any]], name: str) -> dict[str, float] | None:
    """Return the means of a figure over videos, and the spread of the simulated mean."""
    group = [row for row in group if name in row["real"]]
    if not group:
        return None
    simulated = np.array([[run[name] for run in row["simulated"]] for row in group])
    difference = simulated.mean(1) - np.array([row["real"][name] for row in group])
    noise = simulated.std(1, ddof=1) * np.sqrt(1 + 1 / simulated.shape[1])
    return {
        "real": float(np.mean([row["real"][name] for row in group])),
        "simulated": float(simulated.mean()),
        "difference": float(difference.mean()),
        "se_between_videos": float(difference.std(ddof=1) / np.sqrt(len(group))),
        "se_of_seeds": float(np.sqrt((noise**2).sum()) / len(group)),
    }


def main(options: argparse.Namespace) -> dict[str, Any]:
    planner = common.planner_of(options)
    JointSimulator(planner).warm_up()
    videos = {video["id"]: video for video in common.replays()}
    tasks = [
        Task(event, videos[event.id], planner, options.seeds)
        for event in common.dev_events(options.half)
    ]
    rows = [row for _, row in common.parallel(judge, tasks, "videos")]
    report: dict[str, Any] = {"planner": planner.to_dict(), "seeds": options.seeds}
    names = [name for name in max((row["real"] for row in rows), key=len) if name != "speeds"]
    print(f"{'':14} {'':16} {'real':>8} {'simulated':>10} {'difference':>11}  (+- videos, seeds)")
    for scenario in ("all", *common.SCENARIOS):
        group = [row for row in rows if scenario in ("all", row["scenario"])]
        report[scenario] = {name: compared(group, name) for name in names}
        for name, value in report[scenario].items():
            if value is not None:
                print(
                    f"{scenario:14} {name:16} {value['real']:8.2f} {value['simulated']:10.2f} "
                    f"{value['difference']:11.2f}  (+- {value['se_between_videos']:.2f},"
                    f" {value['se_of_seeds']:.2f})"
                )
        errors = np.array([row["errors"] for row in group]).mean((0, 1))
        report[scenario]["error_by_quarter"] = errors.tolist()
        print(f"{scenario:14} {'error by quarter':16} " + "  ".join(f"{e:.1f}" for e in errors))
    report["speed_by_strength"] = {}
    for level in STRENGTH_LEVELS:
        pairs = [
            (row["real"]["speeds"][a], np.mean([run["speeds"][a] for run in row["simulated"]]))
            for row in rows
            for a in range(2)
            if row["strengths"][a] == level
        ]
        real, simulated = np.mean(pairs, axis=0)
        report["speed_by_strength"][str(level)] = {
            "real": float(real),
            "simulated": float(simulated),
        }
        print(f"mean speed at {level:.0f} N: real {real:.2f}, simulated {simulated:.2f} units/s")
    return report
