"""Copies of a recording that look different and mean the same: reflections, other colours.

Landmarks keep their places and colours, so under a reflection a goal is about another landmark;
agents that turn one way only turn the other way.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.dataset.generation.situation import Situation
from phase_ppl.dataset.motion import last_motion
from phase_ppl.physics.actions import NO_ACTION, Action
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.goals import goal_literal, literal_goal
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import AGENTS, BLUE_ITEM, ENTITIES, LANDMARKS, NOTHING, Predicate
from phase_ppl.world.scene import Scene, Turning

AFTER_MOTION: Final = 8
"""Frames kept after the last motion, as in the original recordings: 2 s of video."""

SHORTEST: Final = 33  # frames that are always kept: the shortest original recording


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """A simulated situation."""

    scene: Scene  # what was known at the start
    hypothesis: Hypothesis  # stated goals, alpha, strengths
    layout: int  # number of the layout, before any reflection
    trajectory: FloatArray  # (time, entity, coord) x, y [units], angle [rad]
    # (time, agent) action that led to the frame, ``NO_ACTION`` at the start
    actions: NDArray[np.int64]
    held: NDArray[np.int64]  # (time, agent) item held when that action was chosen, or ``NOTHING``


def record(situation: Situation, simulator: JointSimulator, frames: int, seed: int) -> Recording:
    """Simulate a situation for ``frames``, 12 per simulated second; cut after the last motion."""
    steps = simulator.steps(situation.scene, situation.hypothesis, np.random.default_rng(seed))
    taken = list(itertools.islice(steps, frames))
    trajectory = np.array([frame for frame, _ in taken], np.float64)
    actions = np.full((frames, len(AGENTS)), NO_ACTION, np.int64)
    held = np.full((frames, len(AGENTS)), NOTHING, np.int64)
    for frame, (_, decisions) in enumerate(taken):
        for agent, decision in enumerate(decisions):
            actions[frame, agent], held[frame, agent] = decision.action, decision.held
    length = after_motion(trajectory)
    return Recording(
        situation.scene,
        situation.hypothesis,
        situation.layout,
        trajectory[:length],
        actions[:length],
        held[:length],
    )


def after_motion(trajectory: FloatArray) -> int:
    """Return how many frames of a (time, entity, coord) trajectory to keep."""
    return min(len(trajectory), max(SHORTEST, last_motion(trajectory) + 1 + AFTER_MOTION))


# --- reflections and colours -----------------------------------------------------------------


class Reflection(NamedTuple):
    """A reflection of the arena about a line through its centre."""

    matrix: FloatArray  # (2, 2) of offsets from the centre
    offset: float  # angle a becomes ``offset`` - a, rad


REFLECTIONS: Final = {
    "up-down": Reflection(np.array([[1.0, 0.0], [0.0, -1.0]]), np.pi),
    "left-right": Reflection(np.array([[-1.0, 0.0], [0.0, 1.0]]), 0.0),
    "about y=x": Reflection(np.array([[0.0, 1.0], [1.0, 0.0]]), -np.pi / 2),
    "about y=-x": Reflection(np.array([[0.0, -1.0], [-1.0, 0.0]]), np.pi / 2),
}
"""Name -> reflection; the names are those of the authors' files."""

_IN_A_MIRROR: Final = (
    (Action.TURN_LEFT, Action.TURN_RIGHT),
    (Action.LEFT, Action.RIGHT),
    (Action.UP_LEFT, Action.UP_RIGHT),
    (Action.DOWN_LEFT, Action.DOWN_RIGHT),
)
"""Actions that look like each other in a mirror; all others look like themselves."""

_OTHER_WAY: Final[dict[str, Turning]] = {"both": "both", "ccw": "cw", "cw": "ccw"}


def reflected(recording: Recording, name: str) -> Recording:
    """Return the recording seen in a mirror."""
    matrix, offset = REFLECTIONS[name]
    scene = recording.scene
    centres = scene.centre + (scene.landmark_centres - scene.centre) @ matrix.T
    landmark = [
        int(np.linalg.norm(scene.landmark_centres - centre, axis=1).argmin()) for centre in centres
    ]
    actions = np.array(recording.actions)
    for left, right in _IN_A_MIRROR:
        actions[recording.actions == left] = right
        actions[recording.actions == right] = left
    mirrored = dataclasses.replace(
        scene,
        start=_mirrored(scene.start, scene, matrix, offset),
        walls=scene.centre + (scene.walls - scene.centre) @ matrix.T,
        turning=_OTHER_WAY[scene.turning],
    )
    return dataclasses.replace(
        recording,
        scene=mirrored,
        hypothesis=_renamed(recording.hypothesis, list(range(len(ENTITIES))), landmark),
        trajectory=_mirrored(recording.trajectory, scene, matrix, offset),
        actions=actions,
    )


def _mirrored(poses: FloatArray, scene: Scene, matrix: FloatArray, offset: float) -> FloatArray:
    result = np.array(poses)
    result[..., :2] = scene.centre + (poses[..., :2] - scene.centre) @ matrix.T
    result[..., : len(AGENTS), 2] = offset - poses[..., : len(AGENTS), 2]
    result[..., len(AGENTS) :, 2] = -poses[..., len(AGENTS) :, 2]
    return result


def recoloured(recording: Recording, *, agents: bool, items: bool) -> Recording:
    """Return the recording with the colours of the agents, of the items or of both exchanged."""
    order = list(range(len(ENTITIES)))
    for swap, first in ((agents, 0), (items, BLUE_ITEM)):
        if swap:
            order[first], order[first + 1] = order[first + 1], order[first]
    agent_order = order[: len(AGENTS)]
    scene = recording.scene
    held = recording.held[:, agent_order]
    return dataclasses.replace(
        recording,
        scene=dataclasses.replace(scene, start=scene.start[order], radius=scene.radius[order]),
        hypothesis=_renamed(recording.hypothesis, order, list(range(len(LANDMARKS)))),
        trajectory=recording.trajectory[:, order],
        actions=recording.actions[:, agent_order],
        held=np.where(held >= 0, np.array(order)[held], held),
    )


def _renamed(hypothesis: Hypothesis, entity: list[int], landmark: list[int]) -> Hypothesis:
    """Return the hypothesis with other entities (entity -> entity, in pairs) and landmarks."""
    goals, alpha, strengths = [0, 0], [0, 0], [0.0, 0.0]
    for agent, goal in enumerate((hypothesis.goal_red, hypothesis.goal_green)):
        literal = goal_literal(goal, agent)
        target = literal.target
        about_agent = literal.predicate is Predicate.TOUCH
        goals[entity[agent]] = literal_goal(
            literal._replace(
                subject=entity[literal.subject],
                target=entity[target] if about_agent else landmark[target],
            )
        )
        alpha[entity[agent]] = hypothesis.alpha[agent]
        strengths[entity[agent]] = hypothesis.strengths[agent]
    return Hypothesis(goals[0], goals[1], (alpha[0], alpha[1]), *strengths)
