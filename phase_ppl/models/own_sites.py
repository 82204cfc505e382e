"""Sites that a prior samples beside those of a hypothesis, given hypotheses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import jax
import numpy as np
from numpy.typing import NDArray
from numpyro import handlers

from phase_ppl.models.density import (
    NO_DENSITY,
    Program,
    Site,
    compiled_quickly,
    remembered,
    single_sites,
    trace_log_density,
)
from phase_ppl.models.effective import cells, place_of_level, prior_table, strengths_apart
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES, HYPOTHESIS_SITES, STRENGTH_SITES
from phase_ppl.world.arrays import FloatArray

_PRIORS_KEPT: Final = 8

MOST_VALUES: Final = 64  # combinations of values of further sites up to which all are summed over
_MOST_TOGETHER: Final = 8
"""Likewise where strengths depend on other sites, so that tables are large."""

Values = tuple[tuple[str, tuple[float, ...]], ...]  # sites with all the values that each can take


_single_sites = remembered(_PRIORS_KEPT)(single_sites)


def further_sites(prior: Program) -> dict[str, Site]:
    """Return the sites of a prior that are single numbers and none of a hypothesis."""
    sites = _single_sites(prior)
    return {name: site for name, site in sites.items() if name not in HYPOTHESIS_SITES}


def enumerable(prior: Program) -> Values | None:
    """Return the further sites with their values, if these are few enough to sum over."""
    sites = further_sites(prior)
    counts = [0 if site.values is None else len(site.values) for site in sites.values()]
    most = MOST_VALUES if strengths_apart(prior) else _MOST_TOGETHER
    if not 0 < math.prod(counts) <= most:
        return None
    return tuple((name, site.values) for name, site in sites.items() if site.values is not None)


def log_masses(prior: Program, levels: FloatArray, values: Values) -> FloatArray:
    """Return log prior masses (goal_red, goal_green, alpha, strength_red, strength_green, value).

    The last axis has all combinations of the further sites' values, the last site's fastest.
    """
    table = prior_table(prior, tuple(np.asarray(levels).tolist()), values)
    n = len(values)
    table = np.moveaxis(table, (-2, -1), (3, 4))
    return table.reshape(*table.shape[: table.ndim - n], -1)


def drawn_beside(
    prior: Program,
    hypotheses: Mapping[str, NDArray[Any]],
    log_prior: FloatArray,
    places: tuple[NDArray[np.int64], ...],
    levels: FloatArray,
    seed: int,
) -> tuple[dict[str, NDArray[Any]], FloatArray]:
    """Return (row,) draws of the further sites beside hypotheses, and log weights of the pairs.

    A further site is drawn given the sites before it in the program; a pair weighs by how probable
    the sites after it are, over what they are without it. So weighted, pairs follow the prior's
    joint distribution if the hypotheses follow theirs.

    Args:
        prior: NumPyro program.
        hypotheses: site of a hypothesis -> (row,) codes; strengths are not read.
        log_prior: table of log masses (goal_red, goal_green, alpha, strength_red, strength_green).
        places: of the rows in that table.
        levels: (n,) of strength, each of which stands for its cell.
        seed: the same seed gives the same draws.
    """
    n = len(places[0])
    given: dict[str, NDArray[Any]] = {
        name: np.asarray(hypotheses[name], np.int32) for name in (*GOAL_SITES, ALPHA_SITE)
    }
    if strengths_apart(prior):
        flat = log_prior.reshape(*log_prior.shape[:3], -1)
        log_own = np.logaddexp.reduce(flat, axis=-1)[places[:3]]
        log_volume: FloatArray | float = 0.0
    else:
        rng = np.random.default_rng(seed)
        log_own, log_volume = log_prior[places], np.zeros(n)
        for name, place in zip(STRENGTH_SITES, places[3:], strict=True):
            given[name], log_width = _within(prior, name, levels, place, rng)
            log_volume = log_volume + log_width
    names = tuple(further_sites(prior))
    keys = jax.random.split(jax.random.key(seed), n)
    values, log_density = _beside(prior, tuple(given), names)(keys, given)
    log_weight = np.asarray(log_density, np.float64) + log_volume - log_own
    log_weight[np.asarray(log_density) <= NO_DENSITY] = -np.inf
    return {name: np.asarray(column) for name, column in values.items()}, log_weight


@remembered(_PRIORS_KEPT)
def _beside(prior: Program, given: tuple[str, ...], names: tuple[str, ...]) -> Callable[..., Any]:
    def one(key: jax.Array, z: dict[str, jax.Array]) -> tuple[dict[str, jax.Array], jax.Array]:
        program = handlers.seed(handlers.substitute(prior, data=z), key)
        trace = handlers.trace(program).get_trace()
        return {name: trace[name]["value"] for name in names}, trace_log_density(
            {name: trace[name] for name in given}
        )

    return compiled_quickly(jax.vmap(one))


def _within(
    prior: Program,
    name: str,
    levels: FloatArray,
    place: NDArray[np.int64],
    rng: np.random.Generator,
) -> tuple[NDArray[np.float32], FloatArray]:
    """Return strengths drawn evenly from the cells of levels, and the logs of the cells' sizes."""
    edges = cells(levels)
    site = _single_sites(prior)[name]
    if site.values is None:
        low, high = edges[place], edges[place + 1]
        return np.asarray(rng.uniform(low, high), np.float32), np.log(high - low)
    values = np.array(site.values)
    cell = place_of_level(values, levels)
    drawn, sizes = np.empty(len(place), np.float32), np.ones(len(place))
    for level in range(len(levels)):
        rows, options = place == level, values[cell == level]
        if rows.any() and len(options):  # a level without any has no mass
            drawn[rows] = rng.choice(options, rows.sum())
            sizes[rows] = len(options)
    return drawn, np.log(sizes)
