"""The closed-loop likelihood: every frame given what was OBSERVED before it.

SIMPLE compares the video with one free-running simulation, which drifts away from it in contact
even under the true hypothesis. Here each frame is predicted from the frames before it: what the
agents would do now, by the same planner at what was seen, and where that would put them. There is
no noise of simulations in it but the planner's own, and all pairs of goals are read at once.
"""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from phase_ppl.closed_loop.hidden_state import Tracking
from phase_ppl.world.checks import nonnegative_number, positive_number
from phase_ppl.world.errors import InvalidSettingError, shown

_Array = TypeVar("_Array")


@dataclasses.dataclass(frozen=True)
class StepwiseLikelihood:
    """p(s_1..T | h) = prod_t p(s_t | s_<t, h)^weight, with one step of planner and physics.

    A policy is pi = (1 - lapse) visits^sharpness / Z + lapse / |A|, with the visits of the root
    actions in the planner's search. ``sharpness`` and ``lapse`` are within 0.01 nats a
    frame of the highest likelihood under the true hypotheses of one half of 50 real videos,
    ``weight`` has the highest log score there; on the other half, which was looked at as well,
    they come within 0.02 nats an answer of the best (``benchmarks/stepwise.py fit``).

    Attributes:
        sharpness: exponent of the visits.
        lapse: probability that an agent does anything whatever, in [0, 1].
        weight: what a frame counts. Where the real agents plan otherwise than the model, they do
            so for many frames on end, which are no independent evidence.
        tracking: how hidden velocities, holds and strengths are followed.

    Raises:
        InvalidSettingError: a value that cannot be used.
    """

    sharpness: float = 4.0
    lapse: float = 0.2
    weight: float = 0.15
    tracking: Tracking = dataclasses.field(default_factory=Tracking)

    def __post_init__(self) -> None:
        for name in ("sharpness", "lapse"):
            nonnegative_number(name, getattr(self, name))
        positive_number("weight", self.weight)
        if not 0 < self.lapse <= 1:
            raise InvalidSettingError(
                f"lapse={self.lapse!r}, expected a number in (0, 1], or frames could be impossible"
            )
        if not isinstance(self.tracking, Tracking):
            raise InvalidSettingError(f"tracking={shown(self.tracking)}, expected a Tracking")

    # Kernels that sample see the likelihood as an error per frame: by how much, in nats, another
    # hypothesis explains it better.

    def log_prob(self, errors: _Array) -> _Array:
        """Return the log likelihood of each frame, up to a constant, from its error in nats."""
        result: _Array = -errors  # type: ignore[operator]
        return result

    def max_total_error(self, log_floor: _Array, n_frames: int) -> _Array:
        """Return the summed error at which the log likelihood is ``log_floor``."""
        result: _Array = -log_floor  # type: ignore[operator]
        return result

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain data."""
        return dataclasses.asdict(self)


def prior_table(prior: Any, strengths: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return log prior masses on a grid of strengths, their sum 1.

    Args:
        prior: NumPyro program over the hypothesis sites.
        strengths: (n,) newtons.

    Returns:
        (stated_goal_red, stated_goal_green, alpha, strength_red, strength_green).
    """
    from phase_ppl.models.density import NO_DENSITY
    from phase_ppl.models.effective import log_prior_of_hypotheses
    from phase_ppl.world.goals import N_GOALS
    from phase_ppl.world.hypothesis import ALPHAS

    n = len(strengths)
    shape = (N_GOALS, N_GOALS, len(ALPHAS), n, n)
    codes = np.unravel_index(np.arange(np.prod(shape)), shape)
    densities = log_prior_of_hypotheses(
        prior,
        {
            "goal_red": codes[0],
            "goal_green": codes[1],
            "alpha": codes[2],
            "strength_red": strengths[codes[3]],
            "strength_green": strengths[codes[4]],
        },
    )
    densities[densities <= NO_DENSITY] = -np.inf
    highest = densities.max()
    if not np.isfinite(highest):
        raise InvalidSettingError(
            f"the prior gives no mass to any of the strengths {strengths.tolist()} that the "
            "stepwise likelihood follows: name others, Tracking(strengths=...)"
        )
    total = highest + np.log(np.exp(densities - highest).sum())
    return (densities - total).reshape(shape)
