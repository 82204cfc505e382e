"""Whole simulations: early stop, shares of time, presets, workers, memory, the first step."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from phase_ppl import (
    ClosedLoopLikelihood,
    Hypothesis,
    Model,
    Observation,
    Scene,
    infer,
    load_event,
    watch,
)
from phase_ppl.agents import beliefs, pomcp, vision
from phase_ppl.agents.agent import Policies
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.simulator.runner import Runner
from speed.scenes import episodes

STEPS = 30


def run(planner: PlannerConfig, steps: int = STEPS, seed: int = 0) -> float:
    """Simulate four events and return the CPU seconds."""
    chosen = episodes()
    clock = time.process_time()
    for event, hypothesis in chosen:
        frames = JointSimulator(planner)(event.scene, hypothesis, np.random.default_rng(seed))
        for _ in itertools.islice(frames, steps + 1):
            pass
    return time.process_time() - clock


def early_stop() -> dict[str, Any]:
    """Every decision of the episodes twice, with and without the early stop, from the same state.

    The action, not the tie, is compared: where the early stop ends a search the leader is alone.
    """
    original = pomcp.run
    same: list[bool] = []
    steps = {True: 0, False: 0}

    def both(tree: pomcp.Tree, *given: Any) -> int:
        *where, search, params, layout, scratch, rng = given
        begin, chosen = rng.copy(), {}
        for stops in (True, False):
            rng[:] = begin
            one = pomcp.make_tree(search.simulations) if stops else tree
            settings = search._replace(early_stop=stops)
            chosen[stops] = original(one, *where, settings, params, layout, scratch, rng)  # type: ignore[call-arg]
            steps[stops] += int(one.statistics[1])
        same.append(chosen[True] == chosen[False])
        return int(chosen[False])

    pomcp.run = both  # type: ignore[assignment]
    try:
        run(PlannerConfig())
    finally:
        pomcp.run = original
    return {
        "early_stop_same_action": sum(same) / len(same),
        "early_stop_decisions": len(same),
        "early_stop_saved": 1 - steps[True] / steps[False],
    }


class Clock:
    """Adds up the CPU seconds that calls of a function take."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._undo: list[tuple[Any, str, Any]] = []

    def time(self, owner: Any, name: str, label: str) -> None:
        function: Callable[..., Any] = getattr(owner, name)
        self.seconds.setdefault(label, 0.0)

        def timed(*arguments: Any, **named: Any) -> Any:
            clock = time.process_time()
            try:
                return function(*arguments, **named)
            finally:
                self.seconds[label] += time.process_time() - clock

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
    clock.time(Policies, "_describe", "symbols")
    clock.time(Policies, "_intent", "subgoals")
    clock.time(PymunkWorld, "step", "world")
    try:
        total = run(planner)
    finally:
        clock.stop()
    found = {name: seconds / total for name, seconds in clock.seconds.items()}
    return found | {"rest": 1 - sum(found.values())}


def presets() -> dict[str, Any]:
    """CPU time per step of both presets, in turn."""
    times: dict[str, list[float]] = {"paper": [], "fast": []}
    for repeat in range(3):
        for name, values in times.items():
            values.append(run(PlannerConfig.named(name), seed=repeat))
    per_step = {
        name: 1e3 * float(np.median(v)) / (STEPS * len(episodes())) for name, v in times.items()
    }
    return {
        "cpu_ms_per_step_paper": per_step["paper"],
        "cpu_ms_per_step_fast": per_step["fast"],
        "fast_speedup": per_step["paper"] / per_step["fast"],
    }


def two_workers(repeats: int = 3) -> dict[str, Any]:
    """The same requests by one worker process and by two, in turn, start-up not counted."""
    event, hypothesis = episodes()[0]
    seconds: dict[int, list[float]] = {1: [], 2: []}
    with contextlib.ExitStack() as stack:
        runners = {
            workers: stack.enter_context(
                Runner(JointSimulator("fast"), event.scene, event.observation, workers=workers)
            )
            for workers in seconds
        }
        for runner in runners.values():
            runner.run([hypothesis] * 2, [1, 2])
        for _ in range(repeats):
            for workers, runner in runners.items():
                clock = time.perf_counter()
                runner.run([hypothesis] * 24, range(10, 34))
                seconds[workers].append(time.perf_counter() - clock)
    ratios = np.array(seconds[1]) / np.array(seconds[2])
    return {"two_worker_speedup": float(np.median(ratios))}


def closed_loop(n_frames: int = 16) -> dict[str, Any]:
    """CPU time a frame, one set of searches that share what they imagine or not, in turn."""
    searches = Policies.searches

    def alone(policies: Policies) -> list[list[int]]:
        return [[place] for group in searches(policies) for place in group]

    times: dict[str, list[float]] = {"shared": [], "alone": []}
    model = Model(likelihood=ClosedLoopLikelihood(planner_seeds=1))
    try:
        for _ in range(3):
            for name, grouped in (("shared", searches), ("alone", alone)):
                Policies.searches = grouped  # type: ignore[method-assign,assignment]
                begin = time.process_time()
                for event in ("collaborate", "compete"):
                    scene, seen = load_event(event).scene, load_event(event).observation
                    with watch(scene, model, threads=1) as reading:
                        for frame in seen.trajectory[1 : n_frames + 1]:
                            reading.take(frame)
                times[name].append((time.process_time() - begin) / (2 * n_frames))
    finally:
        Policies.searches = searches  # type: ignore[method-assign]
    shared, apart = (float(np.median(times[name])) for name in ("shared", "alone"))
    return {
        "closed_loop_ms_per_frame": 1e3 * shared,
        "closed_loop_sharing_speedup": apart / shared,
    }


def new_length() -> dict[str, Any]:
    """CPU time of an inference by an instant simulator: of one length again, and of another."""

    def still(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[Any]:
        while True:
            yield scene.start

    whole_event = load_event("collaborate")
    seconds = []
    for n_frames in (20, 20, 21):
        event = dataclasses.replace(
            whole_event, observation=Observation(whole_event.observation.trajectory[:n_frames])
        )
        begin = time.process_time()
        infer(event, Model(simulator=still), kernel="local_mh", progress=False)
        seconds.append(time.process_time() - begin)
    return {"infer_seconds_again": seconds[1], "new_length_seconds": seconds[2] - seconds[1]}


FIRST = """
import itertools, time, numpy as np, phase_ppl as ppl
from phase_ppl.simulator.joint import JointSimulator
event = ppl.load_event("collaborate")
h = ppl.Hypothesis(event.truth.goal_red, event.truth.goal_green)
steps = JointSimulator("paper").steps(event.scene, h, np.random.default_rng(0))
for _ in itertools.islice(steps, 2): pass
print(time.monotonic())
"""


def first_decision() -> dict[str, Any]:
    """A new process with a warm cache, from the start of Python to the end of the first step."""
    seconds = []
    for _ in range(6):
        begin = time.monotonic()
        end = float(subprocess.check_output([sys.executable, "-c", FIRST], text=True))
        seconds.append(end - begin)
    return {"first_decision_seconds_warm": float(np.median(seconds[1:]))}


COLD = """
import sys
import time
from phase_ppl.physics import jit
if sys.argv[1] == "numba":
    jit.KNOWN_NUMBA = False
from phase_ppl.closed_loop.goal_filter import warm_up
from phase_ppl.simulator.joint import JointSimulator
begin = time.process_time()
JointSimulator().warm_up()
warm_up()
print(time.process_time() - begin)
"""


def cold() -> dict[str, Any]:
    """Compilation of what an inference needs where nothing is kept, by numba's rules and ours."""
    seconds = {}
    for rules in ("numba", "ours"):
        with tempfile.TemporaryDirectory() as folder:
            seconds[rules] = float(
                subprocess.check_output(
                    [sys.executable, "-c", COLD, rules],
                    text=True,
                    env=dict(os.environ, NUMBA_CACHE_DIR=folder),
                )
            )
    return {
        "cold_compilation_cpu_seconds": seconds["ours"],
        "cold_compilation_numba_over_ours": seconds["numba"] / seconds["ours"],
    }


def resident() -> float:
    """Return the megabytes of this process that are in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def memory() -> dict[str, Any]:
    """Growth of the resident set over simulated steps, after a warm-up."""
    run(PlannerConfig.fast(), steps=100)
    before, steps = resident(), 0
    for seed in range(1, 4):
        run(PlannerConfig.fast(), steps=100, seed=seed)
        steps += 100 * len(episodes())
    return {"rss_growth_mb_per_1000_steps": 1000 * (resident() - before) / steps}
