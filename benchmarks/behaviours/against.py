"""Behaviours of opponents: tug of war, taking away, blocking, chase and flight."""

from __future__ import annotations

import numpy as np

from behaviours.battery import Behaviour, Trial, trial_of
from behaviours.episode import BLUE, BOTTOM_RIGHT, GREEN, RED, Episode
from behaviours.layouts import LARGE, SMALL, scene
from phase_ppl.world.hypothesis import Hypothesis

TUG = 12
"""Steps (one second) that both hold an item."""

TAKEN = 4.0
"""An item that is this much farther from the opponent's landmark has been taken away, units."""

IN_DOOR = 1.0
"""Distance of an agent's edge from the middle of the door that it stands in, at most, units."""

STANDS = 12
"""Steps that it stands there."""

DOWN = 2


def tug(episode: Episode) -> bool:
    return bool(episode.both_hold(BLUE).sum() >= TUG)


def take_away(episode: Episode) -> bool:
    """The hinderer alone moves the item, away from where the opponent wants it."""
    alone = episode.holding(RED, BLUE) & ~episode.holding(GREEN, BLUE)
    path = episode.scene.rooms.path_distance
    goal = episode.scene.landmark_centres[BOTTOM_RIGHT]
    left = np.array([path(frame[BLUE, :2], goal) for frame in episode.frames])
    return bool(
        left[alone].max(initial=0.0) >= left[0] + TAKEN
        and not episode.is_on(BLUE, BOTTOM_RIGHT).any()
    )


def stand_in_door(episode: Episode) -> bool:
    """The hinderer, too wide for it, stands in the door long, and the opponent stays out."""
    door = episode.scene.rooms.door_position[DOWN]
    gap = np.linalg.norm(episode.frames[:, RED, :2] - door, axis=1)
    stands = gap <= episode.scene.radius[RED] + IN_DOOR
    return bool(stands.sum() >= STANDS and (episode.rooms(GREEN) != BOTTOM_RIGHT).all())


def item_that_fills(rng: np.random.Generator) -> tuple[Trial]:
    sizes = (SMALL, SMALL, LARGE, SMALL)
    # the hinderer sees the item from the start, and not only once the opponent is through
    headings = (rng.uniform(-2.4, -1.7), rng.uniform(-np.pi, np.pi))
    where = scene(12, (8, 8), (14, 20), (12, 6), (24, 20), rng, sizes, headings)
    goals = "Get green agent away from red lm", "Get green agent to red lm"
    return (Trial(where, Hypothesis(*goals, strength_red=600.0, strength_green=150.0)),)


def fill_door(episode: Episode) -> bool:
    """The hinderer brings the item to where it closes the door."""
    door = episode.scene.rooms.door_position[DOWN]
    gap = np.linalg.norm(episode.frames[:, BLUE, :2] - door, axis=1)
    closed = gap < episode.scene.radius[BLUE] + episode.scene.radius[GREEN]
    return bool(closed.any() and episode.moved_while(BLUE, episode.holding(RED, BLUE)) > 1.0)


def close_in(episode: Episode) -> bool:
    return bool(episode.touching(RED, GREEN).any())


def flight(rng: np.random.Generator) -> tuple[Trial, Trial]:
    where = scene(16, (8, 8), (8.5, 19.5), (24, 20), (24, 4), rng)
    strengths = {"strength_red": 300.0, "strength_green": 450.0}
    # on its landmark from the start, the other one has no reason to move
    return tuple(
        Trial(where, Hypothesis("get to green agent", goal, **strengths))  # type: ignore[arg-type, return-value]
        for goal in ("get away from red agent", "Get green agent to blue lm")
    )


def flee(flown: Episode, stood: Episode) -> bool:
    """The evader uses other rooms, and is farther away than one that stands still."""
    farther = flown.way(RED, GREEN).mean() > stood.way(RED, GREEN).mean()
    return bool(len(np.unique(flown.rooms(GREEN))) > 1 and farther)


TO_RED = "Get blue item to red lm"
FROM_RED = "Get blue item away from red lm"
BESIDE = (8, 14), (14, 8), (9, 9), (24, 20)
LONG = "both hold the item a second or longer"
BEHAVIOURS = (
    Behaviour("tug_of_war_opposing", LONG, trial_of(7, BESIDE, (FROM_RED, TO_RED)), tug),
    Behaviour(
        "tug_of_war_competing", LONG, trial_of(7, BESIDE, ("Get blue item to blue lm", TO_RED)), tug
    ),
    Behaviour(
        "carry_away",
        "the hinderer takes the item away in time",
        trial_of(7, ((8, 14), (24, 20), (9, 9), (18, 16)), (FROM_RED, TO_RED), (450.0, 300.0)),
        take_away,
    ),
    Behaviour(
        "stand_in_door",
        "one too wide for a door keeps the opponent out",
        trial_of(
            14, ((13.5, 4), (8, 20), (20, 8), (24, 20)),
            ("Get blue item away from green lm", "Get blue item to green lm"),
            (600.0, 300.0), (LARGE, SMALL, SMALL, SMALL),
        ),
        stand_in_door,
    ),
    Behaviour("fill_door", "an item closes the opponent's door", item_that_fills, fill_door),
    Behaviour(
        "chase",
        "the stronger one comes to touch the other",
        trial_of(
            7, ((14, 8), (18, 16), (8, 20), (24, 4)),
            ("get to green agent", "get away from red agent"), (600.0, 300.0),
        ),
        close_in,
    ),
    Behaviour("flight", "into other rooms, farther off than one that stands", flight, flee),
)  # fmt: skip
