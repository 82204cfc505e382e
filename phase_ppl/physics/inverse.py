"""Inverse dynamics: how well each joint action explains the next observed frame.

Each joint action is tried: it is carried out for one planner step from an estimate of the full
state. The density of the observed frame around the resulting frame says how well it explains it.
Joint actions are numbered with the first agent's as the most significant digit.

Agents that cannot meet within the step, by themselves or over items, move independently. One trial
then tells of one action of each, and all joint actions follow. Of two agents that can meet, all
joint actions are tried. Of three or more, pairs are tried while the others do their best, and the
log densities are added up. Effects of three actions beyond those of pairs are left out.
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
from phase_ppl.physics.records import record
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray

_STOP, _NO_FORCE = int(Action.STOP), int(Action.NO_FORCE)
_ATTACH, _DETACH = int(Action.ATTACH), int(Action.DETACH)
_SUBSTEPS_ADD = 0.6  # of acceleration x duration^2, distance by a push: 1/2 and the steps' ends

FRAME_LAG: Final = 3
"""A frame is the mean over the five substeps of a planner step, and so shows the third."""

_SWEEPS = 2  # over the agents of a group, to find their best joint action
_ALONE = -1  # group of an item that no agent can meet


class Scatter(NamedTuple):
    """Scatter of observed frames about predicted ones: Student's t, independent for each body."""

    scale: FloatArray  # (entity,) of positions, units
    angle_scale: FloatArray  # (entity,) of agents' angles, rad
    tail: float  # degrees of freedom


@record
class Trial(NamedTuple):
    """A copy of a state on which actions are tried, and the results."""

    bodies: FloatArray  # (entity, 9), as in ``physics.flat``, like the two below
    held: IntArray  # (agent,)
    weld: FloatArray  # (agent, 3)
    frame: FloatArray  # (entity, 3) mean pose of the last step tried
    actions: IntArray  # (agent,) the joint action tried
    group: IntArray  # (entity,) the first agent that each can meet, or ``_ALONE``
    way: FloatArray  # (entity,) how far each can get, units
    grabs: BoolArray  # (agent,) whether each can grab something
    best: IntArray  # (agent,) the best action so far
    parts: FloatArray  # (agent, joint action of its group) log densities
    alone: FloatArray  # (agent, N_ACTIONS) work space
    pairs: FloatArray  # (agent, agent, N_ACTIONS, N_ACTIONS) work space


def make_trial(n_bodies: int = 4, n_agents: int = 2) -> Trial:
    """Return space for one trial of ``n_bodies`` bodies, the first ``n_agents`` of them agents."""
    return Trial(
        np.zeros((n_bodies, 9)),
        np.zeros(n_agents, np.int64),
        np.zeros((n_agents, 3)),
        np.zeros((n_bodies, 3)),
        np.zeros(n_agents, np.int64),
        np.zeros(n_bodies, np.int64),
        np.zeros(n_bodies),
        np.zeros(n_agents, np.bool_),
        np.zeros(n_agents, np.int64),
        np.zeros((n_agents, N_ACTIONS**n_agents)),
        np.zeros((n_agents, N_ACTIONS)),
        np.zeros((n_agents, n_agents, N_ACTIONS, N_ACTIONS)),
    )


@bare_kernel
def _copy(bodies: FloatArray, held: IntArray, weld: FloatArray, trial: Trial) -> None:
    for body in range(bodies.shape[0]):
        for column in range(9):
            trial.bodies[body, column] = bodies[body, column]
    for agent in range(held.shape[0]):
        trial.held[agent] = held[agent]
        for column in range(3):
            trial.weld[agent, column] = weld[agent, column]


@bare_kernel
def attempt(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    params: Params,
    scratch: Scratch,
    trial: Trial,
) -> None:
    """Carry out ``trial.actions`` from a state; write the results into ``trial``."""
    _copy(bodies, held, weld, trial)
    compiled.step_mean(
        trial.bodies, trial.held, trial.weld, trial.actions, params, scratch, trial.frame
    )


@bare_kernel
def _entity_log_density(
    frame: FloatArray, observed: FloatArray, entity: int, is_agent: bool, scatter: Scatter
) -> float:
    """Return the log density of one entity's observed pose around the predicted one.

    That of what was seen of it: a position or an angle of NaN counts for nothing.
    """
    scale, angle_scale, tail = scatter.scale[entity], scatter.angle_scale[entity], scatter.tail
    total = 0.0
    if not math.isnan(observed[entity, 0]):
        dx = (observed[entity, 0] - frame[entity, 0]) / scale
        dy = (observed[entity, 1] - frame[entity, 1]) / scale
        total = -math.log(2.0 * math.pi) - 2.0 * math.log(scale)
        total -= 0.5 * (tail + 2.0) * math.log1p((dx * dx + dy * dy) / tail)
    if is_agent and not math.isnan(observed[entity, 2]):
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
def _join(one: int, other: int, trial: Trial) -> None:
    """Merge the groups of two bodies; each body may then move as far as the farthest of them."""
    way = max(trial.way[one], trial.way[other])
    low = min(trial.group[one], trial.group[other])
    high = max(trial.group[one], trial.group[other])
    for body in range(trial.group.shape[0]):
        if trial.group[body] == high:
            trial.group[body] = low
        if trial.group[body] == low:
            trial.way[body] = way


@bare_kernel
def _find_groups(bodies: FloatArray, held: IntArray, params: Params, trial: Trial) -> None:
    """Write into ``trial`` the groups that can meet in this planner step, and who can grab."""
    n_bodies, n_agents = bodies.shape[0], held.shape[0]
    duration = params.dt * params.substeps
    for body in range(n_bodies):
        trial.group[body] = body
        trial.way[body] = duration * math.hypot(bodies[body, VX], bodies[body, VY])
        if body < n_agents:
            pushed = params.force[body] * params.inverse_mass[body]
            trial.way[body] += _SUBSTEPS_ADD * pushed * duration**2
    for agent in range(n_agents):
        item = held[agent]
        trial.grabs[agent] = False
        if item < 0:
            item, _ = compiled.find_grab(bodies, held, agent, params)
            trial.grabs[agent] = item >= 0
        if item >= 0:
            _join(agent, item, trial)
    joined = True
    while joined:  # a body that is hit may move as far as the one that hits it, and hit others
        joined = False
        for body in range(n_bodies):
            for other in range(body):
                reach = params.extent[body] + params.extent[other]
                reach += trial.way[body] + trial.way[other]
                dx = bodies[body, X] - bodies[other, X]
                dy = bodies[body, Y] - bodies[other, Y]
                if trial.group[body] != trial.group[other] and dx * dx + dy * dy < reach * reach:
                    _join(body, other, trial)
                    joined = True
    for item in range(n_agents, n_bodies):
        if trial.group[item] >= n_agents:
            trial.group[item] = _ALONE


@bare_kernel
def _first_alike(held: IntArray, trial: Trial) -> int:
    """Return the first joint action with the same effect as the one in ``trial``.

    Letting go without a hold, or grabbing out of reach, is the same as exerting no force. A grab
    moves the item, after which others may be able to grab something.
    """
    joint, grabbed = 0, False
    for agent in range(held.shape[0]):
        action = trial.actions[agent]
        grabbed |= action == _ATTACH and trial.grabs[agent]
        if (action == _ATTACH and not grabbed) or (action == _DETACH and held[agent] < 0):
            action = _NO_FORCE
        joint = joint * N_ACTIONS + action
    return joint


@bare_kernel
def _group_log_density(group: int, observed: FloatArray, scatter: Scatter, trial: Trial) -> float:
    """Return the log density of a group's observed poses after the last trial."""
    total = 0.0
    for entity in range(trial.group.shape[0]):
        if trial.group[entity] == group:
            is_agent = entity < trial.held.shape[0]
            total += _entity_log_density(trial.frame, observed, entity, is_agent, scatter)
    return total


@bare_kernel
def _size(group: int, trial: Trial) -> int:
    """Return how many agents are in a group."""
    n = 0
    for agent in range(trial.held.shape[0]):
        n += trial.group[agent] == group
    return n


@bare_kernel
def _try_pairs(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    observed: FloatArray,
    scatter: Scatter,
    params: Params,
    scratch: Scratch,
    trial: Trial,
    group: int,
) -> None:
    """Write the log densities of a group of three agents or more into ``trial.parts``."""
    n_agents, n = held.shape[0], _size(group, trial)
    actions, best = trial.actions, trial.best
    for agent in range(n_agents):
        actions[agent] = best[agent] = _STOP
    for _ in range(_SWEEPS):
        for agent in range(n_agents):
            if trial.group[agent] == group:
                highest = -math.inf
                for action in range(N_ACTIONS):
                    actions[agent] = action
                    attempt(bodies, held, weld, params, scratch, trial)
                    found = _group_log_density(group, observed, scatter, trial)
                    if found > highest:
                        highest, best[agent] = found, action
                actions[agent] = best[agent]
    for one in range(n_agents):
        for other in range(one):
            if trial.group[one] == group and trial.group[other] == group:
                for first in range(N_ACTIONS):
                    for second in range(N_ACTIONS):
                        actions[one], actions[other] = first, second
                        attempt(bodies, held, weld, params, scratch, trial)
                        trial.pairs[one, other, first, second] = _group_log_density(
                            group, observed, scatter, trial
                        )
                actions[one], actions[other] = best[one], best[other]
                for action in range(N_ACTIONS):
                    trial.alone[one, action] = trial.pairs[one, other, action, best[other]]
                    trial.alone[other, action] = trial.pairs[one, other, best[one], action]
    everywhere = trial.alone[group, best[group]]
    for joint in range(N_ACTIONS**n):
        rest, total = joint, 0.5 * (n - 1) * (n - 2) * everywhere
        for one in range(n_agents - 1, -1, -1):
            if trial.group[one] == group:
                actions[one] = rest % N_ACTIONS
                rest //= N_ACTIONS
                total -= (n - 2) * trial.alone[one, actions[one]]
        for one in range(n_agents):
            for other in range(one):
                if trial.group[one] == group and trial.group[other] == group:
                    total += trial.pairs[one, other, actions[one], actions[other]]
        trial.parts[group, joint] = total


@bare_kernel
def _combine(rest: float, trial: Trial, found: FloatArray) -> None:
    """Write the log densities of all joint actions from those of the groups."""
    n_agents = trial.held.shape[0]
    for joint in range(found.shape[0]):
        total = rest
        for group in range(n_agents - 1, -1, -1):
            if trial.group[group] == group:
                # the digits of its agents are its own joint action
                place, scale, left = 0, 1, joint
                for agent in range(n_agents - 1, -1, -1):
                    if trial.group[agent] == group:
                        place += scale * (left % N_ACTIONS)
                        scale *= N_ACTIONS
                    left //= N_ACTIONS
                total = trial.parts[group, place] + total
        found[joint] = total


@bare_kernel
def try_all(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    strengths: FloatArray,
    observed: FloatArray,
    scatter: Scatter,
    params: Params,
    scratch: Scratch,
    trial: Trial,
    found: FloatArray,
) -> None:
    """Write the log density of the observed frame after every joint action, for every state.

    The density is Student's t: in two dimensions for the position of each entity, in one for the
    angle of each agent. Angles of items are ignored.

    Args:
        bodies, held, weld: (B, ...) states.
        strengths: (B, agent) newtons, which replace those of ``params``.
        observed: (entity, 3) x, y [units], angle [rad], NaN where unseen: the density is over the
            rest.
        scatter: of observed frames about predicted ones.
        params, scratch, trial: work space; the forces of ``params`` are overwritten.
        found: (B, N_ACTIONS ** agents) output.
    """
    n_agents = held.shape[1]
    for b in range(bodies.shape[0]):
        for agent in range(n_agents):
            params.force[agent] = strengths[b, agent]
        state, holds, welds = bodies[b], held[b], weld[b]
        _find_groups(state, holds, params, trial)
        largest = 1
        for group in range(n_agents):
            size = _size(group, trial)
            if size > 2:
                _try_pairs(
                    state, holds, welds, observed, scatter,
                    params, scratch, trial, group,
                )  # fmt: skip
            elif size == 2:
                largest = 2
        # all groups at a time, each with its own joint actions
        last = N_ACTIONS**largest - 1  # is always tried, since it tells of the other bodies too
        for joint in range(last + 1):
            for group in range(n_agents):
                left = joint
                for agent in range(n_agents - 1, -1, -1):
                    if trial.group[agent] == group:
                        trial.actions[agent] = left % N_ACTIONS
                        left //= N_ACTIONS
            if largest == n_agents and joint < last:  # one group
                alike = _first_alike(holds, trial)
                if alike < joint:
                    trial.parts[0, joint] = trial.parts[0, alike]
                    continue
            attempt(state, holds, welds, params, scratch, trial)
            for group in range(n_agents):
                size = _size(group, trial)
                if 0 < size <= 2 and joint < N_ACTIONS**size:
                    trial.parts[group, joint] = _group_log_density(group, observed, scatter, trial)
        rest = _group_log_density(_ALONE, observed, scatter, trial)
        _combine(rest, trial, found[b])


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
    unseen: IntArray,
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
        parents: (N,) indices of states; actions: (N, agent) actions taken there.
        observed: (entity, 3), NaN where unseen, which corrects nothing.
        gains: (entity, 3) corrections of position, velocity and angle, as shares of the difference
            between the observed and the predicted frame; of velocity per ``FRAME_LAG`` substeps,
            and those of the frames in which it was unseen.
        unseen: (entity,) number of frames just before in which its position was unseen.
        next_bodies, next_held, next_weld: (N, ...) output.
    """
    n_agents = held.shape[1]
    for n in range(parents.shape[0]):
        b = parents[n]
        for agent in range(n_agents):
            params.force[agent] = strengths[b, agent]
            trial.actions[agent] = actions[n, agent]
        attempt(bodies[b], held[b], weld[b], params, scratch, trial)
        for body in range(bodies.shape[1]):
            for column in range(9):
                next_bodies[n, body, column] = trial.bodies[body, column]
            if not math.isnan(observed[body, 0]):
                dx = observed[body, 0] - trial.frame[body, 0]
                dy = observed[body, 1] - trial.frame[body, 1]
                lag = (FRAME_LAG + params.substeps * unseen[body]) * params.dt
                next_bodies[n, body, X] += gains[body, 0] * dx
                next_bodies[n, body, Y] += gains[body, 0] * dy
                moving = trial.bodies[body, VX] != 0.0 or trial.bodies[body, VY] != 0.0
                if moving:
                    next_bodies[n, body, VX] += gains[body, 1] * dx / lag
                    next_bodies[n, body, VY] += gains[body, 1] * dy / lag
            if body < n_agents and not math.isnan(observed[body, 2]):
                turn = observed[body, 2] - trial.frame[body, 2]
                # about the body origin, which the observation shows
                next_bodies[n, body, ANGLE] += gains[body, 2] * turn
                next_bodies[n, body, SPIN] = 0.0
        for agent in range(n_agents):
            next_held[n, agent] = trial.held[agent]
            for column in range(3):
                next_weld[n, agent, column] = trial.weld[agent, column]
