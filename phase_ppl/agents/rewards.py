"""Reward of a state for the current subgoal, and the actions worth trying for it.

Source: paper, Appendix "Hierarchical Planner"; distances are divided by the arena's diagonal.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.ground import DISTANCE_UNIT, Ground, body_origin, path_distance, room_of
from phase_ppl.physics.actions import Action
from phase_ppl.physics.compiled import Params
from phase_ppl.physics.jit import bare_kernel
from phase_ppl.world.literals import Literal, Predicate
from phase_ppl.world.names import NOTHING
from phase_ppl.world.rooms import N_ROOMS, UNREACHABLE

SIDEWAYS_COST: Final = 0.02
"""Cost of each translation other than straight ahead."""

_ON, _TOUCH, _ATTACH, _CLOSE = (
    int(p) for p in (Predicate.ON, Predicate.TOUCH, Predicate.ATTACH, Predicate.CLOSE)
)
_FIRST_SIDEWAYS, _LAST_SIDEWAYS = int(Action.DOWN), int(Action.DOWN_RIGHT)

_NAVIGATION: Final = (
    Action.TURN_LEFT,
    Action.TURN_RIGHT,
    Action.UP,
    Action.STOP,
    Action.NO_FORCE,
)
_GRIP: Final = (Action.ATTACH, Action.DETACH)


def subgoal_code(literal: Literal) -> NDArray[np.int64]:
    """Return (predicate, subject, target, sign) for compiled code."""
    sign = 1 if literal.positive else -1
    return np.array([literal.predicate, literal.subject, literal.target, sign], np.int64)


def actions_for(
    literal: Literal, agent: int, held: int, contested: bool = False
) -> NDArray[np.int64]:
    """Return the actions that ``agent`` considers for a subgoal, indices into ``Action``.

    Args:
        literal: the subgoal.
        agent: who plans.
        held: item it holds or ``NOTHING``.
        contested: the other agent wants to keep it from the landmark it wants to be on.
    """
    predicate, subject = literal.predicate, literal.subject
    without: tuple[Action, ...]
    if predicate is Predicate.TOUCH or (subject == agent and predicate is Predicate.CLOSE):
        return np.array(_NAVIGATION, np.int64)
    if subject == agent and predicate is Predicate.ON and not contested:
        return np.array(_NAVIGATION, np.int64)
    if predicate is Predicate.ATTACH:
        without = () if held != NOTHING else (Action.DETACH,)
    elif predicate is Predicate.ON and subject >= 2:
        without = (Action.DETACH,)
    elif predicate is Predicate.CLOSE and subject >= 2:
        without = _GRIP if held != NOTHING else (Action.DETACH,)
    else:
        without = _GRIP
    return np.array([action for action in Action if action not in without], np.int64)


@bare_kernel
def _distance(
    bodies: NDArray[np.float64],
    held: NDArray[np.int64],
    subgoal: NDArray[np.int64],
    params: Params,
    ground: Ground,
) -> float:
    predicate, subject, target = subgoal[0], subgoal[1], subgoal[2]
    if predicate == _ATTACH:
        return 0.0 if held[subject] == target else DISTANCE_UNIT
    x, y = body_origin(bodies, subject, params.cog)
    if predicate == _ON:
        return path_distance(x, y, ground.landmarks[target, 0], ground.landmarks[target, 1], ground)
    if predicate == _TOUCH:
        other_x, other_y = body_origin(bodies, target, params.cog)
        return path_distance(x, y, other_x, other_y, ground)
    if target >= N_ROOMS:
        door = target - N_ROOMS
        return path_distance(x, y, ground.doors[door, 0], ground.doors[door, 1], ground)
    px, py = ground.room_points[target, 0], ground.room_points[target, 1]
    room = room_of(x, y, ground)
    if room == target:
        inside = math.sqrt((x - px) ** 2 + (y - py) ** 2)
        return inside - UNREACHABLE if subject >= 2 else inside
    door = ground.neighbour[room, target]
    if door < 0:
        return DISTANCE_UNIT
    dx, dy = ground.doors[door, 0], ground.doors[door, 1]
    return math.sqrt((x - dx) ** 2 + (y - dy) ** 2) + math.sqrt((dx - px) ** 2 + (dy - py) ** 2)


@bare_kernel
def reward(
    bodies: NDArray[np.float64],
    held: NDArray[np.int64],
    subgoal: NDArray[np.int64],
    action: int,
    params: Params,
    ground: Ground,
) -> float:
    """Return the reward of being in a state after ``action``, for one subgoal."""
    value = -subgoal[3] * _distance(bodies, held, subgoal, params, ground) / DISTANCE_UNIT
    if _FIRST_SIDEWAYS <= action <= _LAST_SIDEWAYS:
        value -= SIDEWAYS_COST
    return value
