"""A simulator without physics: agents follow the subgoals of the same planner along paths.

It is an ablation of the joint simulator. Beliefs and subgoals are those of Algorithm 1. Motion at a
constant speed along the way through the doors replaces the search for actions and the dynamics.
There are no forces, masses or collisions: bodies pass through each other, and through doors of any
width.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.agents.agent import all_agents
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel, body_origin
from phase_ppl.physics import compiled
from phase_ppl.simulator.joint import run_briefly
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import positive_number
from phase_ppl.world.event import FRAMES_PER_SECOND, State
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import NOTHING, Literal, PredicateKind
from phase_ppl.world.scene import Scene

SPEED: Final = 10.0
"""Speed of everything that moves, units per simulated second. Recorded agents have about this speed
while they move; their mean is 7.6 with their rests, which take a quarter of the time."""

_INSET: Final = 0.1  # least distance of a body from the border, units

_MEAN_OF_STEP: Final = 0.6
"""Mean progress of a body that moves evenly, over the five substeps of a step."""


class Wish(NamedTuple):
    """What an agent wants to do in the next step."""

    move: FloatArray = np.zeros(2)  # how its body should move, with the item that it holds, units
    grab: int = NOTHING  # item to take hold of, or ``NOTHING``
    release: bool = False  # whether to let go


class PathSimulator:
    """Agents with limited views that believe and plan, and move without physics.

    An item with several holders moves by the mean of their wishes. An agent at once faces the way
    that it goes; one that carries an item does not turn.

    Args:
        planner: "fast", "paper" or a :class:`PlannerConfig`. Nothing is searched, so that only its
            settings of beliefs and subgoals count.
        speed: units per simulated second.

    Raises:
        InvalidSettingError: the speed is no positive number.
        UnknownNameError: there is no such planner.
    """

    def __init__(self, planner: str | PlannerConfig = "fast", speed: float = SPEED) -> None:
        self.planner = PlannerConfig.named(planner)
        self.speed = positive_number("speed", speed)

    def settings(self) -> dict[str, Any]:
        """Return what determines the simulations, as plain data."""
        return {"planner": self.planner.to_dict(), "speed": self.speed}

    def warm_up(self) -> None:
        """Compile the kernels of a simulation, or load them from the cache on disk."""
        run_briefly(self)

    def __call__(
        self, scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
    ) -> Iterator[FloatArray]:
        """Yield frames (entity, 3) = x, y [units], angle [rad], the start first."""
        model = WorldModel.of(scene, hypothesis.strengths, self.planner)
        agents = all_agents(hypothesis.effective_goals, model, self.planner, rng)
        state = State.at_start(scene)
        yield state.pose.copy()
        while True:
            before = state.pose.copy()
            arrays = compiled.from_state(state, scene.radius)
            wishes = []
            for agent in agents:
                # it is not told its action, so that its beliefs imagine no dynamics
                agent.observe(*arrays)
                subgoal, agreeing, _ = agent.intent
                imagined = agent.beliefs.bodies[agreeing[0]]
                wishes.append(self._wish(agent.agent, subgoal, imagined, state, model))
            _move(state, wishes, scene)
            frame = state.pose.copy()
            frame[:, :2] = before[:, :2] + _MEAN_OF_STEP * (state.pose - before)[:, :2]
            yield frame

    def _wish(
        self, agent: int, subgoal: Literal, imagined: FloatArray, state: State, model: WorldModel
    ) -> Wish:
        """Return an agent's wish for a subgoal, given where it imagines the others."""
        predicate, subject, target, positive = subgoal
        held = int(state.held[agent])
        if predicate is PredicateKind.STOP:
            return Wish()
        if predicate is PredicateKind.ATTACH and not positive:
            return Wish(release=True)
        n, cog = len(imagined), model.params.cog
        places = np.array([body_origin(imagined, entity, cog) for entity in range(n)])
        item = target if predicate is PredicateKind.ATTACH else subject
        if item >= len(state.held):
            if held != item:
                bodies, holds, _ = compiled.from_state(state, model.scene.radius)
                if compiled.find_grab(bodies, holds, agent, model.params)[0] == item:
                    return Wish(grab=item)
                return Wish(self._up_to(agent, item, places, model))
            return Wish(self._along(state.pose[item, :2], _place(subgoal, places, model), model))
        if predicate is PredicateKind.TOUCH and positive:
            return Wish(self._up_to(agent, target, places, model))
        if subject != agent:  # without physics, nobody can be pushed
            return Wish(self._up_to(agent, subject, places, model))
        return Wish(self._along(places[agent], _place(subgoal, places, model), model))

    def _up_to(self, agent: int, other: int, places: FloatArray, model: WorldModel) -> FloatArray:
        """Return a move towards another body that ends where the two touch."""
        apart = model.scene.radius[agent] + model.scene.radius[other]
        return self._along(places[agent], places[other], model, apart)

    def _along(
        self, start: FloatArray, end: FloatArray, model: WorldModel, apart: float = 0.0
    ) -> FloatArray:
        """Return one step's move along the way from start to end, stopping ``apart`` before it."""
        left = model.scene.rooms.path_distance(start, end) - apart
        length = min(self.speed / FRAMES_PER_SECOND, left)
        place, rooms, corners = start, model.scene.rooms, [end]
        if not rooms.is_open:
            doors = rooms.route(int(rooms.room_of(start)), int(rooms.room_of(end)))
            # there may be no way
            corners = [] if doors is None else [*rooms.door_position[list(doors)], end]
        for corner in corners:
            stretch = float(np.linalg.norm(corner - place))
            if length <= 0:
                break
            if stretch > 0:
                place = place + min(1.0, length / stretch) * (corner - place)
            length -= stretch
        return place - start


def _place(subgoal: Literal, places: FloatArray, model: WorldModel) -> FloatArray:
    """Return the place to which the subject of a subgoal shall go.

    For "not" on a landmark, that is the landmark farthest from it. Away from an agent, it is the
    landmark that the subject reaches with the greatest lead.
    """
    layout, target = model.layout, subgoal.target
    if subgoal.predicate is PredicateKind.CLOSE:
        n_rooms = len(layout.room_points)
        return layout.room_points[target] if target < n_rooms else layout.doors[target - n_rooms]
    landmarks, path_distance = model.scene.landmark_centres, model.scene.rooms.path_distance
    if subgoal.predicate is PredicateKind.TOUCH:
        fugitive, pursuer = places[subgoal.subject], places[target]
        lead = [path_distance(pursuer, to) - path_distance(fugitive, to) for to in landmarks]
        return landmarks[int(np.argmax(lead))]
    if subgoal.positive:
        return landmarks[target]
    return landmarks[int(np.argmax([path_distance(landmarks[target], to) for to in landmarks]))]


def _move(state: State, wishes: list[Wish], scene: Scene) -> None:
    """Change the state as the agents wish; nobody leaves the arena."""
    moves = [wish.move for wish in wishes]
    holders = {item: np.flatnonzero(state.held == item) for item in state.held if item != NOTHING}
    for together in holders.values():
        mean = np.mean([moves[holder] for holder in together], axis=0)
        for holder in together:
            moves[holder] = mean
    for agent, (move, wish) in enumerate(zip(moves, wishes, strict=True)):
        item = state.held[agent]
        state.pose[agent, :2] += move
        if item != NOTHING:
            if agent == holders[item][0]:
                state.pose[item, :2] += move
        elif move.any():  # it faces its way
            angle = float(state.pose[agent, 2])
            turn = math.atan2(-move[0], move[1]) - angle
            state.pose[agent, 2] = angle + math.remainder(turn, 2 * math.pi)
        if wish.release:
            state.held[agent] = NOTHING
        elif wish.grab != NOTHING:
            state.held[agent] = wish.grab
    x0, x1, y0, y1 = scene.arena
    state.pose[:, :2] = state.pose[:, :2].clip(
        [x0 + _INSET, y0 + _INSET], [x1 - _INSET, y1 - _INSET]
    )
