"""What the closed-loop reader makes of a real video, kept in parts for other settings."""

from __future__ import annotations

import dataclasses
import functools
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.policies import Outlook
from phase_ppl.closed_loop.hidden_state import HiddenState, Tracking
from phase_ppl.closed_loop.reader import Reader, policy
from phase_ppl.models import priors
from phase_ppl.models.effective import log_prior_of_effective
from phase_ppl.physics.actions import ACTION_NAMES, Action, executed
from phase_ppl.world.event import Event
from phase_ppl.world.goals import N_GOALS, goal_index
from phase_ppl.world.relations import RELATION_TABLE

FloatArray = NDArray[np.float64]
ALIKE = 0.7
"""Nats within which two actions explain a frame equally well."""

_MIRRORED = {"TURN_LEFT": "TURN_RIGHT", "LEFT": "RIGHT", "UP_LEFT": "UP_RIGHT"}
_MIRRORED |= {"DOWN_LEFT": "DOWN_RIGHT"}
_MIRRORED |= {there: here for here, there in _MIRRORED.items()}


def recovered(record: dict[str, Any], event: Event) -> NDArray[np.int64]:
    """Return the recovered actions (step, agent), as executed in the video as it was shown.

    A reflection changes handedness, so what was to the left is to the right.
    """
    actions = np.array([[ACTION_NAMES.index(name) for name in pair] for pair in record["actions"]])
    actions = actions[: min(record["exact_rows"], event.observation.n_frames - 1)]
    if record["reflection"] != "none":
        swap = np.arange(len(Action))
        for here, there in _MIRRORED.items():
            swap[Action[here]] = Action[there]
        actions = swap[actions]
    turning = event.scene.turning
    return np.vectorize(lambda a: executed(int(a), turning))(actions)


class Told(HiddenState):
    """A filter that is told the actions."""

    def tell(self, pair: NDArray[np.int64]) -> None:
        self._log_prior = np.full((len(Action), len(Action)), -np.inf)
        self._log_prior[pair[0], pair[1]] = 0.0


def compare_with_replay(task: tuple[Event, dict[str, Any]]) -> dict[str, Any]:
    """Return how often actions and holds agree, over both agents, and of how many steps."""
    event, record = task
    actions = recovered(record, event)
    free, told = HiddenState(event.scene, Tracking()), Told(event.scene, Tracking())
    best = alike = held = 0
    seconds = 0.0
    for frame, pair in zip(event.observation.trajectory[1:], actions, strict=False):
        started = time.perf_counter()
        density = free.advance(frame)
        seconds += time.perf_counter() - started
        told.tell(pair)
        told.advance(frame)
        for agent, action in enumerate(pair):
            own = density.max(axis=1 - agent)
            best += int(own[action] >= own.max() - 1e-9)
            alike += int(own[action] > own.max() - ALIKE)
        held += int((free.beam.best()[1] == told.beam.best()[1]).sum())
    levels = np.array(Tracking().strengths)
    place = np.unravel_index(free.strengths().argmax(), (len(levels), len(levels)))
    strengths = np.mean(levels[list(place)] == record["strength_newton"])
    return {
        "steps": len(actions),
        "actions": best,
        "alike": alike,
        "held": held,
        "strengths": float(strengths),
        "seconds": seconds,
    }


@dataclasses.dataclass
class Kept:
    """Densities of all joint actions and outlooks of all intents, per step of a video."""

    truth: tuple[int, int]
    densities: list[FloatArray]
    outlooks: list[list[list[Outlook]]]
    of_pair: list[list[NDArray[np.int64]]]

    @property
    def n_steps(self) -> int:
        return len(self.densities)

    def log_likelihood(self, sharpness: float, lapse: float) -> FloatArray:
        """Return (goal_red, goal_green) summed over frames."""
        total = np.zeros((N_GOALS, N_GOALS))
        for density, outlooks, index in zip(
            self.densities, self.outlooks, self.of_pair, strict=True
        ):
            red, green = (
                np.stack([policy(outlook, sharpness, lapse) for outlook in found])
                for found in outlooks
            )
            with np.errstate(divide="ignore"):
                total += np.log((red @ density @ green.T)[index[0], index[1]])
        return total

    def of_truth(self, table: FloatArray) -> float:
        """Return the entry of the true pair of goals."""
        return float(table[self.truth])

    def log_score(self, table: FloatArray, weight: float) -> float:
        """Return the mean log probability of the true goals and relation."""
        log_mass = log_prior() + weight * np.where(np.isnan(table), -np.inf, table)
        mass = np.exp(log_mass - np.logaddexp.reduce(log_mass.ravel()))
        red, green = self.truth
        relation = mass[RELATION_TABLE[red, green] == RELATION_TABLE].sum()
        found = [mass.sum(axis=1)[red], mass.sum(axis=0)[green], relation]
        return float(np.mean(np.log(np.maximum(found, 1e-12))))


class Recorder(Reader):
    """A reader that keeps what it computes with."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.densities: list[FloatArray] = []
        self.outlooks: list[list[list[Outlook]]] = []
        self.of_pair: list[list[NDArray[np.int64]]] = []

    def _of_pairs(self, outlooks: list[list[Outlook]], relative: FloatArray) -> FloatArray:
        self.densities.append(relative)
        self.outlooks.append(outlooks)
        self.of_pair.append([agent.of_pair.copy() for agent in self._policies])
        return super()._of_pairs(outlooks, relative)


def record(event: Event) -> Kept:
    """Read a real video and keep everything."""
    assert event.truth is not None
    truth = goal_index(event.truth.goal_red), goal_index(event.truth.goal_green)
    with Recorder(event.scene, PlannerConfig.fast(), Tracking(), 1.0, 0.5) as reader:
        for frame in event.observation.trajectory[1:]:
            reader.read(frame)
    return Kept(truth, reader.densities, reader.outlooks, reader.of_pair)


@functools.cache
def log_prior() -> FloatArray:
    """Return (goal_red, goal_green) log prior masses of the uniform prior."""
    pairs = np.argwhere(np.ones((N_GOALS, N_GOALS), bool))
    strengths = dict.fromkeys(("strength_red", "strength_green"), np.full(len(pairs), 300.0))
    found = log_prior_of_effective(priors.named("uniform"), pairs, strengths)
    return (found - np.logaddexp.reduce(found)).reshape(N_GOALS, N_GOALS)
