"""Inverse dynamics: how well each joint action explains the next observed frame.

Of two agents and two items. From one estimate of the full state every pair of actions is carried
out for one planner step; the density of the observed frame around each of the resulting frames says
which actions were taken.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.physics import compiled
from phase_ppl.physics.actions import N_ACTIONS, Action
from phase_ppl.physics.compiled import Params, Scratch
from phase_ppl.physics.flat import ANGLE, SPIN, VX, VY, X, Y
from phase_ppl.physics.jit import bare_kernel
from phase_ppl.world.arrays import FloatArray, IntArray

_UP = int(Action.UP)

FRAME_LAG: Final = 3
"""A frame, the mean over the substeps of a planner step, shows the third of five."""


class Trial(NamedTuple):
    """A state on which an action can be tried without losing the original."""

    bodies: FloatArray  # (entity, 9), as in ``physics.compiled``, like those below
    held: IntArray  # (agent,)
    weld: FloatArray  # (agent, 3)
    frame: FloatArray  # (4, 3) mean pose of the last step tried
    parts: FloatArray  # (N_ACTIONS,) work space
    actions: IntArray  # (2,) the joint action tried


def make_trial() -> Trial:
    """Return room for one trial."""
    return Trial(
        np.zeros((4, 9)),
        np.zeros(2, np.int64),
        np.zeros((2, 3)),
        np.zeros((4, 3)),
        np.zeros(N_ACTIONS),
        np.zeros(2, np.int64),
    )


@bare_kernel
def _copy(bodies: FloatArray, held: IntArray, weld: FloatArray, trial: Trial) -> None:
    for body in range(4):
        for column in range(9):
            trial.bodies[body, column] = bodies[body, column]
    for agent in range(2):
        trial.held[agent] = held[agent]
        for column in range(3):
            trial.weld[agent, column] = weld[agent, column]


@bare_kernel
def attempt(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    action_red: int,
    action_green: int,
    params: Params,
    scratch: Scratch,
    trial: Trial,
) -> None:
    """Carry out one joint action from a state; the state and frame that follow are in ``trial``."""
    _copy(bodies, held, weld, trial)
    trial.actions[0], trial.actions[1] = action_red, action_green
    compiled.step_mean(
        trial.bodies,
        trial.held,
        trial.weld,
        trial.actions,
        params,
        scratch,
        trial.frame,
    )


@bare_kernel
def _entity_log_density(
    frame: FloatArray,
    observed: FloatArray,
    entity: int,
    scale: float,
    angle_scale: float,
    tail: float,
) -> float:
    """Return the log density of one entity's observed pose around the predicted one."""
    dx = (observed[entity, 0] - frame[entity, 0]) / scale
    dy = (observed[entity, 1] - frame[entity, 1]) / scale
    total = -math.log(2.0 * math.pi) - 2.0 * math.log(scale)
    total -= 0.5 * (tail + 2.0) * math.log1p((dx * dx + dy * dy) / tail)
    if entity < 2:
        turn = (observed[entity, 2] - frame[entity, 2]) / angle_scale
        total += (
            math.lgamma(0.5 * (tail + 1.0))
            - math.lgamma(0.5 * tail)
            - 0.5 * math.log(tail * math.pi)
            - math.log(angle_scale)
            - 0.5 * (tail + 1.0) * math.log1p(turn * turn / tail)
        )
    return total


@bare_kernel
def _is_apart(
    bodies: FloatArray, held: IntArray, params: Params, scratch: Scratch, trial: Trial
) -> bool:
    """Whether the agents cannot meet anything, nor grab, whatever they do."""
    trial.actions[0], trial.actions[1] = _UP, _UP
    if not compiled.stay_apart(bodies, held, trial.actions, 4, 2, params, scratch):
        return False
    for agent in range(2):
        item, _ = compiled.find_grab(bodies, held, agent, params)
        if item >= 0:
            return False
    return True


@bare_kernel
def try_all(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    strengths: FloatArray,
    observed: FloatArray,
    scale: float,
    angle_scale: float,
    tail: float,
    params: Params,
    scratch: Scratch,
    trial: Trial,
    found: FloatArray,
) -> None:
    """Write the log density of the observed frame after every joint action, for every state.

    The density is Student's t with ``tail`` degrees of freedom: in two dimensions for the
    position of each entity, in one for the angle of each agent. Angles of items are not looked
    at. Where the agents can meet nothing they move independently, and 14 trials tell all 196.

    Args:
        bodies, held, weld: (B, ...) states.
        strengths: (B, 2) newtons, which replace those of ``params``.
        observed: (4, 3) x, y [units], angle [rad].
        scale: of positions, units; angle_scale: of angles, rad.
        tail: degrees of freedom.
        params, scratch, trial: work space; the forces of ``params`` are overwritten.
        found: (B, N_ACTIONS, N_ACTIONS) output, red's action first.
    """
    for b in range(bodies.shape[0]):
        params.force[0], params.force[1] = strengths[b, 0], strengths[b, 1]
        state, holds, welds = bodies[b], held[b], weld[b]
        if _is_apart(state, holds, params, scratch, trial):
            for action in range(N_ACTIONS):
                attempt(state, holds, welds, action, action, params, scratch, trial)
                for agent in range(2):
                    part = _entity_log_density(
                        trial.frame, observed, agent, scale, angle_scale, tail
                    )
                    for other in range(N_ACTIONS):
                        if agent == 0:
                            found[b, action, other] = part
                        else:
                            trial.parts[action] = part
            rest = 0.0
            for item in range(2, 4):
                rest += _entity_log_density(trial.frame, observed, item, scale, angle_scale, tail)
            for red in range(N_ACTIONS):
                for green in range(N_ACTIONS):
                    found[b, red, green] += trial.parts[green] + rest
            continue
        for red in range(N_ACTIONS):
            for green in range(N_ACTIONS):
                attempt(state, holds, welds, red, green, params, scratch, trial)
                total = 0.0
                for entity in range(4):
                    total += _entity_log_density(
                        trial.frame, observed, entity, scale, angle_scale, tail
                    )
                found[b, red, green] = total


@bare_kernel
def follow(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    strengths: FloatArray,
    parents: IntArray,
    actions: IntArray,
    observed: FloatArray,
    gains: FloatArray,
    params: Params,
    scratch: Scratch,
    trial: Trial,
    next_bodies: FloatArray,
    next_held: IntArray,
    next_weld: FloatArray,
) -> None:
    """Write the states after the chosen joint actions, corrected by the observed frame.

    Args:
        bodies, held, weld, strengths: (B, ...) as in :func:`try_all`.
        parents: (N,) indices of states; actions: (N, 2) what is done there.
        observed: (4, 3).
        gains: (3,) share of the difference between the observed and the predicted frame by
            which position, velocity (per ``FRAME_LAG`` substeps) and angle are corrected.
        next_bodies, next_held, next_weld: (N, ...) output.
    """
    lag = FRAME_LAG * params.dt
    for n in range(parents.shape[0]):
        b = parents[n]
        params.force[0], params.force[1] = strengths[b, 0], strengths[b, 1]
        attempt(bodies[b], held[b], weld[b], actions[n, 0], actions[n, 1], params, scratch, trial)
        for body in range(4):
            dx = observed[body, 0] - trial.frame[body, 0]
            dy = observed[body, 1] - trial.frame[body, 1]
            for column in range(9):
                next_bodies[n, body, column] = trial.bodies[body, column]
            next_bodies[n, body, X] += gains[0] * dx
            next_bodies[n, body, Y] += gains[0] * dy
            moving = trial.bodies[body, VX] != 0.0 or trial.bodies[body, VY] != 0.0
            if moving:
                next_bodies[n, body, VX] += gains[1] * dx / lag
                next_bodies[n, body, VY] += gains[1] * dy / lag
            if body < 2:
                turn = observed[body, 2] - trial.frame[body, 2]
                # about the body origin, which is what was observed
                next_bodies[n, body, ANGLE] += gains[2] * turn
                next_bodies[n, body, SPIN] = 0.0
        for agent in range(2):
            next_held[n, agent] = trial.held[agent]
            for column in range(3):
                next_weld[n, agent, column] = trial.weld[agent, column]
