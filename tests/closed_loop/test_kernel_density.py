"""A density by samples comes near the simulator's own, and says how near."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from phase_ppl.closed_loop.kernel_density import PARTS, log_density
from phase_ppl.world.arrays import FloatArray

SCALE = 0.02
SPREAD = 0.1
STEPS = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])


def walking(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Draw positions (..., 8): two bodies take one of four steps each, two never move."""
    found = np.zeros((*shape, 8))
    for body in range(2):
        step = STEPS[rng.integers(0, len(STEPS), shape)]
        found[..., 2 * body : 2 * body + 2] = step + rng.normal(0, SPREAD, (*shape, 2))
    return found


def of_walking(at: FloatArray) -> float:
    log = -2 * np.log(2 * np.pi * SCALE**2)  # those that never move have the floor
    for body in range(2):
        off = ((at[2 * body : 2 * body + 2] - STEPS) ** 2).sum(axis=1) / SPREAD**2
        log += np.log(np.exp(-off / 2).mean() / (2 * np.pi * SPREAD**2))
    return float(log)


def normal(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Draw positions of a body that carries another, both off together, and of two at rest."""
    found = np.zeros((*shape, 8))
    found[..., :2] = rng.normal(0, SPREAD, (*shape, 2))
    found[..., 2:4] = found[..., :2] + rng.normal(0, SPREAD / 2, (*shape, 2))
    return found


def of_normal(at: FloatArray) -> float:
    off = (at[:2] ** 2).sum() + 4 * ((at[2:4] - at[:2]) ** 2).sum()
    log = -2 * np.log(2 * np.pi * SCALE**2) - off / (2 * SPREAD**2)
    return float(log - np.log(2 * np.pi * SPREAD**2) - np.log(2 * np.pi * SPREAD**2 / 4))


@pytest.mark.parametrize(
    ("draw", "exact", "most"), [(normal, of_normal, (0.3, 0.15)), (walking, of_walking, (1.2, 0.8))]
)
def test_a_density_by_samples_comes_near_the_exact_one_and_states_its_error(
    draw: Callable[..., FloatArray],
    exact: Callable[[FloatArray], float],
    most: tuple[float, float],
) -> None:
    rng, typical = np.random.default_rng(0), []
    for n in (100, 500):
        off, said = [], []
        for _ in range(12):
            at = draw(rng)
            found, _ = log_density(draw(rng, 16, n), at, SCALE, 0.0)
            off.append(found[0] - exact(at))
            said.append((PARTS - 1) * found[1:].var(axis=0))
        typical.append(float(np.median(np.abs(off))))
    assert typical[0] < most[0]
    assert typical[1] < min(most[1], 0.75 * typical[0])
    assert 0.7 < np.sqrt(np.mean(np.var(off, axis=1)) / np.mean(said)) < 1.5


def test_what_never_moves_has_the_floor_and_noise_adds_to_it() -> None:
    still = np.zeros((1, 40, 4))
    at = np.array([0.0, 0.03, 0.0, 0.0])
    for noise in (0.0, 0.04):
        variance = SCALE**2 + noise**2
        found, far = log_density(still, at, SCALE, noise)
        expected = -0.5 * 0.03**2 / variance - 2 * np.log(2 * np.pi * variance)
        np.testing.assert_allclose(found, expected)
        assert far == pytest.approx(0.5 * 0.03**2 / variance)
