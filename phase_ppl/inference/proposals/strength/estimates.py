"""What an estimator of strengths is, and how good its estimates are."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

_GRID = np.linspace(*STRENGTH_RANGE, 901)


class StrengthEstimates(NamedTuple):
    """Normal distributions of the agents' strengths, to be cut to the range of strengths.

    Attributes:
        mean: (window, agent) newtons; NaN where there is no estimate, which means the prior.
        sd: (window, agent) newtons; NaN where ``mean`` is.
    """

    mean: FloatArray
    sd: FloatArray


class Estimator(Protocol):
    """Estimates both agents' strengths from windows of what was observed.

    ``windows`` is (window, 2), the first and the last frame of each; they differ by 1 or more.
    """

    def __call__(
        self, scene: Scene, observation: Observation, windows: NDArray[np.int64], /
    ) -> StrengthEstimates: ...


class Quality(NamedTuple):
    """How good estimates are, as proposals from normal distributions cut to the range.

    Attributes:
        share: of estimates among all.
        rmse: of the proposals' mean, newtons; of the prior's mean where there is no estimate.
        log_density: mean log density of the true strength; without an estimate that of the
            uniform prior, -6.11.
        log_mixture: the same, of a mixture with a tenth of the prior, as in SIMPLE's proposal.
        coverage: share of the estimates that are no farther off than their standard deviation;
            nan without any.
    """

    share: float
    rmse: float
    log_density: float
    log_mixture: float
    coverage: float


def quality(estimates: StrengthEstimates, strength: FloatArray) -> Quality:
    """Return how good estimates are, given the true strengths (of the same shape), newtons."""
    known = ~np.isnan(estimates.mean).ravel()
    mean = np.where(known, estimates.mean.ravel(), 0.0)[:, None]
    sd = np.where(known, estimates.sd.ravel(), math.inf)[:, None]  # cut, that is uniform
    truth = strength.ravel()[:, None]
    density = np.exp(-0.5 * ((_GRID - mean) / sd) ** 2)
    mass = np.trapezoid(density, _GRID, axis=1)
    middle = np.trapezoid(density * _GRID, _GRID, axis=1) / mass
    log_density = -0.5 * ((truth - mean) / sd)[:, 0] ** 2 - np.log(mass)
    log_prior = -math.log(STRENGTH_RANGE[1] - STRENGTH_RANGE[0])
    mixture = np.logaddexp(log_density + math.log(0.9), log_prior + math.log(0.1))
    inside = (np.abs(truth - mean) <= sd)[known]
    return Quality(
        share=float(known.mean()),
        rmse=float(np.sqrt(((middle - truth[:, 0]) ** 2).mean())),
        log_density=float(log_density.mean()),
        log_mixture=float(mixture.mean()),
        coverage=float(inside.mean()) if known.any() else math.nan,
    )
