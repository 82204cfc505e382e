"""Priors over who wants what in any world: NumPyro programs of one argument, the world.

A program samples ``goal_<agent>`` (an index into ``world.goals``), ``company`` (an index into
:func:`phase_ppl.world.hypothesis.all_ways`: who helps or hinders whom) and ``strength_<agent>``
(newtons), with the agents' ``world.keys``. The goal of an agent that helps or hinders is not used.
These sites must be independent of each other::

    def alone(world):
        phase_ppl.roles.goals(world)
        phase_ppl.roles.company(world, social=0.0)
        phase_ppl.roles.strengths(world)

    phase_ppl.Model(prior=alone, likelihood=phase_ppl.StepwiseLikelihood())
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from numpyro import handlers
from numpyro.infer.inspect import get_dependencies

from phase_ppl.models import priors
from phase_ppl.models.effective import cells, nodes_of, place_of_level
from phase_ppl.models.sites import IMPOSSIBLE
from phase_ppl.world import hypothesis
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.goals import possible_goals
from phase_ppl.world.hypothesis import SOCIAL, STRENGTH_RANGE, Roles
from phase_ppl.world.identity import qualified_name
from phase_ppl.world.scene import World
from phase_ppl.world.space import COMPANY_SITE, space_of

_DRAWS: Final = 1000  # of roles, until all can act on their goals

RolePrior = Callable[[World], object]


def goals(world: World) -> None:
    """Sample the agents' own goals: all that an agent can have are alike."""
    for agent, name in enumerate(space_of(world).goal_sites):
        logits = np.full(len(world.goals), IMPOSSIBLE)
        logits[possible_goals(agent, world)] = 0.0
        numpyro.sample(name, dist.Categorical(logits=jnp.asarray(logits)))


def company(world: World, social: float = SOCIAL) -> None:
    """Sample who helps or hinders whom: anybody with probability ``social``, all ways alike."""
    n = len(hypothesis.all_ways(len(world.agents)))
    probs = [1.0 - social, *[social / (n - 1)] * (n - 1)] if n > 1 else [1.0]
    numpyro.sample(COMPANY_SITE, dist.Categorical(probs=jnp.array(probs)))


def strengths(world: World) -> None:
    """Sample the agents' strengths: uniform on [150, 600] newtons."""
    for name in space_of(world).strength_sites:
        numpyro.sample(name, dist.Uniform(*STRENGTH_RANGE))


def uniform(world: World, social: float = SOCIAL) -> None:
    """The paper's prior in any world: goals, strengths and ways to help or hinder are alike."""
    goals(world)
    company(world, social)
    strengths(world)


def draw(world: World, seed: int, prior: Callable[..., object] = uniform) -> Roles:
    """Return roles drawn from a prior, for :func:`phase_ppl.simulate`.

    Args:
        world: whose agents and goals.
        seed: the same seed gives the same roles.
        prior: NumPyro program of a world, or a ready-made one. Roles in which somebody helps or
            hinders and has nothing to do are not drawn.

    Raises:
        InvalidSettingError: it gives (nearly) all mass to others.
    """
    program = functools.partial(in_world(prior, world), world)
    space, ways = space_of(world), hypothesis.all_ways(len(world.agents))
    key = jax.random.key(whole_number("seed", seed, 0))
    for _ in range(_DRAWS):
        trace = handlers.trace(handlers.seed(program, key)).get_trace()
        values = {name: site["value"] for name, site in trace.items() if site["type"] == "sample"}
        towards = ways[int(values[COMPANY_SITE])]
        own = [int(values[name]) for name in space.goal_sites]
        stated = tuple(None if one else goal for goal, one in zip(own, towards, strict=True))
        strengths = tuple(float(values[name]) for name in space.strength_sites)
        roles = Roles(world, stated, towards, strengths)
        if roles.is_possible:
            return roles
        key = jax.random.fold_in(key, 1)
    raise InvalidSettingError(
        f"the prior {qualified_name(prior)} draws none but agents that help or hinder with goals "
        f"that {world.name!r} does not have"
    )


_READY_MADE: Final[dict[Any, RolePrior]] = {
    priors.uniform: uniform,
    priors.sparse_social: functools.partial(uniform, social=priors.SOCIAL),
    priors.no_social_goals: functools.partial(uniform, social=0.0),
}
"""Priors of PHASE -> the same in any world."""


def is_of_any_world(prior: object) -> bool:
    """Whether a program takes the world as its argument."""
    try:
        parameters = inspect.signature(prior).parameters.values()  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    return (
        sum(one.default is one.empty and one.kind < one.VAR_POSITIONAL for one in parameters) == 1
    )


def in_world(prior: Callable[..., object], world: World) -> RolePrior:
    """Return the prior over roles that a model's prior stands for.

    Raises:
        InvalidSettingError: it is of PHASE only.
    """
    if prior in _READY_MADE:
        return _READY_MADE[prior]
    if not is_of_any_world(prior):
        known = ", ".join(one.__name__ for one in _READY_MADE)
        raise InvalidSettingError(
            f"the prior {qualified_name(prior)} is of PHASE only, not of {world.name!r}: expected "
            f"{known}, or a NumPyro program of one argument, the world"
        )
    return prior


class Masses(NamedTuple):
    """Log prior masses of own goals and of ways to help or hinder, and the program's trace."""

    name: str  # of the prior
    goals: FloatArray  # (agent, goal)
    company: FloatArray  # (way,), see ``hypothesis.all_ways``
    trace: Mapping[str, Any]  # a run of the program


def masses(prior: Callable[..., object], world: World) -> Masses:
    """Return the masses that a prior gives to goals and to ways to help or hinder in a world.

    Raises:
        InvalidSettingError: it is of PHASE only, cannot be run, lacks a site, or has some that are
            not independent of each other or not what they should be.
    """
    program = functools.partial(in_world(prior, world), world)
    name = qualified_name(prior)
    try:
        trace = handlers.trace(handlers.seed(program, jax.random.key(0))).get_trace()
        depends = get_dependencies(program)["prior_dependencies"]
    except Exception as error:  # whatever a user's program does
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise InvalidSettingError(f"the prior {name} cannot be run: {reason}") from error
    space = space_of(world)
    wanted = (*space.goal_sites, COMPANY_SITE, *space.strength_sites)
    for site in wanted:
        if site not in trace:
            raise InvalidSettingError(
                f"the prior {name} does not sample {site!r}; in {world.name!r} it takes "
                f"{', '.join(wanted)}"
            )
        if trace[site]["is_observed"]:
            raise InvalidSettingError(
                f"the prior {name} conditions on {site!r} (obs=); a prior only samples"
            )
        others = sorted(set(depends.get(site, {})) - {site})
        if others:
            raise InvalidSettingError(
                f"the prior {name} makes {site!r} depend on {', '.join(others)}: outside of PHASE "
                "goals, company and strengths must be independent of each other"
            )

    def of_site(site: str, n: int) -> FloatArray:
        found = trace[site]["fn"]
        if not getattr(found.support, "is_discrete", False) or trace[site]["value"].shape != ():
            raise InvalidSettingError(
                f"the prior {name} samples {site!r} from {shown(found)}: expected one of 0..{n - 1}"
            )
        values = np.asarray(found.enumerate_support(expand=False)).astype(int)
        density = np.asarray(found.log_prob(jnp.asarray(values)), np.float64)
        density[density < IMPOSSIBLE / 2] = -np.inf
        outside = values[((values < 0) | (values >= n)) & np.isfinite(density)]
        if outside.size:
            raise InvalidSettingError(
                f"the prior {name} gives mass to {site}={outside[0]}: expected 0..{n - 1}"
            )
        inside = np.full(n, -np.inf)
        inside[values[values < n]] = density[values < n]
        return inside

    n_ways = len(hypothesis.all_ways(len(world.agents)))
    own = np.stack([of_site(site, space.n_goals) for site in space.goal_sites])
    for agent, goal in np.argwhere(np.isfinite(own)).tolist():
        if goal not in possible_goals(agent, world):
            raise InvalidSettingError(
                f"the prior {name} gives mass to the goal {world.goals[goal]!r} of the "
                f"{world.agents[agent]}, whom it names"
            )
    return Masses(name, own, of_site(COMPANY_SITE, n_ways), trace)


def log_strengths(prior: Masses, world: World, levels: tuple[float, ...]) -> FloatArray:
    """Return (agent, level) log prior masses of strengths, each level [N] for those nearest to it.

    Raises:
        InvalidSettingError: strengths are all beyond the levels.
    """
    found = []
    for site in space_of(world).strength_sites:
        of_levels = _of_levels(prior.trace[site]["fn"], np.array(levels))
        if not np.isfinite(of_levels).any():
            low, high = STRENGTH_RANGE
            raise InvalidSettingError(
                f"the prior {prior.name} gives {site} no mass between {low:g} and {high:g} newtons"
            )
        found.append(of_levels)
    return np.stack(found)


def _of_levels(found: Any, levels: FloatArray) -> FloatArray:
    """Return (level,) log masses of the strengths that are nearest to each level."""
    values, weights = nodes_of(found, cells(levels))
    inside = np.asarray(found.support(jnp.asarray(values)), bool)
    density = np.full(len(values), -np.inf)
    with np.errstate(divide="ignore"):  # of cells beyond the support
        density[inside] = found.log_prob(jnp.asarray(values[inside])) + np.log(weights[inside])
    place = place_of_level(values, levels)
    by_level = [np.logaddexp.reduce(density[place == level]) for level in range(len(levels))]
    return np.array(by_level)
