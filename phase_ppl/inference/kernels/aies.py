"""Affine-invariant ensemble sampling (Goodman, Weare 2010), NumPyro's, on the uniformised model."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from numpyro.infer import AIES
from numpyro.infer.ensemble import AIESState, EnsembleSamplerState

from phase_ppl.inference.registry import register_kernel
from phase_ppl.inference.sampling.wrapped import UniformKernel
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError


class Ensemble(UniformKernel):
    """The particles are an ensemble, each half of which moves along lines through the other.

    An iteration is a stretch or a differential evolution move by chance. The sampler evaluates a
    current point anew; the bridge answers that from its records.

    Args:
        program: the model of an event.

    Raises:
        InvalidSettingError: a site has no inverse distribution function; when started: there
            are fewer than twice as many chains as sites, so that they might move in a subspace.
    """

    even_chains = True

    def start(self, keys: jax.Array, points: jax.Array) -> jax.Array:
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
        with jax.ensure_compile_time_eval():  # it looks at its weights
            sampler = AIES(
                potential_fn=self.uniform.potential,
                moves={AIES.DEMove(): 0.5, AIES.StretchMove(): 0.5},
            )
        sampler.init(keys, 0, inner)
        none = jnp.zeros(())
        state = EnsembleSamplerState(inner, AIESState(none, none, none, keys[0]), keys[1])
        return sampler.sample(state, (), {}).z

    def points(self, inner: jax.Array) -> jax.Array:
        """Return the points."""
        return inner


@register_kernel("aies", validity="exact", chain_methods=("vectorized",), even_chains=True)
def aies(program: EventProgram) -> Ensemble:
    """Affine-invariant ensemble sampling on the uniformised model."""
    return Ensemble(program)
