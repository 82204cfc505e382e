"""How long a run may be, before anything is simulated."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.inference.registry import KernelInfo
from phase_ppl.inference.runs.length import Length, run_length
from phase_ppl.inference.settings import Budget
from phase_ppl.world.errors import InvalidSettingError

INFO = KernelInfo("mine", lambda program: None, "exact", 2, ("vectorized",), (), "")
COSTLY = SimpleNamespace(sims_at_start=3, sims_per_step=5)
OWN = SimpleNamespace(n_iterations=lambda chains: 12 // chains)


def length_of(
    kernel: Any, chains: int, iterations: int | None = None, budget: Budget | None = None
) -> Length:
    return run_length(kernel, INFO, chains, iterations, budget, n_frames=14)


def test_a_kernel_knows_better_than_its_registration_what_it_costs() -> None:
    length = length_of(COSTLY, 10, 4)
    assert length == Length(10, 4, None, 3, 5)
    assert length.at_most(4) == 10 * (3 + 4 * 5)
    assert length_of(SimpleNamespace(), 10) == Length(10, 6, None, 1, 2)


def test_a_declared_cost_does_not_decide_how_long_a_budget_lasts() -> None:
    kernel = SimpleNamespace(sims_at_start=3, sims_per_step=500)
    for budget in (ppl.simulations(40), ppl.frames(421)):
        length = length_of(kernel, 10, budget=budget)
        assert (length.iterations, length.budget) == (None, budget)


def test_a_kernel_that_decides_its_own_length_does_so() -> None:
    budgets = (None, ppl.simulations(28), ppl.frames(28 * 14))
    assert {length_of(OWN, 4, budget=budget) for budget in budgets} == {Length(4, 3, None, 1, 2)}
    assert length_of(OWN, 4, 3).iterations == 3


@pytest.mark.parametrize(
    ("kernel", "given", "message"),
    [
        (COSTLY, {"budget": ppl.simulations(39)}, r"39 simulations is too small.* 40"),
        (COSTLY, {"budget": ppl.frames(420)}, r"420 frames is too small.* 420"),
        (OWN, {"budget": ppl.frames(30 * 14 - 1)}, r"419 frames is too small.*420"),
        (OWN, {"budget": ppl.simulations(29)}, r"29 simulations is too small.*30"),
        (OWN, {"budget": ppl.seconds(3)}, r"seconds is of no use to kernel 'mine'.*takes 1 it"),
        (OWN, {"iterations": 2}, r"iterations=2.*'mine'.*takes 1"),
    ],
)
def test_a_length_that_cannot_be_is_refused(
    kernel: Any, given: dict[str, Any], message: str
) -> None:
    with pytest.raises(InvalidSettingError, match=message):
        length_of(kernel, 10, **given)
