"""Grabbing in the compiled model: which item, the pull at the grab, and the rigid hold."""

from __future__ import annotations

import math
from typing import Final

from phase_ppl.physics.constants import GRAB_CORRECTIONS
from phase_ppl.physics.flat import ANGLE, SPIN, VX, VY, Params, Scratch, X, Y
from phase_ppl.physics.jit import bare_kernel, inlined_kernel
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.geometry import GRAB_POINTS, GRAB_REACH
from phase_ppl.world.names import NOTHING

_N_POINTS: Final = len(GRAB_POINTS)

_SMALL_TURN: Final = 0.25
"""Radians up to which the Taylor series of ``turn_frame`` are exact to rounding."""


@bare_kernel
def nearest_grab_point(
    bodies: FloatArray, agent: int, item: int, params: Params
) -> tuple[int, float]:
    """Return the agent's grab point nearest to an item's centre, and how far it is, units."""
    c, s = math.cos(bodies[agent, ANGLE]), math.sin(bodies[agent, ANGLE])
    size = params.radius[agent]
    dx, dy = bodies[item, X] - bodies[agent, X], bodies[item, Y] - bodies[agent, Y]
    # the item's centre in the agent's body frame
    x, y = c * dx + s * dy, c * dy - s * dx + params.cog[agent]
    nearest, least = -1, math.inf
    for point in range(_N_POINTS):
        px, py = size * GRAB_POINTS[point, 0], size * GRAB_POINTS[point, 1]
        distance = math.sqrt((x - px) ** 2 + (y - py) ** 2)
        if distance < least:
            nearest, least = point, distance
    return nearest, least


@bare_kernel
def in_reach(bodies: FloatArray, agent: int, item: int, params: Params) -> bool:
    """Whether an item's centre is less than its radius + ``GRAB_REACH`` from a grab point."""
    return nearest_grab_point(bodies, agent, item, params)[1] < params.radius[item] + GRAB_REACH


@bare_kernel
def find_grab(bodies: FloatArray, held: IntArray, agent: int, params: Params) -> tuple[int, int]:
    """Return the item that ``agent`` would grab now, and the grab point it would use.

    It is the nearest item in reach, at its nearest grab point.

    Returns:
        (entity index, index into ``GRAB_POINTS``); -1, -1 if none is in reach or one is held.
    """
    best_item, best_point, best = NOTHING, -1, math.inf
    if held[agent] >= 0:
        return best_item, best_point
    for item in range(held.shape[0], bodies.shape[0]):
        point, distance = nearest_grab_point(bodies, agent, item, params)
        if distance < params.radius[item] + GRAB_REACH and distance < best:
            best_item, best_point, best = item, point, distance
    return best_item, best_point


@inlined_kernel
def place_frame(bodies: FloatArray, agent: int, scratch: Scratch) -> None:
    """Update the cosine and sine of an agent's angle."""
    scratch.rotation[agent, 0] = math.cos(bodies[agent, ANGLE])
    scratch.rotation[agent, 1] = math.sin(bodies[agent, ANGLE])


@inlined_kernel
def turn_frame(bodies: FloatArray, agent: int, turn: float, scratch: Scratch) -> None:
    """As ``place_frame``, after the angle has changed by ``turn``, but faster.

    It uses the Taylor series of a small angle, which are exact to rounding here.
    """
    if turn < -_SMALL_TURN or turn > _SMALL_TURN:
        place_frame(bodies, agent, scratch)
        return
    z = turn * turn
    s = z * (-1 / 6 + z * (1 / 120 + z * (-1 / 5040 + z * (1 / 362880 - z * (1 / 39916800)))))
    c = z * (1 / 24 + z * (-1 / 720 + z * (1 / 40320 + z * (-1 / 3628800 + z * (1 / 479001600)))))
    s, c = turn * (1.0 + s), 1.0 + z * (-0.5 + c)
    old_c, old_s = scratch.rotation[agent, 0], scratch.rotation[agent, 1]
    scratch.rotation[agent, 0] = old_c * c - old_s * s
    scratch.rotation[agent, 1] = old_s * c + old_c * s


@inlined_kernel
def _prepare_rod(
    bodies: FloatArray,
    agent: int,
    item: int,
    weld: FloatArray,
    params: Params,
    scratch: Scratch,
    row: FloatArray,
) -> None:
    """As ``prepare_weld`` for a rod from the agent's origin to the item, free to swivel."""
    c, s = scratch.rotation[agent, 0], scratch.rotation[agent, 1]
    cog = params.cog[agent]
    rx, ry = s * cog, -c * cog
    dx = bodies[item, X] - bodies[agent, X] - rx
    dy = bodies[item, Y] - bodies[agent, Y] - ry
    distance = math.sqrt(dx * dx + dy * dy) + 1e-12
    nx, ny = dx / distance, dy / distance
    lever = rx * ny - ry * nx
    mass = params.inverse_mass[agent] + params.inverse_mass[item]
    scale = 1.0 / (mass + params.inverse_inertia[agent] * lever * lever)
    wx, wy = weld[agent, 0], weld[agent, 1] + cog
    stretch = distance - math.sqrt(wx * wx + wy * wy)
    row[0], row[1] = rx, ry
    row[2], row[3], row[4] = nx * nx * scale, nx * ny * scale, 0.0
    row[5], row[6], row[7] = ny * ny * scale, 0.0, 0.0
    row[8], row[9], row[10] = stretch * nx, stretch * ny, 0.0


@inlined_kernel
def prepare_weld(
    bodies: FloatArray,
    agent: int,
    item: int,
    weld: FloatArray,
    params: Params,
    scratch: Scratch,
    row: FloatArray,
) -> None:
    """Write anchor, inverse effective mass and error of a weld into ``row``.

    Args:
        bodies, weld, params, scratch: of the model.
        agent, item: holder and held.
        row: (11,) row of ``Scratch.welds``. Output: 0, 1 the item's place from the agent's centre
            of mass; 2..7 the upper triangle of the inverse of K = J M^-1 J', by rows; 8..10 the
            error in x, y and angle.
    """
    if params.swivel:
        _prepare_rod(bodies, agent, item, weld, params, scratch, row)
        return
    c, s = scratch.rotation[agent, 0], scratch.rotation[agent, 1]
    rx = weld[agent, 0] * c - weld[agent, 1] * s
    ry = weld[agent, 0] * s + weld[agent, 1] * c
    mass = params.inverse_mass[agent] + params.inverse_mass[item]
    turn = params.inverse_inertia[agent]
    k11, k12, k13 = mass + turn * ry * ry, -turn * rx * ry, -turn * ry
    k22, k23 = mass + turn * rx * rx, turn * rx
    k33 = turn + params.inverse_inertia[item]
    m11 = k22 * k33 - k23 * k23
    m12 = k13 * k23 - k12 * k33
    m13 = k12 * k23 - k13 * k22
    scale = 1.0 / (k11 * m11 + k12 * m12 + k13 * m13)
    row[0], row[1] = rx, ry
    row[2], row[3], row[4] = m11 * scale, m12 * scale, m13 * scale
    row[5], row[6] = (k11 * k33 - k13 * k13) * scale, (k12 * k13 - k11 * k23) * scale
    row[7] = (k11 * k22 - k12 * k12) * scale
    row[8] = bodies[item, X] - bodies[agent, X] - rx
    row[9] = bodies[item, Y] - bodies[agent, Y] - ry
    row[10] = bodies[item, ANGLE] - bodies[agent, ANGLE] - weld[agent, 2]


@inlined_kernel
def _shift(
    bodies: FloatArray,
    agent: int,
    item: int,
    x: int,
    error_x: float,
    error_y: float,
    error_angle: float,
    params: Params,
    row: FloatArray,
) -> float:
    """Change poses (``x`` = X) or velocities (``x`` = VX) by the impulse that corrects an error.

    Returns the square of the impulse.
    """
    jx = -(row[2] * error_x + row[3] * error_y + row[4] * error_angle)
    jy = -(row[3] * error_x + row[5] * error_y + row[6] * error_angle)
    jt = -(row[4] * error_x + row[6] * error_y + row[7] * error_angle)
    bodies[agent, x] -= params.inverse_mass[agent] * jx
    bodies[agent, x + 1] -= params.inverse_mass[agent] * jy
    bodies[agent, x + 2] -= params.inverse_inertia[agent] * (row[0] * jy - row[1] * jx + jt)
    bodies[item, x] += params.inverse_mass[item] * jx
    bodies[item, x + 1] += params.inverse_mass[item] * jy
    bodies[item, x + 2] += params.inverse_inertia[item] * jt
    return jx * jx + jy * jy + jt * jt


@inlined_kernel
def pull(bodies: FloatArray, agent: int, item: int, params: Params, row: FloatArray) -> float:
    """Make a held item move with its holder; return the squared impulse."""
    spin = bodies[agent, SPIN]
    slip_x = bodies[item, VX] - bodies[agent, VX] + row[1] * spin
    slip_y = bodies[item, VY] - bodies[agent, VY] - row[0] * spin
    slip_angle = bodies[item, SPIN] - spin
    return _shift(bodies, agent, item, VX, slip_x, slip_y, slip_angle, params, row)


@inlined_kernel
def mend(
    bodies: FloatArray, agent: int, item: int, weld: FloatArray, params: Params, scratch: Scratch
) -> None:
    """Move and turn holder and item towards the weld's pose, by their masses and inertias.

    This is a Newton step. It changes no velocity: Chipmunk's joints pull errors back by velocities,
    which would drive bodies on when two welds or a wall oppose each other.
    """
    row = scratch.welds[agent]
    prepare_weld(bodies, agent, item, weld, params, scratch, row)
    _shift(bodies, agent, item, X, row[8], row[9], row[10], params, row)
    place_frame(bodies, agent, scratch)


@bare_kernel
def attach(
    bodies: FloatArray,
    held: IntArray,
    weld: FloatArray,
    agent: int,
    params: Params,
    scratch: Scratch,
) -> None:
    """Grab the nearest item in reach, if any, and pull both bodies into place at once."""
    item, point = find_grab(bodies, held, agent, params)
    if item < 0:
        return
    length = params.radius[agent] + params.radius[item]
    held[agent] = item
    weld[agent, 0] = length * GRAB_POINTS[point, 0]
    weld[agent, 1] = length * GRAB_POINTS[point, 1] - params.cog[agent]
    weld[agent, 2] = bodies[item, ANGLE] - bodies[agent, ANGLE]
    if params.swivel:
        # the rod keeps its present length
        c, s = scratch.rotation[agent, 0], scratch.rotation[agent, 1]
        dx, dy = bodies[item, X] - bodies[agent, X], bodies[item, Y] - bodies[agent, Y]
        weld[agent, 0], weld[agent, 1] = c * dx + s * dy, c * dy - s * dx
        return
    for _ in range(GRAB_CORRECTIONS):
        mend(bodies, agent, item, weld, params, scratch)
