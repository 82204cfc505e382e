"""Behaviours of pairs with the same goal: carrying, handing over, clearing the way."""

from __future__ import annotations

import numpy as np

from behaviours.battery import Behaviour, trial_of
from behaviours.episode import BLUE, BOTTOM_RIGHT, GREEN, RED, Episode
from behaviours.layouts import LARGE, MIDDLE, SMALL

CARRIED = 3.0
"""An item that both move this far, units, has been carried by both."""


def carry_together(episode: Episode) -> bool:
    both = episode.both_hold(BLUE)
    goal = episode.goals()[RED]
    return bool(episode.moved_while(BLUE, both) >= CARRIED and episode.reached(goal).any())


def bring_through_door(episode: Episode) -> bool:
    """The helper holds the item where it changes rooms; then it comes to the landmark."""
    crossing = np.flatnonzero(np.diff(episode.rooms(BLUE)) != 0) + 1
    crossed = crossing[episode.rooms(BLUE)[crossing] == BOTTOM_RIGHT]
    brought = any(episode.holding(RED, BLUE)[k] for k in crossed)
    return bool(brought and episode.is_on(BLUE, BOTTOM_RIGHT).any())


def clear_door(episode: Episode) -> bool:
    """The helper holds the item while it leaves the door; then the helpee comes through."""
    door = np.array([16.0, 3.25])
    away = np.linalg.norm(episode.frames[:, BLUE, :2] - door, axis=1) > LARGE + SMALL
    leaving = np.flatnonzero(away[1:] & ~away[:-1]) + 1
    held = [k for k in leaving if episode.holding(RED, BLUE)[k - 1 : k + 1].any()]
    return bool(held and episode.reached(episode.goals()[GREEN])[held[0] :].any())


def hand_over(episode: Episode) -> bool:
    """The item is brought or pushed through the door by the helper; the helpee takes it on."""
    over = np.flatnonzero(episode.rooms(BLUE) == BOTTOM_RIGHT)
    taken = over.size > 0 and episode.holding(GREEN, BLUE)[over[0] :].any()
    return bool(taken and episode.is_on(BLUE, BOTTOM_RIGHT).any())


def of_both(goal: str) -> tuple[str, str]:
    return goal, goal


HOME = of_both("Get blue item to red lm")
BEHAVIOURS = (
    Behaviour(
        "carry_together_weak",
        "150 and 300 N: both hold and move it, and it arrives",
        trial_of(
            7, ((18, 8), (8, 20), (10, 15), (24, 20)), of_both("Get blue item to yellow lm"),
            (300.0, 150.0),
        ),
        carry_together,
    ),
    Behaviour(
        "carry_together",
        "both hold and move it, and it arrives",
        trial_of(6, ((14, 16), (8, 20), (9, 14), (24, 20)), HOME),
        carry_together,
    ),
    Behaviour(
        "bring_through_door",
        "to a helpee that does not fit through the door",
        trial_of(
            12, ((8, 8), (18, 16), (12, 5), (24, 20)), HOME, sizes=(SMALL, LARGE, SMALL, SMALL)
        ),
        bring_through_door,
    ),
    # the item is where the helpee can take it, but the helpee cannot bring it to the goal
    Behaviour(
        "put_for_helpee",
        "the helpee has the item and does not fit",
        trial_of(
            13, ((18, 8), (8, 8), (12, 5), (24, 20)), HOME, sizes=(SMALL, LARGE, SMALL, SMALL)
        ),
        bring_through_door,
    ),
    # the item fits through the door to the goal; neither agent does
    Behaviour(
        "hand_over",
        "from one that does not fit through the door to one beyond it",
        trial_of(
            12, ((8, 8), (22, 10), (12, 5), (24, 20)), HOME, sizes=(MIDDLE, MIDDLE, SMALL, SMALL)
        ),
        hand_over,
    ),
    Behaviour(
        "clear_door",
        "the item that fills the helpee's door is taken away",
        trial_of(
            12, ((22, 9), (8, 8), (17.7, 3.6), (24, 20)), of_both("Get green agent to green lm"),
            (600.0, 300.0), (MIDDLE, SMALL, LARGE, SMALL),
        ),
        clear_door,
    ),
)  # fmt: skip
