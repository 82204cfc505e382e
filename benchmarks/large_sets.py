"""How much memory do generated sets take, by how many events they have?

Each size in a process of its own: a set is made, opened, and all its events are gone through.
Nothing is simulated: every slot gets a bundled event, under its own name.

    python benchmarks/large_sets.py --sizes 100,500,2000 --json large_sets.json
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import loky

import phase_ppl as ppl
from phase_ppl.dataset.generation import generate as module
from phase_ppl.dataset.generation.making import Made
from phase_ppl.dataset.generation.plan import Plan, Slot

EVENT = "collaborate"


def stand_in(plan: Plan, slot: Slot) -> Made:
    """Return a bundled event as what became of a slot."""
    event = dataclasses.replace(ppl.load_event(EVENT), id=slot.name)
    facts = {"frames": event.observation.n_frames, "moved": [0.0] * 4}
    entry = {"id": slot.name, "group": slot.name, "split": slot.split, "measures": facts}
    return Made(slot, [event], [entry], [])


def megabytes() -> float:
    """Return the most memory that this process had until now, by Linux."""
    status = Path("/proc/self/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) * 1024 / 1e6


def made(n: int, folder: Path) -> dict[str, Any]:
    """Make a set; return what that took."""
    module.make = stand_in
    stand_in(Plan(cells={"chasing": 1}), Slot(0, "chasing", "train"))
    before, clock = megabytes(), time.perf_counter()
    ppl.generate(folder, cells={"chasing": n}, workers=1, progress=False)
    return {"made_mb": megabytes() - before, "made_s": time.perf_counter() - clock}


def opened(n: int, folder: Path) -> dict[str, Any]:
    """Open a set and go through it; return what that took."""
    ppl.load_event(EVENT)
    before, clock = megabytes(), time.perf_counter()
    events = ppl.GeneratedEvents(folder)
    found = {"opened_mb": megabytes() - before, "opened_s": time.perf_counter() - clock}
    assert sum(1 for _ in events) == sum(1 for _ in events.entries) == n
    return {**found, "read_mb": megabytes() - before}


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sizes", default="100,500,2000", help="numbers of events")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rows = []
    print(f"{'events':>7}{'made':>10}{'':>9}{'opened':>10}{'':>9}{'read':>10}")
    for n in map(int, options.sizes.split(",")):
        row: dict[str, Any] = {"events": n}
        with tempfile.TemporaryDirectory() as scratch:
            for step in (made, opened):
                with loky.ProcessPoolExecutor(1) as alone:
                    row |= alone.submit(step, n, Path(scratch) / "set").result()
        rows.append(row)
        print(
            f"{n:>7}{row['made_mb']:>7.0f} MB{row['made_s']:>7.1f} s{row['opened_mb']:>7.0f} MB"
            f"{row['opened_s']:>7.2f} s{row['read_mb']:>7.0f} MB",
            flush=True,
        )
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
