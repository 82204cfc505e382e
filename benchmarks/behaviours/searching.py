"""Search for an unseen item, with and without the cost of the way; ``ppl.plot.search`` draws it."""

from __future__ import annotations

import numpy as np

from behaviours.battery import Behaviour, Trial
from behaviours.episode import BLUE, BOTTOM_RIGHT, GREEN, TOP_RIGHT, Episode
from behaviours.layouts import scene
from phase_ppl.world.hypothesis import Hypothesis

PAPER, NONE = 0.05, 0.0
"""Values of lambda, the weight of the cost."""


def hidden(rng: np.random.Generator, cost_weight: float) -> tuple[Trial]:
    """Return green beside a near room; more of what is unseen lies left, and so does the item."""
    headings = (0.0, rng.uniform(2.6, 3.0))
    where = scene("near room", (8.5, 19.5), (20, 10), (12, 20), (24, 4), rng, headings=headings)
    hypothesis = Hypothesis("Get red agent to blue lm", "Get blue item to red lm")
    return (Trial(where, hypothesis, {"cost_weight": cost_weight}),)


def first_room(episode: Episode) -> int:
    """Return the room that green goes to first."""
    rooms = episode.rooms(GREEN)
    others = rooms[rooms != BOTTOM_RIGHT]
    return int(others[0]) if len(others) else BOTTOM_RIGHT


def near_first(episode: Episode) -> bool:
    return first_room(episode) == TOP_RIGHT


def far_first(episode: Episode) -> bool:
    return first_room(episode) not in (TOP_RIGHT, BOTTOM_RIGHT)


def near_first_then_found(episode: Episode) -> bool:
    return near_first(episode) and bool(episode.holding(GREEN, BLUE).any())


BEHAVIOURS = (
    Behaviour(
        "search_near_first",
        "lambda 0.05: the near room before the far ones",
        lambda rng: hidden(rng, PAPER),
        near_first,
    ),
    Behaviour(
        "search_far_first_without_cost",
        "lambda 0: the larger unseen part before the near room",
        lambda rng: hidden(rng, NONE),
        far_first,
    ),
    Behaviour(
        "search_finds",
        "lambda 0.05: the near room first, then the item is found",
        lambda rng: hidden(rng, PAPER),
        near_first_then_found,
        160,
    ),
)
