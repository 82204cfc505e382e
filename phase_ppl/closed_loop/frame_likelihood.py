"""How probable a frame is under hypotheses, from what agents would do and how actions explain it.

Apart from the filter, since a posterior that was kept needs this and nothing that simulates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phase_ppl.world.arrays import FloatArray, IntArray


def log_likelihoods(
    log_density: FloatArray,
    policies: Sequence[FloatArray],
    numbers: Sequence[IntArray],
    n_replicates: int,
) -> tuple[FloatArray, FloatArray]:
    """Return (row,) log likelihoods of a frame by the first set of searches alone.

    And (replicate, row): replicate 0 uses all sets, replicate k leaves out set k; NaN where not all
    have searched. A policy is a mean over the sets.

    Args:
        log_density: (action of the first agent, of the second, ...) of the frame.
        policies: (agent) (policy, set, action) probabilities, NaN where a set has not searched.
        numbers: (agent) (row,) which of its policies an agent has.
        n_replicates: of the second result.
    """
    highest, every = log_density.max(), range(policies[0].shape[1])
    place = np.ravel_multi_index(tuple(numbers), [len(of_agent) for of_agent in policies])

    def by(sets: list[int]) -> FloatArray:
        left = np.exp(log_density - highest)
        for of_agent in policies:  # the first axis goes, and what it becomes is put last
            left = np.tensordot(left, of_agent[:, sets].mean(axis=1), axes=(0, 1))
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(left.ravel())[place] + highest)

    first = by([0])
    if len(every) == 1:
        return first, first[None]
    left_out = (None, *every)[:n_replicates]
    return first, np.array([by([one for one in every if one != other]) for other in left_out])


def shift_of(first: FloatArray, every: FloatArray, log_mass: FloatArray) -> FloatArray:
    """Return (replicate,) by how much all sets move the log likelihoods of the first alone.

    A mean over where all have searched, by log masses (row,) before the frame; 0 where none have.
    """
    sure = ~np.isnan(every[0]) & np.isfinite(log_mass)
    if not sure.any():
        return np.zeros(len(every))
    share = np.exp(log_mass[sure] - log_mass[sure].max())
    return np.asarray((every[:, sure] - first[sure]) @ share / share.sum())
