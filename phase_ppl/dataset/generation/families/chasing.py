"""One agent wants to get to the other, which wants to get away."""

from __future__ import annotations

from phase_ppl.dataset.generation.registry import register_family
from phase_ppl.dataset.generation.situation import Draw, Situation, approach
from phase_ppl.world.names import GREEN, RED


@register_family("chasing", scenario="opposing")
def chasing(draw: Draw) -> Situation:
    """One agent chases the other."""
    chaser = draw.room()
    chased = draw.room(but=[chaser])
    return draw.situation(
        (approach(RED), approach(GREEN)),
        (0, -1),
        (chaser, chased, draw.room(), draw.room()),
        (
            draw.size((chaser, chased)),
            draw.size((chaser, chased)),
            draw.any_size(),
            draw.any_size(),
        ),
        (draw.strength(1, 2, 3), draw.strength(1, 2, 3)),
    )
