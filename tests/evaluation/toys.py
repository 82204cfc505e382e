"""Events of a few frames, and models of a few lines."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import phase_ppl as ppl
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.scene import Scene

START = np.array([[8.0, 12.0, 0.0], [24.0, 12.0, 0.0], [12.0, 12.0, 0.0], [20.0, 12.0, 0.0]])
RED_TO_RED = "Get red agent to red lm"
GREEN_TO_RED = "Get green agent to red lm"


def still(id: str = "still", n_frames: int = 3, shift: float = 0.0, **more: Any) -> Event:
    """Return an event in which nothing moves; ``shift`` tells one from another."""
    start = START + np.array([shift, 0.0, 0.0])
    scene = Scene(start=start, radius=np.full(4, 0.8))
    trajectory = np.repeat(start[None], n_frames, axis=0)
    given = {"truth": Truth(RED_TO_RED, GREEN_TO_RED), **more}
    return Event(scene, Observation(trajectory), id=id, **given)


def several(n: int = 4) -> list[Event]:
    """Return different events of 3, 4, ... frames, called a, b, ..."""
    return [still(chr(ord("a") + i), 3 + i, shift=0.1 * i) for i in range(n)]


def right(scene: Scene, observation: Observation, seed: int) -> Mapping[str, Any]:
    """Say what is true of all these events, surely."""
    return {"goal_red": RED_TO_RED, "goal_green": GREEN_TO_RED, "relation": "neutral"}


def wrong(scene: Scene, observation: Observation, seed: int) -> Mapping[str, Any]:
    return {"goal_red": GREEN_TO_RED, "relation": "friendly"}


def guesses(scene: Scene, observation: Observation, seed: int) -> Mapping[str, Any]:
    rng = np.random.default_rng(seed)
    return {"goal_red": rng.dirichlet(np.ones(36)), "relation": rng.dirichlet(np.ones(3))}


class Counted:
    """Leaves a file for every call, also in other processes; names are numbers of frames."""

    def __init__(self, folder: Path, does: Any = right) -> None:
        folder.mkdir(exist_ok=True)
        self.folder, self.does = folder, does

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Any:
        n = observation.n_frames
        name = f"{n}-{len(list(self.folder.glob(f'{n}-*')))}-{os.getpid()}"
        (self.folder / name).touch()
        return self.does(scene, observation, seed)

    def calls(self) -> dict[int, int]:
        """Return number of frames -> calls."""
        names = [int(path.name.split("-")[0]) for path in self.folder.iterdir()]
        return {n: names.count(n) for n in sorted(names)}


class FailsAt:
    """Right, but for events of so many frames, at which it does something else."""

    def __init__(self, n_frames: int, does: Any) -> None:
        self.n_frames, self.does = n_frames, does

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Any:
        if observation.n_frames == self.n_frames:
            return self.does()
        return right(scene, observation, seed)


EVENTS = several(4)


def evaluate(events: Any = EVENTS, model: Any = right, **more: Any) -> ppl.Evaluation:
    return ppl.evaluate(events, model, **{"workers": 1, "progress": False, **more})


def changed(file: Path, **fields: Any) -> None:
    file.write_text(json.dumps({**json.loads(file.read_text()), **fields}))


def raises() -> Any:
    """Fail, with a message of two lines."""
    raise ValueError("not\ntoday")
