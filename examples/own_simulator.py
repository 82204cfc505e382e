"""A simulator of one's own in fifteen lines: agents and items glide straight to where they should.

    python examples/own_simulator.py [--quick]

A simulator is a generator of frames (entity, coord) of x, y, angle, the start first; nothing needs
a gradient. This one takes milliseconds. Prints the posterior of a bundled event under it and draws
own_simulator.png. --quick makes fewer simulations.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

import phase_ppl as ppl

ENTITIES = ("red agent", "green agent", "blue item", "pink item")
LANDMARKS = ("blue lm", "green lm", "red lm", "yellow lm")


def glide(
    scene: ppl.Scene, hypothesis: ppl.Hypothesis, rng: np.random.Generator
) -> Iterator[np.ndarray]:
    """Move what each goal is about, at a speed that grows with the agent's strength."""
    frame, (x0, x1, y0, y1) = scene.start.copy(), scene.arena
    while True:
        yield frame.copy()
        for agent, code in enumerate(hypothesis.effective_goals):
            goal = ppl.GOALS[code]
            sign = -1 if "away from" in goal else 1
            last = " ".join(goal.split()[-2:])
            moved = agent if goal.startswith("get") else ENTITIES.index(" ".join(goal.split()[1:3]))
            target = (scene.landmark_centres[LANDMARKS.index(last)] if last in LANDMARKS
                      else frame[ENTITIES.index(last), :2])  # fmt: skip
            way = target - frame[moved, :2]
            step = sign * hypothesis.strengths[agent] / 2000 * way / max(np.linalg.norm(way), 1.0)
            frame[moved, :2] += step + rng.normal(0, 0.02, 2)
            frame[moved, :2] = np.clip(frame[moved, :2], (x0 + 1, y0 + 1), (x1 - 1, y1 - 1))


def main(quick: bool) -> None:
    event = ppl.load_event("independent")
    budget = ppl.simulations(60 if quick else 3000)
    # simulations of milliseconds are not worth sending to other processes
    post = ppl.infer(event, ppl.Model(simulator=glide), seed=0, budget=budget, workers=1)
    print(post)
    ppl.plot.posterior(post, path="own_simulator.png")
    print("\nDrawn: own_simulator.png")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="fewer simulations")
    main(**vars(options.parse_args()))
