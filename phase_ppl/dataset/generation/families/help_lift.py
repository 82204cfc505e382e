"""An item is too heavy for one agent; the other comes to help."""

from __future__ import annotations

from phase_ppl.dataset.generation.registry import register_family
from phase_ppl.dataset.generation.situation import Draw, Situation, item_to
from phase_ppl.dataset.generation.tables import SIZES
from phase_ppl.world.names import BLUE_ITEM


@register_family("help_lift", scenario="collaborative")
def help_lift(draw: Draw) -> Situation:
    """A weak agent is with the item, a stronger one comes; both want the item at a landmark."""
    item = draw.room()
    landmark = draw.room(but=[item])
    helper = draw.room(but=[item])
    return draw.situation(
        (item_to(BLUE_ITEM, landmark),) * 2,
        (0, 0),
        (helper, item, item, draw.room()),
        (
            draw.size((helper, item), (item, landmark)),
            SIZES[0],
            draw.size((item, landmark)),
            draw.any_size(),
        ),
        (draw.strength(1, 2, 3), draw.strength(0)),
    )
