"""Simulators of a few lines, good and bad, and a scene to run them in."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phase_ppl.simulator.runner import Runner
from phase_ppl.world.event import Observation
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene

Frame = NDArray[np.float64]

START = np.array([[8.0, 20.0, 0.0], [24.0, 14.0, 1.0], [12.0, 8.0, 0.0], [20.0, 8.0, 0.0]])
SCENE = Scene(start=START, radius=np.full(4, 0.8))
N_FRAMES = 8
AT_REST = Observation(np.repeat(START[None], N_FRAMES, axis=0))

GO = Hypothesis("Get red agent to red lm", "Get green agent to blue lm")
HELP = Hypothesis("Get red agent to red lm", "Get green agent to blue lm", alpha=(0, 1))
WEAK = Hypothesis("Get red agent to red lm", "Get green agent to blue lm", strength_red=150.0)


def wait_until(fact: Callable[[], Any], patience: float = 100.0) -> None:
    """Wait for what comes soon, or late where the machine has other things to do."""
    latest = time.monotonic() + patience
    while not fact():
        assert time.monotonic() < latest, "waited in vain"
        time.sleep(0.01)


def runner(simulator: Any, **more: Any) -> Runner:
    return Runner(simulator, SCENE, AT_REST, **more)


def drift(scene: Any, hypothesis: Any, rng: Any) -> Iterator[Frame]:
    """Wander about at random; what is wanted sets the pace."""
    frame = scene.start.copy()
    pace = 0.01 + 0.01 * hypothesis.goal_green
    while True:
        yield frame
        frame += pace * rng.normal(size=frame.shape)  # in place, as a careless user would


def slide(scene: Any, hypothesis: Any, rng: Any) -> Iterator[Frame]:
    """Move the red agent by 1 per frame: the error of frame k is k."""
    frame = scene.start.copy()
    while True:
        yield frame.copy()
        frame[0, 0] += 1.0


def fails_for_weak(scene: Any, hypothesis: Any, rng: Any) -> Iterator[Frame]:
    if hypothesis.strength_red < 300:
        raise ValueError("too weak")
    yield from drift(scene, hypothesis, rng)


LIMITS = 0.3, 3.0, 30.0
"""Seconds that a simulation may take, of one try after the other: a machine that has other things
to do can keep a sound simulation from its end for a while. What hangs exceeds them all."""


class Sleeps:
    """Sleeps in the middle of a frame, after having touched a file; or until another is there."""

    def __init__(self, marker: Path, until: Path | None = None) -> None:
        self.marker, self.until = marker, until

    def __call__(self, *given: Any) -> Iterator[Frame]:
        yield START
        self.marker.touch()
        if self.until is None:
            time.sleep(100)
        else:
            wait_until(self.until.exists)
        yield START


class KillsItsWorker:
    """Kills its own process for weak hypotheses; ``times`` times, counted by files in a folder."""

    def __init__(self, folder: Path, times: int, seconds_of_others: float = 0.0) -> None:
        self.folder, self.times, self.seconds_of_others = folder, times, seconds_of_others

    def __call__(self, scene: Any, hypothesis: Any, rng: Any) -> Iterator[Frame]:
        deaths = len(list(self.folder.iterdir()))
        if hypothesis.strength_red < 300 and deaths < self.times:
            (self.folder / str(deaths)).touch()
            os._exit(1)
        time.sleep(self.seconds_of_others)
        yield from drift(scene, hypothesis, rng)


class Slips:
    """Leaves files where it travels to a process and warms up; tells its process if weak.

    It fails if it runs cold.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        (self.folder / f"{os.getpid()}-{time.monotonic_ns()}").touch()

    def warm_up(self) -> None:
        (self.folder / f"warm-{time.monotonic_ns()}").touch()

    def __call__(self, scene: Any, hypothesis: Any, rng: Any) -> Iterator[Frame]:
        assert list(self.folder.glob("warm-*"))
        if hypothesis.strength_red < 300:
            tells_its_process()
        yield from drift(scene, hypothesis, rng)


def tells_its_process(*given: Any) -> Any:
    """Fail with what a process has imported, its threads, and whether Ctrl-C reaches it."""
    heavy = {"arviz", "jax", "matplotlib", "numpyro", "pytest", "torch", "xarray"}
    threads = {os.environ.get(f"{name}_NUM_THREADS") for name in ("OMP", "NUMBA", "OPENBLAS")}
    blocked = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    raise RuntimeError(
        f"heavy {sorted(heavy & set(sys.modules))}, threads {sorted(map(str, threads))}, "
        f"interrupts blocked {blocked}"
    )
