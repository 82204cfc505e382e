"""One video under several priors: how much of the answer comes from the prior?

python examples/alternative_prior.py

The closed loop reads the video once. Another prior then takes milliseconds.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpyro
import numpyro.distributions as dist

import phase_ppl as ppl


def friendly_world() -> None:
    """A prior in which the share of helpers is unknown, and inferred too."""
    kindness = numpyro.sample("kindness", dist.Beta(4.0, 1.0))
    helps, hinders = 0.3 * kindness, 0.3 * (1 - kindness)
    ways = jnp.stack([0.4, helps, helps, hinders, hinders])  # neither, red or green helps, hinders
    numpyro.sample("alpha", dist.Categorical(probs=ways))
    ppl.sites.goals()
    ppl.sites.strengths()


def main() -> None:
    event = ppl.load_event("collaborate")
    start = ppl.Observation(event.observation.trajectory[:20])  # too short for a sure answer
    event = dataclasses.replace(event, observation=start)
    model = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1))
    post = ppl.infer(event, model)
    print("the paper's prior:", *post.top("relation"))
    print("sparse_social, a ready-made one:", *post.with_prior("sparse_social").top("relation"))
    hoped = post.with_prior(friendly_world)
    print("friendly world:", *hoped.top("relation"))
    print("E[kindness] =", hoped.query("E[kindness]"), "and 0.8 beforehand")


if __name__ == "__main__":
    main()
