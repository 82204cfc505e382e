"""Two agents carry one item."""

from __future__ import annotations

from phase_ppl.dataset.generation.registry import register_family
from phase_ppl.dataset.generation.situation import Draw, Situation, item_to
from phase_ppl.world.names import BLUE_ITEM


@register_family("collab", scenario="collaborative")
def collab(draw: Draw) -> Situation:
    """Both want the same item at a landmark and fetch it from the same or from two sides."""
    item = draw.room()
    landmark = draw.room(but=[item])
    first = draw.room(but=[item])
    chain = draw.chain
    place = chain.index(item)
    sides = chain[:place], chain[place + 1 :]
    across = sides[0] if first in sides[1] else sides[1]
    second = draw.one_of([first, draw.one_of(across)] if across else [first])
    force = draw.strength()
    return draw.situation(
        (item_to(BLUE_ITEM, landmark),) * 2,
        (0, 0),
        (first, second, item, draw.room()),
        (
            draw.size((first, item), (item, landmark)),
            draw.size((second, item), (item, landmark)),
            draw.size((item, landmark)),
            draw.any_size(),
        ),
        (force, force),
    )
