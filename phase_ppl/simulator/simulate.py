"""Running a simulator forward: a hypothesis becomes an event."""

from __future__ import annotations

from typing import Final

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.simulator.contract import Simulator, simulate_trajectory
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.checks import check_memory, instance_of, whole_number
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.observation import MIN_FRAMES, Observation
from phase_ppl.world.scene import Scene

_FRAME_BYTES: Final = 300
"""Of memory, until the event is written."""


def simulate(
    scene: Scene,
    hypothesis: Hypothesis,
    *,
    frames: int = 101,
    seed: int = 0,
    planner: str | PlannerConfig = "fast",
    simulator: Simulator | None = None,
    id: str = "simulated",
) -> Event:
    """Simulate an event under a hypothesis; it carries its truth.

    Args:
        scene: where it starts.
        hypothesis: who wants what.
        frames: length of the trajectory, 12 per simulated second; frame 0 is the start.
        seed: the same seed gives the same event.
        planner: "fast", "paper" or a ``PlannerConfig``; only for the joint simulator.
        simulator: another simulator than the joint one.
        id: name of the event.

    Raises:
        InvalidSettingError: fewer than 2 frames.
        SimulationError: the simulator failed.
    """
    instance_of("scene", scene, Scene, "a phase_ppl.Scene")
    instance_of("hypothesis", hypothesis, Hypothesis, "a phase_ppl.Hypothesis")
    seed = whole_number("seed", seed, 0)
    frames = whole_number("frames", frames, MIN_FRAMES)
    check_memory(f"frames={frames}", _FRAME_BYTES * frames)
    run = JointSimulator(planner) if simulator is None else simulator
    trajectory = simulate_trajectory(run, scene, hypothesis, seed, frames)
    red, green = hypothesis.effective_goals
    truth = Truth(
        GOALS[red],
        GOALS[green],
        strength_red=hypothesis.strength_red,
        strength_green=hypothesis.strength_green,
    )
    return Event(scene, Observation(trajectory), id=id, truth=truth)
