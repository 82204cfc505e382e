"""A counter-based random generator for compiled code: explicit state, no globals.

SplitMix64 (Steele, Lea and Flood, 2014). The state is a uint64 array of length 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phase_ppl.physics.jit import bare_kernel

_INCREMENT = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_TO_UNIT = 1.0 / 9007199254740992.0


def make_rng(generator: np.random.Generator) -> NDArray[np.uint64]:
    """Return a compiled-code generator state seeded from a NumPy generator."""
    return generator.integers(0, 2**64, size=1, dtype=np.uint64)


@bare_kernel
def uniform(rng: NDArray[np.uint64]) -> float:
    """Return the next float in [0, 1) and advance ``rng``."""
    rng[0] += _INCREMENT
    z = rng[0]
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    z = z ^ (z >> _S31)
    return np.float64(z >> _S11) * _TO_UNIT


@bare_kernel
def below(rng: NDArray[np.uint64], n: int) -> int:
    """Return the next integer in 0..n-1 and advance ``rng``."""
    return int(uniform(rng) * n)
