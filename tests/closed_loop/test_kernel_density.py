"""A density by samples comes near the simulator's own, and says how near."""

from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.closed_loop.kernel_density import log_density

SCALE = 0.02


def test_what_never_moves_has_the_floor_and_noise_adds_to_it() -> None:
    still = np.zeros((1, 40, 4))
    at = np.array([0.0, 0.03, 0.0, 0.0])
    for noise in (0.0, 0.04):
        variance = SCALE**2 + noise**2
        found, far = log_density(still, at, SCALE, noise)
        expected = -0.5 * 0.03**2 / variance - 2 * np.log(2 * np.pi * variance)
        np.testing.assert_allclose(found, expected)
        assert far == pytest.approx(0.5 * 0.03**2 / variance)
