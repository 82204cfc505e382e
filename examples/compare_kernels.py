"""Kernels on equal budgets: which comes nearest to the posterior by enumeration?

python examples/compare_kernels.py

With the package's own simulator, leave the model out; it then takes minutes.
"""

from __future__ import annotations

from glide import MODEL, seen

import phase_ppl as ppl


def main() -> None:
    event = seen(ppl.Hypothesis("Get blue item to blue lm", "Get green agent to red lm"))
    found = ppl.compare(
        event,
        MODEL,
        kernels=["local_mh", "prior_mh"],
        budget=ppl.simulations(600),
        repeats=2,
        reference="enumeration",
        workers=1,
        seed=0,
    )
    print(found)
    ppl.plot.comparison(found).savefig("comparison.png")


if __name__ == "__main__":
    main()
