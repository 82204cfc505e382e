"""Collision detection of the compiled model: which bodies overlap, and along which normal.

The normal comes from separating axes. For these shapes this gives the same as Chipmunk's GJK and
EPA wherever they overlap.
"""

from __future__ import annotations

import math
from typing import Final

from phase_ppl.physics.constants import AGENT_SKIN, COLLISION_SLOP, WALL_RADIUS
from phase_ppl.physics.flat import BIAS_VX, SPIN, VX, VY, Params, Scratch, X, Y
from phase_ppl.physics.jit import bare_kernel, inlined_kernel
from phase_ppl.physics.welds import prepare_weld, pull
from phase_ppl.world.arrays import FloatArray, IntArray

Edge = tuple[float, float, float, float]  # start x, y and end x, y
WALL: Final = -1  # the second body of a contact with a wall
FAR: Final = 1e300
_BIAS_IMPULSE, _IMPULSE = 6, 7  # columns of contacts
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
    if n >= scratch.contacts.shape[0]:
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
    contact[0], contact[1], contact[2], contact[3] = nx, ny, lever_1, lever_2
    contact[4] = 1.0 / inverse
    contact[5] = max(0.0, -gap - COLLISION_SLOP)
    contact[_BIAS_IMPULSE] = contact[_IMPULSE] = 0.0
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

    The end points of each edge are projected on the other, and kept where the edges overlap.
    """
    ax1, ay1, bx1, by1 = edge_1
    ax2, ay2, bx2, by2 = edge_2
    a1 = ax1 * ny - ay1 * nx
    b1 = bx1 * ny - by1 * nx
    a2 = ax2 * ny - ay2 * nx
    b2 = bx2 * ny - by2 * nx
    # an edge along the normal has no extent there; the clamps then choose one of its ends
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
    """Return the edge of an agent that faces a direction, its ends counter-clockwise."""
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
    n_agents = params.force.shape[0]
    for agent in range(n_agents):
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
    for item in range(n_agents, bodies.shape[0]):
        x, y, r = bodies[item, X], bodies[item, Y], params.radius[item]
        box = scratch.boxes[item]
        box[0], box[1], box[2], box[3] = x - r, x + r, y - r, y + r


_TIE: Final = 1e-9
"""Faces within this are equally near. The first one counts, not the one that rounding favours:
back, right, front, left, as in the pymunk world."""


@inlined_kernel
def _boxes_meet(a: FloatArray, b: FloatArray) -> bool:
    return (a[0] <= b[1]) & (a[1] >= b[0]) & (a[2] <= b[3]) & (a[3] >= b[2])


@inlined_kernel
def _border(bodies: FloatArray, n: int, body: int, params: Params, scratch: Scratch) -> int:
    """Add contacts with the arena's border, which is solid without end: no body gets past it."""
    box = scratch.boxes[body]
    for side in range(4):
        limit = params.border[side]
        outward = 1.0 if side & 1 else -1.0
        if (box[side] - limit) * outward < 0.0:
            continue
        upright = side < 2  # the left and right borders
        nx, ny = (outward, 0.0) if upright else (0.0, outward)
        is_agent = body < params.force.shape[0]
        if is_agent:
            ax, ay, bx, by = support_edge(body, nx, ny, scratch)
            thickness = AGENT_SKIN
        else:
            ax, ay = bodies[body, X], bodies[body, Y]
            bx, by = ax, ay
            thickness = params.radius[body]
        for end in range(2 if is_agent else 1):
            x, y = (ax, ay) if end == 0 else (bx, by)
            x += nx * thickness
            y += ny * thickness
            wx, wy = (limit, y) if upright else (x, limit)
            if (wx - x) * nx + (wy - y) * ny <= 0.0:
                n = add_contact(bodies, n, body, WALL, nx, ny, x, y, wx, wy, params, scratch)
    return n


@inlined_kernel
def _agent_wall(
    bodies: FloatArray, n: int, agent: int, wall: FloatArray, params: Params, scratch: Scratch
) -> int:
    corners, faces = scratch.corners[agent], scratch.faces[agent]
    ax, ay, bx, by, wx, wy = wall[0], wall[1], wall[2], wall[3], wall[4], wall[5]
    gap, nx, ny = -FAR, 0.0, 0.0
    for k in range(4):
        fx, fy = faces[k, 0], faces[k, 1]
        reach = fx * corners[k, 0] + fy * corners[k, 1]
        d = min(fx * ax + fy * ay, fx * bx + fy * by) - reach
        if d > gap:
            gap, nx, ny = d, fx, fy
    if gap > WALL_RADIUS + AGENT_SKIN:
        return n
    low, high = FAR, -FAR
    for k in range(4):
        d = wx * (corners[k, 0] - ax) + wy * (corners[k, 1] - ay)
        low, high = min(low, d), max(high, d)
    if low > gap:
        gap, nx, ny = low, -wx, -wy
    if -high > gap:
        gap, nx, ny = -high, wx, wy
    if gap > WALL_RADIUS + AGENT_SKIN:
        return n
    edge = support_edge(agent, nx, ny, scratch)
    # the wall's side that faces the agent, run through against the agent's edge
    wall_edge = (ax, ay, bx, by) if wx * nx + wy * ny > 0.0 else (bx, by, ax, ay)
    return clip(bodies, n, agent, WALL, nx, ny, edge, wall_edge, WALL_RADIUS, params, scratch)


@inlined_kernel
def _item_wall(
    bodies: FloatArray, n: int, item: int, wall: FloatArray, params: Params, scratch: Scratch
) -> int:
    ax, ay = wall[0], wall[1]
    ux, uy = wall[2] - ax, wall[3] - ay
    x, y, r = bodies[item, X], bodies[item, Y], params.radius[item]
    t = clamp(((x - ax) * ux + (y - ay) * uy) / (ux * ux + uy * uy))
    px, py = ax + ux * t, ay + uy * t
    dx, dy = px - x, py - y
    squared = dx * dx + dy * dy
    reach = r + WALL_RADIUS
    if squared >= reach * reach:
        return n
    if squared > 0.0:
        distance = math.sqrt(squared)
        nx, ny = dx / distance, dy / distance
    else:
        nx, ny = wall[4], wall[5]
    return add_contact(
        bodies, n, item, WALL, nx, ny,
        x + nx * r, y + ny * r, px - nx * WALL_RADIUS, py - ny * WALL_RADIUS, params, scratch,
    )  # fmt: skip


@inlined_kernel
def _items(
    bodies: FloatArray, n: int, one: int, other: int, params: Params, scratch: Scratch
) -> int:
    dx, dy = bodies[other, X] - bodies[one, X], bodies[other, Y] - bodies[one, Y]
    r1, r2 = params.radius[one], params.radius[other]
    squared = dx * dx + dy * dy
    if squared >= (r1 + r2) ** 2:
        return n
    nx, ny = 1.0, 0.0  # any direction will do for items on the same spot
    if squared > 0.0:
        distance = math.sqrt(squared)
        nx, ny = dx / distance, dy / distance
    return add_contact(
        bodies, n, one, other, nx, ny,
        bodies[one, X] + nx * r1, bodies[one, Y] + ny * r1,
        bodies[other, X] - nx * r2, bodies[other, Y] - ny * r2, params, scratch,
    )  # fmt: skip


@inlined_kernel
def _agent_item(
    bodies: FloatArray, n: int, agent: int, item: int, params: Params, scratch: Scratch
) -> int:
    corners, faces = scratch.corners[agent], scratch.faces[agent]
    x, y, r = bodies[item, X], bodies[item, Y], params.radius[item]
    reach = r + AGENT_SKIN
    gap, face = -FAR, 0
    for k in range(4):
        d = faces[k, 0] * (x - corners[k, 0]) + faces[k, 1] * (y - corners[k, 1])
        if d > gap + _TIE:
            gap, face = d, k
    if gap > reach:
        return n
    nx, ny = faces[face, 0], faces[face, 1]
    px, py = x - nx * gap, y - ny * gap
    if gap > _TIE:
        # outside, the nearest point may be a corner
        start = (face + 3) & 3
        ax, ay = corners[start, 0], corners[start, 1]
        ux, uy = corners[face, 0] - ax, corners[face, 1] - ay
        t = clamp(((x - ax) * ux + (y - ay) * uy) / (ux * ux + uy * uy))
        px, py = ax + ux * t, ay + uy * t
        dx, dy = x - px, y - py
        squared = dx * dx + dy * dy
        if squared >= reach * reach:
            return n
        distance = math.sqrt(squared)
        nx, ny = dx / distance, dy / distance
    return add_contact(
        bodies, n, agent, item, nx, ny,
        px + nx * AGENT_SKIN, py + ny * AGENT_SKIN, x - nx * r, y - ny * r, params, scratch,
    )  # fmt: skip


@inlined_kernel
def _agents(
    bodies: FloatArray, n: int, one: int, other: int, params: Params, scratch: Scratch
) -> int:
    gap, nx, ny = -FAR, 0.0, 0.0
    for side in range(2):
        owner = one if side == 0 else other
        corners, faces = scratch.corners[owner], scratch.faces[owner]
        others = scratch.corners[other if side == 0 else one]
        for k in range(4):
            fx, fy = faces[k, 0], faces[k, 1]
            nearest = FAR
            for v in range(4):
                nearest = min(nearest, fx * others[v, 0] + fy * others[v, 1])
            d = nearest - fx * corners[k, 0] - fy * corners[k, 1]
            if d > gap + _TIE:
                sign = 1.0 if side == 0 else -1.0
                gap, nx, ny = d, sign * fx, sign * fy
        if gap > 2.0 * AGENT_SKIN:
            return n
    edge_0 = support_edge(one, nx, ny, scratch)
    edge_1 = support_edge(other, -nx, -ny, scratch)
    return clip(bodies, n, one, other, nx, ny, edge_0, edge_1, AGENT_SKIN, params, scratch)


@bare_kernel
def find_contacts(bodies: FloatArray, held: IntArray, params: Params, scratch: Scratch) -> int:
    """Write all contacts into ``scratch`` and mark the bodies touched; return their number.

    A held item and its holder do not collide.
    """
    place_outlines(bodies, params, scratch)
    boxes = scratch.boxes
    border = params.border
    n_bodies, n_agents = bodies.shape[0], held.shape[0]
    n = 0
    for body in range(n_bodies):
        box = boxes[body]
        if (
            (box[0] < border[0])
            | (box[1] > border[1])
            | (box[2] < border[2])
            | (box[3] > border[3])
        ):
            n = _border(bodies, n, body, params, scratch)
        for w in range(params.walls.shape[0]):
            if _boxes_meet(box, params.wall_boxes[w]):
                if body < n_agents:
                    n = _agent_wall(bodies, n, body, params.walls[w], params, scratch)
                else:
                    n = _item_wall(bodies, n, body, params.walls[w], params, scratch)
    for item in range(n_agents, n_bodies):
        for other in range(item + 1, n_bodies):
            n = _items(bodies, n, item, other, params, scratch)
    for agent in range(n_agents):
        for item in range(n_agents, n_bodies):
            if held[agent] != item and _boxes_meet(boxes[agent], boxes[item]):
                n = _agent_item(bodies, n, agent, item, params, scratch)
    for agent in range(n_agents):
        for other in range(agent + 1, n_agents):
            if _boxes_meet(boxes[agent], boxes[other]):
                n = _agents(bodies, n, agent, other, params, scratch)
    return n


SETTLED: Final = 1e-8
"""The iteration ends when the squares of all impulse changes sum to less than this, (N s)^2."""


@inlined_kernel
def rub(bodies: FloatArray, body: int, params: Params, scratch: Scratch) -> float:
    """Let the floor's friction act on one body; return the squared change of the impulse.

    Friction is a joint of limited force that tries to stop the body origin. An agent's origin is
    not its centre of mass, so that friction also turns it; in the body frame the effective mass is
    diagonal. The total impulse does not depend on what has been applied already. So one call from
    zero is exact for a body that touches nothing else.
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
def _meet(
    bodies: FloatArray, k: int, vx: int, impulse: int, aim: float, params: Params, scratch: Scratch
) -> float:
    """Keep two bodies from approaching at a contact; return the squared change of its impulse.

    It changes velocities (``vx`` = VX) or bias velocities (``vx`` = BIAS_VX), until the bodies part
    with velocity ``aim``. That column of the contact keeps the impulse.
    """
    a, b = scratch.contact_bodies[k, 0], scratch.contact_bodies[k, 1]
    contact = scratch.contacts[k]
    nx, ny, lever_a, lever_b = contact[0], contact[1], contact[2], contact[3]
    approach = bodies[a, vx] * nx + bodies[a, vx + 1] * ny + bodies[a, vx + 2] * lever_a
    if b >= 0:
        approach -= bodies[b, vx] * nx + bodies[b, vx + 1] * ny + bodies[b, vx + 2] * lever_b
    total = max(0.0, contact[impulse] + (aim + approach) * contact[4])
    j = total - contact[impulse]
    contact[impulse] = total
    if j != 0.0:
        per_mass = params.inverse_mass[a] * j
        bodies[a, vx] -= nx * per_mass
        bodies[a, vx + 1] -= ny * per_mass
        bodies[a, vx + 2] -= params.inverse_inertia[a] * lever_a * j
        if b >= 0:
            per_mass = params.inverse_mass[b] * j
            bodies[b, vx] += nx * per_mass
            bodies[b, vx + 1] += ny * per_mass
            bodies[b, vx + 2] += params.inverse_inertia[b] * lever_b * j
    return j * j


@inlined_kernel
def _separate(
    bodies: FloatArray, n_contacts: int, rate: float, params: Params, scratch: Scratch
) -> None:
    """Find bias velocities that push overlapping bodies apart, ``rate`` times the overlap."""
    for _ in range(params.iterations):
        change = 0.0
        for k in range(n_contacts):
            aim = rate * scratch.contacts[k, 5]
            change += _meet(bodies, k, BIAS_VX, _BIAS_IMPULSE, aim, params, scratch)
        if change < SETTLED:
            break


@inlined_kernel
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
        bodies, held, weld: state of the model.
        n_contacts: number of contacts in ``scratch``.
        parts: number of parts of this substep.
        with_friction: whether the floor brakes in this inner step.
        params, scratch: parameters and work space of the model.
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
        change = 0.0
        for k in range(n_contacts):
            change += _meet(bodies, k, VX, _IMPULSE, 0.0, params, scratch)
        if with_friction:
            for body in range(bodies.shape[0]):
                if scratch.touched[body]:
                    change += rub(bodies, body, params, scratch)
        for agent in range(held.shape[0]):
            if held[agent] >= 0:
                change += pull(bodies, agent, held[agent], params, scratch.welds[agent])
        if change < SETTLED:
            break
