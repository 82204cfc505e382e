"""Budgets of seconds: no iteration begins that is expected to end too late."""

from __future__ import annotations

from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.inference.runs import pace, session
from phase_ppl.inference.runs.checkpoint import Checkpoint
from phase_ppl.inference.runs.length import Length
from phase_ppl.inference.runs.pace import Pace
from phase_ppl.world.errors import InvalidSettingError
from tests.inference.runs import EVENT, MODEL, Watched, infer


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    fake = Clock()
    monkeypatch.setattr(pace, "clock", fake)
    return fake


def take(pace: Pace, clock: Clock, seconds: float, *, initial: bool = False) -> None:
    pace.begin()
    clock.now += seconds
    pace.end(initial=initial)


def test_a_number_of_iterations_is_kept_whatever_the_time(clock: Clock) -> None:
    fixed = Pace(Length(3, 1, 1), clock())
    take(fixed, clock, 1e6, initial=True)
    assert [fixed.another(done) for done in range(5)] == [True, True, True, False, False]


def test_the_initial_particles_are_the_first_guess_and_then_forgotten(clock: Clock) -> None:
    timed = Pace(Length(None, 1, 2, seconds=50.0), clock())
    take(timed, clock, 10, initial=True)  # so an iteration of two simulations takes 20
    assert timed.expected(0) == 2
    take(timed, clock, 5)
    assert timed.expected(1) == 1 + 7


def test_uneven_iterations_count_by_the_mean_of_the_last_three(clock: Clock) -> None:
    timed = Pace(Length(None, 1, 1, seconds=100.0), clock())
    take(timed, clock, 10, initial=True)
    for seconds in (30, 2, 9, 10):
        take(timed, clock, seconds)
    assert timed.expected(4) == 4 + 5  # 39 s are left, 7 each
    take(timed, clock, 36)
    assert not timed.another(5)


def test_what_was_spent_before_counts(clock: Clock) -> None:
    timed = Pace(Length(None, 1, 1, seconds=60.0), clock(), spent=45.0, recent=[8.0, 7.0])
    assert timed.expected(3) == 5
    clock.now += 8
    assert not timed.another(4)
    assert timed.spent == 53


# --- whole runs ------------------------------------------------------------------------------


@pytest.fixture
def one_second_each(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    class Ticks(Watched):
        def before(self, number: int, requests: int) -> None:
            clock.now += requests

    monkeypatch.setattr(session, "Runner", Ticks)


@pytest.mark.parametrize(
    ("seconds", "iterations"), [(0.5, 0), (7.9, 0), (8, 1), (11.5, 1), (17, 3)]
)
@pytest.mark.usefixtures("one_second_each")
def test_a_run_of_seconds_is_a_shorter_run(seconds: float, iterations: int) -> None:
    post = infer(iterations=None, budget=ppl.seconds(seconds))
    assert post.settings["iterations"] == iterations
    assert post.tree["posterior"].sizes["draw"] == max(iterations, 1)
    assert post.cost["seconds"] == post.cost["simulations"] == 4 * (1 + iterations)
    assert not post.cost["interrupted"]


@pytest.mark.usefixtures("one_second_each")
def test_a_run_of_seconds_goes_on_with_what_is_left_of_them(tmp_path: Any) -> None:
    path = tmp_path / "run.ckpt"
    infer(iterations=None, budget=ppl.seconds(10), checkpoint=path)
    same = {"workers": 1, "progress": False}
    assert ppl.resume(path, EVENT, MODEL, **same).settings["iterations"] == 1
    longer = ppl.resume(path, EVENT, MODEL, budget=ppl.seconds(16), **same)
    assert longer.settings["iterations"] == 3
    assert Checkpoint(path).target == {"iterations": None, "seconds": 16.0}


@pytest.mark.parametrize("n", [0, -1, float("nan"), float("inf"), "60", True])
def test_seconds_that_are_none_are_refused(n: Any) -> None:
    with pytest.raises(InvalidSettingError, match="seconds="):
        ppl.seconds(n)


def test_a_bare_number_is_no_budget() -> None:
    with pytest.raises(InvalidSettingError, match=r"budget=60, expected phase_ppl.simulations"):
        infer(iterations=None, budget=60)
