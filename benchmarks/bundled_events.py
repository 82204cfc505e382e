"""Make the bundled events: simulate drawn scenes, and keep the first that shows its type.

    python benchmarks/bundled_events.py FOLDER

Collaborative and independent events show it by goals reached, competing ones by both agents
holding the item, opposing ones by agents that meet again and again.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np

import phase_ppl as ppl
from phase_ppl.world.goals import goal_literal, is_true

STILL_FRAMES = 8
CENTRE = (16.0, 12.0)
LAYOUTS = {
    "collaborate": [(16.0, 22.0), (11.0, 12.0), (16.0, 7.0)],
    "independent": [(16.0, 22.0), (8.5, 12.0), (21.0, 12.0)],
    "compete": [(16.0, 22.0), (11.0, 12.0), (16.0, 7.0), (21.0, 12.0)],
    "oppose": [(16.0, 22.0), (11.0, 12.0), (16.0, 4.5)],
}
SPOTS = np.array([[8, 20], [8, 14], [14, 16], [24, 20], [24, 14], [18, 16], [24, 10], [24, 4],
                  [18, 8], [18, 4], [8, 10], [8, 4], [14, 8], [14, 4]], float)  # fmt: skip
ITEM_GOALS = [g for g in ppl.GOALS if "item to" in g]


def draw(kind: str, rng: np.random.Generator) -> tuple[ppl.Scene, ppl.Hypothesis]:
    """Return a scene and a hypothesis of one type."""
    spots = SPOTS[rng.choice(len(SPOTS), 4, replace=False)]
    angles = np.concatenate([rng.uniform(-np.pi, np.pi, 2).round(2), [0.0, 0.0]])
    radius = [0.8, rng.choice([0.8, 1.01]), rng.choice([0.8, 1.01]), rng.choice([0.8, 1.2])]
    walls = [[CENTRE, end] for end in LAYOUTS[kind]]
    scene = ppl.Scene(start=np.column_stack([spots, angles]), radius=radius, walls=walls)
    item = str(rng.choice(["blue item", "pink item"]))
    first, second = rng.choice(["blue lm", "green lm", "red lm", "yellow lm"], 2, replace=False)
    if kind == "collaborate":
        goals = (f"Get {item} to {first}",) * 2
    elif kind == "compete":
        goals = (f"Get {item} to {first}", f"Get {item} to {second}")
    elif kind == "independent":
        goals = (f"Get {item} to {first}", f"Get green agent to {second}")
    else:
        goals = ("get to green agent", "get away from red agent")
    strengths = rng.choice([300.0, 450.0, 600.0], 2)
    return scene, ppl.Hypothesis(*goals, strength_red=strengths[0], strength_green=strengths[1])


def reached(event: ppl.Event, hypothesis: ppl.Hypothesis, frame: int) -> list[bool]:
    """Return whether each agent's goal holds in a frame."""
    poses = event.observation.trajectory[frame]
    literals = (goal_literal(g, agent) for agent, g in enumerate(hypothesis.effective_goals))
    return [is_true(literal, poses, event.scene) for literal in literals]


def gap(event: ppl.Event, first: int, second: int) -> np.ndarray:
    """Return the distance of two entities in each frame, less their sizes."""
    p = event.observation.positions
    sizes = event.scene.radius[first] + event.scene.radius[second]
    return np.linalg.norm(p[:, first] - p[:, second], axis=1) - sizes


def shows(kind: str, event: ppl.Event, hypothesis: ppl.Hypothesis) -> bool:
    """Whether an event shows what its type says."""
    if kind == "oppose":
        apart = gap(event, 0, 1)
        meetings = np.sum((apart[1:] < 0.6) & (apart[:-1] >= 0.6))
        return bool(apart[0] > 8 and meetings >= 2 and apart[20:].max() > 4)
    if any(reached(event, hypothesis, 0)):
        return False
    item = goal_literal(hypothesis.effective_goals[0], 0).subject
    together = (gap(event, 0, item) < 0.8) & (gap(event, 1, item) < 0.8)
    if kind == "compete":
        return bool(together.sum() >= 20)
    done = all(reached(event, hypothesis, -1))
    return done and (kind == "independent" or bool(together.sum() >= 6))


def trim(event: ppl.Event, kind: str) -> ppl.Event:
    """Cut an event a little after the last movement."""
    moved = np.abs(np.diff(event.observation.positions, axis=0)).max(axis=(1, 2)) > 0.05
    last = int(np.flatnonzero(moved).max()) + 1 + STILL_FRAMES
    trajectory = event.observation.trajectory[: last + 1].round(4)
    return dataclasses.replace(event, id=kind, observation=ppl.Observation(trajectory))


def make(kind: str) -> tuple[ppl.Event, int]:
    """Return the first drawn event that shows its type, and the number of draws."""
    frames = 60 if kind == "collaborate" else 90
    for seed in range(10_000):
        scene, hypothesis = draw(kind, np.random.default_rng([seed, list(LAYOUTS).index(kind)]))
        event = ppl.simulate(scene, hypothesis, frames=frames, seed=seed, planner="paper", id=kind)
        if shows(kind, event, hypothesis):
            event = trim(event, kind)
            if 30 <= event.observation.n_frames <= 90:
                return event, seed + 1
    raise RuntimeError(f"no draw shows {kind}")


def main(folder: Path) -> None:
    for kind in LAYOUTS:
        event, draws = make(kind)
        ppl.save_event(event, folder / f"{kind}.json")
        print(kind, event.truth.scenario, event.observation.n_frames, "frames,", draws, "draws")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
