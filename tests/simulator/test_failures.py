"""What becomes of simulations that fail, the same on any workers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from phase_ppl.simulator.runner import Runner, fresh_seed
from phase_ppl.world.errors import InvalidSettingError, SimulationError, UnknownNameError
from tests.simulator import toys
from tests.simulator.toys import AT_REST, GO, HELP, N_FRAMES, SCENE, WEAK

REQUESTS: Any = ([GO, WEAK, HELP, WEAK, GO, WEAK], [1, 2, 3, 4, 5, 2])


def unlucky(scene: Any, hypothesis: Any, rng: np.random.Generator) -> Iterator[Any]:
    """Fail for two seeds of three."""
    if rng.integers(3):
        raise ValueError("out of luck")
    yield from toys.drift(scene, hypothesis, rng)


def runner(simulator: Any, **more: Any) -> Runner:
    return Runner(simulator, SCENE, AT_REST, **more)


def test_rejected_failures_are_results_and_counted() -> None:
    with runner(toys.fails_for_weak, workers=1) as one:
        results = one.run(*REQUESTS)
    assert [r.failure is not None for r in results] == [False, True, False, True, False, True]
    assert (one.statistics.failures, one.statistics.retries) == (2, 0)


@pytest.mark.parametrize("workers", [1, 2])
def test_raise_names_hypothesis_and_seed(workers: int) -> None:
    with (
        runner(toys.fails_for_weak, workers=workers, on_failure="raise") as strict,
        pytest.raises(SimulationError, match=r"150.* with seed 2 failed: ValueError: too weak"),
    ):
        strict.run([GO, WEAK, GO], [1, 2, 3])


def test_raise_lets_sound_simulations_be() -> None:
    with runner(toys.drift, workers=1, on_failure="raise") as strict:
        assert all(r.completed for r in strict.run(*REQUESTS))


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


@pytest.mark.parametrize("workers", [1, 2])
def test_retries_give_the_same_on_any_workers_and_are_announced_once(workers: int) -> None:
    seen: list[Any] = []
    options: dict[str, Any] = {"on_failure": "retry", "retries": 2}
    with (
        runner(unlucky, workers=1, **options) as one,
        runner(unlucky, workers=workers, on_result=seen.append, **options) as other,
    ):
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
    killer = toys.KillsItsWorker(tmp_path, times=2)
    with runner(killer, workers=2, max_retries=0, on_failure="retry", retries=3) as patient:
        (result,) = patient.run([WEAK], [1])
    assert result.completed
    assert patient.statistics.retries == 2


def test_fresh_seeds_are_seeds_and_all_different() -> None:
    seeds = [fresh_seed(seed, attempt) for seed in range(30) for attempt in range(1, 30)]
    assert len({*seeds, *range(30)}) == 30 * 30
    assert all(0 <= seed < 2**31 for seed in seeds)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"on_failure": "ignore"}, UnknownNameError, "'reject', 'raise', 'retry'"),
        ({"on_failure": "retry", "retries": 0}, InvalidSettingError, "retries=0"),
        ({"retries": 2}, InvalidSettingError, "goes with on_failure='retry'"),
    ],
)
def test_policies_that_are_none_are_refused(options: Any, error: Any, message: str) -> None:
    with pytest.raises(error, match=message):
        runner(toys.drift, **options)


@pytest.mark.parametrize("workers", [1, 2])
def test_identical_requests_on_the_way_are_one_simulation(workers: int, tmp_path: Any) -> None:
    with runner(toys.CountsRuns(tmp_path), workers=workers) as merged:
        results = merged.run([GO, WEAK] * 8, [1, 2] * 8)
    assert len({id(r) for r in results}) == len(list(tmp_path.iterdir())) == 2
    assert merged.statistics.simulations == 2
