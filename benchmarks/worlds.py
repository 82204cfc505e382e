"""Who wants what in worlds of other casts than PHASE's, read step by step or by simulations.

    python benchmarks/worlds.py [--world NAME] [--events N] [--planner-seeds N] [--json FILE]
    python benchmarks/worlds.py --kernel local_mh --simulations 105

Events are drawn: a scene, roles from the uniform prior, and a simulation of them. Kept are those in
which all own goals are to get somewhere and at least one of them is reached. Goals and relations
are then inferred by the closed loop, or with ``--kernel`` by simulations, beside what the last
frame alone says (all positive goals that are true then, and were not at the start, are alike).
Intervals are bootstrapped over events.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import resumed, write

import phase_ppl as ppl
from phase_ppl.world.goals import goal_literal, is_self_referring, is_true

FRAMES = 90
MEASURES = ("goals", "goals_log", "relation", "relation_log", "last_frame", "sure", "seconds_frame")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--world", default="solo", choices=[*ppl.worlds.available()])
    parser.add_argument("--events", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="seed of the first event")
    parser.add_argument("--planner-seeds", type=int, default=1)
    parser.add_argument("--kernel", help="infer by simulations, with this kernel")
    parser.add_argument("--simulations", type=int, default=105, help="budget of a kernel")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--kept", metavar="FILE", help="results so far, to go on from")
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    numbers = range(options.first, options.first + options.events)
    how = options.planner_seeds, options.kernel, options.simulations
    tasks = [(options.world, number, *how) for number in numbers]
    kept = Path(options.kept) if options.kept else None
    settings = {"world": options.world, "planner_seeds": options.planner_seeds}
    if options.kernel:
        settings |= {"kernel": options.kernel, "simulations": options.simulations}
    found = resumed(
        judged, tasks, lambda task: str(task[1]), "events", kept, settings, options.workers
    )
    rows = [row for row in found if row]
    table = {}
    for name in MEASURES:
        values = np.array([row[name] for row in rows], float)
        values = values[~np.isnan(values)]
        if values.size:
            drawn = np.random.default_rng(0).choice(values, (4000, values.size)).mean(axis=1)
            low, high = np.percentile(drawn, [2.5, 97.5])
            table[name] = [float(values.mean()), float(low), float(high)]
            print(f"{name:14s} {values.mean():6.2f} [{low:.2f}, {high:.2f}]  n={values.size}")
    sure = np.array([pair for row in rows for pair in row["calibration"]])
    for low in (0.0, 0.5, 0.8, 0.95):
        chosen = sure[(sure[:, 0] >= low)]
        if len(chosen):
            mean, right = chosen.mean(axis=0)
            print(
                f"goals surer than {low:.2f}: n={len(chosen)}, {mean:.2f} sure, {right:.2f} right"
            )
    write({"options": vars(options), "table": table, "events": rows}, options.json)


def drawn(world: ppl.World, number: int) -> ppl.Event | None:
    """Return an event of that number in which something is reached."""
    for attempt in range(50):
        seed = 1000 * number + attempt
        roles = ppl.roles.draw(world, seed)
        own = [goal for goal in roles.stated if goal is not None]
        if any(" away from " in world.goals[goal] for goal in own):
            continue
        scene = world.random_scene(seed)
        event = ppl.simulate(scene, roles, frames=FRAMES, seed=seed, id=f"{world.name}-{number}")
        frames = event.observation.trajectory
        for agent, goal in enumerate(roles.stated):
            if goal is None:
                continue
            literal = goal_literal(goal, agent, world)
            if is_true(literal, frames[-1], scene) and not is_true(literal, frames[0], scene):
                return event
    return None


def judged(task: tuple[str, int, int, str | None, int]) -> dict[str, Any]:
    """Return how one event is explained; nothing, where there is none of that number."""
    name, number, planner_seeds, kernel, simulations = task
    world = ppl.worlds.named(name)
    event = drawn(world, number)
    if event is None:
        return {}
    began = time.process_time()
    blind = ppl.Event(event.scene, event.observation, id=event.id)
    post: Any
    if kernel:
        budget = ppl.simulations(simulations)
        post = ppl.infer(blind, kernel=kernel, budget=budget, workers=1, progress=False)
    else:
        model = ppl.Model(likelihood=ppl.StepwiseLikelihood(planner_seeds=planner_seeds))
        post = ppl.infer(blind, model, workers=1, progress=False)
    seconds = time.process_time() - began
    truth, keys = event.truth, world.keys
    right, logs, sure, calibration, last = [], [], [], [], []
    frames = event.observation.trajectory
    for agent, goal in enumerate(truth.effective_goals):
        masses = post.marginal(f"goal_{keys[agent]}").values
        right.append(masses.argmax() == goal)
        logs.append(np.log(max(masses[goal], 1e-3)))
        sure.append(masses.max())
        calibration.append([float(masses.max()), bool(right[-1])])
        came_true = [
            other
            for other in range(len(world.goals))
            if not is_self_referring(other, agent, world)
            and " away from " not in world.goals[other]
            and is_true(goal_literal(other, agent, world), frames[-1], event.scene)
            and not is_true(goal_literal(other, agent, world), frames[0], event.scene)
        ]
        last.append((goal in came_true) / max(1, len(came_true)))
    relations, relation_logs = [], []
    for b, other in enumerate(keys):
        for a, one in enumerate(keys[:b]):
            found = post.marginal(f"relation_{one}_{other}")
            true = truth.relation_between(world.agents[a], world.agents[b])
            relations.append(str(found[found.dims[0]].values[found.values.argmax()]) == true)
            relation_logs.append(np.log(max(float(found.sel({found.dims[0]: true})), 1e-3)))
    nothing = float("nan")
    return {
        "id": event.id,
        "truth": str(truth),
        "goals": float(np.mean(right)),
        "goals_log": float(np.mean(logs)),
        "relation": float(np.mean(relations)) if relations else nothing,
        "relation_log": float(np.mean(relation_logs)) if relations else nothing,
        "last_frame": float(np.mean(last)),
        "sure": float(np.mean(sure)),
        "seconds_frame": seconds / (len(frames) - 1),
        "searches": post.cost.get("searches", 0) / (len(frames) - 1),
        "calibration": calibration,
    }


if __name__ == "__main__":
    main()
