"""What the agents of a simulation thought at each step, and why they did what they did."""

from __future__ import annotations

import dataclasses

from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.names import Literal


@dataclasses.dataclass(frozen=True, eq=False)
class Thoughts:
    """What all agents thought; step k is decided at frame k and leads to frame k + 1."""

    subgoals: tuple[tuple[Literal, Literal], ...]  # (step, agent) what each was about
    actions: IntArray  # (step, agent) what it did, an index into the names of actions
    # (step, agent) share of its belief particles in which that was the subgoal
    agreeing: FloatArray
    seen: BoolArray  # (step, agent, entity) whether it had the entity in view
    held: IntArray  # (step, agent) the item that it held, or ``NOTHING``
    # (step, agent, particle, entity, [x, y, angle]) its beliefs, units and radians
    particles: FloatArray
