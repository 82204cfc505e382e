"""Kernels, models, families and priors by name: what holds for all of them."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.dataset.generation.families import CAST_FAMILIES, FAMILIES
from phase_ppl.evaluation.registry import MODELS
from phase_ppl.inference.registry import KERNELS
from phase_ppl.models.priors import PRIORS
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.registry import Registry

Register = Callable[[str], Callable[[Any], Any]]
OPEN: dict[str, tuple[Registry[Any], Callable[[], list[str]], Register]] = {
    "phase_ppl.kernels": (
        KERNELS,
        ppl.available_kernels,
        lambda name: ppl.register_kernel(name, validity="exact"),
    ),
    "phase_ppl.models": (MODELS, ppl.available_models, ppl.register_model),
    "phase_ppl.families": (
        FAMILIES,
        ppl.available_families,
        lambda name: ppl.register_family(name, scenario="opposing"),
    ),
}


@pytest.fixture(params=OPEN)
def group(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Entry point group of a registry that forgets what a test registers."""
    registry, available, _ = OPEN[request.param]
    available()
    monkeypatch.setattr(registry, "entries", dict(registry.entries))
    monkeypatch.setattr(registry, "_loaded", False)
    return str(request.param)


def mine() -> None:
    """Do nothing.

    But say more.
    """


def yours() -> None: ...


def test_a_name_is_taken_once(group: str) -> None:
    registry, available, register = OPEN[group]
    assert register("mine")(mine) is mine
    register("mine")(mine)  # as when its module is loaded again
    assert "mine" in available()
    assert registry["mine"].summary == "Do nothing."
    with pytest.raises(InvalidSettingError, match=rf"'mine' exists: {__name__}.mine"):
        register("mine")(yours)


def test_those_of_other_packages_are_loaded_and_broken_ones_do_not_matter(
    group: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, available, register = OPEN[group]

    class Entry:
        def __init__(self, name: str) -> None:
            self.name = name

        def load(self) -> None:
            if self.name == "broken":
                raise ImportError("no module named elsewhere")
            register("theirs")(yours)

    entries = {group: [Entry("broken"), Entry("theirs")]}
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: entries[group])
    with pytest.warns(UserWarning, match="'broken' cannot be loaded: no module"):
        assert "theirs" in available()
    assert "theirs" in available()  # loaded once, without another warning


@pytest.mark.parametrize(
    ("registry", "name", "close"),
    [
        (KERNELS, "local_hm", "local_mh"),
        (MODELS, "last_fram", "last_frame"),
        (FAMILIES, "hindering", "hinder"),
        (PRIORS, "unifrom", "uniform"),
    ],
)
def test_an_unknown_name_gets_close_ones(registry: Registry[Any], name: str, close: str) -> None:
    with pytest.raises(UnknownNameError, match=f"did you mean '{close}'"):
        registry[name]


def test_what_is_ours_is_there_sorted_and_says_what_it_is() -> None:
    assert {"enumerated_gibbs", "local_mh", "prior_mh"} <= set(ppl.available_kernels())
    assert {"simple", "last_frame"} <= set(ppl.available_models())
    for registry in (KERNELS, MODELS, FAMILIES, CAST_FAMILIES):
        assert registry.names() == sorted(registry.entries)
        for name, entry in registry.items():
            assert entry.name == name
            assert entry.summary.endswith(".")
            assert len(entry.summary) > 20
