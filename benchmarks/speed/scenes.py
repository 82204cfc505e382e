"""States for the measurements: a mix full of contacts, as agents meet them, and whole episodes."""

from __future__ import annotations

import common
import numpy as np

import phase_ppl as ppl
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.event import Event, State
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene

STRENGTHS = (450.0, 300.0)
WALLS = [[[16, 12], [16, 22]], [[16, 12], [11, 12]], [[16, 12], [16, 7]], [[16, 12], [21, 12]]]
UNDECIDED = {
    "turned": (13.0, 14.0, 0.82),
    "averted": (13.0, 14.0, -1.2),
    "other room": (20.0, 8.0, 1.58),
    "other room, averted": (20.0, 8.0, -0.9),
}
BUNDLED = ("collaborate", "independent", "compete", "oppose")


def crowded(red: tuple[float, float, float] = (13.0, 14.0, 0.3)) -> Scene:
    """Return a scene whose bodies lie close together in one room, red perhaps elsewhere."""
    start = [red, [10.0, 16.5, -1.2], [13.2, 16.4, 0.0], [9.5, 14.2, 0.0]]
    return Scene(np.array(start), np.array([0.8, 1.2, 0.8, 1.01]), np.array(WALLS, np.float64))


def undecided() -> dict[str, Scene]:
    """Return scenes by name; red's headings lie near where its choice changes."""
    return {name: crowded(red) for name, red in UNDECIDED.items()}


def contact_mix(n: int) -> list[tuple[State, tuple[int, int]]]:
    """Return states of crowded random motion, holding or not, each with a pair of actions."""
    rng = np.random.default_rng(0)
    mix: list[tuple[State, tuple[int, int]]] = []
    while len(mix) < n:
        world = PymunkWorld(crowded(), STRENGTHS)
        for _ in range(20):
            red, green = (int(a) for a in rng.integers(0, len(Action), 2))
            mix.append((world.state, (red, green)))
            world.step((red, green))
    return mix[:n]


def episodes() -> list[tuple[Event, Hypothesis]]:
    """Return the bundled events with their true hypotheses."""
    events = map(ppl.load_event, BUNDLED)
    return [(event, common.true_hypothesis(event)) for event in events]
