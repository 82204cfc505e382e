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
    """Return the module ``behaviour`` of the benchmarks, which are no package."""
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


def test_two_too_weak_for_it_do_not_move_an_item(battery: ModuleType) -> None:
    together = importlib.import_module("behaviours.together")
    episode_of = importlib.import_module("behaviours.episode")
    carrying = next(one for one in together.BEHAVIOURS if one.name == "carry_together_weak")
    (trial,) = carrying.trials(together.np.random.default_rng(0))
    forces = {"strength_red": 150.0, "strength_green": 150.0}
    weak = type(trial.hypothesis).from_dict({**trial.hypothesis.to_dict(), **forces})
    episode = episode_of.record(trial.scene, weak, PLANNER, 0, 60)
    both = episode.both_hold(episode_of.BLUE)
    assert both.any()
    assert episode.moved_while(episode_of.BLUE, both) < 1.0
