"""What can be seen in a recording: the facts that decide whether it is kept."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.dataset.generation.recording import Recording
from phase_ppl.physics.actions import DIRECTIONS
from phase_ppl.world.geometry import is_on, touches
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.literals import Literal, Predicate
from phase_ppl.world.names import AGENTS, BLUE_ITEM, ENTITIES, ITEMS

STILL: Final = 0.02
"""Units per frame that an agent must move by for its push to count as having an effect."""

PUSHES: Final = tuple(int(action) for action in np.flatnonzero(DIRECTIONS.any(axis=1)))
"""Actions that push."""


def measures(recording: Recording) -> dict[str, Any]:
    """Return facts about a recording, as plain numbers and lists.

    Keys; those in brackets are lists over agents, red first:

    * ``frames``.
    * ``at_start``, ``ever``, ``at_end`` [agent]: whether its effective goal is true then.
    * ``closest``: least distance between the agents, in units of the sum of their sizes.
    * ``met``: frames in which the agents touch.
    * ``touched`` [agent]: items that it touched.
    * ``held`` [agent]: share of frames in which it holds something.
    * ``moved`` [entity]: length of its way, units.
    * ``stuck`` [agent]: longest run of frames in which it pushes and nothing moves.
    """
    track, scene = recording.trajectory, recording.scene
    goals = recording.hypothesis.effective_goals
    literals = [goal_literal(goal, agent) for agent, goal in enumerate(goals)]
    truth = np.array([[_is_true(lit, frame, recording) for lit in literals] for frame in track])
    apart = np.linalg.norm(track[:, 0, :2] - track[:, 1, :2], axis=1) / scene.radius[:2].sum()
    items = range(BLUE_ITEM, BLUE_ITEM + len(ITEMS))
    touched = [
        [ENTITIES[item] for item in items
         if any(touches(agent, item, frame, scene.radius) for frame in track)]
        for agent in range(len(AGENTS))
    ]  # fmt: skip
    steps = np.linalg.norm(np.diff(track[..., :2], axis=0), axis=2)
    return {
        "frames": len(track),
        "at_start": truth[0].tolist(),
        "ever": truth.any(axis=0).tolist(),
        "at_end": truth[-1].tolist(),
        "closest": float(apart.min()),
        "met": sum(touches(0, 1, frame, scene.radius) for frame in track),
        "touched": touched,
        "held": (recording.held >= 0).mean(axis=0).tolist(),
        "moved": steps.sum(axis=0).tolist(),
        "stuck": [
            longest_run(np.isin(recording.actions[1:, agent], PUSHES) & (steps[:, agent] < STILL))
            for agent in range(len(AGENTS))
        ],
    }


def _is_true(literal: Literal, frame: NDArray[np.float64], recording: Recording) -> bool:
    scene = recording.scene
    if literal.predicate is Predicate.TOUCH:
        holds = touches(literal.subject, literal.target, frame, scene.radius)
    else:
        centre = scene.landmark_centres[literal.target]
        holds = is_on(frame[literal.subject, :2], centre, scene.landmark_half_width)
    return holds is literal.positive


def longest_run(flags: NDArray[np.bool_]) -> int:
    """Return the length of the longest run of true values."""
    padded = np.concatenate([[False], flags, [False]]).astype(np.int8)
    edges = np.flatnonzero(np.diff(padded))
    return int((edges[1::2] - edges[::2]).max(initial=0))
