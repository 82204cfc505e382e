"""Tiny simulators, each with one habit; workers import them from here."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene


def drifting(
    scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
) -> Iterator[np.ndarray]:
    """Random walks whose step grows with the red agent's strength."""
    frame = scene.start.copy()
    while True:
        yield frame.copy()
        frame[:, :2] += rng.normal(0, hypothesis.strength_red / 1000, (4, 2))


def still(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[np.ndarray]:
    while True:
        yield scene.start


def broken(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[np.ndarray]:
    yield scene.start
    raise ZeroDivisionError("no such luck")


def not_a_number(
    scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
) -> Iterator[np.ndarray]:
    yield scene.start
    yield np.full((4, 3), np.nan)


def short(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[np.ndarray]:
    yield scene.start


def flat(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[np.ndarray]:
    yield np.zeros(12)


def sleepy(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[np.ndarray]:
    while True:
        time.sleep(0.5)
        yield scene.start


class Closable:
    """Notes in a file when it is closed."""

    def __init__(self, note: Path) -> None:
        self.note = note

    def __call__(
        self, scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
    ) -> Iterator[np.ndarray]:
        try:
            while True:
                yield scene.start + 1.0
        finally:
            self.note.write_text("closed")


class Deadly:
    """Kills its process the first ``times`` times that the red agent is strong."""

    def __init__(self, folder: Path, times: int) -> None:
        self.folder, self.times = folder, times

    def __call__(
        self, scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
    ) -> Iterator[np.ndarray]:
        deaths = len(list(self.folder.glob("death-*")))
        if hypothesis.strength_red == 600 and deaths < self.times:
            (self.folder / f"death-{deaths}").touch()
            os._exit(9)
        yield from still(scene, hypothesis, rng)
