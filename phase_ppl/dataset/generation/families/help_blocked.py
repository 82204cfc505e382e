"""An agent is too large for the door to its item; the other brings it."""

from __future__ import annotations

from phase_ppl.dataset.generation.registry import register_family
from phase_ppl.dataset.generation.situation import Draw, Situation, item_to
from phase_ppl.dataset.generation.tables import LAYOUTS, NARROW, SIZES
from phase_ppl.world.names import BLUE_ITEM

NARROW_LAYOUTS = tuple(n for n, lengths in LAYOUTS.items() if 10 - NARROW in lengths)


@register_family("help_blocked", scenario="collaborative", layouts=NARROW_LAYOUTS)
def help_blocked(draw: Draw) -> Situation:
    """A large agent cannot get to its item through a narrow door; a small one helps it."""
    sides = draw.sides_of(draw.narrow_door())
    near = draw.one_of((0, 1))
    helpee = draw.one_of(sides[near])
    landmark = draw.one_of(sides[near])
    item = draw.one_of(sides[1 - near])
    return draw.situation(
        # what the helper would want for itself does not matter: it acts on the other's goal
        (item_to(BLUE_ITEM, landmark),) * 2,
        (1, 0),
        (draw.room(), helpee, item, draw.room()),
        (SIZES[0], draw.any_size(but=SIZES[:1]), SIZES[0], draw.any_size()),
        (draw.strength(1, 2, 3), draw.strength(1, 2, 3)),
    )
