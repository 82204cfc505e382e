"""The compiled model of the dynamics, for imagination: belief prediction and tree search.

It has the physics of :mod:`phase_ppl.physics.pymunk_world`, which describes a substep. It works on
the flat arrays of :mod:`phase_ppl.physics.flat`. Kernels release the GIL and allocate nothing.
"""

from __future__ import annotations

import math

from phase_ppl.physics.actions import DIRECTIONS, Action
from phase_ppl.physics.constants import FLOOR_FRICTION, SHARED_WELD_SWEEPS
from phase_ppl.physics.contacts import find_contacts, rub, solve
from phase_ppl.physics.flat import (
    ANGLE,
    BIAS_SPIN,
    BIAS_VX,
    BIAS_VY,
    SPIN,
    VX,
    VY,
    Params,
    Scratch,
    X,
    Y,
    from_state,
    make_params,
    make_scratch,
    to_state,
)
from phase_ppl.physics.jit import inlined_kernel, linked_kernel
from phase_ppl.physics.welds import attach, find_grab, mend, place_frame, turn_frame
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.names import AGENTS, ENTITIES, NOTHING

__all__ = [
    "Params",
    "Scratch",
    "find_grab",
    "from_state",
    "make_params",
    "make_scratch",
    "step",
    "step_mean",
    "to_state",
]


_TURN_LEFT, _TURN_RIGHT = int(Action.TURN_LEFT), int(Action.TURN_RIGHT)
_FIRST_PUSH, _LAST_PUSH = int(Action.UP), int(Action.DOWN_RIGHT)
_USUAL_BODIES, _USUAL_AGENTS = len(ENTITIES), len(AGENTS)
_STOP, _ATTACH, _DETACH = int(Action.STOP), int(Action.ATTACH), int(Action.DETACH)


@inlined_kernel
def stay_apart(
    bodies: FloatArray,
    held: IntArray,
    actions: IntArray,
    n_bodies: int,
    n_agents: int,
    params: Params,
    scratch: Scratch,
) -> bool:
    """Whether no body can meet another or a wall during this planner step.

    Every body lies in a circle that it cannot leave: the only impulses on it are its own force and
    the friction.
    """
    for agent in range(n_agents):
        if held[agent] >= 0:
            return False
    duration = params.dt * params.substeps
    for body in range(n_bodies):
        speed = math.sqrt(bodies[body, VX] ** 2 + bodies[body, VY] ** 2) + math.sqrt(
            bodies[body, BIAS_VX] ** 2 + bodies[body, BIAS_VY] ** 2
        )
        if body < n_agents:
            action = actions[body]
            force = params.force[body] if _FIRST_PUSH <= action <= _LAST_PUSH else 0.0
            spins = 0 <= action <= _TURN_RIGHT or bodies[body, SPIN] != 0.0
            if spins or force > 0.0 or speed > 0.0:
                # friction acts off the centre of mass, so that it can also turn spin into speed
                force += FLOOR_FRICTION
            speed += force * params.inverse_mass[body] * duration
        x, y = bodies[body, X], bodies[body, Y]
        reach = params.extent[body] + speed * duration
        if (
            (x - reach < params.border[0])
            | (x + reach > params.border[1])
            | (y - reach < params.border[2])
            | (y + reach > params.border[3])
        ):
            return False
        for w in range(params.wall_boxes.shape[0]):
            box = params.wall_boxes[w]
            if (
                (box[0] <= x + reach)
                & (box[1] >= x - reach)
                & (box[2] <= y + reach)
                & (box[3] >= y - reach)
            ):
                return False
        scratch.boxes[body, 0] = reach
        for other in range(body):
            dx, dy = x - bodies[other, X], y - bodies[other, Y]
            if dx * dx + dy * dy < (reach + scratch.boxes[other, 0]) ** 2:
                return False
    return True


@inlined_kernel
def _push(agent: int, action: int, params: Params, scratch: Scratch) -> None:
    """Write the velocity change by the agent's own force in one substep into ``scratch.kick``."""
    kick = scratch.kick[agent]
    kick[0], kick[1], kick[2] = 0.0, 0.0, 0.0
    inverse_inertia = params.inverse_inertia[agent]
    if action == _TURN_LEFT:
        kick[2] = params.torque[agent] * params.dt * inverse_inertia
    elif action == _TURN_RIGHT:
        kick[2] = -params.torque[agent] * params.dt * inverse_inertia
    elif _FIRST_PUSH <= action <= _LAST_PUSH:
        c, s = scratch.rotation[agent, 0], scratch.rotation[agent, 1]
        impulse = params.force[agent] * params.dt
        jx, jy = impulse * DIRECTIONS[action, 0], impulse * DIRECTIONS[action, 1]
        arm = params.force_point[agent] - params.cog[agent]
        kick[0] = params.inverse_mass[agent] * (c * jx - s * jy)
        kick[1] = params.inverse_mass[agent] * (s * jx + c * jy)
        kick[2] = -inverse_inertia * arm * jx


@inlined_kernel
def _move(
    bodies: FloatArray, body: int, vx: int, dt: float, n_agents: int, scratch: Scratch
) -> None:
    """Move a body by its velocity (``vx`` = VX) or its bias velocity (``vx`` = BIAS_VX)."""
    bodies[body, X] += bodies[body, vx] * dt
    bodies[body, Y] += bodies[body, vx + 1] * dt
    if bodies[body, vx + 2] != 0.0:
        turn = bodies[body, vx + 2] * dt
        bodies[body, ANGLE] += turn
        if body < n_agents:
            turn_frame(bodies, body, turn, scratch)


@inlined_kernel
def _parts(
    bodies: FloatArray, n_bodies: int, n_agents: int, params: Params, scratch: Scratch
) -> int:
    """Return the number of parts that keeps all moves of this substep short enough."""
    fastest = 0.0
    for body in range(n_bodies):
        vx, vy = bodies[body, VX], bodies[body, VY]
        if body < n_agents:
            vx += scratch.kick[body, 0]
            vy += scratch.kick[body, 1]
        fastest = max(fastest, vx * vx + vy * vy)
    parts = params.inner_steps
    way = fastest * params.dt**2
    while parts < params.most_parts and way > (params.longest_move * parts) ** 2:
        parts *= 2
    return parts


@inlined_kernel
def _inner_step(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    part: int,
    parts: int,
    apart: bool,
    n_bodies: int,
    n_agents: int,
    params: Params,
    scratch: Scratch,
) -> None:
    """Collide, accelerate (in the first part of a substep only), solve, and move."""
    first = part == 0
    dt = params.dt / parts
    for body in range(n_bodies):
        _move(bodies, body, BIAS_VX, dt, n_agents, scratch)
        bodies[body, BIAS_VX] = 0.0
        bodies[body, BIAS_VY] = 0.0
        bodies[body, BIAS_SPIN] = 0.0
        scratch.touched[body] = False
        scratch.rub[body, 0] = 0.0
        scratch.rub[body, 1] = 0.0
    n_contacts = 0
    if not apart:
        n_contacts = find_contacts(bodies, held, params, scratch)
    together = n_contacts > 0
    for agent in range(n_agents):
        if held[agent] >= 0:
            scratch.touched[agent] = True
            scratch.touched[held[agent]] = True
            together = True
        if first:
            bodies[agent, VX] += scratch.kick[agent, 0]
            bodies[agent, VY] += scratch.kick[agent, 1]
            bodies[agent, SPIN] += scratch.kick[agent, 2]
    if first:
        for body in range(n_bodies):
            if not scratch.touched[body]:
                rub(bodies, body, params, scratch)
    if together:
        solve(bodies, held, weld, n_contacts, parts, first, params, scratch)
    for body in range(n_bodies):
        _move(bodies, body, VX, dt, n_agents, scratch)


@inlined_kernel
def _begin(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    actions: IntArray,
    n_bodies: int,
    n_agents: int,
    params: Params,
    scratch: Scratch,
) -> bool:
    """Attach and detach, which act once; return whether all bodies stay apart."""
    for agent in range(n_agents):
        place_frame(bodies, agent, scratch)
        action = actions[agent]
        if action == _ATTACH:
            attach(bodies, held, weld, agent, params, scratch)
        elif action == _DETACH:
            held[agent] = NOTHING
    return stay_apart(bodies, held, actions, n_bodies, n_agents, params, scratch)


@inlined_kernel
def _is_shared(held: IntArray, n_agents: int) -> bool:
    """Whether two agents hold the same item."""
    for agent in range(1, n_agents):
        for other in range(agent):
            if held[agent] >= 0 and held[agent] == held[other]:
                return True
    return False


@inlined_kernel
def _substep(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    actions: IntArray,
    apart: bool,
    n_bodies: int,
    n_agents: int,
    params: Params,
    scratch: Scratch,
) -> None:
    for agent in range(n_agents):
        action = actions[agent]
        if action == _STOP:
            bodies[agent, VX] = 0.0
            bodies[agent, VY] = 0.0
        _push(agent, action, params, scratch)
    # with nothing to meet on the way there is no need to divide the movement
    parts = 1 if apart else _parts(bodies, n_bodies, n_agents, params, scratch)
    for part in range(parts):
        _inner_step(bodies, held, weld, part, parts, apart, n_bodies, n_agents, params, scratch)
    # two holders of one item pull at it in turn
    for _ in range(SHARED_WELD_SWEEPS if _is_shared(held, n_agents) else 1):
        for agent in range(n_agents):
            if held[agent] >= 0:
                mend(bodies, agent, held[agent], weld, params, scratch)


@inlined_kernel
def _advance_all(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    actions: IntArray,
    n_bodies: int,
    n_agents: int,
    params: Params,
    scratch: Scratch,
    with_mean: bool,
) -> None:
    apart = _begin(bodies, held, weld, actions, n_bodies, n_agents, params, scratch)
    frame = scratch.frame
    for body in range(n_bodies):
        frame[body, 0], frame[body, 1], frame[body, 2] = 0.0, 0.0, 0.0
    for _ in range(params.substeps):
        _substep(bodies, held, weld, actions, apart, n_bodies, n_agents, params, scratch)
        if with_mean:
            for body in range(n_bodies):
                c, s, cog = scratch.rotation[body, 0], scratch.rotation[body, 1], params.cog[body]
                frame[body, 0] += (bodies[body, X] + s * cog) / params.substeps
                frame[body, 1] += (bodies[body, Y] - c * cog) / params.substeps
                frame[body, 2] += bodies[body, ANGLE] / params.substeps
    for agent in range(n_agents):
        bodies[agent, SPIN] = 0.0
        if params.resets_velocity:
            bodies[agent, VX] = 0.0
            bodies[agent, VY] = 0.0


@linked_kernel
def _advance(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    actions: IntArray,
    params: Params,
    scratch: Scratch,
    with_mean: bool,
) -> None:
    """Advance by one planner step; leave the mean pose in ``scratch.frame`` if wanted."""
    n_bodies, n_agents = bodies.shape[0], held.shape[0]
    if n_bodies == _USUAL_BODIES and n_agents == _USUAL_AGENTS:
        # the same, with loops whose length the compiler knows
        _advance_all(
            bodies, held, weld, actions, _USUAL_BODIES, _USUAL_AGENTS, params, scratch, with_mean
        )
        return
    _advance_all(bodies, held, weld, actions, n_bodies, n_agents, params, scratch, with_mean)


@inlined_kernel
def step(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    actions: IntArray,
    params: Params,
    scratch: Scratch,
) -> None:
    """Advance the world by one planner step, in place.

    Args:
        bodies: (body, 9) as in :mod:`phase_ppl.physics.flat`.
        held: (agent,) item of each agent or ``NOTHING``.
        weld: (agent, 3) item's x, y in the agent's frame about its centre of mass, relative angle.
        actions: (agent,) values of ``Action`` or ``NO_ACTION``.
        params, scratch: from ``make_params`` and ``make_scratch``.
    """
    _advance(bodies, held, weld, actions, params, scratch, False)


@inlined_kernel
def step_mean(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    actions: IntArray,
    params: Params,
    scratch: Scratch,
    frame: FloatArray,
) -> None:
    """As ``step``, and write the (body, 3) mean pose of the body origins over the substeps."""
    _advance(bodies, held, weld, actions, params, scratch, True)
    for body in range(bodies.shape[0]):
        for coord in range(3):
            frame[body, coord] = scratch.frame[body, coord]
