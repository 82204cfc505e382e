"""What our kernels share: batches of particles, and stopping simulations early."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Final, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax, random
from numpyro.infer.mcmc import MCMCKernel
from numpyro.util import is_prng_key

from phase_ppl.inference.proposals.guide import Mixture
from phase_ppl.inference.proposals.tables import window_count
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.models.density import NO_DENSITY, Program, draw
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError

_SLACK: Final = 0.01
_RELATIVE_SLACK: Final = 1e-5


class EventKernel(MCMCKernel):
    """Base of our kernels: bound to the model of an event, and moving all particles together.

    Their simulations reach the runner in one call (``chain_method="vectorized"``). States hold
    constrained values, so nothing is replayed after the run; beside what the registry asks for they
    have ``n_accepted``, how many of ``i`` iterations changed the hypothesis, or could be simulated.
    The proposal program ``guide(window)`` counts windows by their first frame; the index after the
    last one stands for the whole observation.
    """

    sample_field: ClassVar[str] = "z"

    def __init__(
        self,
        program: EventProgram | None = None,
        guide: Program | None = None,
        settings: SimpleSettings | None = None,
    ) -> None:
        self._program = program
        self._guide = guide
        self.settings = SimpleSettings() if settings is None else settings

    def bound_to(self, program: EventProgram, guide: Program, settings: SimpleSettings) -> Self:
        """Return a copy of this kernel, with its own options, for another event."""
        bound = copy.copy(self)
        EventKernel.__init__(bound, program, guide, settings)
        return bound

    @property
    def program(self) -> EventProgram:
        if self._program is None:
            raise InvalidSettingError(f"{type(self).__name__} has no program yet")
        return self._program

    @property
    def guide(self) -> Program:
        if self._guide is None:
            raise InvalidSettingError(f"{type(self).__name__} needs a guide")
        return self._guide

    def init(
        self,
        rng_key: jax.Array,
        num_warmup: int,
        init_params: dict[str, jax.Array] | None = None,
        model_args: tuple[Any, ...] = (),
        model_kwargs: dict[str, Any] | None = None,
    ) -> Any:
        """Return the initial state of the particle, or of a batch where ``rng_key`` is one.

        ``init_params`` is the hypothesis to start from, by default what the kernel proposes; the
        other arguments are ignored: nothing is tuned, and the program knows its event.
        """
        if is_prng_key(rng_key):
            one = rng_key, init_params
            return as_batch_of_one(lambda batch: jax.jit(self._start)(*batch), one)
        return jax.jit(self._start)(rng_key, init_params)

    def sample(self, state: Any, model_args: Any = (), model_kwargs: Any = None) -> Any:
        return self._sample_fn(state)

    def _sample_fn(self, state: Any) -> Any:
        """Move one particle or a batch; NumPyro looks for this name, to see if init is due."""
        if is_prng_key(state.rng_key):
            return as_batch_of_one(self._step, state)
        return self._step(state)

    @abstractmethod
    def _start(self, keys: jax.Array, sites: dict[str, jax.Array] | None) -> Any:
        """Return the initial state of a batch of particles."""

    @abstractmethod
    def _step(self, state: Any) -> Any:
        """Return the state of a batch of particles after one iteration."""

    def get_diagnostics_str(self, state: Any) -> str:
        """Return the share of accepted proposals, for NumPyro's progress bar."""
        return f"acc. rate={float(jnp.mean(state.n_accepted / jnp.maximum(state.i, 1))):.2f}"

    def lenient(self, log_floor: jax.Array) -> jax.Array:
        """Return a log likelihood a little lower, since both it and simulations are rounded."""
        return log_floor - _SLACK - _RELATIVE_SLACK * jnp.abs(log_floor)

    def error_ceiling(self, log_floor: jax.Array) -> jax.Array:
        """Return the summed error [units] beyond which the log likelihood cannot reach a floor.

        A lenient one, so that no simulation is stopped which would have been accepted.
        """
        floor = self.lenient(log_floor)
        # without a floor, as before a first completed simulation, there is no ceiling either
        floor = jnp.where(jnp.isfinite(floor), floor, -jnp.inf)
        n_frames: Any = self.program.observed  # perhaps known only inside compiled code
        return self.program.likelihood.max_total_error(floor, n_frames)

    @property
    def n_windows(self) -> Any:
        """How many windows the observation has: a number, or an array of one if it is padded."""
        if not self.program.is_padded:
            return self.most_windows
        return jnp.maximum(self.program.observed - self.settings.window, 1)

    @property
    def most_windows(self) -> int:
        """How many windows the arrays have room for."""
        return window_count(self.program.n_frames, self.settings.window)

    def draw_guide(self, key: jax.Array, window: jax.Array | int) -> dict[str, jax.Array]:
        """Return a hypothesis from the guide."""
        if isinstance(self.guide, Mixture):
            return self.guide.draw(key, jnp.asarray(window))
        return draw(self.guide, key, jnp.asarray(window))


class ParticleKernel(EventKernel):
    """Base of kernels whose particles do not notice each other: how one starts, and moves."""

    initial_tries: ClassVar[int] = 16
    """Initial hypotheses drawn per particle, of which the first with prior mass is taken; 1 where
    the draw is weighed, since the best of several has another density."""

    def _start(self, keys: jax.Array, sites: dict[str, jax.Array] | None) -> Any:
        return jax.vmap(self._init)(keys, sites)

    def _init(self, key: jax.Array, sites: dict[str, jax.Array] | None) -> Any:
        key, key_sites, key_start = random.split(key, 3)
        start = self._initial_sites(key_sites) if sites is None else sites
        return _strongly_typed(self.start_one(key, key_start, start))

    def _step(self, state: Any) -> Any:
        return jax.vmap(self.step_one)(state)

    def _initial_sites(self, key: jax.Array) -> dict[str, jax.Array]:
        """Return the first of some initial hypotheses that has prior mass.

        A window may suggest what a user's prior excludes; the last try is from the prior itself.
        """
        if self.initial_tries == 1:
            return self.propose_initial(key)
        keys = random.split(key, self.initial_tries)
        tries = jax.vmap(self.propose_initial)(keys[1:])
        last = self.program.draw_prior(keys[0])
        tries = {
            name: jnp.append(values, last[name][None].astype(values.dtype), axis=0)
            for name, values in tries.items()
        }
        possible = jax.vmap(self.program.log_prior)(tries) > NO_DENSITY
        return {name: values[jnp.argmax(possible)] for name, values in tries.items()}

    def propose_initial(self, key: jax.Array) -> dict[str, jax.Array]:
        """Return a hypothesis to start from; by default from the prior."""
        return self.program.draw_prior(key)

    @abstractmethod
    def start_one(self, key: jax.Array, key_start: jax.Array, sites: dict[str, jax.Array]) -> Any:
        """Simulate the initial hypothesis of one particle; return its state, which has ``key``."""

    @abstractmethod
    def step_one(self, state: Any) -> Any:
        """Return the state of one particle after one iteration."""


def log_uniform(key: jax.Array) -> jax.Array:
    """Return the log of a uniform random number, never -inf."""
    return -random.exponential(key)


def chosen(accepted: jax.Array, new: Any, old: Any) -> Any:
    """Return ``new`` where accepted, else ``old``, for whole trees of arrays."""
    return jax.tree.map(lambda a, b: jnp.where(accepted, a, b), new, old)


def as_batch_of_one(function: Callable[[Any], Any], tree: Any) -> Any:
    """Return what a function of a batch makes of a single one, as a single one."""
    return jax.tree.map(lambda leaf: leaf[0], function(jax.tree.map(lambda leaf: leaf[None], tree)))


def _strongly_typed(state: Any) -> Any:
    """Strip weak types, with which the step would be compiled twice."""

    def strip(leaf: jax.Array) -> jax.Array:
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            return leaf
        return lax.convert_element_type(leaf, np.dtype(leaf.dtype))

    return jax.tree.map(strip, jax.tree.map(jnp.asarray, state))
