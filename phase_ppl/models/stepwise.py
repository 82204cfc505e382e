"""The closed-loop likelihood: every frame given what was OBSERVED before it.

SIMPLE compares the video with one free-running simulation, which drifts away from it in contact
even under the true hypothesis. Here each frame is predicted from the frames before it: what the
agents would do now, by the same planner at what was seen, and where that would put them. There is
no noise of simulations in it but the planner's own, and all pairs of goals are read at once.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import jax
import numpy as np
from numpy.typing import NDArray
from numpyro import handlers

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.closed_loop.goal_filter import GoalFilter, PairFilter, PolicyFilter
from phase_ppl.closed_loop.hidden_state import Tracking
from phase_ppl.closed_loop.search_sets import Conduct, SearchSets
from phase_ppl.models.density import NO_DENSITY, remembered
from phase_ppl.models.effective import log_prior_of_hypotheses, strengths_apart
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES, STRENGTH_SITES
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import nonnegative_number, positive_number, whole_number
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import ALPHAS, STRENGTH_RANGE
from phase_ppl.world.scene import PHASE, Scene

_NODES: Final = 4  # at which a continuous prior is evaluated in the cell of each level of strength
_PRIORS_KEPT: Final = 8


@dataclasses.dataclass(frozen=True)
class StepwiseLikelihood:
    """p(s_1..T | h) = prod_t p(s_t | s_<t, h)^weight, with one step of planner and physics.

    An agent acts by pi = (1 - lapse) visits^sharpness / Z + lapse / |A|, with
    the visits of the root actions in the planner's search, as a mean over ``planner_seeds``
    independent sets of beliefs and searches.

    The posterior is tempered: where real agents plan otherwise than the model, they do so for many
    frames on end, which are no independent evidence, so that a frame counts ``weight``. Strengths
    are tempered likewise, see ``tracking``. ``lapse`` and ``weight`` have the highest log score of
    goals and relation after the whole video on 26 of the 50 real videos, and were looked at on 21
    others, where they come within 0.01 nats of the best (``benchmarks/stepwise.py fit``): figures
    on those videos are in-sample. What is computed is approximate in the planner's searches and in
    the filter of the hidden state.

    Attributes:
        sharpness: exponent of the visits.
        lapse: probability, by frame, that an agent does anything whatever.
        weight: what a frame counts; with 1 the posterior is not tempered.
        planner_seeds: sets of searches. Errors come from their spread; 1 is the instant setting,
            with errors unknown. Only the most probable pairs of goals are searched by all sets.
        tracking: how hidden velocities, holds and strengths are followed.

    Raises:
        InvalidSettingError: a value that cannot be used.
    """

    sharpness: float = 4.0
    lapse: float = 0.3
    weight: float = 0.2
    planner_seeds: int = 4
    tracking: Tracking = dataclasses.field(default_factory=Tracking)

    def __post_init__(self) -> None:
        for name in ("sharpness", "lapse"):
            nonnegative_number(name, getattr(self, name))
        positive_number("weight", self.weight)
        whole_number("planner_seeds", self.planner_seeds)
        if not 0 < self.lapse <= 1:
            raise InvalidSettingError(
                f"lapse={self.lapse!r}, expected a number in (0, 1], or frames could be impossible"
            )
        if not isinstance(self.tracking, Tracking):
            raise InvalidSettingError(f"tracking={shown(self.tracking)}, expected a Tracking")

    @property
    def conduct(self) -> Conduct:
        """How agents act on their plans."""
        return Conduct(self.sharpness, self.lapse)

    def filter(
        self, scene: Scene, planner: PlannerConfig, seed: int, threads: int, log_prior: FloatArray
    ) -> GoalFilter:
        """Return what takes in frames one by one, and says for each what hypotheses make of it.

        ``log_prior`` is (goal_red, goal_green) in PHASE, in other worlds (agent, goal); the result
        does not depend on ``threads``.
        """
        sets = SearchSets(scene, planner, self.tracking, seed, threads, self.planner_seeds)
        kind = PairFilter if scene.world == PHASE else PolicyFilter
        return kind(sets, self.conduct, self.weight, log_prior)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain data."""
        return dataclasses.asdict(self)


def cells(levels: FloatArray) -> FloatArray:
    """Return (level + 1,) the bounds, in newtons, between which each level is the nearest one."""
    between = (levels[1:] + levels[:-1]) / 2
    return np.concatenate([STRENGTH_RANGE[:1], between, STRENGTH_RANGE[1:]])


def place_of_level(strengths: Any, levels: FloatArray) -> Any:
    """Return the places of the levels that stand for strengths, an array or a number."""
    return np.searchsorted(cells(levels)[1:-1], strengths)


@remembered(_PRIORS_KEPT)
def prior_table(
    prior: Any, levels: tuple[float, ...], own: tuple[tuple[str, tuple[float, ...]], ...] = ()
) -> FloatArray:
    """Return log prior masses of goals, alpha and levels of strength, their sum 1.

    A level stands for all strengths nearer to it than to any other and has their mass: with
    strengths alike between 150 and 600 N, the four default levels have 1/6, 1/3, 1/3 and 1/6. A
    continuous prior is integrated over them with ``_NODES`` Gauss-Legendre nodes each.

    Args:
        prior: NumPyro program over the hypothesis sites.
        levels: (n,) of strength, newtons, ascending.
        own: further sites of the prior, with all the values that each can take.

    Returns:
        (stated_goal_red, stated_goal_green, alpha, *own, strength_red, strength_green).
    """
    strengths = np.array(levels)
    trace = handlers.trace(handlers.seed(prior, jax.random.key(0))).get_trace()
    nodes = [nodes_of(trace[name]["fn"], strengths) for name in STRENGTH_SITES]
    stated = {name: np.arange(N_GOALS) for name in GOAL_SITES} | {
        ALPHA_SITE: np.arange(len(ALPHAS))
    }
    stated |= {name: np.array(values) for name, values in own}
    forces = {name: values for name, (values, _) in zip(STRENGTH_SITES, nodes, strict=True)}
    if strengths_apart(prior):  # a thousand times fewer densities
        densities = _densities(prior, stated)[..., None, None] + _densities(prior, forces)
    else:
        densities = _densities(prior, stated | forces)
    densities[densities <= NO_DENSITY] = -np.inf
    densities += np.log(nodes[0][1])[:, None] + np.log(nodes[1][1])
    highest = densities.max()
    if not np.isfinite(highest):
        raise InvalidSettingError("the prior gives no mass to any hypothesis")
    masses = np.exp(densities - highest)
    for axis, (values, _) in enumerate(nodes, len(stated)):
        place = place_of_level(values, strengths)
        of_levels = [masses.compress(place == i, axis).sum(axis) for i in range(len(levels))]
        masses = np.stack(of_levels, axis)
    with np.errstate(divide="ignore"):
        table = np.log(masses / masses.sum())
    table.setflags(write=False)
    return table


def _densities(prior: Any, values: Mapping[str, NDArray[Any]]) -> FloatArray:
    """Return the log density at all combinations of values of some sites, an axis for each."""
    columns = dict(zip(values, np.meshgrid(*values.values(), indexing="ij"), strict=True))
    flat = {name: column.ravel() for name, column in columns.items()}
    return log_prior_of_hypotheses(prior, flat).reshape([len(one) for one in values.values()])


def nodes_of(found: Any, levels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return strengths at which to evaluate their distribution, and the newtons of each."""
    if found.support.is_discrete:
        values = np.asarray(found.enumerate_support(expand=False), np.float64).ravel()
        return values, np.ones(len(values))
    places, weights = np.polynomial.legendre.leggauss(_NODES)
    low, high = cells(levels)[:-1, None], cells(levels)[1:, None]
    return (
        ((low + high) / 2 + (high - low) / 2 * places).ravel(),
        ((high - low) / 2 * weights).ravel(),
    )
