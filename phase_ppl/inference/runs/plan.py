"""All that determines the draws of a run, and what a file can say of it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.inference.registry import Factory, KernelInfo, described
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.models import priors
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.world.checks import instance_of, whole_number
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.identity import event_digest, source_hash, stable

if TYPE_CHECKING:
    from phase_ppl.agents.config import PlannerConfig


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """All that determines the draws of a run, but for how many there are.

    Attributes:
        event: what is explained.
        model: prior, simulator, likelihood.
        kernel: as the user gave it.
        options: of the kernel.
        settings: of SIMPLE.
        chains: particles M.
        seed: a whole number >= 0.

    Raises:
        InvalidEventError: ``event`` is no event.
        InvalidSettingError, UnknownNameError: a setting that cannot be used.
    """

    event: Event
    model: Model
    kernel: str | Factory | MCMCKernel
    options: Mapping[str, Any]
    settings: SimpleSettings
    chains: int
    seed: int
    info: KernelInfo = dataclasses.field(init=False)
    """What is known of the kernel."""

    def __post_init__(self) -> None:
        if not isinstance(self.event, Event):
            raise no_event(self.event)
        object.__setattr__(self, "info", described(self.kernel))
        object.__setattr__(self, "chains", whole_number("chains", self.chains))
        object.__setattr__(self, "seed", whole_number("seed", self.seed, minimum=0))

    def identity(self) -> dict[str, Any]:
        """Return as plain data what a run must have in common with another to be the same."""
        observed = self.event
        return {
            "event": event_digest(observed),
            "model": stable(self.model.fingerprint()),
            "kernel": {
                "name": self.info.name,
                "source": source_hash(_unregistered(self)),
                "values": _plain_values(self.kernel),
                "options": stable(dict(self.options)),
            },
            "settings": stable(fields_of(self.settings)),
            "chains": self.chains,
            "seed": self.seed,
        }


def no_event(given: object) -> InvalidEventError:
    """Return the error for something that is no event."""
    return InvalidEventError(f"{shown(given)} is no event; phase_ppl.load_event reads one")


def fields_of(settings: SimpleSettings) -> dict[str, Any]:
    """Return the settings by name."""
    return {f.name: getattr(settings, f.name) for f in dataclasses.fields(settings)}


def complete_model(
    model: Model | None, planner: str | PlannerConfig | None, settings: SimpleSettings
) -> Model:
    """Return the model with the planner and the settings' beta, the paper's model by default.

    Raises:
        InvalidSettingError: beta is given for a likelihood that has none.
    """
    model = Model() if model is None else model
    instance_of("model", model, Model, "a phase_ppl.Model")
    instance_of("settings", settings, SimpleSettings, "a phase_ppl.SimpleSettings")
    if planner is not None:
        model = dataclasses.replace(model, planner=planner)
    if settings.beta is not None:
        if not isinstance(model.likelihood, RadialLikelihood):
            raise InvalidSettingError("beta is of the radial likelihood; the model has another")
        model = dataclasses.replace(model, likelihood=RadialLikelihood(settings.beta))
    return model


# --- what can be made again from a file ------------------------------------------------------


def stored_model(model: Model) -> dict[str, Any] | None:
    """Return what :func:`model_again` needs; None where the model has parts of a user's own."""
    prior = next((name for name, known in priors.PRIORS.items() if known is model.prior), None)
    plain = model.simulator is None and type(model.likelihood) is RadialLikelihood
    if prior is None or not plain or not isinstance(model.likelihood, RadialLikelihood):
        return None
    return {
        "prior": prior,
        "beta": model.likelihood.beta,
        "planner": model.fingerprint()["planner"],
        "noise": model.noise,
    }


def model_again(stored: Mapping[str, Any]) -> Model:
    """Return the model of which :func:`stored_model` was written down."""
    from phase_ppl.agents.config import PlannerConfig

    return Model(
        prior=stored["prior"],
        likelihood=RadialLikelihood(stored["beta"]),
        planner=PlannerConfig.from_dict(stored["planner"]),
        noise=stored["noise"],
    )


def stored_options(options: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return options or settings in JSON's types; None where some are of others."""
    try:
        plain: dict[str, Any] = json.loads(json.dumps(dict(options), allow_nan=False))
        return plain if _same(plain, dict(options)) else None
    except (TypeError, ValueError):
        return None


def _same(one: Any, other: Any) -> bool:
    # a list is no tuple, and 1 is not True
    return bool(type(one) is type(other) and repr(one) == repr(other))


def _unregistered(plan: Plan) -> Any:
    return plan.info.factory if isinstance(plan.kernel, str) else plan.kernel


def _plain_values(kernel: object) -> dict[str, Any]:
    """Return the settings that an instance of a kernel has."""
    if not isinstance(kernel, MCMCKernel):
        return {}
    return {
        name: value
        for name, value in sorted(vars(kernel).items())
        if isinstance(value, bool | int | float | str)
    }
