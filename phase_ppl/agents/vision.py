"""What an agent observes: field of view with occlusion, touch, and the observation chain.

Source: paper, Appendix "Belief Representation and Update".
"""

from __future__ import annotations

import math
from typing import Final

from phase_ppl.agents.ground import Ground
from phase_ppl.agents.shapes import OUTSIDE, outline_cells, shapes_meet
from phase_ppl.physics.compiled import Params
from phase_ppl.physics.jit import bare_kernel
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.geometry import TOUCH_ENLARGEMENT

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
    bodies: FloatArray, agent: int, params: Params, ground: Ground, visible: BoolArray
) -> None:
    """Mark in ``visible`` (size * size,) the cells in the agent's field of view.

    A cell is in view if its centre lies in the cone and no wall and no other entity (a disc of
    its size R around its centre of mass, if that lies between eye and cell) is on the line to it.
    """
    ex, ey, angle = bodies[agent, 0], bodies[agent, 1], bodies[agent, 2]
    hx, hy = -math.sin(angle), math.cos(angle)
    for row in range(ground.size):
        y = ground.origin[1] - 0.5 - row
        for column in range(ground.size):
            x = ground.origin[0] + 0.5 + column
            index = row * ground.size + column
            visible[index] = False
            dx, dy = x - ex, y - ey
            length = math.sqrt(dx * dx + dy * dy)
            if dx * hx + dy * hy < _COS_HALF_ANGLE * length:
                continue
            free = True
            for w in range(ground.walls.shape[0]):
                if _segments_cross(
                    ex,
                    ey,
                    x,
                    y,
                    ground.walls[w, 0],
                    ground.walls[w, 1],
                    ground.walls[w, 2],
                    ground.walls[w, 3],
                ):
                    free = False
                    break
            if not free:
                continue
            for other in range(4):
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
    ground: Ground,
    visible: BoolArray,
    cells: IntArray,
    observed: BoolArray,
) -> None:
    """Fill ``visible`` (cells) and ``observed`` (4,) for one agent in the true state.

    Observed is: itself; whatever has an outline cell in view; whatever it touches or holds, and
    the other holder of its item; and, along the chain, what an observed entity touches or holds.

    Args:
        bodies, held: true state.
        full_view: see everything (an ablation, and the paper's full-observation switch).
        cells: scratch for outline cells.
    """
    visible_cells(bodies, agent, params, ground, visible)
    other = 1 - agent
    for entity in range(4):
        observed[entity] = full_view or entity == agent
    if full_view:
        for cell in range(visible.shape[0]):
            visible[cell] = True
        return
    for entity in range(4):
        if entity == agent:
            continue
        n = outline_cells(bodies, entity, params, ground, cells)
        for i in range(n):
            if cells[i] != OUTSIDE and visible[cells[i]]:
                observed[entity] = True
                break
        if held[agent] == entity or shapes_meet(
            bodies, agent, entity, 1.0, TOUCH_ENLARGEMENT, params
        ):
            observed[entity] = True
    if held[agent] >= 0 and held[agent] == held[other]:
        observed[other] = True
    for _ in range(3):
        changed = False
        for entity in range(4):
            if observed[entity]:
                continue
            for witness in range(4):
                if witness == agent or not observed[witness]:
                    continue
                if entity < 2 and witness < 2:
                    continue
                holds = (witness < 2 and held[witness] == entity) or (
                    entity < 2 and held[entity] == witness
                )
                if holds or shapes_meet(
                    bodies, witness, entity, TOUCH_ENLARGEMENT, TOUCH_ENLARGEMENT, params
                ):
                    observed[entity] = True
                    changed = True
                    break
        if not changed:
            break
