"""Checking a user's prior before the first simulation is paid for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import jax.numpy as jnp
from jax import random
from numpyro import handlers

from phase_ppl.models.density import Program, latent_sites, trace_log_density
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES, HYPOTHESIS_SITES, STRENGTH_SITES
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import ALPHAS

_EXPECTED: Final = {
    **dict.fromkeys(GOAL_SITES, f"a goal code, 0..{N_GOALS - 1}, as phase_ppl.sites.goals()"),
    ALPHA_SITE: f"an alpha code, 0..{len(ALPHAS) - 1}, as phase_ppl.sites.alpha()",
    **dict.fromkeys(STRENGTH_SITES, "a positive real number, as phase_ppl.sites.strengths()"),
}

RESERVED: Final = frozenset(
    (
        *("goal", "relation", "scenario", "stated_goal_red", "stated_goal_green", "weight"),
        *("chain", "draw", "simulation", "time", "entity", "coord", "seed", "iteration"),
        *("log_prior", "log_prior_effective", "log_likelihood", "total_error", "completed"),
        *("frames_simulated", "failed", "mixture", "step_error", "trajectory"),
    )
)
"""Names that a prior's own sites cannot have."""


def checked_sites(prior: Program) -> dict[str, tuple[int, ...]]:
    """Return the latent sites of a prior with their shapes.

    Raises:
        InvalidSettingError: it is not a program that can serve as a prior; the message names
            the site and what is expected.
    """
    name = getattr(prior, "__name__", repr(prior))
    if not callable(prior):
        raise InvalidSettingError(
            f"prior={name} is no NumPyro program: expected a function without arguments that "
            f"samples {', '.join(HYPOTHESIS_SITES)}"
        )
    try:
        trace = handlers.trace(handlers.seed(prior, random.key(0))).get_trace()
    except Exception as error:  # whatever a user's program does
        raise InvalidSettingError(
            f"the prior {name} cannot be run: {type(error).__name__}: {error}"
        ) from error
    _check_trace(name, trace)
    return {site: tuple(jnp.shape(s["value"])) for site, s in latent_sites(trace).items()}


def _check_trace(prior: str, trace: Mapping[str, Any]) -> None:
    for name, site in trace.items():
        if site["type"] == "sample" and site["is_observed"]:
            raise InvalidSettingError(
                f"the prior {prior} conditions on {name!r} (obs= or factor); a prior only samples"
            )
    latent = latent_sites(trace)
    for name in HYPOTHESIS_SITES:
        if name not in latent:
            raise InvalidSettingError(
                f"the prior {prior} does not sample {name!r}: expected {_EXPECTED[name]}"
            )
        _check_site(prior, name, latent[name])
    for name in latent:
        if name in RESERVED:
            raise InvalidSettingError(f"the prior {prior} samples {name!r}, a reserved name")
    try:
        log_density = trace_log_density(trace)
    except (NotImplementedError, AttributeError) as error:
        raise InvalidSettingError(f"the prior {prior} has no density: {error}") from error
    if jnp.isnan(log_density):
        raise InvalidSettingError(f"the density of the prior {prior} is not a number")


def _check_site(prior: str, name: str, site: Mapping[str, Any]) -> None:
    shape = jnp.shape(site["value"])
    start = f"the prior {prior} samples {name!r}"
    if shape != ():
        raise InvalidSettingError(
            f"{start} of shape {shape}: expected a single value, {_EXPECTED[name]}"
        )
    support = site["fn"].support
    wrong = f"{start} with support {support}: expected {_EXPECTED[name]}"
    if name in STRENGTH_SITES:
        if support.is_discrete or bool(support(jnp.array(-1.0))):
            raise InvalidSettingError(wrong)
        return
    limit = len(ALPHAS) if name == ALPHA_SITE else N_GOALS
    outside = jnp.array([-1, limit, limit + 1])
    if not support.is_discrete or any(bool(support(code)) for code in outside):
        raise InvalidSettingError(wrong)
