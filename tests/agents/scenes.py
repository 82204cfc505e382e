"""Scenes for the tests of agents: far-apart corners unless a test says otherwise."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents import vision
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
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
    """Return a scene; ``radius`` and ``walls`` may be given."""
    radius = changes.pop("radius", [0.8] * 4)
    return Scene(start=[red, green, (*blue, 0.0), (*pink, 0.0)], radius=radius, **changes)


class Sight(NamedTuple):
    """What an agent sees: cells (size, size), row 0 at the top, and entities (4,)."""

    cells: NDArray[np.bool_]
    entities: list[bool]


def look(
    where: Scene, agent: int = 0, held: tuple[int, int] = (-1, -1), full_view: bool = False
) -> Sight:
    """Return what ``agent`` observes at the start of a scene."""
    model = WorldModel.of(where, (450.0, 450.0), PlannerConfig())
    bodies, _, _ = compiled.from_state(State.at_start(where), where.radius)
    shape = model.layout.rows, model.layout.columns
    visible = np.zeros(math.prod(shape), bool)
    observed = np.zeros(4, bool)
    vision.observe(
        bodies,
        np.array(held),
        agent,
        full_view,
        model.params,
        model.layout,
        visible,
        np.zeros(128, np.int64),
        observed,
    )
    return Sight(visible.reshape(shape), observed.tolist())
