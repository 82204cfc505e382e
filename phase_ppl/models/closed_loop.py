"""The closed-loop likelihood: every frame given what was OBSERVED before it.

SIMPLE compares the video with one free-running simulation, which drifts away from it in contact
even under the true hypothesis. Here each frame is predicted from the frames before it: what the
agents would do now, by the same planner at what was seen, and where that would put them. There is
no noise of simulations in it but the planner's own, and all combinations of goals are read at once.

A simulator of one's own that can go on from what was seen is read likewise, under every hypothesis
that has prior mass, strengths along with goals.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import Any, Final

from phase_ppl.closed_loop.goal_filter import ActionPolicy
from phase_ppl.closed_loop.hidden_state import Tracking
from phase_ppl.models import effective, world_priors
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    nonnegative_number,
    positive_number,
    shown,
    whole_number,
)
from phase_ppl.world.scene import World
from phase_ppl.world.space import space_of

WEIGHT: Final = 0.2  # what a frame counts of the joint simulator, unless it is said

FEWEST: Final = 20
"""Samples at least: a covariance of some dimensions, without a part of them too."""


@dataclasses.dataclass(frozen=True)
class ClosedLoopLikelihood:
    """The closed loop's likelihood: each frame is predicted from the frames before it.

    p(s_1..T | h) = prod_t p(s_t | s_<t, h)^weight, with one step of planner and physics for each
    frame. The probability of an agent's action is
    (1 - lapse) visits^inverse_temperature / Z + lapse / |A|. Visits count how often the planner's
    search tried the action first; |A| is the number of actions. These probabilities are averaged
    over ``planner_seeds`` sets of searches.

    The posterior is tempered: each frame counts ``weight``. The reason is that real agents can plan
    otherwise than the model for many frames on end, so frames are not independent evidence.
    Evidence for strengths is tempered by ``tracking.strength_weight``. The result is approximate in
    the planner's searches and in the filter of the hidden state.

    ``lapse`` and ``weight`` have the highest log score of goals and relation, after the whole
    video, on 26 of the 50 real videos (``benchmarks/closed_loop.py fit``). On 21 of the others,
    whose scores were seen too, they come within 0.01 nats a video of the best. So figures on these
    videos are in-sample.

    A simulator of your own (:class:`phase_ppl.simulator.contract.Simulator`) may have a density of
    the next frame, ``log_prob_next``. Then the posterior is exact. Otherwise the density is a
    kernel density of the positions of all entities in ``samples`` next frames
    (:mod:`phase_ppl.closed_loop.kernel_density`). It is biased if kernels are wide or few samples
    are near the observation; more samples reduce this. Planner and hidden state are not used with a
    simulator of your own. Of ``tracking`` only three settings count then: ``strengths``; ``scale``,
    the least standard deviation of a kernel; and ``noise``, which is added to that (None: 0).

    Attributes:
        inverse_temperature: exponent of the visits: the inverse temperature of an agent's policy.
        lapse: probability, in each frame, that an agent acts at random.
        weight: exponent of each frame's density; 1: the posterior is not tempered. None: 0.2, or 1
            with a simulator of your own.
        planner_seeds: number of sets of searches (a set is one run of all agents' planners along
            the video). Errors of the posterior come from the spread of the sets; with one set, the
            fastest, they are unknown. The first set searches for all goals. Further sets search
            only for the most probable combinations of goals, which have 0.99 of the posterior so
            far. With more than 50 000 hypotheses all sets search for all goals.
        tracking: settings by which hidden velocities, holds and strengths are followed.
        samples: number of next frames sampled per hypothesis and frame from a simulator of your
            own; 20 or more.

    Raises:
        InvalidSettingError: a value cannot be used.
    """

    inverse_temperature: float = 4.0
    lapse: float = 0.3
    weight: float | None = None
    planner_seeds: int = 4
    tracking: Tracking = dataclasses.field(default_factory=Tracking)
    samples: int = 100

    def __post_init__(self) -> None:
        for name in ("inverse_temperature", "lapse"):
            nonnegative_number(name, getattr(self, name))
        if self.weight is not None:
            positive_number("weight", self.weight)
        whole_number("samples", self.samples, minimum=FEWEST)
        whole_number("planner_seeds", self.planner_seeds)
        if not 0 < self.lapse <= 1:
            raise InvalidSettingError(
                f"lapse={self.lapse!r}, expected a number in (0, 1], or frames could be impossible"
            )
        if not isinstance(self.tracking, Tracking):
            raise InvalidSettingError(f"tracking={shown(self.tracking)}, expected a Tracking")

    def frame_weight(self, users_simulator: bool = False) -> float:
        """Return the weight of a frame; ``users_simulator``: the model has its own simulator."""
        usual = 1.0 if users_simulator else WEIGHT
        return usual if self.weight is None else float(self.weight)

    @property
    def policy(self) -> ActionPolicy:
        """How agents act on their plans: inverse_temperature and lapse."""
        return ActionPolicy(self.inverse_temperature, self.lapse)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain data."""
        return dataclasses.asdict(self)


def closed_loop_prior(
    prior: Callable[..., object], world: World, levels: tuple[float, ...]
) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """Return what a file keeps of a prior that is bound to a world: variables, attributes.

    Where hypotheses are few enough for a table, ``log_prior`` of all of them, and the names of
    further ``sites``; else ``log_prior_goals``, ``log_prior_alpha`` and ``log_prior_strengths``,
    of sites that are independent of each other. Levels of strength are in newtons, ascending.
    """
    if space_of(world).is_listed:
        further = json.dumps(list(effective.further_sites(prior)))
        return {"log_prior": effective.prior_table(prior, levels)}, {"sites": further}
    assert isinstance(prior, effective.WorldPrior), "hypotheses of PHASE are few enough"
    masses = world_priors.masses_of(prior)
    found = {
        "log_prior_goals": masses.goals,
        "log_prior_alpha": masses.alpha,
        "log_prior_strengths": world_priors.log_strengths(masses, world, levels),
    }
    return found, {}
