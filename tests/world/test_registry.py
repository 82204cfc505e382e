"""Kernels, models, families and priors by name: what holds for all of them."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.data.generation.families import FAMILIES
from phase_ppl.evaluation.registry import MODELS
from phase_ppl.inference.registry import KERNELS
from phase_ppl.world.errors import InvalidSettingError


@pytest.fixture
def _forgetful(monkeypatch: pytest.MonkeyPatch) -> None:
    for registry in (KERNELS, MODELS, FAMILIES):
        registry.names()
        monkeypatch.setattr(registry, "entries", dict(registry.entries))
        monkeypatch.setattr(registry, "_loaded", False)


def mine() -> None:
    """Do nothing.

    But say more.
    """


def yours() -> None: ...


@pytest.mark.usefixtures("_forgetful")
def test_a_name_is_taken_once() -> None:
    for available, register in (
        (ppl.available_kernels, ppl.register_kernel("mine", validity="exact")),
        (ppl.available_models, ppl.register_model("mine")),
        (ppl.available_families, ppl.register_family("mine", scenario="opposing")),
    ):
        assert register(mine) is mine
        register(mine)  # as when its module is loaded again
        assert "mine" in available()
        with pytest.raises(
            InvalidSettingError, match=rf"'mine( of PHASE)?' exists: {__name__}.mine"
        ):
            register(yours)
    assert KERNELS["mine"].summary == "Do nothing."


@pytest.mark.usefixtures("_forgetful")
def test_those_of_other_packages_are_loaded_and_broken_ones_do_not_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Entry:
        def __init__(self, name: str, register: Callable[[Any], Any]) -> None:
            self.name, self.register = name, register

        def load(self) -> None:
            if self.name == "broken":
                raise ImportError("no module named elsewhere")
            self.register(yours)

    for group, available, register in (
        ("kernels", ppl.available_kernels, ppl.register_kernel("theirs", validity="exact")),
        ("models", ppl.available_models, ppl.register_model("theirs")),
        ("families", ppl.available_families, ppl.register_family("theirs", scenario="opposing")),
    ):
        offered = {f"phase_ppl.{group}": [Entry(name, register) for name in ("broken", "theirs")]}
        monkeypatch.setattr(importlib.metadata, "entry_points", lambda group, of=offered: of[group])
        with pytest.warns(UserWarning, match="'broken' cannot be loaded: no module"):
            assert "theirs" in available()
        assert "theirs" in available()  # loaded once, without another warning


def test_what_is_ours_is_there_sorted_and_says_what_it_is() -> None:
    assert {"gibbs", "local_mh", "prior_mh"} <= set(ppl.available_kernels())
    assert {"simple", "last_frame"} <= set(ppl.available_models())
    for registry in (KERNELS, MODELS, FAMILIES):
        assert registry.names() == sorted(registry.entries)
        for name, entry in registry.items():
            assert entry.name == name.partition(" of ")[0]
            assert entry.summary.endswith(".")
            assert len(entry.summary) > 20
