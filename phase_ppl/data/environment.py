"""A PettingZoo environment: a world for trained, scripted or human agents."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.render.frames import Painter
from phase_ppl.simulator.stage import Stage
from phase_ppl.world import worlds
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    instance_of,
    shown,
    whole_number,
)
from phase_ppl.world.event import SHOWN_SECONDS_PER_FRAME, Event, Observation, Truth
from phase_ppl.world.goals import goal_literal, is_true, possible_goals
from phase_ppl.world.hypothesis import STRENGTH, Hypothesis
from phase_ppl.world.names import NOTHING
from phase_ppl.world.scene import Scene, World

_ParallelEnv: Any = object  # if the extra `env` is missing, as `env()` then says
with contextlib.suppress(ImportError):
    import gymnasium
    from pettingzoo import ParallelEnv as _ParallelEnv  # type: ignore[no-redef]

FEATURES: Final = ("x", "y", "cos", "sin", "vx", "vy", "spin")
"""Features of a body: units; of its angle; units per simulated second; rad per second."""

Observed = dict[str, Any]
Infos = dict[str, dict[str, Any]]


def env(
    world: World | str,
    scene: Scene | None = None,
    *,
    goals: Mapping[str, str | int] | None = None,
    relation: Mapping[tuple[str, str], str] | None = None,
    strength: Mapping[str, float] | float = STRENGTH,
    steps: int = 100,
    full_view: bool = False,
) -> WorldEnv:
    """Return a world as a PettingZoo ``ParallelEnv``, for agents of your own.

    Example:
        ``game = ppl.env(ppl.worlds.TRIO); observations, infos = game.reset(seed=0)``; then
        ``game.step({name: action for name in game.agents})``. ``game.event()`` is an event, for any
        function that takes one.

    Args:
        world: the world, or the name of a ready-made one.
        scene: starts, sizes and walls; None: drawn anew at every reset.
        goals: name of an agent -> its own goal, for all that neither help nor hinder; None: drawn
            at every reset. The goals determine the rewards.
        relation: (who, whom) -> "help" or "hinder" with the other's own goal.
        strength: maximum force by name, or one for all, newtons.
        steps: length of an episode, after which it is truncated; a step lasts a twelfth of a
            simulated second.
        full_view: whether agents see everything.

    Raises:
        InvalidSettingError: PettingZoo is not installed, or a setting is impossible.
        UnknownNameError: there is no such world, agent or goal.
    """
    if _ParallelEnv is object:
        raise InvalidSettingError("environments need PettingZoo: pip install 'phase_ppl[env]'")
    given = {"scene": scene, "goals": goals, "relation": relation}
    n_steps = whole_number("steps", steps)
    return WorldEnv(worlds.named(world), given, strength, n_steps, bool(full_view))


class WorldEnv(_ParallelEnv):  # type: ignore[misc]
    """A world as a ``ParallelEnv``; made by :func:`env`.

    Agents have the names of the world. All act at once, each by one of the fourteen actions of
    :class:`phase_ppl.Action`, which last one step. The physics is the joint simulator's. An
    observation is a dictionary:

    * ``bodies``: (entity, 7) float32 of :data:`FEATURES`; zeros if not observed.
    * ``observed``: (entity,) 0 or 1. An agent observes itself, what is in its field of view and not
      hidden, and what it touches or holds. It also observes what these touch or hold.
    * ``holds``: (agent, item) 0 or 1: whether an observed agent holds the item.
    * ``goal``: the goal that it is rewarded for, an index into the world's goals.

    The reward of a step is 1 if the agent's effective goal is true after it, else 0. A helper's
    effective goal is the other's, a hinderer's its negation. No agent is ever terminated; all are
    truncated after the given number of steps.

    Attributes:
        possible_agents: all agents.
        agents: the same during an episode, else empty.
        scene: of this episode.
        roles: the hypothesis of this episode.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "phase_ppl",
        "render_modes": ["rgb_array"],
        "render_fps": 1 / SHOWN_SECONDS_PER_FRAME,
        "is_parallelizable": True,
    }
    render_mode = "rgb_array"

    def __init__(
        self,
        world: World,
        given: Mapping[str, Any],
        strength: Mapping[str, float] | float,
        steps: int,
        full_view: bool,
    ) -> None:
        self.world, self._given, self._strength = world, dict(given), strength
        self._steps, self._full_view = steps, full_view
        self.possible_agents: list[str] = list(world.agents)
        self.agents: list[str] = []
        n, spaces = len(world.entities), gymnasium.spaces
        self.observation_spaces = {
            name: spaces.Dict(
                {
                    "bodies": spaces.Box(-np.inf, np.inf, (n, len(FEATURES)), np.float32),
                    "observed": spaces.MultiBinary(n),
                    "holds": spaces.MultiBinary((len(world.agents), max(1, len(world.items)))),
                    "goal": spaces.Discrete(len(world.goals)),
                }
            )
            for name in self.possible_agents
        }
        self.action_spaces = {name: spaces.Discrete(N_ACTIONS) for name in self.possible_agents}
        self._rng = np.random.default_rng()
        self._frames: list[FloatArray] = []
        self._begin(self._given, np.random.default_rng(0))  # refuses impossible settings now

    def observation_space(self, agent: str) -> Any:
        """Return the space of an agent's observations, always the same."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """Return the space of an agent's actions, always the same."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Observed], Infos]:
        """Begin an episode; return observations and infos by agent.

        Args:
            seed: of all scenes and goals drawn from now on; None: go on drawing.
            options: ``scene``, ``goals`` or ``relation``, instead of the environment's, for this
                episode. Other options are for wrappers, and ignored.
        """
        if seed is not None:
            self._rng = np.random.default_rng(whole_number("seed", seed, 0))
        told = {name: value for name, value in (options or {}).items() if name in self._given}
        self._begin({**self._given, **told}, self._rng)
        self.agents = list(self.possible_agents)
        return self._observations(), self._infos()

    def _begin(self, given: Mapping[str, Any], rng: np.random.Generator) -> None:
        world, scene, goals = self.world, given["scene"], given["goals"]
        if scene is None:
            scene = world.random_scene(int(rng.integers(2**31)))
        instance_of("scene", scene, Scene, "a phase_ppl.Scene")
        if scene.world != world:
            raise InvalidSettingError(
                f"the scene is of the world {scene.world.name}, the environment of {world.name}"
            )
        if goals is None:
            if given["relation"] is not None:
                raise InvalidSettingError("relation= goes with goals=")
            goals = {
                name: int(rng.choice(possible_goals(agent, world)))
                for agent, name in enumerate(world.agents)
            }
        self.roles = Hypothesis.of(world, goals, given["relation"], self._strength)
        self.scene: Scene = scene
        self._goals = self.roles.effective_goals
        self._stage = Stage(scene, self.roles.strengths)
        self._frames = [scene.start.copy()]
        self._painter: Painter | None = None

    def step(
        self, actions: Mapping[str, int]
    ) -> tuple[dict[str, Observed], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Advance by one step, in which all agents act.

        Args:
            actions: name of every agent -> its action, 0 to 13.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent.

        Raises:
            InvalidSettingError: the episode is over or has not begun, or an agent has no action or
                an unknown one.
        """
        if not self.agents:
            raise InvalidSettingError("no episode goes on: reset() begins one")
        for name in actions:
            self.world.agent(name)
        doing = []
        for name in self.agents:
            if name not in actions:
                raise InvalidSettingError(f"the {name} has no action")
            what = f"action of the {name}"
            doing.append(whole_number(what, actions[name], 0, N_ACTIONS - 1))
        self._frames.append(self._stage.step(doing))
        infos, over = self._infos(), len(self._frames) > self._steps
        rewards = {name: float(infos[name]["reached"]) for name in self.agents}
        ended, cut = (dict.fromkeys(self.agents, flag) for flag in (False, over))
        if over:
            self.agents = []
        return self._observations(), rewards, ended, cut, infos

    def _observations(self) -> dict[str, Observed]:
        state = self._stage.state
        n, n_agents = len(state.pose), len(state.held)
        angle = state.pose[:, 2]
        features = np.column_stack(
            [state.pose[:, :2], np.cos(angle), np.sin(angle), state.velocity, state.spin]
        )
        holds = np.zeros((n_agents, max(1, n - n_agents)), np.int8)
        holding = np.flatnonzero(state.held != NOTHING)
        holds[holding, state.held[holding] - n_agents] = 1
        found = {}
        for agent, name in enumerate(self.possible_agents):
            seen = np.ones(n, np.bool_) if self._full_view else self._stage.sees(agent)
            found[name] = {
                "bodies": np.where(seen[:, None], features, 0.0).astype(np.float32),
                "observed": seen.astype(np.int8),
                "holds": np.where(seen[:n_agents, None], holds, 0).astype(np.int8),
                "goal": np.int64(self._goals[agent]),
            }
        return found

    def _infos(self) -> Infos:
        infos = {}
        for agent, name in enumerate(self.possible_agents):
            literal = goal_literal(self._goals[agent], agent, self.world)
            infos[name] = {
                "goal": self.world.goals[self._goals[agent]],
                "reached": is_true(literal, self._frames[-1], self.scene),
            }
        return infos

    def render(self) -> NDArray[np.uint8]:
        """Return a picture of the present scene, (height, width, 3) RGB values."""
        if self._painter is None:
            self._painter = Painter(self.scene)
        return np.asarray(self._painter.draw(self._frames[-1]), np.uint8)

    def event(self, id: str = "played") -> Event:
        """Return the episode so far as an event; its truth has the rewarded goals.

        Raises:
            InvalidEventError: nothing has happened yet.
        """
        if len(self._frames) < 2:
            raise InvalidEventError(f"event {shown(id)}: no step has been made since the reset")
        truth = Truth.of(self.roles)
        return Event(self.scene, Observation(np.array(self._frames)), id=id, truth=truth)
