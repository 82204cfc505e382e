"""The model of a video as a plain NumPyro program, sampled by NumPyro's own MCMC.

    python examples/numpyro_native.py

It traces the program, conditions it, runs SIMPLE's kernel in vectorised chains, and asks the
posterior a question. The video is short, so this takes some seconds.
"""

import dataclasses

from jax import random
from numpyro import handlers
from numpyro.infer import MCMC

import phase_ppl as ppl

CHAINS, WARMUP, DRAWS = 8, 3, 9


def main() -> None:
    event = ppl.load_event("collaborate")
    short = ppl.Observation(event.observation.trajectory[:8])
    event = dataclasses.replace(event, observation=short)
    with ppl.program(event, workers=1) as program:  # its workers stop with the block
        # One run of the program: a seed, a hypothesis from the prior, the simulation, its fit.
        trace = handlers.trace(handlers.seed(program, random.key(0))).get_trace()
        for name, site in trace.items():
            print(f"{name:15} {site['type']:14} {type(site.get('fn')).__name__}")

        # What if red were strong? NumPyro's handlers work on this program as on any other.
        strong = handlers.condition(program, {"strength_red": 600.0})
        for label, model in (("as drawn", program), ("strong red", strong)):
            again = handlers.trace(handlers.seed(model, random.key(0))).get_trace()
            print(f"{label}: off by {again['step_error']['value'].mean():.2f} units a frame")

        # NumPyro runs SIMPLE's kernel. One step of all chains is one batch of simulations.
        mcmc = MCMC(
            ppl.kernels.LocalMH(program),
            num_warmup=WARMUP,
            num_samples=DRAWS,
            num_chains=CHAINS,
            chain_method="vectorized",
        )
        mcmc.run(random.key(1), extra_fields=("window",))
        accepted = mcmc.get_extra_fields()["accepted"].mean()
        n = len(program.records)
        print(f"{CHAINS} chains x {WARMUP + DRAWS} steps: {n} simulations, {accepted:.0%} accepted")

    # A posterior from the draws. Nothing is simulated again.
    post = ppl.Posterior.from_numpyro(mcmc)
    print(post.marginal("relation").to_series().round(2).to_string())
    print("P(the agents want the same) =", post.query("P(relation=friendly)"))


if __name__ == "__main__":
    main()
