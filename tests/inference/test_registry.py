from __future__ import annotations

from typing import Any

import pytest
from numpyro.infer import NUTS, SA

from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.metropolis import PriorMH
from phase_ppl.inference.registry import KERNELS, info_of, kernel_info, register_kernel
from phase_ppl.inference.settings import SimpleSettings, frames, seconds, simulations
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError
from tests.inference.toy import TableRunner, table_errors, table_guide, table_program


@pytest.fixture
def program() -> EventProgram:
    return table_program(TableRunner(table_errors()))[0]


def test_a_kernel_says_what_it_is_and_is_made_by_name_and_options(program: EventProgram) -> None:
    info = kernel_info("local_mh")
    assert info_of(info.factory) is info
    assert (info.validity, info.sims_per_step) == ("exact", 1)
    assert info.options == ("rule", "early_reject")
    supplies = {"guide": table_guide(), "settings": SimpleSettings()}
    kernel = info.make(program, **supplies, rule="paper")
    assert isinstance(kernel, LocalMH)
    assert kernel.validity == "approximate"


def test_a_kernel_of_ones_own_is_registered_by_a_decorator(
    monkeypatch: pytest.MonkeyPatch, program: EventProgram
) -> None:
    monkeypatch.setattr(KERNELS, "entries", dict(KERNELS.entries))

    @register_kernel("mine", validity="exact")
    def mine(program: EventProgram) -> PriorMH:
        return PriorMH(program)

    assert isinstance(kernel_info("mine").make(program), PriorMH)
    for message, given in {
        "validity='perfect'": {"validity": "perfect"},
        "sims_per_step=0": {"validity": "exact", "sims_per_step": 0},
        "'luck' is none of": {"validity": "exact", "needs": ("luck",)},
        "'first' is none of": {"validity": "exact", "keeps": "first"},
    }.items():
        with pytest.raises(InvalidSettingError, match=message):
            register_kernel("wrong", **given)  # type: ignore[arg-type]


def test_a_kernel_may_be_a_class_or_a_function(program: EventProgram) -> None:
    assert isinstance(info_of(PriorMH).make(program), PriorMH)
    assert isinstance(info_of(lambda program: PriorMH(program)).make(program), PriorMH)
    for other in (7, PriorMH(program)):
        with pytest.raises(InvalidSettingError, match=r"kernel=.*: expected a name of"):
            info_of(other)  # type: ignore[arg-type]


CONSISTENT = ("amis", "enumerate", "importance", "sa", "smc")


@pytest.mark.parametrize("name", [*CONSISTENT, "aies", "gibbs"])
def test_what_is_made_of_a_kernel_counts_its_draws_as_it_does(name: str) -> None:
    info: Any = info_of(name)
    own = info_of(type("Own", (info.factory,), {}))
    for what in ("keeps", "weighted", "adapts"):
        assert getattr(own, what) == getattr(info, what), what
    assert own.validity == "unknown"  # before it is made
    assert info.factory.validity == info.validity
    assert info.validity == ("consistent" if name in CONSISTENT else "exact")


def test_what_makes_no_kernel_says_so(program: EventProgram) -> None:
    for kernel in (NUTS, NUTS(lambda: None)):
        with pytest.raises(InvalidSettingError, match=r"NUTS.* needs a gradient"):
            info_of(kernel)  # type: ignore[arg-type]
    with pytest.raises(InvalidSettingError, match="which makes a NUTS, needs a gradient"):
        info_of(lambda program: NUTS(program)).make(program)
    with pytest.raises(InvalidSettingError, match="keeps no seed of the simulator: take 'sa'"):
        info_of(SA)
    with pytest.raises(InvalidSettingError, match="which makes a SA, keeps no seed"):
        info_of(lambda program: SA(program)).make(program)
    with pytest.raises(InvalidSettingError, match=r"makes None: .*does the function return it"):
        info_of(lambda program: None).make(program)  # type: ignore[arg-type,return-value]


@pytest.mark.parametrize(
    ("budget", "n"),
    [(simulations, 0), (simulations, True), (frames, 2.5), (seconds, 0), (seconds, float("inf"))],
)
def test_budgets_that_are_none_are_refused(budget: Any, n: Any) -> None:
    with pytest.raises(InvalidSettingError, match=f"{budget.__name__}="):
        budget(n)


def test_settings_of_the_papers_proposal_are_refused_for_the_learned_one() -> None:
    for given in ({"gamma": 5.0}, {"sign": "printed"}, {"unit": "printed"}):
        with pytest.raises(InvalidSettingError, match="settings of proposal='paper'"):
            SimpleSettings(**given)
        assert SimpleSettings(proposal="paper", **given).proposal == "paper"
