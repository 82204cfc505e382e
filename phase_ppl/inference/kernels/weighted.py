"""Kernels whose draws have weights: importance sampling, and enumeration of every hypothesis."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from jax.scipy.special import logsumexp
from numpy.typing import NDArray
from numpyro import handlers

from phase_ppl.inference.kernels.metropolis import EventKernel, chosen, for_each
from phase_ppl.inference.registry import register_kernel
from phase_ppl.models.bridge import Request
from phase_ppl.models.density import NO_DENSITY, Sites, log_density
from phase_ppl.models.effective import (
    WorldPrior,
    cells,
    prior_table,
    space_of_prior,
    stated_hypotheses,
    upstream,
    within_support,
)
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram
from phase_ppl.models.world_priors import drawn_stated, effective_goals, log_prior_of_effective
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, number_or_nan, shown
from phase_ppl.world.hypothesis import STRENGTH_RANGE


class WeightedState(NamedTuple):
    """State of a particle that makes an independent, weighted draw in every iteration."""

    i: jax.Array
    # site -> value, the hypothesis drawn last with any further sites; an earlier one, at weight 0,
    # where the last could not be simulated
    z: dict[str, jax.Array]
    sim_seed: jax.Array
    log_weight: jax.Array  # of the draw, -inf where it could not be simulated
    window: jax.Array  # the window it was drawn from, by its first frame; -1 where there is none
    accepted: jax.Array  # whether the last draw could be simulated
    n_accepted: jax.Array
    rng_key: jax.Array

    @classmethod
    def before(
        cls, key: jax.Array, sites: dict[str, jax.Array], seed: jax.Array | int = 0
    ) -> WeightedState:
        """Return the state before the first draw."""
        none = jnp.zeros((), jnp.int32)
        seed = jnp.asarray(seed, jnp.int32)
        return cls(none - 1, sites, seed, none - jnp.inf, none - 1, none > 0, none, key)

    def after(
        self,
        key: jax.Array,
        sites: dict[str, jax.Array],
        seed: jax.Array,
        log_weight: jax.Array,
        simulated: jax.Array,
        window: jax.Array | int = -1,
    ) -> WeightedState:
        """Return the state after a draw; ``simulated`` says whether its simulation succeeded."""
        sites, seed = chosen(simulated, (sites, seed), (self.z, self.sim_seed))
        return WeightedState(
            self.i + 1,
            sites,
            seed,
            jnp.where(simulated, log_weight, -jnp.inf),
            jnp.asarray(window, jnp.int32),
            simulated,
            self.n_accepted + simulated,
            key,
        )


@register_kernel(
    "importance",
    validity="consistent",
    needs=("guide", "settings"),
    keeps="start",
    weighted=True,
    any_length=True,
)
class Importance(EventKernel):
    """Importance sampling from the guide's mixture over windows.

    Draws are independent, each with weight P(h) L / Q(h). Q is the even mixture of the bottom-up
    proposals from all windows and from the whole video. The share of the prior in the proposals
    makes Q cover the prior's support. No simulation is stopped early.
    """

    validity = "consistent"
    keeps = "start"
    weighted = True

    initial_tries = 1

    def propose_initial(self, key: jax.Array) -> dict[str, jax.Array]:
        return self._draw(key)[0]

    def _draw(self, key: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
        key_window, key_sites = random.split(key)
        window = random.randint(key_window, (), 0, self.n_windows + 1)
        return self.guide.draw(key_sites, window), window

    def start(
        self, key: jax.Array, key_start: jax.Array, sites: dict[str, jax.Array]
    ) -> tuple[Any, Request]:
        return self._drawn(None, key, key_start, sites, jnp.asarray(-1, jnp.int32))

    def started(self, known: Any, step_error: jax.Array) -> WeightedState:
        _, key, request, *_ = known
        before = WeightedState.before(key, request.sites, request.seed)
        return self.accept((before, *known[1:]), step_error)

    def propose(self, state: WeightedState) -> tuple[Any, Request]:
        """Make another draw, independent of those before."""
        key, key_sites, key_seed = random.split(state.rng_key, 3)
        return self._drawn(state, key, key_seed, *self._draw(key_sites))

    def _drawn(
        self, state: Any, key: jax.Array, key_seed: jax.Array, sites: Any, window: jax.Array
    ) -> tuple[Any, Request]:
        log_prior = self.program.log_prior(sites)
        request = Request(sites, log_prior, self.program.simulator_seed(key_seed))
        return (state, key, request, log_prior - self._log_proposal(sites), window), request

    def accept(self, known: Any, step_error: jax.Array) -> WeightedState:
        """Weigh the draw."""
        state, key, request, log_ratio, window = known
        log_weight = log_ratio + self.program.relative_log_likelihood(step_error)
        log_weight = jnp.where(jnp.isfinite(step_error).all(), log_weight, -jnp.inf)
        possible = jnp.isfinite(log_weight)
        return state.after(key, request.sites, request.seed, log_weight, possible, window)

    def _log_proposal(self, sites: Sites) -> jax.Array:
        """Return the log density with which a hypothesis is drawn."""
        windows = jnp.arange(self.most_windows + 1)  # and the whole observation
        by_window = jax.vmap(lambda window: self.guide.log_prob(sites, window))(windows)
        by_window = jnp.where(windows <= self.n_windows, by_window, -jnp.inf)
        log_count = jnp.asarray(np.log(np.arange(1, len(windows) + 1)), jnp.float32)
        return logsumexp(by_window) - log_count[self.n_windows]


# --- every hypothesis ----------------------------------------------------------------------------

_NEGLIGIBLE: Final = -60.0
"""Log prior relative to the highest, below which a hypothesis is left out. NumPyro gives a
probability of 0 a log of about -87."""

STRENGTHS: Final = (150.0, 300.0, 450.0, 600.0)  # grid of each agent's strength, newtons
MAX_SIMULATIONS: Final = 50_000


class Grid(NamedTuple):
    """Hypotheses that differ in effective goals or strengths."""

    # hypothesis site -> (row,). The stated goals and alpha are drawn from those that lead to the
    # row's effective goals, by their prior
    sites: dict[str, NDArray[Any]]
    # (row,) of effective goals and strengths, normalised over the rows
    log_prior: NDArray[np.float32]

    @property
    def size(self) -> int:
        return len(self.log_prior)


def hypothesis_grid(model: Model, strengths: Sequence[float]) -> Grid:
    """Return all effective goals of all agents with prior mass, times all strengths [N].

    A strength stands for all that are nearer to it than to any other, and has their prior mass. In
    other worlds than PHASE, and for grids beyond the range of strengths, it has the prior density
    at its value. In other worlds than PHASE, more than :data:`MAX_SIMULATIONS` are refused.
    """
    space = space_of_prior(model.prior)
    own = [name for name in model.sites if name not in space.sites]
    if own:
        raise InvalidSettingError(
            f"the prior's own sites {own} cannot be enumerated, only goals, alpha and strengths"
        )
    numbers = isinstance(strengths, Sequence) and not isinstance(strengths, str)
    if not (numbers and strengths and all(0 < number_or_nan(s) < np.inf for s in strengths)):
        raise InvalidSettingError(
            f"strengths={shown(strengths)}, expected a few positive numbers, newtons"
        )
    with jax.ensure_compile_time_eval():  # kernels may be made inside compiled code
        forces = tuple(float(value) for value in strengths)
        return _grid(model.prior, forces)


@functools.lru_cache(8)
def _grid(prior: Any, strengths: tuple[float, ...]) -> Grid:
    space = space_of_prior(prior)
    forces = np.array(list(itertools.product(strengths, repeat=space.n_agents)), np.float32)
    goals = effective_goals(prior, MAX_SIMULATIONS // len(forces))
    if goals is None:
        raise InvalidSettingError(
            f"{space.world.name!r} has so many combinations of goals that, with the strengths "
            f"{list(strengths)}, there are more than {MAX_SIMULATIONS} hypotheses"
        )
    # strengths vary slowest: a run that is cut short has seen all goals
    which = np.tile(np.arange(len(goals)), len(forces))
    force = np.repeat(forces, len(goals), axis=0)
    trace = handlers.trace(handlers.seed(prior, random.key(0))).get_trace()
    laws = [trace[name]["fn"] for name in space.strength_sites]
    low, high = STRENGTH_RANGE
    within = low <= min(strengths) and max(strengths) <= high
    in_cells = within and not any(law.support.is_discrete for law in laws)
    if in_cells and not isinstance(prior, WorldPrior):
        log_prior = _log_cells(prior, goals, strengths).ravel()
    else:
        columns = dict(zip(space.strength_sites, force.T.astype(np.float64), strict=True))
        log_prior = log_prior_of_effective(prior, goals[which], columns)
        depends = upstream(prior)
        for (name, newtons), law in zip(columns.items(), laws, strict=True):
            log_prior = log_prior + _log_newtons(law, newtons, cut=not depends[name])
    stated, _ = drawn_stated(prior, goals[which], force)
    sites = dict(zip(space.limits, stated.T.astype(np.int32), strict=True))
    sites |= dict(zip(space.strength_sites, force.T, strict=True))
    return _with_mass(prior, sites, log_prior, strengths)


def _log_cells(prior: Any, pairs: NDArray[np.int64], strengths: tuple[float, ...]) -> FloatArray:
    """Return (strength, strength, pair) log prior masses of effective goals and strengths.

    Masses are integrals: if strengths depend on each other, a density may be unbounded.
    """
    levels, place, count = np.unique(strengths, return_inverse=True, return_counts=True)
    masses = np.exp(prior_table(prior, tuple(levels.tolist())))
    stated = [stated_hypotheses()[red, green] for red, green in pairs.tolist()]
    by_pair = np.stack([masses[tuple(one.T)].sum(axis=0) for one in stated], axis=-1)
    each = (by_pair / np.multiply.outer(count, count)[..., None])[place[:, None], place]
    with np.errstate(divide="ignore"):  # of what the prior cannot have
        return np.asarray(np.log(each))


def _log_newtons(law: Any, strengths: NDArray[Any], cut: bool = True) -> FloatArray:
    """Return (row,) the log width, in newtons, of each strength's cell of the grid.

    Args:
        law: the strength's distribution in the prior.
        strengths: (row,) newtons, with repetitions as in the grid.
        cut: whether ``law`` has the same support in all hypotheses.
    """
    if law.support.is_discrete:
        return np.zeros(len(strengths))
    levels, index, count = np.unique(
        strengths.astype(np.float64), return_inverse=True, return_counts=True
    )
    ends = cells(levels)
    ends[[0, -1]] = min(ends[0], levels[0]), max(ends[-1], levels[-1])
    newtons = np.diff(within_support(law, ends) if cut else ends)
    with np.errstate(divide="ignore"):  # of what the prior cannot have
        return np.asarray(np.log(newtons * count.min() / count)[index])


def _with_mass(
    prior: Any, sites: dict[str, NDArray[Any]], log_prior: FloatArray, strengths: Sequence[float]
) -> Grid:
    """Return the grid without hypotheses that have no prior mass."""
    density = jax.jit(jax.vmap(functools.partial(log_density, prior)))(sites)
    keep = np.asarray(density) > NO_DENSITY  # checks the support, which NumPyro does not
    keep &= log_prior > np.max(log_prior, initial=-np.inf, where=keep) + _NEGLIGIBLE
    if not keep.any():
        raise InvalidSettingError(
            f"the prior has no mass on the strengths {list(strengths)}; give others that it has"
        )
    log_prior = log_prior[keep] - np.logaddexp.reduce(log_prior[keep])
    kept = {name: values[keep] for name, values in sites.items()}
    return Grid(kept, log_prior.astype(np.float32))


@register_kernel("enumerate", validity="consistent", keeps="start", weighted=True, any_length=True)
class Enumeration(EventKernel):
    """Enumeration of all agents' effective goals on a grid of strengths.

    Every hypothesis h is simulated, one after the other, and has weight P(h) L. The posterior is
    as good as the grid of strengths and, for a noisy simulator, the number of seeds: hence
    "consistent", not "exact". The particles share the work.

    Args:
        strengths: grid of each agent's strength, newtons. A strength of the grid stands for all
            strengths that are nearest to it. Under a uniform prior from 150 to 600 N the default
            four have prior 1/6, 1/3, 1/3 and 1/6. See :func:`hypothesis_grid`.

    Raises:
        InvalidSettingError: the prior cannot be enumerated, or takes too many simulations.
    """

    validity = "consistent"
    keeps = "start"
    weighted = True
    is_population = True  # which shares the work

    def __init__(
        self,
        program: EventProgram,
        *,
        strengths: Sequence[float] = STRENGTHS,
    ) -> None:
        super().__init__(program)
        self._strengths = strengths
        if self.n_simulations > MAX_SIMULATIONS:
            raise InvalidSettingError(
                f"the prior leaves {self.n_simulations} hypotheses with the strengths "
                f"{list(strengths)}, more than {MAX_SIMULATIONS} simulations"
            )

    @property
    def _grid(self) -> Grid:
        return hypothesis_grid(self.program.model, self._strengths)

    @property
    def n_simulations(self) -> int:
        """Number of simulations for all hypotheses."""
        return self._grid.size

    def n_iterations(self, chains: int) -> int:
        """Return how many iterations ``chains`` particles need after the initial ones."""
        return -(-self.n_simulations // chains) - 1

    def initial(self, keys: jax.Array, _: Any) -> tuple[Any, Request]:
        """Ask for the first hypotheses of all particles."""

        def before(key: jax.Array) -> WeightedState:
            return WeightedState.before(random.split(key, 3)[0], self._sites(jnp.zeros((), int)))

        return self.propose(for_each(before, keys))

    def started(self, known: Any, step_error: jax.Array) -> WeightedState:
        return self.accept(known, step_error)

    def propose(self, state: WeightedState) -> tuple[Any, Request]:
        """Ask for the next hypothesis of each particle, if there is one."""
        chains = len(state.i)
        numbers = (state.i + 1) * chains + jnp.arange(chains)
        asked: tuple[Any, Request] = for_each(self._asked, state, numbers)
        return asked

    def accept(self, known: Any, step_error: jax.Array) -> WeightedState:
        """Weigh the hypotheses."""

        def weighed(known: Any, error: jax.Array) -> WeightedState:
            state, key, row, request = known
            # relative to a simulation without any error
            likeness = self.program.relative_log_likelihood(error)
            log_weight = jnp.asarray(self._grid.log_prior)[row] + likeness
            possible = jnp.isfinite(error).all()
            return state.after(key, request.sites, request.seed, log_weight, possible)

        after: WeightedState = for_each(weighed, known, step_error)
        return after

    def _sites(self, row: jax.Array) -> dict[str, jax.Array]:
        return {name: jnp.asarray(values)[row] for name, values in self._grid.sites.items()}

    def _asked(self, state: WeightedState, number: jax.Array) -> tuple[Any, Request]:
        key, key_seed = random.split(state.rng_key)
        row = number % self._grid.size
        sites = self._sites(row)
        log_prior = jnp.where(number < self.n_simulations, self.program.log_prior(sites), -jnp.inf)
        request = Request(sites, log_prior, self.program.simulator_seed(key_seed))
        return (state, key, row, request), request
