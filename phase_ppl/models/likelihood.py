"""Likelihoods that compare a simulation with the video, among them the paper's (Eq. 2).

The other kind, the closed loop's (``closed_loop.py``), compares no whole simulation.

The paper's exp(-beta sum_t ||s_t - s^_t||) is made a proper density. In each frame the positions of
all entities (d numbers, 8 in PHASE) have the radial density exp(-beta ||s - s^||) / Z. Z does not
depend on the hypothesis, so the posterior is the paper's. But data can be drawn from it.

Its mean distance is d / beta, 160 units at the paper's beta = 0.05, eight times the arena's width.
So it is a tempered likelihood, not a model of the observation noise.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard, TypeVar

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.errors import positive_number
from phase_ppl.world.names import ENTITIES

if TYPE_CHECKING:
    from phase_ppl.models.closed_loop import ClosedLoopLikelihood

_Array = TypeVar("_Array")


class TrajectoryLikelihood(Protocol):
    """Compares a simulation with the video, frame by frame.

    Both methods must work on NumPy and JAX arrays alike. The density must fall with the error.
    """

    def log_prob(self, errors: _Array) -> _Array:
        """Return the log density of each frame, an array of the shape of ``errors``.

        The error of a frame is ||s_t - s^_t||, the distance between the simulated and the observed
        positions of all entities, units.
        """
        ...

    def max_total_error(self, log_floor: _Array, n_frames: int) -> _Array:
        """Return the largest sum of frame errors, units, that is compatible with ``log_floor``.

        With a larger sum, the log density of ``n_frames`` frames together is below ``log_floor``.
        """
        ...


def is_closed_loop(likelihood: object) -> TypeGuard[ClosedLoopLikelihood]:
    """Whether a likelihood is the closed loop's, which compares no whole simulation."""
    # if there is one, its module is loaded; other runs need not load planner and physics
    module = sys.modules.get("phase_ppl.models.closed_loop")
    return module is not None and isinstance(likelihood, module.ClosedLoopLikelihood)


class InNats:
    """The likelihood exp(-error), for errors in nats.

    With it kernels sample a table over hypotheses. The error of a frame is the log likelihood of
    the best hypothesis minus that hypothesis's own.
    """

    def log_prob(self, errors: _Array) -> _Array:
        """Return the log density of each frame, up to a constant."""
        return -errors  # type: ignore[operator]

    def max_total_error(self, log_floor: _Array, n_frames: int) -> _Array:
        """Return the summed error at which the log density is ``log_floor``."""
        return self.log_prob(log_floor)


@dataclasses.dataclass(frozen=True)
class RadialLikelihood:
    """The paper's likelihood: exp(-beta ||s_t - s^_t||) / Z in every frame.

    ||s_t - s^_t|| is the distance between simulated and observed positions: the Euclidean norm over
    all entities' x and y stacked.

    Attributes:
        beta: how fast the density falls with the distance, 1 / units. Default: the paper's 0.05.
        n_entities: number of entities of the world. A run sets it.

    Raises:
        InvalidSettingError: ``beta`` is no positive number.
    """

    beta: float = 0.05
    n_entities: int = dataclasses.field(default=len(ENTITIES), repr=False)

    def __post_init__(self) -> None:
        positive_number("beta", self.beta)

    @property
    def n_coordinates(self) -> int:
        """Number of coordinates in a frame, d: x and y of each entity."""
        return 2 * self.n_entities

    @property
    def _log_normaliser(self) -> float:
        """Log Z of exp(-beta ||x||) in d dimensions."""
        d = self.n_coordinates
        sphere = math.log(2) + d / 2 * math.log(math.pi) - math.lgamma(d / 2)
        return sphere + math.lgamma(d) - d * math.log(self.beta)

    def log_prob(self, errors: _Array) -> _Array:
        """Return the log density of each frame, given its distance ``errors``, units.

        The result has the shape of ``errors``. It is -inf for an infinite distance.
        """
        return -self.beta * errors - self._log_normaliser  # type: ignore[operator,return-value]

    def max_total_error(self, log_floor: _Array, n_frames: int) -> _Array:
        """Return the sum of distances over all frames, units, at a given log density.

        ``log_floor`` is the log density of all ``n_frames`` frames together, nats.
        """
        spent = n_frames * self._log_normaliser
        return -(log_floor + spent) / self.beta  # type: ignore[operator,return-value]

    def replicate(
        self, positions: NDArray[np.floating[Any]], rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return observed positions drawn from the likelihood, (..., entity, 2), units.

        In every frame, independently, the positions of all entities are displaced by a vector of
        ``n_coordinates`` numbers, with random direction and Gamma(d, beta) length.

        Args:
            positions: (..., entity, 2) simulated x, y, units.
            rng: source of the noise.
        """
        direction = rng.standard_normal(positions.shape)
        direction /= np.linalg.norm(direction, axis=(-2, -1), keepdims=True)
        length = rng.gamma(self.n_coordinates, 1 / self.beta, positions.shape[:-2])
        return positions + direction * length[..., None, None]
