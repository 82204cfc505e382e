from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from phase_ppl.inference.registry import KernelInfo
from phase_ppl.inference.runs.length import Length, budget_of, check_chains, run_length
from phase_ppl.inference.settings import Budget, FrameBudget, TimeBudget
from phase_ppl.world.errors import InvalidSettingError


def info(**options: Any) -> KernelInfo:
    return KernelInfo("mine", lambda program: None, "exact", 2, ("vectorized",), (), "", **options)


def test_a_kernel_knows_better_than_its_registration_what_it_costs() -> None:
    kernel = SimpleNamespace(sims_at_start=3, sims_per_step=5)
    length = run_length(kernel, info(), 10, 4, None, 14)
    assert length == Length(4, 3, 5)
    assert length.at_most(10, 4) == 10 * (3 + 4 * 5)
    assert length.at_most(10, 1) == 10 * 8
    assert run_length(SimpleNamespace(), info(), 10, None, None, 14) == Length(6, 1, 2)


def test_a_declared_cost_does_not_decide_how_long_a_budget_lasts() -> None:
    kernel = SimpleNamespace(sims_at_start=3, sims_per_step=500)
    length = run_length(kernel, info(), 10, None, Budget(40), 14)
    assert (length.iterations, length.simulations, length.frames) == (None, 40, None)
    length = run_length(kernel, info(), 10, None, FrameBudget(421), 14)
    assert (length.iterations, length.simulations, length.frames) == (None, None, 421)


def test_a_budget_that_leaves_nothing_beside_the_start_is_refused() -> None:
    kernel = SimpleNamespace(sims_at_start=3, sims_per_step=5)
    with pytest.raises(InvalidSettingError, match=r"39 simulations is too small.* 40"):
        run_length(kernel, info(), 10, None, Budget(39), 14)
    with pytest.raises(InvalidSettingError, match=r"420 frames is too small.* 420"):
        run_length(kernel, info(), 10, None, FrameBudget(420), 14)


@pytest.mark.parametrize("budget", [Budget(40), FrameBudget(500), TimeBudget(2.5), None])
def test_what_ends_a_run_is_read_again(budget: Any) -> None:
    length = run_length(SimpleNamespace(), info(), 10, None, budget, 14)
    assert budget_of(length.target) == budget
    assert budget_of({"iterations": 3, "seconds": None}) is None  # as older files have it


def test_a_kernel_that_decides_its_own_length_is_not_contradicted() -> None:
    kernel = SimpleNamespace(n_iterations=lambda chains: 12 // chains)
    assert run_length(kernel, info(), 4, None, None, 14).iterations == 3
    assert run_length(kernel, info(), 4, 3, None, 14).iterations == 3
    assert run_length(kernel, info(), 4, None, Budget(28), 14).iterations == 3
    assert run_length(kernel, info(), 4, None, FrameBudget(28 * 14), 14).iterations == 3
    with pytest.raises(InvalidSettingError, match=r"391 frames is too small.*392"):
        run_length(kernel, info(), 4, None, FrameBudget(28 * 14 - 1), 14)
    with pytest.raises(InvalidSettingError, match=r"iterations=2.*'mine'.*takes 3"):
        run_length(kernel, info(), 4, 2, None, 14)
    with pytest.raises(InvalidSettingError, match=r"27 simulations is too small.*28"):
        run_length(kernel, info(), 4, None, Budget(27), 14)


def test_odd_chains_are_refused_where_they_must_be_even() -> None:
    check_chains(info(), 15)
    check_chains(info(even_chains=True), 16)
    with pytest.raises(InvalidSettingError, match=r"chains=15.*'mine'.*16"):
        check_chains(info(even_chains=True), 15)
