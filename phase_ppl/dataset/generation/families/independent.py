"""Each agent minds its own business."""

from __future__ import annotations

from phase_ppl.dataset.generation.registry import register_family
from phase_ppl.dataset.generation.situation import Draw, Situation, agent_to, item_to
from phase_ppl.world.names import AGENTS, BLUE_ITEM, PINK_ITEM


@register_family("independent", scenario="independent", variants=("LMO+LMO", "LMO+LMA", "LMA+LMA"))
def independent(draw: Draw, variant: str) -> Situation:
    """Each agent takes an item of its own (LMO), or itself (LMA), to a landmark."""
    agents = [draw.room() for _ in AGENTS]
    items = [draw.room(), draw.room()]
    goals, sizes, item_sizes = [], [], [draw.any_size(), draw.any_size()]
    for agent, kind in enumerate(variant.split("+")):
        moved = items[agent] if kind == "LMO" else agents[agent]
        landmark = draw.room(but=[moved])
        if kind == "LMO":
            goals.append(item_to((BLUE_ITEM, PINK_ITEM)[agent], landmark))
            sizes.append(draw.size((agents[agent], moved), (moved, landmark)))
            item_sizes[agent] = draw.size((moved, landmark))
        else:
            goals.append(agent_to(agent, landmark))
            sizes.append(draw.size((moved, landmark)))
    return draw.situation(
        (goals[0], goals[1]),
        (0, 0),
        (*agents, *items),
        (*sizes, *item_sizes),
        (draw.strength(), draw.strength()),
    )
