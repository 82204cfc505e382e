"""The fourteen low-level actions of an agent."""

from __future__ import annotations

import enum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.scene import Turning


class Action(enum.IntEnum):
    """An agent's action during one planner step: one frame, a twelfth of a simulated second.

    Directions are relative to the agent's body; ``UP`` is ahead. ``STOP`` ends the agent's motion,
    ``NO_FORCE`` lets it coast. ``ATTACH`` grabs an item within reach, ``DETACH`` lets go of it.
    """

    TURN_LEFT = 0
    TURN_RIGHT = 1
    UP = 2
    DOWN = 3
    LEFT = 4
    RIGHT = 5
    UP_LEFT = 6
    UP_RIGHT = 7
    DOWN_LEFT = 8
    DOWN_RIGHT = 9
    STOP = 10
    NO_FORCE = 11
    ATTACH = 12
    DETACH = 13

    @property
    def recorded(self) -> str:
        """Name of the action in the recordings of PHASE's authors: "turnleft", ..., "detach"."""
        return self.name.lower().replace("_", "")


ACTION_NAMES: Final = tuple(action.recorded for action in Action)
"""Names used in recorded data, in the order of :class:`Action`."""

N_ACTIONS: Final = len(Action)
NO_ACTION: Final = -1  # an agent that does nothing; its body coasts as with ``NO_FORCE``
_DIAGONAL = 0.707  # the original world's factor, not exactly 1 / sqrt(2)


def _directions() -> NDArray[np.float64]:
    directions = np.zeros((N_ACTIONS, 2))
    directions[Action.UP] = 0.0, 1.0
    directions[Action.DOWN] = 0.0, -1.0
    directions[Action.LEFT] = -1.0, 0.0
    directions[Action.RIGHT] = 1.0, 0.0
    directions[Action.UP_LEFT] = -_DIAGONAL, _DIAGONAL
    directions[Action.UP_RIGHT] = _DIAGONAL, _DIAGONAL
    directions[Action.DOWN_LEFT] = -_DIAGONAL, -_DIAGONAL
    directions[Action.DOWN_RIGHT] = _DIAGONAL, -_DIAGONAL
    directions.setflags(write=False)
    return directions


DIRECTIONS: Final = _directions()
"""(14, 2) direction of each action's force in the body frame; 0 for actions without one."""


def executed(action: int, turning: Turning) -> int:
    """Return the action that the world carries out where agents can turn one way only.

    In the original recordings both turns went the same way. The agents' choices show that they
    expected a turn to the right to go to the right.
    """
    if turning == "both" or action not in (Action.TURN_LEFT, Action.TURN_RIGHT):
        return action
    return Action.TURN_LEFT if turning == "ccw" else Action.TURN_RIGHT
