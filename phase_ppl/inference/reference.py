"""References that kernels are compared with: enumeration, or the exact sum of a table.

Enumeration simulates all effective goals g of the agents. Their mass is the mean over strengths
s ~ P(s) and simulator seeds w of

    P(g | s) L(g, s, w)

This takes a few simulations of all with prior mass, in PHASE some 1150 pairs under the paper's
prior, and no Markov chain. If the log likelihood of goals varies by several nats from seed to seed,
a mean of a few is a poor estimate. Tables from halves of the simulations measure this error.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import jax
import numpy as np
from jax import random
from numpy.typing import NDArray

from phase_ppl.analysis.comparison import (
    DISTANCES,
    Marginals,
    distances,
    marginals,
)
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.inference.settings import Budget
from phase_ppl.models.effective import space_of_prior
from phase_ppl.models.model import Model
from phase_ppl.models.program import MAX_SEED, EventProgram
from phase_ppl.models.world_priors import effective_goals, log_prior_of_effective
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    SimulationError,
    shown,
    whole_number,
)
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import RELATIONS, Hypothesis
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import HypothesisSpace, space_of

if TYPE_CHECKING:
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior

PER_PAIR: Final = 4  # simulations of each pair, unless more are asked for
MOST: Final = 10_000  # combinations of goals, of which all agents have one
SPLITS: Final = 3  # ways in which the simulations of a pair are parted into halves
_POOL: Final = 32  # draws of strengths, of which each pair takes a few
_NO_MASS: Final = -60.0  # log probability below which a pair is not simulated


class Enumeration(NamedTuple):
    """Posterior of the effective goals."""

    probability: FloatArray  # (goal of the first agent, of the second, ...), sum 1
    # (split, 2, goal, goal, ...) the same from either half of the simulations of each combination
    halves: FloatArray
    simulations: int  # how many were made


class Plan(NamedTuple):
    """The simulations that an enumeration will make."""

    space: HypothesisSpace
    goals: NDArray[np.int64]  # (row, agent) effective goals of all agents that have prior mass
    strengths: FloatArray  # (draw, agent) newtons, from the prior
    log_prior: FloatArray  # (row, draw) log P(goals | strengths)


def plan_enumeration(model: Model, seed: int = 0, most: float = MOST) -> Plan | None:
    """Return the goals that the prior of a model allows, with their probabilities.

    None: these are more than ``most`` combinations of goals. The prior is bound to its world.
    """
    space = space_of_prior(model.prior)
    every = effective_goals(model.prior, most)
    if every is None:
        return None
    possible = np.unique(every, axis=0)
    program = EventProgram(model, 0, 1)
    keys = random.split(random.key(seed), _POOL)
    drawn = jax.jit(jax.vmap(program.draw_prior))(keys)
    names = space.strength_sites
    strengths = np.stack([np.asarray(drawn[name], float) for name in names], axis=1)
    repeated = dict(zip(names, np.tile(strengths.T, len(possible)), strict=True))
    log_joint = log_prior_of_effective(model.prior, np.repeat(possible, _POOL, axis=0), repeated)
    log_joint = log_joint.reshape(len(possible), _POOL)
    log_prior = log_joint - np.logaddexp.reduce(log_joint, axis=0)
    kept = log_prior.max(axis=1) > _NO_MASS
    plan = Plan(space, possible[kept], strengths, log_prior[kept])
    return plan if len(plan.goals) <= most else None


def enumerate_goals(
    event: Event,
    model: Model,
    plan: Plan,
    *,
    per_pair: int = PER_PAIR,
    seed: int = 0,
    workers: int | None = None,
    executor: Executor | None = None,
) -> Enumeration:
    """Return the posterior of the effective goals by simulating all combinations of a plan.

    Each is simulated ``per_pair`` times (even, at most 32), every time with other strengths
    and another simulator seed.
    """
    rng = np.random.default_rng(seed)
    which = np.stack([rng.permutation(_POOL)[:per_pair] for _ in plan.goals])
    world, nobody = plan.space.world, (None,) * plan.space.n_agents
    hypotheses = [
        Hypothesis.coded(world, tuple(goals), nobody, tuple(plan.strengths[draw].tolist()))
        for goals, draws in zip(plan.goals.tolist(), which, strict=True)
        for draw in draws
    ]
    seeds = np.random.default_rng([seed, 1]).integers(0, MAX_SEED, len(hypotheses)).tolist()
    place = model.build_simulator(), event.scene, event.observation
    with Runner(*place, workers=workers, executor=executor) as runner:
        results = runner.run(hypotheses, seeds)
    errors = np.array([result.errors for result in results])
    usable = np.array([result.completed for result in results])
    if not usable.any():
        raise SimulationError(f"no simulation was completed; the first: {results[0].failure}")
    by_frame = model.error_likelihood.log_prob(np.where(usable[:, None], errors, 0.0))
    log_likelihood = np.asarray(by_frame).sum(axis=1)
    log_mass = np.where(usable, log_likelihood, -np.inf).reshape(which.shape)
    log_mass += np.take_along_axis(plan.log_prior, which, axis=1)
    return of_masses(plan.goals, log_mass, plan.space.n_goals)


def of_masses(
    goals: NDArray[np.int64], log_mass: FloatArray, n_goals: int = len(PHASE.goals)
) -> Enumeration:
    """Return the posterior of simulations, from all of them and from halves.

    ``log_mass`` is (row, repeat) of effective goals (row, agent), -inf for failed simulations.
    """
    weight = np.exp(log_mass - log_mass.max())
    rng = np.random.default_rng(0)
    halves = []
    for split in range(SPLITS):
        order = rng.permutation(log_mass.shape[1]) if split else np.arange(log_mass.shape[1])
        halves.append([_table(goals, weight[:, order[h::2]], n_goals) for h in (0, 1)])
    return Enumeration(_table(goals, weight, n_goals), np.array(halves), log_mass.size)


def _table(goals: NDArray[np.int64], weight: FloatArray, n_goals: int) -> FloatArray:
    """Return (goal, goal, ...) mean weights of simulations, failed ones 0, normalised."""
    table = np.zeros([n_goals] * goals.shape[1])
    table[tuple(goals.T)] = weight.mean(axis=1)
    total = table.sum()
    return table / total if total > 0 else table  # total 0: nothing was completed in this half


Halves: TypeAlias = tuple[Marginals, Marginals]  # what two halves of the same simulations say
Asked: TypeAlias = Posterior | str | tuple[str, Mapping[str, int]] | None
ENUMERATION: Final = "enumeration"
NONE: Final = "none"  # in place of a reference: there is none
LONG: Final = 10  # how many times the budget enumeration may take where nothing is asked for


@dataclasses.dataclass(frozen=True)
class Reference:
    """The requested reference: a posterior, enumeration, or none."""

    budget: Budget  # what it may take
    given: Posterior | None = None
    enumeration: bool = False  # whether goals are enumerated, if the budget suffices
    at_any_cost: bool = False  # whether they are even if it does not
    per_pair: int = PER_PAIR  # simulations of each pair of goals, where these are enumerated

    @classmethod
    def asked_for(cls, reference: Asked, event: Event, budget: Budget) -> Reference:
        """Return the meaning of a comparison's argument ``reference``."""
        if isinstance(reference, Posterior):
            if not np.array_equal(reference.observed(), event.observation.trajectory):
                raise InvalidEventError(
                    f"the reference is of {reference.event_id}, another event than {event.id}"
                )
            return cls(budget, given=reference)
        if reference == NONE:
            return cls(budget)
        if reference is None:
            long = dataclasses.replace(budget, amount=LONG * budget.amount)
            return cls(long, enumeration=True)
        given = reference if isinstance(reference, tuple) else (reference, {"per_pair": PER_PAIR})
        if given[:1] != (ENUMERATION,):
            raise InvalidSettingError(
                f"reference={shown(reference)}, expected {ENUMERATION!r}, {NONE!r} or a posterior, "
                "such as infer(event, model, kernel=...)"
            )
        each = _per_pair(given)
        return cls(budget, enumeration=True, at_any_cost=True, per_pair=each)

    def record(self) -> Any:
        """Return the request as it is stored."""
        if self.given is not None:
            digest = hashlib.sha256()
            for probabilities in marginals(self.given).values():
                digest.update(probabilities.round(9).tobytes())
            return {"posterior": digest.hexdigest()[:16]}
        if self.at_any_cost:
            more = {} if self.per_pair == PER_PAIR else {"per_pair": self.per_pair}
            return [ENUMERATION, more] if more else ENUMERATION
        return {"enumeration within": str(self.budget)} if self.enumeration else NONE


def _per_pair(reference: tuple[Any, ...]) -> int:
    """Return n of ``("enumeration", {"per_pair": n})``, checked."""
    options = reference[1] if len(reference) == 2 else None
    if not isinstance(options, Mapping) or set(options) != {"per_pair"}:
        raise InvalidSettingError(
            f'reference={shown(reference)}, expected ("enumeration", {{"per_pair": n}})'
        )
    number = whole_number("per_pair", options["per_pair"])
    if number % 2 or number > _POOL:
        raise InvalidSettingError(
            f"per_pair={number}, expected an even number of at most {_POOL}: halves are compared"
        )
    return number


def reference_of(
    asked: Reference,
    event: Event,
    model: Model,
    read: ClosedLoopPosterior | None,
    seed: int,
    workers: int | None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Return the reference: ``description``, ``marginals``, ``simulations``, ``error``.

    ``error`` is the total variation between the marginals of two halves of the simulations or of
    the chains: ``tv_goals`` (mean of both agents) and ``tv_relation``. The error of the whole is
    smaller: half of this where errors are small, three quarters where single simulations decide. It
    omits errors that all simulations share, such as a mode that none found.
    ``error`` is None without halves; marginals are None without a reference. ``read`` is a result
    of the closed loop, if kernels sample its table: then the reference is exact.
    """

    def said(
        description: str,
        found: Mapping[str, Any] | None,
        simulations: int,
        halves: Sequence[Halves],
        exact: bool = False,
    ) -> dict[str, Any]:
        return {
            "description": description,
            "marginals": None if found is None else dict(found),
            "simulations": simulations,
            "error": dict.fromkeys(DISTANCES, 0.0) if exact else error_of(halves),
        }

    if asked.enumeration and read is not None:
        exact = read.with_prior(model.prior)
        words = "the exact sum over the table that the closed loop has read"
        return said(words, marginals(exact), 0, [], exact=True)
    if asked.enumeration:
        each, most = asked.per_pair, MOST if asked.at_any_cost else _affordable(asked, event)
        bound = model.in_world(event.scene, event.observation)
        plan = plan_enumeration(bound, seed, most)
        if plan is None and asked.at_any_cost:
            raise InvalidSettingError(
                f"{event.scene.world.name!r} has too many combinations of goals for a reference by "
                f"enumeration, which takes {MOST}: expected a posterior or {NONE!r}"
            )
        if plan is not None:
            options: dict[str, Any] = {"seed": seed, "workers": workers, "executor": executor}
            found = enumerate_goals(event, bound, plan, per_pair=each, **options)
            of = "pairs" if plan.space.n_agents == 2 else "combinations"
            words = f"enumeration of {len(plan.goals)} {of} of goals, {each} simulations each"
            world = plan.space.world
            halves = [(of_goals(one, world), of_goals(two, world)) for one, two in found.halves]
            return said(words, of_goals(found.probability, world), found.simulations, halves)
    if asked.given is not None:
        post = asked.given
        words = f"a given posterior ({post.tree.attrs['kernel']}, weights {post.weights})"
        return said(words, marginals(post), int(post.cost["simulations"]), _halves_of(post))
    return said("none", None, 0, [])


def _affordable(asked: Reference, event: Event) -> float:
    """Return how many combinations of goals can be simulated within the budget."""
    n_frames = event.observation.n_frames
    each = {"simulations": 1.0, "frames": n_frames, "seconds": math.inf}[asked.budget.unit]
    return min(MOST, asked.budget.amount / (each * asked.per_pair))


def of_goals(probability: FloatArray, world: World = PHASE) -> dict[str, FloatArray]:
    """Return the marginals of a table (goal of the first agent, of the second, ...)."""
    space = space_of(world)
    agents = set(range(space.n_agents))
    found = {
        name: probability.sum(axis=(*(agents - {agent}),))
        for agent, name in enumerate(space.goal_sites)
    }
    for name, pair in space.relation_names.items():
        joint = probability.sum(axis=(*(agents - {*pair}),))
        codes = space.relations[pair].ravel()
        found[name] = np.bincount(codes, joint.ravel(), len(RELATIONS))
    return found


def _halves_of(post: Posterior) -> list[Halves]:
    """Return the marginals of halves of the chains; none with fewer than two."""
    n_chains = post.tree["posterior"].sizes["chain"]
    if n_chains < 2 or post.weights != "count":
        return []

    def of(chains: slice) -> Marginals:
        part = post.tree.isel(chain=chains, missing_dims="ignore")
        return marginals(Posterior(part, post.weights))

    middle = n_chains // 2
    halves = (slice(middle), slice(middle, None)), (slice(0, None, 2), slice(1, None, 2))
    return [(of(one), of(other)) for one, other in halves]


def error_of(halves: Sequence[Halves]) -> dict[str, float] | None:
    """Return the mean distances between halves, see :func:`reference_of`; None without halves."""
    if not halves:
        return None
    apart = [distances(one, other) for one, other in halves]
    return {name: float(np.mean([one[name] for one in apart])) for name in apart[0]}
