"""Another prior in ten lines: agents that are related more often than not, and how much it matters.

    python examples/alternative_prior.py [--quick]

Prints the goals and the relation of a bundled event under the paper's prior, under a ready-made one
and under one's own, which has a site of its own, `friendliness`. --quick simulates next to nothing.
"""

from __future__ import annotations

import argparse

import jax.numpy as jnp
import numpyro
import numpyro.distributions as dist

import phase_ppl as ppl


def mostly_related() -> None:
    """Three in four pairs have a social goal; how many of those are helpers is learnt."""
    friendliness = numpyro.sample("friendliness", dist.Beta(2.0, 2.0))
    helping, hindering = 0.75 * friendliness / 2, 0.75 * (1 - friendliness) / 2
    numpyro.sample(
        "alpha",  # neither, red helps, green helps, red hinders, green hinders
        dist.Categorical(probs=jnp.stack([0.25, helping, helping, hindering, hindering])),
    )
    ppl.sites.goals()  # the defaults for the rest
    ppl.sites.strengths()


def main(quick: bool) -> None:
    event = ppl.load_event("collaborate")
    size = {"kernel": "prior_mh", "chains": 2, "iterations": 1, "workers": 1} if quick else {}
    print(f"Ready-made priors: {', '.join(ppl.priors.available())}\n")
    for prior in ("uniform", "sparse_social", mostly_related):
        post = ppl.infer(event, ppl.Model(prior=prior), seed=0, **size)
        print(prior if isinstance(prior, str) else prior.__name__)
        for name in ("goal_red", "goal_green", "relation"):
            label, probability = post.top(name, 1)[0]
            print(f"  {name:<12}{label:<34}{probability:.2f}")
    print(f"  friendliness {post.mean('friendliness'):.2f} on average")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="seconds instead of minutes")
    main(**vars(options.parse_args()))
