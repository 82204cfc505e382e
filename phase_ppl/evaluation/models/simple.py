"""SIMPLE, the paper's model: inference over goals, relation and strengths by simulation.

Beside it the closed-loop model, and lesions of SIMPLE. A lesion differs from SIMPLE in the one
thing that its name says; both propose from the same features of the video.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.evaluation.registry import Predict, register_model
from phase_ppl.world.errors import InvalidSettingError, check_name, unknown_name
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.scene import Scene

if TYPE_CHECKING:
    from phase_ppl.analysis.event_posterior import EventPosterior
    from phase_ppl.models.model import Model

_NOT_OPTIONS: Final = ("checkpoint", "event", "executor", "progress", "seed", "workers")


@dataclasses.dataclass(frozen=True)
class Simple:
    """A model of this package with its options, ready to be asked."""

    model: Model  # prior, simulator and likelihood
    # for ``infer``, kernel options included
    options: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> EventPosterior:
        """Return the posterior."""
        from phase_ppl.inference.infer import infer

        event = Event(scene, observation)
        return infer(event, self.model, seed=seed, workers=1, progress=False, **self.options)

    def warm_up(self) -> None:
        """Compile what the model needs, for all processes."""
        if self.options.get("kernel") is None:
            from phase_ppl.closed_loop.goal_filter import warm_up

            warm_up()
            return
        simulator = self.model.build_simulator()
        if hasattr(simulator, "warm_up"):
            simulator.warm_up()

    def settings(self) -> dict[str, Any]:
        """Return what the model consists of."""
        return {"model": self.model.fingerprint()}


def _of_simple(given: Mapping[str, Any]) -> list[str] | None:
    """Return what SIMPLE takes beside its own options, by ``kernel``; None: anything it does."""
    from phase_ppl.inference.infer import infer
    from phase_ppl.inference.registry import info_of
    from phase_ppl.inference.settings import KERNEL, SETTINGS

    of_kernel = info_of(given.get("kernel") or KERNEL).options
    if of_kernel is None:
        return None
    of_infer = [name for name in _options_of(infer) if name not in _NOT_OPTIONS]
    return [*of_infer, *SETTINGS, *of_kernel]


def _options_of(function: Callable[..., Any]) -> list[str]:
    parameters = inspect.signature(function).parameters.values()
    return [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]


@register_model("simple", any_world=True)
def simple(
    *,
    prior: Any = "uniform",
    planner: Any = None,
    simulator: Any = None,
    likelihood: Any = None,
    program: Model | None = None,
    weights: str | None = None,
    preset: str = "simple",
    **options: Any,
) -> Simple:
    """SIMPLE: inference over goals, relation and strengths by simulation.

    Args:
        prior, planner, simulator, likelihood: of the :class:`phase_ppl.Model`.
        program: a model instead of these.
        weights: of the draws; by default the run's.
        preset: of :func:`phase_ppl.preset`; other arguments override it.
        **options: for :func:`phase_ppl.infer`: ``kernel`` and its options, ``chains``,
            ``iterations`` or ``budget``, ``on_failure``, ``settings``; or fields of the settings
            by name, such as ``proposal="paper"``.
    """
    from phase_ppl.analysis.weights import WEIGHTINGS
    from phase_ppl.inference.registry import info_of
    from phase_ppl.inference.settings import completed
    from phase_ppl.models.model import Model

    options = completed(preset, {"planner": planner, "weights": weights, **options})
    usual = options.pop("planner", None)
    if simulator is None and program is None:
        planner = usual  # what brings its own simulator brings its planner
    for name in options:
        if name in _NOT_OPTIONS:
            raise InvalidSettingError(f"{name} is no option of model 'simple'")
    if options.get("weights") is not None:
        check_name("weights", options["weights"], WEIGHTINGS)
    known = _of_simple(options)
    for name in options:
        if known is not None and name not in known:
            kernel = info_of(options["kernel"]).name
            what = f"option of model 'simple' with kernel {kernel!r}:"
            raise unknown_name(what, name, [*_options_of(simple), *known])
    if program is None:
        program = Model(prior, simulator, likelihood, planner)
    elif (prior, simulator, likelihood, planner) != ("uniform", None, None, None):
        raise InvalidSettingError("give either a program or its prior, planner and so on")
    return Simple(program, options)


# --- the closed-loop model: every frame explained from what was observed before it ----------------


@register_model("closed_loop", any_world=True)
def closed_loop(
    *,
    prior: Any = "uniform",
    planner: Any = None,
    program: Model | None = None,
    inverse_temperature: float | None = None,
    lapse: float | None = None,
    weight: float | None = None,
    planner_seeds: int | None = None,
    strengths: Any = None,
    noise: float | None = None,
) -> Simple:
    """Closed loop: each frame given what was seen before, summed over all goals, in any world.

    Args:
        prior, planner: of the :class:`phase_ppl.Model`.
        program: a model instead of all that.
        inverse_temperature, lapse, weight, planner_seeds: of the
            :class:`phase_ppl.ClosedLoopLikelihood`.
        strengths, noise: of its :class:`phase_ppl.Tracking`.
    """
    from phase_ppl.closed_loop.hidden_state import Tracking
    from phase_ppl.models.closed_loop import ClosedLoopLikelihood
    from phase_ppl.models.model import Model

    tracking = Tracking(**_given(strengths=strengths, noise=noise))
    given = _given(
        inverse_temperature=inverse_temperature,
        lapse=lapse,
        weight=weight,
        planner_seeds=planner_seeds,
    )
    likelihood = ClosedLoopLikelihood(tracking=tracking, **given)
    made = Model(prior=prior, planner=planner, likelihood=likelihood)
    if program is None:
        return Simple(made)
    if made != Model(prior="uniform", likelihood=ClosedLoopLikelihood()):
        raise InvalidSettingError("give either a program, or its prior, planner and likelihood")
    return Simple(program.for_reading())


def _given(**options: Any) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


# --- lesions: SIMPLE with one thing changed, and all of its other options -------------------------
# What each leaves out shows what SIMPLE needs it for. Options are those of the model ``simple``;
# what a lesion changes itself cannot be given. Proposals are the same, with one exception that
# cannot be helped: a prior without social goals proposes none.


@register_model("no_physics", any_world=True)
def no_physics(*, planner: Any = None, speed: float | None = None, **options: Any) -> Predict:
    """SIMPLE without physics: agents and items move along paths at a constant speed.

    Args:
        planner: chooses the subgoals, "fast", "paper" or a ``PlannerConfig``.
        speed: units per simulated second; by default 10.
        **options: of the model ``simple``.
    """
    _refuse(options, "simulator")
    from phase_ppl.simulator.no_physics import SPEED, PathSimulator

    simulator = PathSimulator(_planner(planner, options), SPEED if speed is None else speed)
    return simple(simulator=simulator, **options)


@register_model("noisy_physics", any_world=True)
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

    noise = DynamicsNoise(**_given(speed=speed_noise, direction=direction_noise))
    simulator = JointSimulator(_planner(planner, options), noise=noise)
    return simple(simulator=simulator, **options)


@register_model("full_observation", any_world=True)
def full_observation(*, planner: Any = None, **options: Any) -> Predict:
    """SIMPLE with full observation: agents see everything at all times."""
    return simple(planner=_planner(planner, options, full_observation=True), **options)


@register_model("true_state", any_world=True)
def true_state(*, planner: Any = None, **options: Any) -> Predict:
    """SIMPLE without belief particles: agents plan on the true state, whatever they have seen."""
    return simple(planner=_planner(planner, options, true_state=True), **options)


@register_model("no_cost_weight", any_world=True)
def no_cost_weight(*, planner: Any = None, **options: Any) -> Predict:
    """SIMPLE with lambda = 0: subgoals are chosen by their probability, whatever they cost."""
    return simple(planner=_planner(planner, options, cost_weight=0.0), **options)


@register_model("no_social_goals", any_world=True)
def no_social_goals(*, planner: Any = None, **options: Any) -> Predict:
    """SIMPLE with alpha = 0: nobody helps or hinders; goals agree or clash by chance only."""
    _refuse(options, "prior")
    return simple(prior="no_social_goals", planner=planner, **options)


def _refuse(options: dict[str, Any], name: str) -> None:
    """Raise InvalidSettingError if an option is given that is what the lesion changes."""
    if name in options:
        raise InvalidSettingError(f"{name} is no option here: it is what this model changes")


def _planner(planner: Any, options: Mapping[str, Any], **changes: Any) -> Any:
    """Return a planner by name, or the preset's or the default one, with fields changed."""
    from phase_ppl.agents.config import PlannerConfig
    from phase_ppl.inference.settings import completed
    from phase_ppl.models.model import DEFAULT_PLANNER

    usual = completed(options.get("preset", "simple"), {"planner": planner})
    config = PlannerConfig.named(usual.get("planner", DEFAULT_PLANNER))
    return dataclasses.replace(config, **changes)
