"""Behaviours of two that want the same: carrying, handing over, clearing the way."""

from __future__ import annotations

import numpy as np

from behaviours.battery import Behaviour, Trial
from behaviours.episode import BLUE, BOTTOM_RIGHT, GREEN, RED, Episode
from behaviours.layouts import LARGE, MIDDLE, SMALL, scene
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene

CARRIED = 3.0
"""An item that both move this far, units, has been carried by both."""


def of_both(where: Scene, goal: str, red: float = 450.0, green: float = 450.0) -> tuple[Trial]:
    """Return the trial of a goal of both, with their strengths in newtons."""
    return (Trial(where, Hypothesis(goal, goal, strength_red=red, strength_green=green)),)


def lift(rng: np.random.Generator) -> tuple[Trial]:
    where = scene(7, (18, 8), (8, 20), (10, 15), (24, 20), rng)
    return of_both(where, "Get blue item to yellow lm", red=300.0, green=150.0)


def collaborate(rng: np.random.Generator) -> tuple[Trial]:
    where = scene(6, (14, 16), (8, 20), (9, 14), (24, 20), rng)
    return of_both(where, "Get blue item to red lm")


def carry_together(episode: Episode) -> bool:
    both = episode.both_hold(BLUE)
    goal = episode.goals()[RED]
    return bool(episode.moved_while(BLUE, both) >= CARRIED and episode.reached(goal).any())


def too_narrow(rng: np.random.Generator) -> tuple[Trial]:
    sizes = (SMALL, LARGE, SMALL, SMALL)
    where = scene(12, (8, 8), (18, 16), (12, 5), (24, 20), rng, sizes)
    return of_both(where, "Get blue item to red lm")


def bring_through_door(episode: Episode) -> bool:
    """The helper holds the item where it changes rooms; then it comes to the landmark."""
    crossing = np.flatnonzero(np.diff(episode.rooms(BLUE)) != 0) + 1
    crossed = crossing[episode.rooms(BLUE)[crossing] == BOTTOM_RIGHT]
    brought = any(episode.holding(RED, BLUE)[k] for k in crossed)
    return bool(brought and episode.is_on(BLUE, BOTTOM_RIGHT).any())


def filled_door(rng: np.random.Generator) -> tuple[Trial]:
    sizes = (MIDDLE, SMALL, LARGE, SMALL)
    where = scene(12, (22, 9), (8, 8), (17.7, 3.6), (24, 20), rng, sizes)
    return of_both(where, "Get green agent to green lm", red=600.0, green=300.0)


def clear_door(episode: Episode) -> bool:
    """The helper holds the item while it leaves the door; then the helpee comes through."""
    door = np.array([16.0, 3.25])
    away = np.linalg.norm(episode.frames[:, BLUE, :2] - door, axis=1) > LARGE + SMALL
    leaving = np.flatnonzero(away[1:] & ~away[:-1]) + 1
    held = [k for k in leaving if episode.holding(RED, BLUE)[k - 1 : k + 1].any()]
    return bool(held and episode.reached(episode.goals()[GREEN])[held[0] :].any())


def stays_home(rng: np.random.Generator) -> tuple[Trial]:
    """The item is where the helpee can take it, but the helpee cannot bring it to the goal."""
    sizes = (SMALL, LARGE, SMALL, SMALL)
    where = scene(13, (18, 8), (8, 8), (12, 5), (24, 20), rng, sizes)
    return of_both(where, "Get blue item to red lm")


def changes_hands(rng: np.random.Generator) -> tuple[Trial]:
    """The item fits through the door to the goal; neither agent does."""
    sizes = (MIDDLE, MIDDLE, SMALL, SMALL)
    where = scene(12, (8, 8), (22, 10), (12, 5), (24, 20), rng, sizes)
    return of_both(where, "Get blue item to red lm")


def hand_over(episode: Episode) -> bool:
    """The item is brought or pushed through the door by the helper; the helpee takes it on."""
    over = np.flatnonzero(episode.rooms(BLUE) == BOTTOM_RIGHT)
    taken = over.size > 0 and episode.holding(GREEN, BLUE)[over[0] :].any()
    return bool(taken and episode.is_on(BLUE, BOTTOM_RIGHT).any())


BEHAVIOURS = (
    Behaviour(
        "carry_together_weak",
        "150 and 300 N: both hold and move it, and it arrives",
        lift,
        carry_together,
    ),
    Behaviour(
        "carry_together", "both hold and move it, and it arrives", collaborate, carry_together
    ),
    Behaviour(
        "bring_through_door",
        "to a helpee that does not fit through the door",
        too_narrow,
        bring_through_door,
    ),
    Behaviour(
        "put_for_helpee",
        "the helpee has the item and does not fit",
        stays_home,
        bring_through_door,
    ),
    Behaviour(
        "hand_over",
        "from one that does not fit through the door to one beyond it",
        changes_hands,
        hand_over,
    ),
    Behaviour(
        "clear_door",
        "the item that fills the helpee's door is taken away",
        filled_door,
        clear_door,
    ),
)
