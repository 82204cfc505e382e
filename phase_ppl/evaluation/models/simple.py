"""SIMPLE, the paper's model: inference over goals, relation and strengths by simulation."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.evaluation.answer import Answer
from phase_ppl.evaluation.folder import POSTERIOR
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction
from phase_ppl.evaluation.registry import register_model
from phase_ppl.world.errors import InvalidSettingError, unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

if TYPE_CHECKING:
    from phase_ppl.models.model import Model

_COUNTED: Final = ("simulations", "frames", "frames_saved", "failures", "retries")
_KERNEL: Final = "local_mh"
_NOT_OPTIONS: Final = ("checkpoint", "event", "executor", "progress", "seed", "workers")


@dataclasses.dataclass(frozen=True)
class Simple:
    """SIMPLE with its options, ready to be asked.

    Attributes:
        model: prior, simulator and likelihood.
        weights: of the draws; None: the run's default.
        options: for :func:`phase_ppl.infer`, kernel options included.
    """

    model: Model
    weights: str | None
    options: dict[str, Any]

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Answer:
        """Return the marginals of both effective goals and of the relation."""
        from phase_ppl.analysis.posterior import Posterior
        from phase_ppl.inference.infer import infer

        event = Event(scene, observation)
        post = infer(
            event, self.model, seed=seed, workers=1, progress=False, checkpoint=None, **self.options
        )
        counted: tuple[str, ...] = ("searches",)
        if isinstance(post, Posterior):
            counted = _COUNTED
            if self.weights is not None:
                post = Posterior(post.tree, self.weights)
        prediction = Prediction(
            "",
            probabilities={question: post.marginal(question).values for question in QUESTIONS},
            cost={name: post.cost[name] for name in counted},
        )
        return Answer(prediction, {POSTERIOR: post.save})

    def warm_up(self) -> None:
        """Compile what the simulator needs, for all processes."""
        simulator = self.model.build_simulator()
        if hasattr(simulator, "warm_up"):
            simulator.warm_up()

    def settings(self) -> dict[str, Any]:
        """Return what the model consists of."""
        return {"model": self.model.fingerprint()}


def more_options(given: Mapping[str, Any]) -> list[str] | None:
    """Return what SIMPLE takes beside its own options; None: anything, which the kernel does.

    Args:
        given: all options; ``kernel`` decides.

    Raises:
        InvalidSettingError, UnknownNameError: there is no such kernel.
    """
    from phase_ppl.inference.infer import infer
    from phase_ppl.inference.registry import described

    of_kernel = described(given.get("kernel") or _KERNEL).options
    if of_kernel is None:
        return None
    of_infer = [
        parameter.name
        for parameter in inspect.signature(infer).parameters.values()
        if parameter.kind is parameter.KEYWORD_ONLY and parameter.name not in _NOT_OPTIONS
    ]
    return [*of_infer, *_names_of_settings(), *of_kernel]


@register_model("simple", more_options=more_options)
def simple(
    *,
    prior: Any = "uniform",
    planner: Any = None,
    simulator: Any = None,
    noise: str = "fresh",
    program: Model | None = None,
    weights: str | None = None,
    **options: Any,
) -> Simple:
    """SIMPLE: inference over goals, relation and strengths by simulation.

    Args:
        prior, planner, simulator, noise: of the :class:`phase_ppl.Model`.
        program: a model instead of these.
        weights: of the draws; by default the run's.
        **options: for :func:`phase_ppl.infer`: ``kernel`` and its options, ``chains``,
            ``iterations`` or ``budget``, ``on_failure``, ``settings``; or fields of the settings
            by name, such as ``proposal="paper"``.

    Raises:
        InvalidSettingError, UnknownNameError: one of them cannot be used.
    """
    from phase_ppl.analysis.weights import WEIGHTINGS
    from phase_ppl.inference.registry import described
    from phase_ppl.models.model import Model

    for name in options:
        if name in _NOT_OPTIONS:
            raise InvalidSettingError(f"{name} is no option of model 'simple'")
    if weights is not None and weights not in WEIGHTINGS:
        raise unknown_name("weights", weights, WEIGHTINGS)
    known = more_options(options)
    for name in options:
        if known is not None and name not in known:
            kernel = described(options.get("kernel") or _KERNEL).name
            what = f"option of model 'simple' with kernel {kernel!r}:"
            raise unknown_name(what, name, [*inspect.signature(simple).parameters, *known])
    parts = {"prior": prior, "planner": planner, "simulator": simulator, "noise": noise}
    if program is None:
        program = Model(**parts)
    elif parts != {"prior": "uniform", "planner": None, "simulator": None, "noise": "fresh"}:
        raise InvalidSettingError("give either a program or its prior, planner, simulator, noise")
    return Simple(program, weights, _with_settings(options))


def _names_of_settings() -> list[str]:
    from phase_ppl.inference.settings import SimpleSettings

    return [field.name for field in dataclasses.fields(SimpleSettings)]


def _with_settings(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options with those that are SIMPLE's settings as one."""
    from phase_ppl.inference.settings import SimpleSettings

    names = _names_of_settings()
    given = {name: value for name, value in options.items() if name in names}
    if not given:
        return options
    if options.get("settings") is not None:
        raise InvalidSettingError(f"give either settings or {', '.join(given)}")
    rest = {name: value for name, value in options.items() if name not in names}
    return {**rest, "settings": SimpleSettings(**given)}
