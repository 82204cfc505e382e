"""How fast is the simulator?

    python benchmarks/simulator.py [--json FILE] [--only NAME ...]

Ratios are taken in one run, alternately. On a busy machine, figures in ms and s mean little.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import common
from speed import engines, whole

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.simulator.joint import JointSimulator

DEMANDS = {
    "transition_speedup": (">=", 8.0),
    "decision_speedup": (">=", 10.0),
    "early_stop_same_action": (">=", 1.0),
    "early_stop_saved": (">=", 0.30),
    "outside_search_share": ("<=", 0.15),
    "outside_search_share_fast": ("<=", 0.15),
    "two_worker_speedup": (">=", 1.8),
    "fast_speedup": (">=", 8.0),
    "cpu_ms_per_step_paper": ("<=", 90.0),
    "first_decision_seconds_warm": ("<=", 1.5),
    "new_length_seconds": ("<=", 0.6),
    "rss_growth_mb_per_1000_steps": ("<=", 2.0),
    "oracle_tv_beyond_seeds": ("<=", 0.0),
}


def where_time_goes() -> dict[str, Any]:
    shares = {name: whole.shares(PlannerConfig.named(name)) for name in ("paper", "fast")}
    return {
        "shares": shares,
        "outside_search_share": 1 - shares["paper"]["search"],
        "outside_search_share_fast": 1 - shares["fast"]["search"],
    }


PARTS: dict[str, Callable[[], dict[str, Any]]] = {
    "transitions": engines.transitions,
    "decisions": engines.decisions,
    "early_stop": whole.early_stop,
    "where_time_goes": where_time_goes,
    "presets": whole.presets,
    "two_workers": whole.two_workers,
    "first_decision": whole.first_decision,
    "cold": whole.cold,
    "closed_loop": whole.closed_loop,
    "new_length": whole.new_length,
    "memory": whole.memory,
}


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--only", nargs="+", choices=[*PARTS, "oracle"], metavar="NAME")
    parser.add_argument("--oracle-seeds", type=int, default=200)
    parser.add_argument(
        "--keep", type=Path, metavar="FILE", help="keeps the oracle's draws; a second run continues"
    )
    options = parser.parse_args()
    for planner in ("paper", "fast"):
        JointSimulator(planner).warm_up()
    report: dict[str, Any] = {}
    parts = PARTS | {"oracle": lambda: engines.histograms(options.oracle_seeds, options.keep)}
    for name, measure in parts.items():
        if options.only and name not in options.only:
            continue
        found = measure()
        report |= found
        for key, value in found.items():
            if not isinstance(value, (int, float)):
                continue
            sign, bound = DEMANDS.get(key, ("", None))
            demand = "" if bound is None else f"   demanded {sign} {bound:g}"
            if bound is not None:
                met = value >= bound if sign == ">=" else value <= bound
                demand += "" if met else "   MISSED"
            print(f"{key:34} {value:10.3f}{demand}", flush=True)
    for planner, shares in report.get("shares", {}).items():
        listed = ", ".join(f"{name} {share:.1%}" for name, share in shares.items())
        print(f"where the time goes, {planner} planner: {listed}")
    for scene, found in report.get("oracle_scenes", {}).items():
        listed = ", ".join(f"{name} {value:.3f}" for name, value in found.items())
        print(f"oracle, {scene}: {listed}")
    common.write(report, options.json)


if __name__ == "__main__":
    main()
