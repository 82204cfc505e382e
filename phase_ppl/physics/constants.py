"""Constants of the dynamics, shared by the pymunk world and the compiled model.

The two engines must agree on every choice below. Even the anchor of the floor friction matters:
at the body origin or at the centre of mass, a body moves by half a unit more or less in ten steps.

Units: lengths in units of the arena, simulated seconds, newtons.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.geometry import is_agent
from phase_ppl.world.names import AGENTS

SUBSTEP: Final = 1.0 / 60.0  # length of one substep, the step of the original engine, s
SUBSTEPS: Final = 5  # substeps in one planner step; actions last that long
STEP: Final = SUBSTEP * SUBSTEPS  # length of one planner step and of one frame, s

WORLD_INNER_STEPS: Final = 4
"""Parts into which the world divides the movement of a substep. Bodies reach one unit per substep
and there is no continuous collision detection: undivided, they jump through inner walls and
squeeze through doors that are too narrow for them."""

IMAGINATION_INNER_STEPS: Final = 1
"""The minimum number of parts in the agents' heads, where speed matters more."""

LONGEST_MOVE: Final = 0.2
"""In the agents' heads a substep is divided further, up to ``WORLD_INNER_STEPS``, while a body
would move more than this in one part, units."""

LEAST_SIZE: Final = 0.8
MOST_STRENGTH: Final = 600.0
"""If no body is smaller and no agent stronger, as in PHASE, ``WORLD_INNER_STEPS`` are enough. Else
both engines divide a substep as far as the smallest body needs, up to ``MOST_INNER_STEPS``."""

MOST_INNER_STEPS: Final = 1024

_MOVE_OF_SIZE: Final = 0.25
"""How far a body may move in one part, in sizes of the smallest body: then none passes a wall."""

FLOOR_FRICTION: Final = 100.0
"""Largest friction force on any body, whatever its mass, acting on the body origin, N."""

AGENT_AREA: Final = 4.0  # area (= mass at density 1) of an agent of size 1

AGENT_INERTIA: Final = 26.0 / 9.0
"""Moment of inertia of an agent of size 1 about its centre of mass."""

FORCE_POINT_Y: Final = -1.0 / 12.0
"""Local y of the point at which an agent pushes, in units of its size. It is not the centre of
mass, so that sideways pushes also turn the body a little."""

TURN_TORQUE: Final = 300.0
"""Torque of a turning agent of size ``TURN_TORQUE_SIZE``, N m; it grows with the size squared."""

TURN_TORQUE_SIZE: Final = 0.8

WALL_RADIUS: Final = 0.01
"""Half thickness of inner walls, and how far the arena's border reaches inside."""

AGENT_SKIN: Final = 0.01
"""How far an agent's collision shape reaches beyond its outline, as in the original engine."""

COLLISION_SLOP: Final = 0.005  # overlap that is not pushed apart

COLLISION_BIAS: Final = 0.2**60
"""Share of an overlap that remains after one second of pushing apart; after a substep, a fifth."""

GRAB_CORRECTIONS: Final = 3
"""Newton steps by which a grab pulls agent and item into place. Each moves and turns both like an
impulse, by their masses and inertias. One more after each substep keeps the hold rigid."""

SHARED_WELD_SWEEPS: Final = 3
"""How often the two welds of an item with two holders are mended after each substep."""

WORLD_ITERATIONS: Final = 20  # solver iterations per inner step in the world
IMAGINATION_ITERATIONS: Final = 10  # solver iterations per inner step in the agents' heads


def division(
    radii: Sequence[float], strengths: Sequence[float], arena: Sequence[float]
) -> tuple[float, int]:
    """Return how far bodies may move in a part of a substep, units, and the most parts allowed.

    Args:
        radii: sizes of all bodies, agents first.
        strengths: of the agents, newtons.
        arena: x_min, x_max, y_min, y_max.

    Raises:
        InvalidSettingError: a body is so small that a strong agent could pass walls even then;
            the message gives the size needed.
    """
    least = min(radii)
    if least >= LEAST_SIZE and max(strengths) <= MOST_STRENGTH:
        return LONGEST_MOVE, WORLD_INNER_STEPS
    far = math.hypot(arena[1] - arena[0], arena[3] - arena[2])
    longest = min(LONGEST_MOVE, _MOVE_OF_SIZE * least)
    fastest, strength, size = max(
        # the speed that a force gives a body on the longest possible way
        (SUBSTEP * math.sqrt(2.0 * strength / mass(0, size) * far), strength, size)
        for strength, size in zip(strengths, radii, strict=False)
    )
    if fastest > MOST_INNER_STEPS * longest:
        allowed = fastest / MOST_INNER_STEPS / _MOVE_OF_SIZE
        if size == least:  # a larger one is slower too
            allowed = math.sqrt(allowed * least)
        raise InvalidSettingError(
            f"a body of size {least:g} is too small where an agent of size {size:g} has "
            f"{strength:g} N: walls would not stop it; expected a size of at least "
            f"{math.ceil(1e3 * allowed) / 1e3:g}, or less strength"
        )
    return longest, MOST_INNER_STEPS


def mass(entity: int, radius: float, n_agents: int = len(AGENTS)) -> float:
    """Return the mass of an entity of size ``radius``, at density 1."""
    return (AGENT_AREA if is_agent(entity, n_agents) else math.pi) * radius**2


def inertia(entity: int, radius: float, n_agents: int = len(AGENTS)) -> float:
    """Return the moment of inertia of an entity about its centre of mass."""
    if is_agent(entity, n_agents):
        return AGENT_INERTIA * radius**4
    return 0.5 * mass(entity, radius, n_agents) * radius**2


def turn_torque(radius: float) -> float:
    """Return the torque of a turning agent of size ``radius``, N m."""
    return TURN_TORQUE * (radius / TURN_TORQUE_SIZE) ** 2
