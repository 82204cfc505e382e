"""A scene in motion, in which people, scripts, policies and the planner can act."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from phase_ppl.agents import vision
from phase_ppl.agents.agent import Agent
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled, constants
from phase_ppl.physics.actions import N_ACTIONS, Action, executed
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.errors import InvalidSettingError, instance_of, whole_number
from phase_ppl.world.event import State
from phase_ppl.world.hypothesis import checked_strength
from phase_ppl.world.scene import Scene


class Stage:
    """A scene in motion: actions move bodies, and some agents can act by themselves.

    The physics is that of :func:`phase_ppl.simulate`, in any world.

    Example:
        ``stage = ppl.Stage(scene, [300, 300])`` and ``rival = stage.planned(1, goals, seed)``; then
        ``frame = stage.step([ppl.Action.UP, rival.decide()])``, step by step.

    Args:
        scene: the start; it also says which way agents turn, and whether they stop after each step.
        strengths: (agent,) maximum force of each agent, newtons.
        planner: settings for agents that act by themselves: the name of a preset
            (:meth:`phase_ppl.PlannerConfig.named`), such as "fast", or a ``PlannerConfig``.

    Attributes:
        scene: the start.
        SUBSTEPS: number of substeps of a step, 5.

    Raises:
        InvalidSettingError: a strength is no positive force, or some agent has none; or a body is
            too small for the speed that the strengths give it.
        UnknownNameError: there is no such planner.
    """

    SUBSTEPS: ClassVar[int] = constants.SUBSTEPS

    def __init__(
        self,
        scene: Scene,
        strengths: Sequence[float],
        planner: str | PlannerConfig = "fast",
    ) -> None:
        instance_of("scene", scene, Scene, "a phase_ppl.Scene")
        self.scene, self._planner = scene, PlannerConfig.named(planner)
        self._check_each("strengths", strengths)
        self._strengths = tuple(
            checked_strength(f"strength of the {name}", force)
            for name, force in zip(scene.world.agents, strengths, strict=True)
        )
        self._physics = PymunkWorld(scene, self._strengths)

    def _check_each(self, what: str, given: Sequence[object]) -> None:
        agents = self.scene.world.agents
        number = len(given) if isinstance(given, Sequence | np.ndarray) else 1
        if number != len(agents) or isinstance(given, str):
            raise InvalidSettingError(
                f"{what}: {number} are given, expected one for each of {', '.join(agents)}"
            )

    @functools.cached_property
    def _model(self) -> WorldModel:  # compiled code, which motion alone does not need
        return WorldModel.of(self.scene, self._strengths, self._planner)

    @property
    def state(self) -> State:
        """A copy of the present state.

        ``pose`` (entity, 3) is x, y [units] and angle [rad]. ``velocity`` (entity, 2) and ``spin``
        (entity,) are in units and rad per simulated second. ``held`` (agent,) is the index of the
        entity that each agent holds, or -1. ``weld`` (agent, 3) is the place of the held item
        relative to the agent: x, y [units], angle [rad].
        """
        return self._physics.state

    def step(self, actions: Sequence[int]) -> FloatArray:
        """Advance by one planner step, a twelfth of a simulated second; all agents act.

        Args:
            actions: (agent,) a :class:`phase_ppl.Action` for each agent.

        Returns:
            The next frame of the trajectory, whose first frame is ``scene.start``: (entity, 3) x, y
            [units] and angle [rad, unwrapped], the mean over the five substeps.

        Raises:
            InvalidSettingError: there is no such action, or some agent has none.
        """
        return self._physics.step(self._doing(actions))

    def substeps(self, actions: Sequence[int]) -> Iterator[None]:
        """Advance by one planner step, and yield after each of its five substeps.

        The step is done when the iterator is exhausted. For ``actions`` and errors see
        :meth:`step`.
        """
        return self._physics.substeps(self._doing(actions))

    def _doing(self, actions: Sequence[int]) -> list[int]:
        self._check_each("actions", actions)
        return [
            executed(whole_number("action", action, 0, N_ACTIONS - 1), self.scene.turning)
            for action in actions
        ]

    def _number_of(self, agent: int) -> int:
        return whole_number("agent", agent, 0, len(self.scene.world.agents) - 1)

    def sees(self, agent: int) -> BoolArray:
        """Return (entity,) whether the agent of index ``agent`` observes each entity now.

        An agent observes itself, entities in its field of view that nothing hides, and entities
        that it touches or holds. Along a chain, it also observes what an observed entity touches or
        holds.
        """
        agent = self._number_of(agent)
        bodies, held, _ = compiled.from_state(self.state, self.scene.radius)
        layout = self._model.layout
        cells = np.zeros(layout.rows * layout.columns, np.bool_)
        outline = np.empty(vision.MAX_OUTLINE_CELLS, np.int64)
        observed = np.zeros(len(bodies), np.bool_)
        vision.observe(
            *(bodies, held, agent, False, self._model.params, layout), cells, outline, observed
        )
        return observed

    def planned(
        self, agent: int, goals: Sequence[str | int], seed: int | np.random.Generator
    ) -> Planned:
        """Return an agent that acts by itself, as in the joint simulator.

        Args:
            agent: index of the agent.
            goals: (agent,) effective goal of each agent, one of ``world.goals`` or its index there.
                The agent knows all of them.
            seed: a whole number >= 0, or a generator, for the agent's beliefs and searches.

        Raises:
            UnknownNameError: there is no such goal.
            InvalidSettingError: there is no such agent, or some agent has no goal.
        """
        agent = self._number_of(agent)
        self._check_each("goals", goals)
        codes = tuple(map(self.scene.world.goal_index, goals))
        rng = np.random.default_rng(seed)
        return Planned(self, Agent(agent, codes, self._model, self._planner, rng))


class Planned:
    """An agent on a :class:`Stage` that acts by itself: it sees, believes and plans."""

    def __init__(self, stage: Stage, agent: Agent) -> None:
        self._stage, self._agent = stage, agent

    def decide(self) -> Action:
        """Observe the stage as it is now, and return the agent's action for the coming step.

        Call it once a step: the agent remembers what it has seen and done before.
        """
        seen = compiled.from_state(self._stage.state, self._stage.scene.radius)
        return self._agent.decide(*seen).action
