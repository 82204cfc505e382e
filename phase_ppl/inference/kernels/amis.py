"""Adaptive multiple importance sampling: the proposal learns from all simulations so far.

For simulators that take milliseconds. Every draw weighs P(h) L / Q(h). Q is the mixture of all the
run's proposals, each weighted by its number of draws (Cornuet, Marin, Mira, Robert 2012). A
proposal has a table of alphas and goals, and a normal distribution of each agent's strength given
its effective goal. With a small weight it is the prior.

The first proposal is half bottom-up and half uniform over goals. So a misleading video costs half
the first draws. Later proposals are fitted to all simulations so far:

* Mean field: each agent's part of a simulation is compared with the video on its own. All others
  get their mean error in good simulations. So a simulation in which one agent follows the video is
  evidence about that agent, even if the other agent does not.
* The joint likelihoods of simulations of the same effective goals correct that.

Both likelihoods are raised to a power below 1, low enough for many simulations to count. The fit
affects how many simulations are needed, not what the answer is.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from numpy.typing import NDArray
from numpyro import handlers

from phase_ppl.analysis.estimate import kish_size
from phase_ppl.analysis.weights import log_sum_exp, normalised
from phase_ppl.inference.guide import Guide, Replaced, estimated, strength_distribution
from phase_ppl.inference.kernels.weighted import Importance
from phase_ppl.inference.registry import register_kernel
from phase_ppl.models.bridge import Record
from phase_ppl.models.density import Program, Sites, compiled_quickly, log_density, remembered
from phase_ppl.models.effective import WorldPrior, prior_table, space_of_prior
from phase_ppl.models.model import Model
from phase_ppl.models.program import effective_goals
from phase_ppl.models.sites import IMPOSSIBLE
from phase_ppl.models.world_priors import masses_of
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.space import ALPHA_SITE, HypothesisSpace

GROWTH: Final = 1.1
"""Growth of the number of draws, as a factor, after which the proposal is fitted again."""

EFFECTIVE: Final = 30.0
"""Effective simulations for each agent (Kish's size) to which the likelihood is tempered."""

POWER: Final = 0.8
"""Highest power of the likelihood; below 1, so that proposals are wider than the posterior."""

UNTRIED: Final = 0.2
"""Share of a proposal for untried goals: what single agents show need not hold for all of them
together."""

PSEUDO: Final = 0.5
"""Pseudo-count: number of simulations that the mean-field expectation counts for."""

WIDER: Final = 1.25
"""Factor by which proposed strengths are wider than the fitted ones."""

NARROWEST: Final = 10.0  # standard deviation of a proposed strength, newtons, at least
MOST_ENTRIES: Final = 2_000_000  # of the table of goals
_FEWEST: Final = 3  # draws for each goal before the first fit
_ROUNDS: Final = 5  # of the mean field
_ROWS: Final = 512  # densities that are evaluated at a time
_BISECTIONS: Final = 20
_RANGE: Final = STRENGTH_RANGE[1] - STRENGTH_RANGE[0]


class Proposal(NamedTuple):
    """The distribution that hypotheses are drawn from."""

    # log probabilities of the way and of each agent's stated goal, given the way and the goals of
    # the agents before: (way,), (way, goal), (way, goal, goal), ...
    goals: tuple[NDArray[Any], ...]
    strength: NDArray[Any]  # (agent, effective goal) mean, newtons; NaN: as in the prior
    strength_sd: NDArray[Any]  # likewise


def guide_of(
    prior: Program, sites: Mapping[str, tuple[int, ...]], proposal: Proposal, prior_share: float
) -> Guide:
    """Return the NumPyro program that draws from a proposal or, with its share, from the prior."""
    space = space_of_prior(prior)

    def fitted(_: Any) -> None:
        given: dict[str, jax.Array] = {}
        names = (ALPHA_SITE, *space.goal_sites)
        for name, logits in zip(names, proposal.goals, strict=True):
            law = dist.Categorical(logits=jnp.asarray(logits)[tuple(given.values())])
            given[name] = numpyro.sample(name, law)
        acts_on, replace = effective_goals(space, given), {}
        for agent, name in enumerate(space.strength_sites):
            known, normal = estimated(
                jnp.asarray(proposal.strength)[agent, acts_on[agent]],
                jnp.asarray(proposal.strength_sd)[agent, acts_on[agent]],
            )
            replace[name] = functools.partial(strength_distribution, known, normal)
        with (
            handlers.block(hide=list(given)),
            handlers.substitute(data=given),
            Replaced(replace, given),
        ):
            prior()

    programs = (fitted, lambda _: prior())
    return Guide(programs, (1 - prior_share, prior_share), sites)


@register_kernel(
    "amis",
    validity="consistent",
    needs=("guide", "settings"),
    keeps="start",
    weighted=True,
    any_length=True,
)
class AMIS(Importance):
    """Adaptive multiple importance sampling, for simulators that take milliseconds.

    The proposal learns from all simulations so far. Every draw is weighed by the mixture of all
    versions of the proposal. No simulation is stopped early.
    """

    adapts = True

    @property
    def guide(self) -> Guide:
        """The current proposal; only a run of ``infer`` fits it to its draws."""
        if self._guide is None:
            raise InvalidSettingError(
                "AMIS learns from a whole run: call phase_ppl.infer(event, kernel='amis')"
            )
        return super().guide

    def _draw(self, key: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
        return self.guide.draw(key, 0), jnp.asarray(-1, jnp.int32)

    def _log_proposal(self, sites: Sites) -> jax.Array:
        return self.guide.log_prob(sites, 0)


class Adaptation:
    """The proposals of a run, and the densities of its draws under all of them.

    Args:
        model: whose hypotheses are drawn.
        observed: (time, entity, 2) x, y, units.
        first: the first proposal.
        prior_share: of every proposal.
    """

    def __init__(
        self, model: Model, observed: FloatArray, first: Proposal, prior_share: float
    ) -> None:
        self._model, self._observed, self._share = model, observed, prior_share
        self._space = space_of_prior(model.prior)
        self._proposals = [first]
        self._made_by: list[int] = []  # which proposal drew each batch
        self._batches: list[Mapping[str, NDArray[Any]]] = []
        self._log_weights: list[FloatArray] = []  # under what drew each batch; -inf: failed
        self._simulated: list[_Simulated] = []
        shape = (self._space.n_goals,) * self._space.n_agents
        self._tried = np.zeros(shape, bool)  # (goal, ..., goal) effective ones, failed ones too
        self._fitted_to = 0

    @property
    def proposal(self) -> Proposal:
        """The current proposal."""
        return self._proposals[-1]

    def add(
        self, sites: Mapping[str, NDArray[Any]], log_weight: FloatArray, records: Sequence[Record]
    ) -> None:
        """Add a batch (chain, ...) of draws from the current proposal, and fit the next one."""
        self._made_by.append(len(self._proposals) - 1)
        self._batches.append(sites)
        self._log_weights.append(log_weight)
        if records:
            found = _Simulated.of(records, self._made_by[-1], self._observed, self._space)
            self._tried[tuple(found.goals.T)] = True
            done = np.array([record.result.completed for record in records])
            self._simulated.append(_Simulated(*(column[done] for column in found)))
        n = len(self._batches) * len(log_weight)
        known = any(len(one.goals) for one in self._simulated)
        if known and n >= max(GROWTH * self._fitted_to, _FEWEST * self._space.n_goals):
            self._fitted_to = n
            self._proposals.append(self._fitted())

    def log_weights(self) -> FloatArray:
        """Return (batch, chain) the log weights against the mixture of all proposals."""
        # a proposal without draws is no part of the mixture
        drawn = np.bincount(self._made_by)
        log_density = np.stack([self._evaluated(one) for one in self._proposals[: len(drawn)]])
        log_share = np.log(drawn / drawn.sum())
        log_mixture = np.logaddexp.reduce(log_share[:, None] + log_density, axis=0)
        made_by = np.repeat(self._made_by, len(self._log_weights[0]))
        own = log_density[made_by, np.arange(len(made_by))]
        found = np.concatenate(self._log_weights) + own - log_mixture
        return found.reshape(len(self._batches), -1)

    def _evaluated(self, proposal: Proposal) -> FloatArray:
        """Return (draw,) the log density of all draws under a proposal."""
        sites = tuple(self._model.sites.items())
        density = _density_of_proposals(self._model.prior, sites, self._share)
        columns = _joined(self._batches)
        n, found = len(next(iter(columns.values()))), []
        for first in range(0, n, _ROWS):
            rows = np.arange(first, first + _ROWS).clip(max=n - 1)
            given = {name: values[rows] for name, values in columns.items()}
            found.append(np.asarray(density(proposal, given), np.float64))
        return np.concatenate(found)[:n]

    def _fitted(self) -> Proposal:
        """Return the proposal fitted to all simulations so far."""
        space = self._space
        all_of = _Simulated(*map(np.concatenate, zip(*self._simulated, strict=True)))
        log_ratio = np.stack(
            [self._log_ratio(agent, all_of) for agent in range(space.n_agents)], axis=1
        )
        power, log_likelihood = self._mean_field(all_of, log_ratio)
        shape = space.n_agents, space.n_goals
        scores, strength = np.zeros(shape), np.full((2, *shape), np.nan)
        for agent in range(space.n_agents):
            goal = all_of.goals[:, agent]
            log_value = log_ratio[:, agent] + power * log_likelihood[:, agent]
            value = np.exp(log_value - log_value.max())
            n, total = np.bincount(goal, minlength=shape[1]), np.bincount(goal, value, shape[1])
            scores[agent] = np.log((total + PSEUDO * value.mean()) / (n + PSEUDO))
            strength[:, agent] = _strengths(goal, value, all_of.strengths[:, agent], shape[1])
        stated = _log_prior_of_stated(self._model.prior)
        acts_on = _acted_on(space)  # (agent, way, goal, ..., goal)
        expected = sum(scores[agent][acts_on[agent]] for agent in range(space.n_agents))
        log_value = log_ratio.sum(axis=1) + power * self._log_likelihood(
            np.sqrt(all_of.squares.sum(axis=2))
        )
        own = sum(scores[agent][all_of.goals[:, agent]] for agent in range(space.n_agents))
        table = stated + _corrected(expected, acts_on, all_of.goals, log_value, own, space)
        untried = np.where(self._tried[tuple(acts_on)], -np.inf, stated)
        if np.isfinite(untried).any():
            shares = np.log(1 - UNTRIED), np.log(UNTRIED)
            parts = zip(shares, (table, untried), strict=True)
            table = np.logaddexp(*(one + share - log_sum_exp(one) for share, one in parts))
        return Proposal(_chained(table), *strength.astype(np.float32))

    def _log_ratio(self, agent: int, all_of: _Simulated) -> FloatArray:
        """Return (row,) log P / Q of an agent's strength, given its effective goal."""
        from scipy.stats import truncnorm  # slow to import

        goal, newtons = all_of.goals[:, agent], all_of.strengths[:, agent]
        drawn = np.zeros((len(self._proposals), self._space.n_goals))
        np.add.at(drawn, (all_of.made_by, goal), 1.0)
        drawn /= drawn.sum(axis=0).clip(min=1.0)
        density = np.zeros(len(goal))
        for proposal, share in zip(self._proposals, drawn, strict=True):
            mean, sd = proposal.strength[agent, goal], proposal.strength_sd[agent, goal]
            known = ~np.isnan(mean)
            mean, sd = np.where(known, mean, 0.0), np.where(known, sd, 1.0)
            low, high = ((end - mean) / sd for end in STRENGTH_RANGE)
            normal = truncnorm.pdf(newtons, low, high, mean, sd)
            of_this = self._share / _RANGE + (1 - self._share) * np.where(known, normal, 1 / _RANGE)
            density += share[goal] * of_this
        return -np.log(density * _RANGE)

    def _mean_field(self, all_of: _Simulated, log_ratio: FloatArray) -> tuple[float, FloatArray]:
        """Return the power, and (row, agent) log likelihoods of each agent's part alone."""
        n_agents = self._space.n_agents
        squares = all_of.squares  # (row, time, entity)
        # before there is any weight, take the best quarter
        typical = np.quantile(squares, 0.25, axis=0)
        power, found = POWER, np.empty((len(squares), n_agents))
        for _ in range(_ROUNDS):
            weights = []
            for agent in range(n_agents):
                rest = typical.sum(axis=1) - typical[:, agent]
                found[:, agent] = self._log_likelihood(np.sqrt(squares[:, :, agent] + rest))
            power = min(_power_of(found[:, a], log_ratio[:, a]) for a in range(n_agents))
            for agent in range(n_agents):
                weights.append(normalised(log_ratio[:, agent] + power * found[:, agent]))
                typical[:, agent] = weights[-1] @ squares[:, :, agent]
            others = np.prod(np.array(weights) ** (1 / n_agents), axis=0)
            typical[:, n_agents:] = np.tensordot(others / others.sum(), squares[:, :, n_agents:], 1)
        return power, found

    def _log_likelihood(self, errors: FloatArray) -> FloatArray:
        """Return (row,) log likelihoods of errors (row, time), less the highest."""
        by_frame = np.asarray(self._model.error_likelihood.log_prob(errors), np.float64)
        total = by_frame.sum(axis=1)
        return np.asarray(np.nan_to_num(total - total.max(), nan=-np.inf, neginf=-1e6))


class _Simulated(NamedTuple):
    """The results of simulations."""

    made_by: NDArray[np.int64]  # (row,) which proposal drew each
    goals: NDArray[np.int64]  # (row, agent) effective ones
    strengths: FloatArray  # (row, agent) newtons
    squares: FloatArray  # (row, time, entity) squared distances from the video, units

    @classmethod
    def of(
        cls, records: Sequence[Record], made_by: int, observed: FloatArray, space: HypothesisSpace
    ) -> _Simulated:
        names = (ALPHA_SITE, *space.goal_sites, *space.strength_sites)
        sites = {name: np.array([record.sites[name] for record in records]) for name in names}
        # in a checkpoint's precision, so that a resumed run learns the same
        found = [record.result.trajectory[..., :2].astype(np.float32) for record in records]
        strengths = np.stack([sites[name] for name in space.strength_sites], axis=1)
        squares = ((np.array(found, np.float64) - observed) ** 2).sum(axis=3)
        squares[:, np.isnan(observed).any(axis=2)] = 0.0  # only what was seen is compared
        drawn_by = np.full(len(records), made_by)
        return cls(drawn_by, space.effective(sites).astype(np.int64), strengths, squares)


def first_proposal(suggested: NDArray[Any], prior: Program) -> Proposal:
    """Return the first proposal, given bottom-up logits (..., agent, goal).

    Raises:
        InvalidSettingError: there are too many combinations of goals for a table.
    """
    space = space_of_prior(prior)
    shape = (len(space.ways), *[space.n_goals] * space.n_agents)
    if math.prod(shape) > MOST_ENTRIES:
        raise InvalidSettingError(
            f"kernel 'amis' keeps a table of who helps whom and of all goals: {math.prod(shape)} "
            f"entries in {space.world.name!r}, at most {MOST_ENTRIES} are possible; take 'smc'"
        )
    share = np.exp(suggested - suggested.max(axis=-1, keepdims=True))
    logits = np.log(0.5 * share / share.sum(axis=-1, keepdims=True) + 0.5 / space.n_goals)
    table = _summed(np.broadcast_to(logits, (shape[0], space.n_agents, space.n_goals)))
    stated = _log_prior_of_stated(prior)
    # the video suggests own goals, not how probable each way is
    _, *goals = _chained(np.where(np.isfinite(stated), table, -np.inf))
    unknown = np.full((space.n_agents, space.n_goals), np.nan, np.float32)
    return Proposal((_chained(stated)[0], *goals), unknown, unknown)


def _summed(logits: FloatArray) -> FloatArray:
    """Return (way, goal, ..., goal) the sums of numbers (way, agent, goal) over the agents."""
    n_ways, n_agents, _ = logits.shape
    table = np.zeros([n_ways] + [1] * n_agents)
    for agent in range(n_agents):
        axes = [-1 if other == agent else 1 for other in range(n_agents)]
        table = table + logits[:, agent].reshape(n_ways, *axes)
    return np.asarray(table)


@remembered(16)
def _log_prior_of_stated(prior: Program) -> FloatArray:
    """Return (way, goal, ..., goal) log prior masses of the way and of all stated goals.

    -inf where somebody helps or hinders who cannot act on it: nothing of that is simulated.
    """
    if isinstance(prior, WorldPrior):
        found = masses_of(prior)
        goals = np.broadcast_to(found.goals, (len(found.alpha), *found.goals.shape))
        table = _summed(goals) + found.alpha.reshape(-1, *[1] * len(found.goals))
    else:
        table = prior_table(prior, (sum(STRENGTH_RANGE) / 2,))[..., 0, 0]
        table = np.moveaxis(table, -1, 0)
    possible = (_acted_on(space_of_prior(prior)) >= 0).all(axis=0)
    return np.where(possible, table, -np.inf)


def _acted_on(space: HypothesisSpace) -> NDArray[np.int64]:
    """Return (agent, way, goal, ..., goal) effective goals of ways and stated goals; -1: none."""
    shape = (len(space.ways), *[space.n_goals] * space.n_agents)
    names = (ALPHA_SITE, *space.goal_sites)
    columns = dict(zip(names, np.indices(shape).reshape(len(shape), -1), strict=True))
    return space.effective(columns).T.reshape(space.n_agents, *shape).astype(np.int64)


def _corrected(
    expected: FloatArray,
    acts_on: NDArray[np.int64],
    goals: NDArray[np.int64],
    log_value: FloatArray,
    own: FloatArray,
    space: HypothesisSpace,
) -> FloatArray:
    """Return the log of the expected likelihood of goals, corrected by their simulations.

    It is a root mean square over simulations of the same effective goals and ``PSEUDO`` expected
    ones. Draws in this proportion give a sum the least variance (Neyman), and untried goals come
    sooner than by their mean. ``own`` is the expectation for each simulation, (row,).
    """
    square = np.exp(2 * (log_value - log_value.max()))
    scale = np.log(square.sum()) - log_sum_exp(2 * own)
    shape = (space.n_goals,) * space.n_agents
    size, code = math.prod(shape), np.ravel_multi_index(tuple(goals.T), shape)
    n, total = np.bincount(code, minlength=size), np.bincount(code, square, size)
    # the prior excludes ways in which somebody cannot act
    of_all = np.ravel_multi_index(tuple(acts_on.clip(min=0)), shape)
    with np.errstate(divide="ignore"):  # goals that were not simulated
        sums = np.logaddexp(np.log(total[of_all]), np.log(PSEUDO) + scale + 2 * expected)
    return np.asarray(0.5 * (sums - np.log(n[of_all] + PSEUDO)))


def _joined(batches: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    return {name: np.concatenate([one[name] for one in batches]) for name in batches[0]}


def _chained(log_table: FloatArray) -> tuple[NDArray[Any], ...]:
    """Return log probabilities of each axis of a table given those before."""
    log_table = log_table - log_sum_exp(log_table)
    chained: list[NDArray[Any]] = []
    before: FloatArray = np.zeros(())
    for axes in range(1, log_table.ndim + 1):
        flat = log_table.reshape(*log_table.shape[:axes], -1)
        joint = np.logaddexp.reduce(flat, axis=-1)
        given = joint - np.where(np.isfinite(before), before, 0.0)[..., None]
        chained.append(np.maximum(given, IMPOSSIBLE).astype(np.float32))
        before = joint
    return tuple(chained)


def _strengths(
    goal: NDArray[np.int64], value: FloatArray, newtons: FloatArray, n_goals: int
) -> FloatArray:
    """Return ([mean, sd], goal) the strengths to propose for each goal; NaN: as in the prior."""
    overall = (value * newtons).sum() / value.sum()
    spread = (value * (newtons - overall) ** 2).sum() / value.sum()
    n, total = np.bincount(goal, minlength=n_goals), np.bincount(goal, value, n_goals)
    kept = PSEUDO * value.mean()
    mean = (np.bincount(goal, value * newtons, n_goals) + kept * overall) / (total + kept)
    square = (value * (newtons - mean[goal]) ** 2, (overall - mean) ** 2 + spread)
    variance = (np.bincount(goal, square[0], n_goals) + kept * square[1]) / (total + kept)
    # among few simulations none may be near the best fit
    variance = WIDER**2 * variance + (_RANGE / (n + 1)) ** 2
    found = np.stack([mean, np.maximum(np.sqrt(variance), NARROWEST)])
    return np.where(n > 1, found, np.nan)


def _power_of(log_likelihood: FloatArray, log_ratio: FloatArray) -> float:
    """Return the highest power, at most ``POWER``, that leaves ``EFFECTIVE`` rows (Kish)."""

    def is_enough(power: float) -> bool:
        return kish_size(normalised(log_ratio + power * log_likelihood)) >= EFFECTIVE

    low, high = 0.0, POWER
    if is_enough(high):
        return high
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if is_enough(middle) else (low, middle)
    return low


@remembered(16)
def _density_of_proposals(prior: Any, sites: tuple[tuple[str, Any], ...], share: float) -> Any:
    """Return compiled (proposal, sites (row, ...)) -> (row,) log density of that proposal."""

    def density(proposal: Proposal, rows: dict[str, jax.Array]) -> jax.Array:
        guide = guide_of(prior, dict(sites), proposal, share)
        return jax.vmap(lambda row: log_density(guide, row, 0))(rows)

    return compiled_quickly(density)
