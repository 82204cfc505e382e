"""How long does a person wait, and where does the time go?

    python benchmarks/waits.py [--only PART ...] [--frames N] [--every N] [--json FILE]

- ``first``: the first answer where no compiled code is kept; which functions were compiled
- ``answers``: the closed loop and SIMPLE on a bundled event, by part
- ``stream``: frames of a stream, early and late: seconds and memory
- ``events``: what an event of a set costs beside its answer; the second process, the second machine
- ``models``: models at their accuracy, on every fourth real video (``--every``)

Seconds depend on the machine, so the first line measures it: a loop of Python, and one transition
of the compiled physics. Use a quiet machine, and compare figures of one run.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import common
import numpy as np
import pandas as pd
from speed.engines import transitions
from speed.whole import Clock, resident

import phase_ppl as ppl
from phase_ppl.agents import pomcp
from phase_ppl.agents.agent import Policies
from phase_ppl.closed_loop.hidden_state import HiddenState
from phase_ppl.simulator.joint import JointSimulator

EVENT = "collaborate"
STREAM = 10_000
SETS = (10, 100, 1000, 10_000)
LISTED = 12  # functions that took longest to compile


def closed_loop(sets: int) -> ppl.Model:
    return ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=sets))


def machine(_: Any) -> dict[str, float]:
    began = time.process_time()
    total = 0
    for number in range(5_000_000):
        total += number * number
    return {"python_loop_s": time.process_time() - began, **transitions()}


FIRST = """
import json, sys, time
from collections import Counter
from numba.core import event
import jax
spent, open_ = Counter(), []

class Compiling(event.Listener):
    def on_start(self, one):
        open_.append([time.process_time(), 0.0])

    def on_end(self, one):
        began, inner = open_.pop()
        took = time.process_time() - began
        spent["numba " + one.data["dispatcher"].py_func.__qualname__] += took - inner
        if open_:
            open_[-1][1] += took

event.register("numba:compile", Compiling())
jax.monitoring.register_event_duration_secs_listener(
    lambda name, seconds, **_: spent.update({"jax " + name.split("/")[-1]: seconds})
)
import phase_ppl as ppl
seen = ppl.load_event("collaborate")
began = time.process_time()
if sys.argv[1] == "simple":
    ppl.infer(seen, kernel="local_mh", budget=ppl.simulations(30), workers=1, progress=False)
else:
    ppl.infer(seen, ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1)), progress=False)
print(json.dumps({"cpu_s": time.process_time() - began, "compiling": dict(spent)}))
"""


def first(_: Any) -> dict[str, Any]:
    """CPU seconds of the same answer with nothing kept, less those with all kept."""
    found: dict[str, Any] = {}
    for way in ("closed_loop", "simple"):
        with tempfile.TemporaryDirectory() as folder:
            cold, warm = (
                json.loads(
                    subprocess.run(
                        [sys.executable, "-c", FIRST, way],
                        env=dict(os.environ, NUMBA_CACHE_DIR=folder),
                        capture_output=True,
                        text=True,
                        check=True,
                    ).stdout
                )
                for _ in range(2)
            )
        found[f"{way}_compiling_cpu_s"] = cold["cpu_s"] - warm["cpu_s"]
        longest = Counter(cold["compiling"]).most_common(LISTED)
        found[f"{way}_longest"] = {name: round(seconds, 2) for name, seconds in longest}
        for kind in ("numba", "jax"):
            parts = [s for name, s in cold["compiling"].items() if name.startswith(kind)]
            found[f"{way}_{kind}_s"] = sum(parts)
    return found


def answers(_: Any) -> dict[str, Any]:
    """Seconds by the clock and of all cores; where they go, in the closed loop's threads."""
    event = ppl.load_event(EVENT)
    length = event.observation.n_frames / 4  # seconds of film
    found: dict[str, Any] = {"film_s": length}
    for sets in (1, 4):
        model = closed_loop(sets)
        ppl.infer(event, model, progress=False)
        wall, cpu = time.perf_counter(), time.process_time()
        post = ppl.infer(event, model, seed=1, progress=False)
        found[f"closed_loop_{sets}_wall_of_film"] = (time.perf_counter() - wall) / length
        found[f"closed_loop_{sets}_cpu_of_film"] = (time.process_time() - cpu) / length
        found[f"closed_loop_{sets}_searches"] = post.cost["searches"]
        clock = Clock()
        clock.time(HiddenState, "advance", "joint actions")
        clock.time(Policies, "observe", "beliefs")
        clock.time(Policies, "root_statistics", "searches")
        try:
            with ppl.watch(event.scene, model, seed=1, threads=1) as watch:
                cpu = time.process_time()
                for frame in event.observation.trajectory:
                    watch.take(frame)
                total = time.process_time() - cpu
        finally:
            clock.stop()
        shares = {name: seconds / total for name, seconds in clock.seconds.items()}
        found[f"closed_loop_{sets}_shares"] = shares
        found[f"closed_loop_{sets}_transitions_a_frame"] = transitions_of(
            lambda model=model: ppl.infer(event, model, seed=1, progress=False)  # type: ignore[misc]
        ) / (event.observation.n_frames - 1)
    wall, cpu = time.perf_counter(), time.process_time()
    ppl.infer(event, kernel="local_mh", budget=ppl.simulations(120), workers=1, progress=False)
    found["simple_120_cpu_s"] = time.process_time() - cpu
    found["simple_120_wall_s"] = time.perf_counter() - wall
    return found


def transitions_of(read: Callable[[], Any]) -> int:
    """Return how many transitions all searches of a reading imagine."""
    search, counts = pomcp.run, []

    def counted(tree: pomcp.Tree, *given: Any) -> int:
        chosen = search(tree, *given)
        counts.append(int(tree.statistics[1]))
        return int(chosen)

    pomcp.run = counted  # type: ignore[assignment]
    try:
        read()
    finally:
        pomcp.run = search
    return sum(counts)


def stream(options: Any) -> dict[str, Any]:
    """One set of searches reads a long event: seconds a frame and memory, by tenths of it."""
    event = ppl.load_event(EVENT)
    frames = JointSimulator("fast")(
        event.scene, common.true_hypothesis(event), np.random.default_rng(0)
    )
    wall, cpu, memory = [], [], []
    with ppl.watch(event.scene, closed_loop(1)) as watch:
        for frame in itertools.islice(frames, options.frames):
            at = time.perf_counter(), time.process_time()
            watch.take(frame)
            wall.append(time.perf_counter() - at[0])
            cpu.append(time.process_time() - at[1])
            memory.append(resident())
            if len(wall) % 500 == 0:
                print(f"  frame {len(wall)}: {1e3 * np.median(wall[-500:]):.0f} ms", flush=True)
    tenths = np.array_split(np.array(wall[50:]), 10)  # the first frames load compiled code
    return {
        "frames": len(wall),
        "ms_by_tenth": [1e3 * float(np.median(part)) for part in tenths],
        "cpu_ms_by_tenth": [
            1e3 * float(np.median(part)) for part in np.array_split(np.array(cpu[50:]), 10)
        ],
        "p99_ms": 1e3 * float(np.quantile(wall[50:], 0.99)),
        "mb_by_tenth": [float(part[-1]) for part in np.array_split(np.array(memory), 10)],
    }


def events(options: Any) -> dict[str, Any]:
    """Seconds an event that any evaluation needs, by events; two processes over one."""
    one = ppl.load_event(EVENT)
    found: dict[str, Any] = {"ms_an_event": {}, "mb": {}}
    for n in SETS:
        began = time.perf_counter()
        ppl.evaluate(named(one, n), model="majority", workers=1, progress=False)
        found["ms_an_event"][n] = 1e3 * (time.perf_counter() - began) / n
        found["mb"][n] = resident()
    seconds = {}
    for workers in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            began = time.perf_counter()
            ppl.evaluate(
                named(one, 12), closed_loop(1), out=folder, workers=workers, progress=False
            )
            seconds[workers] = time.perf_counter() - began
    found["second_process"] = seconds[1] / seconds[2]
    found["second_machine"] = seconds_by_dask(one, 1) / seconds_by_dask(one, 2)
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**10
    found["largest_process_mb"] = children
    if options.figure:
        draw(found["ms_an_event"], options.figure)
    return found


def seconds_by_dask(event: ppl.Event, machines: int) -> float:
    """Seconds for twelve events on a cluster whose workers have a core each."""
    from dask.distributed import Client, LocalCluster

    def keep_to_a_core(dask_worker: Any) -> None:
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(dask_worker.name) % len(cores)]})

    with (
        LocalCluster(n_workers=machines, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
        tempfile.TemporaryDirectory() as folder,
    ):
        client.run(keep_to_a_core)
        given: dict[str, Any] = {"executor": client.get_executor(), "progress": False}
        # each worker loads what is compiled
        ppl.evaluate(named(event, machines), closed_loop(1), out=f"{folder}/first", **given)
        began = time.perf_counter()
        ppl.evaluate(named(event, 12), closed_loop(1), out=f"{folder}/all", **given)
        return time.perf_counter() - began


def named(event: ppl.Event, n: int) -> list[ppl.Event]:
    return [dataclasses.replace(event, id=f"event-{place}") for place in range(n)]


def draw(costs: dict[int, float], file: str) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(4.5, 3), layout="constrained")
    axes.loglog(list(costs), list(costs.values()), "o-")
    axes.set(xlabel="events", ylabel="ms an event, without its answer")
    figure.savefig(file, dpi=150)


def models(options: Any) -> dict[str, Any]:
    """Right answers, mean log probability of the truth and CPU seconds, by model."""
    budget: dict[str, Any] = {"budget": ppl.simulations(120), "workers": 1}
    ways: dict[str, Callable[[ppl.Event], Any]] = {
        "closed loop, 1 set": lambda one: ppl.infer(one, closed_loop(1), progress=False),
        "closed loop, 4 sets": lambda one: ppl.infer(one, closed_loop(4), progress=False),
    }
    for kernel in ("local_mh", "importance", "smc"):
        ways[f"{kernel}, 120"] = lambda one, kernel=kernel: ppl.infer(  # type: ignore[misc]
            one, kernel=kernel, progress=False, **budget
        )
    rows = []
    for one in common.dev_events()[:: options.every]:
        truth = {"goal_red": one.truth.goal_red, "goal_green": one.truth.goal_green,
                 "relation": one.truth.relation}  # fmt: skip
        for name, infer in ways.items():
            cpu = time.process_time()
            post = infer(one)
            cpu = time.process_time() - cpu
            masses = {site: post.marginal(site).to_series() for site in truth}
            log_p = {site: np.log(max(masses[site][truth[site]], 1e-12)) for site in truth}
            rows.append(
                {
                    "model": name,
                    "cpu_s": cpu,
                    "goals": np.mean(
                        [masses[s].idxmax() == truth[s] for s in ("goal_red", "goal_green")]
                    ),
                    "relation": float(masses["relation"].idxmax() == truth["relation"]),
                    "log_p_goals": np.mean([log_p["goal_red"], log_p["goal_green"]]),
                    "log_p_relation": log_p["relation"],
                }
            )
            print(f"  {one.id} {name}: {cpu:.0f} s", flush=True)
    table = pd.DataFrame(rows).groupby("model", sort=False).mean()
    print(table.round(2).to_string())
    return {"models": table.to_dict("index")}


PARTS = {
    "machine": machine,
    "first": first,
    "answers": answers,
    "stream": stream,
    "events": events,
    "models": models,
}


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART")
    parser.add_argument("--frames", type=int, default=STREAM, help="of the stream")
    parser.add_argument("--every", type=int, default=4, metavar="N", help="real video, of models")
    parser.add_argument("--figure", metavar="FILE", help="cost against events")
    options = parser.parse_args()
    report = {}
    for name in options.only:
        report[name] = PARTS[name](options)
        for key, value in report[name].items():
            print(f"{key:28} {value}", flush=True)
    common.write(report, options.json)


if __name__ == "__main__":
    main()
