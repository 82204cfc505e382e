"""The likelihood of an observed trajectory given a simulated one.

The paper's P(s | h) = exp(-beta sum_t ||s_t - s^_t||) (Eq. 1), as a proper density: per frame a
radial distribution on R^d, d = 2 x 4 entities, with density exp(-beta ||x||) / Z. The posterior
is the same; the normaliser makes predictive checks and calibration possible.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from numpyro.distributions import Distribution, constraints

from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.names import ENTITIES

DIMENSION: Final = 2 * len(ENTITIES)
"""Numbers per frame: x, y of every entity."""

Number = TypeVar("Number", float, jax.Array, np.ndarray)


def log_normaliser(beta: float, dimension: int = DIMENSION) -> float:
    """Return log Z of exp(-beta ||x||) on R^dimension."""
    d = dimension
    return (
        math.log(2)
        + d / 2 * math.log(math.pi)
        - math.lgamma(d / 2)
        + math.lgamma(d)
        - d * math.log(beta)
    )


@dataclasses.dataclass(frozen=True)
class RadialLikelihood:
    """Independent radial errors in every frame.

    Attributes:
        beta: inverse scale, per unit of length; the paper's 0.05 is a tempered likelihood: it
            is the density of errors with a mean of dimension / beta = 160 units per frame.

    Raises:
        InvalidSettingError: beta is not a positive number.
    """

    beta: float = 0.05

    def __post_init__(self) -> None:
        if not (math.isfinite(self.beta) and self.beta > 0):
            raise InvalidSettingError(f"beta={self.beta!r}, expected a number > 0")

    def log_prob(self, total_error: Number, n_frames: int) -> Number:
        """Return the log likelihood of ``n_frames`` frames whose errors sum to ``total_error``.

        Args:
            total_error: sum over frames of ||s_t - s^_t||, units; any shape.
            n_frames: T.
        """
        return -self.beta * total_error - n_frames * log_normaliser(self.beta)

    def max_total_error(self, log_floor: Number, n_frames: int) -> Number:
        """Return the summed error beyond which the log likelihood falls below ``log_floor``."""
        return -(log_floor + n_frames * log_normaliser(self.beta)) / self.beta

    def to_dict(self) -> dict[str, Any]:
        return {"name": "radial", "beta": self.beta}


class RadialTrajectory(Distribution):
    """Distribution of an observed trajectory around a simulated one.

    Args:
        simulated: (time, dimension) positions, units.
        beta: as in :class:`RadialLikelihood`.
    """

    arg_constraints = {"simulated": constraints.real_matrix, "beta": constraints.positive}  # noqa: RUF012
    support = constraints.real_matrix

    def __init__(
        self, simulated: jax.Array, beta: float = 0.05, *, validate_args: bool | None = None
    ) -> None:
        self.simulated = jnp.asarray(simulated)
        self.beta = beta
        super().__init__((), self.simulated.shape, validate_args=validate_args)

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Draw trajectories (*sample_shape, time, dimension)."""
        key_direction, key_radius = random.split(key)
        shape = (*sample_shape, *self.event_shape)
        direction = random.normal(key_direction, shape)
        direction /= jnp.linalg.norm(direction, axis=-1, keepdims=True)
        radius = random.gamma(key_radius, float(shape[-1]), shape[:-1]) / self.beta
        return self.simulated + radius[..., None] * direction

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Return the log density of trajectories (..., time, dimension)."""
        errors = jnp.linalg.norm(value - self.simulated, axis=-1)
        n_frames, dimension = self.event_shape
        return -self.beta * errors.sum(-1) - n_frames * log_normaliser(self.beta, dimension)
