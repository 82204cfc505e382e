"""The paper's network of strengths, two hidden layers of 64 units (Appendix 4B), in plain NumPy.

It says how strong an agent seems by a window, and how sure that is: the mean and the standard
deviation of a normal distribution that is cut to the range of strengths, which is what SIMPLE
proposes from. Where a window shows nothing the standard deviation is large and the distribution
close to uniform.
"""

from __future__ import annotations

import functools
import io
import zipfile
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.inference.proposals.strength.estimates import StrengthEstimates
from phase_ppl.inference.proposals.strength.features import N_FEATURES, window_features
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

HIDDEN: Final = 64
"""Units of each of the two hidden layers, as in the paper."""

SHAPES: Final[dict[str, tuple[int, ...]]] = {
    "centre": (N_FEATURES,),
    "scale": (N_FEATURES,),
    "weight_1": (N_FEATURES, HIDDEN),
    "bias_1": (HIDDEN,),
    "weight_2": (HIDDEN, HIDDEN),
    "bias_2": (HIDDEN,),
    "weight_3": (HIDDEN, 2),
    "bias_3": (2,),
}
"""The arrays of a file of weights; features are centred and scaled first."""

SD_RANGE: Final = (5.0, 800.0)
"""Bounds of the standard deviation, newtons. The upper one is as good as uniform."""

FARTHEST: Final = 6.0
"""Scaled features are cut here, so that a scene unlike those of the training stays harmless."""


class StrengthNetwork:
    """A trained network; it is an estimator that ``SimpleSettings(strength=...)`` takes.

    Args:
        weights: arrays by name, see :data:`SHAPES`.

    Raises:
        InvalidSettingError: an array is missing, has another shape or is not finite.
    """

    def __init__(self, weights: dict[str, NDArray[Any]]) -> None:
        self._weights = {name: _checked(weights, name) for name in SHAPES}

    @classmethod
    def load(cls, file: str | Path) -> StrengthNetwork:
        """Return the network with the weights of an npz file.

        Raises:
            InvalidSettingError: there is no such file, or it is damaged.
        """
        try:
            # from memory: NumPy leaves a damaged file open
            with np.load(io.BytesIO(Path(file).read_bytes()), allow_pickle=False) as kept:
                return cls({name: kept[name] for name in kept.files})
        except (OSError, EOFError, ValueError, AttributeError, zipfile.BadZipFile) as error:
            raise InvalidSettingError(
                f"{file} holds no weights of a strength network: {error}"
            ) from error

    def save(self, file: str | Path) -> None:
        """Write the weights to an npz file, in single precision."""
        single = {name: array.astype(np.float32) for name, array in self._weights.items()}
        np.savez_compressed(file, allow_pickle=False, **single)

    def outputs(self, features: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """Return (mean, standard deviation), newtons, for features (..., feature)."""
        w = self._weights
        x = np.clip((features - w["centre"]) / w["scale"], -FARTHEST, FARTHEST)
        x = np.maximum(x @ w["weight_1"] + w["bias_1"], 0.0)
        x = np.maximum(x @ w["weight_2"] + w["bias_2"], 0.0)
        x = x @ w["weight_3"] + w["bias_3"]
        share = 0.5 * (1 + np.tanh(x / 2))
        (low, high), (least, most) = STRENGTH_RANGE, np.log(SD_RANGE)
        mean = low + (high - low) * share[..., 0]
        return mean, np.exp(least + (most - least) * share[..., 1])

    def __call__(
        self, scene: Scene, observation: Observation, windows: NDArray[np.int64]
    ) -> StrengthEstimates:
        """Return what each window says; see :class:`Estimator`."""
        features = window_features(observation.trajectory, scene.radius, windows)
        return StrengthEstimates(*self.outputs(features))


@functools.cache
def shipped_network() -> StrengthNetwork:
    """Return the network that comes with the package; ``weights.json`` says how it was made."""
    file = resources.files("phase_ppl.inference.proposals.strength") / "weights.npz"
    with resources.as_file(file) as path:
        return StrengthNetwork.load(path)


def _checked(weights: dict[str, NDArray[Any]], name: str) -> FloatArray:
    if name not in weights:
        raise InvalidSettingError(f"the array {name} is missing")
    array = weights[name]
    if array.shape != SHAPES[name]:
        raise InvalidSettingError(f"{name} has shape {array.shape}, expected {SHAPES[name]}")
    if array.dtype.kind != "f" or not np.isfinite(array).all():
        raise InvalidSettingError(f"{name} holds something else than finite numbers")
    if name == "scale" and not (array > 0).all():
        raise InvalidSettingError("scale holds a number that is not positive")
    return array.astype(np.float64)
