"""Your own kernel in thirty lines: proposals from the prior, accepted by their likelihood.

python examples/own_kernel.py

The state holds everything about a chain, so a run can be saved and continued.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from glide import MODEL, seen
from jax import random
from numpyro.infer.mcmc import MCMCKernel

import phase_ppl as ppl


class State(NamedTuple):
    z: dict[str, jax.Array]  # the hypothesis
    sim_seed: jax.Array  # the seed of its simulation
    log_likelihood: jax.Array
    accepted: jax.Array
    rng_key: jax.Array


class FromPrior(MCMCKernel):
    sample_field = "z"

    def __init__(self, program: ppl.EventProgram) -> None:
        self.program = program

    def init(self, rng_key: jax.Array, *_: Any) -> State:
        return jax.vmap(self.propose)(rng_key)  # all chains at once: one batch of simulations

    def sample(self, state: State, *_: Any) -> State:
        return jax.vmap(self.step)(state)

    def propose(self, key: jax.Array) -> State:
        key, key_z, key_seed = random.split(key, 3)
        z = self.program.draw_prior(key_z)
        seed = self.program.simulator_seed(key_seed)
        errors = self.program.simulate(z, self.program.log_prior(z), seed)
        return State(z, seed, self.program.log_likelihood(errors).sum(), jnp.array(True), key)

    def step(self, state: State) -> State:
        key, key_accept = random.split(state.rng_key)
        new = self.propose(key)
        accepted = -random.exponential(key_accept) < new.log_likelihood - state.log_likelihood
        kept = jax.tree.map(lambda a, b: jnp.where(accepted, a, b), new[:3], state[:3])
        return State(*kept, accepted, new.rng_key)


@ppl.register_kernel("from_prior", validity="exact", needs=())
def from_prior(program: ppl.EventProgram) -> FromPrior:
    """Independence sampler with proposals from the prior."""
    return FromPrior(program)


if __name__ == "__main__":
    event = seen(ppl.Hypothesis("Get blue item to blue lm", "Get green agent to red lm"))
    for kernel in ("from_prior", "prior_mh"):
        post = ppl.infer(event, MODEL, kernel=kernel, chains=8, iterations=100, seed=0, workers=1)
        print(kernel, *post.top("goal_red", 2), *post.top("goal_green", 2))
