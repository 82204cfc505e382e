"""The world: the reference implementation of the dynamics, on pymunk (Chipmunk).

It reproduces the original generator's Box2D world: an arena seen from above, trapezoid
agents, discs, floor friction, rigid grabs. One substep of 1/60 s is, as there,

1. find the contacts;
2. accelerate: the agents' own forces, and the floor's friction of at most 100 N on every body;
3. solve: contacts, friction and grabs agree on new velocities;
4. move with the new velocities.

Two things make Chipmunk do that.

*The due move.* Chipmunk's step is move, collide, accelerate, solve. That is the same cycle, cut at
another place, so that its positions are always one move behind. Here a body's pose is Chipmunk's
pose plus the move that is due. Everything that happens between steps (a stop, spin set to zero, a
grab) happens to that pose. Without this, every change of velocity shows one substep late and every
turn is too small.

*Divided moves.* Chipmunk does not see collisions between two poses. So moves are divided into inner
steps, and into more of them if a body is small for its speed. Forces and friction act in the first
one with all of the substep's impulse: so free motion does not depend on the number of steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import pymunk

from phase_ppl.physics import constants
from phase_ppl.physics.actions import DIRECTIONS, Action
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import State
from phase_ppl.world.geometry import (
    CENTRE_OF_MASS_Y,
    GRAB_POINTS,
    GRAB_REACH,
    UNIT_TRAPEZOID,
    is_agent,
    rotation,
)
from phase_ppl.world.names import NOTHING
from phase_ppl.world.scene import Scene

_BORDER_DEPTH: Final = 5.0
"""Half thickness of the arena's border. A fast body could jump a thin border, which would then keep
it outside; a thick one always pushes it back in."""

_NUDGE: Final = 1e-6  # how far a body that starts on an agent's origin is moved off it, units


AWAY: Final = -1000.0  # x and y of removed bodies, units


class PymunkWorld:
    """A running world.

    Bodies are placed by their centre of mass, in pymunk as in the compiled model. Only poses that
    go in or out (``State``, frames) are of the body origins.

    Args:
        scene: sizes, walls, arena, start poses, and whether agents stop after each step.
        strengths: maximum force of each agent, newtons.
        inner_steps: least number of parts into which the movement of a substep is divided.
        initial: state to start from; None: the scene's start, followed by one empty substep that
            separates overlapping bodies, as in the original.
        iterations: solver iterations per inner step.

    Raises:
        InvalidSettingError: a body is too small for the speed that the agents' strengths give it.
    """

    def __init__(
        self,
        scene: Scene,
        strengths: Sequence[float],
        inner_steps: int = constants.WORLD_INNER_STEPS,
        initial: State | None = None,
        iterations: int = constants.WORLD_ITERATIONS,
    ) -> None:
        self._strengths = strengths
        self._resets_velocity = scene.resets_velocity
        self._radius = [float(r) for r in scene.radius]
        self._n_agents = len(scene.world.agents)
        self._cog_y = [
            CENTRE_OF_MASS_Y * r if is_agent(i, self._n_agents) else 0.0
            for i, r in enumerate(self._radius)
        ]
        self._least_parts = self._inner_steps = inner_steps
        self._longest_move, self._most_parts = constants.division(
            self._radius, strengths, scene.arena
        )
        self._dt = constants.SUBSTEP / inner_steps
        self._space = pymunk.Space()
        self._space.iterations = iterations
        self._space.collision_slop = constants.COLLISION_SLOP
        self._space.collision_bias = constants.COLLISION_BIAS
        self._add_walls(scene)
        state = State.at_start(scene) if initial is None else initial
        self._floor: list[pymunk.PivotJoint] = []
        self._bodies = [self._add_body(entity, state) for entity in range(len(self._radius))]
        self._held = [NOTHING] * self._n_agents
        self._weld = np.zeros((self._n_agents, 3))
        self._joints: list[tuple[pymunk.Constraint, ...]] = [()] * self._n_agents
        for agent in range(self._n_agents):
            if state.held[agent] != NOTHING:
                self._join(agent, int(state.held[agent]), state.weld[agent])
        if initial is None:
            self._break_ties()
            self._substep((Action.NO_FORCE,) * self._n_agents)

    def _add_walls(self, scene: Scene) -> None:
        x0, x1, y0, y1 = scene.arena
        depth = _BORDER_DEPTH
        # the border's surface lies where a wall of normal thickness would have it
        shift = depth - constants.WALL_RADIUS
        left, right, bottom, top = x0 - shift, x1 + shift, y0 - shift, y1 + shift
        corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
        lines = [(a, b, depth) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
        lines += [(tuple(a), tuple(b), constants.WALL_RADIUS) for a, b in scene.walls.tolist()]
        for start, end, thickness in lines:
            wall = pymunk.Segment(self._space.static_body, start, end, thickness)
            wall.friction = wall.elasticity = 0.0
            self._space.add(wall)

    def _add_body(self, entity: int, state: State) -> pymunk.Body:
        radius, cog_y, n = self._radius[entity], self._cog_y[entity], self._n_agents
        body = pymunk.Body(constants.mass(entity, radius, n), constants.inertia(entity, radius, n))
        shape: pymunk.Shape
        if is_agent(entity, n):
            outline = radius * UNIT_TRAPEZOID - np.array([0.0, cog_y])
            shape = pymunk.Poly(body, outline.tolist(), radius=constants.AGENT_SKIN)
        else:
            shape = pymunk.Circle(body, radius)
        shape.friction = shape.elasticity = 0.0
        self._place(body, entity, state)
        x, y, _ = state.pose[entity].tolist()
        # Floor friction is a joint that never pulls the body back (max_bias 0). It only brakes the
        # body origin, with limited force. The walls hang on the same static body, so that the joint
        # must leave collisions between the two on.
        floor = pymunk.PivotJoint(self._space.static_body, body, (x, y), (0.0, -cog_y))
        floor.max_bias = 0.0
        floor.collide_bodies = True
        self._floor.append(floor)
        self._space.add(body, shape, floor)
        return body

    def _place(self, body: pymunk.Body, entity: int, state: State) -> None:
        x, y, angle = state.pose[entity].tolist()
        vx, vy = state.velocity[entity].tolist()
        spin, cog_y = float(state.spin[entity]), self._cog_y[entity]
        # one move back, since Chipmunk moves first
        body.position = (
            x - math.sin(angle) * cog_y - vx * self._dt,
            y + math.cos(angle) * cog_y - vy * self._dt,
        )
        body.angle = angle - spin * self._dt
        body.velocity = vx, vy
        body.angular_velocity = spin

    def restore(self, state: State) -> None:
        """Put the world into ``state``.

        Chipmunk's memory of contacts stays. So bodies in contact move on slightly differently than
        in a new world.
        """
        for agent in range(self._n_agents):
            if self._held[agent] != NOTHING:
                self._detach(agent)
        for entity, body in enumerate(self._bodies):
            self._place(body, entity, state)
        for agent in range(self._n_agents):
            if state.held[agent] != NOTHING:
                self._join(agent, int(state.held[agent]), state.weld[agent].copy())

    def _break_ties(self) -> None:
        """Move bodies that start exactly on an agent's origin by ``_NUDGE``.

        Chipmunk would not see two agents on the same spot, and rounding would decide on which side
        an item leaves. In the original, items leave to the right and agents to the rear.
        """
        for agent in range(self._n_agents):
            for other in range(agent + 1, len(self._bodies)):
                offset = self._poses()[other, :2] - self._poses()[agent, :2]
                if np.abs(offset).max() < _NUDGE:
                    direction = np.array(
                        [0.0, -1.0] if is_agent(other, self._n_agents) else [1.0, 0.0]
                    )
                    nudge = _NUDGE * rotation(self._bodies[agent].angle) @ direction
                    self._bodies[other].position += tuple(nudge)

    @property
    def state(self) -> State:
        """A copy of the current state."""
        bodies = self._bodies
        return State(
            pose=self._poses(),
            velocity=np.array([body.velocity for body in bodies]),
            spin=np.array([body.angular_velocity for body in bodies]),
            held=np.array(self._held, np.int64),
            weld=self._weld.copy(),
        )

    def _pose(self, entity: int) -> tuple[float, float, float]:
        """Return the pose of a body's centre of mass, including the due move."""
        body, dt = self._bodies[entity], self._dt
        (x, y), (vx, vy) = body.position, body.velocity
        return x + vx * dt, y + vy * dt, body.angle + body.angular_velocity * dt

    def _poses(self) -> FloatArray:
        """Return the (body, 3) poses of the body origins, including the due move."""
        poses = np.empty((len(self._bodies), 3))
        for entity, cog_y in enumerate(self._cog_y):
            x, y, angle = self._pose(entity)
            poses[entity] = x + math.sin(angle) * cog_y, y - math.cos(angle) * cog_y, angle
        return poses

    def _in_frame(self, agent: int, entity: int) -> FloatArray:
        """Return a body's centre of mass in an agent's frame about its centre of mass."""
        x, y, angle = self._pose(agent)
        other_x, other_y, _ = self._pose(entity)
        return np.array([other_x - x, other_y - y]) @ rotation(angle)

    def step(self, actions: Sequence[int]) -> FloatArray:
        """Advance by one planner step and return its frame.

        Args:
            actions: of each agent, values of ``Action`` or ``NO_ACTION``.

        Returns:
            (body, 3) mean pose over the five substeps; angles are not wrapped.
        """
        return np.asarray(np.mean([self._poses() for _ in self.substeps(actions)], axis=0))

    def substeps(self, actions: Sequence[int]) -> Iterator[None]:
        """Do one planner step, as :meth:`step`; yield after each of its five substeps.

        The step is done when the iterator is exhausted.
        """
        for agent, action in enumerate(actions):
            if action == Action.ATTACH:
                self._attach(agent)
            elif action == Action.DETACH:
                self._detach(agent)
        for _ in range(constants.SUBSTEPS):
            self._substep(actions)
            yield
        for body in self._bodies[: self._n_agents]:
            body.angle += body.angular_velocity * self._dt
            body.angular_velocity = 0.0
            if self._resets_velocity:
                self._halt(body)

    def _parts(self, actions: Sequence[int]) -> int:
        """Return the number of inner steps that keeps all moves of this substep short enough."""
        parts, fastest = self._least_parts, 0.0
        if self._most_parts <= constants.WORLD_INNER_STEPS:
            return parts
        for entity, body in enumerate(self._bodies):
            speed = body.velocity.length
            if entity < self._n_agents and Action.UP <= actions[entity] <= Action.DOWN_RIGHT:
                speed += self._strengths[entity] * constants.SUBSTEP / body.mass
            fastest = max(fastest, speed)
        while parts < self._most_parts and fastest * constants.SUBSTEP > self._longest_move * parts:
            parts *= 2
        return parts

    def _divide(self, parts: int) -> None:
        """Divide moves into ``parts``; bodies keep the pose that includes the due move."""
        if parts == self._inner_steps:
            return
        before, self._inner_steps, self._dt = self._dt, parts, constants.SUBSTEP / parts
        for body in self._bodies:
            body.position += body.velocity * (before - self._dt)
            body.angle += body.angular_velocity * (before - self._dt)

    def _substep(self, actions: Sequence[int]) -> None:
        n = self._parts(actions)
        self._divide(n)
        for part in range(n):
            if part == 0:
                for agent, action in enumerate(actions):
                    self._act(agent, action)
            if part < 2:
                force = constants.FLOOR_FRICTION * n if part == 0 else 0.0
                for floor in self._floor:
                    floor.max_force = force
            self._space.step(self._dt)
        items = [item for item in self._held if item != NOTHING]
        shared = len(set(items)) < len(items)
        for _ in range(constants.SHARED_WELD_SWEEPS if shared else 1):
            for agent, item in enumerate(self._held):
                if item != NOTHING:
                    self._mend(agent, item, self._weld[agent])

    def _act(self, agent: int, action: int) -> None:
        """Stop the body, or apply its force or torque for the next inner step only."""
        body, n = self._bodies[agent], self._inner_steps
        if action == Action.STOP:
            self._halt(body)
        elif action == Action.TURN_LEFT:
            body.torque = n * constants.turn_torque(self._radius[agent])
        elif action == Action.TURN_RIGHT:
            body.torque = -n * constants.turn_torque(self._radius[agent])
        elif Action.UP <= action <= Action.DOWN_RIGHT:
            force = n * self._strengths[agent] * DIRECTIONS[action]
            arm = constants.FORCE_POINT_Y * self._radius[agent] - self._cog_y[agent]
            body.force = tuple(rotation(self._pose(agent)[2]) @ force)
            body.torque = -arm * float(force[0])

    def _halt(self, body: pymunk.Body) -> None:
        """Stop a body; it keeps the pose that includes the due move."""
        body.position += body.velocity * self._dt
        body.velocity = 0.0, 0.0

    def remove(self, entity: int) -> None:
        """Move a body out of the arena, to ``AWAY``, and out of its holders' hands."""
        for agent in range(self._n_agents):
            if self._held[agent] != NOTHING and entity in (agent, self._held[agent]):
                self._detach(agent)
        body = self._bodies[entity]
        body.position, body.velocity, body.angular_velocity = (AWAY, AWAY), (0.0, 0.0), 0.0

    def deflect(self, factors: FloatArray, angles: FloatArray) -> None:
        """Change the velocities of all bodies at once; poses stay.

        Args:
            factors: (body,) factors of the speed.
            angles: (body,) turns of the direction of motion to the left, rad.
        """
        for body, factor, angle in zip(self._bodies, factors, angles, strict=True):
            before = np.array(body.velocity)
            after = float(factor) * rotation(float(angle)) @ before
            body.position += tuple((before - after) * self._dt)
            body.velocity = tuple(after)

    def find_grab(self, agent: int) -> tuple[int, int]:
        """Return the item that ``agent`` would grab now, and the grab point it would use.

        It is the nearest item, at its nearest grab point, of those whose centre is less than their
        radius + ``GRAB_REACH`` away from a grab point.

        Returns:
            (entity index, index into ``GRAB_POINTS``); -1, -1 if none is in reach or one is held.
        """
        best_item, best_point, best = NOTHING, -1, math.inf
        if self._held[agent] != NOTHING:
            return best_item, best_point
        points = self._radius[agent] * GRAB_POINTS - [0.0, self._cog_y[agent]]
        for item in range(self._n_agents, len(self._bodies)):
            distances = np.linalg.norm(points - self._in_frame(agent, item), axis=1)
            point = int(np.argmin(distances))
            distance = float(distances[point])
            if distance < self._radius[item] + GRAB_REACH and distance < best:
                best_item, best_point, best = item, point, distance
        return best_item, best_point

    def _attach(self, agent: int) -> None:
        item, point = self.find_grab(agent)
        if item == NOTHING:
            return
        length = self._radius[agent] + self._radius[item]
        weld = np.zeros(3)
        weld[:2] = length * GRAB_POINTS[point] - [0.0, self._cog_y[agent]]
        weld[2] = self._pose(item)[2] - self._pose(agent)[2]
        for _ in range(constants.GRAB_CORRECTIONS):
            self._mend(agent, item, weld)
        self._join(agent, item, weld)

    def _mend(self, agent: int, item: int, weld: FloatArray) -> None:
        """Move and turn both bodies towards the weld's pose, by their masses and inertias.

        This is a Newton step on the weld's error e: with J = de/dq and M the masses,
        q -= M^-1 J' K^-1 e, K = J M^-1 J'.
        """
        holder, thing = self._bodies[agent], self._bodies[item]
        x, y, angle = self._pose(agent)
        item_x, item_y, item_angle = self._pose(item)
        rx, ry = rotation(angle) @ weld[:2]
        error = np.array([item_x - x - rx, item_y - y - ry, item_angle - angle - weld[2]])
        jacobian = np.array(
            [[-1.0, 0.0, ry, 1.0, 0.0, 0.0], [0.0, -1.0, -rx, 0.0, 1.0, 0.0], [0, 0, -1, 0, 0, 1]]
        )
        masses = np.array([holder.mass] * 2 + [holder.moment] + [thing.mass] * 2 + [thing.moment])
        weighted = jacobian / masses
        change = -weighted.T @ np.linalg.solve(weighted @ jacobian.T, error)
        holder.position += tuple(change[:2])
        holder.angle += float(change[2])
        thing.position += tuple(change[3:5])
        thing.angle += float(change[5])

    def _join(self, agent: int, item: int, weld: FloatArray) -> None:
        """Weld an item to an agent: a pivot at the item's centre and a gear for the angle."""
        holder, thing = self._bodies[agent], self._bodies[item]
        x, y, angle = weld.tolist()
        pivot = pymunk.PivotJoint(holder, thing, (x, y), (0.0, 0.0))
        gear = pymunk.GearJoint(holder, thing, angle, 1.0)
        for joint in (pivot, gear):
            joint.collide_bodies = False
            # Joints only equalise velocities; ``_mend`` corrects the pose. A joint that pulls back
            # by velocities (error_bias) sags, or drives bodies on when two welds or a wall oppose
            # each other.
            joint.error_bias = 1.0
        self._space.add(pivot, gear)
        self._joints[agent] = (pivot, gear)
        self._held[agent] = item
        self._weld[agent] = weld

    def _detach(self, agent: int) -> None:
        self._space.remove(*self._joints[agent])
        self._joints[agent] = ()
        self._held[agent] = NOTHING
