"""Contact points of the compiled model: where two overlapping shapes press on each other.

Points are chosen as Chipmunk chooses them: the two edges that face each other are clipped against
each other along the normal.
"""

from __future__ import annotations

from typing import Final

from phase_ppl.physics.constants import AGENT_SKIN, COLLISION_SLOP
from phase_ppl.physics.flat import MAX_CONTACTS, Params, Scratch, X, Y
from phase_ppl.physics.jit import inlined_kernel
from phase_ppl.world.arrays import FloatArray

Edge = tuple[float, float, float, float]
"""Start x, y and end x, y."""

WALL: Final = -1
"""Stands for the second body of a contact with a wall."""

FAR: Final = 1e300
_TINY = 1e-300


@inlined_kernel
def add_contact(
    bodies: FloatArray,
    n: int,
    first: int,
    second: int,
    nx: float,
    ny: float,
    x1: float,
    y1: float,
    x2: float,
    y2: float,
    params: Params,
    scratch: Scratch,
) -> int:
    """Add the contact of point 1 of the first with point 2 of the second body; return n + 1."""
    if n >= MAX_CONTACTS:
        return n
    gap = (x2 - x1) * nx + (y2 - y1) * ny
    lever_1 = (x1 - bodies[first, X]) * ny - (y1 - bodies[first, Y]) * nx
    lever_2 = 0.0
    inverse = params.inverse_mass[first] + params.inverse_inertia[first] * lever_1 * lever_1
    scratch.touched[first] = True
    if second != WALL:
        lever_2 = (x2 - bodies[second, X]) * ny - (y2 - bodies[second, Y]) * nx
        inverse += params.inverse_mass[second] + params.inverse_inertia[second] * lever_2 * lever_2
        scratch.touched[second] = True
    scratch.contact_bodies[n, 0] = first
    scratch.contact_bodies[n, 1] = second
    contact = scratch.contacts[n]
    contact[0] = nx
    contact[1] = ny
    contact[2] = lever_1
    contact[3] = lever_2
    contact[4] = 1.0 / inverse
    contact[5] = max(0.0, -gap - COLLISION_SLOP)
    contact[6] = 0.0
    contact[7] = 0.0
    return n + 1


@inlined_kernel
def clamp(x: float) -> float:
    """Return ``x`` limited to 0..1."""
    return min(1.0, max(0.0, x))


@inlined_kernel
def clip(
    bodies: FloatArray,
    n: int,
    first: int,
    second: int,
    nx: float,
    ny: float,
    edge_1: Edge,
    edge_2: Edge,
    skin_2: float,
    params: Params,
    scratch: Scratch,
) -> int:
    """Add up to two contacts of an agent's edge with one that runs in the opposite direction.

    The end points of each edge are projected on the other, and kept where they overlap.
    """
    ax1, ay1, bx1, by1 = edge_1
    ax2, ay2, bx2, by2 = edge_2
    a1 = ax1 * ny - ay1 * nx
    b1 = bx1 * ny - by1 * nx
    a2 = ax2 * ny - ay2 * nx
    b2 = bx2 * ny - by2 * nx
    # an edge along the normal has no extent; the clamps then choose one of its ends
    per_1 = 1.0 / (b1 - a1 + _TINY)
    per_2 = 1.0 / (b2 - a2 + _TINY)
    for end in range(2):
        t1 = clamp(((b2 if end == 0 else a2) - a1) * per_1)
        t2 = clamp(((a1 if end == 0 else b1) - a2) * per_2)
        x1 = ax1 + (bx1 - ax1) * t1 + nx * AGENT_SKIN
        y1 = ay1 + (by1 - ay1) * t1 + ny * AGENT_SKIN
        x2 = ax2 + (bx2 - ax2) * t2 - nx * skin_2
        y2 = ay2 + (by2 - ay2) * t2 - ny * skin_2
        if (x2 - x1) * nx + (y2 - y1) * ny <= 0.0:
            n = add_contact(bodies, n, first, second, nx, ny, x1, y1, x2, y2, params, scratch)
    return n


@inlined_kernel
def support_edge(agent: int, nx: float, ny: float, scratch: Scratch) -> Edge:
    """Return the edge of an agent that faces a direction, counter-clockwise."""
    corners, faces = scratch.corners[agent], scratch.faces[agent]
    farthest, reach = 0, -FAR
    for k in range(4):
        d = corners[k, 0] * nx + corners[k, 1] * ny
        if d > reach:
            farthest, reach = k, d
    after = (farthest + 1) & 3
    faces_more = (
        faces[farthest, 0] * nx + faces[farthest, 1] * ny
        > faces[after, 0] * nx + faces[after, 1] * ny
    )
    end = farthest if faces_more else after
    start = (end + 3) & 3
    return corners[start, 0], corners[start, 1], corners[end, 0], corners[end, 1]


@inlined_kernel
def place_outlines(bodies: FloatArray, params: Params, scratch: Scratch) -> None:
    """Bring corners, faces and bounding boxes up to date."""
    for agent in range(2):
        x, y = bodies[agent, X], bodies[agent, Y]
        c, s = scratch.rotation[agent, 0], scratch.rotation[agent, 1]
        low_x, high_x, low_y, high_y = FAR, -FAR, FAR, -FAR
        for k in range(4):
            lx, ly = params.vertices[agent, k, 0], params.vertices[agent, k, 1]
            cx = x + lx * c - ly * s
            cy = y + lx * s + ly * c
            scratch.corners[agent, k, 0] = cx
            scratch.corners[agent, k, 1] = cy
            lx, ly = params.normals[agent, k, 0], params.normals[agent, k, 1]
            scratch.faces[agent, k, 0] = lx * c - ly * s
            scratch.faces[agent, k, 1] = lx * s + ly * c
            low_x, high_x = min(low_x, cx), max(high_x, cx)
            low_y, high_y = min(low_y, cy), max(high_y, cy)
        box = scratch.boxes[agent]
        box[0], box[1] = low_x - AGENT_SKIN, high_x + AGENT_SKIN
        box[2], box[3] = low_y - AGENT_SKIN, high_y + AGENT_SKIN
    for item in range(2, 4):
        x, y, r = bodies[item, X], bodies[item, Y], params.radius[item]
        box = scratch.boxes[item]
        box[0], box[1], box[2], box[3] = x - r, x + r, y - r, y + r
