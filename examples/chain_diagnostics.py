"""Chains that are too short and long enough: what diagnostics say of both.

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
        # moves change a hypothesis; between chains: how far each is from all, in total variation
        for name in ("acceptance_rate", "move_rate", "distinct_goal_pairs", "between_chain_tv"):
            print(f"    {name:<22}{found[name]}")
        print("    red wants", *post.top("goal_red", 2))
    ppl.plot.diagnostics(post).savefig("diagnostics.png")  # stripes, traces, ranks, errors


if __name__ == "__main__":
    main()
