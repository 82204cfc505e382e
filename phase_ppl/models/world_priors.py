"""Priors over who wants what in any world: NumPyro programs of one argument, the world.

A program samples ``goal_<agent>`` (an index into ``world.goals``), ``alpha`` (an index into
:func:`phase_ppl.world.hypothesis.all_ways`: who helps or hinders whom) and ``strength_<agent>``
(newtons). ``world.keys`` has the agents' short names, such as "red". The goal of an agent that
helps or hinders is not used. These sites must be independent of each other, unless the closed loop
reads a world with few enough hypotheses for a table of them all, such as PHASE::

    def alone(world):
        phase_ppl.roles.goals(world)
        phase_ppl.roles.alpha(world, social=0.0)
        phase_ppl.roles.strengths(world)

    phase_ppl.Model(prior=alone, likelihood=phase_ppl.ClosedLoopLikelihood())

A prior of any world may look at the video: see :func:`bound`. Bound to a world, a prior is a
:class:`WorldPrior`. :mod:`phase_ppl.models.effective` makes the tables. Without a table, the mass
of effective goals is a sum of products over the ways to help or hinder.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from numpy.typing import NDArray
from numpyro.infer.inspect import get_dependencies
from scipy.special import softmax

from phase_ppl.models import density, effective, priors
from phase_ppl.models.density import Program, remembered
from phase_ppl.models.effective import BoundPrior, WorldPrior, as_given, space_of_prior
from phase_ppl.models.sites import IMPOSSIBLE, goals, strengths
from phase_ppl.world import hypothesis
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, shown, whole_number
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.hypothesis import SOCIAL, STRENGTH_RANGE, Hypothesis
from phase_ppl.world.identity import event_digest, qualified_name
from phase_ppl.world.scene import PHASE, Scene, World
from phase_ppl.world.space import ALPHA_SITE, space_of

__all__ = ["alpha", "draw", "goals", "strengths", "uniform"]

_DRAWS: Final = 1000  # of hypotheses, until all can act on their goals
_PRIORS_KEPT: Final = 8

RolePrior = Callable[[World], object]


def alpha(world: World, social: float = SOCIAL) -> None:
    """Sample the site ``alpha``: who helps or hinders whom.

    With probability ``social`` some agent helps or hinders another; all ways to do so are equally
    likely. Default: 2/3, as in the paper.
    """
    n = len(hypothesis.all_ways(len(world.agents)))
    probs = [1.0 - social, *[social / (n - 1)] * (n - 1)] if n > 1 else [1.0]
    numpyro.sample(ALPHA_SITE, dist.Categorical(probs=jnp.array(probs)))


def uniform(world: World, social: float = SOCIAL) -> None:
    """The paper's prior in any world: :func:`goals`, :func:`alpha` and :func:`strengths`.

    ``social`` is the probability that some agent helps or hinders another.
    """
    goals(world)
    alpha(world, social)
    strengths(world)


def draw(world: World, seed: int, prior: Callable[..., object] = uniform) -> Hypothesis:
    """Return a hypothesis drawn from a prior, for :func:`phase_ppl.simulate`.

    Args:
        world: the world of agents and goals.
        seed: a whole number >= 0. The same seed gives the same hypothesis.
        prior: NumPyro program whose argument is the world, or one of PHASE's priors ``uniform``,
            ``sparse_social`` and ``no_social_goals``. A hypothesis is drawn anew if an agent that
            helps or hinders would want what is no goal of the world.

    Raises:
        InvalidSettingError: the prior is for PHASE only, looks at a video, or gives (nearly) no
            mass to hypotheses in which every agent can act.
    """
    if looks_at(prior):
        raise refused(qualified_name(prior), "looks at a video, and there is none to look at")
    program = functools.partial(role_prior(prior, world), world)
    space, key = space_of(world), jax.random.key(whole_number("seed", seed, 0))
    for _ in range(_DRAWS):
        found = space.hypothesis(density.draw(program, key))
        if found.is_possible:
            return found
        key = jax.random.fold_in(key, 1)
    raise InvalidSettingError(
        f"the prior {qualified_name(prior)} draws none but agents that help or hinder with goals "
        f"that {world.name!r} does not have"
    )


_READY_MADE: Final[dict[Any, RolePrior]] = {
    priors.uniform: uniform,
    priors.sparse_social: functools.partial(uniform, social=priors.SPARSE_SOCIAL),
    priors.no_social_goals: functools.partial(uniform, social=0.0),
}
"""Priors of PHASE -> the same in any world."""


SHOWN: Final = ("scene", "observation", "event")
"""Arguments by which a prior asks for what it looks at."""


def asked(prior: object) -> tuple[str, ...]:
    """Return what a program asks for: some of :data:`SHOWN` and "world", by the arguments' names.

    A single argument of any other name is a world.
    """
    try:
        parameters = inspect.signature(prior).parameters.values()  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return ()
    names = tuple(
        one.name for one in parameters if one.default is one.empty and one.kind < one.VAR_POSITIONAL
    )
    if set(names) <= {*SHOWN, "world"}:
        return names
    return ("world",) if len(names) == 1 else ()


def looks_at(prior: object) -> tuple[str, ...]:
    """Return what of an event a program asks for, some of :data:`SHOWN`."""
    return tuple(name for name in asked(prior) if name in SHOWN)


def role_prior(prior: Callable[..., object], world: World) -> RolePrior:
    """Return the program of a world that a model's prior stands for.

    Raises:
        InvalidSettingError: it is of PHASE only.
    """
    if prior in _READY_MADE:
        return _READY_MADE[prior]
    if asked(prior) != ("world",):
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
    alpha: FloatArray  # (way,), see ``hypothesis.all_ways``
    trace: Mapping[str, Any]  # a run of the program


def masses(prior: WorldPrior) -> Masses:
    """Return the masses that a prior gives to goals and to ways to help or hinder in its world.

    Raises:
        InvalidSettingError: it cannot be run, lacks a site, or has some that are not independent of
            each other or not what they should be.
    """
    name, world = qualified_name(prior.given), prior.world
    space = space_of(world)
    wanted = (*space.goal_sites, ALPHA_SITE, *space.strength_sites)
    try:
        trace = density.traced(prior, jax.random.key(0))
        depends = get_dependencies(prior)["prior_dependencies"]
    except Exception as error:  # whatever a user's program does
        raise refused(name, f"cannot be run: {in_one_line(error)}") from error
    for site in wanted:
        if site not in trace:
            takes = f"in {world.name!r} it takes {', '.join(wanted)}"
            raise refused(name, f"does not sample {site!r}; {takes}")
        if trace[site]["is_observed"]:
            raise refused(name, f"conditions on {site!r} (obs=); a prior only samples")
        if others := sorted(set(depends.get(site, {})) - {site}):
            raise refused(
                name,
                f"makes {site!r} depend on {', '.join(others)}: outside of PHASE goals, alpha "
                "and strengths must be independent of each other",
            )

    def of_site(site: str, n: int) -> FloatArray:
        found = trace[site]["fn"]
        if not getattr(found.support, "is_discrete", False) or trace[site]["value"].shape != ():
            raise refused(name, f"samples {site!r} from {shown(found)}: expected one of 0..{n - 1}")
        values = np.asarray(found.enumerate_support(expand=False)).astype(int)
        log_mass = np.asarray(found.log_prob(jnp.asarray(values)), np.float64)
        log_mass[log_mass < IMPOSSIBLE / 2] = -np.inf
        outside = values[((values < 0) | (values >= n)) & np.isfinite(log_mass)]
        if outside.size:
            raise refused(name, f"gives mass to {site}={outside[0]}: expected 0..{n - 1}")
        inside = np.full(n, -np.inf)
        inside[values[values < n]] = log_mass[values < n]
        return inside

    own = np.stack([of_site(site, space.n_goals) for site in space.goal_sites])
    for agent, goal in np.argwhere(np.isfinite(own) & space.impossible).tolist():
        whose = f"the goal {world.goals[goal]!r} of the {world.agents[agent]}, whom it names"
        raise refused(name, f"gives mass to {whose}")
    return Masses(name, own, of_site(ALPHA_SITE, len(hypothesis.all_ways(space.n_agents))), trace)


def refused(prior: str, fault: str) -> InvalidSettingError:
    """Return the error for a prior with that fault."""
    return InvalidSettingError(f"the prior {prior} {fault}")


def in_one_line(error: BaseException) -> str:
    """Return class and message of an error."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def log_strengths(prior: Masses, world: World, levels: tuple[float, ...]) -> FloatArray:
    """Return (agent, level) log prior masses of strengths, each level [N] for those nearest to it.

    Raises:
        InvalidSettingError: strengths are all beyond the levels.
    """
    newtons, rows = np.array(levels), []
    for site in space_of(world).strength_sites:
        found = prior.trace[site]["fn"]
        values, weights = effective.nodes_of(found, effective.cells(newtons))
        inside = np.asarray(found.support(jnp.asarray(values)), bool)
        log_mass = np.full(len(values), -np.inf)
        with np.errstate(divide="ignore"):  # of cells beyond the support
            log_mass[inside] = found.log_prob(jnp.asarray(values[inside])) + np.log(weights[inside])
        place = effective.place_of_level(values, newtons)
        rows.append([np.logaddexp.reduce(log_mass[place == n]) for n in range(len(levels))])
        if not np.isfinite(rows[-1]).any():
            low, high = STRENGTH_RANGE
            raise refused(prior.name, f"gives {site} no mass between {low:g} and {high:g} newtons")
    return np.array(rows)


# --- bound to a world, or to what is seen ---------------------------------------------------------


def bound(
    prior: Callable[..., object], place: World | Scene, observation: Observation | None = None
) -> Program:
    """Return a prior as it is in a world: bound to it, unless that is PHASE.

    A prior that asks by the names of its arguments for the ``scene``, the ``observation`` or the
    ``event`` (both of these, without truth) is bound to what is shown. It uses the video twice,
    as does the likelihood: it is an empirical prior, a cue, not a generative one. One that is bound
    already stays so where nothing is shown.

    Raises:
        InvalidSettingError: it is of PHASE and the world another, or the reverse; or it asks for
            what is not shown here.
    """
    if isinstance(prior, BoundPrior) and prior.shows and observation is None:
        return prior
    prior = as_given(prior)
    scene = place if isinstance(place, Scene) else None
    world = place.world if isinstance(place, Scene) else place
    in_phase = world == PHASE
    kind = BoundPrior if in_phase else WorldPrior
    if looks_at(prior):
        return _looking(prior, kind, world, scene, observation)
    if not in_phase:
        return kind(prior, role_prior(prior, world), world, arguments=(world,))
    if asked(prior):
        wanted = f"in PHASE one takes none and samples {', '.join(space_of(PHASE).sites)}"
        look = f"one that looks at the video takes {', '.join(SHOWN)} or some of these"
        raise refused(qualified_name(prior), f"takes a world as its argument: {wanted}; {look}")
    return prior


def _looking(
    prior: Callable[..., object],
    kind: type[BoundPrior],
    world: World,
    scene: Scene | None,
    observation: Observation | None,
) -> BoundPrior:
    """Return a prior bound to what it looks at."""
    names, looks = asked(prior), looks_at(prior)
    if scene is None or (observation is None and looks != ("scene",)):
        whole = "the scene" if looks == ("scene",) else "the whole video"
        raise refused(
            qualified_name(prior),
            f"asks for {' and '.join(looks)}, and {whole} is not known here: take "
            "phase_ppl.infer(event, model), watch(scene, model, observation=event.observation) or "
            "priors.summary(prior, event)",
        )
    if looks == ("scene",) or observation is None:  # the same, whatever happens in it
        observation = Observation(np.stack([scene.start] * 2))
    event = Event(scene, observation)
    seen = {"world": world, "scene": scene, "observation": observation, "event": event}
    return kind(prior, prior, world, event_digest(event), tuple(seen[name] for name in names))


@remembered(_PRIORS_KEPT)
def masses_of(prior: WorldPrior) -> Masses:
    """Return the masses of own goals and ways of a prior that is bound to a world."""
    with jax.ensure_compile_time_eval():  # kernels are made inside compiled code
        return masses(prior)


def effective_goals(prior: Program, most: float) -> NDArray[np.int64] | None:
    """Return (row, agent) the effective goals of all agents that a prior may give mass to.

    None: in a world other than PHASE, ``most`` are fewer than there are ways to choose own goals.
    """
    if not isinstance(prior, WorldPrior):
        return np.array(list(effective.stated_hypotheses()))
    found, space = masses_of(prior), space_of_prior(prior)
    own = [np.flatnonzero(np.isfinite(row)) for row in found.goals]
    if math.prod(map(len, own)) > most:
        return None
    stated = np.stack(np.meshgrid(*own, indexing="ij"), -1).reshape(-1, space.n_agents)
    every = [
        space.becomes[way, np.arange(space.n_agents), stated[:, space.owner[way]]]
        for way in np.flatnonzero(np.isfinite(found.alpha))
    ]
    goals = np.unique(np.concatenate(every), axis=0)
    return goals[(goals >= 0).all(axis=1)].astype(np.int64)


def log_prior_of_effective(
    prior: Program, goals: NDArray[np.int64], strengths: Mapping[str, NDArray[np.float64]]
) -> FloatArray:
    """Return (row,) the log prior of effective goals (row, agent) with strengths [N], each (row,).

    Stated goals and ways to help or hinder are summed over.
    """
    if not isinstance(prior, WorldPrior):
        return effective.log_prior_of_effective(prior, goals, strengths)
    found, space = masses_of(prior), space_of_prior(prior)
    by_way = space.log_prior_of_effective(found.goals, found.alpha, goals)
    log_prior = np.logaddexp.reduce(by_way, axis=0)
    for name in space.strength_sites:
        law, newtons = found.trace[name]["fn"], jnp.asarray(strengths[name], jnp.float32)
        log_density = np.asarray(law.log_prob(newtons), np.float64)
        log_prior += np.where(np.asarray(law.support(newtons)), log_density, -np.inf)
    return np.asarray(log_prior)


def kept_prior(prior: Program) -> dict[str, tuple[tuple[str, ...], FloatArray]]:
    """Return what a file keeps of a prior over goals: name -> dimensions and values.

    In PHASE ``prior_of_pairs``; elsewhere ``log_prior_goals`` and ``log_prior_alpha``.
    """
    if not isinstance(prior, WorldPrior):
        return {"prior_of_pairs": (("pair_red", "pair_green"), effective.prior_of_pairs(prior))}
    found = masses_of(prior)
    return {
        "log_prior_goals": (("agent", "goal"), found.goals),
        "log_prior_alpha": (("way",), found.alpha),
    }


def drawn_stated(
    prior: Program,
    goals: NDArray[np.int64],
    strengths: NDArray[np.floating[Any]],
    seed: int | Sequence[int] = 0,
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return (row, agent + 1) stated goals and way for effective goals (row, agent).

    Drawn by the prior given these and strengths (row, agent), newtons; also (row,) the log of how
    probable that was.
    """
    if not isinstance(prior, WorldPrior):
        return effective.drawn_stated(prior, goals, strengths, seed)
    found, space, rng = masses_of(prior), space_of_prior(prior), np.random.default_rng(seed)
    by_way = space.log_prior_of_effective(found.goals, found.alpha, goals)
    # the largest of Gumbel-perturbed log weights is a draw in proportion to the weights
    way = (by_way + rng.gumbel(size=by_way.shape)).argmax(axis=0)
    stated, rows = np.array(goals, np.int64), np.arange(len(goals))
    total = np.logaddexp.reduce(by_way, axis=0)
    log_drawn = by_way[way, rows] - np.where(total > -np.inf, total, 0.0)
    for agent in range(space.n_agents):
        # the own goal of one that helps or hinders is not used
        share = softmax(found.goals[agent])
        unused = rng.choice(space.n_goals, len(goals), p=share)
        idle = space.owner[way, agent] != agent
        stated[idle, agent] = unused[idle]
        log_drawn[idle] += np.log(share[unused[idle]])
    return np.column_stack([stated, way]), log_drawn
