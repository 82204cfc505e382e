"""Is a large set the same if its maker was killed?

    python benchmarks/large_sets.py [--events 2000] [--frames 101]

A process with an executor makes a set, by a simulator that takes no time, and evaluates it. It is
killed and started again. The result must have the same bytes as that of an undisturbed process,
except for seconds. Exits with 1 if it has not.
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

WORK: Final = {"make": "parts", "evaluate": "events"}
"""Work of a process, and the subfolder of its results."""


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--events", type=int, default=2000)
    parser.add_argument("--frames", type=int, default=101)
    parser.add_argument("--step", choices=WORK, help="do only this, in the folder --set")
    parser.add_argument("--set", metavar="DIR", type=Path)
    options = parser.parse_args()
    if options.step is not None:
        work(options.step, options.set, options.events, options.frames)
        return
    differs = killed(options.events, options.frames)
    common.write({"events": options.events, "differs": differs}, options.json)
    if differs:
        sys.exit(1)


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
        elif file.is_file():
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
    return Recording(situation.scene, hypothesis, situation.layout, track, nothing)


if __name__ == "__main__":
    main()
