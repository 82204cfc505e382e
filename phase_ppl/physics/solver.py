"""Impulses of the compiled model: contacts, floor friction and welds, solved in turn.

Chipmunk's sequential impulses (Catto, 2005): every constraint in turn applies the impulse that
mends its own error, accumulated and clamped, until all agree. Nothing is carried over from one
inner step to the next, so that a state is fully described by its arrays.
"""

from __future__ import annotations

import math
from typing import Final

from phase_ppl.physics.flat import BIAS_SPIN, BIAS_VX, BIAS_VY, SPIN, VX, VY, Params, Scratch
from phase_ppl.physics.jit import bare_kernel, inlined_kernel
from phase_ppl.physics.welds import prepare_weld, pull
from phase_ppl.world.arrays import FloatArray, IntArray

SETTLED: Final = 1e-8
"""The iteration ends when the squares of all impulse changes sum to less than this, (N s)^2."""


@inlined_kernel
def rub(bodies: FloatArray, body: int, params: Params, scratch: Scratch) -> float:
    """Let the floor's friction act on one body; return the squared change of the impulse.

    A joint that wants to stop the body origin, with limited force. The origin of an agent is not
    its centre of mass, so that friction also turns it; in the body frame the effective mass is
    diagonal. For a body that nothing else touches, one call from zero is the exact solution: the
    wanted total impulse does not depend on what has been applied already.
    """
    vx, vy, spin = bodies[body, VX], bodies[body, VY], bodies[body, SPIN]
    if vx == 0.0 and vy == 0.0 and spin == 0.0:
        return 0.0
    c, s = scratch.rotation[body, 0], scratch.rotation[body, 1]
    inverse_mass = params.inverse_mass[body]
    inverse_inertia = params.inverse_inertia[body]
    arm = -params.cog[body]
    along = c * vx + s * vy - spin * arm
    ahead = c * vy - s * vx
    old_x, old_y = scratch.rub[body, 0], scratch.rub[body, 1]
    new_x = old_x - along * params.origin_mass[body, 0]
    new_y = old_y - ahead * params.origin_mass[body, 1]
    squared = new_x * new_x + new_y * new_y
    if squared > params.friction * params.friction:
        scale = params.friction / math.sqrt(squared)
        new_x *= scale
        new_y *= scale
    scratch.rub[body, 0] = new_x
    scratch.rub[body, 1] = new_y
    jx, jy = new_x - old_x, new_y - old_y
    bodies[body, VX] = vx + inverse_mass * (c * jx - s * jy)
    bodies[body, VY] = vy + inverse_mass * (s * jx + c * jy)
    bodies[body, SPIN] = spin - inverse_inertia * arm * jx
    return jx * jx + jy * jy


@inlined_kernel
def _separate(
    bodies: FloatArray, n_contacts: int, rate: float, params: Params, scratch: Scratch
) -> None:
    """Find bias velocities that push overlapping bodies apart, ``rate`` times the overlap."""
    for _ in range(params.iterations):
        change = 0.0
        for k in range(n_contacts):
            a, b = scratch.contact_bodies[k, 0], scratch.contact_bodies[k, 1]
            contact = scratch.contacts[k]
            nx, ny, lever_a, lever_b = contact[0], contact[1], contact[2], contact[3]
            approach = (
                bodies[a, BIAS_VX] * nx + bodies[a, BIAS_VY] * ny + bodies[a, BIAS_SPIN] * lever_a
            )
            if b >= 0:
                approach -= (
                    bodies[b, BIAS_VX] * nx
                    + bodies[b, BIAS_VY] * ny
                    + bodies[b, BIAS_SPIN] * lever_b
                )
            total = max(0.0, contact[6] + (rate * contact[5] + approach) * contact[4])
            j = total - contact[6]
            contact[6] = total
            if j != 0.0:
                change += j * j
                per_mass = params.inverse_mass[a] * j
                bodies[a, BIAS_VX] -= nx * per_mass
                bodies[a, BIAS_VY] -= ny * per_mass
                bodies[a, BIAS_SPIN] -= params.inverse_inertia[a] * lever_a * j
                if b >= 0:
                    per_mass = params.inverse_mass[b] * j
                    bodies[b, BIAS_VX] += nx * per_mass
                    bodies[b, BIAS_VY] += ny * per_mass
                    bodies[b, BIAS_SPIN] += params.inverse_inertia[b] * lever_b * j
        if change < SETTLED:
            break


@inlined_kernel
def _press(bodies: FloatArray, n_contacts: int, params: Params, scratch: Scratch) -> float:
    """Stop bodies from approaching at their contacts; return the squared change of impulses."""
    change = 0.0
    for k in range(n_contacts):
        a, b = scratch.contact_bodies[k, 0], scratch.contact_bodies[k, 1]
        contact = scratch.contacts[k]
        nx, ny, lever_a, lever_b = contact[0], contact[1], contact[2], contact[3]
        approach = bodies[a, VX] * nx + bodies[a, VY] * ny + bodies[a, SPIN] * lever_a
        if b >= 0:
            approach -= bodies[b, VX] * nx + bodies[b, VY] * ny + bodies[b, SPIN] * lever_b
        total = max(0.0, contact[7] + approach * contact[4])
        j = total - contact[7]
        contact[7] = total
        if j != 0.0:
            change += j * j
            per_mass = params.inverse_mass[a] * j
            bodies[a, VX] -= nx * per_mass
            bodies[a, VY] -= ny * per_mass
            bodies[a, SPIN] -= params.inverse_inertia[a] * lever_a * j
            if b >= 0:
                per_mass = params.inverse_mass[b] * j
                bodies[b, VX] += nx * per_mass
                bodies[b, VY] += ny * per_mass
                bodies[b, SPIN] += params.inverse_inertia[b] * lever_b * j
    return change


@bare_kernel
def solve(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    n_contacts: int,
    parts: int,
    with_friction: bool,
    params: Params,
    scratch: Scratch,
) -> None:
    """Change velocities until contacts, floor friction and welds of touched bodies agree.

    Args:
        bodies, held, weld: of the model.
        n_contacts: number of contacts in ``scratch``.
        parts: into which this substep is divided.
        with_friction: whether the floor brakes in this inner step.
        params, scratch: of the model.
    """
    for agent in range(held.shape[0]):
        if held[agent] >= 0:
            row = scratch.welds[agent]
            prepare_weld(bodies, agent, held[agent], weld, params, scratch, row)
    for k in range(n_contacts):
        if scratch.contacts[k, 5] > 0.0:
            _separate(bodies, n_contacts, params.contact_rates[parts], params, scratch)
            break
    for _ in range(params.iterations):
        change = _press(bodies, n_contacts, params, scratch)
        if with_friction:
            for body in range(bodies.shape[0]):
                if scratch.touched[body]:
                    change += rub(bodies, body, params, scratch)
        for agent in range(held.shape[0]):
            if held[agent] >= 0:
                change += pull(bodies, agent, held[agent], params, scratch.welds[agent])
        if change < SETTLED:
            break
