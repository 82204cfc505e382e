"""Simulated pairs behave as in the paper's animations: scenes of the behaviour battery.

``benchmarks/behaviour.py`` measures how often; here each behaviour must come within two tries.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

import phase_ppl as ppl

PLANNER = ppl.PlannerConfig.fast()
BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def battery() -> Iterator[ModuleType]:
    sys.path.insert(0, str(BENCHMARKS))
    yield importlib.import_module("behaviour")
    sys.path.remove(str(BENCHMARKS))


@pytest.mark.parametrize(
    "name",
    ["carry_together_weak", "bring_through_door", "tug_of_war_opposing",
     *(pytest.param(name, marks=pytest.mark.slow) for name in ("chase", "flight"))],
)  # fmt: skip
def test_a_pair_shows_the_behaviour(battery: ModuleType, name: str) -> None:
    assert any(battery.attempt(battery.Try(name, seed, PLANNER)) for seed in range(2))
