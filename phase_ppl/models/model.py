"""A model: prior, simulator and likelihood; what is simulated, inferred and compared."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
from collections.abc import Callable
from typing import Any, cast

import jax
import numpy as np
from numpyro import handlers

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.models import priors
from phase_ppl.models.bridge import Noise
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.sites import GOAL_SITES, SITES
from phase_ppl.simulator.contract import Simulator
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.errors import InvalidSettingError, unknown_name
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import ALPHAS

Prior = Callable[[], object]


@dataclasses.dataclass(frozen=True)
class Model:
    """Prior, simulator and likelihood.

    Attributes:
        prior: NumPyro program that samples the hypothesis sites (``phase_ppl.models.sites``) and
            perhaps others.
        simulator: yields frames (``phase_ppl.simulator.contract``); None: the joint simulator.
        likelihood: of the observed given the simulated trajectory.
        planner: "fast", "paper" or a ``PlannerConfig``; for the joint simulator.
        noise: "fresh": a new seed for every simulation; "fixed": one per hypothesis.

    Raises:
        InvalidSettingError: the prior cannot work; the message names the site.
        UnknownNameError: planner or noise is none of the allowed names.
    """

    prior: Prior = priors.uniform
    simulator: Simulator | None = None
    likelihood: RadialLikelihood = dataclasses.field(default_factory=RadialLikelihood)
    planner: str | PlannerConfig = "fast"
    noise: Noise = "fresh"

    def __post_init__(self) -> None:
        object.__setattr__(self, "planner", PlannerConfig.named(self.planner))
        if self.noise not in ("fresh", "fixed"):
            raise unknown_name("noise", self.noise, ("fresh", "fixed"))
        check_prior(self.prior)

    def make_simulator(self) -> Simulator:
        """Return the simulator that this model runs."""
        if self.simulator is not None:
            return self.simulator
        return JointSimulator(cast(PlannerConfig, self.planner))

    def own_sites(self) -> tuple[str, ...]:
        """Return the sites of the prior beyond those of a hypothesis."""
        return tuple(name for name in _sites_of(self.prior) if name not in SITES)

    def to_dict(self) -> dict[str, Any]:
        """Return what determines this model's results, as plain values."""
        joint = self.simulator is None
        return {
            "prior": _signature(self.prior),
            "simulator": "joint" if joint else _signature(self.simulator),
            "planner": cast(PlannerConfig, self.planner).to_dict() if joint else None,
            "likelihood": self.likelihood.to_dict(),
            "noise": self.noise,
        }


def _signature(part: Any) -> dict[str, str]:
    """Return the name of a function or object, and a hash of its source where there is one."""
    named = part if inspect.isroutine(part) or inspect.isclass(part) else type(part)
    try:
        source = hashlib.sha256(inspect.getsource(named).encode()).hexdigest()[:16]
    except (OSError, TypeError):
        source = ""
    return {"name": getattr(named, "__qualname__", str(named)), "source": source}


def _sites_of(prior: Prior) -> dict[str, dict[str, Any]]:
    trace = handlers.trace(handlers.seed(prior, jax.random.key(0))).get_trace()
    return {
        name: site
        for name, site in trace.items()
        if site["type"] == "sample" and not site["is_observed"]
    }


def check_prior(prior: Prior) -> None:
    """Raise InvalidSettingError if a program cannot be a prior over hypotheses."""
    if not callable(prior):
        raise InvalidSettingError(f"prior={prior!r} is not a NumPyro program")
    try:
        found = _sites_of(prior)
    except Exception as error:
        raise InvalidSettingError(
            f"the prior cannot be run: {type(error).__name__}: {error}"
        ) from error
    limits = {**dict.fromkeys(GOAL_SITES, N_GOALS), "alpha": len(ALPHAS)}
    for name in SITES:
        if name not in found:
            raise InvalidSettingError(
                f"the prior has no site {name!r}; sample it, or call a default statement of "
                "phase_ppl.sites"
            )
        site = found[name]
        value = np.asarray(site["value"])
        if value.shape != ():
            raise InvalidSettingError(
                f"site {name!r} of the prior has shape {value.shape}, expected a single value"
            )
        if name in limits:
            n = np.shape(getattr(site["fn"], "probs", ()))[-1:]
            if not site["fn"].support.is_discrete or n != (limits[name],):
                raise InvalidSettingError(
                    f"site {name!r} of the prior must be Categorical over {limits[name]} values, "
                    f"not {type(site['fn']).__name__}"
                    + (f" over {n[0]}" if site["fn"].support.is_discrete and n else "")
                )
        elif site["fn"].support.is_discrete:
            raise InvalidSettingError(
                f"site {name!r} of the prior must have a density over newtons, "
                f"not be a discrete {type(site['fn']).__name__}"
            )
