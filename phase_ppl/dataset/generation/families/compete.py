"""Two agents want one item at different landmarks."""

from __future__ import annotations

from phase_ppl.dataset.generation.registry import register_family
from phase_ppl.dataset.generation.situation import Draw, Situation, item_to
from phase_ppl.world.names import BLUE_ITEM


@register_family("compete", scenario="competing")
def compete(draw: Draw) -> Situation:
    """Both want the same item, at landmarks of their own."""
    item = draw.room()
    red = draw.room(but=[item])
    green = draw.room(but=[item, red])
    rooms = draw.room(), draw.room()
    return draw.situation(
        (item_to(BLUE_ITEM, red), item_to(BLUE_ITEM, green)),
        (0, 0),
        (*rooms, item, draw.room()),
        (
            draw.size((rooms[0], item), (item, red)),
            draw.size((rooms[1], item), (item, green)),
            draw.size((item, red), (item, green)),
            draw.any_size(),
        ),
        (draw.strength(1, 2, 3), draw.strength(1, 2, 3)),
    )
