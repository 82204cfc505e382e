"""What becomes of simulations that fail, the same on any workers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from phase_ppl.simulator.runner import fresh_seed
from phase_ppl.world.errors import SimulationError
from tests.simulator import toys
from tests.simulator.toys import GO, HELP, N_FRAMES, WEAK, runner

REQUESTS: Any = ([GO, WEAK, HELP, WEAK, GO, WEAK], [1, 2, 3, 4, 5, 2])


def unlucky(scene: Any, hypothesis: Any, rng: np.random.Generator) -> Iterator[Any]:
    """Fail for two seeds of three."""
    if rng.integers(3):
        raise ValueError("out of luck")
    yield from toys.drift(scene, hypothesis, rng)


@pytest.mark.parametrize("workers", [1, 2])
def test_raise_names_hypothesis_and_seed(workers: int) -> None:
    with runner(toys.fails_for_weak, workers=workers, on_failure="raise") as strict:
        assert strict.run([GO], [1])[0].completed
        with pytest.raises(SimulationError, match=r"150.* with seed 2 failed: ValueError: too w"):
            strict.run([GO, WEAK, GO], [1, 2, 3])


def test_retried_simulations_have_the_frames_of_a_fresh_seed_under_their_own() -> None:
    with (
        runner(unlucky, workers=1, on_failure="retry", retries=20) as patient,
        runner(unlucky, workers=1) as plain,
    ):
        asked = list(range(12))
        results = patient.run([GO] * 12, asked)
        assert [r.seed for r in results] == asked
        assert all(r.completed for r in results)
        attempts = 0
        for seed, result in zip(asked, results, strict=True):
            tries = [seed, *(fresh_seed(seed, k) for k in range(1, 21))]
            alone = [plain.run([GO], [s])[0] for s in tries]
            first = next(k for k, r in enumerate(alone) if r.completed)
            np.testing.assert_array_equal(result.trajectory, alone[first].trajectory)
            attempts += first
    assert patient.statistics.retries == patient.statistics.failures == attempts > 0
    assert patient.statistics.simulations == 12 + attempts
    assert patient.statistics.frames == 12 * N_FRAMES


def test_retries_give_the_same_on_any_workers_and_are_announced_once() -> None:
    seen: list[Any] = []
    options: dict[str, Any] = {"on_failure": "retry", "retries": 2}
    with (
        runner(unlucky, workers=1, **options) as one,
        runner(unlucky, workers=2, **options) as other,
    ):
        other.on_result = seen.append
        alone, found = one.run([GO] * 20, range(20)), other.run([GO] * 20, range(20))
    for a, b in zip(alone, found, strict=True):
        assert (a.seed, a.failure, a.completed) == (b.seed, b.failure, b.completed)
        np.testing.assert_array_equal(a.errors, b.errors)
    assert {a.completed for a in alone} == {True, False}
    assert len(seen) == 20
    assert one.statistics.retries == other.statistics.retries


def test_what_always_fails_is_rejected_after_the_retries() -> None:
    with runner(toys.fails_for_weak, workers=1, on_failure="retry") as patient:
        (result, again) = patient.run([WEAK, WEAK], [7, 7])
    assert result is again
    assert (result.seed, str(result.failure)[:10]) == (7, "ValueError")
    assert (patient.statistics.failures, patient.statistics.retries) == (4, 3)


def test_a_batch_is_tried_again_only_where_it_failed() -> None:
    class Unlucky(toys.Batched):
        def simulate_batch(self, scene: Any, hypotheses: Any, rngs: Any, n_frames: int) -> Any:
            frames = super().simulate_batch(scene, hypotheses, rngs, n_frames)
            weak = [h.strength_red < 300 and len(self.sizes) == 1 for h in hypotheses]
            frames[weak] = np.nan
            return frames

    batched = Unlucky()
    with runner(batched, on_failure="retry") as patient:
        assert all(r.completed for r in patient.run(*REQUESTS))
    assert batched.sizes == [5, 2]


def test_what_kills_its_worker_is_tried_with_fresh_seeds_too(tmp_path: Any) -> None:
    killer = toys.KillsItsWorker(tmp_path, times=4)  # twice under each of two seeds
    with runner(killer, workers=2, on_failure="retry", retries=3) as patient:
        (result,) = patient.run([WEAK], [1])
    assert result.completed
    assert (patient.statistics.retries, patient.statistics.failures) == (4, 2)


def test_fresh_seeds_are_seeds_and_all_different() -> None:
    seeds = [fresh_seed(seed, attempt) for seed in range(30) for attempt in range(1, 30)]
    assert len({*seeds, *range(30)}) == 30 * 30
    assert all(0 <= seed < 2**31 for seed in seeds)
