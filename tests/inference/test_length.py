from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from phase_ppl.inference.registry import KernelInfo
from phase_ppl.inference.runs.length import Length, check_chains, run_length
from phase_ppl.inference.settings import Budget
from phase_ppl.world.errors import InvalidSettingError


def info(**options: Any) -> KernelInfo:
    return KernelInfo("mine", lambda program: None, "exact", 2, ("vectorized",), (), "", **options)


def test_a_kernel_knows_better_than_its_registration_what_it_costs() -> None:
    kernel = SimpleNamespace(sims_at_start=3, sims_per_step=5)
    length = run_length(kernel, info(), 10, 4, None)
    assert length == Length(4, 3, 5)
    assert length.simulations(10, 4) == 10 * (3 + 4 * 5)
    assert length.simulations(10, 1) == 10 * 8
    assert run_length(SimpleNamespace(), info(), 10, None, None) == Length(6, 1, 2)


def test_budget_pays_for_the_start_first() -> None:
    kernel = SimpleNamespace(sims_at_start=3, sims_per_step=5)
    assert run_length(kernel, info(), 10, None, Budget(129)).iterations == 1
    assert run_length(kernel, info(), 10, None, Budget(130)).iterations == 2
    with pytest.raises(InvalidSettingError, match=r"79 simulations is too small.* 80"):
        run_length(kernel, info(), 10, None, Budget(79))


def test_a_kernel_that_decides_its_own_length_is_not_contradicted() -> None:
    kernel = SimpleNamespace(n_iterations=lambda chains: 12 // chains)
    assert run_length(kernel, info(), 4, None, None).iterations == 3
    assert run_length(kernel, info(), 4, 3, None).iterations == 3
    assert run_length(kernel, info(), 4, None, Budget(28)).iterations == 3
    with pytest.raises(InvalidSettingError, match=r"iterations=2.*'mine'.*takes 3"):
        run_length(kernel, info(), 4, 2, None)
    with pytest.raises(InvalidSettingError, match=r"27 simulations is too small.*28"):
        run_length(kernel, info(), 4, None, Budget(27))


def test_odd_chains_are_refused_where_they_must_be_even() -> None:
    check_chains(info(), 15)
    check_chains(info(even_chains=True), 16)
    with pytest.raises(InvalidSettingError, match=r"chains=15.*'mine'.*16"):
        check_chains(info(even_chains=True), 15)
