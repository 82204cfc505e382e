"""One simulation: compared with what was observed, no further than needed, and never lost."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phase_ppl.simulator.contract import (
    Cancelled,
    simulate_one,
    simulate_trajectory,
)
from phase_ppl.world.errors import SimulationError
from phase_ppl.world.hypothesis import Hypothesis
from tests.simulator import toys
from tests.simulator.toys import AT_REST, GO, HELP, N_FRAMES, SCENE, START, WEAK

OBSERVED = AT_REST.positions


class UnprintableError(Exception):
    def __str__(self) -> str:
        raise RuntimeError


def raises(error: BaseException) -> Callable[..., Any]:
    def simulator(*given: Any) -> Iterator[Any]:
        yield START
        raise error

    return simulator


def clings(*_: Any) -> Iterator[Any]:
    while True:
        try:
            yield START
        except GeneratorExit:
            yield START


WHERE = r"\(test_contract.py, line \d+, in simulator\)"
BAD: list[tuple[Callable[..., Any], int, str]] = [
    (lambda *_: [START] * 3, 3, "SimulationError: the simulator ended after 3 of 8 frames"),
    (lambda *_: [START, START * np.nan], 1,
     "SimulationError: frame 1 holds a value that is not finite"),
    (lambda *_: [START + 1e300], 0, "SimulationError: frame 0 holds a value that is not finite"),
    (lambda *_: [np.ma.masked_greater(START, 9.0)], 0,
     "SimulationError: frame 0 holds .*, expected numbers"),
    (lambda *_: [START[:2]], 0,
     r"SimulationError: frame 0 has shape \(2, 3\), expected \(4, 3\)"),
    (raises(ZeroDivisionError("no way to divide")), 1,
     f"ZeroDivisionError: no way to divide {WHERE}"),
    (raises(UnprintableError()), 1, "UnprintableError: .*"),
    (clings, N_FRAMES, "RuntimeError: generator ignored GeneratorExit.*"),  # when it is closed
]  # fmt: skip


def simulate(simulator: Any, hypothesis: Hypothesis = GO, seed: int = 1, **more: Any) -> Any:
    return simulate_one(simulator, SCENE, hypothesis, seed, OBSERVED, **more)


class Watched:
    """A simulator that notes what is taken from it, and whether it was closed."""

    taken, closed, running = 0, False, None

    def __call__(self, *given: Any) -> Any:
        self.running = self._frames(*given)  # kept: garbage is closed anyway
        return self.running

    def _frames(self, *given: Any) -> Iterator[Any]:
        try:
            for frame in toys.slide(*given):
                self.taken += 1
                yield frame
        finally:
            self.closed = True


def test_the_error_of_a_frame_is_the_distance_over_all_four_entities() -> None:
    beside = [START + np.array([3.0, 4.0, 100.0])] * N_FRAMES  # 5 away each, whatever the angle
    np.testing.assert_allclose(simulate(lambda *_: beside).errors, math.sqrt(4 * 25))
    # the first frame is compared with the first observed one
    np.testing.assert_allclose(simulate(toys.slide).errors, np.arange(N_FRAMES))


def test_a_complete_simulation_has_everything() -> None:
    result = simulate(toys.drift, HELP, seed=5)
    assert (result.hypothesis, result.seed, result.failure) == (HELP, 5, None)
    assert (result.completed, result.frames_simulated) == (True, N_FRAMES)
    assert result.trajectory.shape == (N_FRAMES, 4, 3)
    assert np.isfinite(result.errors).all()
    assert result.total_error == pytest.approx(result.errors.sum())
    assert result.seconds > 0
    # also where the simulator changes its frame in place
    np.testing.assert_array_equal(result.trajectory[0], START)
    assert (np.ptp(result.trajectory, axis=0) > 0).all()
    alone = simulate_trajectory(toys.drift, SCENE, HELP, 5, N_FRAMES)
    np.testing.assert_array_equal(alone, result.trajectory)
    assert simulate(lambda *given: AT_REST.trajectory).completed, "a plain trajectory does too"


def test_simulators_are_given_effective_goals_only() -> None:
    given = []

    def notes(scene: Any, hypothesis: Hypothesis, rng: Any) -> Iterator[Any]:
        given.append(hypothesis)
        yield from toys.drift(scene, hypothesis, rng)

    result = simulate(notes, HELP)
    assert given == [HELP.effective()]
    assert given[0].goal_green == HELP.goal_red
    assert given[0].alpha == (0, 0)
    assert result.hypothesis == HELP


def test_the_seed_any_whole_number_determines_a_simulation() -> None:
    first, again, other = (simulate(toys.drift, seed=s).trajectory for s in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    for seed in (0, 2**31 - 1, 2**40, -1, np.int32(7)):
        assert simulate(toys.drift, seed=seed).completed


def test_no_more_frames_are_taken_than_are_needed() -> None:
    watched = Watched()
    assert simulate(watched).completed
    assert (watched.taken, watched.closed) == (N_FRAMES, True)
    watched = Watched()
    result = simulate(watched, error_ceiling=4.0)  # 0 + 1 + 2 + 3 is the first sum above
    assert watched.closed
    assert watched.taken == result.frames_simulated == 4
    assert (result.completed, result.failure) == (False, None)
    np.testing.assert_array_equal(result.errors, [0, 1, 2, 3] + [np.inf] * 4)
    assert np.isnan(result.trajectory[4:]).all()
    assert np.isfinite(result.trajectory[:4]).all()
    assert result.total_error == 6.0
    for ceiling in (-1.0, -np.inf):  # below zero nothing is simulated
        result = simulate(raises(ValueError()), error_ceiling=ceiling)
        assert (result.frames_simulated, result.completed, result.failure) == (0, False, None)


@given(seed=st.integers(0, 2**31), ceiling=st.floats(0, 2))
def test_a_ceiling_never_changes_what_stays_under_it(seed: int, ceiling: float) -> None:
    free = simulate(toys.drift, seed=seed)
    bound = simulate(toys.drift, seed=seed, error_ceiling=ceiling)
    n = bound.frames_simulated
    np.testing.assert_array_equal(bound.errors[:n], free.errors[:n])
    np.testing.assert_array_equal(bound.trajectory[:n], free.trajectory[:n])
    assert bound.completed == (np.cumsum(free.errors)[-2] <= ceiling)


class Stopped(Watched):
    """Is told to stop while it makes its third frame."""

    def __init__(self) -> None:
        self.stop: Future[None] = Future()
        self.goes_on = threading.Event()

    def _frames(self, *given: Any) -> Iterator[Any]:
        for frame in super()._frames(*given):
            if self.taken == 3:
                self.stop.set_result(None)
                self.goes_on.wait(10)
            yield frame


def test_a_simulation_that_is_stopped_closes_after_its_next_frame() -> None:
    stopped = Stopped()
    with pytest.raises(Cancelled):
        simulate(stopped, stop=[stopped.stop])
    stopped.goes_on.set()
    toys.wait_until(lambda: stopped.closed)
    assert stopped.taken == 3


@pytest.mark.parametrize(("simulator", "frames", "failure"), BAD)
def test_whatever_goes_wrong_is_a_failed_result_or_an_error_of_that_hypothesis_and_seed(
    simulator: Callable[..., Any], frames: int, failure: str
) -> None:
    result = simulate(simulator, WEAK, seed=9)
    assert result.failure is not None
    assert re.fullmatch(failure, result.failure)
    assert (result.hypothesis, result.seed) == (WEAK, 9)
    assert not result.completed
    assert result.frames_simulated == frames
    assert np.isinf(result.errors[frames:]).all()
    assert np.isfinite(result.errors[:frames]).all()
    with pytest.raises(SimulationError, match=failure) as raised:
        simulate_trajectory(simulator, SCENE, WEAK, 9, N_FRAMES)
    assert f"[{WEAK}] with seed 9" in str(raised.value)
