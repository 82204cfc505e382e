"""Samplers of NumPyro: any of real vectors, through one adapter, and composable Gibbs.

The adapter shows the model to a sampler as a potential on R^d. Hypothesis and simulator seed are
functions of uniform numbers u (``sites_at`` of :mod:`phase_ppl.models.program`), and
u = 1 / (1 + exp(-x)).
"""

from __future__ import annotations

import copy
import functools
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import random
from numpyro import handlers
from numpyro.infer import AIES, SA
from numpyro.infer.gibbs import DiscreteGibbs, Gibbs, discrete_latent_sites
from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.inference.kernels.metropolis import EventKernel, chosen, for_each, log_uniform
from phase_ppl.inference.registry import register_kernel
from phase_ppl.models.density import draw, trace_log_density
from phase_ppl.models.program import (
    IMPOSSIBLE_POTENTIAL,
    EventProgram,
    dimensions,
    in_steps,
    sites_at,
)
from phase_ppl.world.errors import InvalidSettingError

Found = tuple[dict[str, jax.Array], jax.Array, jax.Array]
"""A hypothesis, the seed of its simulation, and the errors (time,) of that, units."""


class SamplerState(NamedTuple):
    """State of one particle, or of all."""

    i: jax.Array
    z: dict[str, jax.Array]  # site -> value, the current hypothesis with any further sites
    sim_seed: jax.Array
    step_error: jax.Array  # (time,) errors of its simulation, units
    inner: Any  # state of NumPyro's sampler
    accepted: jax.Array  # whether the sampler moved in the last iteration
    n_accepted: jax.Array
    rng_key: jax.Array

    def after(self, inner: Any, moved: jax.Array, found: Found, rng_key: jax.Array) -> SamplerState:
        """Return the next state; after a failed simulation the hypothesis stays as it was."""
        moved &= jnp.isfinite(found[2]).all()
        z, sim_seed, error = chosen(moved, found, (self.z, self.sim_seed, self.step_error))
        n_accepted = self.n_accepted + moved
        return SamplerState(self.i + 1, z, sim_seed, error, inner, moved, n_accepted, rng_key)


# --- any sampler of real vectors ------------------------------------------------------------------


class NumpyroKernel(EventKernel):
    """Base of kernels that run a NumPyro sampler on real numbers that stand for a hypothesis.

    The inverse distribution functions of the prior's sites turn the numbers into a hypothesis,
    goals included. A subclass makes the sampler, in :meth:`sampler`. All particles are simulated
    together.

    Args:
        program: the event's program, of :func:`phase_ppl.program`.

    Raises:
        InvalidSettingError: a site of the prior has no inverse distribution function; or, when the
            kernel starts, an ensemble sampler has too few chains, or an odd number.
    """

    starts, moves = ("begun",), ("moved",)  # the sampler simulates from within
    is_population = True

    def __init__(self, program: EventProgram) -> None:
        super().__init__(program)
        # refuses sites that it cannot draw
        jax.eval_shape(self._sites, jax.ShapeDtypeStruct((self.dimensions,), jnp.float32))

    @abstractmethod
    def sampler(self) -> MCMCKernel:
        """Return NumPyro's sampler of points (dimension,), made with ``self.potential``."""

    @property
    def dimensions(self) -> int:
        """Length of a point: a number per site, and one for the simulator's seed."""
        return dimensions(self.program.model)

    def potential(self, point: jax.Array) -> jax.Array:
        """Return minus the log density of a point (dimension,), up to a constant."""
        error = self._simulated(point)[2]
        # the density of u is the same everywhere, that of x is du/dx = u (1 - u)
        volume = jax.nn.log_sigmoid(point) + jax.nn.log_sigmoid(-point)
        potential = -self.program.relative_log_likelihood(error) - volume.sum()
        return jnp.where(jnp.isfinite(potential), potential, IMPOSSIBLE_POTENTIAL)

    def begun(self, keys: jax.Array, _: Any) -> SamplerState:
        """Return the first state of all particles, drawn from the prior with ``keys``, (chain,)."""
        keys = for_each(lambda key: random.split(key, 3), keys)
        # starting points from the prior
        draw = functools.partial(random.logistic, shape=(self.dimensions,))
        sampler, inner = self._started(keys[:, 0], for_each(draw, keys[:, 1]))
        z, sim_seed, error = for_each(self._simulated, inner.z)
        none = jnp.zeros(len(keys), jnp.int32)
        inner = _by_chain(inner) if sampler.is_ensemble_kernel else inner
        return SamplerState(none, z, sim_seed, error, inner, none > 0, none, keys[:, 2])

    def moved(self, state: SamplerState) -> SamplerState:
        """Return the next state of all particles."""
        keys = for_each(random.split, state.rng_key)
        # a start makes the sampler ready; what it would simulate, the compiler leaves out
        sampler, _ = self._started(keys[:, 0], state.inner.z)
        if sampler.is_ensemble_kernel:
            inner = _by_chain(sampler.sample(_together(state.inner), (), {}))
        else:
            inner = sampler.sample(state.inner._replace(rng_key=keys[:, 0]), (), {})
        moved = (inner.z != state.inner.z).any(axis=1)
        found = for_each(self._simulated, inner.z)  # already simulated by the sampler
        after: SamplerState = for_each(SamplerState.after, state, inner, moved, found, keys[:, 1])
        return after

    def _started(self, keys: jax.Array, points: jax.Array) -> tuple[MCMCKernel, Any]:
        """Return the sampler, and its state at points (chain, dimension)."""
        with jax.ensure_compile_time_eval():  # NumPyro looks at the values of settings
            sampler = self.sampler()
        chains, n = points.shape
        if sampler.is_ensemble_kernel and (chains % 2 or chains < 2 * n):
            raise InvalidSettingError(
                f"chains={chains}: {type(sampler).__name__} moves {n} numbers here, the sites and "
                f"the simulator's seed, and needs an even number of chains, {2 * n} or more"
            )
        return sampler, sampler.init(keys, 0, points, (), {})

    def _simulated(self, point: jax.Array) -> Found:
        program, sites = self.program, self._sites(point)
        seed = program.seed_at(in_steps(jax.nn.sigmoid(point))[-1])
        return sites, seed, program.simulate(sites, program.log_prior(sites), seed)

    def _sites(self, point: jax.Array) -> dict[str, jax.Array]:
        """Return the hypothesis, with any further sites, that a point stands for."""
        return sites_at(self.program.model, in_steps(jax.nn.sigmoid(point)))


def _by_chain(state: Any) -> Any:
    """Return an ensemble's state with what its chains share, such as its key, once per chain."""
    shape = state.z.shape[:1]
    shared = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf, shape + np.shape(leaf)), state._replace(z=None)
    )
    return shared._replace(z=state.z)


def _together(state: Any) -> Any:
    """Undo :func:`_by_chain`."""
    return jax.tree.map(lambda leaf: leaf[0], state._replace(z=None))._replace(z=state.z)


@register_kernel("aies", validity="exact", any_length=True)
class EnsembleKernel(NumpyroKernel):
    """Affine-invariant ensemble sampling (Goodman, Weare 2010).

    The particles are an ensemble; each half moves along lines through the other half. An iteration
    is a stretch or a differential evolution move, at random. The number of chains must be even, and
    at least twice the number of sites, seed included: fewer might move in a subspace.
    """

    validity: ClassVar[str] = "exact"

    def sampler(self) -> AIES:
        moves = {AIES.DEMove(): 0.5, AIES.StretchMove(): 0.5}
        return AIES(potential_fn=self.potential, moves=moves)


_POOL: Final = 8  # points per number that moves


@register_kernel("sa", validity="consistent", any_length=True)
class SampleAdaptiveKernel(NumpyroKernel):
    """Sample Adaptive MCMC (Zhu 2019).

    Each particle has a pool of eight points for each site and the seed. The pool proposes a new
    point, which replaces one of its points. The draw of an iteration is a random point of the pool.
    The first points are simulated at the start, and it takes many iterations to replace them all.
    Small pools bias: on the tests' toy with a known posterior by a total variation of 0.05 with two
    points per site, below 0.015 with eight.
    """

    validity: ClassVar[str] = "consistent"

    @property
    def sims_at_start(self) -> int:
        """Simulations that the first pool of a particle takes."""
        return _POOL * self.dimensions

    def sampler(self) -> SA:
        return SA(potential_fn=self.potential, adapt_state_size=self.sims_at_start)

    def _started(self, keys: jax.Array, points: jax.Array) -> tuple[MCMCKernel, Any]:
        """Start a particle at a possible point of its pool, if there is one."""
        sampler, state = super()._started(keys, points)
        best = state.adapt_state.pes.argmin(axis=1)[:, None, None]
        best = jnp.take_along_axis(state.adapt_state.zs, best, axis=1)[:, 0]
        possible = state.potential_energy[:, None] < IMPOSSIBLE_POTENTIAL
        return sampler, state._replace(z=jnp.where(possible, state.z, best))


# --- Gibbs ----------------------------------------------------------------------------------------

SEED_SITE: Final = "_simulator_seed"  # uniform number that stands for the simulator's seed
_DRAWS: Final = 256
_STEP: Final = 0.5  # standard deviation of steps, in standard deviations of the prior


class WalkState(NamedTuple):
    """State of the block of real sites."""

    z: dict[str, jax.Array]  # site -> value
    log_density: jax.Array  # of the joint model, given the other block
    rng_key: jax.Array  # for the next step


class RandomWalk(MCMCKernel):
    """Random walk on all real sites together, with an occasional new simulator seed.

    Args:
        model: NumPyro program; Gibbs conditions it on the sites of other blocks.
        scale: site -> standard deviation of its steps.
    """

    sample_field = "z"

    def __init__(self, model: Callable[..., Any], scale: dict[str, Any]) -> None:
        self.model, self._scale = model, scale

    def wrap_model(self, wrapper: Any) -> RandomWalk:
        wrapped = copy.copy(self)
        wrapped.model = wrapper(self.model)
        return wrapped

    def get_constrain_fn(self, model_args: Any, model_kwargs: Any) -> Callable[[Any], Any]:
        """Return the identity: values are constrained."""
        return lambda values: values

    def init(
        self, rng_key: jax.Array, num_warmup: int, init_params: Any, args: Any, kwargs: Any
    ) -> WalkState:
        return WalkState(init_params, self._log_density(init_params, kwargs), rng_key)

    def refresh(self, state: WalkState, args: Any, kwargs: Any) -> WalkState:
        """Return the state with its density given what other blocks have done."""
        return state._replace(log_density=self._log_density(state.z, kwargs))

    def sample(self, state: WalkState, args: Any, kwargs: Any) -> WalkState:
        key, key_step, key_coin, key_seed, key_accept = random.split(state.rng_key, 5)
        proposed = {}
        for number, (name, value) in enumerate(sorted(state.z.items())):
            if name == SEED_SITE:
                fresh = random.uniform(key_seed, dtype=value.dtype)
                proposed[name] = jnp.where(random.bernoulli(key_coin), fresh, value)
            else:
                noise = random.normal(random.fold_in(key_step, number), value.shape, value.dtype)
                proposed[name] = value + self._scale[name] * noise
        log_density = self._log_density(proposed, kwargs)
        accepted = log_uniform(key_accept) < log_density - state.log_density
        z, log_density = chosen(accepted, (proposed, log_density), (state.z, state.log_density))
        return WalkState(z, log_density, key)

    def _log_density(self, values: Any, kwargs: Any) -> jax.Array:
        model = handlers.seed(handlers.substitute(self.model, values), random.key(0))
        total = trace_log_density(handlers.trace(model).get_trace(**kwargs))
        return jnp.where(jnp.isnan(total), -jnp.inf, total)


@register_kernel("gibbs", validity="exact", sims_per_step=4, any_length=True)
class GibbsKernel(EventKernel):
    """Gibbs sampling: random walks site by site.

    It updates the discrete sites one by one, in random order, then the real sites and the seed. The
    proposal for a discrete site is one of its other values, all equally likely; the simulator's
    seed stays. The target is the joint distribution of hypothesis and seed. An iteration takes one
    simulation for each discrete site and one for real sites and seed.

    Raises:
        InvalidSettingError: a discrete site's values are not 0, 1, ..., n.
    """

    validity = "exact"
    starts, moves = ("begun",), ("moved",)

    def __init__(self, program: EventProgram) -> None:
        super().__init__(program)
        self.sims_per_step  # noqa: B018  (refuses sites that it cannot update)

    @property
    def sims_per_step(self) -> int:
        """Simulations per step: one for each discrete element, and one for the rest."""
        shapes = self.program.model.sites
        return 1 + sum(int(np.prod(shapes[name])) for name in self._discrete())

    def _discrete(self) -> list[str]:
        """Return the discrete sites."""
        with jax.ensure_compile_time_eval():
            prior = handlers.seed(self.program.model.prior, random.key(0))
            trace = handlers.trace(prior).get_trace()
            found = []
            for name in self.program.model.sites:
                law = trace[name]["fn"]
                if not law.support.is_discrete:
                    continue
                listed = law.has_enumerate_support and not law.event_shape
                values = np.ravel(law.enumerate_support(False)) if listed else np.empty(0)
                if not len(values) or not np.array_equal(values, np.arange(len(values))):
                    raise InvalidSettingError(
                        f"kernel 'gibbs' cannot update site {name!r} ({type(law).__name__}): a "
                        "discrete site must be without event dimensions, with values 0, 1, ..., n"
                    )
                found.append(name)
        return found

    def _gibbs(self) -> Gibbs:
        program = self.program

        def joint() -> None:
            with handlers.trace() as trace:
                program.model.prior()
            sites = {name: trace[name]["value"] for name in program.model.sites}
            uniform = numpyro.sample(SEED_SITE, dist.Uniform())
            # checks the support of all sites, fixed by Gibbs or not
            log_prior = program.log_prior(sites)
            error = program.simulate(sites, log_prior, program.seed_at(uniform))
            log_likelihood = program.relative_log_likelihood(error)
            possible = jnp.isfinite(log_prior) & jnp.isfinite(log_likelihood)
            numpyro.factor("trajectory", jnp.where(possible, log_likelihood, -jnp.inf))

        blocks = [
            (DiscreteGibbs(joint, random_walk=True, modified=True), discrete_latent_sites),
            (RandomWalk(joint, self._scale()), None),
        ]
        return Gibbs(blocks)

    def _scale(self) -> dict[str, Any]:
        """Return the prior's standard deviations times the step."""
        with jax.ensure_compile_time_eval():
            keys = random.split(random.key(0), _DRAWS)
            draws = jax.vmap(lambda key: draw(self.program.model.prior, key))(keys)
            return {name: _STEP * values.std(axis=0) for name, values in draws.items()}

    def begun(self, key: jax.Array, given: dict[str, jax.Array] | None) -> SamplerState:
        key, key_sites, key_start = random.split(key, 3)
        sites = self.initial_sites(key_sites) if given is None else given
        uniform = random.uniform(key_start)
        inner = self._gibbs().init(key, 0, {**sites, SEED_SITE: uniform}, (), {})
        none = jnp.zeros((), jnp.int32)
        seed = self.program.seed_at(uniform)
        error = self.program.simulate(sites, self.program.log_prior(sites), seed)
        return SamplerState(none, sites, seed, error, inner, none > 0, none, key)

    def moved(self, state: SamplerState) -> SamplerState:
        key, key_inner, *key_blocks = random.split(state.rng_key, 4)
        gibbs = self._gibbs()
        gibbs.init(key_inner, 0, state.inner.z, (), {})  # makes it ready; simulates nothing
        blocks = tuple(
            block._replace(rng_key=key_block)
            for block, key_block in zip(state.inner.block_states, key_blocks, strict=True)
        )
        before = state.inner._replace(block_states=blocks, rng_key=key_inner)
        inner = gibbs.sample(before, (), {})
        sites = {name: inner.z[name] for name in state.z}
        moved = jnp.stack([jnp.any(inner.z[n] != state.inner.z[n]) for n in inner.z]).any()
        seed = self.program.seed_at(inner.z[SEED_SITE])
        error = self.program.simulate(sites, self.program.log_prior(sites), seed)
        return state.after(inner, moved, (sites, seed, error), key)
