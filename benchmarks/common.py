"""What the benchmarks share: real videos, work on all cores with progress, results kept."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any, TypeVar

import loky
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import Hypothesis

sys.path.insert(0, str(Path(__file__).parents[1]))  # small worlds and slow searches are the tests'

Task = TypeVar("Task")
Row = TypeVar("Row", bound=Mapping[str, Any])
FOLDER = Path(os.environ.get("PHASE_TEST") or Path(__file__).parents[2] / "shared" / "phase-test")
SCENARIOS = ("collaborative", "independent", "opposing", "competing")
HALVES = ("first", "second", "all")


_OPTIONS: dict[str, dict[str, Any]] = {
    "half": {"choices": HALVES, "default": "all", "help": "half of the real videos"},
    "limit": {"type": int, "help": "a stratified subset of about this many videos"},
    "workers": {"type": int, "help": "processes; default one per core"},
    "json": {"metavar": "FILE", "help": "write the figures as JSON"},
}


def parser(doc: str | None, *options: str) -> argparse.ArgumentParser:
    """Return the parser of a script's arguments, with some of the options that many have."""
    made = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add(made, *options)
    return made


def add(parser: argparse.ArgumentParser, *options: str) -> None:
    """Add some of the options "half", "limit", "workers" and "json"."""
    for name in options:
        parser.add_argument(f"--{name}", **_OPTIONS[name])


def need(file: str) -> Path:
    """Return the path of a file of the real videos; where it is missing, end and say so."""
    path = FOLDER / file
    if not path.exists():
        sys.exit(f"{path} is missing; the variable PHASE_TEST names the folder of the real videos")
    return path


def dev_events(half: str = "all", limit: int | None = None) -> list[Event]:
    """Return the real videos with their truth, or one half of them, or a stratified few.

    Args:
        half: "first", "second" (every other video of each scenario, by id) or "all".
        limit: at most about so many, with the scenarios in proportion.
    """
    chosen: list[Event] = []
    events = sorted(ppl.load_events(need("dev.json")), key=lambda event: event.id)
    for scenario in SCENARIOS:
        group = [event for event in events if event.truth.scenario == scenario]
        if half != "all":
            group = group[HALVES.index(half) :: 2]
        if limit is not None:
            n = max(1, round(limit * len(group) / len(events) * (1 if half == "all" else 2)))
            group = [
                group[i] for i in np.linspace(0, len(group) - 1, min(n, len(group))).astype(int)
            ]
        chosen += group
    return sorted(chosen, key=lambda event: -event.observation.n_frames)


def true_hypothesis(event: Event) -> Hypothesis:
    """Return the effective goals and the strengths of an event."""
    told = event.truth
    strengths = told.strength_red, told.strength_green
    return Hypothesis(told.goal_red, told.goal_green, (0, 0), *strengths)


def by_scenario(rows: Iterable[Row]) -> Iterator[tuple[str, list[Row]]]:
    """Yield each scenario, and "all", with the rows of it, of those that have any."""
    given = list(rows)
    for scenario in (*SCENARIOS, "all"):
        if group := [row for row in given if scenario in (row["scenario"], "all")]:
            yield scenario, group


def replays() -> list[dict[str, Any]]:
    """Return the recovered actions of the real agents."""
    return json.loads(need("dev_replays.json").read_text())["videos"]


def parallel(
    function: Callable[[Task], Any], tasks: Sequence[Task], label: str, workers: int | None = None
) -> Iterator[tuple[Task, Any]]:
    """Yield (task, result) as they finish, from all cores, under a progress bar."""
    n = workers or loky.cpu_count()
    if n == 1:  # that of this process
        for task in tqdm(tasks, desc=label, disable=None):
            yield task, function(task)
        return
    with loky.ProcessPoolExecutor(n) as pool:
        futures = {pool.submit(function, task): task for task in tasks}
        for future in tqdm(as_completed(futures), total=len(futures), desc=label, disable=None):
            yield futures[future], future.result()


def resumed(
    function: Callable[[Task], dict[str, Any]],
    tasks: Sequence[Task],
    name_of: Callable[[Task], str],
    label: str,
    kept: Path | None,
    settings: dict[str, Any],
    workers: int | None = None,
) -> list[dict[str, Any]]:
    """Return the results of all tasks in order; those kept in a file are not computed again.

    Args:
        kept: one JSON object per line: the settings, then a result per finished task. A file
            with other settings is refused.
    """
    done: dict[str, dict[str, Any]] = {}
    if kept is not None and kept.exists():
        lines = [json.loads(line) for line in kept.read_text().splitlines() if line]
        if lines and lines[0] != {"settings": settings}:
            sys.exit(f"{kept} holds results of other settings: {lines[0].get('settings')}")
        done = {line["name"]: line["result"] for line in lines[1:]}
    elif kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps({"settings": settings}) + "\n")
    left = [task for task in tasks if name_of(task) not in done]
    for task, result in parallel(function, left, label, workers):
        done[name_of(task)] = result
        if kept is not None:
            with kept.open("a") as file:
                file.write(json.dumps({"name": name_of(task), "result": result}) + "\n")
    return [done[name_of(task)] for task in tasks]


def add_planner(parser: argparse.ArgumentParser, default: str = "fast") -> None:
    """Add the options that choose a planner."""
    parser.add_argument("--planner", default=default, choices=["paper", "fast"])
    parser.add_argument(
        "--set",
        dest="changes",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a setting of the planner, such as simulations=100",
    )


def planner_of(options: argparse.Namespace) -> PlannerConfig:
    """Return the planner that the options ask for."""
    known = {field.name for field in dataclasses.fields(PlannerConfig)}
    changes = assignments(options.changes)
    for key in changes:
        if key not in known:
            sys.exit(f"--set {key}: there is no such setting, but {', '.join(sorted(known))}")
    return dataclasses.replace(PlannerConfig.named(options.planner), **changes)


def assignments(given: Iterable[str]) -> dict[str, Any]:
    """Return KEY=VALUE options; a value that is no JSON, such as a word, is taken as it is."""
    changes: dict[str, Any] = {}
    for change in given:
        key, equals, value = change.partition("=")
        if not (key and equals and value):
            sys.exit(f"{change}: expected KEY=VALUE")
        try:
            changes[key] = json.loads(value)
        except json.JSONDecodeError:
            changes[key] = value
    return changes


def interval(
    values: Iterable[float],
    statistic: Callable[..., NDArray[Any]] = np.mean,
    resamples: int = 2000,
    level: float = 0.95,
) -> dict[str, float]:
    """Return a statistic with its bootstrap interval over the values."""
    sample = np.asarray(list(values), float)
    rng = np.random.default_rng(0)
    draws = statistic(sample[rng.integers(0, len(sample), (resamples, len(sample)))], axis=1)
    low, high = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2])
    value = float(statistic(sample[None], axis=1)[0])
    return {"value": value, "ci_low": float(low), "ci_high": float(high)}


def shown(figure: Mapping[str, float], form: str = ".2f", ends: str = ".2f") -> str:
    """Return a figure of :func:`interval` in words."""
    return f"{figure['value']:{form}} [{figure['ci_low']:{ends}}, {figure['ci_high']:{ends}}]"


def write(report: dict[str, Any], file: str | None) -> None:
    """Write the report as JSON, if a file is named."""
    if file is not None:
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        Path(file).write_text(json.dumps(report, indent=1) + "\n")
