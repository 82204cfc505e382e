"""An item blocks an agent's door; the other moves it away."""

from __future__ import annotations

import numpy as np

from phase_ppl.dataset.generation.families.help_blocked import NARROW_LAYOUTS
from phase_ppl.dataset.generation.registry import register_family
from phase_ppl.dataset.generation.situation import Draw, Situation, agent_to
from phase_ppl.dataset.generation.tables import SIZES, SPOTS
from phase_ppl.world.names import BLUE_ITEM, GREEN
from phase_ppl.world.rooms import ROOMS_OF_RAY


@register_family("help_move", scenario="collaborative", layouts=NARROW_LAYOUTS)
def help_move(draw: Draw) -> Situation:
    """A large item stands before the door to an agent's landmark; a strong agent helps it."""
    door = draw.narrow_door()
    sides = draw.sides_of(door)
    near = draw.one_of((0, 1))
    beyond = sides[1 - near]
    before_door = draw.one_of(room for room in ROOMS_OF_RAY[door] if room in beyond)
    away = [np.linalg.norm(draw.rooms.door_position[door] - spot) for spot in SPOTS[before_door]]
    goal = agent_to(GREEN, draw.one_of(beyond))
    return draw.situation(
        (goal, goal),
        (1, 0),
        (draw.one_of(beyond), draw.one_of(sides[near]), before_door, draw.room()),
        (draw.any_size(), SIZES[0], SIZES[2], draw.any_size()),
        (draw.strength(3), draw.strength(0, 1)),
        at={BLUE_ITEM: SPOTS[before_door][int(np.argmin(away))]},
    )
