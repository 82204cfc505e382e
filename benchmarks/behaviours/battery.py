"""A behaviour of the battery, and how it is tried."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from behaviours.episode import Episode, record
from behaviours.layouts import SMALL, Place, scene
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene


class Trial(NamedTuple):
    """One simulation: scene, hypothesis, and changes of the planner."""

    scene: Scene
    hypothesis: Hypothesis
    changes: dict[str, Any] = {}  # noqa: RUF012


Draws = Callable[[np.random.Generator], tuple[Trial, ...]]


def trial_of(
    layout: int,
    places: tuple[Place, Place, Place, Place],
    goals: tuple[str, str],
    strengths: tuple[float, float] = (450.0, 450.0),
    sizes: tuple[float, float, float, float] = (SMALL,) * 4,
) -> Draws:
    """Return what draws one trial of red, green, blue and pink, whose agents look anywhere."""

    def trials(rng: np.random.Generator) -> tuple[Trial]:
        where = scene(layout, *places, rng, sizes)
        return (Trial(where, Hypothesis(*goals, (0, 0), *strengths)),)

    return trials


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
    trials: Draws
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
