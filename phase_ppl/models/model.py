"""A model: the prior, the simulator and the likelihood that explain an event."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, Any, Final, Literal

from phase_ppl.models import priors
from phase_ppl.models.checks import checked_sites
from phase_ppl.models.density import Program
from phase_ppl.models.likelihood import Likelihood, RadialLikelihood
from phase_ppl.world.errors import InvalidSettingError, unknown_name
from phase_ppl.world.identity import qualified_name, source_hash

if TYPE_CHECKING:
    from phase_ppl.agents.config import PlannerConfig
    from phase_ppl.simulator.contract import Simulator

Noise = Literal["fresh", "fixed"]

DEFAULT_PLANNER: Final = "fast"


class _PriorField:
    """A field that is set to a program or to the name of a ready-made one, and is a program."""

    def __get__(self, model: object | None, owner: type) -> Program:
        if model is None:
            return priors.uniform  # the default
        program: Program = vars(model)["prior"]
        return program

    def __set__(self, model: object, value: Program | str) -> None:
        vars(model)["prior"] = priors.named(value) if isinstance(value, str) else value


@dataclasses.dataclass(frozen=True)
class Model:
    """What is simulated, inferred, compared and evaluated.

    Attributes:
        prior: NumPyro program that samples the five hypothesis sites, and perhaps more; or the
            name of a ready-made one (:mod:`phase_ppl.models.priors`).
        simulator: generator function ``(scene, hypothesis, rng)`` of frames; None for the joint
            simulator of the paper (Algorithm 1).
        likelihood: of a trajectory, from its per-frame errors.
        planner: "fast", "paper" or a ``PlannerConfig`` for the joint simulator; None: "fast".
        noise: "fresh", a new simulator seed per proposal, so that the posterior is that of the
            mean likelihood over seeds; or "fixed", one seed per event and hypothesis: a
            deterministic likelihood, hence another posterior.

    Raises:
        InvalidSettingError: the prior cannot work (the message names the site and what is
            expected), or a planner is given for another simulator.
        UnknownNameError: an unknown prior, planner or noise.
    """

    prior: _PriorField = _PriorField()
    simulator: Simulator | None = None
    likelihood: Likelihood = dataclasses.field(default_factory=RadialLikelihood)
    planner: str | PlannerConfig | None = None
    noise: Noise = "fresh"

    def __post_init__(self) -> None:
        if self.noise not in ("fresh", "fixed"):
            raise unknown_name("noise", self.noise, ("fresh", "fixed"))
        if self.simulator is None:
            object.__setattr__(self, "planner", self._planner_config())
        elif not callable(self.simulator):
            raise InvalidSettingError(
                f"simulator={self.simulator!r}: expected a generator function "
                "(scene, hypothesis, rng) of frames"
            )
        elif self.planner is not None:
            raise InvalidSettingError(
                "planner applies to the joint simulator, but the model has a simulator of its own"
            )
        if not all(hasattr(self.likelihood, name) for name in ("log_prob", "max_total_error")):
            raise InvalidSettingError(
                f"likelihood={self.likelihood!r} lacks log_prob or max_total_error"
            )
        self.sites  # noqa: B018  (refuses a prior that cannot work, before anything is simulated)

    @functools.cached_property
    def sites(self) -> dict[str, tuple[int, ...]]:
        """Latent sites of the prior with their shapes."""
        return checked_sites(self.prior)

    def _planner_config(self) -> PlannerConfig:
        from phase_ppl.agents.config import PlannerConfig

        return PlannerConfig.named(DEFAULT_PLANNER if self.planner is None else self.planner)

    def build_simulator(self) -> Simulator:
        """Return the simulator, the joint one with the model's planner by default."""
        if self.simulator is not None:
            return self.simulator
        from phase_ppl.simulator.joint import JointSimulator

        return JointSimulator(self._planner_config())

    def fingerprint(self) -> dict[str, Any]:
        """Return what distinguishes this model, as plain data for a run's settings.

        Names of prior and simulator with a hash of their source where it can be had, the
        likelihood, the planner's values and the kind of noise; of a simulator with a method
        ``settings()`` what that returns.
        """
        own = self.simulator is not None
        details = getattr(self.simulator, "settings", None)
        return {
            **({"simulator_settings": details()} if callable(details) else {}),
            "prior": qualified_name(self.prior),
            "prior_source": source_hash(self.prior),
            "simulator": qualified_name(self.simulator) if own else "joint",
            "simulator_source": source_hash(self.simulator) if own else None,
            "likelihood": repr(self.likelihood),
            "planner": None if own else self._planner_config().to_dict(),
            "noise": self.noise,
        }
