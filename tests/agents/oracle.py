"""The same search in plain Python over the pymunk world: slow, and plain to read.

An oracle for tests and benchmarks of :mod:`phase_ppl.agents.pomcp`, which does the same with
compiled physics. It imagines welded holds only, not the swivelling ones.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from phase_ppl.agents import pomcp
from phase_ppl.agents.agent import Agent, Intent, RootStatistics
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.pomcp import SearchSettings
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import NO_ACTION, Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.arrays import IntArray
from phase_ppl.world.event import State
from phase_ppl.world.names import Literal


@dataclasses.dataclass
class Node:
    """A node of the search tree: ``children`` by action column, None where not tried."""

    children: list[Node | None]
    visits: int = 0
    total: float = 0.0

    @property
    def value(self) -> float:
        return self.total / self.visits if self.visits else math.nan


class SlowSearch:
    """PUCT over an agent's own actions with random rollouts (see ``pomcp.run``).

    An early stop is not made, as it changes no action.
    """

    def __init__(
        self,
        model: WorldModel,
        strengths: tuple[float, float],
        search: SearchSettings,
        inner_steps: int,
        generator: np.random.Generator,
    ) -> None:
        self.model, self.search, self.generator = model, search, generator
        start = State.at_start(model.scene)
        self.world = PymunkWorld(model.scene, strengths, inner_steps, start, iterations=10)

    def run(self, particles: list[State], agent: int, subgoal: Literal, actions: IntArray) -> Node:
        """Return the root after ``n_simulations`` from particles drawn uniformly."""
        code = pomcp.subgoal_code(subgoal)
        root = Node([None] * len(actions))
        for _ in range(self.search.simulations):
            self.world.restore(particles[int(self.generator.integers(len(particles)))])
            self._simulate(root, agent, code, actions)
        return root

    def _simulate(self, root: Node, agent: int, code: IntArray, actions: IntArray) -> None:
        node, path, gains = root, [root], []
        while True:
            column = self._select(node)
            gains.append(self._step(agent, int(actions[column]), NO_ACTION, code))
            child = node.children[column]
            if child is None:
                child = node.children[column] = Node([None] * len(actions))
                path.append(child)
                break
            node = child
            path.append(node)
        value, weight = 0.0, 1.0
        for _ in range(self.search.rollout_length):
            own, other = (int(a) for a in self.generator.choice(actions, 2))
            value += weight * self._step(agent, own, other, code)
            weight *= self.search.discount
        for visited, gain in zip(path[:0:-1], gains[::-1], strict=True):
            value = gain + self.search.discount * value
            visited.visits += 1
            visited.total += value
        root.visits += 1

    def _select(self, node: Node) -> int:
        """Return the column of highest Q + U; untried ones first; ties at random."""
        search, n = self.search, len(node.children)
        grown = math.log((1 + node.visits + search.c_base) / search.c_base) + search.c_init
        scores = np.array(
            [
                math.inf
                if child is None
                else child.value + grown * math.sqrt(node.visits) / n / (1 + child.visits)
                for child in node.children
            ]
        )
        return int(self.generator.choice(np.flatnonzero(scores == scores.max())))

    def _step(self, agent: int, own: int, other: int, code: IntArray) -> float:
        """Move the imagined world on and return the reward of the agent's action."""
        self.world.step((own, other) if agent == 0 else (other, own))
        bodies, held, _ = compiled.from_state(self.world.state, self.model.scene.radius)
        return pomcp.reward(bodies, held, code, own, self.model.params, self.model.layout)


class OracleAgent(Agent):
    """An agent that searches with :class:`SlowSearch`; all else is as in :class:`Agent`."""

    def __init__(
        self,
        agent: int,
        goals: tuple[int, int],
        model: WorldModel,
        config: PlannerConfig,
        generator: np.random.Generator,
        strengths: tuple[float, float],
    ) -> None:
        assert not config.swivel, "the search imagines none"
        assert not config.paired, "the search pairs nothing"
        super().__init__(agent, goals, model, config, generator)
        self.slow_search = SlowSearch(
            model, strengths, SearchSettings.of(config), config.inner_steps, generator.spawn(1)[0]
        )

    def _search_actions(self, intents: Sequence[Intent], actions: IntArray) -> list[RootStatistics]:
        beliefs, (intent,) = self.beliefs, intents
        particles = [
            compiled.to_state(
                beliefs.bodies[k], beliefs.held[k], beliefs.weld[k], self.model.scene.radius
            )
            for k in intent.agreeing
        ]
        root = self.slow_search.run(particles, self.agent, intent.subgoal, actions)
        visits = np.array([child.visits if child else 0 for child in root.children], np.int64)
        values = np.array([child.value if child else math.nan for child in root.children])
        best = self.slow_search.generator.choice(np.flatnonzero(visits == visits.max()))
        return [RootStatistics(actions, visits, values, Action(int(actions[best])))]
