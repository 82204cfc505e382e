"""How much memory do generated sets take? Is a set the same if its maker was killed?

    python benchmarks/large_sets.py [--events 100 500 2000] [--frames 101]
    python benchmarks/large_sets.py --killed [--events 2000]

One process makes a set by a simulator that takes no time, a second opens it, a third goes through
it. Each reports its peak memory beyond the imports.

With ``--killed`` a process with an executor makes a set and evaluates it; it is killed and started
again. The result must have the same bytes as that of an undisturbed process, except for seconds.
Exits with 1 if it has not.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import common
import numpy as np

import phase_ppl as ppl
from phase_ppl.data.generation import making
from phase_ppl.data.generation.families import Drawn
from phase_ppl.data.generation.making import Recording
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.names import AGENTS

STEPS: Final = ("made", "opened", "gone through")
WORK: Final = {"make": "parts", "evaluate": "events"}
"""Work of a process, and the subfolder of its results."""


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--events", type=int, nargs="+", default=[100, 500, 2000])
    parser.add_argument("--frames", type=int, default=101)
    parser.add_argument("--killed", action="store_true")
    parser.add_argument("--step", choices=(*STEPS, *WORK), help="do only this, in the folder --set")
    parser.add_argument("--set", metavar="DIR", type=Path)
    options = parser.parse_args()
    if options.step in WORK:
        work(options.step, options.set, options.events[0], options.frames)
        return
    if options.step is not None:
        print(megabytes(options.step, options.set, options.events[0], options.frames))
        return
    if options.killed:
        sys.exit(killed(options.events[-1], options.frames))
    rows = [measured(n, options.frames) for n in options.events]
    print(f"{'events':>7}{''.join(f'{step:>14}' for step in STEPS)}{'seconds':>10}{'on disk':>10}")
    for row in rows:
        peaks = "".join(f"{row[step]:11.0f} MB" for step in STEPS)
        print(f"{row['events']:7.0f}{peaks}{row['seconds']:10.0f}{row['disk']:7.0f} MB")
    common.write({"sets": rows}, options.json)


def measured(n: int, frames: int) -> dict[str, float]:
    """Return the memory that each step with ``n`` events takes, MB, and what making them takes."""
    found: dict[str, float] = {"events": n}
    with tempfile.TemporaryDirectory() as folder:
        for step in STEPS:
            clock = time.perf_counter()
            done = subprocess.run(
                [
                    *(sys.executable, __file__, "--step", step, "--set", f"{folder}/set"),
                    *("--events", str(n), "--frames", str(frames)),
                ],
                stdout=subprocess.PIPE,
                text=True,
                check=True,
            )
            found[step] = float(done.stdout)
            found.setdefault("seconds", time.perf_counter() - clock)
        files = [file for file in Path(folder).rglob("*") if file.is_file()]
        found["disk"] = sum(file.stat().st_size for file in files) / 1e6
    return found


def megabytes(step: str, folder: Path, n: int, frames: int) -> float:
    """Return the memory that a step takes in this process, MB."""
    for name in ("generate", "load_events"):  # with all that they import
        getattr(ppl, name)
    before = most()
    if step == "made":
        making.record = instant
        making.reason_against = lambda *_: None
        ppl.generate(folder, n, frames=frames, workers=1)
    else:
        events = ppl.load_events(folder)
        assert len(events) == n
        for event in events if step == "gone through" else [events[n // 2]]:
            assert event.observation.n_frames
    return most() - before


def most() -> float:
    """Return the most memory that this process ever had, MB; as Linux tells it."""
    # getrusage would begin with the peak of the parent process
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6


def work(what: str, folder: Path, n: int, frames: int) -> None:
    """Make a set in this process, or evaluate the one beside it; go on with what is there."""
    making.record = instant
    making.reason_against = lambda *_: None
    options: dict[str, Any] = {"progress": False, "resume": True}
    with ThreadPoolExecutor(1) as executor:
        if what == "make":
            ppl.generate(folder, n, frames=frames, executor=executor, **options)
        else:
            ppl.evaluate(
                str(folder.parent / "make"), "predicate", out=folder, executor=executor, **options
            )


def killed(n: int, frames: int) -> bool:
    """Return whether anything differs from what one process makes and evaluates."""
    differs = False
    with tempfile.TemporaryDirectory() as root:
        for what, finished in WORK.items():

            def start(name: str, what: str = what) -> subprocess.Popen[bytes]:
                command = (sys.executable, __file__, "--step", what, "--set", f"{root}/{name}")
                return subprocess.Popen([*command, "--events", str(n), "--frames", str(frames)])

            undisturbed, other = start(what), start("other")
            while other.poll() is None and len(entries(Path(root, "other", finished))) < n // 4:
                time.sleep(0.1)
            other.kill()
            other.wait()
            print(f"{what}: killed with {len(entries(Path(root, 'other', finished)))} finished")
            if any(process.wait() for process in (undisturbed, start("other"))):
                return True
            ours, theirs = (contents(Path(root, name)) for name in ("other", what))
            apart = [name for name in ours | theirs if ours.get(name) != theirs.get(name)]
            print(f"{what}: {len(theirs)} files of {n} events, {len(apart)} differ {apart[:3]}")
            differs |= bool(apart)
            shutil.rmtree(Path(root, "other"))
    return differs


def entries(folder: Path) -> list[str]:
    return os.listdir(folder) if folder.is_dir() else []


def contents(folder: Path) -> dict[str, Any]:
    """Return the contents of files, without the seconds that the work took."""
    found: dict[str, Any] = {}
    for file in folder.rglob("*"):
        if file.name in ("prediction.json", "metrics.json"):
            found[str(file)] = json.loads(file.read_text())
            del found[str(file)]["cost"]
        elif file.is_file() and file.name != "cost.json":
            found[str(file)] = file.read_bytes()
    return {str(Path(name).relative_to(folder)): value for name, value in found.items()}


def instant(
    situation: Drawn, simulator: JointSimulator, frames: int, rng: np.random.Generator
) -> Recording:
    """Return a recording in which everything makes for one place."""
    start = situation.scene.start
    there = np.append(np.reshape(situation.scene.arena, (2, 2)).mean(axis=1), rng.uniform(0, np.pi))
    gone = np.linspace(0, 0.5, frames)[:, None, None]
    nothing = np.zeros((frames, len(AGENTS)), bool)
    track = start + gone * (there - start)
    hypothesis = situation.roles
    return Recording(situation.scene, hypothesis, situation.layout, track, nothing, nothing)


if __name__ == "__main__":
    main()
