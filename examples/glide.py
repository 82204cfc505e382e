"""A fast simulator (a millisecond), which the kernel examples use.

python examples/glide.py

Agents and items glide straight to their targets. Stronger agents are faster.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

import phase_ppl as ppl

ENTITIES = (*ppl.AGENTS, "blue item", "pink item")
LANDMARKS = ("blue lm", "green lm", "red lm", "yellow lm")


def glide(
    scene: ppl.Scene, hypothesis: ppl.Hypothesis, rng: np.random.Generator
) -> Iterator[np.ndarray]:
    frame = scene.start.copy()
    while True:
        yield frame.copy()
        for agent, code in enumerate(hypothesis.effective_goals):
            goal = ppl.GOALS[code]
            sign = -1 if "away from" in goal else 1
            last = " ".join(goal.split()[-2:])
            moved = agent if goal.startswith("get") else ENTITIES.index(" ".join(goal.split()[1:3]))
            target = (
                scene.landmark_centres[LANDMARKS.index(last)]
                if last in LANDMARKS
                else frame[ENTITIES.index(last), :2]
            )
            way = target - frame[moved, :2]
            step = sign * hypothesis.strengths[agent] / 2000 * way / max(np.linalg.norm(way), 1.0)
            frame[moved, :2] = np.clip(frame[moved, :2] + step, 2, 26)
        frame[:, :2] += rng.normal(0, 0.02, (4, 2))


MODEL = ppl.Model(
    simulator=glide, likelihood=ppl.RadialLikelihood(beta=0.3)
)  # less noise than usual


def seen(hypothesis: ppl.Hypothesis, frames: int = 12, start: str = "collaborate") -> ppl.Event:
    """Return a simulated event under a hypothesis, in the scene of a bundled event."""
    scene = ppl.load_event(start).scene
    run = itertools.islice(glide(scene, hypothesis, np.random.default_rng(0)), frames)
    red, green = (ppl.GOALS[code] for code in hypothesis.effective_goals)
    return ppl.Event(scene, ppl.Observation(np.stack(list(run))), "glide", ppl.Truth(red, green))


if __name__ == "__main__":
    event = seen(ppl.Hypothesis("Get blue item to blue lm", "Get green agent to red lm"))
    print(event)
    print(event.observation.positions[[0, -1]].round(1))
