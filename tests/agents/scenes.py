"""Scenes for the tests of agents: far-apart corners unless a test says otherwise."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents import vision
from phase_ppl.agents.agent import Agent
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.event import State
from phase_ppl.world.scene import Scene

CENTRE = (16.0, 12.0)
FULL_WALL_UP = [[16.0, 12.0], [16.0, 22.0]]
HALF_WALL_LEFT = [[16.0, 12.0], [11.0, 12.0]]
NARROW_WALL_DOWN = [[16.0, 12.0], [16.0, 4.5]]
HALF_WALL_RIGHT = [[16.0, 12.0], [21.0, 12.0]]


def scene(
    red: tuple[float, float, float] = (8.0, 20.0, 0.0),
    green: tuple[float, float, float] = (24.0, 20.0, 0.0),
    blue: tuple[float, float] = (24.0, 4.0),
    pink: tuple[float, float] = (8.0, 4.0),
    **changes: Any,
) -> Scene:
    radius = changes.pop("radius", [0.8] * 4)
    return Scene(start=[red, green, (*blue, 0.0), (*pink, 0.0)], radius=radius, **changes)


def state_of(where: Scene) -> tuple[FloatArray, IntArray, FloatArray]:
    return compiled.from_state(State.at_start(where), where.radius)


def model_of(where: Scene, config: PlannerConfig | None = None) -> WorldModel:
    strengths = [450.0] * len(where.world.agents)
    return WorldModel.of(where, strengths, PlannerConfig() if config is None else config)


def agent_in(where: Scene, goals: tuple[int, ...], config: PlannerConfig, seed: int = 0) -> Agent:
    return Agent(0, goals, model_of(where, config), config, np.random.default_rng(seed))


class Sight(NamedTuple):
    """What an agent sees: cells (size, size), row 0 at the top, and entities (4,)."""

    cells: NDArray[np.bool_]
    entities: list[bool]


def look(
    where: Scene, agent: int = 0, held: tuple[int, int] = (-1, -1), full_view: bool = False
) -> Sight:
    model, (bodies, _, _) = model_of(where), state_of(where)
    shape = model.layout.rows, model.layout.columns
    visible, observed = np.zeros(math.prod(shape), bool), np.zeros(4, bool)
    vision.observe(
        *(bodies, np.array(held), agent, full_view, model.params, model.layout),
        *(visible, np.zeros(vision.MAX_OUTLINE_CELLS, np.int64), observed),
    )
    return Sight(visible.reshape(shape), observed.tolist())
