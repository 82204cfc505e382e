"""Lesions: SIMPLE with one thing changed, and all of its other options.

What each leaves out shows what SIMPLE needs it for. Options are those of the model ``simple``;
what a lesion changes itself cannot be given.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any

from phase_ppl.evaluation.answer import Predict
from phase_ppl.evaluation.models.simple import more_options as more_of_simple
from phase_ppl.evaluation.models.simple import simple
from phase_ppl.evaluation.registry import MoreOptions, register_model
from phase_ppl.world.errors import InvalidSettingError


def _without(changed: str) -> MoreOptions:
    """Return what tells the options of the model ``simple``, but for what a lesion changes."""

    def more_options(given: Mapping[str, Any]) -> list[str] | None:
        others = more_of_simple(given)
        if others is None:
            return None
        parameters = inspect.signature(simple).parameters.values()
        own = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]
        return [name for name in (*own, *others) if name != changed]

    return more_options


@register_model("no_physics", more_options=_without("simulator"))
def no_physics(*, planner: Any = None, speed: float | None = None, **options: Any) -> Predict:
    """SIMPLE without physics: agents and items move along paths at a constant speed.

    Args:
        planner: chooses the subgoals, "fast", "paper" or a ``PlannerConfig``.
        speed: units per simulated second; by default 10.
        **options: of the model ``simple``.
    """
    _refuse(options, "simulator")
    from phase_ppl.simulator.no_physics import SPEED, PathSimulator

    simulator = PathSimulator(_planner(planner), SPEED if speed is None else speed)
    return simple(simulator=simulator, **options)


@register_model("noisy_physics", more_options=_without("simulator"))
def noisy_physics(
    *,
    planner: Any = None,
    speed_noise: float | None = None,
    direction_noise: float | None = None,
    **options: Any,
) -> Predict:
    """SIMPLE with noisy physics: after each step every body's velocity is off at random.

    Args:
        planner: "fast", "paper" or a ``PlannerConfig``.
        speed_noise: standard deviation of the log of the speed per step of 1/12 s, 0.2 by default.
        direction_noise: likewise of the direction of motion, 0.2 rad by default.
        **options: of the model ``simple``.
    """
    _refuse(options, "simulator")
    from phase_ppl.simulator.joint import DynamicsNoise, JointSimulator

    given = {"speed": speed_noise, "direction": direction_noise}
    noise = DynamicsNoise(**{name: value for name, value in given.items() if value is not None})
    return simple(simulator=JointSimulator(_planner(planner), noise=noise), **options)


@register_model("full_observation", more_options=_without("simulator"))
def full_observation(*, planner: Any = None, **options: Any) -> Predict:
    """SIMPLE with full observation: agents see everything at all times."""
    return simple(planner=_planner(planner, full_observation=True), **options)


@register_model("true_state", more_options=_without("simulator"))
def true_state(*, planner: Any = None, **options: Any) -> Predict:
    """SIMPLE without belief particles: agents plan on the true state, whatever they have seen."""
    return simple(planner=_planner(planner, true_state=True), **options)


@register_model("no_cost_weight", more_options=_without("simulator"))
def no_cost_weight(*, planner: Any = None, **options: Any) -> Predict:
    """SIMPLE with lambda = 0: subgoals are chosen by their probability, whatever they cost."""
    return simple(planner=_planner(planner, cost_weight=0.0), **options)


@register_model("no_social_goals", more_options=_without("prior"))
def no_social_goals(*, planner: Any = None, **options: Any) -> Predict:
    """SIMPLE with alpha = 0: nobody helps or hinders; goals agree or clash by chance only."""
    _refuse(options, "prior")
    return simple(prior="no_social_goals", planner=planner, **options)


def _refuse(options: dict[str, Any], name: str) -> None:
    """Raise InvalidSettingError if an option is given that is what the lesion changes."""
    if name in options:
        raise InvalidSettingError(f"{name} is no option here: it is what this model changes")


def _planner(planner: Any, **changes: Any) -> Any:
    """Return a planner by name, or the default one, with fields changed."""
    from phase_ppl.agents.config import PlannerConfig
    from phase_ppl.models.model import DEFAULT_PLANNER

    config = PlannerConfig.named(DEFAULT_PLANNER if planner is None else planner)
    return dataclasses.replace(config, **changes)
