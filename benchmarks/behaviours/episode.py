"""A simulated pair with its holds and reasons, and questions about them."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.agent import Decision
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.physics.actions import executed
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.simulator.contract import random_generator
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.geometry import is_on, touches
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import NOTHING, Literal, PredicateKind
from phase_ppl.world.scene import Scene

RED, GREEN, BLUE, PINK = range(4)
TOP_LEFT, TOP_RIGHT, BOTTOM_RIGHT, BOTTOM_LEFT = range(4)


class Episode(NamedTuple):
    """What happened.

    Attributes:
        frames: (T, 4, 3) x, y, angle per entity.
        held: (T, 2) item that (red, green) hold at the end of each step, -1 for none.
        decisions: of both agents, one pair per step: frames[k] follows decisions[k - 1].
    """

    scene: Scene
    hypothesis: Hypothesis
    frames: NDArray[np.float64]
    held: NDArray[np.int64]
    decisions: tuple[tuple[Decision, ...], ...]

    def gap(self, first: int, second: int) -> NDArray[np.float64]:
        """Return the straight distance between two entities over time, units."""
        return np.linalg.norm(self.frames[:, first, :2] - self.frames[:, second, :2], axis=1)

    def way(self, first: int, second: int) -> NDArray[np.float64]:
        """Return the length of the way through the doors between two entities over time."""
        path = self.scene.rooms.path_distance
        return np.array([path(frame[first, :2], frame[second, :2]) for frame in self.frames])

    def rooms(self, entity: int) -> NDArray[np.int64]:
        return np.asarray(self.scene.rooms.room_of(self.frames[:, entity, :2]))

    def holding(self, agent: int, item: int) -> NDArray[np.bool_]:
        return self.held[:, agent] == item

    def both_hold(self, item: int) -> NDArray[np.bool_]:
        return self.holding(RED, item) & self.holding(GREEN, item)

    def moved_while(self, item: int, when: NDArray[np.bool_]) -> float:
        """Return how far an item travelled in the steps for which ``when`` holds, units."""
        steps = np.linalg.norm(np.diff(self.frames[:, item, :2], axis=0), axis=1)
        return float(steps[when[1:]].sum())

    def is_on(self, entity: int, landmark: int) -> NDArray[np.bool_]:
        centre, half_width = self.scene.landmark_centres[landmark], self.scene.landmark_half_width
        return np.array([is_on(frame[entity, :2], centre, half_width) for frame in self.frames])

    def touching(self, first: int, second: int) -> NDArray[np.bool_]:
        return np.array([touches(first, second, f, self.scene.radius) for f in self.frames])

    def reached(self, goal: Literal) -> NDArray[np.bool_]:
        """Return when the positive form of a goal holds."""
        if goal.predicate is PredicateKind.ON:
            return self.is_on(goal.subject, goal.target)
        return self.touching(goal.subject, goal.target)

    def goals(self) -> tuple[Literal, Literal]:
        red, green = self.hypothesis.effective_goals
        return goal_literal(red, RED), goal_literal(green, GREEN)


def record(
    scene: Scene, hypothesis: Hypothesis, planner: PlannerConfig, seed: int, steps: int = 100
) -> Episode:
    """Simulate ``steps`` steps."""
    simulator = JointSimulator(planner)
    run = simulator.steps(scene, hypothesis.effective(), random_generator(seed))
    frames, decisions = zip(*itertools.islice(run, steps + 1), strict=True)
    # the world is deterministic: the same actions give the same holds
    world = PymunkWorld(scene, hypothesis.strengths, simulator.inner_steps)
    held = [[NOTHING, NOTHING]]
    for red, green in decisions[1:]:
        actions = executed(red.action, scene.turning), executed(green.action, scene.turning)
        world.step(actions)
        held.append(world.state.held.tolist())
    return Episode(scene, hypothesis, np.array(frames), np.array(held), decisions[1:])
