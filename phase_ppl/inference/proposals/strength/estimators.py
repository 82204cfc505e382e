"""The estimators of strengths by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.inference.proposals.strength.analytic import analytic_strengths
from phase_ppl.inference.proposals.strength.estimates import Estimator, StrengthEstimates
from phase_ppl.inference.proposals.strength.network import shipped_network
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name
from phase_ppl.world.names import AGENTS
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene


def network_strengths(
    scene: Scene, observation: Observation, windows: NDArray[np.int64]
) -> StrengthEstimates:
    """Return what the network that comes with the package says; see :class:`Estimator`."""
    return shipped_network()(scene, observation, windows)


ESTIMATORS: Final[Mapping[str, Estimator]] = MappingProxyType(
    {"analytic": analytic_strengths, "network": network_strengths}
)
"""By name: the analytic rule, and the paper's network."""

DEFAULT_ESTIMATOR: Final = "network"


def strength_estimator(strength: str | Estimator) -> Estimator:
    """Return the estimator of that name, or ``strength`` itself if it is one.

    Raises:
        UnknownNameError: no estimator has that name.
        InvalidSettingError: neither a name nor an estimator.
    """
    if isinstance(strength, str):
        if strength not in ESTIMATORS:
            raise unknown_name("estimator of strengths", strength, ESTIMATORS)
        return ESTIMATORS[strength]
    if not callable(strength):
        raise InvalidSettingError(
            f"strength={shown(strength)}, expected the name of an estimator or a function"
        )
    return strength


def estimated_strengths(
    strength: str | Estimator,
    scene: Scene,
    observation: Observation,
    windows: NDArray[np.int64],
) -> StrengthEstimates:
    """Return what an estimator says of each window.

    Args:
        strength: the name of an estimator, or one.
        scene, observation: what was seen.
        windows: (window, 2) first and last frame of each.

    Raises:
        UnknownNameError, InvalidSettingError: no such estimator, or an answer that is of another
            shape or no normal distribution.
    """
    mean, sd = (np.asarray(part, float) for part in strength_estimator(strength)(
        scene, observation, windows
    ))  # fmt: skip
    wanted = (len(windows), len(AGENTS))
    if mean.shape != wanted or sd.shape != wanted:
        raise InvalidSettingError(
            f"the estimator of strengths {estimator_name(strength)} returned shapes {mean.shape} "
            f"and {sd.shape}, expected {wanted} twice: mean and standard deviation"
        )
    known = ~np.isnan(mean)
    good = known & np.isfinite(mean) & np.isfinite(sd) & (sd > 0)
    if (known & ~good).any():
        window, agent = np.argwhere(known & ~good)[0]
        raise InvalidSettingError(
            f"the estimator of strengths {estimator_name(strength)} returned mean "
            f"{mean[window, agent]:g} and standard deviation {sd[window, agent]:g}, expected "
            "finite numbers, the second above 0; or nan for no estimate"
        )
    return StrengthEstimates(mean, np.where(known, sd, np.nan))


def estimator_name(strength: str | Estimator) -> str:
    """Return a name for the settings that a run records."""
    if isinstance(strength, str):
        return strength
    named = strength if hasattr(strength, "__qualname__") else type(strength)
    return f"{named.__module__}.{named.__qualname__}"  # type: ignore[union-attr]
