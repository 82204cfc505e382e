"""A kernel of one's own in forty lines: an independence sampler that looks at the whole video.

    python examples/own_kernel.py [--quick]

It proposes hypotheses from what the whole observation shows, and accepts by P L / Q: exact, since
proposals do not depend on where the chain is. Prints what it makes of a bundled event, beside
SIMPLE. --quick makes fewer simulations.

A package offers such a kernel to everybody who installs it by an entry point in its pyproject.toml,

    [project.entry-points."phase_ppl.kernels"]
    whole_video = "my_package.whole_video:whole_video"

after which `phase-ppl infer collaborate --kernel whole_video` knows it.
"""

from __future__ import annotations

import argparse
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import random
from numpyro.infer.mcmc import MCMCKernel
from own_simulator import glide

import phase_ppl as ppl
from phase_ppl.inference.proposals.tables import window_count
from phase_ppl.models.density import draw, log_density


class State(NamedTuple):
    z: dict[str, jax.Array]  # the hypothesis
    sim_seed: jax.Array  # with which it was simulated
    log_weight_of_z: jax.Array  # log P L / Q
    accepted: jax.Array
    rng_key: jax.Array


class WholeVideo(MCMCKernel):
    sample_field = "z"

    def __init__(self, program: Any, guide: Any, settings: Any) -> None:
        self.program, self.guide = program, guide
        self.whole = window_count(program.n_frames, settings.window)  # the index after the last

    def init(self, rng_key: jax.Array, *_: Any) -> State:
        return jax.vmap(self.propose)(rng_key)  # all chains at once: one batch of simulations

    def sample(self, state: State, *_: Any) -> State:
        return jax.vmap(self.step)(state)

    def propose(self, key: jax.Array) -> State:
        key, key_z, key_seed = random.split(key, 3)
        z = draw(self.guide, key_z, self.whole)
        log_prior = self.program.log_prior(z)
        seed = self.program.simulator_seed(key_seed, z)
        errors = self.program.simulate(z, log_prior, seed)
        log_joint = log_prior + self.program.log_likelihood(errors).sum()
        log_weight = log_joint - log_density(self.guide, z, self.whole)
        return State(z, seed, log_weight, jnp.array(True), key)

    def step(self, state: State) -> State:
        key, key_accept = random.split(state.rng_key)
        new = self.propose(key)
        accepted = -random.exponential(key_accept) < new.log_weight_of_z - state.log_weight_of_z
        kept = jax.tree.map(lambda a, b: jnp.where(accepted, a, b), new[:3], state[:3])
        return State(*kept, accepted, new.rng_key)


@ppl.register_kernel("whole_video", validity="exact", needs=("guide", "settings"))
def whole_video(program: Any, *, guide: Any, settings: Any) -> WholeVideo:
    """Independence sampler with proposals from the whole video."""
    return WholeVideo(program, guide, settings)


def main(quick: bool) -> None:
    event = ppl.load_event("independent")
    budget = ppl.simulations(60 if quick else 1500)
    model = ppl.Model(simulator=glide)  # of own_simulator.py: it takes milliseconds
    for kernel in ("local_mh", "whole_video"):
        print(ppl.infer(event, model, kernel=kernel, budget=budget, seed=0, workers=1), "\n")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="fewer simulations")
    main(**vars(options.parse_args()))
