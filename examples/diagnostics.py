"""Can a posterior be trusted? The chains' diagnostics, and ArviZ on the draws.

    python examples/diagnostics.py [--quick]

Prints the verdict with the numbers behind it, then effective sample size and R-hat of the log
joint and of whether a chain holds the leading goal; those of goal codes mean nothing: codes have no
order. Draws diagnostics.png, the log joint of every chain. --quick makes fewer simulations.
"""

from __future__ import annotations

import argparse
import warnings

import xarray as xr
from own_simulator import glide

import phase_ppl as ppl

with warnings.catch_warnings():
    warnings.simplefilter("ignore", FutureWarning)  # ArviZ announces its version 1
    import arviz


def main(quick: bool) -> None:
    event = ppl.load_event("independent")
    budget = ppl.simulations(100 if quick else 3000)
    model = ppl.Model(simulator=glide)
    post = ppl.infer(event, model, kernel="local_mh", budget=budget, seed=0, workers=1)

    found = post.diagnostics()
    print(found["verdict"], "\n")
    for name in ("acceptance_rate", "move_rate", "distinct_goal_pairs", "agreement",
                 "between_chain_tv", "monte_carlo_error", "aborted_mass_bound"):  # fmt: skip
        print(f"{name:<22}{found[name]}")

    draws = post.tree["posterior"].to_dataset()
    leading = {
        name: ppl.GOALS.index(post.top(name, 1)[0][0]) for name in ("goal_red", "goal_green")
    }
    chains = xr.Dataset(
        {
            "log_joint": post.tree["sample_stats"]["log_joint"],
            "strength_red": draws["strength_red"],
            **{f"{name} leads": (draws[name] == code) * 1.0 for name, code in leading.items()},
        }
    )
    print("\nArviZ, over all chains (nan: never, or always)")
    ess, rhat = arviz.ess(chains, method="mean"), arviz.rhat(chains, method="split")
    for name in chains.data_vars:
        print(f"{name:<22}ESS {float(ess[name]):7.1f}   R-hat {float(rhat[name]):.2f}")

    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3), layout="constrained")
    axes = figure.add_subplot(xlabel="draw", ylabel="log joint", title="15 chains")
    axes.plot(chains["log_joint"].values.T, lw=0.8)
    figure.savefig("diagnostics.png", dpi=150)
    print("\nDrawn: diagnostics.png")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="fewer simulations")
    main(**vars(options.parse_args()))
