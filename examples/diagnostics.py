"""Can a posterior be trusted? The chains' diagnostics, over time, and ArviZ on the draws.

    python examples/diagnostics.py [--quick]

Prints the verdict with some of the numbers behind it, and ArviZ's summary of the draws: R-hat and
effective sample size of the log joint, the strengths, and of whether a chain holds a goal. Draws
diagnostics.png, how the chains went, and over_time.png, what of the video speaks for which goal.
--quick makes fewer simulations.
"""

from __future__ import annotations

import argparse
import warnings

from own_simulator import glide

import phase_ppl as ppl

with warnings.catch_warnings():
    warnings.simplefilter("ignore", FutureWarning)  # ArviZ announces its version 1
    import arviz


def main(quick: bool) -> None:
    event = ppl.load_event("independent")
    budget = ppl.simulations(180 if quick else 3000)
    model = ppl.Model(simulator=glide)
    post = ppl.infer(event, model, kernel="local_mh", budget=budget, seed=0, workers=1)

    found = post.diagnostics()
    print(found["verdict"], "\n")
    for name in ("acceptance_rate", "move_rate", "distinct_goal_pairs", "agreement",
                 "between_chain_tv", "aborted_mass_bound"):  # fmt: skip
        print(f"{name:<22}{found[name]}")
    for goal, entry in found["categories"]["goal_red"].items():
        print(f"{goal:<36}{entry}")

    print("\nArviZ, every draw counting once")
    print(
        arviz.summary(post.arviz, var_names=["log_joint", "strength_red", "goal_red"]).to_string()
    )

    ppl.plot.diagnostics(post, path="diagnostics.png")
    ppl.plot.over_time(post, path="over_time.png")
    print("\nDrawn: diagnostics.png, over_time.png")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="fewer simulations")
    main(**vars(options.parse_args()))
