"""NumPyro's composable Gibbs, site by site."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import random
from numpyro import handlers
from numpyro.infer.gibbs import DiscreteGibbs, Gibbs, discrete_latent_sites
from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.inference.kernels.metropolis import EventKernel, chosen, log_uniform
from phase_ppl.inference.registry import register_kernel
from phase_ppl.models.density import draw, trace_log_density
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError


class GibbsState(NamedTuple):
    """State of one particle."""

    i: jax.Array
    z: dict[str, jax.Array]  # site -> value, the current hypothesis with any further sites
    sim_seed: jax.Array
    step_error: jax.Array  # (time,) errors of its simulation, units
    inner: Any  # state of NumPyro's sampler
    accepted: jax.Array  # whether the sampler moved in the last iteration
    n_accepted: jax.Array
    rng_key: jax.Array


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

    It updates the discrete sites one by one, in random order, then the real sites and the seed. A
    discrete site is proposed evenly from its other values, with the simulator's seed kept. The
    target is the joint law of hypothesis and seed. An iteration takes one simulation for each
    discrete site and one for the rest.

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
            return {name: _STEP * values.std(axis=0) for name, values in draws.items()}

    def begun(self, key: jax.Array, given: dict[str, jax.Array] | None) -> GibbsState:
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
        return GibbsState(none, sites, seed, error, inner, none > 0, none, key)

    def moved(self, state: GibbsState) -> GibbsState:
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
        moved &= jnp.isfinite(error).all()  # after a failed simulation the hypothesis stays
        now, before_it = (sites, seed, error), (state.z, state.sim_seed, state.step_error)
        z, sim_seed, error = chosen(moved, now, before_it)
        n_accepted = state.n_accepted + moved
        return GibbsState(state.i + 1, z, sim_seed, error, inner, moved, n_accepted, key)
