"""What the closed loop could have read of four frames, made up, and draws from it."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist

import phase_ppl as ppl
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.world.goals import N_GOALS
from tests.analysis.readings import reading
from tests.inference.toy import GREEN_GOALS, RED_GOALS, few_goals

NAMES = ("goal_red", "goal_green", "relation")


def skewed() -> None:
    """Other masses than those of ``few_goals``, on the same goals."""
    for name, codes in (("goal_red", RED_GOALS), ("goal_green", GREEN_GOALS)):
        mass = jnp.zeros(N_GOALS).at[jnp.array(codes)].set(1 / len(codes))
        numpyro.sample(name, dist.Categorical(probs=mass))
    ppl.sites.alpha()
    ppl.sites.strengths()


def made_up(seed: int = 0, sets: int = 3, noise: float = 0.2) -> ClosedLoopPosterior:
    """What each of so many sets of searches says of three frames, and their mean.

    What the frames say is the same for every seed, but for noise of each set, in nats.
    """
    truth, rng = np.zeros((4, N_GOALS, N_GOALS)), np.random.default_rng(seed)
    truth[1:] = np.random.default_rng(3).normal(0, 1.2, (3, N_GOALS, N_GOALS))
    found = truth + noise * rng.normal(0, 1, (sets, *truth.shape))
    found[:, 0] = 0
    left_out = [np.delete(found, one, axis=0).mean(axis=0) for one in range(sets) if sets > 1]
    without = np.array(left_out, np.float32).reshape(-1, *truth.shape)
    columns = {"log_likelihood": found.mean(axis=0), "log_likelihood_without": without}
    return ClosedLoopPosterior(reading(sets, columns=columns)).with_prior(few_goals)


EXACT = made_up()
OPTIONS: dict[str, Any] = {"kernel": "prior_mh", "chains": 60, "seed": 1, "progress": False}


def sampled(read: Any = EXACT, *given: Any, **options: Any) -> ppl.Posterior:
    return ppl.infer(read, *given, **{**OPTIONS, "iterations": 400, **options})
