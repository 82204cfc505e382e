"""Open loop: the recovered actions of the real agents through our physics."""

from __future__ import annotations

import argparse
from typing import Any

import common
import numpy as np
from numpy.typing import NDArray

from phase_ppl.physics import compiled
from phase_ppl.physics.actions import ACTION_NAMES
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.scene import Scene

ROWS = (5, 10, 20)


def scene_of(video: dict[str, Any]) -> Scene:
    """Return the scene of a replay, in the frame of the original recording."""
    angles = [*video["start_angle"], 0.0, 0.0]
    return Scene(
        np.column_stack([video["start_position"], angles]),
        video["radius"],
        np.array(video["walls"], np.float64).reshape(-1, 2, 2),
        turning="ccw",
    )


def actions_of(video: dict[str, Any]) -> list[tuple[int, int]]:
    """Return the actions of (red, green) per planner step, as far as they are exact."""
    steps = video["actions"][: video["exact_rows"]]
    return [(ACTION_NAMES.index(red), ACTION_NAMES.index(green)) for red, green in steps]


def pymunk_frames(video: dict[str, Any], inner_steps: int) -> NDArray[np.float64]:
    world = PymunkWorld(scene_of(video), tuple(video["strength_newton"]), inner_steps)
    return np.array([world.step(pair)[:, :2] for pair in actions_of(video)])


def compiled_frames(video: dict[str, Any], inner_steps: int) -> NDArray[np.float64]:
    scene = scene_of(video)
    strengths = tuple(video["strength_newton"])
    state = PymunkWorld(scene, strengths, 4).state  # after the empty first substep
    bodies, held, weld = compiled.from_state(state, scene.radius)
    params = compiled.make_params(scene, strengths, inner_steps)
    scratch = compiled.make_scratch()
    frames = np.empty((len(actions_of(video)), 4, 3))
    for frame, (red, green) in zip(frames, actions_of(video), strict=True):
        compiled.step_mean(bodies, held, weld, np.array([red, green]), params, scratch, frame)
    return frames[..., :2]


ENGINES = {
    "pymunk": (pymunk_frames, 4),
    "compiled_4": (compiled_frames, 4),
    "compiled_1": (compiled_frames, 1),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    del parser


def main(options: argparse.Namespace) -> dict[str, Any]:
    del options
    report: dict[str, Any] = {}
    print(
        f"{'median over videos of the largest error of an entity':44} " + "row 5   row 10  row 20"
    )
    for name, (frames_of, inner_steps) in ENGINES.items():
        errors = []
        for video in common.replays():
            frames = frames_of(video, inner_steps)
            errors.append(
                np.linalg.norm(frames - np.array(video["rows"][1 : len(frames) + 1]), axis=2).max(1)
            )
        medians = {
            f"median_error_row{row}": float(
                np.median([e[row - 1] for e in errors if len(e) >= row])
            )
            for row in ROWS
        }
        print(f"{name:44} " + "  ".join(f"{value:.4f}" for value in medians.values()))
        report[name] = medians | {"inner_steps": inner_steps}
    return report | {k: v for k, v in report["pymunk"].items() if k.startswith("median")}
