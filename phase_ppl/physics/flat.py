"""The compiled model's world as flat arrays: parameters, scratch space and states.

Bodies are a (body, 9) array, agents first, columns ``X`` to ``BIAS_SPIN`` below. The position is
the CENTRE OF MASS. Trajectories contain the body origin instead, which differs for agents.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.physics import constants
from phase_ppl.physics.records import record
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.event import State
from phase_ppl.world.geometry import CENTRE_OF_MASS_Y, UNIT_TRAPEZOID, heading
from phase_ppl.world.names import AGENTS, ENTITIES
from phase_ppl.world.scene import Scene

X, Y, ANGLE, VX, VY, SPIN, BIAS_VX, BIAS_VY, BIAS_SPIN = range(9)
"""Columns of ``bodies``. Bias velocities push overlapping bodies apart once, at the start of the
next inner step, so that pushing apart adds no momentum."""

CONTACTS_PER_BODY: Final = 16
"""Most contacts in one inner step; more would need bodies in impossible places."""

_N_CORNERS = len(UNIT_TRAPEZOID)


@record
class Params(NamedTuple):
    """Parameters that are constant during a simulation."""

    radius: FloatArray  # (body,) sizes R
    cog: FloatArray  # (body,) local y of the centre of mass: -R/6 for agents, 0 for items
    extent: FloatArray  # (body,) radius of the circle about the centre of mass that holds the body
    inverse_mass: FloatArray  # (body,)
    inverse_inertia: FloatArray
    origin_mass: FloatArray  # (body, 2) effective mass of the body origin in local x and y
    force: FloatArray  # (agent,); it acts at local y
    force_point: FloatArray
    torque: FloatArray
    # (agent, 4, 2) corners of the agents about their centre of mass, counter-clockwise; normals:
    # (agent, 4, 2) outward normal of the face that ENDS at the corner of the same index
    vertices: FloatArray
    normals: FloatArray
    border: FloatArray  # (4,) x_min, x_max, y_min, y_max within which bodies fit
    walls: FloatArray  # (n, 6) inner walls: end points x1, y1, x2, y2 and a unit normal
    wall_boxes: FloatArray  # (n, 4) x_min, x_max, y_min, y_max of the thick walls
    substeps: int  # per planner step
    dt: float  # length of one, s
    inner_steps: int  # least number of parts of the movement in a substep
    most_parts: int  # and the most; more parts than the least keep moves below ``longest_move``
    longest_move: float
    iterations: int  # of the solver
    friction: float  # largest impulse of the floor friction in a substep
    contact_rates: FloatArray  # (number of parts,) bias velocity per unit of overlap
    # a held item hangs on a rod from its holder's origin, instead of being welded, and agents push
    # at their origin: the authors' agents imagine this
    swivel: bool
    resets_velocity: bool  # whether agents stand still after each planner step


@record
class Scratch(NamedTuple):
    """Work space of one thread; nothing in it outlives a planner step."""

    # (body, 2) cosine and sine of the angle; 1, 0 for items, whose angle is not needed
    rotation: FloatArray
    boxes: FloatArray  # (body, 4) x_min, x_max, y_min, y_max of the bodies
    corners: FloatArray  # (agent, 4, 2) the agents' vertices and normals in the world
    faces: FloatArray
    # (agent, 3) change of velocity and spin by the agents' own force in one substep
    kick: FloatArray
    contact_bodies: IntArray  # (contacts, 2) the two bodies, -1 for a wall
    # (contacts, 8): normal from the first to the second, lever arms, effective mass, overlap, bias
    # impulse, impulse
    contacts: FloatArray
    touched: BoolArray  # (body,) bodies that the solver must treat together
    rub: FloatArray  # (body, 2) floor friction's impulse in the body frame
    welds: FloatArray  # (agent, 11) as in ``welds.prepare_weld``
    frame: FloatArray  # (body, 3) mean pose over the substeps so far


def make_scratch(n_bodies: int = len(ENTITIES), n_agents: int = len(AGENTS)) -> Scratch:
    """Return fresh work space for ``n_bodies`` bodies, the first ``n_agents`` of them agents."""
    rotation = np.zeros((n_bodies, 2))
    n_contacts = CONTACTS_PER_BODY * n_bodies
    rotation[:, 0] = 1.0
    return Scratch(
        rotation=rotation,
        boxes=np.zeros((n_bodies, 4)),
        corners=np.zeros((n_agents, _N_CORNERS, 2)),
        faces=np.zeros((n_agents, _N_CORNERS, 2)),
        kick=np.zeros((n_agents, 3)),
        contact_bodies=np.zeros((n_contacts, 2), np.int64),
        contacts=np.zeros((n_contacts, 8)),
        touched=np.zeros(n_bodies, np.bool_),
        rub=np.zeros((n_bodies, 2)),
        welds=np.zeros((n_agents, 11)),
        frame=np.zeros((n_bodies, 3)),
    )


def _agent_outline() -> tuple[FloatArray, FloatArray]:
    """Return corners about the centre of mass and face normals of an agent of size 1."""
    corners = UNIT_TRAPEZOID[::-1] - np.array([0.0, CENTRE_OF_MASS_Y])
    along = corners - np.roll(corners, 1, axis=0)
    normals = np.column_stack([along[:, 1], -along[:, 0]])
    return corners, normals / np.linalg.norm(normals, axis=1, keepdims=True)


_UNIT_CORNERS, _UNIT_NORMALS = _agent_outline()
_UNIT_EXTENT = float(np.linalg.norm(_UNIT_CORNERS, axis=1).max())


def _walls(scene: Scene) -> tuple[FloatArray, FloatArray]:
    ends, thickness = scene.walls, constants.WALL_RADIUS
    dx, dy = (ends[:, 1] - ends[:, 0]).T
    length = np.hypot(dx, dy)
    low, high = ends.min(axis=1) - thickness, ends.max(axis=1) + thickness
    boxes = np.stack([low, high], axis=-1).reshape(-1, 4)
    return np.column_stack([ends.reshape(-1, 4), -dy / length, dx / length]), boxes


def make_params(
    scene: Scene,
    strengths: Sequence[float],
    inner_steps: int = constants.IMAGINATION_INNER_STEPS,
    iterations: int = constants.IMAGINATION_ITERATIONS,
    swivel: bool = False,
) -> Params:
    """Return the parameters of the compiled model for one scene and its agents' strengths.

    Args:
        scene: sizes, walls and arena.
        strengths: maximum force of each agent, newtons.
        inner_steps: least number of parts into which the movement of a substep is divided; from
            ``WORLD_INNER_STEPS`` on, the exact number.
        iterations: solver iterations per inner step.
        swivel: see ``Params``.
    """
    radius, n_agents = scene.radius, len(scene.world.agents)
    sizes = radius[:n_agents]
    cog = np.append(CENTRE_OF_MASS_Y * sizes, np.zeros(len(radius) - n_agents))
    inverse_mass = np.array([1.0 / constants.mass(i, r, n_agents) for i, r in enumerate(radius)])
    inverse_inertia = np.array(
        [1.0 / constants.inertia(i, r, n_agents) for i, r in enumerate(radius)]
    )
    walls, wall_boxes = _walls(scene)
    x0, x1, y0, y1 = scene.arena
    inset = constants.WALL_RADIUS
    longest_move, most_parts = constants.division(radius.tolist(), strengths, scene.arena)
    lengths = np.arange(max(inner_steps, 2 * most_parts) + 1)
    part_length = constants.SUBSTEP / np.maximum(1, lengths)
    return Params(
        radius=np.array(radius),
        cog=cog,
        extent=np.append(_UNIT_EXTENT * sizes + constants.AGENT_SKIN, radius[n_agents:]),
        inverse_mass=inverse_mass,
        inverse_inertia=inverse_inertia,
        origin_mass=1.0 / np.column_stack([inverse_mass + inverse_inertia * cog**2, inverse_mass]),
        force=np.array(strengths, np.float64),
        force_point=sizes * (0.0 if swivel else constants.FORCE_POINT_Y),
        torque=np.array([constants.turn_torque(size) for size in sizes]),
        vertices=sizes[:, None, None] * _UNIT_CORNERS,
        normals=np.repeat(_UNIT_NORMALS[None], n_agents, axis=0),
        border=np.array([x0 + inset, x1 - inset, y0 + inset, y1 - inset]),
        walls=walls,
        wall_boxes=wall_boxes,
        substeps=constants.SUBSTEPS,
        dt=constants.SUBSTEP,
        inner_steps=inner_steps,
        most_parts=most_parts,
        longest_move=longest_move,
        iterations=iterations,
        friction=constants.FLOOR_FRICTION * constants.SUBSTEP,
        contact_rates=(1.0 - constants.COLLISION_BIAS**part_length) / part_length,
        swivel=swivel,
        resets_velocity=scene.resets_velocity,
    )


def from_state(state: State, radius: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return new (bodies, held, weld) arrays for ``state``.

    Args:
        state: any state of the world.
        radius: (body,) sizes R.
    """
    bodies = np.zeros((len(state.pose), BIAS_SPIN + 1))
    bodies[:, : ANGLE + 1] = state.pose
    for agent in range(len(state.held)):
        bodies[agent, : Y + 1] += CENTRE_OF_MASS_Y * radius[agent] * heading(bodies[agent, ANGLE])
    bodies[:, VX : VY + 1] = state.velocity
    bodies[:, SPIN] = state.spin
    return bodies, np.array(state.held, np.int64), np.array(state.weld, np.float64)


def to_state(bodies: FloatArray, held: IntArray, weld: FloatArray, radius: FloatArray) -> State:
    """Return the state in the arrays, without pending bias velocities."""
    pose = bodies[:, : ANGLE + 1].copy()
    for agent in range(len(held)):
        pose[agent, :2] -= CENTRE_OF_MASS_Y * radius[agent] * heading(pose[agent, 2])
    return State(
        pose=pose,
        velocity=bodies[:, VX : VY + 1].copy(),
        spin=bodies[:, SPIN].copy(),
        held=held.copy(),
        weld=weld.copy(),
    )
