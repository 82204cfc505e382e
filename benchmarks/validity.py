"""How far from the exact posterior does every kernel end, on a world small enough to enumerate?

    python benchmarks/validity.py [--only KERNEL ...] [--simulations N] [--json FILE]

The world is the tests' toy: eighteen hypotheses with three equally likely simulations each, looked
up in a table. The table has the total variation between the exact posterior and a kernel's draws
after a warm-up of a third. Draws are correlated, so about 0.02 is chance. The rule as the paper
prints it is run too.
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np
from jax import random

from phase_ppl.inference.registry import KernelInfo, available_kernels, kernel_info
from tests.inference.toy import (
    ALPHA_CODES,
    GREEN_GOALS,
    RED_GOALS,
    SETTINGS,
    TableRunner,
    exact_posterior,
    run,
    table_errors,
    table_guide,
    table_program,
    total_variation,
)

CHAINS = 100
POPULATION_STEPS = 9
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "local_mh (paper)": ("local_mh", {"rule": "paper"}),
    "enumerate": ("enumerate", {}),
}


def main() -> None:
    names = sorted({*available_kernels(), *VARIANTS})
    parser = common.parser(__doc__, "json")
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="KERNEL")
    parser.add_argument("--simulations", type=int, default=100_000, help="for each kernel")
    options = parser.parse_args()
    report: dict[str, Any] = {"kernels": {}}
    print(f"{'kernel':20}{'validity':>12}{'simulations':>13}{'total variation':>17}")
    for name in options.only:
        kernel, given = VARIANTS.get(name, (name, {}))
        result = measured(kernel, given, options.simulations)
        report["kernels"][name] = result
        print(
            f"{name:20}{result['validity']:>12}{result['simulations']:13}{result['tv']:17.3f}",
            flush=True,
        )
    common.write(report, options.json)


def measured(name: str, options: dict[str, Any], simulations: int) -> dict[str, Any]:
    """Return validity, total variation and simulations of a kernel on the small world."""
    info = kernel_info(name)
    errors = table_errors()
    program, bridge = table_program(TableRunner(errors))
    supplies = {"guide": table_guide(), "settings": SETTINGS}
    needed = {need: supplies[need] for need in info.needs}
    kernel: Any = info.make(program, **needed, **options)
    chains, steps = size(kernel, info, simulations)
    states = run(kernel, steps, random.split(random.key(1), chains))
    z = {site: np.asarray(values) for site, values in states.z.items()}
    first = {"last": steps - 1, "start": 0, "all": steps // 3}[info.keeps]
    weight = np.asarray(states.log_weight)[first:] if info.weighted else np.zeros(1)
    weight = np.broadcast_to(np.exp(weight - weight.max()), z["alpha"][first:].shape)
    share = np.zeros((len(RED_GOALS), len(GREEN_GOALS), len(ALPHA_CODES)))
    axes = (("goal_red", RED_GOALS), ("goal_green", GREEN_GOALS), ("alpha", ALPHA_CODES))
    where = tuple(np.searchsorted(codes, z[site][first:]) for site, codes in axes)
    np.add.at(share, where, weight)
    return {
        "validity": getattr(kernel, "validity", info.validity),
        "tv": total_variation(share / share.sum(), exact_posterior(errors)),
        "simulations": len(bridge.records),
    }


def size(kernel: Any, info: KernelInfo, simulations: int) -> tuple[int, int]:
    """Return the chains and steps that take about so many simulations."""
    if hasattr(kernel, "n_iterations"):
        return CHAINS, kernel.n_iterations(CHAINS)
    if info.keeps == "last":
        return simulations // (POPULATION_STEPS + 1), POPULATION_STEPS
    per_step = getattr(kernel, "sims_per_step", info.sims_per_step)
    left = simulations - CHAINS * getattr(kernel, "sims_at_start", 1)
    return CHAINS, max(3, left // (CHAINS * per_step))


if __name__ == "__main__":
    main()
