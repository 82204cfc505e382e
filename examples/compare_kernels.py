"""Kernels against each other on equal budgets, as a table and a figure.

    python examples/compare_kernels.py [--quick]

SIMPLE with the exact acceptance rule, SIMPLE as printed in the paper, and proposals from the prior,
on a bundled event and the fast simulator of own_simulator.py, which makes enumeration of all goals
affordable as a reference. Prints the table and writes compare_kernels.json and compare_kernels.png.
Run again, it only does what is missing. --quick makes fewer runs of fewer simulations.

With phase_ppl's own simulator (leave `model` out) it takes hours instead of minutes.
"""

from __future__ import annotations

import argparse

from own_simulator import glide

import phase_ppl as ppl

KERNELS = {
    "SIMPLE": "local_mh",
    "SIMPLE as printed": ("local_mh", {"rule": "paper"}),
    "prior": "prior_mh",
}


def main(quick: bool) -> None:
    found = ppl.compare(
        ppl.load_event("independent"),
        ppl.Model(simulator=glide),
        kernels={name: KERNELS[name] for name in ("SIMPLE", "prior")} if quick else KERNELS,
        budget=ppl.simulations(60 if quick else 1000),
        repeats=2 if quick else 8,
        reference=("local_mh", {"budget": ppl.simulations(120)}) if quick else "enumeration",
        workers=1,
        checkpoint="compare_kernels.json",
    )
    print(found)
    ppl.plot.comparison(found, path="compare_kernels.png")
    print("\nWritten: compare_kernels.json, compare_kernels.png")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="fewer simulations")
    main(**vars(options.parse_args()))
