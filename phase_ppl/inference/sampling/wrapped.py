"""NumPyro's own samplers as kernels of ours: what their points stand for, simulated."""

from __future__ import annotations

import copy
from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
from jax import random
from numpyro.infer.mcmc import MCMCKernel
from numpyro.util import is_prng_key

from phase_ppl.inference.sampling.particle import chosen
from phase_ppl.inference.sampling.uniform import At, Uniformised
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError


class WrappedState(NamedTuple):
    """State of one particle, or of all.

    Attributes:
        i: iterations so far.
        z: site -> value, the current hypothesis with any further sites.
        sim_seed: seed of its simulation.
        step_error: (time,) errors of its simulation, units.
        inner: state of the sampler, with an entry per particle in every array.
        accepted: whether the sampler moved in the last iteration.
        n_accepted: how often it did.
        rng_key: of the particle.
    """

    i: jax.Array
    z: dict[str, jax.Array]
    sim_seed: jax.Array
    step_error: jax.Array
    inner: Any
    accepted: jax.Array
    n_accepted: jax.Array
    rng_key: jax.Array


def settled(
    state: WrappedState,
    inner: Any,
    moved: jax.Array,
    found: tuple[dict[str, jax.Array], jax.Array, jax.Array],
    rng_key: jax.Array,
) -> WrappedState:
    """Return the next state; what could not be simulated leaves the hypothesis as it was.

    Args:
        state: the one before.
        inner: the sampler's next state.
        moved: whether the sampler moved.
        found: sites, seed and error of its point; the bridge has simulated it already.
        rng_key: for the next iteration.
    """
    moved &= jnp.isfinite(found[2]).all()
    z, sim_seed, error = chosen(moved, found, (state.z, state.sim_seed, state.step_error))
    n_accepted = state.n_accepted + moved
    return WrappedState(state.i + 1, z, sim_seed, error, inner, moved, n_accepted, rng_key)


class UniformKernel(MCMCKernel):
    """Base of kernels that run a sampler of NumPyro on the uniformised model.

    Subclasses work on all particles together.

    Args:
        program: the model of an event.

    Raises:
        InvalidSettingError: a site of the prior has no inverse distribution function.
    """

    validity: ClassVar[str] = "exact"
    sample_field: ClassVar[str] = "z"
    default_fields: ClassVar[tuple[str, ...]] = ("z",)

    def __init__(self, program: EventProgram | None = None) -> None:
        self._uniform = None if program is None else Uniformised(program)

    def bound_to(self, program: EventProgram) -> Self:
        """Return a copy of this kernel, with its own options, for another event."""
        bound = copy.copy(self)
        UniformKernel.__init__(bound, program)
        return bound

    @property
    def uniform(self) -> Uniformised:
        """The model over real vectors."""
        if self._uniform is None:
            raise InvalidSettingError(f"{type(self).__name__} has no program yet")
        return self._uniform

    @property
    def model(self) -> EventProgram:
        """The model of the event."""
        return self.uniform.program

    def init(self, rng_key: jax.Array, *_: Any, **__: Any) -> WrappedState:
        """Return the initial states of a batch of keys, or of one."""
        if is_prng_key(rng_key):
            return jax.tree.map(lambda leaf: leaf[0], self.init(rng_key[None]))
        keys = jax.vmap(lambda key: random.split(key, 3))(rng_key)
        inner = self.start(keys[:, 0], jax.vmap(self.uniform.draw)(keys[:, 1]))
        at = self._at(inner)
        none = jnp.zeros(rng_key.shape, jnp.int32)
        return WrappedState(none, at.sites, at.seed, at.error, inner, none > 0, none, keys[:, 2])

    def sample(
        self, state: WrappedState, model_args: Any = (), model_kwargs: Any = None
    ) -> WrappedState:
        """Return the states after one iteration."""
        return self._sample_fn(state)

    def get_diagnostics_str(self, state: WrappedState) -> str:
        """Return the share of iterations that moved, for NumPyro's progress bar."""
        return f"acc. rate={float(jnp.mean(state.n_accepted / jnp.maximum(state.i, 1))):.2f}"

    def _sample_fn(self, state: WrappedState) -> WrappedState:
        if is_prng_key(state.rng_key):
            whole = jax.tree.map(lambda leaf: leaf[None], state)
            return jax.tree.map(lambda leaf: leaf[0], self._sample_fn(whole))
        keys = jax.vmap(random.split)(state.rng_key)
        inner = self.advance(keys[:, 0], state.inner)
        moved = (self.points(inner) != self.points(state.inner)).any(axis=1)
        at = self._at(inner)
        found = at.sites, at.seed, at.error
        return jax.vmap(settled)(state, inner, moved, found, keys[:, 1])

    def _at(self, inner: Any) -> At:
        """Return what the points stand for; their simulations were paid for by the sampler."""
        return jax.vmap(self.uniform)(self.points(inner))

    @abstractmethod
    def start(self, keys: jax.Array, points: jax.Array) -> Any:
        """Return the sampler's state at the points (chain, dimension)."""

    @abstractmethod
    def advance(self, keys: jax.Array, inner: Any) -> Any:
        """Return the sampler's state after one iteration."""

    @abstractmethod
    def points(self, inner: Any) -> jax.Array:
        """Return (chain, dimension) the points at which the sampler is."""
