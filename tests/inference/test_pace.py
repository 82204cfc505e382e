"""Budgets: of seconds, where no iteration begins that is expected to end too late; and of
simulations and frames, which are spent by what is really simulated."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.inference import run, sampler
from phase_ppl.inference.checkpoint import Checkpoint
from phase_ppl.inference.registry import KernelInfo, kernel_info
from phase_ppl.inference.run import IDLE, Length, Pace
from phase_ppl.world.errors import InvalidSettingError
from tests.inference.runs import EVENT, MODEL, OPTIONS, Watched, assert_same_draws, infer, stops_at
from tests.inference.toy import few_goals, walkers


def resume(path: Path, **options: Any) -> ppl.Posterior:
    return ppl.resume(path, EVENT, MODEL, **{"workers": 1, "progress": False, **options})


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    fake = Clock()
    monkeypatch.setattr(run, "clock", fake)
    return fake


def test_what_an_iteration_takes_is_guessed_from_the_last_three(clock: Clock) -> None:
    def take(seconds: float, done: int, *, initial: bool = False) -> None:
        pace.begin()
        clock.now += seconds
        pace.end(initial=initial)
        pace.done = done

    pace = Pace(Length(1, None, ppl.seconds(113), 1, sims_per_step=2), clock())
    take(10, 0, initial=True)  # so an iteration of two simulations is taken to need 20
    assert pace.expected == 5
    take(30, 1)  # the guess is forgotten
    assert pace.expected == 1 + 2
    for done, seconds in enumerate((2, 9, 10), 2):
        take(seconds, done)
    assert pace.expected == 4 + 7  # 52 s are left, 7 each
    take(49, 5)
    assert not pace.goes_on


def test_a_run_whose_hypotheses_are_all_known_ends() -> None:
    pace = Pace(Length(1, None, ppl.simulations(200)), 0.0)
    pace.count([], IDLE - 1)
    assert pace.goes_on
    pace.count([], IDLE)
    assert not pace.goes_on


@pytest.fixture
def one_second_each(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    class Ticks(Watched):
        def before(self, number: int, requests: int) -> None:
            clock.now += requests

    monkeypatch.setattr(sampler, "Runner", Ticks)
    sampler._known_simulators.add(walkers)  # which is not checked by one more simulation


@pytest.mark.usefixtures("one_second_each")
def test_a_run_of_seconds_is_a_shorter_run_and_goes_on_with_what_is_left(tmp_path: Path) -> None:
    for seconds, iterations in ((0.5, 0), (7.9, 0), (8, 1), (17, 3)):
        post = infer(iterations=None, budget=ppl.seconds(seconds))
        assert post.settings["iterations"] == iterations
        assert post.tree["posterior"].sizes["draw"] == max(iterations, 1)
        assert post.cost["seconds"] == post.cost["simulations"] == 4 * (1 + iterations)
        assert not post.cost["interrupted"]
    path = tmp_path / "run.ckpt"
    infer(iterations=None, budget=ppl.seconds(10), checkpoint=path)
    assert resume(path).settings["iterations"] == 1
    assert resume(path, budget=ppl.seconds(16)).settings["iterations"] == 3
    asked = Checkpoint(path).asked
    assert (asked["iterations"], asked["budget"]) == (None, ppl.seconds(16))


def test_no_kernel_is_starved_by_what_it_declares() -> None:
    # some proposals have no prior mass
    model = ppl.Model(prior=few_goals, simulator=walkers)
    options = {**OPTIONS, "kernel": "gibbs", "iterations": None, "budget": ppl.simulations(100)}
    post = ppl.infer(EVENT, model, **options)
    simulations = np.bincount(post.tree["simulations"]["iteration"].values)
    spent, last = post.cost["simulations"], int(simulations[-1])
    assert 100 <= spent < 100 + last
    declared = 4 * kernel_info("gibbs").sims_per_step
    assert simulations[1:].max() <= declared
    said = f"{spent} simulations (4 at the start, {spent - 4} in iterations), "
    said += f"{post.cost['frames']} frames (of a budget of 100"
    assert said in " ".join(str(post).split())


def test_equal_frames_are_more_simulations_where_they_are_stopped_early() -> None:
    options: tuple[dict[str, Any], ...] = ({}, {"early_reject": False})
    early, whole = (
        infer(iterations=None, budget=ppl.frames(2000), seed=1, **given) for given in options
    )
    for post in (early, whole):
        frames = post.tree["simulations"]["frames_simulated"].values
        last = post.tree["simulations"]["iteration"].values == post.settings["iterations"]
        assert frames[~last].sum() < 2000 <= frames.sum() == post.cost["frames"]
    assert early.cost["simulations"] > whole.cost["simulations"]
    assert "budget of 2000 frames" in " ".join(str(early).split())


@pytest.mark.parametrize("budget", [ppl.simulations(60), ppl.frames(500)])
def test_a_budget_goes_on(budget: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options: dict[str, Any] = {"iterations": None, "budget": budget}
    whole = infer(**options)
    path = tmp_path / "run.ckpt"
    with monkeypatch.context() as patched:
        patched.setattr(sampler, "Runner", stops_at(3))
        with pytest.raises(ppl.Interrupted):
            infer(**options, checkpoint=path)
    for _ in range(2):  # the second time it is complete
        again = resume(path)
        assert_same_draws(again.tree, whole.tree)
        assert again.settings == whole.settings
    less = dataclasses.replace(budget, amount=budget.amount // 2)
    with pytest.raises(InvalidSettingError, match=r"too small.*went on after"):
        resume(path, budget=less)


INFO = KernelInfo("mine", lambda program: None, "exact", 2, ("vectorized",), (), "")
COSTLY = SimpleNamespace(sims_at_start=3, sims_per_step=5)
OWN = SimpleNamespace(n_iterations=lambda chains: 12 // chains)


def length_of(kernel: Any, chains: int, iterations: Any = None, budget: Any = None) -> Length:
    return Length.of(kernel, INFO, chains, iterations, budget, n_frames=14)


def test_a_kernel_knows_better_than_its_registration_what_it_costs_and_may_decide_it() -> None:
    length = length_of(COSTLY, 10, 4)
    assert length == Length(10, 4, None, 3, 5)
    assert length.at_most(4) == 10 * (3 + 4 * 5)
    assert length_of(SimpleNamespace(), 10) == Length(10, 6, None, 1, 2)
    budgets = (None, ppl.simulations(28), ppl.frames(28 * 14))
    assert {length_of(OWN, 4, budget=budget) for budget in budgets} == {Length(4, 3, None, 1, 2)}
    assert length_of(OWN, 4, 3).iterations == 3


def test_impossible_lengths_are_refused() -> None:
    for kernel, given, message in [
        (COSTLY, {"budget": ppl.simulations(39)}, r"39 simulations is too small.* 40"),
        (COSTLY, {"budget": ppl.frames(420)}, r"420 frames is too small.* 420"),
        (OWN, {"budget": ppl.frames(30 * 14 - 1)}, r"419 frames is too small.*420"),
        (OWN, {"budget": ppl.simulations(29)}, r"29 simulations is too small.*30"),
        (OWN, {"budget": ppl.seconds(3)}, r"seconds is of no use to kernel 'mine'.*takes 1 it"),
        (OWN, {"iterations": 2}, r"iterations=2.*'mine'.*takes 1"),
    ]:
        with pytest.raises(InvalidSettingError, match=message):
            length_of(kernel, 10, **given)
