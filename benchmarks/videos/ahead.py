"""Teacher-forced: a few steps of our physics from each recorded state, with the recovered actions.

Without chaos, this shows in which situations our physics differs from the recordings: with nobody
holding an item, one agent or both, at a wall or not.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from typing import Any, Final

import common
import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.physics import compiled
from phase_ppl.world.event import Event
from videos.decisions import Task, states
from videos.replay import actions_of, scene_of

NEAR: Final = 0.15
"""What comes nearer than this to an inner wall is at it, units."""

WIDEST: Final = 1.6
"""How far an agent reaches from its origin, in units of its size."""

MOVED: Final = 0.5
STUCK: Final = 0.3
"""Something is stuck that moves less than this share of a way of more than ``MOVED`` units."""


def gap(position: NDArray[np.float64], walls: NDArray[np.float64]) -> float:
    """Return the distance (units) of a point from the nearest inner wall, inf without any."""
    if not len(walls):
        return np.inf
    start, along = walls[:, 0], walls[:, 1] - walls[:, 0]
    share = ((position - start) * along).sum(1) / (along**2).sum(1)
    nearest = start + np.clip(share, 0, 1)[:, None] * along
    return float(np.linalg.norm(nearest - position, axis=1).min())


def judge(task: tuple[dict[str, Any], Event, int]) -> list[tuple[str, bool, float, float, float]]:
    """Return situation, at a wall, error, way in the recording and in ours, by step and agent."""
    video, event, steps = task
    scene = scene_of(video)
    params = compiled.make_params(scene, tuple(video["strength_newton"]), inner_steps=4)
    scratch, frame = compiled.make_scratch(), np.empty((4, 3))
    rows, actions = np.array(video["rows"]), actions_of(video)
    known = [state for state, _ in states(Task(video, event, PlannerConfig(), 1), params)]
    found = []
    for t, start in enumerate(known[:-steps]):
        state = start.copy()
        for red, green in actions[t : t + steps]:
            compiled.step_mean(*state, np.array([red, green]), params, scratch, frame)
        error = np.linalg.norm(frame[:, :2] - rows[t + steps], axis=1)
        real = np.linalg.norm(rows[t + steps] - rows[t], axis=1)
        ours = np.linalg.norm(frame[:, :2] - rows[t], axis=1)
        for agent, item in enumerate(start.held.tolist()):
            entity = item if item >= 0 else agent
            together = item >= 0 and start.held[1 - agent] == item
            situation = "both hold" if together else "one holds" if item >= 0 else "free"
            size = scene.radius[entity] * (1.0 if item >= 0 else WIDEST)
            at_wall = gap(rows[t][entity], scene.walls) < size + NEAR
            found.append((situation, at_wall, error[entity], real[entity], ours[entity]))
    return found


def add_options(parser: argparse.ArgumentParser) -> None:
    common.add(parser, "half")
    parser.add_argument("--steps", type=int, default=5, help="steps from each state")


def main(options: argparse.Namespace) -> dict[str, Any]:
    if options.steps < 1:
        raise SystemExit(f"--steps {options.steps}: at least 1")
    events = {event.id: event for event in common.dev_events(options.half)}
    tasks = [
        (video, events[video["id"]], options.steps)
        for video in common.replays()
        if video["id"] in events
    ]
    groups = defaultdict(list)
    for _, found in common.parallel(judge, tasks, "videos"):
        for situation, at_wall, *figures in found:
            groups[situation, at_wall].append(figures)
    report = {}
    print(f"{'':22} {'n':>6}  median error  90 %   only ours stuck  only theirs")
    for (situation, at_wall), rows in sorted(groups.items()):
        error, real, ours = np.array(rows).T
        name = f"{situation}, at a wall" if at_wall else situation
        report[name] = row = {
            "n": len(rows),
            "median_error": float(np.median(error)),
            "error_90": float(np.quantile(error, 0.9)),
            "only_ours_stuck": float(np.mean((real > MOVED) & (ours < STUCK * real))),
            "only_theirs_stuck": float(np.mean((ours > MOVED) & (real < STUCK * ours))),
        }
        print(
            f"{name:22} {row['n']:6d}  {row['median_error']:12.3f}  {row['error_90']:.3f}"
            f"  {row['only_ours_stuck']:15.3f}  {row['only_theirs_stuck']:11.3f}"
        )
    return {"steps": options.steps, "by_situation": report}
