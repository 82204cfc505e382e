"""The prior of what is simulated: effective goals, with what does not matter summed out.

A helper or hinderer acts on the other's goal, so its own stated goal changes nothing. The prior
of an effective pair is the sum over all stated goals and alphas that lead to it.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from numpyro.infer.util import log_density

from phase_ppl.world.goals import N_GOALS, effective_goals
from phase_ppl.world.hypothesis import ALPHAS

FloatArray = NDArray[np.float64]

_CHUNK = 4096


@functools.cache
def stated_hypotheses() -> dict[tuple[int, int], NDArray[np.int64]]:
    """Return, per effective pair of goals, the (n, 3) stated goals and alphas that lead to it."""
    found: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    for red, green in itertools.product(range(N_GOALS), repeat=2):
        for index, alpha in enumerate(ALPHAS):
            pair = effective_goals(red, green, alpha)
            found.setdefault(pair, []).append((red, green, index))
    return {pair: np.array(rows) for pair, rows in found.items()}


def log_prior_of_effective(
    prior: Callable[..., object],
    goals: NDArray[np.int64],
    others: Mapping[str, NDArray[np.float64]],
) -> FloatArray:
    """Return the log prior of effective hypotheses.

    Args:
        prior: NumPyro program over the hypothesis sites.
        goals: (n, 2) effective goals of red and green.
        others: the remaining sites (strengths, and a user's own), each (n, ...).

    Returns:
        (n,) log of the summed density.
    """
    if len(goals) == 0:
        return np.empty(0)
    stated = [stated_hypotheses()[int(red), int(green)] for red, green in goals]
    row = np.repeat(np.arange(len(goals)), [len(s) for s in stated])
    sites = np.concatenate(stated)
    latent = {
        "goal_red": sites[:, 0],
        "goal_green": sites[:, 1],
        "alpha": sites[:, 2],
        **{name: np.asarray(values)[row] for name, values in others.items()},
    }
    density = jax.jit(jax.vmap(lambda z: log_density(prior, (), {}, z)[0]))
    n = len(row)
    parts = []
    for start in range(0, n, _CHUNK):
        # one shape, so that it compiles once
        chosen = np.minimum(np.arange(start, start + _CHUNK), n - 1)
        parts.append(np.asarray(density({k: jnp.asarray(v[chosen]) for k, v in latent.items()})))
    log_densities = np.concatenate(parts)[:n].astype(float)
    total = np.full(len(goals), -np.inf)
    np.logaddexp.at(total, row, log_densities)
    return total
