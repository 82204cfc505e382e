"""The joint physical-social simulator G(h) (paper, Algorithm 1)."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.agent import Decision, all_agents
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import NO_ACTION, Action, executed
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.simulator.contract import Simulator, simulate_trajectory
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    check_memory,
    instance_of,
    nonnegative_number,
    whole_number,
)
from phase_ppl.world.event import MIN_FRAMES, Event, Observation, State, Thoughts, Truth
from phase_ppl.world.geometry import CENTRE_OF_MASS_Y, deepest_overlap
from phase_ppl.world.hypothesis import STRENGTH, Hypothesis
from phase_ppl.world.scene import Scene


@dataclasses.dataclass(frozen=True)
class DynamicsNoise:
    """Noise on the dynamics: after each step of 1/12 s it disturbs every body's velocity.

    The agents do not know of the noise: they imagine the dynamics without it.

    Attributes:
        speed: standard deviation, per step, of the logarithm of the factor on a body's speed.
        direction: standard deviation, per step, of the turn of a body's direction of motion, rad.

    Raises:
        InvalidSettingError: a value is negative or not finite.
    """

    speed: float = 0.2
    direction: float = 0.2

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            nonnegative_number(f"noise of {name}", value)

    def disturb(self, world: PymunkWorld, rng: np.random.Generator) -> None:
        """Change the velocities of a world's bodies."""
        n = len(world.state.pose)
        factors = np.exp(self.speed * rng.standard_normal(n))
        world.deflect(factors, self.direction * rng.standard_normal(n))


class Past(NamedTuple):
    """The states and actions before a simulation goes on.

    Attributes:
        states: (time,) state of the world at every frame so far, the start first.
        actions: (time - 1, agent) action that each agent intended between two frames.
    """

    states: Sequence[State]
    actions: Sequence[Sequence[Action]]


class JointSimulator:
    """The paper's simulator (Algorithm 1): agents with limited views believe, plan and push.

    Args:
        planner: settings of the agents' planner: the name of a preset
            (:meth:`phase_ppl.PlannerConfig.named`) or a :class:`phase_ppl.PlannerConfig`.
        inner_steps: number of solver steps per physics substep, a fifth of a frame.
        noise: a ``DynamicsNoise`` on the bodies' velocities; None: no noise.
    """

    def __init__(
        self,
        planner: str | PlannerConfig = "fast",
        inner_steps: int = 4,
        noise: DynamicsNoise | None = None,
    ) -> None:
        self.planner = PlannerConfig.named(planner)
        self.inner_steps = inner_steps
        self.noise = noise

    def settings(self) -> dict[str, Any]:
        """Return planner, inner steps and noise as plain data, to be stored with a run."""
        return {
            "planner": self.planner.to_dict(),
            "inner_steps": self.inner_steps,
            "noise": None if self.noise is None else dataclasses.asdict(self.noise),
        }

    def warm_up(self) -> None:
        """Compile the code of planner and physics, or load it from the cache on disk."""
        run_briefly(JointSimulator(dataclasses.replace(self.planner, simulations=2)))

    def __call__(
        self, scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
    ) -> Iterator[NDArray[np.float64]]:
        """Yield frames (entity, 3) = x, y [units], angle [rad], the start first, without end."""
        return (frame for frame, _ in self.steps(scene, hypothesis, rng))

    def steps(
        self,
        scene: Scene,
        hypothesis: Hypothesis,
        rng: np.random.Generator,
        past: Past | None = None,
        removed: Collection[int] = (),
    ) -> Iterator[tuple[NDArray[np.float64], tuple[Decision, ...]]]:
        """Yield each frame, (entity, 3), with the agents' decisions that led to it.

        The first frame has no decisions.

        Args:
            scene: the start.
            hypothesis: goals and strengths of all agents.
            rng: source of all randomness.
            past: a ``Past``, the states and actions so far; None: begin at the scene's start.
            removed: indices of entities that have left the scene. Removed agents decide nothing.
                The other agents notice a removal only by sight.

        Raises:
            InvalidEventError: a state of ``past`` has another number of entities than the scene.
        """
        for state in () if past is None else past.states:
            if state.pose.shape != scene.start.shape:
                raise InvalidEventError(
                    f"past: {len(state.pose)} entities, expected the {len(scene.start)} of "
                    f"{scene.world.name}"
                )
        strengths = hypothesis.strengths
        model = WorldModel.of(scene, strengths, self.planner)
        agents = all_agents(hypothesis.effective_goals, model, self.planner, rng)
        disturbing = rng.spawn(1)[0]
        now = None if past is None else past.states[-1]
        world = PymunkWorld(scene, strengths, self.inner_steps, now)
        if past is not None:
            for state, actions in zip(past.states, past.actions, strict=False):
                seen = compiled.from_state(state, scene.radius)
                for agent, action in zip(agents, actions, strict=True):
                    agent.look(*seen, action)
        for entity in removed:
            world.remove(entity)
        first = world.state.pose if now is not None or removed else scene.start.copy()
        yield first, ()
        there = [agent for agent in agents if agent.agent not in removed]
        while True:
            bodies, held, weld = compiled.from_state(world.state, scene.radius)
            decisions = tuple(agent.decide(bodies, held, weld) for agent in there)
            doing = [NO_ACTION] * len(agents)
            for agent, decision in zip(there, decisions, strict=True):
                doing[agent.agent] = executed(decision.action, scene.turning)
            yield world.step(doing), decisions
            if self.noise is not None:
                self.noise.disturb(world, disturbing)


def scene_in_reach() -> Scene:
    """Return a scene in which an agent can grab, so that all kernels are compiled soon."""
    spots = [[8.0, 20.0, 0.0], [24.0, 20.0, 0.0], [8.0, 18.6, 0.0], [8.0, 4.0, 0.0]]
    return Scene(start=np.array(spots), radius=np.full(4, 0.8))


def run_briefly(simulator: Simulator) -> None:
    """Take a few frames from a simulator, so that its kernels are compiled."""
    scene = scene_in_reach()
    hypothesis = Hypothesis("Get blue item to red lm", "Get red agent to red lm")  # type: ignore[arg-type]
    frames = iter(simulator(scene, hypothesis, np.random.default_rng(0)))
    for _ in range(3):
        next(frames)


_FRAME_BYTES: Final = 10_000  # of memory, including the agents' thoughts
_OVERLAP: Final = 0.25  # units by which bodies may overlap at the start; the world moves them apart


def _thoughts(decisions: Sequence[Decision], scene: Scene) -> tuple[Any, ...]:
    """Return the agents' thoughts at one moment, in the order of ``Thoughts``."""
    offsets = CENTRE_OF_MASS_Y * scene.radius
    offsets[len(scene.world.agents) :] = 0.0
    poses = np.stack([one.beliefs.bodies[..., :3] for one in decisions])
    poses[..., 0] += np.sin(poses[..., 2]) * offsets
    poses[..., 1] -= np.cos(poses[..., 2]) * offsets
    return (
        tuple(one.intent.subgoal for one in decisions),
        [int(one.action) for one in decisions],
        [len(one.intent.agreeing) / poses.shape[1] for one in decisions],
        np.stack([one.beliefs.observed for one in decisions]),
        [one.held for one in decisions],
        poses.astype(np.float32),
    )


def simulate(
    scene: Scene,
    hypothesis: Hypothesis | None = None,
    *,
    goals: Mapping[str, str | int] | None = None,
    relation: Mapping[tuple[str, str], str] | None = None,
    strength: Mapping[str, float] | float = STRENGTH,
    frames: int = 101,
    seed: int = 0,
    planner: str | PlannerConfig = "fast",
    simulator: Simulator | None = None,
    id: str = "simulated",
    overlapping: bool = False,
) -> Event:
    """Return an event simulated under a hypothesis, with its truth and the agents' thoughts.

    Example:
        ``ppl.simulate(ppl.Scene(start, radius), ppl.Hypothesis("Get blue item to red lm",
        "get to red agent"))``; :func:`phase_ppl.explain` then says why the agents act as they do.
        In any world: ``ppl.simulate(scene, goals={"red agent": "ball to home"},
        relation={("purple agent", "red agent"): "hinder"})``.

    Args:
        scene: the start.
        hypothesis: goals, strengths, and who helps or hinders whom. ``goals``, ``relation`` and
            ``strength`` can take its place.
        goals: name of an agent -> its own goal, a string or an index into ``world.goals``, for
            every agent that neither helps nor hinders.
        relation: (name of an agent, name of the agent that it helps or hinders) -> "help" or
            "hinder"; the paper's alpha, not the relation that follows from two effective goals. By
            default nobody helps or hinders.
        strength: maximum force, newtons: name of an agent -> force, or one for all. Default: 450.
        frames: number of frames, 12 per simulated second; frame 0 is the start. Default: 101.
        seed: a whole number >= 0. The same seed gives the same event.
        planner: settings of the package's planner: "fast", "paper", "as_printed",
            "as_printed_fast" (:meth:`phase_ppl.PlannerConfig.named`) or a ``PlannerConfig``.
        simulator: a simulator in place of the package's; ``planner`` then has no effect. Unless it
            is a ``JointSimulator``, the event has no ``thoughts``.
        id: name of the event.
        overlapping: whether bodies may overlap by more than 0.25 units at the start, as in some
            real videos. They then fly apart.

    Raises:
        InvalidSettingError: there are fewer than 2 frames, or goals and relations do not fit.
        UnknownNameError: there is no such agent, goal or planner.
        InvalidEventError: bodies overlap at the start, or stick in a wall; the message says which
            and how deeply.
        SimulationError: the simulator failed.
    """
    instance_of("scene", scene, Scene, "a phase_ppl.Scene")
    if goals is not None:
        if hypothesis is not None:
            raise InvalidSettingError("both a hypothesis and goals are given, expected one of them")
        hypothesis = Hypothesis.of(scene.world, goals, relation, strength)
    elif relation is not None or strength != STRENGTH:
        raise InvalidSettingError("relation and strength go with goals=; a hypothesis has its own")
    instance_of("hypothesis", hypothesis, Hypothesis, "a phase_ppl.Hypothesis, or goals=")
    assert hypothesis is not None
    if hypothesis.world != scene.world:
        raise InvalidSettingError(
            f"the hypothesis is of the world {hypothesis.world.name}, the scene of "
            f"{scene.world.name}: give goals="
        )
    seed = whole_number("seed", seed, 0)
    frames = whole_number("frames", frames, MIN_FRAMES)
    check_memory(f"frames={frames}", _FRAME_BYTES * frames)
    what, depth = deepest_overlap(scene)
    if depth > _OVERLAP and not overlapping:
        raise InvalidEventError(
            f"{what} overlap by {depth:.2f} units at the start (allowed: {_OVERLAP:g}) and would "
            "fly apart; to simulate anyway: overlapping=True"
        )
    run = JointSimulator(planner) if simulator is None else simulator
    notes: list[tuple[Any, ...]] = []  # copied at each step, since beliefs change in place

    def noted(joint: JointSimulator, *given: Any) -> Iterator[NDArray[np.float64]]:
        for frame, decisions in joint.steps(*given):
            if decisions:
                notes.append(_thoughts(decisions, scene))
            yield frame

    source = functools.partial(noted, run) if type(run) is JointSimulator else run
    trajectory = simulate_trajectory(source, scene, hypothesis, seed, frames)
    thoughts = None
    if notes:
        subgoals, *others = zip(*notes, strict=True)
        thoughts = Thoughts(subgoals, *map(np.array, others))
    return Event(
        scene, Observation(trajectory), id=id, truth=Truth.of(hypothesis), thoughts=thoughts
    )
