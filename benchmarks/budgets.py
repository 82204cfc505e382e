"""Equal budgets on a small world: what each kernel was given, and what it really spent.

    python benchmarks/budgets.py [--only KERNEL ...] [--unit simulations|frames] [--budget N]
        [--chains M] [--json FILE]

The world is that of the tests: eighteen hypotheses and a simulator that takes microseconds. Of the
36 goals of an agent only a few have prior mass, so that a kernel that tries all goals in a step
simulates far fewer than it could have to.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from common import write

sys.path.insert(0, str(Path(__file__).parents[1]))  # the small world is the tests'

import phase_ppl as ppl
from tests.inference.toy import few_goals, walkers, walking_event

FRAMES = 14


def main() -> None:
    names = ppl.available_kernels()
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="KERNEL")
    parser.add_argument("--unit", choices=("simulations", "frames"), default="simulations")
    parser.add_argument("--budget", type=int, metavar="N", help="default 1500, or 15000 frames")
    parser.add_argument("--chains", type=int, default=16, metavar="M")
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    n = options.budget or {"simulations": 1500, "frames": 15_000}[options.unit]
    report: dict[str, Any] = {"unit": options.unit, "budget": n, "kernels": {}}
    print(f"{n} {options.unit} each, {options.chains} chains, events of {FRAMES} frames")
    print(f"{'kernel':20}{'iterations':>12}{'simulations':>13}{'frames':>10}{'frames each':>13}")
    for name in options.only:
        result = spent(name, getattr(ppl, options.unit)(n), options.chains)
        report["kernels"][name] = result
        if "refused" in result:
            print(f"{name:20}  {result['refused']}", flush=True)
            continue
        each = result["frames"] / result["simulations"]
        print(
            f"{name:20}{result['iterations']:12}{result['simulations']:13}{result['frames']:10}"
            f"{each:13.1f}",
            flush=True,
        )
    write(report, options.json)


def spent(name: str, budget: Any, chains: int) -> dict[str, Any]:
    """Return iterations, simulations and frames of a run of a kernel under a budget."""
    try:
        post = ppl.infer(
            walking_event(FRAMES),
            ppl.Model(prior=few_goals, simulator=walkers),
            kernel=name,
            chains=chains,
            budget=budget,
            workers=1,
            progress=False,
        )
    except ppl.errors.InvalidSettingError as error:
        return {"refused": str(error)}
    assert isinstance(post, ppl.Posterior), "a kernel is named"
    cost = {name: post.cost[name] for name in ("simulations", "frames")}
    return {"iterations": post.settings["iterations"], **cost}


if __name__ == "__main__":
    main()
