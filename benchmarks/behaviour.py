"""Do simulated pairs help, hinder, chase, flee and search as in the paper's animations?

    python benchmarks/behaviour.py [--only NAME ...] [--seeds N] [--json FILE]

Each behaviour is tried in a scene that calls for it. A last part asks whether simulated pairs
reach the goals of the real videos from their starts.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import common
from behaviours import against, searching, together
from behaviours.battery import episodes
from behaviours.episode import record

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.event import Event

BEHAVIOURS = {b.name: b for b in (*together.BEHAVIOURS, *against.BEHAVIOURS, *searching.BEHAVIOURS)}
REAL = "goal_reached_rate"
REAL_SEEDS = 3
DEMANDED = 0.9
"""Share of the real videos whose goals are to be reached from their start."""

STEPS = 100


class Try(NamedTuple):
    name: str
    seed: int
    planner: PlannerConfig
    event: Event | None = None


def attempt(task: Try) -> bool:
    """Return whether one try shows what it should."""
    if task.event is not None:
        return reaches_goals(task.event, task.planner, task.seed)
    behaviour = BEHAVIOURS[task.name]
    return behaviour.seen(*episodes(behaviour, task.planner, task.seed))


def reaches_goals(event: Event, planner: PlannerConfig, seed: int) -> bool:
    """Return whether all positive goals of a real video are reached from its start."""
    episode = record(event.scene, common.true_hypothesis(event), planner, seed, STEPS)
    return all(bool(episode.reached(goal).any()) for goal in episode.goals() if goal.positive)


def real_events() -> list[Event]:
    """Return the collaborative and independent real videos, or none where they are absent."""
    if not (common.FOLDER / "dev.json").exists():
        print(f"no {REAL}: {common.FOLDER / 'dev.json'} is missing")
        return []
    chosen = ("collaborative", "independent")
    return [event for event in common.dev_events() if event.truth.scenario in chosen]


def rate(successes: list[bool]) -> dict[str, Any]:
    figures: dict[str, Any] = common.interval(successes)
    return {"rate": figures.pop("value"), "n": len(successes), **figures, "successes": successes}


def report(results: list[tuple[Try, bool]]) -> dict[str, Any]:
    """Return rates by behaviour; for the real videos also by scenario and what fails.

    ``successes`` are in the order of videos and seeds, so that those of two planners can be paired.
    """

    def order(result: tuple[Try, bool]) -> tuple[str, str, int]:
        task = result[0]
        return task.name, "" if task.event is None else task.event.id, task.seed

    by_name: dict[str, list[bool]] = {}
    failed: dict[str, list[int]] = {}
    for task, success in sorted(results, key=order):
        if task.event is None:
            by_name.setdefault(task.name, []).append(success)
            continue
        for name in (REAL, f"{REAL}_{task.event.truth.scenario}"):
            by_name.setdefault(name, []).append(success)
        if not success:
            failed.setdefault(task.event.id, []).append(task.seed)
    figures: dict[str, Any] = {name: rate(successes) for name, successes in by_name.items()}
    if REAL in figures:
        figures[REAL]["failed_seeds"] = {video: sorted(s) for video, s in failed.items()}
    return figures


def main() -> None:
    parser = common.parser(__doc__, "json")
    common.add_planner(parser)
    parser.add_argument("--seeds", type=int, default=20, help="tries of each behaviour")
    parser.add_argument(
        "--only", nargs="+", choices=[*BEHAVIOURS, REAL], metavar="NAME", help="only these"
    )
    options = parser.parse_args()
    planner = common.planner_of(options)
    names = options.only or [*BEHAVIOURS, REAL]
    JointSimulator(planner).warm_up()
    tasks = [
        Try(name, seed, planner) for name in names if name != REAL for seed in range(options.seeds)
    ]
    if REAL in names:
        seeds = range(min(options.seeds, REAL_SEEDS))
        tasks += [Try(REAL, s, planner, event) for event in real_events() for s in seeds]
    figures = report(list(common.parallel(attempt, tasks, "tries")))
    for name in [*names, f"{REAL}_collaborative", f"{REAL}_independent"]:
        if name in figures:
            row = figures[name]
            shown = BEHAVIOURS[name].shows if name in BEHAVIOURS else ""
            interval = f"[{row['ci_low']:.2f}, {row['ci_high']:.2f}]"
            if name == REAL:
                missed = "" if row["rate"] >= DEMANDED else "   MISSED"
                shown = f"demanded >= {DEMANDED:g}{missed}"
            print(f"{name:32} {row['rate']:.2f} {interval:14} n={row['n']:<4} {shown}")
    for video, failing in figures.get(REAL, {}).get("failed_seeds", {}).items():
        print(f"  {video:24} failed with seeds {failing}")
    common.write({"planner": planner.to_dict(), "behaviours": figures}, options.json)


if __name__ == "__main__":
    main()
