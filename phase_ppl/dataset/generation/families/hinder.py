"""An agent keeps the other from its goal."""

from __future__ import annotations

from phase_ppl.dataset.generation.registry import register_family
from phase_ppl.dataset.generation.situation import Draw, Situation, agent_to, item_to
from phase_ppl.world.names import BLUE_ITEM, GREEN


@register_family("hinder", scenario="opposing", variants=("LMA", "LMO"))
def hinder(draw: Draw, variant: str) -> Situation:
    """One wants itself (LMA) or an item (LMO) at a landmark, the other wants it not to be there.

    The original family also has agents that are to touch an item; the 36 goals have none.
    """
    hinderer, hindered, item = draw.room(), draw.room(), draw.room()
    mover = hindered if variant == "LMA" else item
    landmark = draw.room(but=[mover])
    goal = agent_to(GREEN, landmark) if variant == "LMA" else item_to(BLUE_ITEM, landmark)
    ways = [(mover, landmark)] + [(hindered, mover)] * (variant == "LMO")
    return draw.situation(
        (goal, goal),
        (-1, 0),
        (hinderer, hindered, item, draw.room()),
        (
            draw.size((hinderer, mover), (mover, landmark)),
            draw.size(*ways),
            draw.size((item, landmark)) if variant == "LMO" else draw.any_size(),
            draw.any_size(),
        ),
        (draw.strength(1, 2, 3), draw.strength(1, 2, 3)),
    )
