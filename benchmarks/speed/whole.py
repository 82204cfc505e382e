"""Whole simulations: early stop, where the time goes, presets, workers, memory, the first step."""

from __future__ import annotations

import dataclasses
import itertools
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from phase_ppl.agents import beliefs, pomcp, vision
from phase_ppl.agents.agent import Agent
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.simulator.runner import Runner
from speed.scenes import episodes

STEPS = 30


def run(planner: PlannerConfig, steps: int = STEPS, seed: int = 0) -> tuple[float, list[int], int]:
    """Return CPU seconds, all actions, and physics steps of the searches, over four events."""
    actions, searched = [], 0
    made: list[Agent] = []
    create = Agent.__init__

    def noted(self: Agent, *arguments: Any, **named: Any) -> None:
        create(self, *arguments, **named)
        made.append(self)

    Agent.__init__ = noted  # type: ignore[method-assign]
    try:
        clock = time.process_time()
        for event, hypothesis in episodes():
            frames = JointSimulator(planner).steps(
                event.scene, hypothesis, np.random.default_rng(seed)
            )
            for _, decisions in itertools.islice(frames, steps + 1):
                actions += [int(decision.action) for decision in decisions]
        seconds = time.process_time() - clock
    finally:
        Agent.__init__ = create  # type: ignore[method-assign]
    searched = sum(int(agent.tree.statistics[1]) for agent in made)
    return seconds, actions, searched


def early_stop() -> dict[str, Any]:
    """The same episodes with and without the early stop, which draws no random number less."""
    paper = PlannerConfig()
    _, kept, all_steps = run(dataclasses.replace(paper, early_stop=False))
    same, decisions = compare_decisions(paper)
    _, _, fewer = run(paper)
    return {
        "early_stop_same_action": same / decisions,
        "early_stop_decisions": decisions,
        "early_stop_saved": 1 - fewer / all_steps,
        "decisions_without_early_stop": len(kept),
    }


def compare_decisions(planner: PlannerConfig) -> tuple[int, int]:
    """Return in how many decisions the early stop chooses as the full search, and of how many."""
    same = total = 0
    original = Agent._search_actions

    def both(self: Agent, *arguments: Any) -> Any:
        nonlocal same, total
        rng, search = self._rng.copy(), self.search
        self.search = search._replace(early_stop=False)
        full = original(self, *arguments)
        after = self._rng.copy()
        self._rng[:] = rng
        self.search = search
        stopped = original(self, *arguments)
        # ties are broken at random after the search; count them as the same
        most = full[1] == full[1].max()
        same += bool(most[stopped[0]])
        total += 1
        self._rng[:] = after
        return full

    Agent._search_actions = both  # type: ignore[method-assign]
    try:
        run(planner)
    finally:
        Agent._search_actions = original  # type: ignore[method-assign]
    return same, total


class Clock:
    """Adds up the seconds that calls of a function take."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._undo: list[tuple[Any, str, Any]] = []

    def time(self, owner: Any, name: str, label: str) -> None:
        function: Callable[..., Any] = getattr(owner, name)
        self.seconds.setdefault(label, 0.0)

        def timed(*arguments: Any, **named: Any) -> Any:
            clock = time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                self.seconds[label] += time.perf_counter() - clock

        setattr(owner, name, timed)
        self._undo.append((owner, name, function))

    def stop(self) -> None:
        for owner, name, function in reversed(self._undo):
            setattr(owner, name, function)


def shares(planner: PlannerConfig) -> dict[str, float]:
    """Return which share of a simulation's time goes where."""
    run(planner, steps=2)
    clock = Clock()
    clock.time(pomcp, "run", "search")
    clock.time(vision, "observe", "vision")
    clock.time(beliefs, "update", "beliefs")
    clock.time(Agent, "choose_subgoal", "symbols and A*")
    clock.time(PymunkWorld, "step", "world")
    begin = time.perf_counter()
    run(planner)
    total = time.perf_counter() - begin
    clock.stop()
    found = {name: seconds / total for name, seconds in clock.seconds.items()}
    return found | {"rest": 1 - sum(found.values())}


def presets() -> dict[str, Any]:
    """CPU time per step of both presets, in turn."""
    times: dict[str, list[float]] = {"paper": [], "fast": []}
    for repeat in range(3):
        for name, values in times.items():
            values.append(run(PlannerConfig.named(name), seed=repeat)[0])
    per_step = {
        name: 1e3 * float(np.median(v)) / (STEPS * len(episodes())) for name, v in times.items()
    }
    return {
        "cpu_ms_per_step_paper": per_step["paper"],
        "cpu_ms_per_step_fast": per_step["fast"],
        "fast_speedup": per_step["paper"] / per_step["fast"],
    }


def two_workers() -> dict[str, Any]:
    """The same requests with one worker process and with two, start-up not counted."""
    event, hypothesis = episodes()[0]
    seconds = {}
    for workers in (1, 2):
        with Runner(
            JointSimulator("fast"), event.scene, event.observation, workers=workers
        ) as runner:
            runner.run([hypothesis] * 2, [1, 2])
            clock = time.perf_counter()
            runner.run([hypothesis] * 24, range(10, 34))
            seconds[workers] = time.perf_counter() - clock
    return {"two_worker_speedup": seconds[1] / seconds[2]}


FIRST = """
import time; begin = time.perf_counter()
import itertools, numpy as np, phase_ppl as ppl
from phase_ppl.simulator.joint import JointSimulator
event = ppl.load_event("collaborate")
h = ppl.Hypothesis(event.truth.goal_red, event.truth.goal_green)
steps = JointSimulator("paper").steps(event.scene, h, np.random.default_rng(0))
for _ in itertools.islice(steps, 2): pass
print(time.perf_counter() - begin)
"""


def first_decision() -> dict[str, Any]:
    """A new process with a warm cache, from its first line to the first step."""
    seconds = [
        float(subprocess.check_output([sys.executable, "-c", FIRST], text=True)) for _ in range(4)
    ]
    return {"first_decision_seconds_warm": float(np.median(seconds[1:]))}


def memory() -> dict[str, Any]:
    """Growth of the resident set over simulated steps, after a warm-up."""

    def resident() -> float:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * 4096 / 2**20

    run(PlannerConfig.fast(), steps=100)
    before, steps = resident(), 0
    for seed in range(1, 4):
        run(PlannerConfig.fast(), steps=100, seed=seed)
        steps += 100 * len(episodes())
    return {"rss_growth_mb_per_1000_steps": 1000 * (resident() - before) / steps}
