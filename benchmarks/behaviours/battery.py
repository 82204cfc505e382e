"""What a behaviour of the battery is, and how one is tried."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from behaviours.episode import Episode, record
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene


class Trial(NamedTuple):
    """One simulation: where, who wants what, and what is changed in the planner."""

    scene: Scene
    hypothesis: Hypothesis
    changes: dict[str, Any] = {}  # noqa: RUF012


class Behaviour(NamedTuple):
    """Scenes in which a pair must show a behaviour.

    Attributes:
        name: key of the report.
        shows: what must be seen, in words.
        trials: from a generator, which draws what varies, the simulations to compare.
        seen: whether their episodes show the behaviour.
        steps: length of an episode.
    """

    name: str
    shows: str
    trials: Callable[[np.random.Generator], tuple[Trial, ...]]
    seen: Callable[..., bool]
    steps: int = 100


def episodes(behaviour: Behaviour, planner: PlannerConfig, seed: int) -> list[Episode]:
    """Return the episodes of one try; the same seed gives the same."""
    return [
        record(
            trial.scene,
            trial.hypothesis,
            dataclasses.replace(planner, **trial.changes),
            seed,
            behaviour.steps,
        )
        for trial in behaviour.trials(np.random.default_rng(seed))
    ]
