"""What diagnostics say of chains that are too short, and of longer ones.

python examples/chain_diagnostics.py
"""

from __future__ import annotations

from glide import MODEL, seen

import phase_ppl as ppl


def main() -> None:
    event = seen(ppl.Hypothesis("Get blue item to blue lm", "Get green agent to red lm"))
    for iterations in (4, 200):
        post = ppl.infer(
            event, MODEL, kernel="prior_mh", chains=8, iterations=iterations, seed=0, workers=1
        )
        found = post.diagnostics()
        print(f"\n{iterations} iterations of 8 particles: {found['answer']}")
        for one in found["checks"]:
            print(f"    {one['state']:<8}{one['name']:<22}{one['value']} ({one['limit']})")
        # move_rate: share of iterations in which a particle's pair of goals changed
        # between_chain_tv: mean and max over pairs of particles of the total variation
        for name in ("acceptance_rate", "move_rate", "distinct_goal_pairs", "between_chain_tv"):
            print(f"    {name:<22}{found[name]}")
        print("    red wants", *post.top("goal_red", 2))
    ppl.plot.diagnostics(post).savefig("diagnostics.png")  # stripes, traces, ranks, errors


if __name__ == "__main__":
    main()
