"""Does anything end in a traceback, hang, lose work or change it silently?

    python benchmarks/attack.py [--inputs N] [--kills N] [--only KIND ...] [--seed N] [--json FILE]

``--inputs`` draws N attacks at random from four kinds:

* ``commands``: a command line with one option spoilt;
* ``calls``: a call of the API with one argument spoilt;
* ``flips``: a file with bytes changed or cut off, which must be refused or read as it was;
* ``hostile``: a file made to do harm.

Each is tried in a warm process. More than 20 s counts as endless, and the end of the process as a
crash.

``--kills`` ends N processes of infer, evaluate, generate or compare by SIGKILL at a random moment.
The next process must then make the same as one that was never killed. Simulators are toys.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import dataclasses
import faulthandler
import io
import json
import pickle
import random
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import common
import h5py
import numpy as np

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.cli import main as terminal
from phase_ppl.data.events_json import checksum
from phase_ppl.inference.checkpoint import Checkpoint
from phase_ppl.world.errors import PhasePPLError
from phase_ppl.world.picture import plain
from tests.data.test_bad_files import FILES
from tests.data.test_hdf5 import TRICKS
from tests.inference.test_checkpoint import HOSTILE
from tests.inference.toy import walkers, walking_event

KINDS = ("commands", "calls", "flips", "hostile", "kills")
SECONDS, KILL_SECONDS = 20.0, 300.0
FILE = str(Path(__file__).resolve())
EVENT, MODEL = walking_event(), ppl.Model(simulator=walkers)
RUN: dict[str, Any] = {"kernel": "prior_mh", "chains": 4, "seed": 3, "workers": 1}
QUIET: dict[str, Any] = {"progress": False}
GO = ppl.Hypothesis("Get red agent to red lm", "Get green agent to blue lm")

# --- files -------------------------------------------------------------------------------------


def prepare(folder: Path) -> None:
    """Make one good file of each kind."""
    post = ppl.infer(EVENT, MODEL, iterations=2, checkpoint=folder / "run.ckpt", **RUN, **QUIET)
    post.save(folder / "posterior.nc")
    with ppl.watch(EVENT.scene, event_id="walk") as watch:
        watch.take(EVENT.observation.trajectory[0])
        watch.posterior().save(folder / "reading.nc")
    ppl.save_event(EVENT, folder / "event.json")
    other = dataclasses.replace(walking_event(13), id="other")
    ppl.save_events([EVENT, other], folder / "events.json")


def content_of(path: Path) -> Any:
    """Return all that a file holds, so that it can be compared."""
    if path.suffix == ".ckpt":
        saved = Checkpoint(path)
        return pickle.dumps((saved.identity, saved.particles, saved._leaves))
    if path.stem in ("posterior", "reading"):
        post = ppl.load_posterior(path)
        groups = post.tree.subtree if isinstance(post, ppl.Posterior) else [post.dataset]
        return [(g.attrs, {n: v.values.tobytes() for n, v in g.variables.items()}) for g in groups]
    return [checksum(event) for event in ppl.load_events(path)]


def flip(rng: random.Random, folder: Path) -> tuple[str, Callable[[], Any]]:
    names = ("run.ckpt", "posterior.nc", "reading.nc", "event.json", "events.json")
    source = folder / rng.choice(names)
    content = bytearray(source.read_bytes())
    if rng.random() < 0.2:
        content = content[: rng.randrange(len(content))]
    for _ in range(rng.choice((1, 1, 3, 30)) if content else 0):
        content[rng.randrange(len(content))] = rng.randrange(256)
    damaged = folder / "damaged" / source.name
    damaged.parent.mkdir(exist_ok=True)
    damaged.write_bytes(content)

    def attempt() -> str:
        return "" if content_of(damaged) == content_of(source) else "silent difference"

    return source.name, attempt


def hostile(rng: random.Random, folder: Path) -> tuple[str, Callable[[], Any]]:
    files = {f"{n} {message}": content for n, (content, message) in enumerate(FILES)}
    trick = rng.choice(list(rng.choice([TRICKS, HOSTILE, files])))
    if trick in TRICKS:
        source = folder / rng.choice(("posterior.nc", "reading.nc"))
        path = folder / f"hostile-{source.name}"
        path.write_bytes(source.read_bytes())
        with h5py.File(path, "r+") as file:
            groups = [name for name in file if isinstance(file[name], h5py.Group)]
            TRICKS[trick][0](file[rng.choice(groups or ["/"])])
    elif trick in HOSTILE:
        path = folder / "hostile.ckpt"
        path.write_bytes(HOSTILE[trick]((folder / "run.ckpt").read_bytes()))
    else:
        path = folder / "hostile.json"
        path.write_bytes(files[trick])

    def attempt() -> str:
        if path.suffix == ".ckpt":
            ppl.resume(path, model=MODEL, **QUIET)
        elif path.stem.endswith(("posterior", "reading")):
            return "an escape got through" if "\x1b" in str(ppl.load_posterior(path)) else ""
        else:
            ppl.load_events(path)
        return ""

    return f"{trick} {path.suffix}", attempt


# --- calls and command lines ---------------------------------------------------------------------

ODD: tuple[Any, ...] = (
    *(None, -1, 0, 1.5, 10**12, 10**5000, float("nan"), float("inf"), True, "", "x", "x" * 5000),
    *("a\0b", b"x", [], {}, [3], {"x": 1}, object(), np.int64(-3), np.zeros(3), lambda: 3),
)
ODD_WORDS = (
    *("", "-1", "0", "1.5", "nan", "inf", "1e400", "1000000000000", "9" * 5000, "x" * 5000, "ä"),
    *("nowhere", "/dev/null/x", "\x1b[31m", "a=b", "=", "a,b,,", "--", "../..", "None"),
)


def call(rng: random.Random, folder: Path) -> tuple[str, Callable[[], Any]]:
    toy = {"event": EVENT, "model": MODEL, **RUN, **QUIET}
    out, budget = folder / f"out-{rng.randrange(10**9)}", ppl.simulations(8)
    pool: list[tuple[Callable[..., Any], dict[str, Any]]] = [
        (ppl.infer, {**toy, "iterations": 1, "settings": None, "budget": None, "executor": None}),
        (ppl.infer, {**toy, "iterations": 1, "on_failure": "reject", "checkpoint": None}),
        (ppl.resume, {"path": folder / "run.ckpt", "model": MODEL, "iterations": 2, **QUIET}),
        (ppl.compare, {"event": EVENT, "kernels": ["prior_mh"], "repeats": 1, "budget": budget}),
        (ppl.evaluate, {"events": EVENT, "model": "majority", "out": out, "seed": 0, "limit": 1}),
        (ppl.generate, {"out": out, "n": 10**8, "cells": {"chasing": 1}, "copies": 0, "seed": 0}),
        (ppl.simulate, {"scene": EVENT.scene, "hypothesis": GO, "frames": 3, "seed": 0}),
        (ppl.load_event, {"path": folder / "event.json", "video": None, "turning": None}),
        (ppl.load_events, {"path": folder / "events.json", "turning": None}),
        (ppl.load_posterior, {"path": folder / "posterior.nc", "weights": None}),
        (ppl.save_event, {"event": EVENT, "path": folder / "saved.json"}),
        (ppl.save_events, {"events": [EVENT], "path": folder / "saved.json"}),
        (ppl.Hypothesis, {"goal_red": 12, "goal_green": 13, "alpha": (0, 0), "strength_red": 3.0}),
        (ppl.Scene, {"start": EVENT.scene.start, "radius": EVENT.scene.radius, "walls": []}),
        (ppl.Event, {"scene": EVENT.scene, "observation": EVENT.observation}),
        (ppl.watch, {"scene": EVENT.scene, "model": None, "seed": 0, "threads": 1}),
        (ppl.report, {"folder": folder, "path": folder / "report.html"}),
        (ppl.render.video, {"what": EVENT, "path": folder / "film.mp4", "fps": 5}),
        (ppl.seconds, {"n": 3}),
        (ppl.Model, {"prior": "uniform", "simulator": walkers, "planner": None}),
    ]
    function, arguments = rng.choice(pool)
    name, odd = rng.choice(list(arguments)), rng.choice(ODD)
    what = f"{function.__name__}({name}: {type(odd).__name__})"
    return what, lambda: function(**{**arguments, name: odd}) and None


def command(rng: random.Random, folder: Path) -> tuple[str, Callable[[], Any]]:
    event, post = str(folder / "event.json"), str(folder / "posterior.nc")
    goals = ["--goal", "red agent=red agent to red lm", "--goal", "green agent=get to red agent"]
    tiny = ["--workers", "1", "--quiet", "--chains", "2"]
    lines = [
        ["infer", event, "--kernel", "prior_mh", "--iterations", "1", "--prior", "uniform", *tiny],
        ["infer", event, "--kernel", "prior_mh", "--budget", "4", "--option", "x=1", *tiny],
        ["simulate", event, *goals, "--frames", "3", "--out", str(folder / "made.json")],
        ["resume", str(folder / "run.ckpt"), "--iterations", "2", "--out", str(folder / "no")],
        ["compare", event, "--kernels", "prior_mh", "--budget", "4", "--repeats", "1", *tiny],
        ["query", post, "P(relation=friendly)", "--weights", "count"],
        ["query", post, "E[strength_red | strength_red > 200]", "top 3 goal_red", "--json"],
        ["evaluate", event, "--model", "majority", "--limit", "1", "--seed", "0"],
        ["generate", "--n", "1000000000", "--seed", "0", "--out", str(folder / "set")],
        ["export", event, "--out", str(folder / "exported.json")],
        ["render", event, "--out", str(folder / "picture.png")],
        ["report", str(folder)],
        ["describe", event],
    ]
    line = list(rng.choice(lines))
    place = rng.randrange(len(line))
    if rng.random() < 0.2:
        del line[place]
    else:
        line[place] = rng.choice(ODD_WORDS)

    def attempt() -> str:
        output, errors = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            try:
                code: Any = terminal(line)
            except SystemExit as stop:
                code = stop.code
        if "Traceback" in errors.getvalue() or code not in (0, 1, 2):
            raise RuntimeError(f"exit code {code}: {errors.getvalue()[-300:]}")
        said = bool(errors.getvalue().strip())
        return "" if code == 0 else "refused" if said else "no word why"

    return " ".join(word[:30] for word in line), attempt


ATTACKS = {"commands": command, "calls": call, "flips": flip, "hostile": hostile}


def serve(folder: Path, kinds: list[str], seed: int, first: int, last: int) -> None:
    """Try inputs, a line before and after each; a simulator of ours would take too long."""
    ppl.Model.build_simulator = lambda self: self.simulator or walkers  # type: ignore[method-assign]
    lines = sys.stdout
    for number in range(first, last):
        rng = random.Random(f"{seed} {number}")
        kind = kinds[number % len(kinds)]
        what, attempt = ATTACKS[kind](rng, folder)
        print(json.dumps([number, kind, what, "begun"]), file=lines, flush=True)
        faulthandler.dump_traceback_later(SECONDS, exit=True)
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                outcome = attempt() or "accepted"
        except PhasePPLError as error:
            outcome = "refused" if "\n" not in str(error) else f"refused in lines: {error}"
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(place.filename).name}, line {place.lineno}"
            outcome = f"traceback: {type(error).__name__}: {str(error)[:200]} ({where})"
        print(json.dumps([number, kind, what, outcome]), file=lines, flush=True)


def watched(folder: Path, kinds: list[str], seed: int, n: int) -> list[list[Any]]:
    """Return number, kind, what and outcome of n inputs."""
    found: list[list[Any]] = []
    while len(found) < n:
        command = [sys.executable, FILE, "--serve", str(folder), str(len(found)), "--only", *kinds]
        command += ["--seed", str(seed), "--inputs", str(n)]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        found += [line for line in lines if line[3] != "begun"]
        if len(found) < n:
            found.append([*lines[-1][:3], f"endless, or a crash: exit code {done.returncode}"])
    return found


# --- kills ---------------------------------------------------------------------------------------


def slowly(scene: Any, hypothesis: Any, rng: Any) -> Any:
    time.sleep(0.02)
    yield from walkers(scene, hypothesis, rng)


def predict(scene: Any, observation: Any, seed: int) -> dict[str, Any]:
    time.sleep(0.1)
    return {"goal_red": ppl.GOALS[int(seed) % 3], "goal_green": ppl.GOALS[-1]}


def work(name: str, folder: Path) -> Any:
    """Do, or go on with, some work, and return what must be the same whatever happened before."""
    model, run = ppl.Model(simulator=slowly), {**RUN, **QUIET}
    if name == "infer":
        kept = folder / "run.ckpt"
        if kept.exists():
            post = ppl.resume(kept, model=model, workers=1, **QUIET)
        else:
            post = ppl.infer(EVENT, model, iterations=8, checkpoint=kept, **run)
        return {n: v.values.tolist() for n, v in post.tree["posterior"].dataset.variables.items()}
    if name == "evaluate":
        events = [walking_event(n) for n in range(8, 18)]
        events = [dataclasses.replace(e, id=str(n)) for n, e in enumerate(events)]
        done = ppl.evaluate(events, predict, out=folder / "e", resume=True, workers=1, **QUIET)
        return {n: dict(p.answers) for n, p in done.predictions.items()}
    if name == "generate":
        planner = PlannerConfig(particles=5, simulations=2, rollout_length=1)
        cells = {"chasing": 3, "independent:LMA+LMA": 1}
        options = {"planner": planner, "frames": 34, "workers": 1, "max_tries": 3, **QUIET}
        return ppl.generate(folder / "set", cells=cells, resume=True, **options).entries
    options = {"chains": 4, "repeats": 3, "reference": "none", "workers": 1, **QUIET}
    options |= {"budget": ppl.simulations(16), "checkpoint": folder / "kept.json"}
    found = ppl.compare(EVENT, model, kernels=["prior_mh"], **options)
    return found.runs[["kernel", "seed", "p_goals", "moves", "simulations"]].to_dict("list")


def killed(n: int, seed: int) -> list[list[Any]]:
    """Return number, kind, what and outcome of n kills."""
    rng, found, whole = random.Random(seed), [], {}
    for number in range(n):
        name = ("infer", "evaluate", "generate", "compare")[number % 4]
        if name not in whole:
            with tempfile.TemporaryDirectory() as folder:
                began = time.monotonic()
                whole[name] = *worked(name, folder), time.monotonic() - began
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, FILE, "--work", name, folder]
            with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
                time.sleep(whole[name][2] * rng.uniform(0.3, 1.0))
                process.kill()
            code, output = worked(name, folder)
        outcome = "the same" if output == whole[name][1] else "silent difference"
        found.append([number, "kills", name, f"traceback: {output[-300:]}" if code else outcome])
    return found


def worked(name: str, folder: str) -> tuple[int, str]:
    """Return the exit code of a process that does some work, and what it says."""
    command = [sys.executable, FILE, "--work", name, folder]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=KILL_SECONDS)
    except subprocess.TimeoutExpired:
        return 1, "endless"
    return done.returncode, done.stderr if done.returncode else done.stdout


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--inputs", type=int, default=200)
    parser.add_argument("--kills", type=int, default=8)
    parser.add_argument("--only", nargs="+", choices=KINDS, default=list(KINDS), metavar="KIND")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--serve", nargs=2, metavar="X", help=argparse.SUPPRESS)
    parser.add_argument("--work", nargs=2, metavar="X", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        print(json.dumps(plain(work(options.work[0], Path(options.work[1])))))
        return
    kinds = [kind for kind in options.only if kind in ATTACKS]
    if options.serve:
        folder, first = options.serve
        serve(Path(folder), kinds, options.seed, int(first), options.inputs)
        return
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        prepare(Path(folder))
        found = watched(Path(folder), kinds, options.seed, options.inputs) if kinds else []
    if "kills" in options.only:
        found += killed(options.kills, options.seed)
    good = ("refused", "accepted", "the same")
    bad = [one for one in found if one[3] not in good]
    counts = collections.Counter((one[1], one[3].partition(":")[0]) for one in found)
    for (kind, outcome), n in sorted(counts.items()):
        print(f"{kind:<10}{n:>6}  {outcome}")
    for one in bad:
        print(*one)
    report = {"counts": {" ".join(key): n for key, n in counts.items()}, "bad": bad}
    common.write(report, options.json)
    if bad:
        sys.exit(1)


if __name__ == "__main__":
    main()
