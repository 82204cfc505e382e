"""The joint physical-social simulator G(h) (paper, Algorithm 1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.agent import Decision, both_agents
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import NO_ACTION, Action, executed
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.simulator.contract import Simulator, simulate_trajectory
from phase_ppl.world.checks import check_memory, instance_of, nonnegative_number, whole_number
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.geometry import CENTRE_OF_MASS_Y, deepest_overlap
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import AGENTS, ENTITIES, ITEMS
from phase_ppl.world.observation import MIN_FRAMES, Observation, State
from phase_ppl.world.scene import Scene
from phase_ppl.world.thoughts import Thoughts


@dataclasses.dataclass(frozen=True)
class DynamicsNoise:
    """Noise on the dynamics: after each step every body's velocity is off at random.

    The agents know nothing of it: they imagine the dynamics without.

    Attributes:
        speed: standard deviation of the log of the factor on the speed, per step of 1/12 s.
        direction: standard deviation of the turn of the direction of motion, rad per step.

    Raises:
        InvalidSettingError: one of them is negative or no finite number.
    """

    speed: float = 0.2
    direction: float = 0.2

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            nonnegative_number(f"noise of {name}", value)

    def disturb(self, world: PymunkWorld, rng: np.random.Generator) -> None:
        """Change the velocities of a world's bodies."""
        n = len(ENTITIES)
        factors = np.exp(self.speed * rng.standard_normal(n))
        world.deflect(factors, self.direction * rng.standard_normal(n))


class Past(NamedTuple):
    """What happened before a simulation goes on.

    Attributes:
        states: of the world at every frame, from the start to the one it goes on from.
        actions: of (red, green) between these, as intended.
    """

    states: Sequence[State]
    actions: Sequence[tuple[Action, Action]]


class JointSimulator:
    """Two agents with limited views that believe, plan and push each other about.

    Args:
        planner: "fast", "paper" or a :class:`PlannerConfig`.
        inner_steps: solver steps per physics substep of the world.
        noise: on the dynamics; None: they are exact.
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
        """Return what determines the simulations, as plain data."""
        return {
            "planner": self.planner.to_dict(),
            "inner_steps": self.inner_steps,
            "noise": None if self.noise is None else dataclasses.asdict(self.noise),
        }

    def warm_up(self) -> None:
        """Compile what simulating needs, or load it from the cache on disk."""
        run_briefly(JointSimulator(dataclasses.replace(self.planner, simulations=2)))

    def __call__(
        self, scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
    ) -> Iterator[NDArray[np.float64]]:
        """Yield frames (4, 3) = x, y [units], angle [rad] per entity, the start first."""
        for frame, _ in self.steps(scene, hypothesis, rng):
            yield frame

    def steps(
        self,
        scene: Scene,
        hypothesis: Hypothesis,
        rng: np.random.Generator,
        past: Past | None = None,
        removed: Collection[int] = (),
    ) -> Iterator[tuple[NDArray[np.float64], tuple[Decision, ...]]]:
        """Yield each frame with the decisions of (red, green) behind it; the first has none.

        Args:
            scene, hypothesis, rng: as of any simulator.
            past: what happened before, if it does not begin at the scene's start.
            removed: entities that are there no more; agents among them decide nothing. The others
                know of it only what they see.
        """
        strengths = hypothesis.strengths
        model = WorldModel.of(scene, strengths, self.planner)
        agents = both_agents(hypothesis.effective_goals, model, self.planner, rng)
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
            yield world.step((doing[0], doing[1])), decisions
            if self.noise is not None:
                self.noise.disturb(world, disturbing)


def run_briefly(simulator: Simulator) -> None:
    """Take a few frames from a simulator, so that what it needs is compiled."""
    spots = [[8.0, 20.0, 0.0], [24.0, 20.0, 0.0], [24.0, 4.0, 0.0], [8.0, 4.0, 0.0]]
    scene = Scene(start=np.array(spots), radius=np.full(4, 0.8))
    hypothesis = Hypothesis("Get blue item to red lm", "Get red agent to red lm")  # type: ignore[arg-type]
    frames = iter(simulator(scene, hypothesis, np.random.default_rng(0)))
    for _ in range(3):
        next(frames)


_FRAME_BYTES: Final = 10_000
"""Of memory, with what the agents thought."""

_OVERLAP: Final = 0.25
"""Units by which bodies may overlap at the start; the world moves them apart."""


class _Thinking:
    """The joint simulator, with a note of what the agents think."""

    def __init__(self, simulator: JointSimulator) -> None:
        self._simulator = simulator
        self._notes: list[tuple[Any, ...]] = []

    def __call__(
        self, scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
    ) -> Iterator[NDArray[np.float64]]:
        offsets = np.array([CENTRE_OF_MASS_Y] * len(AGENTS) + [0.0] * len(ITEMS)) * scene.radius
        for frame, pair in self._simulator.steps(scene, hypothesis, rng):
            if pair:  # beliefs change in place
                poses = np.stack([one.beliefs.bodies[..., :3] for one in pair])
                poses[..., 0] += np.sin(poses[..., 2]) * offsets
                poses[..., 1] -= np.cos(poses[..., 2]) * offsets
                self._notes.append(
                    (
                        tuple(one.intent.subgoal for one in pair),
                        [int(one.action) for one in pair],
                        [len(one.intent.agreeing) / poses.shape[1] for one in pair],
                        np.stack([one.beliefs.observed for one in pair]),
                        [one.held for one in pair],
                        poses.astype(np.float32),
                    )
                )
            yield frame

    def thoughts(self) -> Thoughts:
        """Return what was noted."""
        subgoals, *others = zip(*self._notes, strict=True)
        return Thoughts(subgoals, *map(np.array, others))


def simulate(
    scene: Scene,
    hypothesis: Hypothesis,
    *,
    frames: int = 101,
    seed: int = 0,
    planner: str | PlannerConfig = "fast",
    simulator: Simulator | None = None,
    id: str = "simulated",
    overlapping: bool = False,
) -> Event:
    """Simulate an event under a hypothesis; it carries its truth and what the agents thought.

    Example:
        ``ppl.simulate(ppl.Scene(start, radius), ppl.Hypothesis("Get blue item to red lm",
        "get to red agent"))``, and :func:`phase_ppl.explain` says why they do what they do.

    Args:
        scene: where it starts.
        hypothesis: who wants what.
        frames: length of the trajectory, 12 per simulated second; frame 0 is the start.
        seed: the same seed gives the same event.
        planner: "fast", "paper" or a ``PlannerConfig``; only for the joint simulator.
        simulator: another simulator than the joint one; of one that is no ``JointSimulator`` the
            event has no ``thoughts``.
        id: name of the event.
        overlapping: whether bodies may overlap at the start, as they do in some real videos; they
            then fly apart.

    Raises:
        InvalidSettingError: fewer than 2 frames.
        InvalidEventError: bodies overlap at the start, or stick in a wall; the message says which
            and how far.
        SimulationError: the simulator failed.
    """
    instance_of("scene", scene, Scene, "a phase_ppl.Scene")
    instance_of("hypothesis", hypothesis, Hypothesis, "a phase_ppl.Hypothesis")
    seed = whole_number("seed", seed, 0)
    frames = whole_number("frames", frames, MIN_FRAMES)
    check_memory(f"frames={frames}", _FRAME_BYTES * frames)
    what, depth = deepest_overlap(scene)
    if depth > _OVERLAP and not overlapping:
        raise InvalidEventError(
            f"{what} overlap by {depth:.2f} units at the start, {_OVERLAP:g} at most: they would "
            "fly apart; overlapping=True simulates it all the same"
        )
    run = JointSimulator(planner) if simulator is None else simulator
    thinking = _Thinking(run) if type(run) is JointSimulator else None
    trajectory = simulate_trajectory(thinking or run, scene, hypothesis, seed, frames)
    red, green = hypothesis.effective_goals
    truth = Truth(
        GOALS[red],
        GOALS[green],
        strength_red=hypothesis.strength_red,
        strength_green=hypothesis.strength_green,
    )
    thoughts = None if thinking is None else thinking.thoughts()
    return Event(scene, Observation(trajectory), id=id, truth=truth, thoughts=thoughts)
