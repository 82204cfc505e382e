"""The joint physical-social simulator G(h) (paper, Algorithm 1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.agent import Agent, Decision
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.mind import Mind
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import executed
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import AGENTS
from phase_ppl.world.scene import Scene


class JointSimulator:
    """Two agents with limited views that believe, plan and push each other about.

    Args:
        planner: "fast", "paper" or a :class:`PlannerConfig`.
        inner_steps: solver steps per physics substep of the world.
    """

    def __init__(self, planner: str | PlannerConfig = "fast", inner_steps: int = 4) -> None:
        self.planner = PlannerConfig.named(planner)
        self.inner_steps = inner_steps

    def warm_up(self) -> None:
        """Compile what simulating needs, or load it from the cache on disk."""
        spots = [[8.0, 20.0, 0.0], [24.0, 20.0, 0.0], [24.0, 4.0, 0.0], [8.0, 4.0, 0.0]]
        scene = Scene(start=np.array(spots), radius=np.full(4, 0.8))
        hypothesis = Hypothesis("Get blue item to red lm", "Get red agent to red lm")  # type: ignore[arg-type]
        planner = dataclasses.replace(self.planner, simulations=2)
        frames = JointSimulator(planner)(scene, hypothesis, np.random.default_rng(0))
        for _ in range(3):
            next(frames)

    def __call__(
        self, scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
    ) -> Iterator[NDArray[np.float64]]:
        """Yield frames (4, 3) = x, y [units], angle [rad] per entity, the start first."""
        for frame, _ in self.steps(scene, hypothesis, rng):
            yield frame

    def steps(
        self, scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
    ) -> Iterator[tuple[NDArray[np.float64], tuple[Decision, ...]]]:
        """Yield each frame with the decisions of (red, green) behind it; the start has none."""
        strengths = hypothesis.strengths
        goals = hypothesis.effective_goals
        mind = Mind.of(scene, strengths, self.planner)
        agents = [
            Agent(agent, goals, mind, self.planner, rng.spawn(1)[0]) for agent in range(len(AGENTS))
        ]
        world = PymunkWorld(scene, strengths, self.inner_steps)
        yield scene.start.copy(), ()
        while True:
            bodies, held, weld = compiled.from_state(world.state, scene.radius)
            decisions = tuple(agent.decide(bodies, held, weld) for agent in agents)
            red, green = (executed(decision.action, scene.turning) for decision in decisions)
            yield world.step((red, green)), decisions
