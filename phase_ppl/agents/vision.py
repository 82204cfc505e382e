"""What an agent observes: field of view with occlusion, touch, and the observation chain.

Source: paper, Appendix "Belief Representation and Update".
"""

from __future__ import annotations

import math
from typing import Final

from phase_ppl.agents.world_model import Layout
from phase_ppl.physics.compiled import Params
from phase_ppl.physics.jit import bare_kernel
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.geometry import TOUCH_ENLARGEMENT as _GROWN

MAX_OUTLINE_CELLS: Final = 128
RIM_POINTS: Final = 16
OUTSIDE: Final = -1
"""Cell number of a point outside the grid."""


@bare_kernel
def cell_of(x: float, y: float, layout: Layout) -> int:
    """Return row * columns + column of the 1 x 1 cell that holds a point, or OUTSIDE."""
    column = int(math.floor(x - layout.origin[0]))
    row = int(math.floor(layout.origin[1] - y))
    if column < 0 or row < 0 or column >= layout.columns or row >= layout.rows:
        return OUTSIDE
    return row * layout.columns + column


@bare_kernel
def corner(
    bodies: FloatArray, agent: int, k: int, scale: float, params: Params
) -> tuple[float, float]:
    """Return corner ``k`` of an agent, enlarged by ``scale`` about its centre of mass."""
    c, s = math.cos(bodies[agent, 2]), math.sin(bodies[agent, 2])
    lx, ly = params.vertices[agent, k, 0] * scale, params.vertices[agent, k, 1] * scale
    return bodies[agent, 0] + lx * c - ly * s, bodies[agent, 1] + lx * s + ly * c


@bare_kernel
def outline_cells(
    bodies: FloatArray, entity: int, params: Params, layout: Layout, cells: IntArray
) -> int:
    """Write the cells that the outline of ``entity`` touches into ``cells``; return their number.

    An agent: the grid line between cells of neighbouring corners. An item: 16 points on the rim.
    """
    if entity >= params.force.shape[0]:
        for i in range(RIM_POINTS):
            angle = 2.0 * math.pi * i / RIM_POINTS
            x = bodies[entity, 0] + params.radius[entity] * math.cos(angle)
            y = bodies[entity, 1] + params.radius[entity] * math.sin(angle)
            cells[i] = cell_of(x, y, layout)
        return RIM_POINTS
    n = 0
    for k in range(4):
        x1, y1 = corner(bodies, entity, k, 1.0, params)
        x2, y2 = corner(bodies, entity, (k + 1) % 4, 1.0, params)
        steps = int(math.ceil(max(abs(x2 - x1), abs(y2 - y1)))) + 1
        if n + steps > MAX_OUTLINE_CELLS:
            break
        for i in range(steps):
            t = i / steps
            cells[n] = cell_of(x1 + (x2 - x1) * t, y1 + (y2 - y1) * t, layout)
            n += 1
    return n


@bare_kernel
def _project(
    bodies: FloatArray, agent: int, scale: float, ax: float, ay: float, params: Params
) -> tuple[float, float]:
    low, high = 1e300, -1e300
    for k in range(4):
        x, y = corner(bodies, agent, k, scale, params)
        d = ax * x + ay * y
        low = min(low, d)
        high = max(high, d)
    return low, high


@bare_kernel
def _agents_meet(
    bodies: FloatArray, one: int, other: int, scale_1: float, scale_2: float, params: Params
) -> bool:
    for side in range(2):
        owner = one if side == 0 else other
        for k in range(4):
            x1, y1 = corner(bodies, owner, k, 1.0, params)
            x2, y2 = corner(bodies, owner, (k + 1) % 4, 1.0, params)
            ax, ay = y1 - y2, x2 - x1
            low_1, high_1 = _project(bodies, one, scale_1, ax, ay, params)
            low_2, high_2 = _project(bodies, other, scale_2, ax, ay, params)
            if high_1 < low_2 or high_2 < low_1:
                return False
    return True


@bare_kernel
def _agent_meets_disc(
    bodies: FloatArray, agent: int, scale: float, item: int, reach: float, params: Params
) -> bool:
    px, py = bodies[item, 0], bodies[item, 1]
    inside, nearest = True, 1e300
    for k in range(4):
        x1, y1 = corner(bodies, agent, k, scale, params)
        x2, y2 = corner(bodies, agent, (k + 1) % 4, scale, params)
        ex, ey = x2 - x1, y2 - y1
        cx, cy = px - x1, py - y1
        t = min(1.0, max(0.0, (cx * ex + cy * ey) / (ex * ex + ey * ey)))
        dx, dy = cx - t * ex, cy - t * ey
        nearest = min(nearest, dx * dx + dy * dy)
        # the signed side distinguishes inside from outside in either order of the corners
        ox, oy = bodies[agent, 0] - x1, bodies[agent, 1] - y1
        if (ex * cy - ey * cx) * (ex * oy - ey * ox) < 0:
            inside = False
    return inside or nearest <= reach * reach


@bare_kernel
def shapes_meet(
    bodies: FloatArray, first: int, second: int, scale_1: float, scale_2: float, params: Params
) -> bool:
    """Whether two entities' shapes overlap when enlarged by the scales."""
    n_agents = params.force.shape[0]
    if first >= n_agents and second < n_agents:
        first, second = second, first
        scale_1, scale_2 = scale_2, scale_1
    dx = bodies[first, 0] - bodies[second, 0]
    dy = bodies[first, 1] - bodies[second, 1]
    far_1 = params.radius[first] * scale_1 * (1.75 if first < n_agents else 1.0)
    far_2 = params.radius[second] * scale_2 * (1.75 if second < n_agents else 1.0)
    if dx * dx + dy * dy > (far_1 + far_2) ** 2:
        return False
    if first >= n_agents:
        return True
    if second >= n_agents:
        reach = params.radius[second] * scale_2
        return _agent_meets_disc(bodies, first, scale_1, second, reach, params)
    return _agents_meet(bodies, first, second, scale_1, scale_2, params)


HALF_ANGLE: Final = math.atan2(0.8, 0.4 + 1.0 / 6.0)
"""Half the opening of the cone of vision, rad: its edge passes local (0.8 R, 0.4 R)."""

_COS_HALF_ANGLE = math.cos(HALF_ANGLE)


@bare_kernel
def _segments_cross(
    ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float
) -> bool:
    d1 = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    d2 = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
    d3 = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
    d4 = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
    return d1 * d2 <= 0.0 and d3 * d4 <= 0.0


@bare_kernel
def visible_cells(
    bodies: FloatArray, agent: int, params: Params, layout: Layout, visible: BoolArray
) -> None:
    """Mark in ``visible`` (cell,) the cells in the agent's field of view.

    A cell is in view if its centre lies in the cone, and the line to it meets no wall and no other
    entity. An entity counts as a disc of its size R around its centre of mass, if that lies between
    eye and cell.
    """
    ex, ey, angle = bodies[agent, 0], bodies[agent, 1], bodies[agent, 2]
    hx, hy = -math.sin(angle), math.cos(angle)
    for row in range(layout.rows):
        y = layout.origin[1] - 0.5 - row
        for column in range(layout.columns):
            x = layout.origin[0] + 0.5 + column
            index = row * layout.columns + column
            visible[index] = False
            dx, dy = x - ex, y - ey
            length = math.sqrt(dx * dx + dy * dy)
            if dx * hx + dy * hy < _COS_HALF_ANGLE * length:
                continue
            free = True
            for w in range(layout.walls.shape[0]):
                wall = layout.walls[w]
                if _segments_cross(ex, ey, x, y, wall[0], wall[1], wall[2], wall[3]):
                    free = False
                    break
            if not free:
                continue
            for other in range(bodies.shape[0]):
                if other == agent:
                    continue
                ox, oy = bodies[other, 0] - ex, bodies[other, 1] - ey
                along = (ox * dx + oy * dy) / max(length, 1e-9)
                if along <= 0.0 or along >= length:
                    continue
                if ox * ox + oy * oy - along * along < params.radius[other] ** 2:
                    free = False
                    break
            visible[index] = free


@bare_kernel
def observe(
    bodies: FloatArray,
    held: IntArray,
    agent: int,
    full_view: bool,
    params: Params,
    layout: Layout,
    visible: BoolArray,
    cells: IntArray,
    observed: BoolArray,
) -> None:
    """Fill ``visible`` (cells) and ``observed`` (entity,) for one agent in the true state.

    An agent observes itself, entities with an outline cell in view, what it touches or holds, and
    the other holder of its item. Along the chain, it also observes what an observed entity
    touches or holds.

    Args:
        bodies, held: true state.
        full_view: see everything (an ablation, and the paper's full-observation switch).
        cells: scratch for outline cells.
    """
    visible_cells(bodies, agent, params, layout, visible)
    n_bodies, n_agents = bodies.shape[0], held.shape[0]
    for entity in range(n_bodies):
        observed[entity] = full_view or entity == agent
    if full_view:
        for cell in range(visible.shape[0]):
            visible[cell] = True
        return
    for entity in range(n_bodies):
        if entity == agent:
            continue
        n = outline_cells(bodies, entity, params, layout, cells)
        for i in range(n):
            if cells[i] != OUTSIDE and visible[cells[i]]:
                observed[entity] = True
                break
        if held[agent] == entity or shapes_meet(bodies, agent, entity, 1.0, _GROWN, params):
            observed[entity] = True
    for other in range(n_agents):
        if held[agent] >= 0 and held[agent] == held[other]:
            observed[other] = True
    for _ in range(n_bodies - 1):
        changed = False
        for entity in range(n_bodies):
            if observed[entity]:
                continue
            for witness in range(n_bodies):
                if witness == agent or not observed[witness]:
                    continue
                if entity < n_agents and witness < n_agents:
                    continue
                holds = (witness < n_agents and held[witness] == entity) or (
                    entity < n_agents and held[entity] == witness
                )
                if holds or shapes_meet(bodies, witness, entity, _GROWN, _GROWN, params):
                    observed[entity] = changed = True
                    break
        if not changed:
            break
