"""The prior of what is simulated: hypotheses with what does not matter summed out.

A helper or hinderer acts on the other's goal, so its own stated goal changes nothing: the prior
of an effective pair is the sum over all stated goals and alphas that lead to it. Sites of a
user's own are summed out where they have few values, else averaged out over draws from the prior;
or they are enumerated or drawn beside hypotheses. Where strengths are levels, a prior is a table of
masses (:func:`prior_table`).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import logsumexp
from numpy.typing import NDArray
from numpyro.infer.inspect import get_dependencies

from phase_ppl.models.compiled import Compiled
from phase_ppl.models.density import (
    NO_DENSITY,
    Program,
    Site,
    compiled_quickly,
    remembered,
    single_sites,
    trace_log_density,
    traced,
    tracing,
)
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES, STRENGTH_SITES
from phase_ppl.world.arrays import FloatArray, equal_rows
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import STRENGTH_RANGE, effective_table
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import HypothesisSpace, space_of

_CHUNK = 4096
_LEAST_DRAWS = 64  # of sites of a user's own, over which what depends on them is averaged
_MOST_DRAWS = 2**14
_DENSITIES = 2**23  # that are evaluated for that, unless the least draws come to more
_MOST_VALUES = 64  # combinations of values of sites of a user's own up to which these are summed
_PRIORS_KEPT = 16
_TABLES_KEPT = 8
_NODES = 4  # at which a continuous prior is evaluated in the cell of each level of strength
_NODES_VARYING = 40  # at which masses are summed up where the density varies, a multiple
_STATED_SITES = (*GOAL_SITES, ALPHA_SITE)
Values = tuple[tuple[str, tuple[float, ...]], ...]  # sites with all the values that each can take


@dataclasses.dataclass(frozen=True)
class BoundPrior:
    """A NumPyro program and what it asks for (:func:`phase_ppl.models.world_priors.bound`)."""

    given: Callable[..., Any]  # by the user: a program, or a ready-made prior of PHASE
    program: Callable[..., Any]  # that it stands for
    world: World
    shows: str = ""  # hash of the scene or event that it looks at; "": it asks for a world only
    arguments: tuple[Any, ...] = dataclasses.field(default=(), compare=False, repr=False)

    def __call__(self) -> None:
        self.program(*self.arguments)


class WorldPrior(BoundPrior):
    """One of another world than PHASE."""


def as_given(prior: Callable[..., Any]) -> Callable[..., Any]:
    """Return a prior as the user gave it, bound to nothing."""
    return prior.given if isinstance(prior, BoundPrior) else prior


def space_of_prior(prior: object) -> HypothesisSpace:
    """Return the hypotheses that a prior is over: those of PHASE, unless it is bound to a world."""
    return space_of(prior.world if isinstance(prior, BoundPrior) else PHASE)


@functools.cache
def stated_hypotheses() -> dict[tuple[int, int], NDArray[np.int64]]:
    """Return, per effective pair of goals, the (n, 3) stated goals and alphas that lead to it."""
    table = effective_table()
    found: dict[tuple[int, int], list[tuple[int, ...]]] = {}
    for stated in np.ndindex(table.shape[:-1]):
        red, green = table[stated].tolist()
        found.setdefault((red, green), []).append(stated)
    return {pair: np.array(rows) for pair, rows in found.items()}


def log_prior_of_hypotheses(prior: Program, sites: Mapping[str, NDArray[Any]]) -> FloatArray:
    """Return (n,) log densities of the hypothesis sites, each (n,), a user's sites summed out."""
    names, n = tuple(sites), len(next(iter(sites.values())))
    above = _users_above(prior, names)
    if not above or n == 0:
        return _of_rows(_density(prior, names), sites, _CHUNK)
    depends = upstream(prior)
    mixed = tuple(name for name in names if not depends[name].isdisjoint(above))
    apart = tuple(name for name in names if name not in mixed)
    # what is averaged depends on some of the sites only, which have fewer combinations
    relevant = {*mixed}.union(*(depends[name] for name in (*mixed, *above)))
    columns = {name: np.asarray(sites[name]) for name in names if name in relevant}
    kind, first = equal_rows([part for one in columns.values() for part in one.reshape(n, -1).T])
    n_draws = 2 ** int(math.log2(_DENSITIES / len(first))) if len(first) < _DENSITIES else 0
    n_draws = min(max(n_draws, _LEAST_DRAWS), _MOST_DRAWS)
    density = _averaged(prior, mixed, above, n_draws)
    chunk = max(1, _CHUNK * _LEAST_DRAWS // n_draws)
    found = _of_rows(density, {name: one[first] for name, one in columns.items()}, chunk)[kind]
    return found + _of_rows(_density(prior, apart), sites, _CHUNK) if apart else found


def _of_rows(
    density: Callable[[dict[str, jax.Array]], jax.Array],
    sites: Mapping[str, NDArray[Any]],
    chunk: int,
) -> FloatArray:
    """Return (n,) the density of sites, each (n,), evaluated for so many at a time."""
    n = len(next(iter(sites.values())))
    parts = []
    for start in range(0, n, chunk):
        # one shape, so that it compiles once
        rows = np.minimum(np.arange(start, start + chunk), n - 1)
        parts.append(np.asarray(density({k: jnp.asarray(v[rows]) for k, v in sites.items()})))
    return np.concatenate([np.empty(0), *parts])[:n].astype(float)


@remembered(_PRIORS_KEPT)
def upstream(prior: Program) -> dict[str, set[str]]:
    """Return latent site -> the sites on whose values its distribution depends."""
    with tracing():
        found = get_dependencies(prior)["prior_dependencies"]
    return {name: set(others) - {name} for name, others in found.items()}


def strengths_apart(prior: Program) -> bool:
    """Whether a prior's strengths depend on no other sites, and no others on them."""
    apart = set(space_of_prior(prior).strength_sites)
    return all(
        others <= apart if name in apart else not others & apart
        for name, others in upstream(prior).items()
    )


def _users_above(prior: Program, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the other sites on which those named depend, be it by way of each other."""
    depends = upstream(prior)
    found: set[str] = set()
    new = set().union(*(depends[name] for name in names)) - {*names}
    while new:
        found |= new
        new = set().union(*(depends[name] for name in new)) - {*names} - found
    return tuple(name for name in depends if name in found)


@remembered(_PRIORS_KEPT)
def _density(prior: Program, names: tuple[str, ...]) -> Callable[[dict[str, jax.Array]], jax.Array]:
    """Return the log density of sites that depend on no others than those they are given with."""

    def given(z: dict[str, jax.Array]) -> jax.Array:
        trace = traced(prior, jax.random.key(0), z)
        return trace_log_density({name: trace[name] for name in names})

    return Compiled(jax.vmap(given))


@remembered(_PRIORS_KEPT)
def _averaged(
    prior: Program, names: tuple[str, ...], above: tuple[str, ...], n_draws: int
) -> Callable[[dict[str, jax.Array]], jax.Array]:
    """Return the log density of the sites ``names``, with the sites ``above`` them summed out.

    ``names`` depend on ``above``. Sites above with few values are summed over. The others are
    averaged over ``n_draws`` draws in all.
    """
    known, summed, n_values = single_sites(prior), dict[str, tuple[float, ...]](), 1
    for name in above:
        values = known[name].values if name in known else None
        if values is not None and n_values * len(values) <= _MOST_VALUES:
            summed[name], n_values = values, n_values * len(values)
    n_each = max(1, n_draws // n_values) if len(summed) < len(above) else 1
    grid = np.meshgrid(*map(np.array, summed.values()), indexing="ij")
    options = {name: np.repeat(one, n_each) for name, one in zip(summed, grid, strict=True)}

    def given(key: jax.Array, users: dict[str, jax.Array], z: dict[str, jax.Array]) -> jax.Array:
        # a user's sites are drawn given those before them and weighted by those after
        # them, which averages to the marginal density wherever they stand in a hierarchy
        trace = traced(prior, key, {**z, **users})
        return trace_log_density({name: trace[name] for name in (*names, *users)})

    def marginal(z: dict[str, jax.Array]) -> jax.Array:
        keys = jax.random.split(jax.random.key(0), n_values * n_each)
        users = {name: jnp.asarray(values) for name, values in options.items()}
        return logsumexp(jax.vmap(given, in_axes=(0, 0, None))(keys, users, z)) - math.log(n_each)

    return Compiled(jax.vmap(marginal))


def log_prior_of_effective(
    prior: Program, goals: NDArray[np.int64], strengths: Mapping[str, NDArray[np.float64]]
) -> FloatArray:
    """Return (n,) the log prior of effective goals (n, 2) with strengths, each (n,) newtons."""
    if len(goals) == 0:
        return np.empty(0)
    _, row, log_densities = _all_stated(prior, goals, strengths)
    total = np.full(len(goals), -np.inf)
    np.logaddexp.at(total, row, log_densities)
    return total


def _all_stated(
    prior: Program, goals: NDArray[np.int64], strengths: Mapping[str, NDArray[np.float64]]
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Return all stated goals and alphas (n, 3) that lead to effective goals (row, 2).

    Also (n,) the row that each is of, ascending, and (n,) its log density with the row's strengths.
    """
    options = [stated_hypotheses()[int(red), int(green)] for red, green in goals]
    stated, row = np.concatenate(options), np.repeat(np.arange(len(goals)), list(map(len, options)))
    columns: dict[str, NDArray[Any]] = dict(zip(_STATED_SITES, stated.T, strict=True))
    columns |= {name: np.asarray(values)[row] for name, values in strengths.items()}
    return stated, row, log_prior_of_hypotheses(prior, columns)


def drawn_stated(
    prior: Program,
    goals: NDArray[np.int64],
    strengths: NDArray[np.floating[Any]],
    seed: int | Sequence[int] = 0,
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return stated goals and alpha for effective goals, drawn by the prior given these.

    Effective goals are (n, 2), strengths (n, 2) newtons; what is drawn is (n, 3), and (n,) the log
    of how probable that was.
    """
    by_site = dict(zip(STRENGTH_SITES, strengths.T.astype(np.float64), strict=True))
    stated, row, log_weight = _all_stated(prior, goals, by_site)
    # the largest of Gumbel-perturbed log weights is a draw in proportion to the weights
    perturbed = log_weight + np.random.default_rng(seed).gumbel(size=len(log_weight))
    order, last = np.lexsort((perturbed, row)), np.flatnonzero(np.diff(row, append=-1))
    total = np.full(len(goals), -np.inf)
    np.logaddexp.at(total, row, log_weight)
    total[total == -np.inf] = 0.0  # without prior mass anything may be drawn
    return stated[order[last]], log_weight[order[last]] - total


@remembered(_PRIORS_KEPT)
def prior_of_pairs(prior: Program) -> FloatArray:
    """Return (goal_red, goal_green) prior masses of the pairs of effective goals, their sum 1.

    Exact where goals and alpha depend on nothing else but sites of a user's own with few values;
    others, and strengths, are averaged out over draws.
    """
    pairs = np.array(list(stated_hypotheses()))
    _, row, log_mass = _all_stated(prior, pairs, {})
    mass = np.zeros((N_GOALS, N_GOALS))
    mass[tuple(pairs.T)] = np.bincount(row, np.exp(log_mass - log_mass.max()))
    mass /= mass.sum()
    mass.setflags(write=False)
    return mass


def cells(levels: FloatArray) -> FloatArray:
    """Return (level + 1,) the bounds, in newtons, between which each level is the nearest one."""
    between = (levels[1:] + levels[:-1]) / 2
    return np.concatenate([STRENGTH_RANGE[:1], between, STRENGTH_RANGE[1:]])


def place_of_level(strengths: Any, levels: FloatArray) -> Any:
    """Return the places of the levels that stand for strengths, an array or a number."""
    return np.searchsorted(cells(levels)[1:-1], strengths)


@remembered(_TABLES_KEPT)
def prior_table(prior: Program, levels: tuple[float, ...], users: Values = ()) -> FloatArray:
    """Return log prior masses of goals, alpha and levels of strength, their sum 1.

    A level stands for all strengths nearer to it than to any other and has their mass: with
    strengths alike between 150 and 600 N, the four default levels have 1/6, 1/3, 1/3 and 1/6. A
    continuous prior is integrated over them (:func:`nodes_of`): roughly, at ``_NODES`` strengths a
    cell, only where goals, alpha or further sites decide how strengths are distributed.

    Dimensions are those of the sites of a hypothesis in its world, with ``users`` before the
    strengths: further sites of the prior, with all the values that each can take. Levels of
    strength are in newtons, ascending.
    """
    space, strengths = space_of_prior(prior), np.array(levels)
    trace = traced(prior, jax.random.key(0))
    apart = strengths_apart(prior)
    of_example = _NODES_VARYING if apart else _NODES
    nodes = [
        nodes_of(trace[name]["fn"], cells(strengths), of_example if upstream(prior)[name] else None)
        for name in space.strength_sites
    ]
    stated = {name: np.arange(n) for name, n in space.limits.items()}
    stated |= {name: np.array(values) for name, values in users}
    forces = {name: values for name, (values, _) in zip(space.strength_sites, nodes, strict=True)}
    if apart:  # a thousand times fewer densities
        densities = np.add.outer(_densities(prior, stated), _densities(prior, forces))
    else:
        densities = _densities(prior, stated | forces)
    densities[densities <= NO_DENSITY] = -np.inf
    with np.errstate(divide="ignore"):  # of cells beyond the support
        densities += functools.reduce(np.add.outer, [np.log(newtons) for _, newtons in nodes])
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


def _densities(prior: Program, values: Mapping[str, NDArray[Any]]) -> FloatArray:
    """Return the log density at all combinations of values of some sites, an axis for each."""
    columns = dict(zip(values, np.meshgrid(*values.values(), indexing="ij"), strict=True))
    flat = {name: column.ravel() for name, column in columns.items()}
    return log_prior_of_hypotheses(prior, flat).reshape([len(one) for one in values.values()])


def nodes_of(
    found: Any, ends: FloatArray, of_example: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return strengths at which to evaluate their distribution, and the newtons of each.

    In a cell, density times newtons sums up to its mass.

    Args:
        found: the distribution of a strength.
        ends: (cell + 1,) the bounds of cells, newtons, ascending.
        of_example: nodes in a cell where ``found`` is but an example of a distribution that depends
            on other sites; None: it depends on none.
    """
    if found.support.is_discrete:
        values = np.asarray(found.enumerate_support(expand=False), np.float64).ravel()
        return values, np.ones(len(values))
    if of_example is not None:
        return _gauss_legendre(ends, of_example)
    within = within_support(found, ends)
    values, newtons = _gauss_legendre(within, _NODES)
    inside = np.asarray(found.log_prob(values))[newtons > 0]
    if inside.size == 0 or np.ptp(inside) == 0:
        return values, newtons
    # as few, which have the mass of their neighbours too
    values, newtons = _gauss_legendre(within, _NODES_VARYING)
    density = np.exp(np.asarray(found.log_prob(values), np.float64))
    mass = np.where(newtons > 0, density * newtons, 0.0).reshape((len(ends) - 1) * _NODES, -1)
    total = mass.sum(axis=1)
    middle = (mass.cumsum(axis=1) >= total[:, None] / 2).argmax(axis=1)
    middle += np.arange(len(mass)) * mass.shape[1]
    shares = np.divide(total, density[middle], where=total > 0, out=np.zeros(len(total)))
    return values[middle], shares


def within_support(found: Any, newtons: FloatArray) -> FloatArray:
    """Return strengths, those beyond the support of a continuous distribution at its ends."""
    bounds = (getattr(found.support, f"{end}_bound", None) for end in ("lower", "upper"))
    lowest, highest = (math.nan if end is None else float(np.asarray(end)) for end in bounds)
    return np.fmin(np.fmax(newtons, lowest), highest)


def _gauss_legendre(ends: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return ``n`` nodes in each cell, and their weights, newtons."""
    places, weights = np.polynomial.legendre.leggauss(n)
    low, high = ends[:-1, None], ends[1:, None]
    values = (low + high) / 2 + (high - low) / 2 * places
    return values.ravel(), ((high - low) / 2 * weights).ravel()


# --- sites of a user's own beside hypotheses ------------------------------------------------------

_MOST_TOGETHER: Final = 8
"""Combinations of values up to which all are summed over where strengths depend on other sites, so
that tables are large."""


def further_sites(prior: Program) -> dict[str, Site]:
    """Return the sites of a prior that are single numbers and none of a hypothesis."""
    found = single_sites(prior)
    return {name: site for name, site in found.items() if name not in space_of_prior(prior).sites}


def enumerable(prior: Program) -> Values | None:
    """Return the further sites with their values, if these are few enough to sum over."""
    sites = further_sites(prior)
    counts = [0 if site.values is None else len(site.values) for site in sites.values()]
    most = _MOST_VALUES if strengths_apart(prior) else _MOST_TOGETHER
    if not 0 < math.prod(counts) <= most:
        return None
    return tuple((name, site.values) for name, site in sites.items() if site.values is not None)


def log_masses(prior: Program, levels: tuple[float, ...], values: Values) -> FloatArray:
    """Return log prior masses of hypotheses, an axis for each site, and values of further sites.

    The last axis has all combinations of the further sites' values, the last site's fastest.
    Levels of strength are in newtons, ascending.
    """
    table = prior_table(prior, levels, values)
    n, before = len(values), len(space_of_prior(prior).limits)
    further = range(before, before + n)
    table = np.moveaxis(table, further, range(-n, 0))
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
        log_prior: table of log masses, an axis for each site.
        places: of the rows in that table.
        levels: (n,) of strength, each of which stands for its cell.
        seed: of the draws.
    """
    n, space = len(places[0]), space_of_prior(prior)
    given: dict[str, NDArray[Any]] = {
        name: np.asarray(hypotheses[name], np.int32) for name in space.limits
    }
    n_codes = len(given)
    if strengths_apart(prior):
        flat = log_prior.reshape(*log_prior.shape[:n_codes], -1)
        log_kept = np.logaddexp.reduce(flat, axis=-1)[places[:n_codes]]
        log_volume: FloatArray | float = 0.0
    else:
        rng = np.random.default_rng(seed)
        log_kept, log_volume = log_prior[places], np.zeros(n)
        for name, place in zip(space.strength_sites, places[n_codes:], strict=True):
            given[name], log_width = _within(single_sites(prior)[name], levels, place, rng)
            log_volume = log_volume + log_width
    names = tuple(further_sites(prior))
    keys = jax.random.split(jax.random.key(seed), n)
    values, log_density = _beside(prior, tuple(given), names)(keys, given)
    log_weight = np.asarray(log_density, np.float64) + log_volume - log_kept
    log_weight[np.asarray(log_density) <= NO_DENSITY] = -np.inf
    return {name: np.asarray(column) for name, column in values.items()}, log_weight


@remembered(_PRIORS_KEPT)
def _beside(prior: Program, given: tuple[str, ...], names: tuple[str, ...]) -> Callable[..., Any]:
    def one(key: jax.Array, z: dict[str, jax.Array]) -> tuple[dict[str, jax.Array], jax.Array]:
        trace = traced(prior, key, z)
        log_density = trace_log_density({name: trace[name] for name in given})
        return {name: trace[name]["value"] for name in names}, log_density

    return compiled_quickly(jax.vmap(one))


def _within(
    site: Site, levels: FloatArray, place: NDArray[np.int64], rng: np.random.Generator
) -> tuple[NDArray[np.float32], FloatArray]:
    """Return strengths drawn evenly from the cells of levels, and the logs of the cells' sizes."""
    if site.values is None:
        edges = cells(levels)
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
