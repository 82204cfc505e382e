"""Samplers of NumPyro: composable Gibbs, site by site, and samplers of real vectors.

The latter see the model as a function of uniform numbers u (:mod:`phase_ppl.models.program`). They
move on the whole real line, u = 1 / (1 + exp(-x)).
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
from numpyro.infer.ensemble import AIESState, EnsembleSamplerState
from numpyro.infer.gibbs import DiscreteGibbs, Gibbs, discrete_latent_sites
from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.inference.kernels.metropolis import (
    EventKernel,
    chosen,
    for_each,
    log_uniform,
)
from phase_ppl.inference.registry import register_kernel
from phase_ppl.models.density import draw, trace_log_density
from phase_ppl.models.program import (
    IMPOSSIBLE_POTENTIAL,
    EventProgram,
    dimensions,
    in_steps,
    sites_at,
)
from phase_ppl.world.errors import InvalidSettingError, positive_number, whole_number

Found = tuple[dict[str, jax.Array], jax.Array, jax.Array]
"""The meaning of a point: sites, seed, and errors (time,) of the simulation, units."""


class WrappedState(NamedTuple):
    """State of one particle, or of all."""

    i: jax.Array
    z: dict[str, jax.Array]  # site -> value, the current hypothesis with any further sites
    sim_seed: jax.Array
    step_error: jax.Array  # (time,) errors of its simulation, units
    inner: Any  # state of the sampler, with an entry per particle in every array
    accepted: jax.Array  # whether the sampler moved in the last iteration
    n_accepted: jax.Array
    rng_key: jax.Array

    def after(self, inner: Any, moved: jax.Array, found: Found, rng_key: jax.Array) -> WrappedState:
        """Return the next state; after a failed simulation the hypothesis stays as it was.

        ``found`` is the meaning of the sampler's point; the bridge has simulated it already.
        """
        moved &= jnp.isfinite(found[2]).all()
        z, sim_seed, error = chosen(moved, found, (self.z, self.sim_seed, self.step_error))
        n_accepted = self.n_accepted + moved
        return WrappedState(self.i + 1, z, sim_seed, error, inner, moved, n_accepted, rng_key)


class UniformKernel(EventKernel):
    """Base of kernels that run a sampler of NumPyro on the model as a function of real numbers.

    Subclasses work on all particles together.

    Raises:
        InvalidSettingError: a site of the prior has no inverse distribution function.
    """

    validity: ClassVar[str] = "exact"
    starts, moves = ("begun",), ("moved",)  # samplers simulate from within
    is_population = True

    def __init__(self, program: EventProgram | None = None) -> None:
        super().__init__(program)
        if program is not None:  # refuses sites that it cannot draw
            jax.eval_shape(self._sites, jax.ShapeDtypeStruct((self.dimensions,), jnp.float32))

    @property
    def dimensions(self) -> int:
        """Length of a point: a number per site, and one for the seed unless noise is fixed."""
        return dimensions(self.program.model)

    def potential(self, point: jax.Array) -> jax.Array:
        """Return - log density of a point (dimension,), up to a constant."""
        error = self._simulated(point)[2]
        # the density of u is the same everywhere, that of x is du/dx = u (1 - u)
        volume = jax.nn.log_sigmoid(point) + jax.nn.log_sigmoid(-point)
        potential = -self.program.relative_log_likelihood(error) - volume.sum()
        return jnp.where(jnp.isfinite(potential), potential, IMPOSSIBLE_POTENTIAL)

    def begun(self, keys: jax.Array, _: Any) -> WrappedState:
        keys = for_each(lambda key: random.split(key, 3), keys)
        # starting points from the prior
        draw = functools.partial(random.logistic, shape=(self.dimensions,))
        inner = self.started_at(keys[:, 0], for_each(draw, keys[:, 1]))
        found: Found = for_each(self._simulated, self.points(inner))
        none = jnp.zeros(len(keys), jnp.int32)
        z, sim_seed, error = found
        return WrappedState(none, z, sim_seed, error, inner, none > 0, none, keys[:, 2])

    def moved(self, state: WrappedState) -> WrappedState:
        keys = for_each(random.split, state.rng_key)
        inner = self.advance(keys[:, 0], state.inner)
        moved = (self.points(inner) != self.points(state.inner)).any(axis=1)
        found = for_each(self._simulated, self.points(inner))  # already simulated by the sampler
        after: WrappedState = for_each(WrappedState.after, state, inner, moved, found, keys[:, 1])
        return after

    def _simulated(self, point: jax.Array) -> Found:
        program, sites = self.program, self._sites(point)
        # the number after the sites' is the seed's; with fixed noise there is none, nor a need
        seed = program.seed_at(in_steps(jax.nn.sigmoid(point))[-1], sites)
        return sites, seed, program.simulate(sites, program.log_prior(sites), seed)

    def _sites(self, point: jax.Array) -> dict[str, jax.Array]:
        """Return the hypothesis, with any further sites, that a point stands for."""
        return sites_at(self.program.model, in_steps(jax.nn.sigmoid(point)))

    @abstractmethod
    def started_at(self, keys: jax.Array, points: jax.Array) -> Any:
        """Return the sampler's state at the points (chain, dimension)."""

    @abstractmethod
    def advance(self, keys: jax.Array, inner: Any) -> Any:
        """Return the sampler's state after one iteration."""

    @abstractmethod
    def points(self, inner: Any) -> jax.Array:
        """Return (chain, dimension) the points at which the sampler is."""


@register_kernel("aies", validity="exact", even_chains=True, any_length=True)
class Ensemble(UniformKernel):
    """Affine-invariant ensemble sampling on the uniformised model.

    NumPyro's sampler (Goodman, Weare 2010): the particles are an ensemble; each half moves along
    lines through the other. An iteration is a stretch or a differential evolution move, at random.
    The sampler evaluates a current point anew; the bridge answers that from its records.

    Raises:
        InvalidSettingError: a site has no inverse distribution function; when started: there
            are fewer than twice as many chains as sites, so that they might move in a subspace.
    """

    even_chains = True

    def started_at(self, keys: jax.Array, points: jax.Array) -> jax.Array:
        """Return the points: they are the whole state."""
        chains, dimensions = points.shape
        if chains < 2 * dimensions:
            raise InvalidSettingError(
                f"chains={chains}: kernel 'aies' moves {dimensions} numbers here, the sites and "
                f"the simulator's seed, and needs twice as many chains, {2 * dimensions}"
            )
        return points

    def advance(self, keys: jax.Array, inner: jax.Array) -> Any:
        """Move one half of the ensemble, then the other."""
        with jax.ensure_compile_time_eval():  # AIES needs the values of its weights
            sampler = AIES(
                potential_fn=self.potential, moves={AIES.DEMove(): 0.5, AIES.StretchMove(): 0.5}
            )
        sampler.init(keys, 0, inner)
        none = jnp.zeros(())
        state = EnsembleSamplerState(inner, AIESState(none, none, none, keys[0]), keys[1])
        return sampler.sample(state, (), {}).z

    def points(self, inner: jax.Array) -> jax.Array:
        return inner


_POINTS_PER_SITE: Final = 8


@register_kernel("sa", validity="consistent", any_length=True)
class SampleAdaptive(UniformKernel):
    """Sample Adaptive MCMC on the uniformised model.

    NumPyro's sampler (Zhu 2019): a pool of points per particle proposes a new point, which replaces
    another. The draw of an iteration is a random point of the pool. The pool's points are simulated
    at the start, and it takes many iterations to leave them behind. With few points the sampler is
    biased: on the tests' toy model by a total variation of 0.05 with twice as many points as sites,
    and below 0.015 with eight times as many. Hence "consistent", and hence the default.

    Args:
        pool: points per particle; by default eight times the number of sites, the seed's
            included.

    Raises:
        InvalidSettingError: ``pool`` is below 2, or a site has no inverse distribution function.
    """

    validity = "consistent"

    def __init__(self, program: EventProgram | None = None, *, pool: int | None = None) -> None:
        super().__init__(program)
        self._pool = None if pool is None else whole_number("pool", pool, minimum=2)

    @property
    def sims_at_start(self) -> int:
        """Simulations that the first pool of a particle takes."""
        return _POINTS_PER_SITE * self.dimensions if self._pool is None else self._pool

    def started_at(self, keys: jax.Array, points: jax.Array) -> Any:
        """Simulate pools around the points."""
        state = self._sampler(keys, points)[1]
        # a particle starts at a possible point of its pool, if there is one
        zs, pes = state.adapt_state.zs, state.adapt_state.pes
        best = pes.argmin(axis=1)[:, None]
        possible = state.potential_energy < IMPOSSIBLE_POTENTIAL
        best_z = jnp.take_along_axis(zs, best[..., None], axis=1)[:, 0]
        best_pe = jnp.take_along_axis(pes, best, axis=1)[:, 0]
        return state._replace(
            z=jnp.where(possible[:, None], state.z, best_z),
            potential_energy=jnp.where(possible, state.potential_energy, best_pe),
        )

    def advance(self, keys: jax.Array, inner: Any) -> Any:
        """Propose one point per pool."""
        sampler, _ = self._sampler(keys, inner.z)  # which calls its init
        return sampler.sample(inner._replace(rng_key=keys), (), {})

    def points(self, inner: Any) -> Any:
        return inner.z

    def _sampler(self, keys: jax.Array, points: jax.Array) -> tuple[SA, Any]:
        sampler = SA(potential_fn=self.potential, adapt_state_size=self.sims_at_start)
        return sampler, sampler.init(keys, 0, points)


SEED_SITE: Final = "_simulator_seed"  # uniform number that stands for the simulator's seed
_DRAWS: Final = 256


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

    It updates the discrete sites one by one, in random order, then the real sites and the seed. A
    discrete site is proposed evenly from its other values, with the simulator's seed kept. The
    target is the joint law of hypothesis and seed. An iteration takes one simulation for each
    discrete site and one for the rest.

    Args:
        step: standard deviation of the steps of real sites, in standard deviations of the prior.

    Raises:
        InvalidSettingError: ``step`` is no positive number, or a discrete site's values are not
            0, 1, ..., n.
    """

    validity = "exact"
    starts, moves = ("begun",), ("moved",)

    def __init__(self, program: EventProgram | None = None, *, step: float = 0.5) -> None:
        super().__init__(program)
        self._step_size = positive_number("step", step)
        if program is not None:
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
        fresh = program.model.noise == "fresh"

        def joint() -> None:
            with handlers.trace() as trace:
                program.model.prior()
            sites = {name: trace[name]["value"] for name in program.model.sites}
            uniform = numpyro.sample(SEED_SITE, dist.Uniform()) if fresh else jnp.zeros(())
            # checks the support of all sites, fixed by Gibbs or not
            log_prior = program.log_prior(sites)
            error = program.simulate(sites, log_prior, program.seed_at(uniform, sites))
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
            return {name: self._step_size * values.std(axis=0) for name, values in draws.items()}

    def begun(self, key: jax.Array, given: dict[str, jax.Array] | None) -> WrappedState:
        key, key_sites, key_start = random.split(key, 3)
        sites = self.initial_sites(key_sites) if given is None else given
        uniform = random.uniform(key_start)
        start = dict(sites)
        if self.program.model.noise == "fresh":
            start[SEED_SITE] = uniform
        inner = self._gibbs().init(key, 0, start, (), {})
        none = jnp.zeros((), jnp.int32)
        seed = self.program.seed_at(uniform, sites)
        error = self.program.simulate(sites, self.program.log_prior(sites), seed)
        return WrappedState(none, sites, seed, error, inner, none > 0, none, key)

    def moved(self, state: WrappedState) -> WrappedState:
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
        seed = self.program.seed_at(inner.z.get(SEED_SITE, jnp.zeros(())), sites)
        error = self.program.simulate(sites, self.program.log_prior(sites), seed)
        return state.after(inner, moved, (sites, seed, error), key)
