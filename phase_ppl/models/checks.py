"""Checking a user's prior before the first simulation is paid for."""

from __future__ import annotations

import functools
import os
from collections.abc import Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from jax import random
from numpy.typing import NDArray
from numpyro import handlers

from phase_ppl.models.compiling import compiled_quickly
from phase_ppl.models.density import (
    NO_DENSITY,
    Program,
    latent_sites,
    log_density,
)
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES, HYPOTHESIS_SITES, STRENGTH_SITES
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import ALPHAS

_EXPECTED: Final = {
    **dict.fromkeys(GOAL_SITES, f"a goal code, 0..{N_GOALS - 1}, as phase_ppl.sites.goals()"),
    ALPHA_SITE: f"an alpha code, 0..{len(ALPHAS) - 1}, as phase_ppl.sites.alpha()",
    **dict.fromkeys(
        STRENGTH_SITES,
        "a positive real number, as phase_ppl.sites.strengths(), or one of a few, as "
        "phase_ppl.sites.OneOf",
    ),
}

RESERVED: Final = frozenset(
    (
        *("goal", "relation", "scenario", "stated_goal_red", "stated_goal_green", "weight"),
        *("chain", "draw", "simulation", "time", "entity", "coord", "seed", "iteration"),
        *("log_prior", "log_prior_effective", "log_likelihood", "total_error", "completed"),
        *("frames_simulated", "failed", "mixture", "step_error", "trajectory"),
        *("goal_kind_red", "goal_kind_green", "target_red", "target_green"),
        *("landmark_red", "landmark_green", "sign_red", "sign_green"),
        *("given", "self", "error", "bound", "probability"),
        *("log_joint", "step_log_likelihood"),
    )
)
"""Names that a prior's own sites cannot have."""

_TRIES: Final = 32
"""Draws that are looked at."""

_REMEMBERED: Final = 64

_NOT_POSITIVE: Final = -np.logspace(-3, 6, 91, dtype=np.float32)
"""Strengths that no support may hold."""

_FAR: Final = 100
"""How far from the allowed codes others are looked for."""


def checked_sites(prior: Program) -> dict[str, tuple[int, ...]]:
    """Return the latent sites of a prior with their shapes.

    Raises:
        InvalidSettingError: it is not a program that can serve as a prior; the message names
            the site and what is expected.
    """
    if not callable(prior):
        raise InvalidSettingError(
            f"prior={shown(prior)} is no NumPyro program: expected the name of a ready-made prior "
            f"or a function without arguments that samples {', '.join(HYPOTHESIS_SITES)}"
        )
    try:
        return dict(_checked_once(prior))
    except TypeError:  # it cannot be hashed
        return _checked(prior)


def _checked(prior: Program) -> dict[str, tuple[int, ...]]:
    name = getattr(prior, "__name__", shown(prior))
    try:
        jax.local_devices(backend="cpu")
    except RuntimeError as error:
        platforms = os.environ.get("JAX_PLATFORMS")
        raise InvalidSettingError(
            f"JAX has no processor to work on, with JAX_PLATFORMS={platforms!r}: {_reason(error)}"
        ) from error
    try:
        trace = handlers.trace(handlers.seed(prior, random.key(0))).get_trace()
    except Exception as error:  # whatever a user's program does
        raise InvalidSettingError(f"the prior {name} cannot be run: {_reason(error)}") from error
    _check_trace(name, trace)
    sites = {site: tuple(jnp.shape(s["value"])) for site, s in latent_sites(trace).items()}
    _check_draws(name, prior, sites)
    return sites


_checked_once = functools.lru_cache(_REMEMBERED)(_checked)


def _reason(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


# --- one run of the program ----------------------------------------------------------------


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
        _check_hypothesis_site(prior, name, latent[name])
    for name, site in latent.items():
        _check_any_site(prior, name, site)


def _check_any_site(prior: str, name: str, site: Mapping[str, Any]) -> None:
    start = f"the prior {prior} samples {name!r}"
    if name in RESERVED:
        raise InvalidSettingError(f"{start}, a reserved name")
    if not name or "/" in name:
        raise InvalidSettingError(f"{start}: expected a name without '/', by which it is stored")
    if isinstance(site["fn"], dist.MaskedDistribution) or site["scale"] not in (None, 1.0):
        raise InvalidSettingError(
            f"{start} with a mask or a scale: expected a plain distribution, whose density is "
            "that of its draws"
        )


def _check_hypothesis_site(prior: str, name: str, site: Mapping[str, Any]) -> None:
    start = f"the prior {prior} samples {name!r}"
    if site["cond_indep_stack"]:
        plates = ", ".join(repr(frame.name) for frame in site["cond_indep_stack"])
        raise InvalidSettingError(
            f"{start} in the plate {plates}: expected a single value outside of plates, "
            f"{_EXPECTED[name]}"
        )
    shape = jnp.shape(site["value"])
    if shape != ():
        raise InvalidSettingError(
            f"{start} of shape {shape}: expected a single value, {_EXPECTED[name]}"
        )
    if not _support_fits(name, site["fn"]):
        raise InvalidSettingError(
            f"{start} with support {site['fn'].support}: expected {_EXPECTED[name]}"
        )
    dtype = jnp.result_type(site["value"])
    if name not in STRENGTH_SITES and not jnp.issubdtype(dtype, jnp.integer):
        raise InvalidSettingError(f"{start} of type {dtype}: expected {_EXPECTED[name]}")


def _support_fits(name: str, distribution: dist.Distribution) -> bool:
    try:
        support = distribution.support
        if name in STRENGTH_SITES and support.is_discrete:
            values = np.asarray(distribution.enumerate_support(expand=False))
            possible = values[np.asarray(support(values))]
            return bool(((possible > 0) & np.isfinite(possible)).all())
        if name in STRENGTH_SITES:
            return not np.asarray(support(_NOT_POSITIVE)).any()
        limit = len(ALPHAS) if name == ALPHA_SITE else N_GOALS
        outside = np.append(np.arange(-_FAR, 0), np.arange(limit, limit + _FAR))
        return support.is_discrete and not np.asarray(support(outside)).any()
    except (NotImplementedError, AttributeError, TypeError, ValueError):
        return False  # a support that cannot be asked, or values that cannot be listed


# --- many runs, as inference makes them ----------------------------------------------------


def _check_draws(name: str, prior: Program, sites: Mapping[str, tuple[int, ...]]) -> None:
    """Draw often, compiled and vectorised as in kernels, and look at values and densities."""

    def drawn(key: jax.Array) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
        latent = latent_sites(handlers.trace(handlers.seed(prior, key)).get_trace())
        values = {site: entry["value"] for site, entry in latent.items()}
        return values, {site: _log_prob(name, site, entry) for site, entry in latent.items()}

    def given(values: dict[str, jax.Array]) -> jax.Array:
        return log_density(prior, values)

    keys = random.split(random.key(1), _TRIES)
    try:
        values, by_site = compiled_quickly(jax.vmap(drawn))(keys)
    except InvalidSettingError:
        raise
    except Exception as error:
        raise InvalidSettingError(
            f"the prior {name} cannot be compiled: {_reason(error)}; expected jax.numpy "
            "throughout, such as jnp.where instead of if"
        ) from error
    found = {site: jnp.shape(value)[1:] for site, value in values.items()}
    if found != dict(sites):
        differing = sorted(s for s in {*found, *sites} if found.get(s) != sites.get(s))
        raise InvalidSettingError(
            f"the prior {name} samples {', '.join(map(repr, differing))} in some runs and not, or "
            "with another shape, in others: expected the same sites each time"
        )
    _check_values(name, {site: np.asarray(value) for site, value in values.items()})
    for site, densities in by_site.items():
        bad = ~np.isfinite(np.asarray(densities))
        if bad.any():
            raise InvalidSettingError(
                f"the prior {name} samples {site!r} with a log density of {densities[bad][0]} at "
                f"a value that it drew, {shown(np.asarray(values[site])[bad][0].tolist())}: "
                "expected a finite number"
            )
    try:
        density = compiled_quickly(jax.vmap(given))(values)
    except Exception as error:
        raise InvalidSettingError(
            f"the density of the prior {name} cannot be evaluated at given values of its sites: "
            f"{_reason(error)}"
        ) from error
    total = np.sum([np.asarray(densities) for densities in by_site.values()], axis=0)
    _check_densities(name, np.asarray(density), total)


def _log_prob(prior: str, name: str, site: Mapping[str, Any]) -> jax.Array:
    try:
        return jnp.sum(site["fn"].log_prob(site["value"]))
    except Exception as error:
        raise InvalidSettingError(
            f"the prior {prior} samples {name!r}, which has no density: {_reason(error)}; expected "
            "a distribution with log_prob"
        ) from error


def _check_values(prior: str, columns: Mapping[str, NDArray[Any]]) -> None:
    limits = {**dict.fromkeys(GOAL_SITES, N_GOALS), ALPHA_SITE: len(ALPHAS)}
    for name in HYPOTHESIS_SITES:
        values = columns[name]
        if name in limits:
            wrong = (values < 0) | (values >= limits[name])
        else:
            wrong = ~((values > 0) & np.isfinite(values))
        if wrong.any():
            raise InvalidSettingError(
                f"the prior {prior} draws {name!r} as {values[wrong][0]}: "
                f"expected {_EXPECTED[name]}"
            )


def _check_densities(
    prior: str, density: NDArray[np.float32], drawn_density: NDArray[np.float32]
) -> None:
    if (density < NO_DENSITY).any():
        raise InvalidSettingError(
            f"the prior {prior} draws values outside its own support: they have no density"
        )
    if not np.allclose(density, drawn_density, rtol=1e-3, atol=1e-2):
        raise InvalidSettingError(
            f"the density of the prior {prior} changes from run to run: expected all randomness "
            "to come from numpyro.sample"
        )
