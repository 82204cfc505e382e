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
        scene: the start; also which way agents turn, and whether they stop after each step.
        strengths: maximum force of each agent, newtons.
        planner: for agents that act by themselves, "fast", "paper" or a ``PlannerConfig``.

    Attributes:
        scene: as given.
        SUBSTEPS: parts of a step, 5.

    Raises:
        InvalidSettingError: a strength is no positive force, or there is not one for each agent;
            or a body is too small for the speed that the strengths give it.
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
        """The present state, a copy.

        ``pose`` (entity, 3) is x, y [units] and angle [rad]. ``velocity`` (entity, 2) is in units,
        ``spin`` (entity,) in rad per simulated second. ``held`` (agent,) is the number of the item
        that each agent holds, or -1.
        """
        return self._physics.state

    def step(self, actions: Sequence[int]) -> FloatArray:
        """Advance by one planner step, a twelfth of a simulated second; all agents act.

        Args:
            actions: of each agent, a :class:`phase_ppl.Action`.

        Returns:
            (entity, 3) x, y [units] and angle [rad, unwrapped], the mean over five substeps: a
            frame of a trajectory, after ``scene.start``.

        Raises:
            InvalidSettingError: there is no such action, or not one for each agent.
        """
        return self._physics.step(self._doing(actions))

    def substeps(self, actions: Sequence[int]) -> Iterator[None]:
        """Do the same as :meth:`step`, and yield after each of the five substeps.

        The step is done when the iterator is exhausted.
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
        """Return (entity,) whether an agent observes each entity now.

        It observes itself, what is in its field of view and not hidden, and what it touches or
        holds. It also observes what these touch or hold.
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
            agent: its number.
            goals: effective goals of all agents; the agent knows all of them.
            seed: of its beliefs and searches.

        Raises:
            UnknownNameError: there is no such goal.
            InvalidSettingError: there is no such agent, or not a goal for each.
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
        """Observe the stage as it is now, and return the action of the coming step.

        Call it once a step: it remembers what it has seen and done before.
        """
        seen = compiled.from_state(self._stage.state, self._stage.scene.radius)
        return self._agent.decide(*seen).action
